"""Control allocation: squared rotor speeds for wanted moments and thrust, within the rotors' ranges.

Weighted least squares by an active set: where the rotors cannot produce all wanted loads, yaw is reduced first, then
thrust, then roll and pitch. Source: Harkegard, Efficient active set algorithms for solving constrained least
squares problems in aircraft control allocation, CDC 2002; weights: Smeur, Hoppener, de Wagter, Prioritized control
allocation for quadrotors subject to saturation, IMAV 2017.
"""

import numpy as np
from numba import njit

ALLOCATION_SCRATCH_SIZE = 64  # numbers of scratch that `allocate_rotors` needs
_REGULARISATION_WEIGHT = (
    1e-8  # weight of the squared distance from the preferred input, against weight 1 of a wanted row
)


@njit(cache=True, error_model="numpy")
def invert_matrix(a, inverse):
    """Inverse of a (4, 4) matrix, flat row by row in `a` (16,), into `inverse` (16,); Gauss-Jordan, partial pivots."""
    work = np.empty((4, 8))
    for i in range(4):
        for j in range(4):
            work[i, j] = a[4 * i + j]
            work[i, 4 + j] = 1.0 if i == j else 0.0
    for column in range(4):
        pivot = column
        for i in range(column + 1, 4):
            if abs(work[i, column]) > abs(work[pivot, column]):
                pivot = i
        for j in range(8):
            work[column, j], work[pivot, j] = work[pivot, j], work[column, j]
        scale = 1.0 / work[column, column]
        for j in range(8):
            work[column, j] *= scale
        for i in range(4):
            if i != column:
                factor = work[i, column]
                for j in range(8):
                    work[i, j] -= factor * work[column, j]
    for i in range(4):
        for j in range(4):
            inverse[4 * i + j] = work[i, 4 + j]


@njit(cache=True, error_model="numpy")
def allocate_rotors(effect, wanted, weights, low, high, scale, u, scratch):
    """Fill u (4,) with the inputs in [low, high] (4,) that minimise sum of (weights (effect u - wanted))^2.

    effect (16,) rows Mx My Mz Fz; wanted (4,); weights (4,), one per row, relative to what the row can do: each row
    is first divided by the sum of its entries times `scale`, a typical input. scratch (ALLOCATION_SCRATCH_SIZE,) is
    overwritten.
    On entry u is the preferred input; it resolves what the wanted rows do not determine.
    """
    # normal equations of the scaled problem: h x = g, x = u / scale; h (16), g (4), x (4), bounds at 44..52
    h, g, x, side = scratch[0:16], scratch[16:20], scratch[20:24], scratch[24:28]
    for i in range(4):
        for j in range(4):
            h[4 * i + j] = _REGULARISATION_WEIGHT if i == j else 0.0
        side[i] = 0.0
        g[i] = _REGULARISATION_WEIGHT * u[i] / scale
        x[i] = min(max(u[i], low[i]), high[i]) / scale
    for row in range(4):
        size = 0.0
        for j in range(4):
            size += abs(effect[4 * row + j]) * scale
        w2 = (weights[row] / size) ** 2
        for i in range(4):
            a = effect[4 * row + i] * scale
            g[i] += w2 * a * wanted[row]
            for j in range(4):
                h[4 * i + j] += w2 * a * effect[4 * row + j] * scale
    # rotors at a bound of the preferred input begin there
    for i in range(4):
        if x[i] <= low[i] / scale:
            side[i] = -1.0
        elif x[i] >= high[i] / scale:
            side[i] = 1.0
    for _ in range(24):
        # best inputs of the free rotors, the others at their bounds
        _solve_free(h, g, x, side, scratch)
        best = scratch[28:32]
        # the longest step towards them that stays inside
        step, hit, at = 1.0, -1, 0.0
        for i in range(4):
            if side[i] == 0.0:
                move = best[i] - x[i]
                if move < 0.0 and x[i] + move < low[i] / scale:
                    share = (low[i] / scale - x[i]) / move
                    if share < step:
                        step, hit, at = share, i, -1.0
                elif move > 0.0 and x[i] + move > high[i] / scale:
                    share = (high[i] / scale - x[i]) / move
                    if share < step:
                        step, hit, at = share, i, 1.0
        for i in range(4):
            if side[i] == 0.0:
                x[i] += step * (best[i] - x[i])
        if hit >= 0:
            side[hit] = at
            x[hit] = (low[hit] if at < 0.0 else high[hit]) / scale
            continue
        # at the optimum of this set: release the rotor with the most negative multiplier
        worst, rotor = -1e-9, -1
        for i in range(4):
            if side[i] != 0.0:
                slope = -g[i]
                for j in range(4):
                    slope += h[4 * i + j] * x[j]
                # at the lower bound the cost must rise upwards, at the upper bound downwards
                multiplier = -side[i] * slope
                if multiplier < worst * (1.0 + abs(g[i])):
                    worst, rotor = multiplier / (1.0 + abs(g[i])), i
        if rotor < 0:
            break
        side[rotor] = 0.0
    for i in range(4):
        u[i] = min(max(x[i] * scale, low[i]), high[i])


@njit(cache=True, error_model="numpy")
def _solve_free(h, g, x, side, scratch):
    """Solution of h x = g over the rotors with side 0, the others as in x, into scratch[28:32]; Cholesky."""
    best, chol = scratch[28:32], scratch[32:48]
    for i in range(4):
        best[i] = x[i]
    for i in range(4):
        if side[i] != 0.0:
            continue
        right = g[i]
        for j in range(4):
            if side[j] != 0.0:
                right -= h[4 * i + j] * x[j]
        for j in range(i):
            if side[j] == 0.0:
                value = h[4 * i + j]
                for k in range(j):
                    if side[k] == 0.0:
                        value -= chol[4 * i + k] * chol[4 * j + k]
                chol[4 * i + j] = value / chol[4 * j + j]
                right -= chol[4 * i + j] * scratch[48 + j]
        value = h[4 * i + i]
        for k in range(i):
            if side[k] == 0.0:
                value -= chol[4 * i + k] ** 2
        chol[4 * i + i] = np.sqrt(value)
        scratch[48 + i] = right / chol[4 * i + i]
    for back in range(4):
        i = 3 - back
        if side[i] != 0.0:
            continue
        value = scratch[48 + i]
        for j in range(i + 1, 4):
            if side[j] == 0.0:
                value -= chol[4 * j + i] * best[j]
        best[i] = value / chol[4 * i + i]
