"""A rotor's speed of its commands by a first-order lag, with its derivatives, and least squares along them.

Sources: Klein & Morelli, Aircraft System Identification, 2006, section 6.3 (output error by modified Newton-Raphson;
its sensitivity equations); Marquardt, SIAM J. Appl. Math. 11, 1963 (damping in proportion to the diagonal).
"""

from collections.abc import Callable

import numpy as np
from numba import njit

STEPS = 30
NO_SLOPES = np.empty((0, 0))


@njit(cache=True)
def follow(wanted, speed, start, late, dt, up, down, out, moves, slopes):
    """Speeds out (n,) of a rotor that follows wanted (n,) with its lag; wanted is linear between samples.

    start (n,) nonzero where the equation starts anew from the measured speed; late  delay in samples, may be a fraction
    moves (n, q)  derivatives of wanted by constants of its map; slopes (n, 3 + q)  takes those of the speeds by up,
    down, delay (1/s) and the map's constants. Both NO_SLOPES where these are not asked.
    """
    n, asked, maps = len(wanted), len(slopes) > 0, moves.shape[1]
    keep, first, last = np.empty(2), np.empty(2), np.empty(2)
    moved = np.empty((2, 3))  # of keep, first and last with the time constant
    for k in range(2):
        tau = up if k else down
        share = dt / tau
        keep[k] = np.exp(-share)
        last[k] = 1.0 - (1.0 - keep[k]) / share
        first[k] = (1.0 - keep[k]) / share - keep[k]
        moved[k, 0] = keep[k] * share / tau
        moved[k, 2] = (moved[k, 0] - (1.0 - keep[k]) / tau) / share
        moved[k, 1] = -moved[k, 0] - moved[k, 2]
    whole = int(np.floor(late))
    part = late - whole
    y = speed[0]
    before, falls, a_before, b_before = wanted[0], 0.0, 0, 0
    for i in range(n):
        a, b = min(max(i - whole - 1, 0), n - 1), min(max(i - whole, 0), n - 1)
        now = part * wanted[a] + (1.0 - part) * wanted[b]
        fall = (wanted[a] - wanted[b]) / dt
        if start[i]:
            y = speed[i]
            if asked:
                for j in range(3 + maps):
                    slopes[i, j] = 0.0
        else:
            k = 1 if 0.5 * (before + now) > y else 0
            if asked:
                u, v, w = keep[k], first[k], last[k]
                own = moved[k, 0] * y + moved[k, 1] * before + moved[k, 2] * now
                slopes[i, 0] = u * slopes[i - 1, 0] + k * own
                slopes[i, 1] = u * slopes[i - 1, 1] + (1 - k) * own
                slopes[i, 2] = u * slopes[i - 1, 2] + v * falls + w * fall
                for j in range(maps):
                    then = part * moves[a_before, j] + (1.0 - part) * moves[b_before, j]
                    here = part * moves[a, j] + (1.0 - part) * moves[b, j]
                    slopes[i, 3 + j] = u * slopes[i - 1, 3 + j] + v * then + w * here
            y = keep[k] * y + first[k] * before + last[k] * now
        before, falls, a_before, b_before = now, fall, a, b
        out[i] = y


def fit_damped(
    run: Callable[[np.ndarray], np.ndarray],
    slopes: Callable[[np.ndarray], np.ndarray],
    target: np.ndarray,
    start: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    size: np.ndarray,
    iterations: int = STEPS,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least squares by damped Gauss-Newton steps: values (p,), last slopes (n, p), prediction (n,).

    run  values -> prediction (n,) of target (n,); slopes  values -> its derivatives (n, p)
    bounds  two (p,), at which steps are clipped; size (p,)  steps in proportion to the sizes of the values
    """
    x, predicted = start, run(start)
    cost = float(np.sum((target - predicted) ** 2))
    damping, jacobian = 1e-3, np.empty((len(target), len(x)))
    for _ in range(iterations):
        jacobian = slopes(x)
        normal = (jacobian.T @ jacobian) * np.outer(size, size)
        gradient = jacobian.T @ (target - predicted) * size
        diagonal = np.diag(np.diag(normal) + 1e-12 * np.trace(normal))
        gained = 0.0
        while damping < 1e6:
            candidate = np.clip(x + np.linalg.solve(normal + damping * diagonal, gradient) * size, *bounds)
            there = run(candidate)
            new = float(np.sum((target - there) ** 2))
            if new < cost:
                gained, x, predicted, cost = cost - new, candidate, there, new
                damping = max(damping / 10, 1e-6)
                break
            damping *= 10
        if gained < 1e-7 * cost or gained == 0.0:
            break
    return x, jacobian, predicted
