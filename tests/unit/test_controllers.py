"""Controllers on a plain plant: against printed step responses, the model itself, and what faults must do."""

import math

import numpy as np
import plain_plant as plain
import pytest
from numba import njit

from quasi.attitude import from_euler, rotate_inverse
from quasi.errors import ConfigError, DataError
from quasi.simulation import controllers as c
from quasi.simulation import gains as g
from quasi.simulation.control_model import by_geometry, control_model, hover_speed, trim
from quasi.simulation.controllers import controller_step, make_controller
from quasi.simulation.outer_loop import _approach, attitude_of_angles, attitude_of_thrust, rotation, turn_towards
from quasi.standalone.kernel import wrench

KINDS = ("PID", "NDI", "INDI")
POSITION, RATES, ROTORS, TARGETS, UPRIGHT, YAW = slice(0, 3), slice(6, 9), slice(9, 13), slice(13, 17), 17, 18


@pytest.fixture(scope="module")
def model():
    return plain.made_model()


def rate_goals(n, **rates):
    """Goals of body rates, from the first step on."""
    goals = plain.still(n)
    goals[:, 0] = 3.0
    for name, value in rates.items():
        goals[:, 10 + "pqr".index(name)] = value
    return goals


# what the controllers know


def test_the_effectiveness_is_that_of_the_models_terms_about_hover(model):
    known = control_model(model)
    thrust = 0.43 * 9.81 / (4 * 1500.0**2)
    left, front, spin = np.array([-1, -1, 1, 1]), np.array([-1, 1, -1, 1]), np.array([1, -1, -1, 1])
    assert known.hover_speed == pytest.approx(1500.0, rel=1e-9)
    expected = thrust * np.array([0.0544 * left, 0.0544 * front, -0.012 * spin, [-1.0] * 4])
    assert np.allclose(known.effectiveness, expected, rtol=1e-6)
    assert np.allclose(known.yaw_reaction, -6e-7 * spin, rtol=1e-6)
    assert known.lag == 0.03
    assert (known.lowest, known.highest) == pytest.approx((200 * 1.4959965, 1800 * 1.4959965))


def test_the_plain_mixer_is_that_of_thrusts_at_the_hubs(model):
    mixer = by_geometry(control_model(model)).effectiveness
    frame = model.airframe
    for i in range(4):
        force = np.array([0.0, 0.0, mixer[3, i]])
        assert np.allclose(np.cross(frame.hubs[i], force)[:2], mixer[:2, i], rtol=1e-3)
        assert np.sign(mixer[2, i]) == -frame.spin[i], "a rotor that turns clockwise pushes the body anticlockwise"


def test_trim_balances_an_asymmetric_model():
    model = plain.made_model(asymmetric=True)
    speeds = trim(model, hover_speed(model))
    force, moment = model.predict(np.zeros(12), speeds, np.zeros(4))
    assert force[2] == pytest.approx(-0.43 * 9.81, rel=1e-9) and np.allclose(moment, 0.0, atol=1e-12)


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
    kernel, offset, _ = c._unpack_model(parameters)
    wrench(kernel, inputs, np.zeros(len(kernel.code) + len(kernel.numbers)), out)
    out -= offset


# geometry of the attitude loop


def test_rotations_agree_with_the_house():
    q = from_euler(0.4, -0.7, 2.0)
    r = np.array(rotation(q)).reshape(3, 3)
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
    turn_towards(rotation(q), rotation(turned), p, out)
    assert np.allclose(out, small * [p[g.ATTITUDE], p[g.ATTITUDE], p[g.YAW]], rtol=1e-3)


def test_upside_down_it_turns_over_rather_than_waits(model):
    _, p, _ = make_controller({"controller": "INDI"}, model)
    out = np.empty(3)
    turn_towards(rotation(from_euler(math.pi, 0.0, 0.0)), rotation(from_euler(0.0, 0.0, 0.0)), p, out)
    assert np.hypot(out[0], out[1]) == pytest.approx(p[g.ATTITUDE] * math.pi)


# closed loops


@pytest.mark.parametrize("name", KINDS)
def test_in_trim_the_commands_are_those_of_the_hover(name, model):
    log = plain.fly({"controller": name}, model, plain.still(300))
    assert np.allclose(log[:, TARGETS], 1500.0, rtol=1e-6)
    assert np.max(np.abs(log[:, POSITION])) < 1e-6


