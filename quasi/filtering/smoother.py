"""Fixed-interval smoother: the backward pass over a stored forward pass.

Bryson-Frazier form: the adjoint of the error state and its information matrix run backward through the very steps and
scalar updates of the forward pass, so no matrix is inverted and states without noise of their own (constant biases)
need no special care. To first order in the errors the estimate is that of the Rauch-Tung-Striebel smoother.

Source: Bierman, Fixed interval smoothing with discrete measurements, Int. J. Control 18(1), 1973.
"""

import numpy as np
from numba import njit

from quasi.filtering.ekf import FilterResult, Inputs
from quasi.filtering.ekf_steps import CHUNKS, STATES, WIDTH, WORK_SHAPE, compose_rotation, predict, unpack_triangle
from quasi.terms.lanes import LANES, make_vectors, view_lanes

SYMMETRISED = 8  # samples between two symmetrisations; rounding differences grow, for no update reduces them


@njit(cache=True, error_model="numpy")
def _pull(L, blocks, dt, Y, width):
    """Y = F' L, rows of L (18 width) mixed by the transposed Jacobian; numbers of arrays, or vectors of views."""
    half = 0.5 * dt
    for j in range(width):
        u0 = L[3 * width + j] + half * L[6 * width + j]
        u1 = L[4 * width + j] + half * L[7 * width + j]
        u2 = L[5 * width + j] + half * L[8 * width + j]
        r0, r1, r2 = L[j], L[width + j], L[2 * width + j]
        for i in range(3):
            attitude = blocks[0, 0, i] * r0 + blocks[0, 1, i] * r1 + blocks[0, 2, i] * r2
            attitude += blocks[2, 0, i] * u0 + blocks[2, 1, i] * u1 + blocks[2, 2, i] * u2
            gyro = L[(9 + i) * width + j] + blocks[1, 0, i] * r0 + blocks[1, 1, i] * r1 + blocks[1, 2, i] * r2
            gyro += blocks[3, 0, i] * u0 + blocks[3, 1, i] * u1 + blocks[3, 2, i] * u2
            accel = L[(12 + i) * width + j]
            accel += blocks[4, 0, i] * u0 + blocks[4, 1, i] * u1 + blocks[4, 2, i] * u2
            Y[i * width + j] = attitude
            Y[(9 + i) * width + j] = gyro
            Y[(12 + i) * width + j] = accel
            Y[(3 + i) * width + j] = L[(3 + i) * width + j] + dt * L[(6 + i) * width + j]
            Y[(6 + i) * width + j] = L[(6 + i) * width + j]
            Y[(15 + i) * width + j] = L[(15 + i) * width + j]


