"""Error-state extended Kalman filter of attitude, velocity, position and IMU biases; the forward pass.

Nominal state: attitude quaternion q (Hamilton, body to earth), velocity v and position p (earth NED), gyro bias and
accelerometer bias (body axes; bias = measured - true), and the alignment e of the attitude source (rotation vector from
body axes to the axes whose attitude is measured: q_measured = q exp(e)).
Error state (18): rotation d in body axes (q_true = q exp(d)), then the errors of v, p, the two biases and e, in this
order.

The prediction integrates gyro and accelerometer by the trapezium rule; its Jacobian is that of this very map, and the
noise of a step enters like a bias that lasts for the step. Measurements are worked in one scalar at a time, which
equals the batch update for a diagonal noise covariance and keeps the covariance exactly symmetric.

Sources: Sola, Quaternion kinematics for the error-state Kalman filter, arXiv:1711.02508, 2017, chapters 5-6 (local
angular error); Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, section II (scalar updates);
Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4 (NIS, gating).
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.filtering.ekf_steps import (
    CHUNKS,
    STATES,
    WIDTH,
    WORK_SHAPE,
    compose_rotation,
    measurement_model,
    measurement_update,
    normalised_innovation,
    predict,
    propagate_covariance,
)  # fmt: skip
from quasi.terms.lanes import make_vectors, view_lanes

ATTITUDE_KIND, POSITION_KIND, VELOCITY_KIND = 0, 1, 2  # kinds of measurement
MEASUREMENT_KINDS = ("attitude", "position", "velocity")
TAIL = 4.0  # an outlier costs this times the logarithm of its NIS: more than the 3 by which less noise lowers the rest
Watch = Callable[[Iterable[int], str], Iterable[int]]  # hands on sample numbers, and may report progress
_PACKED = STATES * (STATES + 1) // 2
_ROW = 28  # innovation, its variance, two column numbers, 2 x 3 entries of the measurement row, 18 of the gain


class Inputs(NamedTuple):
    """What one pass needs. N samples on a uniform grid.

    dt            s, grid step
    gyro, accel   (N, 3) as measured, rad/s and m/s2 (specific force), body axes, finite
    noise         (N, 6) standard deviation per sample of gyro and accelerometer
    bias_random_walk          (6,) random bias_random_walk of the biases: rad/s and m/s2 per square root of a second
    used          (N, 3) int8, 1 where a measurement of attitude, position, velocity is to be used
    attitude      (N, 4) measured quaternion; position (N, 3) m, earth; velocity (N, 3) m/s
    body          True where `velocity` is in body axes, False where in earth axes
    std           (3, 3) standard deviations of attitude (rad, about the three axes), position (m), velocity (m/s)
    gate          normalised innovation squared (3 degrees of freedom) above which a measurement is an outlier
    max_rejections      rejected measurements in a row, per kind, after which the filter gives in and takes them
    quaternion, state, covariance   at the first sample: (4,), (15,) = v p bg ba e, (18, 18) of the error state
    """

    dt: float
    gyro: np.ndarray
    accel: np.ndarray
    noise: np.ndarray
    bias_random_walk: np.ndarray
    used: np.ndarray
    attitude: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    body: bool
    std: np.ndarray
    gate: float
    max_rejections: np.ndarray
    quaternion: np.ndarray
    state: np.ndarray
    covariance: np.ndarray


class FilterResult(NamedTuple):
    """Result of a pass, forward or smoothed.

    quaternion (N, 4), state (N, 15) = v p bg ba e; covariance (N, 171), lower triangles of the 18 x 18 error covariance
    whitened    (N, 3, 3) innovations over their standard deviation, one by one, per kind; NaN where there was none
    outcome     (N, 3) int8: 0 no measurement, 1 used, 2 rejected by the gate, 3 used because rejections went on
    cost        minus twice the log likelihood of the innovations, up to a constant, with a heavy tail beyond the gate
    rows, first   what the smoother needs of each scalar update, and the number of the first one of each sample (N + 1)
    """

    quaternion: np.ndarray
    state: np.ndarray
    covariance: np.ndarray
    whitened: np.ndarray
    outcome: np.ndarray
    cost: float
    rows: np.ndarray
    first: np.ndarray


@njit(cache=True, error_model="numpy")
def _forward(
    dt,
    gyro,
    accel,
    noise,
    bias_random_walk,
    used,
    attitude,
    position,
    velocity,
    body,
    std,
    gate,
    max_rejections,
    q0,
    x0,
    P0,
    keep,
    room,
    C,
    rows,
):
    n = gyro.shape[0]
    kept = n if keep else 0
    Q = np.empty((kept, 4))
    X = np.empty((kept, 15))
    whitened = np.full((kept, 3, 3), np.nan)
    outcome = np.zeros((kept, 3), np.int8)
    first_row = np.zeros(kept + 1, np.int64)
    q, x = q0.copy(), x0.copy()
    P_vectors, T_vectors, s_vectors = room[: STATES * CHUNKS], room[STATES * CHUNKS : -CHUNKS], room[-CHUNKS:]
    P, T, s = P_vectors.reshape((STATES, WIDTH)), T_vectors.reshape((9, WIDTH)), s_vectors.reshape(WIDTH)
    P_rows, T_rows, s_rows = view_lanes(P_vectors), view_lanes(T_vectors), view_lanes(s_vectors)
    room[:] = 0.0
    for i in range(STATES):
        for j in range(STATES):
            P[i, j] = P0[i, j]
    blocks = np.empty((5, 3, 3))
    work = np.empty(WORK_SHAPE)
    y, var = np.empty(3), np.empty(3)
    H_first = np.empty((3, 3))
    H_second = np.empty((3, 3))
    delta = np.empty(STATES)
    rejected = np.zeros(3, np.int64)
    cost = 0.0
    count = np.int64(0)  # as a literal it would be a type of its own, for which the update is compiled again
    for k in range(n):
        if k > 0:
            predict(q, x, gyro, accel, k - 1, dt, blocks, work)
            propagate_covariance(P, P_rows, blocks, dt, noise, k, bias_random_walk, T, T_rows)
        for kind in range(3):
            if used[k, kind] == 0:
                continue
            first, second = measurement_model(
                kind, k, q, x, attitude, position, velocity, body, y, H_first, H_second, work
            )
            for i in range(3):
                var[i] = std[kind, i] * std[kind, i]
            e0, e1, e2, log_det = normalised_innovation(P, y, var, first, H_first, second, H_second, work)
            nis = e0 * e0 + e1 * e1 + e2 * e2
            cost += (nis if nis <= gate else gate + TAIL * np.log(nis / gate)) + log_det
            result = 1
            if nis <= gate:
                rejected[kind] = 0
            else:
                rejected[kind] += 1
                result = 3 if rejected[kind] > max_rejections[kind] else 2
            if keep:
                whitened[k, kind, 0], whitened[k, kind, 1], whitened[k, kind, 2] = e0, e1, e2
                outcome[k, kind] = result
            if result == 2:
                continue
            measurement_update(P_rows, y, var, first, H_first, second, H_second, delta, s, s_rows, rows, count)
            if keep:
                count += 3
            compose_rotation(q, delta[0], delta[1], delta[2])
            for i in range(15):
                x[i] += delta[3 + i]
        if keep:
            first_row[k + 1] = count
            for i in range(4):
                Q[k, i] = q[i]
            for i in range(15):
                X[k, i] = x[i]
            c = 0
            for i in range(STATES):
                for j in range(i + 1):
                    C[k, c] = P[i, j]
                    c += 1
    return Q, X, C, whitened, outcome, cost, rows, first_row


def _run(inputs: Inputs, keep: bool) -> tuple:
    # vectors of the covariance, of nine rows of its product with the Jacobian, and of one row
    room = make_vectors((STATES + 9 + 1) * CHUNKS)
    # NumPy asks the kernel for large pages; arrays made in compiled code spend half the pass on page faults
    covariance = np.empty((len(inputs.gyro) if keep else 0, _PACKED))
    rows = np.empty((3 * int(inputs.used.sum()) if keep else 0, _ROW))
    return _forward(*inputs, keep, room, covariance, rows)


def innovation(inputs: Inputs, kind: int, k: int, q: np.ndarray, x: np.ndarray):
    """Measured minus expected (3,) of one kind at sample k, its Jacobian's two 3 x 3 blocks and their first columns.

    q (4,), x (15,)  nominal state. Where a kind has a single block, the second is zero.
    """
    y, H_first, H_second = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    first, second = measurement_model(
        kind,
        k,
        q,
        x,
        inputs.attitude,
        inputs.position,
        inputs.velocity,
        inputs.body,
        y,
        H_first,
        H_second,
        np.empty(WORK_SHAPE),
    )
    return y, H_first, H_second, first, second


def forward(inputs: Inputs) -> FilterResult:
    """Filter forward in time; every sample's estimate uses the samples up to it."""
    return FilterResult(*_run(inputs, True))


def cost(inputs: Inputs) -> float:
    """`FilterResult.cost` alone, without keeping anything: for the choice of noise levels."""
    return _run(inputs, False)[5]


def unpack(packed: np.ndarray) -> np.ndarray:
    """Symmetric matrices (..., 18, 18) of lower triangles (..., 171)."""
    rows, columns = np.tril_indices(STATES)
    full = np.empty((*packed.shape[:-1], STATES, STATES))
    full[..., rows, columns] = packed
    full[..., columns, rows] = packed
    return full


def deviations(packed: np.ndarray) -> np.ndarray:
    """Standard deviations (..., 18) of lower triangles (..., 171)."""
    diagonal = np.cumsum(np.arange(1, STATES + 1)) - 1
    return np.sqrt(np.maximum(packed[..., diagonal], 0.0))
