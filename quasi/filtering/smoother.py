"""Fixed-interval smoother: the backward pass over a stored forward pass.

Bryson-Frazier form: the adjoint of the error state and its information matrix run backward through the very steps and
scalar updates of the forward pass, so no matrix is inverted and states without noise of their own (constant biases)
need no special care. To first order in the errors the estimate is that of the Rauch-Tung-Striebel smoother.

Source: Bierman, Fixed interval smoothing with discrete measurements, Int. J. Control 18(1), 1973.
"""

import numpy as np
from numba import njit

from quasi.filtering.ekf import FilterResult, Inputs
from quasi.filtering.ekf_steps import STATES, compose_rotation, predict


@njit(cache=True)
def _pull(L, blocks, dt, Y):
    """Y = F' L, rows of L (18, m) mixed by the transposed Jacobian."""
    half = 0.5 * dt
    m = L.shape[1]
    for i in range(3):
        for j in range(m):
            turn = L[9 + i, j]
            lean = L[12 + i, j]
            head = 0.0
            for b in range(3):
                u = L[3 + b, j] + half * L[6 + b, j]
                head += blocks[0, b, i] * L[b, j] + blocks[2, b, i] * u
                turn += blocks[1, b, i] * L[b, j] + blocks[3, b, i] * u
                lean += blocks[4, b, i] * u
            Y[i, j] = head
            Y[9 + i, j] = turn
            Y[12 + i, j] = lean
            Y[3 + i, j] = L[3 + i, j] + dt * L[6 + i, j]
            Y[6 + i, j] = L[6 + i, j]
            Y[15 + i, j] = L[15 + i, j]


@njit(cache=True)
def _backward(dt, gyro, accel, Q, X, C, rows, first):
    n = Q.shape[0]
    lam = np.zeros((STATES, 1))
    lam2 = np.zeros((STATES, 1))
    L = np.zeros((STATES, STATES))
    Y = np.zeros((STATES, STATES))
    P = np.empty((STATES, STATES))
    T = np.empty((STATES, STATES))
    g = np.empty(STATES)
    delta = np.empty(STATES)
    blocks = np.empty((5, 3, 3))
    work = np.empty((4, 3, 3))
    step = np.empty(4)
    q = np.empty(4)
    x = np.empty(15)
    Qs = np.empty_like(Q)
    Xs = np.empty_like(X)
    Cs = np.empty_like(C)
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            q[:] = Q[k]
            x[:] = X[k]
            predict(q, x, gyro[k], gyro[k + 1], accel[k], accel[k + 1], dt, blocks, work)
            _pull(lam, blocks, dt, lam2)
            lam, lam2 = lam2, lam
            _pull(L, blocks, dt, Y)
            for i in range(STATES):
                for j in range(i):
                    Y[i, j], Y[j, i] = Y[j, i], Y[i, j]
            _pull(Y, blocks, dt, L)
        c = 0
        for i in range(STATES):
            for j in range(i + 1):
                P[i, j] = C[k, c]
                P[j, i] = C[k, c]
                c += 1
        c = 0
        for i in range(STATES):
            value = 0.0
            for j in range(STATES):
                value += P[i, j] * lam[j, 0]
                T[i, j] = 0.0
            delta[i] = value
            for m in range(STATES):
                p = P[i, m]
                for j in range(STATES):
                    T[i, j] += p * L[m, j]
        for i in range(STATES):
            for j in range(i + 1):
                value = P[i, j]
                for m in range(STATES):
                    value -= T[i, m] * P[j, m]
                Cs[k, c] = value
                c += 1
        Qs[k] = Q[k]
        compose_rotation(Qs[k], delta[0], delta[1], delta[2], step)
        for i in range(15):
            Xs[k, i] = X[k, i] + delta[3 + i]
        for m in range(first[k + 1] - 1, first[k] - 1, -1):
            row = rows[m]
            a = int(row[2])
            b = int(row[3])
            gain = row[10:]
            push = row[0] / row[1]
            weight = 1.0 / row[1]
            for i in range(STATES):
                push -= gain[i] * lam[i, 0]
                value = 0.0
                for j in range(STATES):
                    value += L[i, j] * gain[j]
                g[i] = value
            for i in range(STATES):
                weight += gain[i] * g[i]
            for i in range(3):
                lam[a + i, 0] += row[4 + i] * push
                lam[b + i, 0] += row[7 + i] * push
            # L becomes (I - h K') L (I - K h') + h h' / S, with h zero but for six entries
            for i in range(STATES):
                for e in range(3):
                    L[i, a + e] -= g[i] * row[4 + e]
                    L[i, b + e] -= g[i] * row[7 + e]
            for e in range(3):
                for j in range(STATES):
                    L[a + e, j] -= row[4 + e] * g[j]
                    L[b + e, j] -= row[7 + e] * g[j]
            for e in range(3):
                for f in range(3):
                    L[a + e, a + f] += weight * row[4 + e] * row[4 + f]
                    L[a + e, b + f] += weight * row[4 + e] * row[7 + f]
                    L[b + e, a + f] += weight * row[7 + e] * row[4 + f]
                    L[b + e, b + f] += weight * row[7 + e] * row[7 + f]
    return Qs, Xs, Cs


def smooth(inputs: Inputs, filtered: FilterResult) -> FilterResult:
    """Every sample's estimate from all samples, earlier and later; shapes and innovations of the forward pass.

    inputs    those of the forward pass; filtered  its result
    """
    q, x, c = _backward(
        inputs.dt,
        inputs.gyro,
        inputs.accel,
        filtered.quaternion,
        filtered.state,
        filtered.covariance,
        filtered.rows,
        filtered.first,
    )
    return filtered._replace(quaternion=q, state=x, covariance=c)