@njit(cache=True, error_model="numpy")
def _reduce_covariance(P, P_rows, L_rows, T, T_rows, out, out_rows, packed, k):
    """packed[k] = P - P L P, lower triangle; T, out (18, WIDTH) scratch. Two rows at a time share what they read."""
    for i in range(0, STATES, 2):
        for c in range(CHUNKS):
            one, other = P[i, 0] * L_rows[c], P[i + 1, 0] * L_rows[c]
            for m in range(1, STATES):
                row = L_rows[m * CHUNKS + c]
                one += P[i, m] * row
                other += P[i + 1, m] * row
            T_rows[i * CHUNKS + c] = one
            T_rows[(i + 1) * CHUNKS + c] = other
    for i in range(0, STATES, 2):
        for c in range((i + 1) // LANES + 1):
            one, other = P_rows[i * CHUNKS + c], P_rows[(i + 1) * CHUNKS + c]
            for m in range(STATES):
                row = P_rows[m * CHUNKS + c]
                one -= T[i, m] * row
                other -= T[i + 1, m] * row
            out_rows[i * CHUNKS + c] = one
            out_rows[(i + 1) * CHUNKS + c] = other
    c = 0
    for i in range(STATES):
        for j in range(i + 1):
            packed[k, c] = out[i, j]
            c += 1


@njit(cache=True, error_model="numpy")
def _revert_update(rows, m, lam, L, L_rows, g, g_rows):
    """Carry the adjoint lam (18,) and its information L back over scalar update m; g (WIDTH,) scratch.

    L becomes (I - h K') L (I - K h') + h h' / S, with h zero but for six entries.
    """
    a, b = int(rows[m, 2]), int(rows[m, 3])
    push, weight = rows[m, 0] / rows[m, 1], 1.0 / rows[m, 1]
    for c in range(CHUNKS):
        total = rows[m, 10] * L_rows[c]
        for j in range(1, STATES):
            total += rows[m, 10 + j] * L_rows[j * CHUNKS + c]
        g_rows[c] = total
    for i in range(STATES):
        push -= rows[m, 10 + i] * lam[i]
        weight += rows[m, 10 + i] * g[i]
    for e in range(3):
        lam[a + e] += rows[m, 4 + e] * push
        lam[b + e] += rows[m, 7 + e] * push
    for i in range(STATES):
        for e in range(3):
            L[i, a + e] -= g[i] * rows[m, 4 + e]
            L[i, b + e] -= g[i] * rows[m, 7 + e]
    for e in range(3):
        for c in range(CHUNKS):
            L_rows[(a + e) * CHUNKS + c] -= rows[m, 4 + e] * g_rows[c]
            L_rows[(b + e) * CHUNKS + c] -= rows[m, 7 + e] * g_rows[c]
    for e in range(3):
        for f in range(3):
            L[a + e, a + f] += weight * rows[m, 4 + e] * rows[m, 4 + f]
            L[a + e, b + f] += weight * rows[m, 4 + e] * rows[m, 7 + f]
            L[b + e, a + f] += weight * rows[m, 7 + e] * rows[m, 4 + f]
            L[b + e, b + f] += weight * rows[m, 7 + e] * rows[m, 7 + f]


@njit(cache=True, error_model="numpy")
def _backward(dt, gyro, accel, Q, X, C, rows, first, room, Cs):
    n, size, shape = Q.shape[0], STATES * CHUNKS, (STATES, WIDTH)
    room[:] = 0.0
    P, L, T = room[:size].reshape(shape), room[size : 2 * size].reshape(shape), room[2 * size : 3 * size].reshape(shape)
    Y, g = room[3 * size : 4 * size].reshape(shape), room[4 * size :].reshape(WIDTH)
    P_rows, L_rows, T_rows = view_lanes(room[:size]), view_lanes(room[size : 2 * size]), view_lanes(room[2 * size :])
    Y_rows, g_rows = view_lanes(room[3 * size : 4 * size]), view_lanes(room[4 * size :])
    lam, pulled, delta = np.zeros(STATES), np.zeros(STATES), np.empty(STATES)
    blocks, work = np.empty((5, 3, 3)), np.empty(WORK_SHAPE)
    q, x = np.empty(4), np.empty(15)
    Qs, Xs = np.empty_like(Q), np.empty_like(X)
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            for i in range(4):
                q[i] = Q[k, i]
            for i in range(15):
                x[i] = X[k, i]
            predict(q, x, gyro, accel, k, dt, blocks, work)
            _pull(lam, blocks, dt, pulled, 1)
            for i in range(STATES):
                lam[i] = pulled[i]
            _pull(L_rows, blocks, dt, Y_rows, CHUNKS)
            for i in range(STATES):
                for j in range(i):
                    Y[i, j], Y[j, i] = Y[j, i], Y[i, j]
            _pull(Y_rows, blocks, dt, L_rows, CHUNKS)
            if k % SYMMETRISED == 0:
                for i in range(STATES):
                    for j in range(i):
                        L[j, i] = L[i, j]
        unpack_triangle(C, k, P)
        for i in range(STATES):
            value = 0.0
            for j in range(STATES):
                value += P[i, j] * lam[j]
            delta[i] = value
        _reduce_covariance(P, P_rows, L_rows, T, T_rows, Y, Y_rows, Cs, k)
        for i in range(4):
            q[i] = Q[k, i]
        compose_rotation(q, delta[0], delta[1], delta[2])
        for i in range(4):
            Qs[k, i] = q[i]
        for i in range(15):
            Xs[k, i] = X[k, i] + delta[3 + i]
        for m in range(first[k + 1] - 1, first[k] - 1, -1):
            _revert_update(rows, m, lam, L, L_rows, g, g_rows)
    return Qs, Xs


def smooth(inputs: Inputs, filtered: FilterResult) -> FilterResult:
    """Every sample's estimate from all samples, earlier and later; shapes and innovations of the forward pass.

    inputs    those of the forward pass; filtered  its result
    """
    covariance = np.empty_like(filtered.covariance)  # NumPy asks for large pages, see `ekf`
    q, x = _backward(
        inputs.dt,
        inputs.gyro,
        inputs.accel,
        filtered.quaternion,
        filtered.state,
        filtered.covariance,
        filtered.rows,
        filtered.first,
        make_vectors((4 * STATES + 1) * CHUNKS),
        covariance,
    )
    return filtered._replace(quaternion=q, state=x, covariance=covariance)
