"""Controllers: what they know of the model, the geometry of the attitude loop, their settings."""

import json
import math

import numpy as np
import plain_plant as plain
import pytest
from numba import njit
from plain_plant import KINDS

from quasi.attitude import from_euler, rotate_inverse
from quasi.errors import ConfigError, DataError
from quasi.model.model import Model
from quasi.simulation.control import parameters as g
from quasi.simulation.control.control_model import make_control_model, use_geometric_mixer
from quasi.simulation.control.controllers import controller_step, make_controller
from quasi.simulation.control.gains import complete_settings, derive_gains
from quasi.simulation.control.law import RATE_FILTERS, SPEED_FILTERS
from quasi.simulation.control.ndi import unpack_model
from quasi.simulation.control.outer_loop import (
    _limit_approach_gain,
    attitude_of_angles,
    attitude_of_thrust,
    rotation_matrix,
    turn_towards,
)
from quasi.simulation.control.registry import LAWS
from quasi.terms.kernel import compute_wrench


@pytest.fixture(scope="module")
def model():
    return plain.made_model()


# what the controllers know


def test_the_effectiveness_is_that_of_the_models_terms_about_hover(model):
    known = make_control_model(model)
    thrust = 0.43 * 9.81 / (4 * 1500.0**2)
    left, front, spin = np.array([-1, -1, 1, 1]), np.array([-1, 1, -1, 1]), np.array([1, -1, -1, 1])
    assert known.hover_speed == pytest.approx(1500.0, rel=1e-9)
    expected = thrust * np.array([0.0544 * left, 0.0544 * front, -0.012 * spin, [-1.0] * 4])
    assert np.allclose(known.effectiveness, expected, rtol=1e-6)
    assert np.allclose(known.yaw_reaction, -6e-7 * spin, rtol=1e-6)
    assert known.lag == 0.03
    assert (known.lowest, known.highest) == pytest.approx((200 * 1.4959965, 1800 * 1.4959965))


def test_the_plain_mixer_is_that_of_thrusts_at_the_hubs(model):
    mixer = use_geometric_mixer(make_control_model(model)).effectiveness
    frame = model.airframe
    for i in range(4):
        force = np.array([0.0, 0.0, mixer[3, i]])
        assert np.allclose(np.cross(frame.hubs[i], force)[:2], mixer[:2, i], rtol=1e-3)
        assert np.sign(mixer[2, i]) == -frame.spin[i], "a rotor that turns clockwise pushes the body anticlockwise"


def test_a_model_in_the_controllers_parameters_gives_what_the_model_predicts(model):
    _, parameters, _ = make_controller({"controller": "NDI"}, model, offset=np.arange(6.0))
    rng = np.random.default_rng(4)
    state, speeds, slopes = rng.normal(size=(20, 12)), rng.uniform(500, 2500, (20, 4)), rng.normal(size=(20, 4)) * 1e3
    force, moment = model.predict(state, speeds, slopes)
    out = np.empty(6)
    for row in range(20):
        _from_parameters(parameters, np.concatenate([state[row], speeds[row], slopes[row]]), out)
        assert np.allclose(out, np.concatenate([force[row], moment[row]]) - np.arange(6.0), rtol=1e-12, atol=1e-12)


@njit
def _from_parameters(parameters, inputs, out):
    kernel, offset, _ = unpack_model(parameters)
    compute_wrench(kernel, inputs, np.zeros(len(kernel.code) + len(kernel.numbers)), out)
    out -= offset


# geometry of the attitude loop


def test_rotations_agree_with_the_house():
    q = from_euler(0.4, -0.7, 2.0)
    r = np.array(rotation_matrix(q)).reshape(3, 3)
    assert np.allclose(r, np.column_stack([rotate_inverse(q * [1, -1, -1, -1], e) for e in np.eye(3)]), atol=1e-12)
    assert np.allclose(np.array(attitude_of_angles(0.4, -0.7, 2.0)).reshape(3, 3), r, atol=1e-12)


