"""The compiled steps of the extended Kalman filter: prediction, covariance, measurement model and update.

States and their order are those of `ekf`. The compiler sees plain loops over small blocks, for the 18 x 18 Jacobian
is mostly zero. Matrices with 18 columns have WIDTH columns, the last ones zero, so that a row is whole vectors; they
come twice, as array (rows, WIDTH) and as view of CHUNKS vectors a row (`quasi.terms.lanes`). Nothing is allocated here.

Sources: those of `ekf`.
"""

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi.terms.lanes import LANES

STATES = 18
CHUNKS = -(-STATES // LANES)  # vectors of a row
WIDTH = CHUNKS * LANES  # columns of a row, with those that fill up its last vector
WORK_SHAPE = (5, 3, 3)  # scratch of the functions below: four matrices, and one innovation covariance


@njit(cache=True, error_model="numpy")
def rotation_matrix(w, x, y, z, m):
    """Rotation matrix of a quaternion into m (3, 3)."""
    m[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    m[0, 1] = 2.0 * (x * y - w * z)
    m[0, 2] = 2.0 * (x * z + w * y)
    m[1, 0] = 2.0 * (x * y + w * z)
    m[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    m[1, 2] = 2.0 * (y * z - w * x)
    m[2, 0] = 2.0 * (x * z - w * y)
    m[2, 1] = 2.0 * (y * z + w * x)
    m[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@njit(cache=True, error_model="numpy")
def rotation_exponential(x, y, z):
    """Quaternion of a rotation vector."""
    angle = np.sqrt(x * x + y * y + z * z)
    s = 0.5 - angle * angle / 48.0 if angle < 1e-4 else np.sin(0.5 * angle) / angle
    return np.cos(0.5 * angle), s * x, s * y, s * z


@njit(cache=True, error_model="numpy")
def multiply_quaternions(q, step):
    """Product of two quaternions, of unit length."""
    w = q[0] * step[0] - q[1] * step[1] - q[2] * step[2] - q[3] * step[3]
    a = q[0] * step[1] + q[1] * step[0] + q[2] * step[3] - q[3] * step[2]
    b = q[0] * step[2] - q[1] * step[3] + q[2] * step[0] + q[3] * step[1]
    c = q[0] * step[3] + q[1] * step[2] - q[2] * step[1] + q[3] * step[0]
    n = 1.0 / np.sqrt(w * w + a * a + b * b + c * c)
    return w * n, a * n, b * n, c * n


@njit(cache=True, error_model="numpy")
def compose_rotation(q, x, y, z):
    """q becomes q exp(x, y, z), of unit length; returns the exponential."""
    step = rotation_exponential(x, y, z)
    q[0], q[1], q[2], q[3] = multiply_quaternions(q, step)
    return step


@njit(cache=True, error_model="numpy")
def predict(q, x, gyro, accel, k, dt, blocks, work):
    """Carry the nominal state (q, x) in place from sample k to the next; write the Jacobian's blocks.

    blocks (5, 3, 3): d rotation / d rotation, d rotation / d gyro bias, d velocity / d rotation, / d gyro bias,
    / d accelerometer bias. Position rows are dt/2 times (old + new) velocity rows. work (5, 3, 3) scratch.
    """
    half = 0.5 * dt
    px = (0.5 * (gyro[k, 0] + gyro[k + 1, 0]) - x[6]) * dt
    py = (0.5 * (gyro[k, 1] + gyro[k + 1, 1]) - x[7]) * dt
    pz = (0.5 * (gyro[k, 2] + gyro[k + 1, 2]) - x[8]) * dt
    f0x, f0y, f0z = accel[k, 0] - x[9], accel[k, 1] - x[10], accel[k, 2] - x[11]
    f1x, f1y, f1z = accel[k + 1, 0] - x[9], accel[k + 1, 1] - x[10], accel[k + 1, 2] - x[11]
    rotation_matrix(q[0], q[1], q[2], q[3], work[0])
    step = compose_rotation(q, px, py, pz)
    rotation_matrix(q[0], q[1], q[2], q[3], work[1])
    for i in range(3):
        old = x[i]
        a, b, c = work[0, i, 0], work[0, i, 1], work[0, i, 2]
        d, e, f = work[1, i, 0], work[1, i, 1], work[1, i, 2]
        force = a * f0x + b * f0y + c * f0z
        force += d * f1x + e * f1y + f * f1z
        x[i] = old + half * force
        if i == 2:
            x[i] += dt * GRAVITY
        x[3 + i] += half * (old + x[i])
        # R [f]x, row by row
        work[2, i, 0] = b * f0z - c * f0y
        work[2, i, 1] = c * f0x - a * f0z
        work[2, i, 2] = a * f0y - b * f0x
        work[3, i, 0] = e * f1z - f * f1y
        work[3, i, 1] = f * f1x - d * f1z
        work[3, i, 2] = d * f1y - e * f1x
    rotation_matrix(step[0], step[1], step[2], step[3], blocks[1])
    for i in range(3):
        for j in range(3):
            blocks[0, i, j] = blocks[1, j, i]
    # right Jacobian of the rotation: (I - (1 - cos a)/a2 [phi]x + (a - sin a)/a3 [phi]x[phi]x)
    square = px * px + py * py + pz * pz
    if square < 1e-4:
        c1 = 0.5 - square / 24.0
        c2 = 1.0 / 6.0 - square / 120.0
    else:
        angle = np.sqrt(square)
        c1 = (1.0 - np.cos(angle)) / square
        c2 = (angle - np.sin(angle)) / (square * angle)
    level = dt * (1.0 - c2 * square)
    blocks[1, 0, 0], blocks[1, 1, 1], blocks[1, 2, 2] = (
        -dt * c2 * px * px - level, -dt * c2 * py * py - level, -dt * c2 * pz * pz - level
    )  # fmt: skip
    blocks[1, 0, 1], blocks[1, 1, 0] = -dt * c2 * px * py - dt * c1 * pz, -dt * c2 * px * py + dt * c1 * pz
    blocks[1, 0, 2], blocks[1, 2, 0] = -dt * c2 * px * pz + dt * c1 * py, -dt * c2 * px * pz - dt * c1 * py
    blocks[1, 1, 2], blocks[1, 2, 1] = -dt * c2 * py * pz - dt * c1 * px, -dt * c2 * py * pz + dt * c1 * px
    for i in range(3):
        for j in range(3):
            by_rotation = 0.0
            by_gyro = 0.0
            for b in range(3):
                by_rotation += work[3, i, b] * blocks[0, b, j]
                by_gyro += work[3, i, b] * blocks[1, b, j]
            blocks[2, i, j] = -half * (work[2, i, j] + by_rotation)
            blocks[3, i, j] = -half * by_gyro
            blocks[4, i, j] = -half * (work[0, i, j] + work[1, i, j])


@njit(cache=True, error_model="numpy")
def propagate_covariance(P, P_rows, blocks, dt, noise, sample, bias_random_walk, T, T_rows):
    """P becomes F P F' + Q in place. noise (N, 6), that of `sample` acts; bias_random_walk (6,); T (9, WIDTH) scratch.

    P_rows, T_rows  views of both
    """
    half = 0.5 * dt
    for i in range(3):
        d0, d1, d2 = blocks[0, i, 0], blocks[0, i, 1], blocks[0, i, 2]
        g0, g1, g2 = blocks[1, i, 0], blocks[1, i, 1], blocks[1, i, 2]
        for c in range(CHUNKS):
            T_rows[i * CHUNKS + c] = (
                d0 * P_rows[c] + d1 * P_rows[CHUNKS + c] + d2 * P_rows[2 * CHUNKS + c]
                + g0 * P_rows[9 * CHUNKS + c] + g1 * P_rows[10 * CHUNKS + c] + g2 * P_rows[11 * CHUNKS + c]
            )  # fmt: skip
        d0, d1, d2 = blocks[2, i, 0], blocks[2, i, 1], blocks[2, i, 2]
        g0, g1, g2 = blocks[3, i, 0], blocks[3, i, 1], blocks[3, i, 2]
        a0, a1, a2 = blocks[4, i, 0], blocks[4, i, 1], blocks[4, i, 2]
        for c in range(CHUNKS):
            change = (
                d0 * P_rows[c] + d1 * P_rows[CHUNKS + c] + d2 * P_rows[2 * CHUNKS + c]
                + g0 * P_rows[9 * CHUNKS + c] + g1 * P_rows[10 * CHUNKS + c] + g2 * P_rows[11 * CHUNKS + c]
            )  # fmt: skip
            change += a0 * P_rows[12 * CHUNKS + c] + a1 * P_rows[13 * CHUNKS + c] + a2 * P_rows[14 * CHUNKS + c]
            velocity, position = P_rows[(3 + i) * CHUNKS + c], P_rows[(6 + i) * CHUNKS + c]
            T_rows[(3 + i) * CHUNKS + c] = velocity + change
            T_rows[(6 + i) * CHUNKS + c] = position + dt * velocity + half * change
    for i in range(9):
        for j in range(9, STATES):
            P[i, j] = T[i, j]
            P[j, i] = T[i, j]
    # the noise of the step acts like an extra bias variance in the products below
    for b in range(3):
        gyro = noise[sample, b] * noise[sample, b]
        accel = noise[sample, 3 + b] * noise[sample, 3 + b]
        for i in range(3):
            T[i, 9 + b] += blocks[1, i, b] * gyro
            T[3 + i, 9 + b] += blocks[3, i, b] * gyro
            T[6 + i, 9 + b] += half * blocks[3, i, b] * gyro
            T[3 + i, 12 + b] += blocks[4, i, b] * accel
            T[6 + i, 12 + b] += half * blocks[4, i, b] * accel
    for i in range(9):
        for a in range(3):
            if a <= i:
                value = 0.0
                for b in range(3):
                    value += T[i, b] * blocks[0, a, b] + T[i, 9 + b] * blocks[1, a, b]
                P[i, a] = value
                P[a, i] = value
            if i >= 3:
                change = 0.0
                for b in range(3):
                    change += T[i, b] * blocks[2, a, b] + T[i, 9 + b] * blocks[3, a, b]
                    change += T[i, 12 + b] * blocks[4, a, b]
                if 3 + a <= i:
                    value = T[i, 3 + a] + change
                    P[i, 3 + a] = value
                    P[3 + a, i] = value
                if 6 + a <= i:
                    value = T[i, 6 + a] + dt * T[i, 3 + a] + half * change
                    P[i, 6 + a] = value
                    P[6 + a, i] = value
    for b in range(6):
        P[9 + b, 9 + b] += bias_random_walk[b] * bias_random_walk[b] * dt


@njit(cache=True, error_model="numpy")
def measurement_model(kind, k, q, x, attitude, position, velocity, body, y, H_first, H_second, work):
    """Innovation y (3,) and the two 3 x 3 blocks of the measurement matrix; returns their first columns."""
    for i in range(3):
        for j in range(3):
            H_first[i, j] = H_second[i, j] = 0.0
    if kind == 0:
        step = rotation_exponential(x[12], x[13], x[14])
        expected = multiply_quaternions(q, step)
        m = attitude[k, 0], attitude[k, 1], attitude[k, 2], attitude[k, 3]
        w = expected[0] * m[0] + expected[1] * m[1] + expected[2] * m[2] + expected[3] * m[3]
        a = expected[0] * m[1] - expected[1] * m[0] - expected[2] * m[3] + expected[3] * m[2]
        b = expected[0] * m[2] + expected[1] * m[3] - expected[2] * m[0] - expected[3] * m[1]
        c = expected[0] * m[3] - expected[1] * m[2] + expected[2] * m[1] - expected[3] * m[0]
        if w < 0.0:
            w, a, b, c = -w, -a, -b, -c
        s = np.sqrt(a * a + b * b + c * c)
        factor = 2.0 if s < 1e-12 else 2.0 * np.arctan2(s, w) / s
        y[0], y[1], y[2] = factor * a, factor * b, factor * c
        rotation_matrix(step[0], step[1], step[2], step[3], work[0])
        for i in range(3):
            for j in range(3):
                H_first[i, j] = work[0, j, i]
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
    rotation_matrix(q[0], q[1], q[2], q[3], work[0])
    for j in range(3):
        for i in range(3):
            H_first[i, j] = work[0, j, i]
    u = H_first[0, 0] * x[0] + H_first[0, 1] * x[1] + H_first[0, 2] * x[2]
    v = H_first[1, 0] * x[0] + H_first[1, 1] * x[1] + H_first[1, 2] * x[2]
    w = H_first[2, 0] * x[0] + H_first[2, 1] * x[1] + H_first[2, 2] * x[2]
    y[0], y[1], y[2] = velocity[k, 0] - u, velocity[k, 1] - v, velocity[k, 2] - w
    H_second[0, 1], H_second[0, 2], H_second[1, 2] = -w, v, -u
    H_second[1, 0], H_second[2, 0], H_second[2, 1] = w, -v, u
    return 3, 0


@njit(cache=True, error_model="numpy")
def normalised_innovation(P, y, var, first, H_first, second, H_second, work):
    """Three normalised innovations, one by one, and the log determinant of their covariance (in work[4])."""
    for i in range(3):
        for j in range(i + 1):
            value = 0.0
            for a in range(3):
                near = far = 0.0
                for b in range(3):
                    near += P[first + a, first + b] * H_first[j, b] + P[first + a, second + b] * H_second[j, b]
                    far += P[second + a, first + b] * H_first[j, b] + P[second + a, second + b] * H_second[j, b]
                value += H_first[i, a] * near + H_second[i, a] * far
            work[4, i, j] = value
        work[4, i, i] += var[i]
    l00 = np.sqrt(work[4, 0, 0])
    l10 = work[4, 1, 0] / l00
    l20 = work[4, 2, 0] / l00
    l11 = np.sqrt(work[4, 1, 1] - l10 * l10)
    l21 = (work[4, 2, 1] - l20 * l10) / l11
    l22 = np.sqrt(work[4, 2, 2] - l20 * l20 - l21 * l21)
    e0 = y[0] / l00
    e1 = (y[1] - l10 * e0) / l11
    e2 = (y[2] - l20 * e0 - l21 * e1) / l22
    return e0, e1, e2, 2.0 * np.log(l00 * l11 * l22)


@njit(cache=True, error_model="numpy")
def measurement_update(P_rows, y, var, first, H_first, second, H_second, delta, s, s_rows, rows, count):
    """Three scalar updates of P and of the error estimate delta (18,); rows[count...] keep them for the smoother.

    P_rows  view of P; s (WIDTH,) scratch and its view s_rows
    """
    delta[:] = 0.0
    at, to = first * CHUNKS, second * CHUNKS
    for r in range(3):
        h0, h1, h2 = H_first[r, 0], H_first[r, 1], H_first[r, 2]
        g0, g1, g2 = H_second[r, 0], H_second[r, 1], H_second[r, 2]
        for c in range(CHUNKS):
            s_rows[c] = (
                h0 * P_rows[at + c] + h1 * P_rows[at + CHUNKS + c] + h2 * P_rows[at + 2 * CHUNKS + c]
                + g0 * P_rows[to + c] + g1 * P_rows[to + CHUNKS + c] + g2 * P_rows[to + 2 * CHUNKS + c]
            )  # fmt: skip
        variance = var[r]
        innovation_left = y[r]
        for b in range(3):
            variance += H_first[r, b] * s[first + b] + H_second[r, b] * s[second + b]
            innovation_left -= H_first[r, b] * delta[first + b] + H_second[r, b] * delta[second + b]
        inverse = 1.0 / variance
        for i in range(STATES):
            delta[i] += s[i] * inverse * innovation_left
            for c in range(CHUNKS):
                P_rows[i * CHUNKS + c] -= (s[i] * s_rows[c]) * inverse
        if rows.shape[0] > 0:
            n = count + r
            rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3] = innovation_left, variance, first, second
            for b in range(3):
                rows[n, 4 + b] = H_first[r, b]
                rows[n, 7 + b] = H_second[r, b]
            for i in range(STATES):
                rows[n, 10 + i] = s[i] * inverse


@njit(cache=True, error_model="numpy")
def unpack_triangle(packed, k, P):
    """Write the lower triangle packed[k] (171,) to both halves of P (18, WIDTH)."""
    c = 0
    for i in range(STATES):
        for j in range(i + 1):
            P[i, j] = packed[k, c]
            P[j, i] = packed[k, c]
            c += 1
