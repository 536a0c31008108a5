"""The compiled steps of the extended Kalman filter: prediction, covariance, measurement model and update.

States and their order are those of `ekf`. The compiler sees plain loops over small blocks, for the 18 x 18 Jacobian
is mostly zero.

Sources: those of `ekf`.
"""

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY

STATES = 18


@njit(cache=True)
def rotation_matrix(q, m):
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
def rotation_exponential(x, y, z, q):
    angle = np.sqrt(x * x + y * y + z * z)
    s = 0.5 - angle * angle / 48.0 if angle < 1e-4 else np.sin(0.5 * angle) / angle
    q[0], q[1], q[2], q[3] = np.cos(0.5 * angle), s * x, s * y, s * z


@njit(cache=True)
def compose_rotation(q, x, y, z, step):
    """q becomes q exp(x, y, z), of unit length; `step` (4,) is left holding the exponential."""
    rotation_exponential(x, y, z, step)
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
    rotation_matrix(q, r0)
    step = np.empty(4)
    compose_rotation(q, phi[0], phi[1], phi[2], step)
    rotation_matrix(q, r1)
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
    transposed_step, right_jacobian = blocks[0], blocks[1]
    rotation_matrix(step, right_jacobian)
    for i in range(3):
        for j in range(3):
            transposed_step[i, j] = right_jacobian[j, i]
    # right Jacobian of the rotation: (I - (1 - cos a)/a2 [phi]x + (a - sin a)/a3 [phi]x[phi]x)
    square = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    if square < 1e-4:
        c1 = 0.5 - square / 24.0
        c2 = 1.0 / 6.0 - square / 120.0
    else:
        angle = np.sqrt(square)
        c1 = (1.0 - np.cos(angle)) / square
        c2 = (angle - np.sin(angle)) / (square * angle)
    for i in range(3):
        for j in range(3):
            right_jacobian[i, j] = -dt * c2 * phi[i] * phi[j]
        right_jacobian[i, i] -= dt * (1.0 - c2 * square)
    right_jacobian[0, 1] -= dt * c1 * phi[2]
    right_jacobian[0, 2] += dt * c1 * phi[1]
    right_jacobian[1, 0] += dt * c1 * phi[2]
    right_jacobian[1, 2] -= dt * c1 * phi[0]
    right_jacobian[2, 0] -= dt * c1 * phi[1]
    right_jacobian[2, 1] += dt * c1 * phi[0]
    for i in range(3):
        for j in range(3):
            by_rotation = 0.0
            by_gyro = 0.0
            for k in range(3):
                by_rotation += cross1[i, k] * transposed_step[k, j]
                by_gyro += cross1[i, k] * right_jacobian[k, j]
            blocks[2, i, j] = -half * (cross0[i, j] + by_rotation)
            blocks[3, i, j] = -half * by_gyro
            blocks[4, i, j] = -half * (r0[i, j] + r1[i, j])


@njit(cache=True)
def propagate_covariance(P, blocks, dt, noise, bias_random_walk, T):
    """P becomes F P F' + Q in place. noise, bias_random_walk (6,); T (9, 18) scratch."""
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
        P[9 + b, 9 + b] += bias_random_walk[b] * bias_random_walk[b] * dt


@njit(cache=True)
def measurement_model(kind, k, q, x, attitude, position, velocity, body, y, H_first, H_second, work):
    """Innovation y (3,) and the two 3 x 3 blocks of the measurement matrix; returns their first columns."""
    H_first[:] = 0.0
    H_second[:] = 0.0
    if kind == 0:
        expected = np.empty(4)
        step = np.empty(4)
        expected[:] = q
        compose_rotation(expected, x[12], x[13], x[14], step)
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
        rotation_matrix(step, work)
        for i in range(3):
            for j in range(3):
                H_first[i, j] = work[j, i]
            H_second[i, i] = 1.0
        return 0, 15
    if kind == 1:
        for i in range(3):
            y[i] = position[k, i] - x[3 + i]
            H_first[i, i] = 1.0
        return 6, 0
    if not body:
        for i in range(3):
            y[i] = velocity[k, i] - x[i]
            H_first[i, i] = 1.0
        return 3, 0
    rotation_matrix(q, work)
    body_velocity = np.empty(3)
    for i in range(3):
        body_velocity[i] = work[0, i] * x[0] + work[1, i] * x[1] + work[2, i] * x[2]
        y[i] = velocity[k, i] - body_velocity[i]
        for j in range(3):
            H_first[i, j] = work[j, i]
    H_second[0, 1], H_second[0, 2], H_second[1, 2] = -body_velocity[2], body_velocity[1], -body_velocity[0]
    H_second[1, 0], H_second[2, 0], H_second[2, 1] = body_velocity[2], -body_velocity[1], body_velocity[0]
    return 3, 0


@njit(cache=True)
def normalised_innovation(P, y, var, first, H_first, second, H_second):
    """Normalised innovation squared of the three together, and the log determinant of their covariance."""
    S = np.empty((3, 3))
    h = np.empty((3, 6))
    for i in range(3):
        for b in range(3):
            h[i, b] = H_first[i, b]
            h[i, 3 + b] = H_second[i, b]
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
def measurement_update(P, y, var, first, H_first, second, H_second, delta, s, rows, count):
    """Three scalar updates of P and of the error estimate delta (18,); rows[count...] keep them for the smoother."""
    delta[:] = 0.0
    for r in range(3):
        h0, h1, h2 = H_first[r, 0], H_first[r, 1], H_first[r, 2]
        g0, g1, g2 = H_second[r, 0], H_second[r, 1], H_second[r, 2]
        for j in range(STATES):
            s[j] = (
                h0 * P[first, j]
                + h1 * P[first + 1, j]
                + h2 * P[first + 2, j]
                + g0 * P[second, j]
                + g1 * P[second + 1, j]
                + g2 * P[second + 2, j]
            )
        variance = var[r]
        innovation_left = y[r]
        for b in range(3):
            variance += H_first[r, b] * s[first + b] + H_second[r, b] * s[second + b]
            innovation_left -= H_first[r, b] * delta[first + b] + H_second[r, b] * delta[second + b]
        inverse = 1.0 / variance
        for i in range(STATES):
            gain = s[i] * inverse
            delta[i] += gain * innovation_left
            for j in range(STATES):
                P[i, j] -= (s[i] * s[j]) * inverse
        if rows.shape[0] > 0:
            row = rows[count + r]
            row[0], row[1], row[2], row[3] = innovation_left, variance, first, second
            for b in range(3):
                row[4 + b] = H_first[r, b]
                row[7 + b] = H_second[r, b]
            for i in range(STATES):
                row[10 + i] = s[i] * inverse
