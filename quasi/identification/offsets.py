"""Flights that differ by a constant: a battery seated elsewhere, a bias of the day.

One intercept over all flights puts such constants into the slopes: where the trim of the rotors balances the moment of
a displaced cg, the moment is that of another trim, and the lever comes out too short. The intercept of flight f is
therefore drawn about a common one, with the variance tau2 between flights:

    z_f = X_f theta + u_f + e_f,    var u_f = tau2,    psi_f = tau2 n_f / (M sigma2 + tau2 n_f)

n_f are its rows, M the rows over which residuals of variance sigma2 resemble each other. Generalised least squares of
this model is least squares after the share 1 - sqrt(1 - psi_f) of a flight's means has been taken off both sides. With
tau2 = 0 that is one intercept; with a large tau2 only what varies within flights counts, and in between flights at
constant speeds keep what they show between them.

The moment of a displaced cg follows the thrust, and so does that of a weaker rotor. What thrust changes of a flight's
own offset would be left to whatever moves with thrust, such as climb: it is taken off the target (`shape_of`).

Source: Fuller & Battese, Journal of the American Statistical Association 68, 1973 (the share of the means); Patterson
& Thompson, Biometrika 58, 1971 (tau2 by restricted likelihood).
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize_scalar

from quasi.identification.products import Pool, Products
from quasi.identification.regression import Fit, flat_top, least_squares, memory_window
from quasi.terms.rotor_map import SPEEDS

TARGET_ROUNDING = 1e-12  # of the target's squares, that a difference of products is known to: less of an error is none
RATIOS = (1e-6, 1e6)  # of tau2 to the variance of a flight's mean: from none to all


MOMENTS = ("Mx", "My", "Mz")
OFFSET_ROUNDS = 3  # of choosing or fitting terms and of estimating by which offsets flights differ


def shape_of(axis: str, columns: Mapping[str, np.ndarray], rows: np.ndarray, scale: np.ndarray | float) -> np.ndarray:
    """Shape (n,), of mean 1, of what one flight differs by from others in some of its rows (n,): of a moment the
    thrust, by the squared rotor speeds "w1".."w4" of the columns, of a force a constant.

    scale  that the axis is divided by, for each row of the columns or for all
    """
    if axis not in MOMENTS or not all(w in columns for w in SPEEDS):
        return np.ones(len(rows))
    thrust = (sum(np.asarray(columns[w], float) ** 2 for w in SPEEDS) / scale)[rows]
    known = np.isfinite(thrust)
    if not thrust[known].any():
        return np.ones(len(rows))
    return np.where(known, thrust / thrust[known].mean(), 1.0)


def offsets_of(residuals: np.ndarray, share: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Likeliest offset (F,) of each flight: its mean residual, less what chance makes of one."""
    parts = np.split(residuals, np.cumsum(sizes)[:-1])
    return np.array([(1.0 - (1.0 - s) ** 2) * p.mean() if len(p) else 0.0 for p, s in zip(parts, share)])


class LessOffsets(Products):
    """Products after a share of each flight's means is taken off columns and target.

    products  the first of their columns is the constant
    share     (F,) of the means, by number of the flight
    """

    def __init__(self, products: Products, share: np.ndarray) -> None:
        self.whole, self.share = products, share
        flights, place = np.unique(products.flight, return_inverse=True)
        gather = (place == np.arange(len(flights))[:, None]).astype(float)
        rows = gather @ products.rows
        self._sums = products.cross(0)
        self._means = ((gather @ self._sums) / rows[:, None])[place]
        self._part = np.asarray(share)[products.flight]
        z, total = ((gather @ products.target_sum) / rows)[place], products.target_sum
        n, s = products.rows, self._part
        both = self._means * total[:, None] + z[:, None] * self._sums
        super().__init__(
            products.fixed,
            n,
            products.flight,
            self._less(products.square, n, self._means, self._sums),
            products.target - s[:, None] * both + (s**2 * n * z)[:, None] * self._means,
            products.target_square - 2.0 * s * z * total + s**2 * n * z**2,
            total - s * n * z,
        )

    def _less(self, products: np.ndarray, rows: np.ndarray, mean: np.ndarray, total: np.ndarray) -> np.ndarray:
        # products (B, m) of a column, whose flight means and cell sums are given, with all columns
        s, n = self._part[:, None], rows[:, None]
        return products - s * (mean * self._sums + self._means * total) + s**2 * n * mean * self._means

    def cross(self, column: int, promising: np.ndarray | None = None) -> np.ndarray:
        """Products (B, m) of a column with all columns; `promising` (m,) ranks what else may be wanted soon."""
        if column not in self.crossed:
            known = self.whole.cross(column, promising)
            self.crossed[column] = self._less(known, self.rows, self._means[:, [column]], self._sums[:, [column]])
        return self.crossed[column]

    def subset(self, columns: Sequence[int]) -> Products:
        """All products among some of the columns, the fixed ones first."""
        part = LessOffsets(self.whole.subset(columns), self.share)
        for k in range(len(columns)):
            part.cross(k)
        return part


