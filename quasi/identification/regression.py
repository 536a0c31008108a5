"""Least squares on the chosen columns, with a covariance that survives autocorrelated residuals.

Residuals of 500 Hz data resemble their neighbours for a long time, so that a hundred thousand rows hold the information
of a few hundred. The covariance is the sandwich of Newey & West with a bandwidth from the residuals' own memory; rows
that do not take part (the test rows of a random partition) count as missing, not as neighbours.

Source: Newey & West, Econometrica 55(3), 1987; Parzen, On spectral analysis with missing observations, Sankhya A 25,
1963 (missing rows as zeros); Sokal, Monte Carlo methods in statistical mechanics, 1997, section 3 (memory window).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.linalg import qr, solve_triangular

from quasi.errors import DataError

MEMORY_WINDOW = 5.0  # the memory is summed over this many times its own length


class Fit(NamedTuple):
    """Result of `least_squares`.

    coefficients (p,); covariance (p, p) robust to autocorrelation; plain_covariance (p, p) as if rows were independent;
    residuals (n,); sigma2, their variance; condition number of the scaled columns; inflation (p,) of each coefficient's
    variance by the other columns (about the means where one column is constant; nan for the constant itself);
    bandwidth in rows; effective_rows, independent rows that weigh as much as these.
    """

    coefficients: np.ndarray
    covariance: np.ndarray
    plain_covariance: np.ndarray
    residuals: np.ndarray
    sigma2: float
    condition: float
    inflation: np.ndarray
    bandwidth: int
    effective_rows: float


def least_squares(a: np.ndarray, z: np.ndarray, series: Sequence[np.ndarray], bandwidth: int | None = None) -> Fit:
    """Least squares of z (n,) on the columns of a (n, p) by QR of the scaled columns.

    series     per flight the row numbers (n_b,) in its time order, increasing; together they cover the n rows in order
    bandwidth  Bartlett bandwidth in rows (Newey & West); when None, from the residuals' memory, with full weight up to
               half of it
    Raises DataError when columns are combinations of each other or rows are too few.
    """
    n, p = a.shape
    if n <= p:
        raise DataError(f"{n} training rows are too few for {p} terms; use more flights or fewer terms")
    scale = np.linalg.norm(a, axis=0)
    if not np.all(np.isfinite(scale)) or np.any(scale == 0):
        raise DataError("a regressor is zero or not finite over the training rows; remove it")
    scaled = a / scale
    q, r = qr(scaled, mode="economic", check_finite=False)
    singular = np.linalg.svd(r, compute_uv=False)
    if singular[-1] < 1e-12 * singular[0]:
        raise DataError("the regressors are combinations of each other; remove one of them")
    theta = solve_triangular(r, q.T @ z)
    residuals = z - scaled @ theta
    inverse = solve_triangular(r, np.eye(p))
    bread = inverse @ inverse.T
    sigma2 = float(residuals @ residuals) / (n - p)
    scores = scaled * residuals[:, None]
    if bandwidth is None:
        bandwidth = max(memory_windows(np.vstack([residuals, scores.T]), series))
        meat = flat_top(scores, series, bandwidth)
        variance = flat_top(residuals[:, None], series, bandwidth)[0, 0]
    else:
        meat = bartlett(scores, series, bandwidth)
        variance = bartlett(residuals[:, None], series, bandwidth)[0, 0]
    return Fit(
        coefficients=theta / scale,
        covariance=bread @ meat @ bread / np.outer(scale, scale),
        plain_covariance=sigma2 * bread / np.outer(scale, scale),
        residuals=residuals,
        sigma2=sigma2,
        condition=float(singular[0] / singular[-1]),
        inflation=_inflation(a, scale, bread),
        bandwidth=int(bandwidth),
        effective_rows=float(np.clip(n * (residuals @ residuals) / variance, 1.0, n)) if variance > 0 else float(n),
    )


def _inflation(a: np.ndarray, scale: np.ndarray, bread: np.ndarray) -> np.ndarray:
    constant = np.ptp(a, axis=0) == 0
    inflation = np.diag(bread).copy()
    if constant.any():
        # next to a constant, only what varies about the mean counts
        inflation *= a.var(axis=0) * len(a) / scale**2
        inflation[constant] = np.nan
    return inflation


def bartlett(scores: np.ndarray, series: Sequence[np.ndarray], bandwidth: int) -> np.ndarray:
    """Sum over lags |l| < bandwidth of (1 - |l|/bandwidth) sum_t s_t s_{t+l}', within flights. Returns (p, p).

    Equal to the mean over all windows of that length of the outer product of their sums, which takes one running sum.
    """
    total = np.zeros((scores.shape[1],) * 2)
    start = 0
    for rows in series:
        part = scores[start : start + len(rows)]
        start += len(rows)
        if not len(rows):
            continue
        length = int(rows[-1] - rows[0]) + 1
        dense = np.zeros((length + 2 * bandwidth, scores.shape[1]))
        dense[bandwidth + rows - rows[0]] = part
        running = np.cumsum(dense, axis=0)
        windows = running[bandwidth:] - running[:-bandwidth]
        total += windows.T @ windows / bandwidth
    return total


def flat_top(scores: np.ndarray, series: Sequence[np.ndarray], bandwidth: int) -> np.ndarray:
    """As `bartlett`, but lags up to half the bandwidth count fully, and weights fall to zero from there.

    Bartlett's weights take a fifth off the variance when the bandwidth is five times the memory. The price is that a
    variance may come out negative; then Bartlett's matrix is returned.
    Source: Politis & Romano, Journal of Time Series Analysis 16(1), 1995.
    """
    half = (bandwidth + 1) // 2
    whole = bartlett(scores, series, 2 * half)
    sharper = 2.0 * whole - bartlett(scores, series, half)
    scale = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    least = np.linalg.eigvalsh(sharper / np.outer(scale, scale))[0]
    return sharper if least > 0.0 else whole


def memory_window(values: np.ndarray, series: Sequence[np.ndarray], pairs: np.ndarray | None = None) -> int:
    """Lags over which values (n,) resemble themselves: the smallest window of five times the memory summed inside it.

    Missing rows are left out of the products. At least 1, at most a third of the longest flight. pairs  of
    `count_pairs`, where they are known
    """
    return memory_windows(values[None], series, pairs)[0]


def memory_windows(values: np.ndarray, series: Sequence[np.ndarray], pairs: np.ndarray | None = None) -> list[int]:
    """As `memory_window`, of each row of values (k, n)."""
    pairs = count_pairs(series) if pairs is None else pairs
    return [_window(products, pairs) for products in _sum_products(values, series)]


def count_pairs(series: Sequence[np.ndarray]) -> np.ndarray:
    """Pairs of rows (limit,) that are there, per lag; the same for all values of some rows."""
    return np.round(_sum_products(np.ones((1, sum(map(len, series)))), series)[0])


def _sum_products(values: np.ndarray, series: Sequence[np.ndarray]) -> np.ndarray:
    """Sums (k, limit) of products of each row of values (k, n) with itself, per lag, within flights."""
    longest = max((int(rows[-1] - rows[0]) + 1 for rows in series if len(rows)), default=1)
    limit = max(longest // 3, 1)
    size = fft.next_fast_len(longest + limit, real=True)
    total = np.zeros((len(values), limit))
    start = 0
    for rows in series:
        part = values[:, start : start + len(rows)]
        start += len(rows)
        if not len(rows):
            continue
        dense = np.zeros((len(values), size))
        dense[:, rows - rows[0]] = part
        total += fft.irfft(np.abs(fft.rfft(dense, axis=1)) ** 2, size, axis=1)[:, :limit]
    return total


def _window(product: np.ndarray, pairs: np.ndarray) -> int:
    """Window of sums of products (limit,) per lag over so many pairs (limit,)."""
    if product[0] <= 0:
        return 1
    rho = product / np.maximum(pairs, 1.0)
    rho = np.where(pairs > 0, rho / rho[0], 0.0)
    memory = np.maximum(2.0 * np.cumsum(rho) - 1.0, 0.0)
    enough = np.flatnonzero(np.arange(len(product)) >= MEMORY_WINDOW * memory)
    return max(int(enough[0]) if len(enough) else len(product), 1)


def ends_within(
    x: np.ndarray, k: int, step: float, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Values (p,) with entry k a step higher and lower, no further than its bounds, and the distance of both."""
    up, down = x.copy(), x.copy()
    up[k], down[k] = min(x[k] + step, high[k]), max(x[k] - step, low[k])
    return up, down, float(up[k] - down[k])
