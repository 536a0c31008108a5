"""Attitude on board data alone, against a truth it has not seen."""

import numpy as np
import pytest
from made_motion import body
from scipy.spatial.transform import Rotation

from quasi.attitude import to_euler
from quasi.errors import DataError
from quasi.importing.onboard_attitude import estimate_attitude, rest_at_start


def tilt_error(estimate, truth):
    """Angle between the two verticals, seen in body axes, rad."""
    down = Rotation.from_quat(estimate, scalar_first=True).inv().apply([0, 0, 1])
    true = Rotation.from_quat(truth, scalar_first=True).inv().apply([0, 0, 1])
    return np.arccos(np.clip(np.sum(down * true, axis=1), -1, 1))


def test_rest_before_take_off_gives_level_and_bias():
    truth = body(30.0, rate=500.0, rest=4.0)
    rng = np.random.default_rng(1)
    bias = np.array([0.02, -0.015, 0.01])
    gyro = truth.rates + bias + rng.normal(0, 0.01, truth.rates.shape)
    force = truth.force + rng.normal(0, 0.2, truth.force.shape)
    force[0] = 0.0  # a filter that has not settled
    found = estimate_attitude(truth.t, gyro, force)
    assert found.levelled == "at rest"
    assert 3.0 <= found.rest_seconds <= 4.6
    assert found.gyro_bias == pytest.approx(bias, abs=1e-3)
    assert np.degrees(np.sqrt(np.mean(tilt_error(found.quaternion, truth.quaternion) ** 2))) < 1.0
    heading = np.unwrap(to_euler(found.quaternion)[:, 2] - to_euler(truth.quaternion)[:, 2])
    assert np.degrees(np.ptp(heading)) < 5.0


def test_a_flight_that_begins_in_the_air_is_levelled_over_the_flight():
    truth = body(60.0, rate=250.0, seed=3)
    found = estimate_attitude(truth.t, truth.rates + [0.005, 0.0, -0.005], truth.force)
    assert found.levelled == "whole flight"
    assert np.degrees(np.sqrt(np.mean(tilt_error(found.quaternion, truth.quaternion) ** 2))) < 2.5


def test_gyro_alone_is_integrated_exactly_for_a_steady_turn():
    t = np.arange(0, 5, 0.002)
    rates = np.tile([0.0, 0.0, 1.3], (len(t), 1))
    force = np.tile([0.0, 0.0, -9.81], (len(t), 1))
    found = estimate_attitude(t, rates, force)
    assert np.unwrap(to_euler(found.quaternion)[:, 2]) == pytest.approx(1.3 * t, abs=1e-6)


def test_rest_is_found_from_the_first_sample_though_filters_settle_and_rotors_idle():
    truth = body(20.0, rate=500.0, rest=6.0)
    rng = np.random.default_rng(5)
    gyro = truth.rates + [0.03, -0.02, 0.01] + rng.normal(0, 0.04, truth.rates.shape)
    force = truth.force + rng.normal(0, 0.4, truth.force.shape)
    # the log begins while the accelerometer's low-pass rises from zero
    force *= 1 - np.exp(-truth.t / 0.02)[:, None]
    still = rest_at_start(truth.t, gyro, force)
    assert 5.0 <= truth.t[still - 1] <= 6.6


def test_a_tilted_rest_is_tilted():
    t = np.arange(0, 3, 0.002)
    true = Rotation.from_euler("ZYX", [0.0, 0.2, -0.1])
    force = np.tile(true.inv().apply([0, 0, -9.81]), (len(t), 1))
    euler = to_euler(estimate_attitude(t, np.zeros((len(t), 3)), force).quaternion)
    assert euler[-1] == pytest.approx([-0.1, 0.2, 0.0], abs=1e-6)


def test_flight_is_not_rest():
    truth = body(5.0, rate=500.0)
    assert rest_at_start(truth.t, truth.rates, truth.force) == 0


def test_too_short_a_record_is_refused():
    with pytest.raises(DataError, match="half a second"):
        estimate_attitude(np.arange(5) / 100, np.zeros((5, 3)), np.zeros((5, 3)))