def less_means(values: np.ndarray, sizes: Sequence[int], share: Sequence[float]) -> np.ndarray:
    """Values (n, ...) of flights of so many rows (F,), less a share (F,) of each flight's mean."""
    out, start = np.array(values, float), 0
    for size, part in zip(sizes, share):
        rows = slice(start, start + size)
        start += size
        if size and part:
            out[rows] -= part * out[rows].mean(axis=0)
    return out


def shares_of_pool(
    pool: Pool, columns: Sequence[int], residuals: np.ndarray, series: Sequence[np.ndarray]
) -> np.ndarray:
    """As `shares`, for the model of some columns of a pool, whose residuals (n,) are known."""
    columns = list(columns)
    gather = (pool.flight == np.arange(len(series))[:, None]).astype(float)
    sums = np.column_stack([gather @ pool.cross(0)[:, columns], gather @ pool.target_sum])
    gram = np.array([pool.cross(k)[:, columns].sum(axis=0) for k in columns])
    target = pool.target[:, columns].sum(axis=0)
    both = np.block([[gram, target[:, None]], [target[None], np.array([[pool.target_square.sum()]])]])
    return _shares(both, sums, residuals, series)


def shares(columns: np.ndarray, target: np.ndarray, series: Sequence[np.ndarray]) -> np.ndarray:
    """Share (F,) of each flight's means that generalised least squares takes off.

    columns (n, p), a constant among them; target (n,); series  row numbers per flight, which cover the rows in order
    tau2 is the maximum of the restricted likelihood. With one flight, or residuals that are rounding, it is 0.
    """
    both = np.column_stack([columns, target])
    ends = np.cumsum([0, *(len(rows) for rows in series)])
    sums = np.array([both[i:j].sum(axis=0) for i, j in pairwise(ends)])
    residuals = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
    return _shares(both.T @ both, sums, residuals, series)


def _shares(both: np.ndarray, sums: np.ndarray, residuals: np.ndarray, series: Sequence[np.ndarray]) -> np.ndarray:
    # both (p + 1, p + 1): products of columns and target; sums (F, p + 1) of them per flight
    sizes = [len(rows) for rows in series]
    rows, none = np.array(sizes, float), np.zeros(len(sizes))
    within = less_means(residuals, sizes, np.ones(len(sizes)))
    energy = float(within @ within)
    if np.count_nonzero(rows) < 2 or energy <= TARGET_ROUNDING * both[-1, -1]:
        return none
    memory = max(flat_top(within[:, None], series, memory_window(within, series))[0, 0] / energy, 1.0)
    freedom = float(rows.sum()) / memory - (len(both) - 1)
    if freedom <= 0.0:
        return none
    scale = np.sqrt(np.maximum(np.diag(both), 1e-300))
    both, mean = both / np.outer(scale, scale), sums / scale / np.maximum(rows, 1.0)[:, None]

    def taken(ratio: float) -> np.ndarray:
        return ratio * rows / (memory + ratio * rows)

    def criterion(ratio: float) -> float:
        """Twice the negative restricted log-likelihood, less constants."""
        left = (both - (mean.T * (taken(ratio) * rows)) @ mean) / memory
        (sign, size), (whole, log) = np.linalg.slogdet(left[:-1, :-1]), np.linalg.slogdet(left)
        if sign <= 0.0 or whole <= 0.0:
            return np.inf
        # the Schur complement is the squared error
        return float(freedom * (log - size) + size - np.sum(np.log1p(-taken(ratio))))

    about = memory / float(np.mean(rows[rows > 0]))
    found = minimize_scalar(lambda x: criterion(about * np.exp(x)), bounds=np.log(RATIOS), method="bounded")
    return 1.0 - np.sqrt(1.0 - taken(about * np.exp(found.x))) if found.fun < criterion(0.0) else none


def fit_with_offsets(columns: np.ndarray, target: np.ndarray, series: Sequence[np.ndarray]) -> Fit:
    """Least squares of target (n,) on columns (n, p) and a constant, the last, where flights differ by a constant.

    Raises DataError as `least_squares` does.
    """
    constant = np.ones((len(columns), 1))
    whole = np.hstack([columns / np.maximum(np.abs(columns).max(axis=0), 1e-300), constant])
    share, sizes = shares(whole, target, series), [len(rows) for rows in series]
    both = less_means(np.hstack([columns, constant, target[:, None]]), sizes, share)
    return least_squares(both[:, :-1], both[:, -1], series)