@pytest.mark.parametrize(
    ("axis", "block"), [("p", "time constant"), ("q", "time constant"), ("r", "yaw time constant")]
)
@pytest.mark.parametrize("name", ["NDI", "INDI"])
def test_rates_answer_like_the_wanted_angular_acceleration_through_the_rotors_lag(name, axis, block, model):
    # nu = (wish - rate)/T and rate' = nu/(lag s + 1): rate = wish/(T lag s^2 + T s + 1)
    known = control_model(model)
    time = g.default_gains(g.kind_of(name), known, 0.001)["rates"][block]
    size = 0.2
    log = plain.fly({"controller": name, "time step": 0.001}, model, rate_goals(400, **{axis: size}), dt=0.001)
    t = np.arange(400) * 0.001
    roots = np.roots([time * 0.03, time, 1.0])
    answer = size * np.real(
        1 + (roots[1] * np.exp(roots[0] * t) - roots[0] * np.exp(roots[1] * t)) / (roots[0] - roots[1])
    )
    # one step of waiting, and the damping that INDI sees through its filter
    assert np.max(np.abs(log[:, 6 + "pqr".index(axis)] - answer)) < (0.03 if name == "NDI" else 0.06) * size


def test_ndi_decouples_the_axes_of_a_full_inertia_at_high_rates(model):
    start = np.zeros(13)
    start[6:9] = [6.0, -5.0, 4.0]
    goals = rate_goals(200, p=6.0, q=-5.0, r=4.0)
    log = plain.fly({"controller": "NDI", "time step": 0.001}, model, goals, dt=0.001, start=start)
    # gyroscopic accelerations of 20 rad/s2 would carry the rates away by more than 1 rad/s
    assert np.max(np.abs(log[:, RATES] - start[6:9])) < 0.8
    assert np.max(np.abs(log[100:, RATES] - start[6:9])) < 0.35


@pytest.mark.parametrize("name", KINDS)
def test_a_position_step_is_followed_without_much_overshoot_and_settles(name, model):
    goals = plain.still(2500)
    goals[50:, 1:4] = [1.0, -0.5, -0.4]
    log = plain.fly({"controller": name}, model, goals)
    for k, way in enumerate([1.0, -0.5, -0.4]):
        assert np.max(log[:, k] / way) < 1.16, "overshoot"
        assert log[-1, k] == pytest.approx(way, abs=0.01)
        rise = np.argmax(log[:, k] / way > 0.9) - 50
        assert 0.3 < rise * 0.004 < 1.6
    assert np.max(np.abs(log[:, YAW])) < 0.05


@pytest.mark.parametrize("name", KINDS)
def test_a_step_of_heading_turns_the_shorter_way_and_leaves_the_place(name, model):
    goals = plain.still(1500, yaw=3.0)
    goals[500:, 9] = -3.0
    log = plain.fly({"controller": name}, model, goals)
    yaw = np.unwrap(log[:, YAW])
    assert yaw[499] == pytest.approx(3.0, abs=0.03)
    assert yaw[-1] == pytest.approx(2 * math.pi - 3.0, abs=0.02)
    assert np.max(np.linalg.norm(log[:, POSITION], axis=1)) < 0.08


@pytest.mark.parametrize(("name", "most"), [("PID", 0.35), ("NDI", 0.06), ("INDI", 0.08)])
def test_a_figure_eight_is_tracked(name, most, model):
    t = np.arange(4000) * 0.004
    goals = plain.still(len(t))
    goals[:, 1], goals[:, 2] = 2 * np.cos(t), 2 * np.sin(t) * np.cos(t)
    goals[:, 4], goals[:, 5] = -2 * np.sin(t), 2 * np.cos(2 * t)
    goals[:, 15], goals[:, 16] = -2 * np.cos(t), -4 * np.sin(2 * t)
    log = plain.fly({"controller": name}, model, goals, start=[2.0, 0, 0, 0, 2.0, 0] + [0.0] * 7)
    error = np.linalg.norm(log[1500:, POSITION] - goals[1500:, 1:4], axis=1)
    assert np.sqrt(np.mean(error**2)) < most


@pytest.mark.parametrize("name", KINDS)
def test_velocity_and_attitude_goals_are_followed(name, model):
    goals = plain.still(1500)
    goals[:, 0], goals[:, 4:7] = 1.0, [1.0, -0.5, 0.3]
    log = plain.fly({"controller": name}, model, goals)
    assert np.allclose(log[-1, 3:6], [1.0, -0.5, 0.3], atol=0.05)
    goals = plain.still(400)
    goals[:, 0], goals[:, 7:10] = 2.0, [0.2, 0.0, 0.5]
    log = plain.fly({"controller": name}, model, goals)
    # without a thrust it carries the weight: pushed sideways, neither sinking nor rising much
    assert log[-1, UPRIGHT] == pytest.approx(math.cos(0.2), abs=8e-3 if name == "PID" else 3e-3)
    assert log[-1, YAW] == pytest.approx(0.5, abs=0.05)
    assert abs(log[-1, 5]) < 0.3 and log[-1, 4] > 1.0


