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

from quasi.attitude import GRAVITY

STATES = 18
ATTITUDE, POSITION, VELOCITY = 0, 1, 2  # kinds of measurement
KINDS = ("attitude", "position", "velocity")
TAIL = 4.0  # an outlier costs this times the logarithm of its NIS: more than the 3 by which less noise lowers the rest
Watch = Callable[[Iterable[int], str], Iterable[int]]  # hands on sample numbers, and may report progress
_PACKED = STATES * (STATES + 1) // 2
_ROW = 28  # innovation, its variance, two column numbers, 2 x 3 entries of the measurement row, 18 of the gain


class Inputs(NamedTuple):
    """What one pass needs. N samples on a uniform grid.

    dt            s, grid step
    gyro, accel   (N, 3) as measured, rad/s and m/s2 (specific force), body axes, finite
    noise         (N, 6) standard deviation per sample of gyro and accelerometer
    walk          (6,) random walk of the biases: rad/s and m/s2 per square root of a second
    used          (N, 3) int8, 1 where a measurement of attitude, position, velocity is to be used
    attitude      (N, 4) measured quaternion; position (N, 3) m, earth; velocity (N, 3) m/s
    body          True where `velocity` is in body axes, False where in earth axes
    std           (3, 3) standard deviations of attitude (rad, about the three axes), position (m), velocity (m/s)
    gate          normalised innovation squared (3 degrees of freedom) above which a measurement is an outlier
    patience      rejected measurements in a row, per kind, after which the filter gives in and takes them
    quaternion, state, covariance   at the first sample: (4,), (15,) = v p bg ba e, (18, 18) of the error state
    """

    dt: float
    gyro: np.ndarray
    accel: np.ndarray
    noise: np.ndarray
    walk: np.ndarray
    used: np.ndarray
    attitude: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    body: bool
    std: np.ndarray
    gate: float
    patience: np.ndarray
    quaternion: np.ndarray
    state: np.ndarray
    covariance: np.ndarray


class Pass(NamedTuple):
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


