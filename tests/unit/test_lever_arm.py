"""The place of the IMU: hover tells a cg that is off; what the arm adds follows rigid-body kinematics."""

import numpy as np
import pytest
from airframes import BEETLE

from quasi.airframe import read_airframe
from quasi.importing.lever_arm import felt_too_much, hover_arm

HUBS = read_airframe(BEETLE, "beetle").hubs


def hover(cg, seconds=20.0, rate=250.0, seed=1):
    """Rotor speeds whose thrust balances about a cg (x, y) m from the hubs' centre, with small motions of trim."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds, 1 / rate)
    # four thrusts with sum 1, no roll or pitch moment about the cg, no yaw: the least squares solution is the mean one
    lever = HUBS[:, :2] - np.asarray(cg)
    spin = np.array([1.0, -1.0, -1.0, 1.0])
    thrust = np.linalg.lstsq(np.vstack([np.ones(4), lever.T, spin]), [1.0, 0, 0, 0], rcond=None)[0]
    speeds = 2100 * np.sqrt(4 * thrust) * (1 + 0.002 * rng.normal(size=(len(t), 4)))
    rates = 0.02 * rng.normal(size=(len(t), 3))
    force = np.array([0.0, 0.0, -9.81]) + 0.1 * rng.normal(size=(len(t), 3))
    return t, rates, force, speeds


def test_offset_of_the_cg_is_told_by_hover_and_is_minus_the_place_of_the_imu():
    arm = hover_arm(*hover((0.004, -0.002)), HUBS)
    np.testing.assert_allclose(arm.position, [-0.004, 0.002, 0.0], atol=1e-4)
    assert np.all(arm.std[:2] < 1e-4)


def test_cg_ahead_of_the_hubs_makes_the_front_rotors_turn_faster():
    speeds = hover((0.004, 0.0))[3].mean(axis=0)
    front = read_airframe(BEETLE, "beetle").front
    assert speeds[front > 0].min() > speeds[front < 0].max()


def test_flight_without_hover_tells_nothing():
    t, rates, force, speeds = hover((0.004, 0.0))
    assert hover_arm(t, rates + 1.0, force, speeds, HUBS) is None
    assert hover_arm(t, rates, force, 0.0 * speeds, HUBS) is None


def test_what_an_arm_feels_equals_the_second_derivative_of_its_place():
    """Position of a point on a body that turns about a fixed cg, differentiated twice."""
    t = np.arange(0, 2, 1e-3)
    angle = 0.4 * np.sin(3 * t)
    rates = np.column_stack([0 * t, 0 * t, np.gradient(angle, t)])
    arm = np.array([0.03, -0.01, 0.02])
    c, s = np.cos(angle), np.sin(angle)
    place = np.column_stack([c * arm[0] - s * arm[1], s * arm[0] + c * arm[1], np.full_like(t, arm[2])])
    earth = np.gradient(np.gradient(place, t, axis=0), t, axis=0)
    body = np.column_stack([c * earth[:, 0] + s * earth[:, 1], -s * earth[:, 0] + c * earth[:, 1], earth[:, 2]])
    middle = slice(50, -50)
    np.testing.assert_allclose(felt_too_much(t, rates, arm)[middle], body[middle], atol=2e-3)


@pytest.mark.parametrize("lost", [0, 3])
def test_a_missing_sample_does_not_spread(lost):
    t, rates, force, speeds = hover((0.002, 0.001))
    speeds[100 : 100 + lost] = np.nan
    assert hover_arm(t, rates, force, speeds, HUBS).position[0] == pytest.approx(-0.002, abs=2e-4)