@pytest.mark.parametrize("name", KINDS)
def test_it_recovers_from_the_manuals_initial_conditions_with_noise(name, model):
    log = plain.fly(
        {"controller": name}, model, plain.still(1500), start=[1.0, 0.5, -1.0] + [0.0] * 10, angles=(0.5, -1.0, 0.5),
        noise=1.0,
    )  # fmt: skip
    assert np.max(np.linalg.norm(log[1250:, POSITION], axis=1)) < 0.1
    assert np.max(np.std(log[1250:, TARGETS], axis=0)) < 15.0, "noise hardly reaches the rotors"


def test_indi_turns_over_when_it_starts_upside_down(model):
    log = plain.fly({"controller": "INDI"}, model, plain.still(1500, (0, 0, -20)), angles=(3.0, 0.0, 0.0),
                    start=[0, 0, -20.0] + [0.0] * 10)  # fmt: skip
    assert log[400, UPRIGHT] > 0.9 and np.linalg.norm(log[-1, POSITION] - [0, 0, -20]) < 0.1


@pytest.mark.parametrize("name", KINDS)
def test_models_with_and_without_gravity_fly_alike(name, model):
    other = plain.made_model(gravity="noGravity")
    goals = plain.still(600)
    goals[50:, 1:4] = [1.0, 1.0, -0.5]
    logs = [plain.fly({"controller": name}, m, goals) for m in (model, other)]
    assert np.allclose(logs[0], logs[1], atol=1e-6)


def test_indi_and_pid_find_constant_moments_and_ndi_inverts_them(model):
    crooked = plain.made_model(asymmetric=True)
    for name in KINDS:
        log = plain.fly({"controller": name}, crooked, plain.still(3000))
        assert np.linalg.norm(log[-1, POSITION]) < 0.02, name
        assert abs(log[-1, YAW]) < 0.02, name
    # the same moments unknown to it leave NDI beside its place: it integrates the velocity, not the rates
    crooked = plain.made_model(asymmetric=10.0)
    log = plain.fly({"controller": "NDI"}, crooked, plain.still(3000), belief=model)
    assert np.max(np.linalg.norm(log[:, POSITION], axis=1)) > 0.1


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
        acceleration = p[g.EFFECT] * left[0] * np.sum(left * speeds**2) / light.airframe.inertia[0, 0]
        seen[7], seen[13:17] = rate, speeds
        controller_step(kind, p, memory, step * dt, dt, seen, goal, out)
        moment = np.sum(p[g.EFFECT : g.EFFECT + 4] * memory[c.SQUARES : c.SQUARES + 12 : 3])
        raw = np.sum(p[g.EFFECT : g.EFFECT + 4] * speeds**2)
        late.append(light.airframe.inertia[0, 0] * memory[c.RATES + 1] - moment)
        early.append(light.airframe.inertia[0, 0] * memory[c.RATES + 1] - raw)
        rate += dt * acceleration
    assert np.std(late[100:]) < 0.05 * np.std(early[100:])


def test_a_far_goal_is_approached_no_faster_than_can_be_braked():
    gain, brake, most = 1.7, 4.0, 8.0
    way = np.linspace(0.0, 40.0, 400001)
    speed = np.array([_approach(d, gain, brake, most) * d for d in way])
    slowing = np.gradient(0.5 * speed**2, way)  # dv/dt = v dv/dx
    assert slowing.max() <= brake * (1 + 1e-6) and speed.max() == most
    assert np.allclose(speed[way < brake / gain**2], gain * way[way < brake / gain**2])
    assert np.all(np.diff(speed) >= -1e-9) and np.max(np.diff(speed)) < 2 * gain * 1e-4
    assert _approach(0.0, gain, brake, most) == gain


# limits and faults


