"""The clock's doubt in the standard errors: a shifted capture errs by what is claimed."""

import numpy as np
import pytest
from rigid_body import measure, move, quadrotor

from quasi.filtering import ekf, timing
from quasi.filtering.flight import filter_flight


def test_doubt_is_least_where_the_lag_was_found_and_grows_with_the_clock_rates():
    t = np.linspace(0.0, 60.0, 7)
    metadata = {
        "start": {"value": 1.0},
        "synchronisation": {"lag": {"value": -2.0, "std": 3e-5, "at capture time": 33.0}, "clock rate": {"std": 1e-6}},
    }
    found = timing.clock_uncertainty(metadata, t)
    assert found[3] == pytest.approx(3e-5)  # 33 s of the capture are 30 s of the grid
    assert found[0] == pytest.approx(np.hypot(3e-5, 3e-5)) and found[6] == pytest.approx(found[0])
    assert not timing.clock_uncertainty({"synchronisation": None}, t).any()


def test_a_capture_that_is_late_errs_by_what_is_claimed():
    motion = move(seconds=20.0, seed=9, loops=False)
    frame, metadata = measure(motion)
    late = 1e-3
    for name in "xyz":
        frame[name] = np.interp(motion.t - late, motion.t, frame[name])
    metadata["synchronisation"] = {"lag": {"value": 0.0, "std": late, "at capture time": 10.0}, "clock rate": {}}
    result = filter_flight(frame, metadata, quadrotor(), {})
    flying = (motion.t > 6.0) & (motion.t < 18.0)
    error = (result.with_gravity[["x", "y", "z"]].to_numpy() - motion.p)[flying]
    claimed = result.convergence[[f"position_std_{a}" for a in "xyz"]].to_numpy()[flying]
    assert 0.7 < np.sqrt(np.mean((error / claimed) ** 2)) < 1.2
    del metadata["synchronisation"]
    claimed = filter_flight(frame, metadata, quadrotor(), {}).convergence["position_std_x"].to_numpy()[flying]
    assert np.sqrt(np.mean((error[:, 0] / claimed) ** 2)) > 2


def test_widening_adds_the_shift_of_velocity_and_position_alone():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(18, 18))
    P = root @ root.T
    q, state = np.array([[1.0, 0, 0, 0]]), rng.normal(size=(1, 15))
    run = ekf.FilterResult(q, state, P[np.tril_indices(18)][None], None, None, 0.0, None, None)
    accel = rng.normal(size=(1, 3))
    inputs = ekf.Inputs(*[None] * 2, accel, *[None] * 13)
    wide = ekf.unpack(timing.widen(run, inputs, np.array([0.01])).covariance)[0]
    shift = np.zeros(18)
    shift[3:6] = accel[0] - state[0, 9:12] + [0, 0, 9.81]
    shift[6:9] = state[0, :3]
    np.testing.assert_allclose(wide, P + 1e-4 * np.outer(shift, shift), atol=1e-12)
