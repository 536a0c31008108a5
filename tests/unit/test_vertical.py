"""Flight with the nose through the vertical: loops and flips against independently turned rotation matrices."""

import numpy as np
import pytest
from plain_plant import made_model
from scipy.spatial.transform import Rotation

from quasi.attitude import POLE, from_euler, matrix, to_euler
from quasi.simulation.control.references import evaluate_reference, make_reference
from quasi.simulation.loop.run import simulate
from quasi.simulation.loop.setup import make_setup
from quasi.simulation.tools.figures import draw_simulation
from quasi.simulation.vehicle.dynamics import euler_angles

ANGLES = ["roll", "pitch", "yaw"]


def of_angles(roll, pitch, yaw):
    """Rotation matrices body to earth of angles 3-2-1, by scipy."""
    return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1)).as_matrix()


def turned(start, rates, dt):
    """Matrices (N, 3, 3) from body rates (N, 3) at steps of dt, s: the mean rate of each step by Rodrigues' formula."""
    r = [start]
    for w in 0.5 * (rates[1:] + rates[:-1]):
        r.append(r[-1] @ Rotation.from_rotvec(w * dt).as_matrix())
    return np.array(r)


def flown(references, duration, controller="drone_INDI", **more):
    settings = {"model": {"model ID": "made"}, "noise": {"add": False}, "controller": {"controller": controller},
                "simulation": {"time step": 0.001, "duration": duration}, "references": references, **more}  # fmt: skip
    return simulate(make_setup(settings, made_model()))


LOOP = {"kind": "rate steps", "steps": [[0, 0, 0, 0], [0.1, 0, 6.0, 0, 5.0], [1.3, 0, 0, 0]]}
FLIP = {"kind": "rate steps", "steps": [[0, 0, 0, 0], [0.1, 6.0, 5.0, 3.0, 5.0], [1.3, 0, 0, 0]]}


@pytest.mark.parametrize("references", [LOOP, FLIP], ids=["loop", "flip"])
@pytest.mark.parametrize("controller", ["drone_INDI", "drone_NDI", "drone_PID"])
def test_attitude_velocity_and_path_are_those_of_a_turned_matrix(references, controller):
    result = flown(references, 1.5, controller)
    table = result.table
    assert result.stopped is None
    assert np.degrees(table["pitch"].abs().max()) > (85.0 if references is LOOP else 60.0)
    assert (1 - 2 * (table["qx"] ** 2 + table["qy"] ** 2)).min() < -0.5, "upside down on the way"
    r = turned(np.eye(3), table[["p", "q", "r"]].to_numpy(), 0.001)
    q = table[["qw", "qx", "qy", "qz"]].to_numpy()
    assert np.abs(matrix(q) - r).max() < 2e-4
    assert np.abs(of_angles(*table[ANGLES].to_numpy().T) - matrix(q)).max() < 1e-7
    # earth axes: no product of rates and velocity, no Euler angle
    force = np.einsum("nij,nj->ni", r, table[["Fx", "Fy", "Fz"]].to_numpy()) / 0.43 + [0.0, 0.0, 9.81]
    velocity = np.cumsum(0.0005 * (force[1:] + force[:-1]), axis=0)
    earth = np.einsum("nij,nj->ni", r, table[["u", "v", "w"]].to_numpy())[1:]
    assert np.abs(velocity - earth).max() < 0.02
    path = np.cumsum(0.0005 * np.vstack([velocity[:1], velocity[1:] + velocity[:-1]]), axis=0)
    assert np.abs(path - table[["x", "y", "z"]].to_numpy()[1:]).max() < 0.02


@pytest.mark.parametrize("pitch", [90.0, -90.0])
@pytest.mark.parametrize("start", [0.0, 0.7])
def test_a_start_with_the_nose_at_the_vertical_recovers(pitch, start):
    attitude = [start, np.radians(pitch), -0.4]
    result = flown({}, 4.0, **{"initial state conditions": {"attitude": attitude}})
    table = result.table
    assert result.stopped is None
    assert np.abs(of_angles(*table[ANGLES].to_numpy().T)[0] - of_angles(*attitude)).max() < 1e-7
    assert np.linalg.norm(table[["x", "y", "z"]].to_numpy()[-1]) < 0.3