def test_integrals_stay_within_their_limit_and_do_not_wind_up_on_a_long_way(model):
    goals = plain.still(4000, (60.0, 0.0, -8.0))
    log = plain.fly({"controller": "PID"}, model, goals)
    assert np.max(log[:, 0]) < 60.6 and abs(log[-1, 0] - 60.0) < 0.3
    assert np.max(np.hypot(log[:, 3], log[:, 4])) < 8.6, "the speed limit holds"
    assert np.degrees(np.arccos(np.min(log[:, UPRIGHT]))) < 60.0


@pytest.mark.parametrize("name", KINDS)
def test_commands_never_leave_the_rotors_range(name, model):
    goals = plain.still(800)
    goals[100:, 1:4] = [30.0, -30.0, -30.0]
    goals[100:, 9] = 3.0
    log = plain.fly({"controller": name}, model, goals, noise=5.0)
    known = control_model(model)
    assert log[:, TARGETS].min() >= known.lowest * (1 - 1e-12)
    assert log[:, TARGETS].max() <= known.highest * (1 + 1e-12)


def test_half_the_effectiveness_of_a_rotor_is_survived(model):
    log = plain.fly({"controller": "INDI"}, model, plain.still(2500), share=(0.5, 1, 1, 1), fault=2.0, noise=1.0)
    assert np.max(np.linalg.norm(log[:, POSITION], axis=1)) < 0.5
    assert np.linalg.norm(log[-1, POSITION]) < 0.05
    assert log[-1, 9] == pytest.approx(1500.0 * math.sqrt(2.0), rel=0.02), "the weak rotor turns faster"


def test_half_the_effectiveness_where_the_rotors_are_near_their_limit_costs_yaw_and_nothing_else():
    tight = plain.made_model(hover=2150.0)  # rotors reach 1.57 times the hover's thrust: half of it is 0.78
    log = plain.fly({"controller": "INDI"}, tight, plain.still(2500), share=(0.5, 1, 1, 1), fault=2.0, noise=1.0,
                    speeds=2150.0)  # fmt: skip
    assert np.max(np.linalg.norm(log[:, POSITION], axis=1)) < 0.8
    assert np.linalg.norm(log[-1, POSITION]) < 0.15
    assert abs(log[-1, 8]) > 1.0, "it spins"


CAP = {"cap": (0.5 * 2692.8, np.inf, 0.75 * 2692.8, np.inf), "fault": 2.0, "noise": 1.0}


def test_the_manuals_cap_is_loss_of_control_for_a_controller_that_holds_on_to_yaw(model):
    tight = plain.made_model(hover=1500.0)
    weights = {"allocation": {"method": "inverse", "learn rotor limits": False}}
    for name in ("NDI", "INDI"):
        log = plain.fly({"controller": name, **weights}, tight, plain.still(1500), speeds=1500.0, **CAP)
        assert np.linalg.norm(log[-1, POSITION]) > 5.0, name
        assert np.max(np.linalg.norm(log[:500, POSITION], axis=1)) < 0.1, "until the fault it hovers"


def test_the_manuals_cap_is_survived_when_rotor_limits_are_learnt_and_yaw_is_given_up(model):
    log = plain.fly({"controller": "INDI"}, model, plain.still(3000), **CAP)
    assert np.max(np.linalg.norm(log[:, POSITION], axis=1)) < 0.5
    assert abs(log[-1, 8]) > 1.0, "it spins"


def test_even_the_loss_of_a_whole_rotor_leaves_it_spinning_at_its_place(model):
    log = plain.fly({"controller": "INDI"}, plain.made_model(damping=2e-3), plain.still(2500), fault=2.0,
                    cap=(np.inf, np.inf, np.inf, 0.0))  # fmt: skip
    assert np.max(np.linalg.norm(log[:, POSITION], axis=1)) < 1.5
    assert np.linalg.norm(log[-1, POSITION]) < 0.3 and abs(log[-1, 8]) > 15.0


def test_a_learnt_limit_is_forgotten_when_the_rotor_follows_again(model):
    kind, p, size = make_controller({"controller": "INDI"}, model)
    memory, goal, out, seen = np.zeros(size), np.zeros(20), np.empty(4), np.zeros(26)
    goal[13], seen[0], seen[19] = np.nan, 1.0, -9.81
    seen[13:17] = 1500.0
    limits = []
    for step in range(1500):
        goal[3] = -5.0 if step < 300 else 0.0
        capped = 1400.0 if step < 300 else np.inf
        controller_step(kind, p, memory, 0.004 * step, 0.004, seen, goal, out)
        limits.append(memory[c.HIGHEST])
        seen[13:17] += (np.clip(out, 0, np.inf) - seen[13:17]) * (1 - math.exp(-0.004 / 0.03))
        seen[13] = min(seen[13], capped)
    assert min(limits[:300]) < 1450.0
    assert limits[-1] == pytest.approx(p[g.HIGHEST])