def test_the_attitude_of_a_thrust_points_its_z_axis_against_it_with_the_wanted_heading():
    thrust, yaw = np.array([3.0, -2.0, -9.0]), 2.5
    d = np.array(attitude_of_thrust(*thrust, yaw)).reshape(3, 3)
    assert np.allclose(d.T @ d, np.eye(3), atol=1e-12) and np.linalg.det(d) == pytest.approx(1.0)
    assert np.allclose(d[:, 2], -thrust / np.linalg.norm(thrust))
    assert math.atan2(d[1, 0], d[0, 0]) == pytest.approx(yaw)


def test_small_attitude_errors_ask_for_their_rotation_vector(model):
    _, p, _ = make_controller({"controller": "INDI"}, model)
    q = from_euler(0.5, -0.3, 1.0)
    small = np.array([2e-4, -3e-4, 1e-4])
    half = np.concatenate([[1.0], 0.5 * small])
    w, v = q[0], q[1:]
    turned = np.concatenate([[w * half[0] - v @ half[1:]], w * half[1:] + half[0] * v + np.cross(v, half[1:])])
    out = np.empty(3)
    turn_towards(rotation_matrix(q), rotation_matrix(turned), p, out)
    assert np.allclose(out, small * [p[g.ATTITUDE_GAIN], p[g.ATTITUDE_GAIN], p[g.YAW_GAIN]], rtol=1e-3)


def test_upside_down_it_turns_over_rather_than_waits(model):
    _, p, _ = make_controller({"controller": "INDI"}, model)
    out = np.empty(3)
    turn_towards(rotation_matrix(from_euler(math.pi, 0.0, 0.0)), rotation_matrix(from_euler(0.0, 0.0, 0.0)), p, out)
    assert np.hypot(out[0], out[1]) == pytest.approx(p[g.ATTITUDE_GAIN] * math.pi)


# filters and braking


def test_filtered_rates_and_rotor_speeds_are_of_the_same_moment(model):
    """With every term known and no noise, the filtered moment explains the filtered acceleration in a manoeuvre."""
    light = plain.made_model()
    for axis in ("Mx", "My", "Mz", "Fx", "Fy", "Fz"):  # no aerodynamic damping or drag
        for term in light.document["axes"][axis]["terms"]:
            if term["name"] in "uvwpqr":
                term["coefficient"] = 0.0
    light = type(light)(light.document)
    kind, p, size = make_controller({"controller": "INDI"}, light)
    memory, goal, out, seen = np.zeros(size), np.zeros(20), np.empty(4), np.zeros(26)
    goal[0], goal[13] = 3.0, np.nan
    dt, seen[0], rate, speeds = 0.002, 1.0, 0.0, np.full(4, 1500.0)
    late, early = [], []
    left = light.airframe.left
    for step in range(400):
        speeds = 1500.0 + 150.0 * np.sin(40.0 * step * dt) * left
        acceleration = p[g.EFFECTIVENESS] * left[0] * np.sum(left * speeds**2) / light.airframe.inertia[0, 0]
        seen[7], seen[13:17] = rate, speeds
        controller_step(kind, p, memory, dt, seen, goal, out)
        moment = np.sum(p[g.EFFECTIVENESS : g.EFFECTIVENESS + 4] * memory[SPEED_FILTERS : SPEED_FILTERS + 12 : 3])
        raw = np.sum(p[g.EFFECTIVENESS : g.EFFECTIVENESS + 4] * speeds**2)
        late.append(light.airframe.inertia[0, 0] * memory[RATE_FILTERS + 1] - moment)
        early.append(light.airframe.inertia[0, 0] * memory[RATE_FILTERS + 1] - raw)
        rate += dt * acceleration
    assert np.std(late[100:]) < 0.05 * np.std(early[100:])


def test_a_far_goal_is_approached_no_faster_than_can_be_braked():
    gain, brake, most = 1.7, 4.0, 8.0
    way = np.linspace(0.0, 40.0, 400001)
    speed = np.array([_limit_approach_gain(d, gain, brake, most) * d for d in way])
    slowing = np.gradient(0.5 * speed**2, way)  # dv/dt = v dv/dx
    assert slowing.max() <= brake * (1 + 1e-6) and speed.max() == most
    assert np.allclose(speed[way < brake / gain**2], gain * way[way < brake / gain**2])
    assert np.all(np.diff(speed) >= -1e-9) and np.max(np.diff(speed)) < 2 * gain * 1e-4
    assert _limit_approach_gain(0.0, gain, brake, most) == gain


