"""Clipped sensors are found with their range known or not; peaks, coarse logs and held values are none."""

import numpy as np
import pytest
from rigid_body import measure, move, quadrotor
from scipy.signal import butter, lfilter, sosfiltfilt

from quasi.filtering.flight import filter_flight
from quasi.sensor_limits import find_clipping

RATE = 1000.0
STEP = np.radians(1.0)


def motion(seed, size=4.0, noise=0.05, n=30000):
    rng = np.random.default_rng(seed)
    low = butter(2, 3.0, fs=RATE, output="sos")
    x = sosfiltfilt(low, rng.standard_normal(n + 2000))[1000:-1000]
    return size * x / x.std() + noise * rng.standard_normal(n)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("step", [0.0, STEP])
def test_a_clipped_channel_is_found_below_any_usual_range_and_where_it_is(seed, step):
    true = motion(seed)
    limit = 5.3  # rad/s, no usual full scale
    seen = np.clip(true, -limit, limit)
    if step:
        seen = step * np.round(seen / step)
    found = find_clipping(seen, "gyro", step)
    assert sorted(np.sign(end.level) for end in found) == [-1, 1]
    for end in found:
        beyond = np.sign(end.level) * true >= limit
        assert end.full_scale is None and abs(end.level) == pytest.approx(limit, abs=0.6 * STEP)
        # rounding carries values of half a step below to the limit as well
        assert end.where[beyond].all() and (end.where & ~beyond).sum() <= (0.1 if step else 0.0) * beyond.sum()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size", [0.3, 1.0, 8.0])
@pytest.mark.parametrize("noise", [0.0, 0.002, 0.05])
def test_peaks_are_not_clipped_however_coarse_the_log(seed, size, noise):
    for step in (0.0, STEP, 4 * STEP):
        seen = motion(seed, size, noise)
        seen = step * np.round(seen / step) if step else seen
        assert find_clipping(seen, "gyro", step) == []


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("degrees", [125.0, 250.0, 500.0, 2000.0])
@pytest.mark.parametrize("share", [0.993, 0.999, 1.004])
def test_a_peak_that_happens_to_reach_a_usual_full_scale_is_none(seed, degrees, share):
    seen = motion(seed, noise=0.0)
    seen *= share * np.radians(degrees) / np.abs(seen).max()
    for step in (0.0, STEP):
        assert find_clipping(step * np.round(seen / step) if step else seen, "gyro", step) == []


@pytest.mark.parametrize("seed", range(8))
def test_a_noisy_peak_that_happens_to_reach_a_usual_full_scale_is_none(seed):
    """Noise makes many visits of the band about the full scale, and steps of 0.01 deg/s left its neighbours empty."""
    seen = np.radians(125.0) * np.sin(2.0 * np.pi * 0.2 * np.arange(30000) / RATE)
    seen += np.radians(0.2) * np.random.default_rng(seed).standard_normal(len(seen))
    step = np.radians(0.01)
    assert find_clipping(step * np.round(seen / step), "gyro", step) == []


def test_values_held_between_slow_updates_are_not_clipped():
    slow = motion(3)[::10]
    for step in (0.0, STEP):
        seen = np.repeat(step * np.round(slow / step) if step else slow, 10)
        assert find_clipping(seen, "gyro", step) == []


@pytest.mark.parametrize("degrees", [250.0, 500.0, 2000.0])
def test_a_usual_full_scale_is_named_also_behind_the_filters_on_board(degrees):
    full = np.radians(degrees)
    share = 1.0 - np.exp(-2 * np.pi * 250.0 / RATE)
    true = motion(1, 0.5 * full)
    seen = lfilter([share], [1.0, share - 1.0], np.clip(true, -full, full))
    found = find_clipping(STEP * np.round(seen / STEP), "gyro", STEP)
    assert {end.full_scale for end in found} == {full}
    beyond = np.abs(true) > full
    where = np.any([end.where for end in found], axis=0)
    assert (where & beyond).sum() > 0.8 * beyond.sum()


def test_the_accelerometer_in_hover_and_at_its_range():
    rng = np.random.default_rng(2)
    hover = -9.81 + 0.3 * rng.standard_normal(20000)
    assert find_clipping(hover, "accelerometer", 9.81 / 2048) == []
    jolts = hover - 60.0 * np.exp(-((np.arange(20000) % 4000 - 2000.0) ** 2) / 200.0)
    (end,) = find_clipping(np.maximum(jolts, -39.24), "accelerometer", 9.81 / 2048)
    assert end.level == pytest.approx(-39.24) and end.full_scale == pytest.approx(4 * 9.81)
    assert find_clipping(jolts, "accelerometer", 9.81 / 2048) == []


@pytest.mark.parametrize("values", [np.zeros(0), np.zeros(50), np.full(50, 3.0), np.array([5.0])])
def test_signals_without_motion_are_not_clipped(values):
    assert find_clipping(values, "gyro") == []


@pytest.fixture(scope="module")
def flown():
    return move(seconds=12.0, seed=4)


@pytest.mark.parametrize(("channel", "limit"), [("q", 6.0), ("p", 2.0)])
def test_the_filter_names_a_clipped_channel_marks_it_and_keeps_its_states(flown, channel, limit):
    frame, metadata = measure(flown)
    before = frame[channel].to_numpy(copy=True)
    frame[channel] = frame[channel].clip(-limit, limit)
    result = filter_flight(frame, metadata, quadrotor(), {})
    said = [n for n in result.metadata["notes"] if f"'{channel}' is saturated at" in n]
    assert said and "first from t = " in said[0]
    beyond = np.abs(before) > limit
    table = result.with_gravity
    assert beyond.sum() > 20 and table["valid"][beyond].max() == 0 and np.isfinite(table.to_numpy()).all()
    error = np.abs(table[["x", "y", "z"]].to_numpy() - flown.p)
    assert error[600:].max() < 0.02


def test_what_the_import_found_is_believed(flown):
    frame, metadata = measure(flown)
    frame["imu_clipped"] = ((frame["t"] > 7.0) & (frame["t"] < 7.2)).astype(float)
    result = filter_flight(frame, metadata, quadrotor(), {})
    assert any("end of its range in 99 samples, first at t = 7.002 s" in n for n in result.metadata["notes"])
    assert (
        result.with_gravity["valid"][frame["imu_clipped"] > 0].max() == 0 and "imu_clipped" not in result.with_gravity
    )
