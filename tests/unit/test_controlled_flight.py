"""Controllers in the simulator itself: beside the plain plant, with the manual's faults, and wrong settings by name."""

import numpy as np
import plain_plant as plain
import pytest

from quasi.errors import ConfigError
from quasi.simulation.loop.run import simulate
from quasi.simulation.loop.setup import make_setup

KINDS = ("drone_PID", "drone_NDI", "drone_INDI")
# the manual's listing 12, with its 7.4.2
LISTING = {
    "model": {"use identified model": True, "model path": "models", "model ID": "made",
              "correct for moment asymmetries": True},
    "noise": {"add": True, "seed": 737400},
    "controller": {"controller": "drone_NDI"},
    "actuator": {"actuator": "rotorDynamicsV2"},
    "simulation": {"time step": 0.004, "duration": 6},
    "references": {"do position track": False, "do circle track": False},
    "initial state conditions": {"attitude": [0, 0, 0], "position": [0, 0, 0]},
    "faults": {"inject failure": True, "time of failure": 2, "rotor health after failure": [0.5, 1, 0.75, 1]},
}  # fmt: skip
PARTIAL = {"rotor health after failure": [1, 1, 1, 1], "rotor effectiveness after failure": [0.5, 1, 1, 1]}


@pytest.fixture(scope="module")
def model():
    return plain.made_model()


def flown(model, /, **changes):
    result = simulate(make_setup({**LISTING, **changes}, model))
    table = result.table
    return result, table, np.linalg.norm(table[["x", "y", "z"]].to_numpy(), axis=1)


@pytest.mark.parametrize("name", KINDS)
def test_simulator_and_plain_plant_fly_the_same(name, model):
    steps = [[0, 0, 0, 0], [0.4, 0.8, -0.4, -0.6]]
    table = flown(
        model,
        controller={"controller": name},
        noise={"add": False},
        faults={"inject failure": False},
        simulation={"time step": 0.004, "duration": 2.4},
        references={"kind": "position steps", "steps": steps},
    )[1]
    goals = plain.still(601)
    goals[100:, 1:4] = steps[1][1:]
    log = plain.fly({"controller": name}, model, goals, fine=100)
    # the accelerometer is read at the end of a step here and at the beginning of the next there
    assert np.max(np.abs(table[["x", "y", "z"]].to_numpy() - log[:, :3])) < 5e-3
    assert np.max(np.abs(table[["w1", "w2", "w3", "w4"]].to_numpy() - log[:, 9:13])) < 25.0


def test_half_the_effectiveness_of_a_rotor_is_survived(model):
    faults = {**LISTING["faults"], **PARTIAL}
    result, table, away = flown(model, controller={"controller": "drone_INDI"}, faults=faults)
    assert result.stopped is None
    assert away.max() < 0.5 and away[-1] < 0.1


def test_half_the_effectiveness_near_the_rotors_limit_costs_yaw_alone():
    faults = {**LISTING["faults"], **PARTIAL}
    result, table, away = flown(plain.made_model(hover=2150.0), controller={"controller": "drone_INDI"}, faults=faults)
    assert result.stopped is None
    assert away.max() < 0.6 and abs(table["r"].iloc[-1]) > 1.0
    tilt = np.arccos(np.cos(table["roll"]) * np.cos(table["pitch"]))
    assert np.degrees(tilt.max()) < 35.0


def test_the_manuals_partial_fault_ends_in_loss_of_control(model):
    """Rotor 1 cannot carry its share any more, the controller knows nothing of it and holds on to yaw (7.4.2)."""
    allocation = {"method": "inverse", "learn rotor limits": False}
    result, table, away = flown(model, controller={"controller": "drone_NDI", "allocation": allocation})
    before = table["t"].to_numpy() < 2.0
    assert away[before].max() < 0.1
    assert away[-1] > 5.0
    cap = 0.5 * 1800 * model.airframe.logged_to_rad_s
    assert np.max(table["w1_measured"][table["t"] > 2.1]) < cap * 1.01


def test_the_manuals_full_fault_ends_in_loss_of_control_and_turns_it_over(model):
    faults = {**LISTING["faults"], "rotor health after failure": [1, 1, 1, 0]}
    result, table, away = flown(model, faults=faults, simulation={"time step": 0.004, "duration": 3})
    assert away[-1] > 1.0 or result.stopped
    assert np.min(np.cos(table["roll"]) * np.cos(table["pitch"])) < 0.0


def test_indi_gives_up_yaw_and_keeps_its_place_under_the_manuals_partial_fault(model):
    result, table, away = flown(
        model, controller={"controller": "drone_INDI"}, simulation={"time step": 0.004, "duration": 12}
    )
    assert result.stopped is None and away.max() < 0.5
    assert abs(table["r"].iloc[-1]) > 3.0


@pytest.mark.parametrize("name", KINDS)
def test_an_uncorrected_asymmetry_is_flown_with_other_rotor_speeds(name):
    crooked = plain.made_model(asymmetric=True)
    quiet = {"noise": {"add": False}, "faults": {"inject failure": False}, "controller": {"controller": name}}
    quiet["simulation"] = {"time step": 0.004, "duration": 10}
    speeds = {}
    for corrected in (True, False):
        about = {**LISTING["model"], "correct for moment asymmetries": corrected}
        _, table, away = flown(crooked, model=about, **quiet)
        assert away[-1] < 0.03, (name, corrected)
        speeds[corrected] = table[["w1", "w2", "w3", "w4"]].iloc[-1].to_numpy()
    assert np.ptp(speeds[True]) < 1.0 and np.ptp(speeds[False]) > 10.0


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"controller": {"controller": "drone_INID"}}, "drone_INDI"),
        ({"controller": {"controller": "drone_PID", "gains": {"velocity": {}}}}, "lacks the key 'position'"),
        ({"references": {"kind": "figure eigth"}}, "figure eight"),
        ({"references": {"do circle track": True, "do position track": True}}, "only one of"),
    ],
)
def test_wrong_controllers_and_references_are_named(changes, told, model):
    with pytest.raises(ConfigError, match=told):
        make_setup({**LISTING, **changes}, model)


def test_the_manuals_circle_is_flown_with_its_radius_height_and_rate(model):
    quiet = {"noise": {"add": False}, "faults": {"inject failure": False}, "controller": {"controller": "drone_INDI"}}
    _, table, _ = flown(model, **quiet, simulation={"duration": 14}, references={"do circle track": True})
    first, later = table["t"] < 3.0, table[table["t"] > 8.0]
    assert np.abs(table.loc[first, ["x", "y", "z"]].to_numpy()).max() < 0.01
    phi = later["t"].to_numpy() - 3.0
    assert np.allclose(later["x_ref"], 4 * np.cos(phi)) and np.allclose(later["y_ref"], 4 * np.sin(phi))
    assert np.allclose(later["vx_ref"], -4 * np.sin(phi)) and np.allclose(later["vy_ref"], 4 * np.cos(phi))
    assert np.allclose(later["z_ref"], -2.0) and np.allclose(later["yaw_ref"], 0.0)
    assert np.allclose(np.hypot(later["x"], later["y"]), 4.0, atol=0.1) and np.allclose(later["z"], -2.0, atol=0.05)
    assert np.allclose(later["x"] + 1j * later["y"], 4 * np.exp(1j * phi), atol=0.15)
