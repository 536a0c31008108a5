"""Gains of flight controllers: the firmware's own chain, written here anew, must turn the model as quasi's PID does."""

import math

import numpy as np
import plain_plant
import pytest

from quasi.errors import DataError
from quasi.model.hover import find_hover_speed
from quasi.model.model import Model
from quasi.simulation.control.control_model import make_control_model, use_geometric_mixer
from quasi.simulation.control.gains import derive_gains
from quasi.simulation.control.registry import PID
from quasi.simulation.loop.setup import make_setup
from quasi.simulation.tools.firmware_gains import command_slope, firmware_gains, gains_of_setup, gains_text, px4_effect
from quasi.simulation.tools.margins import compute_margins

STEP = 0.004
MAP = {"coefficients": [300.0, 2100.0, 100.0]}
AXES = ("Mx", "My", "Mz")


@pytest.fixture(scope="module")
def model():
    made = plain_plant.made_model()
    actuators = {**made.document["actuators"], "command map": MAP}
    return Model({**made.document, "actuators": actuators})


@pytest.fixture(scope="module")
def found(model):
    return firmware_gains({"controller": "PID"}, model, STEP)


def wanted(model):
    """Time constants (3,) of the rates."""
    rates = derive_gains(PID, use_geometric_mixer(make_control_model(model)), STEP)["rates"]
    return np.array([rates["time constant"]] * 2 + [rates["yaw time constant"]]), rates


def turned(model, speeds):
    """Angular acceleration (3,) at these rotor speeds, by the model's moments and the diagonal of the inertia."""
    return model.predict(np.zeros(12), speeds)[1] / np.diag(model.airframe.inertia)


@pytest.mark.parametrize("axis", range(3))
def test_betaflight_s_chain_gives_the_pid_s_angular_acceleration(axis, model, found):
    error = math.degrees(0.01)  # deg/s, of 0.01 rad/s
    total = 0.032029 * found.betaflight["P"][axis] * error
    # motors that push the axis up gain what the others lose
    hubs, spin = model.airframe.hubs, model.airframe.spin
    pattern = np.sign([-hubs[:, 1], hubs[:, 0], -spin][axis])
    hover = find_hover_speed(model)
    command = np.roots([100.0, 2100.0, 300.0 - hover])
    command = command[(command > 0) & (command < 1)][0] + pattern * total / 1000.0
    speeds = 300.0 + 2100.0 * command + 100.0 * command**2
    assert turned(model, speeds)[axis] == pytest.approx(0.01 / wanted(model)[0][axis], rel=0.01)


@pytest.mark.parametrize("axis", range(3))
def test_px4_s_chain_gives_the_pid_s_angular_acceleration(axis, model, found):
    setpoint = np.zeros(3)
    setpoint[axis] = found.px4["P"][axis] * 0.01
    frame, full = model.airframe, 2500.0
    most = frame.mass * 9.81 / 4 * (full / find_hover_speed(model)) ** 2
    effect = np.array([-frame.hubs[:, 1] * most, frame.hubs[:, 0] * most, -0.012 * most * frame.spin, [-most] * 4])
    mix = np.linalg.pinv(effect)
    # PX4: roll and pitch over the larger rms norm, yaw over its largest entry
    norms = [math.sqrt(np.sum(mix[:, k] ** 2) / 2.0) for k in (0, 1)]
    mix = mix[:, :3] / [max(norms), max(norms), mix[:, 2].max()]
    share = (find_hover_speed(model) / full) ** 2 + mix @ setpoint
    assert turned(model, full * np.sqrt(share))[axis] == pytest.approx(0.01 / wanted(model)[0][axis], rel=0.01)


def test_px4_s_mix_of_a_symmetric_quadrotor_is_the_known_one(model):
    """Roll and pitch entries 0.7071 and yaw 1, as in PX4's quadrotor x."""
    known, full = use_geometric_mixer(make_control_model(model)), 2500.0
    effect = px4_effect(known, full) * np.diag(known.inertia)
    moments = known.effectiveness[:3] * full**2
    np.testing.assert_allclose(effect, np.abs(moments).sum(axis=1) * [math.sqrt(0.5), math.sqrt(0.5), 1.0], rtol=1e-9)


def test_integral_and_derivative_follow_from_the_same_times(model, found):
    _, rates = wanted(model)
    np.testing.assert_allclose(found.px4["I"], found.px4["P"] / rates["integral time"])
    np.testing.assert_allclose(found.px4["D"], found.px4["P"] * rates["derivative time"])
    b = found.betaflight
    np.testing.assert_allclose(b["I"] * 0.244381, b["P"] * 0.032029 / rates["integral time"])
    np.testing.assert_allclose(b["D"] * 0.000529, b["P"] * 0.032029 * rates["derivative time"])
    attitude = derive_gains(PID, use_geometric_mixer(make_control_model(model)), STEP)["attitude"]
    assert b["level P"] == pytest.approx(10.0 / attitude["time constant"])
    np.testing.assert_allclose(found.px4["attitude P"][:2], 1.0 / attitude["time constant"])


def test_margins_are_those_of_the_pid_loop(model, found):
    expected = compute_margins({"controller": "PID", "time step": STEP}, model, STEP).by_direction["roll"]
    assert found.margins.by_direction["roll"] == expected


def test_without_a_map_or_a_limit_it_is_said_so():
    made = plain_plant.made_model()
    found = firmware_gains({"controller": "INDI"}, made, STEP)
    assert any("linear" in note for note in found.notes) and found.px4 is not None
    blind = Model({**made.document, "airframe": {**made.document["airframe"], "max RPM": None}})
    assert firmware_gains({"controller": "PID"}, blind, STEP).px4 is None


def test_a_map_that_never_reaches_hover_is_refused(model):
    low = Model({**model.document, "actuators": {"command map": {"coefficients": [100.0, 900.0]}}})
    with pytest.raises(DataError, match="'command map'"):
        command_slope(low, make_control_model(low))


def test_the_table_is_marked_as_not_flown_and_stands_under_the_margins(model, found):
    text = gains_text(found)
    assert "not flown" in text and "MC_<axis>RATE_P" in text and "Betaflight level P" in text
    setup = make_setup({"model": {"model ID": "made"}, "controller": {"controller": "drone_PID"}}, model)
    assert gains_of_setup(setup).splitlines()[2:5] == text.splitlines()[2:5]
