"""Resampling: no aliases, no lag, honest flags, a differentiator of the stated bandwidth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quasi.importing.resampling import (
    angular_acceleration,
    covered,
    fresh,
    grid,
    low_pass,
    resample,
    resample_attitude,
    velocity,
)


def test_grid_has_the_rate_and_stays_inside():
    at = grid(0.3, 2.3, 500)
    assert len(at) == 1001
    assert at[-1] == pytest.approx(2.3)


def test_tones_above_the_grids_half_rate_do_not_fold_down():
    t = np.arange(0, 4, 1 / 2000)
    tone = np.sin(2 * np.pi * 390 * t)  # would appear at 10 Hz on a 400 Hz grid
    at = grid(0.5, 3.5, 400)
    assert np.max(np.abs(resample(t, tone[:, None], at).values)) < 0.02
    slow = np.sin(2 * np.pi * 20 * t)
    assert resample(t, slow[:, None], at).values[:, 0] == pytest.approx(np.sin(2 * np.pi * 20 * at), abs=2e-3)


def test_slow_samples_are_interpolated_along_the_curve():
    t = np.arange(0, 4, 1 / 100)
    at = grid(0.1, 3.8, 500)
    out = resample(t, np.sin(2 * np.pi * 3 * t)[:, None], at)
    assert out.values[:, 0] == pytest.approx(np.sin(2 * np.pi * 3 * at), abs=1e-4)
    assert out.sample.mean() == pytest.approx(0.2, abs=0.01)


def nodding(t):
    """An axis that goes round a cone of 10 deg eight times a second, as a vehicle that shakes."""
    turn = 2 * np.pi * 8 * t
    return Rotation.from_rotvec(np.radians(10) * np.stack([np.cos(turn), np.sin(turn), 0 * t], axis=1))


def test_attitudes_follow_a_swing_between_frames_and_the_shortest_turn_across_a_gap():
    t = np.arange(0, 4, 1 / 120)
    at = grid(0.1, 3.8, 500)
    told = resample_attitude(t, nodding(t).as_quat(scalar_first=True), at)
    off = (Rotation.from_quat(told.values, scalar_first=True) * nodding(at).inv()).magnitude()
    assert np.max(off) < np.radians(0.1)  # along the shortest turns 0.5 deg
    torn = (t < 1.0) | (t > 1.5)
    told = resample_attitude(t[torn], nodding(t[torn]).as_quat(scalar_first=True), at)
    tilt = Rotation.from_quat(told.values, scalar_first=True).magnitude()
    assert np.max(tilt[(at > 1.0) & (at < 1.5)]) < np.radians(10.1)
    assert not told.covered[(at > 1.02) & (at < 1.48)].any()


def test_crowded_stamps_do_not_make_the_spline_swing():
    rng = np.random.default_rng(5)
    t = np.sort(np.arange(0, 4, 0.01) + rng.uniform(0, 0.0099, 400))
    values = np.round(np.sin(t), 2)
    out = resample(t, values[:, None], grid(0.1, 3.8, 500)).values
    assert np.max(np.abs(out)) < 1.05


def test_gaps_are_not_covered_and_fresh_means_within_half_a_step():
    t = np.concatenate([np.arange(0, 1, 0.01), np.arange(1.3, 2, 0.01)])
    at = grid(0.0, 1.9, 500)
    inside = (at > 0.99 + 1e-9) & (at < 1.3 - 1e-9)
    assert not covered(t, at)[inside].any()
    outside = (at < 0.989) | (at > 1.301)
    assert covered(t, at)[outside].all()
    inside = (at > 0.995) & (at < 1.295)
    assert not fresh(t, at)[inside].any()
    distance = np.abs(at[:, None] - t[None, :]).min(axis=1)
    assert (fresh(t, at) == (distance <= 0.001 * (1 + 1e-6))).all()


@pytest.mark.parametrize("frequency", [1.0, 5.0, 10.0, 20.0])
def test_differentiator_has_the_stated_bandwidth_and_no_phase(frequency):
    t = np.arange(0, 20, 1 / 240)
    position = np.sin(2 * np.pi * frequency * t)[:, None] * [1, 0, 0]
    at = grid(5, 15, 500)
    out, trusted = velocity(t, position, at, 10.0)
    true = 2 * np.pi * frequency * np.cos(2 * np.pi * frequency * at)
    gain = np.dot(out[:, 0], true) / np.dot(true, true)
    # Butterworth of 4th order run both ways, -3 dB in total at 10 Hz
    expected = 1 / (1 + (frequency / 10.0) ** 8 * (np.sqrt(2) - 1))
    assert gain == pytest.approx(expected, abs=0.02)
    quadrature = np.dot(out[:, 0], np.sin(2 * np.pi * frequency * at)) / np.dot(true, true) * 2 * np.pi * frequency
    assert abs(quadrature) < 2e-3
    assert trusted.all()


def test_velocity_beside_a_gap_is_not_trusted():
    t = np.arange(0, 6, 1 / 120)
    position = np.stack([np.sin(t), np.cos(t), t], axis=-1)
    position[300:360] = np.nan
    at = grid(0.1, 5.9, 500)
    out, trusted = velocity(t, position, at, 10.0)
    assert not trusted[(at > 2.49) & (at < 3.01)].any()
    assert np.isfinite(out).all()
    true = np.stack([np.cos(at), -np.sin(at), np.ones_like(at)], axis=-1)
    calm = trusted & (at > 0.3) & (at < 5.6)
    assert np.max(np.abs(out - true)[calm]) < 0.02


def test_low_pass_is_3_db_down_at_its_cutoff():
    t = np.arange(0, 30, 1 / 500)
    tone = np.sin(2 * np.pi * 40 * t)[:, None]
    inner = slice(5000, 10000)
    assert np.std(low_pass(tone, 500.0, 40.0)[inner]) / np.std(tone[inner]) == pytest.approx(np.sqrt(0.5), rel=0.01)


def test_angular_acceleration_of_slow_turns():
    at = grid(0, 10, 500)
    rates = np.stack([np.sin(3 * at), np.cos(2 * at), at], axis=-1)
    out = angular_acceleration(at, rates)
    true = np.stack([3 * np.cos(3 * at), -2 * np.sin(2 * at), np.ones_like(at)], axis=-1)
    assert np.max(np.abs(out - true)[200:-200]) < 1e-2
