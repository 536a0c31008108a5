"""Lag and clock rate against known ones, their standard errors, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from made_motion import at_times, body
from scipy.spatial.transform import Rotation

from quasi.attitude import body_rates
from quasi.errors import DataError, cautions
from quasi.importing.clocks.clock_fit import ClockFit, Uniform, correlation, peaks
from quasi.importing.clocks.synchronisation import Motion, _describe_mix, _turned_between, synchronise
from quasi.importing.onboard_attitude import estimate_attitude

BOTH = ["pitch", "yaw"]


def sides(seed, lag, rate, seconds=30.0, capture_rate=120.0, turned=True, shake=0.05):
    """On-board and capture records with noise; t = tau + lag + rate tau, drop-outs in the capture, axes 0.5 deg off."""
    rng = np.random.default_rng(seed)
    truth = body(seconds, rate=500.0, seed=seed)
    gyro = truth.rates + rng.normal(0, shake, truth.rates.shape) + [0.01, -0.02, 0.015]
    force = truth.force + rng.normal(0, 0.5, truth.force.shape)
    onboard = Motion(truth.t, gyro, force, estimate_attitude(truth.t, gyro, force).quaternion)
    tau = np.arange(int((seconds - 3.0) * capture_rate)) / capture_rate + 3.0
    position, quaternion = at_times(truth, tau + lag + rate * tau)
    wrong = Rotation.from_rotvec(np.radians([0.3, -0.4, 0.2]))
    jitter = Rotation.from_rotvec(rng.normal(0, 0.0015, position.shape))
    quaternion = (Rotation.from_quat(quaternion, scalar_first=True) * wrong * jitter).as_quat(scalar_first=True)
    position = position + rng.normal(0, 2e-4, position.shape)
    for start in rng.integers(0, len(tau) - 30, 5):
        position[start : start + 12] = np.nan
        quaternion[start : start + 12] = np.nan
    return onboard, Motion(tau, quaternion=quaternion if turned else None, position=position)


@pytest.mark.parametrize(("seed", "lag", "rate"), [(1, 2.3456, 4e-5), (2, -2.71, -6e-5), (3, 0.01, 0.0)])
def test_lag_and_clock_rate_are_found_within_their_errors(seed, lag, rate):
    onboard, capture = sides(seed, lag, rate)
    found = synchronise(onboard, capture, BOTH, 25.0, "flight")
    fit = found.fit
    error = fit.to_first(fit.reference) - fit.reference - (lag + rate * fit.reference)
    assert abs(error) < 3e-4
    assert abs(error) < 4 * fit.lag_std
    assert abs(fit.rate - rate) < max(5e-6, 4 * fit.rate_std)
    assert fit.to_other(fit.to_first(capture.t)) == pytest.approx(capture.t, abs=1e-9)


def test_standard_errors_are_honest_over_draws():
    errors = []
    for seed in range(10, 18):
        onboard, capture = sides(seed, 0.8, 2e-5, seconds=20.0)
        fit = synchronise(onboard, capture, BOTH, 5.0, "flight").fit
        true = 0.8 + 2e-5 * fit.reference
        errors.append([(fit.lag - true) / fit.lag_std, (fit.rate - 2e-5) / fit.rate_std])
    ratio = np.sqrt(np.mean(np.square(errors), axis=0))
    # eight draws: chi-square bounds of 99.9 % about 1 are 0.3 to 1.9
    assert (ratio > 0.3).all()
    assert (ratio < 1.9).all()


def test_a_fit_told_from_the_other_side_is_the_same_relation():
    fit = ClockFit(1.5, 2e-3, 40.0, 1e-3, 1e-5, 1.0, {}, 60.0, np.eye(3))
    times = np.linspace(0.0, 100.0, 7)
    assert fit.inverted().to_first(times) == pytest.approx(fit.to_other(times), abs=1e-12)
    assert fit.inverted().to_other(times) == pytest.approx(fit.to_first(times), abs=1e-12)
    assert fit.inverted().inverted().lag == pytest.approx(fit.lag)
    assert fit.inverted().reference == fit.reference + fit.lag


def test_rates_between_frames_are_what_a_coarse_capture_shows():
    truth = body(20.0, rate=1000.0, seed=4)
    frames = np.arange(0.1, 19.9, 1 / 60)
    _, quaternion = at_times(truth, frames)
    seen = body_rates(quaternion, frames)[1:-1]
    like = _turned_between(truth.t, truth.rates, 1 / 60)
    away = [np.interp(frames[1:-1], truth.t, w) - s for w, s in zip(like.T, seen.T)]
    plain = [np.interp(frames[1:-1], truth.t, w) - s for w, s in zip(truth.rates.T, seen.T)]
    assert np.std(away) < 0.25 * np.std(plain)


def test_clocks_that_disagree_by_a_percent_are_still_tied_and_called_for_care():
    onboard, capture = sides(5, 1.0, 0.01)
    found = synchronise(onboard, capture, BOTH, 25.0, "flight")
    assert found.fit.rate == pytest.approx(0.01, abs=5e-6)
    assert any("run apart by 1.0 %, far more than two clocks do" in note for note in cautions(found.notes))
    assert not cautions(synchronise(*sides(5, 1.0, 1e-4), BOTH, 25.0, "flight").notes)


def test_without_captured_attitude_accelerations_tie_the_clocks():
    onboard, capture = sides(6, -1.234, 3e-5, turned=False)
    found = synchronise(onboard, capture, BOTH, 25.0, "flight")
    fit = found.fit
    error = fit.lag - (-1.234 + 3e-5 * fit.reference)
    assert abs(error) < 5e-3
    assert abs(error) < 4 * fit.lag_std
    assert any("no attitude" in n for n in found.notes)


def test_heading_of_the_on_board_attitude_is_tied_to_the_captures():
    onboard, capture = sides(7, 0.5, 0.0)
    turn = Rotation.from_euler("z", 1.1)
    turned = (turn * Rotation.from_quat(onboard.quaternion, scalar_first=True)).as_quat(scalar_first=True)
    first = synchronise(onboard, capture, BOTH, 5.0, "flight").yaw_offset
    second = synchronise(
        Motion(onboard.t, onboard.rates, onboard.specific_force, turned), capture, BOTH, 5.0, "f"
    ).yaw_offset
    assert np.angle(np.exp(1j * (first - second))) == pytest.approx(1.1, abs=0.01)


def repeated(seconds=40.0):
    """A body that does exactly the same every four seconds."""
    t = np.arange(int(seconds * 500)) / 500
    angles = np.stack([0.4 * np.sin(np.pi / 2 * t), 0.3 * np.sin(np.pi * t + 1), 0.2 * np.sin(np.pi / 2 * t + 2)], -1)
    turn = Rotation.from_euler("ZYX", angles)
    rates = np.gradient(np.unwrap(angles[:, ::-1], axis=0), t, axis=0)
    rates = (turn[:-1].inv() * turn[1:]).as_rotvec() * 500
    rates = np.vstack([rates, rates[-1]])
    force = turn.inv().apply([0, 0, -9.81])
    return t, turn.as_quat(scalar_first=True), rates, force


def test_motion_that_repeats_itself_is_refused_with_advice():
    t, q, rates, force = repeated()
    rng = np.random.default_rng(1)
    onboard = Motion(t, rates + rng.normal(0, 0.05, rates.shape), force, q)
    some = slice(6000, 14000, 4)
    capture = Motion(t[some] - t[6000], quaternion=q[some], position=np.stack([np.sin(t[some])] * 3, -1))
    with pytest.raises(DataError, match=r"match alike at lags.*lower 'max permitted lag"):
        synchronise(onboard, capture, BOTH, 25.0, "flight")
    near = Motion(t[some], quaternion=q[some], position=capture.position)
    # rates by forward differences are half a step of 2 ms early
    assert synchronise(onboard, near, BOTH, 1.0, "f", same_clock=True).fit.lag == pytest.approx(-1e-3, abs=1e-4)


def test_a_still_capture_is_refused():
    onboard, capture = sides(8, 0.0, 0.0, seconds=20.0)
    still = Motion(
        capture.t, quaternion=np.tile([1.0, 0, 0, 0], (len(capture.t), 1)), position=np.zeros((len(capture.t), 3))
    )
    with pytest.raises(DataError, match="shows no motion"):
        synchronise(onboard, still, BOTH, 25.0, "flight")


@pytest.mark.parametrize("turned", [True, False])
@pytest.mark.parametrize("seed", [9, 30, 31, 35])
def test_records_of_different_flights_are_refused(seed, turned):
    onboard, _ = sides(seed, 0.0, 0.0, seconds=45.0)
    _, capture = sides(seed + 30, 0.0, 0.0, seconds=25.0, turned=turned)
    with pytest.raises(DataError, match="nowhere like|match alike") as caught:
        synchronise(onboard, capture, BOTH, 25.0, "flight")
    assert "go together" not in str(caught.value)


def test_another_unit_or_other_axes_are_named():
    onboard, capture = sides(3, 0.2, 0.0, turned=False)
    in_g = replace(onboard, specific_force=onboard.specific_force / 9.80665)
    with pytest.raises(DataError, match=r"go together \(9. % explained\) if earth acceleration .* times as large"):
        synchronise(in_g, capture, BOTH, 5.0, "flight")
    onboard, capture = sides(3, 0.2, 0.0)
    yawed = replace(onboard, rates=onboard.rates @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    with pytest.raises(DataError, match=r"turned by (8|9). deg: check units and axes"):
        synchronise(yawed, capture, BOTH, 5.0, "flight")


def test_an_export_with_another_axis_up_is_named():
    onboard, capture = sides(3, 3.2, 0.0, seconds=45.0)
    # x y z of the room and of the body are read as y z x
    w, x, y, z = capture.quaternion.T
    tipped = replace(capture, quaternion=np.stack([w, y, z, x], -1), position=capture.position[:, [1, 2, 0]])
    with pytest.raises(DataError, match=r"go together \(\d+ % explained\) if body rates .* turned by 1[12]\d deg"):
        synchronise(onboard, tipped, BOTH, 25.0, "flight")


def test_attitudes_that_turn_against_each_other_are_not_short():
    onboard, capture = sides(3, 0.0, 0.0)
    mirrored = replace(capture, quaternion=capture.quaternion * np.array([1.0, -1.0, -1.0, -1.0]))
    with pytest.raises(DataError, match="correlate at no lag within 0.1 s"):
        synchronise(onboard, mirrored, BOTH, 0.1, "flight", same_clock=True)


def test_unknown_signal_is_named():
    onboard, capture = sides(8, 0.0, 0.0, seconds=10.0)
    with pytest.raises(DataError, match="cannot align with 'heading'"):
        synchronise(onboard, capture, ["heading"], 5.0, "flight")


def test_correlation_equals_the_plain_sum_over_the_overlap():
    rng = np.random.default_rng(4)
    x, y = rng.normal(size=60).cumsum(), rng.normal(size=40).cumsum()
    gx, gy = rng.random(60) > 0.1, rng.random(40) > 0.1
    lags, found = correlation([(Uniform(5.0, 0.1, x[:, None], gx), Uniform(2.0, 0.1, y[:, None], gy))], 1.5)
    mx, my = x[gx].mean(), y[gy].mean()
    for lag, r in zip(lags, found):
        shift = round((lag + 2.0 - 5.0) / 0.1)
        both = [(i, i - shift) for i in range(60) if 0 <= i - shift < 40 and gx[i] and gy[i - shift]]
        if len(both) * 0.1 < 1.5 - 1e-9:
            assert np.isnan(r)
            continue
        a = np.array([x[i] - mx for i, _ in both])
        b = np.array([y[j] - my for _, j in both])
        va = max(np.sum((a - a.mean()) ** 2), 0.05 * len(both) * np.mean(np.where(gx, x - mx, 0) ** 2))
        vb = max(np.sum((b - b.mean()) ** 2), 0.05 * len(both) * np.mean(np.where(gy, y - my, 0) ** 2))
        assert r == pytest.approx(np.sum((a - a.mean()) * (b - b.mean())) / np.sqrt(va * vb), abs=1e-9)


def test_peaks_are_apart_and_in_order():
    lags = np.arange(-5, 5, 0.01)
    height = np.cos(2 * np.pi * lags) * np.exp(-np.abs(lags) / 5)
    found = peaks(lags, height, 0.4)
    assert found[0][0] == pytest.approx(0.0, abs=0.01)
    assert sorted(abs(lag) for lag, _ in found[1:3]) == pytest.approx([1.0, 1.0], abs=0.02)


def test_a_match_beyond_the_lag_limit_is_named_with_its_lag():
    onboard, capture = sides(1, 4.0, 0.0)
    # the records begin 3 s apart: the lag counts from there, and is 7 s
    try:
        words = " ".join(synchronise(onboard, capture, BOTH, 2.0, "flight").notes)
    except DataError as error:
        words = str(error)
    assert "beyond the limit of 2 s" in words
    assert "at +7.0" in words
    assert "'max permitted lag for optitrack'" in words
    within = synchronise(onboard, capture, BOTH, 25.0, "flight")
    assert not any("beyond the limit" in note for note in within.notes)


@pytest.mark.parametrize(("size", "degrees", "explained", "named"), [
    (0.59, 22.0, 0.42, False), (0.59, 22.0, 0.97, True), (0.9, 90.0, 0.42, True),
])  # fmt: skip
def test_a_scale_that_the_noise_of_the_capture_explains_is_not_named(size, degrees, explained, named):
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    clock = ClockFit(0.0, 0.0, 0.0, 0.01, 0.0, explained, {}, 20.0, size * turn)
    assert bool(_describe_mix([clock], "body rates", np.ones(3), True)) == named