@njit(cache=True)
def _matrix(q, m):
    w, x, y, z = q[0], q[1], q[2], q[3]
    m[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    m[0, 1] = 2.0 * (x * y - w * z)
    m[0, 2] = 2.0 * (x * z + w * y)
    m[1, 0] = 2.0 * (x * y + w * z)
    m[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    m[1, 2] = 2.0 * (y * z - w * x)
    m[2, 0] = 2.0 * (x * z - w * y)
    m[2, 1] = 2.0 * (y * z + w * x)
    m[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@njit(cache=True)
def _exponential(x, y, z, q):
    angle = np.sqrt(x * x + y * y + z * z)
    s = 0.5 - angle * angle / 48.0 if angle < 1e-4 else np.sin(0.5 * angle) / angle
    q[0], q[1], q[2], q[3] = np.cos(0.5 * angle), s * x, s * y, s * z


@njit(cache=True)
def _turn(q, x, y, z, step):
    """q becomes q exp(x, y, z), of unit length; `step` (4,) is left holding the exponential."""
    _exponential(x, y, z, step)
    w = q[0] * step[0] - q[1] * step[1] - q[2] * step[2] - q[3] * step[3]
    a = q[0] * step[1] + q[1] * step[0] + q[2] * step[3] - q[3] * step[2]
    b = q[0] * step[2] - q[1] * step[3] + q[2] * step[0] + q[3] * step[1]
    c = q[0] * step[3] + q[1] * step[2] - q[2] * step[1] + q[3] * step[0]
    n = 1.0 / np.sqrt(w * w + a * a + b * b + c * c)
    q[0], q[1], q[2], q[3] = w * n, a * n, b * n, c * n


@njit(cache=True)
def predict(q, x, gyro0, gyro1, accel0, accel1, dt, blocks, work):
    """Carry the nominal state (q, x) in place over one step; write the Jacobian's blocks.

    blocks (5, 3, 3): d rotation / d rotation, d rotation / d gyro bias, d velocity / d rotation, / d gyro bias,
    / d accelerometer bias. Position rows are dt/2 times (old + new) velocity rows. work (4, 3, 3) scratch.
    """
    r0, r1, cross0, cross1 = work[0], work[1], work[2], work[3]
    half = 0.5 * dt
    phi = np.empty(3)
    f0 = np.empty(3)
    f1 = np.empty(3)
    for i in range(3):
        phi[i] = (0.5 * (gyro0[i] + gyro1[i]) - x[6 + i]) * dt
        f0[i] = accel0[i] - x[9 + i]
        f1[i] = accel1[i] - x[9 + i]
    _matrix(q, r0)
    step = np.empty(4)
    _turn(q, phi[0], phi[1], phi[2], step)
    _matrix(q, r1)
    for i in range(3):
        old = x[i]
        force = r0[i, 0] * f0[0] + r0[i, 1] * f0[1] + r0[i, 2] * f0[2]
        force += r1[i, 0] * f1[0] + r1[i, 1] * f1[1] + r1[i, 2] * f1[2]
        x[i] = old + half * force
        if i == 2:
            x[i] += dt * GRAVITY
        x[3 + i] += half * (old + x[i])
        # R [f]x, row by row
        cross0[i, 0] = r0[i, 1] * f0[2] - r0[i, 2] * f0[1]
        cross0[i, 1] = r0[i, 2] * f0[0] - r0[i, 0] * f0[2]
        cross0[i, 2] = r0[i, 0] * f0[1] - r0[i, 1] * f0[0]
        cross1[i, 0] = r1[i, 1] * f1[2] - r1[i, 2] * f1[1]
        cross1[i, 1] = r1[i, 2] * f1[0] - r1[i, 0] * f1[2]
        cross1[i, 2] = r1[i, 0] * f1[1] - r1[i, 1] * f1[0]
    turned, lean = blocks[0], blocks[1]
    _matrix(step, lean)
    for i in range(3):
        for j in range(3):
            turned[i, j] = lean[j, i]
    # right Jacobian of the rotation: (I - (1 - cos a)/a2 [phi]x + (a - sin a)/a3 [phi]x[phi]x)
    square = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    if square < 1e-4:
        one = 0.5 - square / 24.0
        two = 1.0 / 6.0 - square / 120.0
    else:
        angle = np.sqrt(square)
        one = (1.0 - np.cos(angle)) / square
        two = (angle - np.sin(angle)) / (square * angle)
    for i in range(3):
        for j in range(3):
            lean[i, j] = -dt * two * phi[i] * phi[j]
        lean[i, i] -= dt * (1.0 - two * square)
    lean[0, 1] -= dt * one * phi[2]
    lean[0, 2] += dt * one * phi[1]
    lean[1, 0] += dt * one * phi[2]
    lean[1, 2] -= dt * one * phi[0]
    lean[2, 0] -= dt * one * phi[1]
    lean[2, 1] += dt * one * phi[0]
    for i in range(3):
        for j in range(3):
            by_turn = 0.0
            by_gyro = 0.0
            for k in range(3):
                by_turn += cross1[i, k] * turned[k, j]
                by_gyro += cross1[i, k] * lean[k, j]
            blocks[2, i, j] = -half * (cross0[i, j] + by_turn)
            blocks[3, i, j] = -half * by_gyro
            blocks[4, i, j] = -half * (r0[i, j] + r1[i, j])


@njit(cache=True)
def _spread(P, blocks, dt, noise, walk, T):
    """P becomes F P F' + Q in place. noise, walk (6,); T (9, 18) scratch."""
    half = 0.5 * dt
    for i in range(3):
        d0, d1, d2 = blocks[0, i, 0], blocks[0, i, 1], blocks[0, i, 2]
        g0, g1, g2 = blocks[1, i, 0], blocks[1, i, 1], blocks[1, i, 2]
        for j in range(STATES):
            T[i, j] = d0 * P[0, j] + d1 * P[1, j] + d2 * P[2, j] + g0 * P[9, j] + g1 * P[10, j] + g2 * P[11, j]
        d0, d1, d2 = blocks[2, i, 0], blocks[2, i, 1], blocks[2, i, 2]
        g0, g1, g2 = blocks[3, i, 0], blocks[3, i, 1], blocks[3, i, 2]
        a0, a1, a2 = blocks[4, i, 0], blocks[4, i, 1], blocks[4, i, 2]
        for j in range(STATES):
            change = d0 * P[0, j] + d1 * P[1, j] + d2 * P[2, j] + g0 * P[9, j] + g1 * P[10, j] + g2 * P[11, j]
            change += a0 * P[12, j] + a1 * P[13, j] + a2 * P[14, j]
            T[3 + i, j] = P[3 + i, j] + change
            T[6 + i, j] = P[6 + i, j] + dt * P[3 + i, j] + half * change
    for i in range(9):
        for j in range(9, STATES):
            P[i, j] = T[i, j]
            P[j, i] = T[i, j]
    # the noise of the step acts like an extra bias variance in the products below
    for b in range(3):
        gyro = noise[b] * noise[b]
        accel = noise[3 + b] * noise[3 + b]
        for i in range(3):
            T[i, 9 + b] += blocks[1, i, b] * gyro
            T[3 + i, 9 + b] += blocks[3, i, b] * gyro
            T[6 + i, 9 + b] += half * blocks[3, i, b] * gyro
            T[3 + i, 12 + b] += blocks[4, i, b] * accel
            T[6 + i, 12 + b] += half * blocks[4, i, b] * accel
    for i in range(9):
        t = T[i]
        for a in range(3):
            if a <= i:
                value = 0.0
                for b in range(3):
                    value += t[b] * blocks[0, a, b] + t[9 + b] * blocks[1, a, b]
                P[i, a] = value
                P[a, i] = value
            if i >= 3:
                change = 0.0
                for b in range(3):
                    change += t[b] * blocks[2, a, b] + t[9 + b] * blocks[3, a, b] + t[12 + b] * blocks[4, a, b]
                if 3 + a <= i:
                    value = t[3 + a] + change
                    P[i, 3 + a] = value
                    P[3 + a, i] = value
                if 6 + a <= i:
                    value = t[6 + a] + dt * t[3 + a] + half * change
                    P[i, 6 + a] = value
                    P[6 + a, i] = value
    for b in range(6):
        P[9 + b, 9 + b] += walk[b] * walk[b] * dt


@njit(cache=True)
def _observe(kind, k, q, x, attitude, position, velocity, body, y, one, two, work):
    """Innovation y (3,) and the two 3 x 3 blocks of the measurement matrix; returns their first columns."""
    one[:] = 0.0
    two[:] = 0.0
    if kind == 0:
        expected = np.empty(4)
        step = np.empty(4)
        expected[:] = q
        _turn(expected, x[12], x[13], x[14], step)
        m = attitude[k]
        w = expected[0] * m[0] + expected[1] * m[1] + expected[2] * m[2] + expected[3] * m[3]
        a = expected[0] * m[1] - expected[1] * m[0] - expected[2] * m[3] + expected[3] * m[2]
        b = expected[0] * m[2] + expected[1] * m[3] - expected[2] * m[0] - expected[3] * m[1]
        c = expected[0] * m[3] - expected[1] * m[2] + expected[2] * m[1] - expected[3] * m[0]
        if w < 0.0:
            w, a, b, c = -w, -a, -b, -c
        s = np.sqrt(a * a + b * b + c * c)
        factor = 2.0 if s < 1e-12 else 2.0 * np.arctan2(s, w) / s
        y[0], y[1], y[2] = factor * a, factor * b, factor * c
        _matrix(step, work)
        for i in range(3):
            for j in range(3):
                one[i, j] = work[j, i]
            two[i, i] = 1.0
        return 0, 15
    if kind == 1:
        for i in range(3):
            y[i] = position[k, i] - x[3 + i]
            one[i, i] = 1.0
        return 6, 0
    if not body:
        for i in range(3):
            y[i] = velocity[k, i] - x[i]
            one[i, i] = 1.0
        return 3, 0
    _matrix(q, work)
    seen = np.empty(3)
    for i in range(3):
        seen[i] = work[0, i] * x[0] + work[1, i] * x[1] + work[2, i] * x[2]
        y[i] = velocity[k, i] - seen[i]
        for j in range(3):
            one[i, j] = work[j, i]
    two[0, 1], two[0, 2], two[1, 2] = -seen[2], seen[1], -seen[0]
    two[1, 0], two[2, 0], two[2, 1] = seen[2], -seen[1], seen[0]
    return 3, 0


@njit(cache=True)
def _gauge(P, y, var, first, one, second, two):
    """Normalised innovation squared of the three together, and the log determinant of their covariance."""
    S = np.empty((3, 3))
    h = np.empty((3, 6))
    for i in range(3):
        for b in range(3):
            h[i, b] = one[i, b]
            h[i, 3 + b] = two[i, b]
    for i in range(3):
        for j in range(i + 1):
            value = 0.0
            for a in range(6):
                row = first + a if a < 3 else second + a - 3
                part = 0.0
                for b in range(6):
                    part += P[row, (first + b if b < 3 else second + b - 3)] * h[j, b]
                value += h[i, a] * part
            S[i, j] = value
        S[i, i] += var[i]
    l00 = np.sqrt(S[0, 0])
    l10 = S[1, 0] / l00
    l20 = S[2, 0] / l00
    l11 = np.sqrt(S[1, 1] - l10 * l10)
    l21 = (S[2, 1] - l20 * l10) / l11
    l22 = np.sqrt(S[2, 2] - l20 * l20 - l21 * l21)
    e0 = y[0] / l00
    e1 = (y[1] - l10 * e0) / l11
    e2 = (y[2] - l20 * e0 - l21 * e1) / l22
    return e0, e1, e2, 2.0 * np.log(l00 * l11 * l22)


@njit(cache=True)
def _absorb(P, y, var, first, one, second, two, delta, s, rows, count):
    """Three scalar updates of P and of the error estimate delta (18,); rows[count...] keep them for the smoother."""
    delta[:] = 0.0
    for r in range(3):
        h0, h1, h2 = one[r, 0], one[r, 1], one[r, 2]
        g0, g1, g2 = two[r, 0], two[r, 1], two[r, 2]
        for j in range(STATES):
            s[j] = (
                h0 * P[first, j]
                + h1 * P[first + 1, j]
                + h2 * P[first + 2, j]
                + g0 * P[second, j]
                + g1 * P[second + 1, j]
                + g2 * P[second + 2, j]
            )
        spread = var[r]
        left = y[r]
        for b in range(3):
            spread += one[r, b] * s[first + b] + two[r, b] * s[second + b]
            left -= one[r, b] * delta[first + b] + two[r, b] * delta[second + b]
        inverse = 1.0 / spread
        for i in range(STATES):
            gain = s[i] * inverse
            delta[i] += gain * left
            for j in range(STATES):
                P[i, j] -= (s[i] * s[j]) * inverse
        if rows.shape[0] > 0:
            row = rows[count + r]
            row[0], row[1], row[2], row[3] = left, spread, first, second
            for b in range(3):
                row[4 + b] = one[r, b]
                row[7 + b] = two[r, b]
            for i in range(STATES):
                row[10 + i] = s[i] * inverse


@njit(cache=True)
def _forward(
    dt, gyro, accel, noise, walk, used, attitude, position, velocity, body, std, gate, patience, q0, x0, P0, keep
):
    n = gyro.shape[0]
    kept = n if keep else 0
    total = 0
    if keep:
        for k in range(n):
            total += 3 * (used[k, 0] + used[k, 1] + used[k, 2])
    Q = np.empty((kept, 4))
    X = np.empty((kept, 15))
    C = np.empty((kept, _PACKED))
    whitened = np.full((kept, 3, 3), np.nan)
    outcome = np.zeros((kept, 3), np.int8)
    rows = np.empty((total, _ROW))
    first_row = np.zeros(kept + 1, np.int64)
    q, x, P = q0.copy(), x0.copy(), P0.copy()
    blocks = np.empty((5, 3, 3))
    work = np.empty((4, 3, 3))
    T = np.empty((9, STATES))
    y = np.empty(3)
    one = np.empty((3, 3))
    two = np.empty((3, 3))
    delta = np.empty(STATES)
    s = np.empty(STATES)
    step = np.empty(4)
    rejected = np.zeros(3, np.int64)
    cost = 0.0
    count = 0
    for k in range(n):
        if k > 0:
            predict(q, x, gyro[k - 1], gyro[k], accel[k - 1], accel[k], dt, blocks, work)
            _spread(P, blocks, dt, noise[k], walk, T)
        for kind in range(3):
            if used[k, kind] == 0:
                continue
            first, second = _observe(kind, k, q, x, attitude, position, velocity, body, y, one, two, work[0])
            var = std[kind] * std[kind]
            e0, e1, e2, log_det = _gauge(P, y, var, first, one, second, two)
            nis = e0 * e0 + e1 * e1 + e2 * e2
            cost += (nis if nis <= gate else gate + TAIL * np.log(nis / gate)) + log_det
            result = 1
            if nis <= gate:
                rejected[kind] = 0
            else:
                rejected[kind] += 1
                result = 3 if rejected[kind] > patience[kind] else 2
            if keep:
                whitened[k, kind, 0], whitened[k, kind, 1], whitened[k, kind, 2] = e0, e1, e2
                outcome[k, kind] = result
            if result == 2:
                continue
            _absorb(P, y, var, first, one, second, two, delta, s, rows, count)
            if keep:
                count += 3
            _turn(q, delta[0], delta[1], delta[2], step)
            for i in range(15):
                x[i] += delta[3 + i]
        if keep:
            first_row[k + 1] = count
            Q[k] = q
            X[k] = x
            c = 0
            for i in range(STATES):
                for j in range(i + 1):
                    C[k, c] = P[i, j]
                    c += 1
    return Q, X, C, whitened, outcome, cost, rows, first_row


def innovation(inputs: Inputs, kind: int, k: int, q: np.ndarray, x: np.ndarray):
    """Measured minus expected (3,) of one kind at sample k, its Jacobian's two 3 x 3 blocks and their first columns.

    q (4,), x (15,)  nominal state. Where a kind has one block only, the second is zero.
    """
    y, one, two = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    first, second = _observe(
        kind, k, q, x, inputs.attitude, inputs.position, inputs.velocity, inputs.body, y, one, two, np.empty((3, 3))
    )
    return y, one, two, first, second


def forward(inputs: Inputs) -> Pass:
    """Filter forward in time; every sample's estimate uses the samples up to it."""
    return Pass(*_forward(*inputs, True))


def cost(inputs: Inputs) -> float:
    """`Pass.cost` alone, without keeping anything: for the choice of noise levels."""
    return _forward(*inputs, False)[5]


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
