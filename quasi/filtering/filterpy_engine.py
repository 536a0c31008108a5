"""The forward pass with filterpy's ExtendedKalmanFilter: the model of quasi.filtering.ekf in explicit matrices.

The filter's state is the error state, zero except between an update and the moment it is moved into the nominal state;
the nominal state (with the quaternion) stays outside and is carried by the compiled integration. Every step is one
`predict`, every measurement one `update`; a measurement that the gate rejects is an `update` without a value.
The result is that of `ekf.forward` to rounding, so that the smoother runs on either.
"""

import numpy as np

from quasi import attitude
from quasi.filtering.ekf import (
    MEASUREMENT_KINDS,
    STATES,
    TAIL,
    WORK_SHAPE,
    FilterResult,
    Inputs,
    Watch,
    innovation,
    predict,
)

_LOWER = np.tril_indices(STATES)


def transition(blocks: np.ndarray, dt: float) -> np.ndarray:
    """Jacobian (18, 18) of a step, of the blocks (5, 3, 3) that `ekf.predict` leaves."""
    F = np.eye(STATES)
    F[0:3, 0:3], F[0:3, 9:12] = blocks[0], blocks[1]
    F[3:6, 0:3], F[3:6, 9:12], F[3:6, 12:15] = blocks[2], blocks[3], blocks[4]
    F[6:9] += 0.5 * dt * F[3:6]
    F[6:9, 3:6] += 0.5 * dt * np.eye(3)
    return F


def _process(F: np.ndarray, noise: np.ndarray, bias_random_walk: np.ndarray, dt: float) -> np.ndarray:
    """Covariance (18, 18) that a step adds: sensor noise enters like a bias that lasts for it."""
    G = F[:, 9:15].copy()
    G[9:15] = 0.0
    Q = (G * noise**2) @ G.T
    Q[range(9, 15), range(9, 15)] += bias_random_walk**2 * dt
    return Q


def _one_by_one(y: np.ndarray, S: np.ndarray, PHt: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The update as three scalar ones: innovations (3,), their variances (3,), gains (3, 18), and whitened (3,).

    With S = L D L' the innovations are inv(L) y with the variances D: each is what the earlier ones do not predict.
    """
    root = np.linalg.cholesky(S)
    white = np.linalg.solve(root, y)
    size = np.diag(root)
    return white * size, size**2, np.linalg.solve(root, PHt.T) / size[:, None], white


def forward(inputs: Inputs, watch: Watch | None = None) -> FilterResult:
    """Filter forward in time; the same result as `ekf.forward`, some fifty times slower.

    watch  hands on the numbers of the samples one by one and may report progress (`joblog.progress`)
    """
    from filterpy.kalman import ExtendedKalmanFilter  # a second to import, for nothing else

    n, dt = len(inputs.gyro), float(inputs.dt)
    q, x = inputs.quaternion.copy(), inputs.state.copy()
    error = ExtendedKalmanFilter(STATES, 3)
    error.x, error.P = np.zeros(STATES), inputs.covariance.copy()
    Q, X, C = np.empty((n, 4)), np.empty((n, 15)), np.empty((n, len(_LOWER[0])))
    whitened, outcome = np.full((n, 3, 3), np.nan), np.zeros((n, 3), np.int8)
    rows: list[np.ndarray] = []
    first_row = np.zeros(n + 1, np.int64)
    rejected = np.zeros(3, np.int64)
    cost = 0.0
    blocks, work = np.empty((5, 3, 3)), np.empty(WORK_SHAPE)
    for k in watch(range(n), "filtering samples") if watch else range(n):
        if k > 0:
            predict(q, x, inputs.gyro, inputs.accel, k - 1, dt, blocks, work)
            error.F = transition(blocks, dt)
            error.Q = _process(error.F, inputs.noise[k], inputs.bias_random_walk, dt)
            error.predict()
        for kind in range(len(MEASUREMENT_KINDS)):
            if inputs.used[k, kind] == 0:
                continue
            y, one, two, first, second = innovation(inputs, kind, k, q, x)
            H = np.zeros((3, STATES))
            H[:, first : first + 3] += one
            H[:, second : second + 3] += two
            R = np.diag(inputs.std[kind] ** 2)
            PHt = error.P @ H.T
            S = H @ PHt + R
            left, variance, gains, white = _one_by_one(y, S, PHt)
            nis = float(white @ white)
            cost += nis if nis <= inputs.gate else inputs.gate + TAIL * np.log(nis / inputs.gate)
            cost += float(np.sum(np.log(variance)))
            rejected[kind] = 0 if nis <= inputs.gate else rejected[kind] + 1
            result = 1 if nis <= inputs.gate else 3 if rejected[kind] > inputs.max_rejections[kind] else 2
            whitened[k, kind], outcome[k, kind] = white, result
            # the innovation is that of the nominal state: the error state is expected to be zero
            error.update(None if result == 2 else y, lambda _, H=H: H, lambda d, H=H: H @ d, R=R)
            if result == 2:
                continue
            for r in range(3):
                rows.append(np.concatenate([[left[r], variance[r], first, second], one[r], two[r], gains[r]]))
            q = attitude.normalise(attitude.multiply(q, attitude.exponential(error.x[:3])))
            x += error.x[3:]
            error.x = np.zeros(STATES)
        first_row[k + 1] = len(rows)
        Q[k], X[k], C[k] = q, x, error.P[_LOWER]
    kept = np.array(rows) if rows else np.empty((0, 10 + STATES))
    return FilterResult(Q, X, C, whitened, outcome, cost, kept, first_row)
