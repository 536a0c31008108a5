"""Agreement with rotorpy, another simulator, on a common airframe; benchmarks/rotorpy_agreement.py makes its numbers.

rotorpy's axes point up and left where ours point down and right: S = diag(1, -1, -1) turns one into the other.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from simulations import state_derivative

from quasi.attitude import GRAVITY, to_euler
from quasi.model.model import Model
from quasi.simulation.loop.setup import make_step_inputs
from quasi.simulation.tools.replay import ActuatorDynamics, replay
from quasi.simulation.vehicle.dynamics import (
    GIVEN_ACCELERATION,
    ROTOR_SPEEDS,
    TARGET_SPEED,
    WIND_VELOCITY,
    make_body_constants,
    make_scratch,
)

S = np.array([1.0, -1.0, -1.0])


def model_of(reference):
    """Its forces and moments as polynomials: each rotor's thrust, torque and drag at its hub, summed over the rotors.

    Sums over rotors of W x, W y, W x y and so on are d u_q, -d u_p, -d2 u_r; local velocity is V + omega x r.
    """
    c, d = reference["constants"], reference["hubs"]["r4"][0]
    speed = "(u^2 + v^2 + w^2)^0.5"
    k, z = c["k_d"], c["k_z"]
    terms = {
        "Fx": {f"{speed}*u": -c["c_Dx"], "w_tot*u": -k, "r*u_p": -k * d},
        "Fy": {f"{speed}*v": -c["c_Dy"], "w_tot*v": -k, "r*u_q": -k * d},
        "Fz": {f"{speed}*w": -c["c_Dz"], "w2_1 + w2_2 + w2_3 + w2_4": -c["k_eta"], "w_tot*w": -z, "p*u_p": z * d,
               "q*u_q": z * d},
        "Mx": {"U_p": c["k_eta"] * d, "w*u_p": z * d, "p*w_tot": -z * d * d, "q*u_r": -z * d * d},
        "My": {"U_q": c["k_eta"] * d, "w*u_q": z * d, "p*u_r": -z * d * d, "q*w_tot": -z * d * d},
        "Mz": {"U_r": -c["k_m"], "v*u_q": -k * d, "u*u_p": -k * d, "r*w_tot": -2 * k * d * d},
    }  # fmt: skip
    inertia = np.array([[c["Ixx"], c["Ixy"], c["Ixz"]], [c["Ixy"], c["Iyy"], c["Iyz"]], [c["Ixz"], c["Iyz"], c["Izz"]]])
    inertia = inertia * np.outer(S, S)
    document = {
        "schema": "quasi.model/1", "id": "rotorpy", "gravity": "withGravity", "hover speed": {"value": 1500.0},
        "airframe": {
            "name": "common", "mass": c["mass"], "inertia": inertia.tolist(), "rotor radius": 0.038, "b": 0.077,
            "hubs": [(np.array(h) * S).tolist() for h in reference["hubs"].values()], "spin": reference["spin"],
            "motor poles": 14, "idle RPM": None, "max RPM": None, "marker offset": [0, 0, 0], "noise": {},
            "rotor config": {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3},
            "rotor1 clockwise": True,
        },
        "actuators": {},
        "axes": {
            axis: {"unit": "N", "R2": 1.0, "RMSE": 0.0, "n": 9, "sigma2": 0.0, "effective rows": 9, "covariance": [],
                   "confidence level": 0.95, "terms": [{"name": e, "expression": e, "coefficient": v, "std": 0.0,
                                                        "unit": "", "given": True} for e, v in of.items()]}
            for axis, of in terms.items()
        },
    }  # fmt: skip
    return Model(document)


def ours(state):
    """Our state (17,) and the wind (3,) of one of theirs (20,)."""
    quaternion = np.array([state[9], *(state[6:9] * S)])
    x = np.concatenate([quaternion, np.zeros(3), state[10:13] * S, state[0:3] * S, state[16:20]])
    w, r = x[0], x[1:4]
    velocity = state[3:6] * S
    turned = 2.0 * np.cross(-r, velocity)
    x[4:7] = velocity + w * turned + np.cross(-r, turned)
    return x, state[13:16] * S


def derivative_error(reference):
    """Largest difference of the derivatives, each relative to the largest of its kind."""
    model = model_of(reference)
    tau = reference["constants"]["tau_m"]
    body = make_body_constants(model.airframe.mass, model.airframe.inertia, model.kernel, GRAVITY, tau, tau)
    scratch = make_scratch(model.kernel)
    worst = 0.0
    for state, command, theirs in zip(*(np.array(reference[k]) for k in ("states", "commands", "derivatives"))):
        x, wind = ours(state)
        held = make_step_inputs(20, 0.0)
        (
            held[TARGET_SPEED : TARGET_SPEED + 4],
            held[GIVEN_ACCELERATION : GIVEN_ACCELERATION + 4],
            held[WIND_VELOCITY : WIND_VELOCITY + 3],
        ) = command, np.nan, wind
        state_derivative(x, held, model.kernel, body, scratch.inputs, scratch.work, scratch.loads, scratch.derivatives)
        mine = scratch.derivatives[0]
        # their velocity is in the world: dv/dt there is R (dv/dt + omega x v)
        w, r = x[0], x[1:4]
        inside = mine[4:7] + np.cross(x[7:10], x[4:7])
        turned = 2.0 * np.cross(r, inside)
        acceleration = inside + w * turned + np.cross(r, turned)
        pairs = (
            (mine[10:13] * S, theirs[0:3]),
            (acceleration * S, theirs[3:6]),
            (np.array([*(mine[1:4] * S), mine[0]]), theirs[6:10]),
            (mine[7:10] * S, theirs[10:13]),
            (mine[ROTOR_SPEEDS:], theirs[16:20]),
        )
        worst = max(worst, *(float(np.max(np.abs(a - b)) / np.max(np.abs(b))) for a, b in pairs))
    return worst


def rollout_error(reference):
    """Largest difference in position (m), velocity (m/s), attitude (rad) and rates (rad/s) over the second."""
    model = model_of(reference)
    path = reference["roll-out"]
    commands, rows = np.array(path["commands"]), np.array(path["states"])
    start, wind = ours(rows[0])
    n = len(commands) + 1
    t = path["dt"] * np.arange(n)
    states = np.zeros((n, 12))
    states[0] = [*to_euler(start[:4]), *start[4:13]]
    orders = np.concatenate([commands, commands[-1:]])
    tau = reference["constants"]["tau_m"]
    rotors = ActuatorDynamics(tau, tau, 0.0, 200.0, 2600.0)
    speeds = np.tile(start[ROTOR_SPEEDS:], (n, 1))
    found = replay(model, t, states, speeds, [0], t[-1], orders, rotors, np.tile(wind, (n, 1)), substeps=20)[0, ::10]
    worst = 0.0
    for mine, row in zip(found, rows):
        theirs, _ = ours(row)
        sign = np.sign(mine[:4] @ theirs[:4])
        differences = np.concatenate([mine[4:] - theirs[4:], mine[:4] - sign * theirs[:4]])
        worst = max(worst, float(np.max(np.abs(differences))))
    return worst


@pytest.fixture(scope="module")
def reference():
    return json.loads((Path(__file__).parent / "rotorpy_reference.json").read_text(encoding="utf-8"))


def test_the_state_derivative_agrees_with_rotorpys_to_1e_12(reference):
    assert derivative_error(reference) < 1e-12


def test_a_second_in_open_loop_with_changing_commands_agrees_with_rotorpys_to_1e_6(reference):
    assert rollout_error(reference) < 1e-6
    # and the second is one that tells: metres and radians are flown
    path = np.array(reference["roll-out"]["states"])
    assert np.ptp(path[:, 0]) > 0.5 and np.abs(path[:, 10:13]).max() > 0.5
