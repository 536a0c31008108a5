"""The engine "filterpy": really filterpy's filter, and the compiled engine's results to rounding."""

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from rigid_body import measure, move, quadrotor
from test_ekf import inputs_of

from quasi import attitude
from quasi.errors import ConfigError
from quasi.filtering import ekf, filterpy_engine
from quasi.filtering.flight import filter_flight
from quasi.filtering.smoother import smooth


@pytest.fixture(scope="module")
def inputs():
    """A flight with loops, a gap of 2 s in the capture, outliers, a shift that forces the gate open, and velocity."""
    motion = move(seconds=11.0, rest=1.0, seed=2, size=0.3)
    frame = measure(motion, rest=1.0)[0]
    made = inputs_of(motion, frame, gate=25.0, max_rejections=np.array([20, 20, 20]))
    used, position = made.used.copy(), made.position.copy()
    used[::7, ekf.VELOCITY_KIND] = 1
    used[3600:4600] = 0
    position[np.flatnonzero(used[:, ekf.POSITION_KIND])[100:700:60]] += 0.3
    position[5000:] += 0.5
    pitch = np.abs(attitude.to_euler(motion.q)[:, 1])
    assert np.degrees(pitch.max()) > 89.5
    return made._replace(used=used, position=position)


@pytest.fixture(scope="module")
def passes(inputs):
    return ekf.forward(inputs), filterpy_engine.forward(inputs)


def scaled(covariance, other):
    """Greatest difference of two packed covariances (N, 171), entries over the standard deviations of their row and
    column."""
    a, b = ekf.unpack(covariance), ekf.unpack(other)
    size = np.sqrt(np.einsum("kii->ki", a))
    return np.max(np.abs(a - b) / (size[:, :, None] * size[:, None, :]))


def test_equals_the_compiled_filter(inputs, passes):
    compiled, through = passes
    assert set(np.unique(compiled.outcome)) == {0, 1, 2, 3}
    np.testing.assert_array_equal(through.outcome, compiled.outcome)
    np.testing.assert_allclose(through.quaternion, compiled.quaternion, atol=1e-9, rtol=0)
    np.testing.assert_allclose(through.state, compiled.state, atol=1e-9, rtol=0)
    assert scaled(compiled.covariance, through.covariance) < 1e-9
    assert np.abs(through.covariance - compiled.covariance).max() < 1e-9
    assert through.cost == pytest.approx(compiled.cost, rel=1e-9)


def test_smoother_runs_on_its_pass(inputs, passes):
    compiled, through = (smooth(inputs, run) for run in passes)
    np.testing.assert_array_equal(passes[1].first, passes[0].first[: len(passes[1].first)])
    np.testing.assert_allclose(through.quaternion, compiled.quaternion, atol=1e-9, rtol=0)
    np.testing.assert_allclose(through.state, compiled.state, atol=1e-8, rtol=0)
    # near the start the smoothed variance is a millionth of the filter's, and that many digits go
    assert scaled(compiled.covariance[200:], through.covariance[200:]) < 1e-6


def test_predict_and_update_are_called_for_every_sample_and_measurement(inputs, monkeypatch):
    calls = {"predict": 0, "update": 0, "without a value": 0}
    predict, update = ExtendedKalmanFilter.predict, ExtendedKalmanFilter.update

    def counted_predict(self, *args, **kwargs):
        calls["predict"] += 1
        return predict(self, *args, **kwargs)

    def counted_update(self, z, *args, **kwargs):
        calls["update"] += 1
        calls["without a value"] += z is None
        return update(self, z, *args, **kwargs)

    monkeypatch.setattr(ExtendedKalmanFilter, "predict", counted_predict)
    monkeypatch.setattr(ExtendedKalmanFilter, "update", counted_update)
    part = inputs._replace(gyro=inputs.gyro[:2500], used=inputs.used[:2500])
    run = filterpy_engine.forward(part)
    assert calls["predict"] == len(part.gyro) - 1  # the first sample is where the filter starts
    assert calls["update"] == part.used.sum()
    assert calls["without a value"] == (run.outcome == 2).sum() > 0


def test_a_flight_is_filtered_alike_by_either_engine():
    made = measure(move(seconds=8.0, rest=2.0, seed=2), rest=2.0)
    options = {"re-estimate noise": False}
    compiled = filter_flight(*made, quadrotor(), options)
    through = filter_flight(*made, quadrotor(), {**options, "engine": "filterpy"})
    assert compiled.metadata["engine"] == "compiled" and through.metadata["engine"].startswith("filterpy 2")
    np.testing.assert_allclose(through.with_gravity, compiled.with_gravity, atol=1e-6, rtol=1e-8)
    with pytest.raises(ConfigError, match="'engine' is 'matlab', expected one of 'compiled', 'filterpy'"):
        filter_flight(*made, quadrotor(), {"engine": "matlab"})


def test_its_progress_can_be_watched_sample_by_sample(inputs):
    part = inputs._replace(gyro=inputs.gyro[:60])
    seen = []

    def watch(samples, what):
        assert what == "filtering samples"
        for k in samples:
            seen.append(k)
            yield k

    watched, alone = filterpy_engine.forward(part, watch), filterpy_engine.forward(part)
    assert seen == list(range(60))
    np.testing.assert_array_equal(watched.covariance, alone.covariance)