# settings


def test_settled_settings_are_plain_and_settle_to_themselves(model):
    import json

    known = control_model(model)
    for name in KINDS:
        settled = g.settle({"controller": f"drone_{name}"}, known)
        assert g.settle(json.loads(json.dumps(settled)), known) == settled
        assert np.array_equal(g.pack(settled, known), g.pack(g.settle(settled, known), known))


def test_each_default_loop_is_slower_than_the_one_inside(model):
    for kind in range(3):
        gains = g.default_gains(kind, control_model(model))
        times = [gains[b]["time constant"] for b in ("rates", "attitude", "velocity", "position")]
        assert np.allclose(np.divide(times[1:], times[:-1]), 2.0)
        assert times[0] > control_model(model).lag


BLOCKS = {"position": {}, "velocity": {}, "attitude": {}, "rates": {}}


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"controller": "drone_INID"}, "did you mean 'drone_INDI'"),
        ({"controller": 3}, "not known"),
        ({"controller": "PID", "gain": {}}, "did you mean 'gains'"),
        (
            {"controller": "PID", "gains": {k: v for k, v in BLOCKS.items() if k != "attitude"}},
            "lacks the block 'attitude'",
        ),
        ({"controller": "PID", "gains": {**BLOCKS, "position": {"time constnat": 1}}}, "did you mean 'time constant'"),
        ({"controller": "INDI", "gains": {**BLOCKS, "rates": {"integral time": 1}}}, "unknown key 'integral time'"),
        ({"controller": "PID", "gains": {**BLOCKS, "rates": {"time constant": -1}}}, "positive number of seconds"),
        ({"controller": "PID", "gains": {**BLOCKS, "rates": 3}}, "expected a section"),
        ({"controller": "PID", "limits": {"tilt": 1.6}}, "at most 1.396"),
        ({"controller": "INDI", "filter": {"cutoff": 3}}, "did you mean 'cut-off'"),
        ({"controller": "INDI", "filter": {"cut-off": float("nan")}}, "positive number"),
        ({"controller": "INDI", "allocation": {"method": "weigthed"}}, "did you mean 'weighted'"),
        ({"controller": "INDI", "allocation": {"weights": [1, 2, 3]}}, "four positive numbers"),
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
    from quasi.standalone.model import Model

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
        (without("Mz", "U_r"), DataError, "Mz does not answer"),
        (without("Fz", "w2_1 + w2_2 + w2_3 + w2_4"), DataError, "carries its weight"),
        (lambda d: d["airframe"].update({"mass": None}), DataError, "knows no mass"),
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


@pytest.mark.parametrize("name", KINDS)
def test_whatever_is_seen_and_wanted_the_commands_are_speeds_that_rotors_can_have(name, model):
    kind, p, size = make_controller({"controller": name}, model)
    rng = np.random.default_rng(6)
    for _ in range(300):
        memory, out = np.zeros(size), np.zeros(4)
        for _ in range(5):
            seen, goal = np.zeros(26), np.zeros(20)
            seen[:4] = rng.normal(size=4)
            seen[:4] /= np.linalg.norm(seen[:4])
            seen[4:13] = rng.normal(size=9) * 10 ** rng.uniform(-2, 3)
            seen[13:17], seen[17:20] = rng.uniform(0, 3000, 4), rng.normal(size=3) * 50
            goal[0], goal[1:18] = rng.integers(4), rng.normal(size=17) * 10 ** rng.uniform(-2, 3)
            goal[13] = np.nan if rng.random() < 0.3 else goal[13]
            controller_step(kind, p, memory, 0.0, 0.004, seen, goal, out)
            assert np.all(np.isfinite(out)), "no number"
            assert p[g.LOWEST] * (1 - 1e-9) <= out.min() and out.max() <= p[g.HIGHEST] * (1 + 1e-9)


def test_what_is_no_number_is_passed_on_and_not_hidden(model):
    for name in KINDS:
        kind, p, size = make_controller({"controller": name}, model)
        seen, goal, memory, out = np.zeros(26), np.zeros(20), np.zeros(size), np.zeros(4)
        seen[0], seen[13:17], seen[19], seen[7] = 1.0, 1500.0, -9.81, np.nan
        controller_step(kind, p, memory, 0.0, 0.004, seen, goal, out)
        assert not np.all(np.isfinite(out))
