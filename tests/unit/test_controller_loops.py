"""Controllers on a plain plant: printed step responses, tracking, noise, models of either kind."""

import math

import numpy as np
import plain_plant as plain
import pytest
from plain_plant import KINDS, POSITION, RATES, TARGETS, UPRIGHT, YAW, rate_goals

from quasi.simulation.control.control_model import make_control_model
from quasi.simulation.control.gains import derive_gains
from quasi.simulation.control.registry import find_law


@pytest.fixture(scope="module")
def model():
    return plain.made_model()


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
    known = make_control_model(model)
    time = derive_gains(find_law(name), known, 0.001)["rates"][block]
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
