"""Doubts about the capture in the standard errors: a shifted clock or point errs by what is claimed."""

import numpy as np
import pytest
from rigid_body import measure, move, quadrotor

from quasi import attitude
from quasi.filtering import capture_doubt, ekf
from quasi.filtering.flight import filter_flight


def test_doubt_is_least_where_the_lag_was_found_and_grows_with_the_clock_rates():
    t = np.linspace(0.0, 60.0, 7)
    metadata = {
        "start": {"value": 1.0},
        "synchronisation": {"lag": {"value": -2.0, "std": 3e-5, "at capture time": 33.0}, "clock rate": {"std": 1e-6}},
    }
    found = capture_doubt.clock_uncertainty(metadata, t)
    assert found[3] == pytest.approx(3e-5)  # 33 s of the capture are 30 s of the grid
    assert found[0] == pytest.approx(np.hypot(3e-5, 3e-5)) and found[6] == pytest.approx(found[0])
    assert not capture_doubt.clock_uncertainty({"synchronisation": None}, t).any()


def test_a_capture_that_is_late_errs_by_what_is_claimed():
    motion = move(seconds=14.0, seed=9, loops=False)
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


def test_a_point_that_lies_elsewhere_is_found_and_velocities_err_by_what_is_claimed():
    motion = move(seconds=14.0, seed=9, loops=False)
    frame, metadata = measure(motion)
    turn = attitude.from_euler(*frame[["roll", "pitch", "yaw"]].to_numpy().T)
    flying = (motion.t > 6.0) & (motion.t < 18.0)
    lever = np.array([0.012, -0.02, 0.008])
    for sign in (1.0, -1.0):
        moved = frame.copy()
        moved[["x", "y", "z"]] += attitude.rotate(turn, np.broadcast_to(sign * lever, (len(frame), 3)))
        result = filter_flight(moved, metadata, quadrotor(), {})
        found = [result.metadata["captured point"][a] for a in "xyz"]
        apart = (np.array([f["value"] for f in found]) - sign * lever) / [f["std"] for f in found]
        assert np.abs(apart).max() < 4.0
        assert all(f["std"] < 2e-3 for f in found)
        error = (attitude.rotate(motion.q, result.with_gravity[["u", "v", "w"]].to_numpy()) - motion.v)[flying]
        claimed = result.convergence[[f"velocity_std_{a}" for a in "xyz"]].to_numpy()[flying]
        assert 0.5 < np.sqrt(np.mean((error / claimed) ** 2)) < 1.2
    found = filter_flight(frame, metadata, quadrotor(), {}).metadata["captured point"]
    assert all(abs(found[a]["value"]) < 4.0 * found[a]["std"] for a in "xyz")


def test_widening_adds_the_shifts_of_velocity_and_position_alone():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(18, 18))
    P = root @ root.T
    q, state = np.array([[1.0, 0, 0, 0]]), rng.normal(size=(1, 15))
    run = ekf.FilterResult(q, state, P[np.tril_indices(18)][None], None, None, 0.0, None, None)
    gyro, accel = rng.normal(size=(2, 1, 3))
    inputs = ekf.Inputs(None, gyro, accel, *[None] * 13)
    clock = capture_doubt.clock_shift(run, inputs, np.array([0.01]))
    point = capture_doubt.lever_shift(run, inputs, np.array([0.0, 0.0, 0.1]))
    expected = np.zeros((2, 18))
    expected[0, 3:6] = 0.01 * (accel[0] - state[0, 9:12] + [0, 0, 9.81])
    expected[0, 6:9] = 0.01 * state[0, :3]
    p, q, _ = gyro[0] - state[0, 6:9]
    expected[1, 3:6] = [0.1 * q, -0.1 * p, 0.0]
    wide = ekf.unpack(capture_doubt.widen(run, [clock, point]).covariance)[0]
    np.testing.assert_allclose(wide, P + expected.T @ expected, atol=1e-12)