def test_angles_give_the_attitude_back_at_and_about_the_poles():
    rng = np.random.default_rng(3)
    for off in (0.0, 1e-12, 0.3 * POLE, 3 * POLE, 1e-6, 1e-3):
        for sign in (1.0, -1.0):
            roll, yaw = rng.uniform(-np.pi, np.pi, (2, 50))
            q = from_euler(roll, np.full(50, sign * (np.pi / 2 - off)), yaw)
            angles = to_euler(q)
            assert np.abs(matrix(from_euler(*angles.T)) - matrix(q)).max() < 4e-8
            compiled = np.empty(3)
            for k in range(50):
                euler_angles(q[k], compiled)
                assert np.abs(of_angles(*compiled) - matrix(q[k])).max() < 4e-8
    q = Rotation.random(1000, random_state=5).as_quat()[:, [3, 0, 1, 2]]
    expected = Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_euler("ZYX")[:, ::-1]
    assert np.allclose(to_euler(q), expected, atol=1e-12)


def loop_table():
    """A loop over 2 s about a leaning axis, as a recording holds it: angles that jump where the nose is vertical."""
    t = np.linspace(0.0, 2.0, 41)
    angle = 2 * np.pi * (t / 2 - np.sin(np.pi * t) / (2 * np.pi))  # starts and ends without a rate
    q = Rotation.from_rotvec([0.0, 0.0, 0.5]) * Rotation.from_rotvec(np.outer(angle, [0.0, 1.0, 0.0]))
    return t, q, to_euler(q.as_quat()[:, [3, 0, 1, 2]])


def test_a_table_of_angles_is_followed_through_the_vertical_by_the_shorter_turn():
    t, q, angles = loop_table()
    made = make_reference({"kind": "table", "goal": "attitude"}, {"t": t, **dict(zip(ANGLES, angles.T))})
    goal = np.zeros(20)
    for row in range(len(t) - 1):
        step = (q[row].inv() * q[row + 1]).as_rotvec()
        for share in (0.0, 0.3, 0.9):
            evaluate_reference(*made, t[row] + share * 0.05 + 1e-9, goal)
            expected = (q[row] * Rotation.from_rotvec(step * (share + 2e-8))).as_matrix()
            assert np.abs(of_angles(*goal[7:10]) - expected).max() < 1e-6
            assert np.allclose(goal[10:13], step / 0.05, atol=1e-6)


def test_a_loop_is_flown_by_its_table_of_angles():
    t, _, angles = loop_table()
    columns = {"t": t, **dict(zip(ANGLES, angles.T)), "thrust": np.full(len(t), 4.2)}
    settings = {"model": {"model ID": "made"}, "noise": {"add": False},
                "simulation": {"time step": 0.002, "duration": 2.2},
                "initial state conditions": {"attitude": [0, 0, 0.5]},
                "references": {"kind": "table", "goal": "attitude"}}  # fmt: skip
    result = simulate(make_setup(settings, made_model(), reference=columns))
    assert result.stopped is None
    assert result.summary()["tracking"]["attitude"]["greatest"] < 0.35
    table = result.table
    assert of_angles(*table[ANGLES].to_numpy().T)[:, 2, 2].min() < -0.99, "upside down on the way"
    assert np.abs(table["pitch_ref"]).max() <= np.pi / 2
    figures = draw_simulation(table, result.setup.airframe, {"name": "loop"})
    error = np.concatenate([line.get_ydata() for line in figures["tracking_error"].axes[0].lines])
    assert np.nanmax(np.abs(error)) < np.degrees(0.35)
    roll = next(a for a in figures["states"].axes if a.get_ylabel() == "roll, deg").lines[0].get_ydata()
    assert np.nanmax(np.abs(np.diff(roll))) < 120.0