# settings


def test_settled_settings_are_plain_and_settle_to_themselves(model):
    known = make_control_model(model)
    for name in KINDS:
        settled = complete_settings({"controller": f"drone_{name}"}, known)
        assert complete_settings(json.loads(json.dumps(settled)), known) == settled
        assert np.array_equal(
            g.pack_parameters(settled, known), g.pack_parameters(complete_settings(settled, known), known)
        )


def test_each_default_loop_is_slower_than_the_one_inside(model):
    for law in LAWS:
        gains = derive_gains(law, make_control_model(model))
        times = [gains[b]["time constant"] for b in ("rates", "attitude", "velocity", "position")]
        assert np.allclose(np.divide(times[1:], times[:-1]), 2.0)
        assert times[0] > make_control_model(model).lag


BLOCKS = {"position": {}, "velocity": {}, "attitude": {}, "rates": {}}


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"controller": "drone_INID"}, "did you mean 'drone_INDI'"),
        ({"controller": 3}, "not known"),
        ({"controller": "PID", "gain": {}}, "did you mean 'gains'"),
        (
            {"controller": "PID", "gains": {k: v for k, v in BLOCKS.items() if k != "attitude"}},
            "lacks the key 'attitude'",
        ),
        ({"controller": "PID", "gains": {**BLOCKS, "position": {"time constnat": 1}}}, "did you mean 'time constant'"),
        ({"controller": "INDI", "gains": {**BLOCKS, "rates": {"integral time": 1}}}, "unknown key 'integral time'"),
        (
            {"controller": "PID", "gains": {**BLOCKS, "rates": {"time constant": -1}}},
            "it means: s, above 0",
        ),
        ({"controller": "PID", "gains": {**BLOCKS, "rates": 3}}, "expected a section"),
        ({"controller": "PID", "limits": {"tilt": 1.6}}, "at most 80 deg"),
        ({"controller": "INDI", "filter": {"cutoff": 3}}, "did you mean 'cut-off'"),
        ({"controller": "INDI", "filter": {"cut-off": float("nan")}}, "finite number"),
        ({"controller": "INDI", "allocation": {"method": "weigthed"}}, "expected one of 'weighted', 'inverse'"),
        ({"controller": "INDI", "allocation": {"weights": [1, 2, 3]}}, "Four positive numbers"),
        ({"controller": "INDI", "allocation": {"learn rotor limits": 1}}, "true or false"),
        ({"controller": "INDI", "time step": 0}, "positive number of seconds"),
    ],
)
def test_wrong_settings_are_named(settings, told, model):
    with pytest.raises(ConfigError, match=told):
        make_controller(settings, model)


def changed(change):
    document = plain.made_model().document
    change(document)
    return Model(document)


def without(axis, name):
    def change(document):
        part = document["axes"][axis]
        part["terms"] = [t for t in part["terms"] if t["name"] != name]
        part["covariance"] = np.zeros((len(part["terms"]),) * 2).tolist()

    return change


@pytest.mark.parametrize(
    ("change", "error", "told"),
    [
        (without("Mz", "U_r"), DataError, "Mz does not depend"),
        (without("Fz", "w2_1 + w2_2 + w2_3 + w2_4"), DataError, "carries its weight"),
        (lambda d: d["airframe"].update({"mass": None}), DataError, "'Mass' in the logbook"),
        (lambda d: d["airframe"].update({"max RPM": 900.0}), ConfigError, "leave no room"),
    ],
)
def test_models_that_cannot_be_controlled_are_named(change, error, told):
    with pytest.raises(error, match=told):
        make_controller({"controller": "INDI"}, changed(change))


def test_impossible_actuators_are_named(model):
    with pytest.raises(ConfigError, match="positive numbers of seconds"):
        make_controller({"controller": "INDI"}, model, {"time constants": [0.03, 0.03, 0.0, 0.03]})
    with pytest.raises(ConfigError, match="0 s or more"):
        make_controller({"controller": "INDI"}, model, {"delay": -1.0})
