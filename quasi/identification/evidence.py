"""How sure a term is, the residuals' memory counted: t of every candidate and of every term from sums over cells.

A cell is a stretch of flight longer than the residuals remember, so that sums over cells are nearly independent pieces
of evidence, and their scatter shows how much a hundred thousand rows that resemble their neighbours really know. The
scatter itself is only known from so many pieces, fewer when a few cells hold most of what a column has to say;
Student's t has that many degrees of freedom.

Source: Bell & McCaffrey, Survey Methodology 28(2), 2002 (leverage correction and degrees of freedom of clustered
errors; here for one regressor after the others are taken out); Newey & West, Econometrica 55(3), 1987 (neighbouring
cells); Vuong, Econometrica 57(2), 1989 (comparing two models by the scatter of their difference).
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import stdtr

from quasi.identification.products import Products

INDEPENDENT = 1e-9  # smallest share of a column that must be left after the selected ones
LEAST_DISTINGUISHABLE_T = 3.0  # standard errors by which a replacement must be worse to be distinguished


class Totals:
    """Sums of products over cells, each cell counted `weights` (B,) times; all once when None.

    square, target (m,); target_square, rows, spread (squares of the target about its mean)  numbers
    """

    def __init__(self, products: Products, weights: np.ndarray | None = None) -> None:
        self.products, self.fixed, self.size = products, products.fixed, products.size
        self.weights = np.ones(len(products.rows)) if weights is None else np.asarray(weights, float)
        self.square = self.weights @ products.square
        self.target = self.weights @ products.target
        self.target_square = float(self.weights @ products.target_square)
        self.rows = round(float(self.weights @ products.rows))
        self.spread = self.target_square - float(self.weights @ products.target_sum) ** 2 / max(self.rows, 1)
        self._cross: dict[int, np.ndarray] = {}
        self._inverse: dict[tuple[int, ...], np.ndarray] = {}
        self._left_out: dict[tuple[int, ...], np.ndarray] = {}
        self._last: tuple[tuple[int, ...], np.ndarray] = ((), np.zeros(0))

    def cross(self, column: int, promising: np.ndarray | None = None) -> np.ndarray:
        """Products (m,) of a column with all columns; `promising` (m,) ranks what else may be wanted soon."""
        if column not in self._cross:
            self._cross[column] = self.weights @ self.products.cross(column, promising)
        return self._cross[column]

    def gram(self, columns: Sequence[int]) -> np.ndarray:
        """Products (p, p) among columns."""
        gram = np.array([self.cross(k)[list(columns)] for k in columns]).reshape(len(columns), -1)
        return 0.5 * (gram + gram.T)

    def inverse(self, columns: Sequence[int]) -> np.ndarray:
        """Inverse of `gram`."""
        key = tuple(columns)
        if key not in self._inverse:
            gram = self.gram(columns)
            scale = np.sqrt(np.diag(gram))
            self._inverse[key] = np.linalg.inv(gram / np.outer(scale, scale)) / np.outer(scale, scale)
        return self._inverse[key]

    def grams(self, columns: Sequence[int]) -> np.ndarray:
        """Products (B, p, p) among columns, per cell; those of the same columns follow one another."""
        key = tuple(columns)
        if key != self._last[0] or not key:
            place, found = list(key), np.empty((len(self.weights), len(key), len(key)))
            for i, k in enumerate(key):
                found[:, i] = self.products.cross(k)[:, place]
            self._last = key, found
        return self._last[1]

    def left_out(self, columns: Sequence[int]) -> np.ndarray:
        """`left_out` of these columns; a search asks for those of its present model many times."""
        key = tuple(columns)
        if key not in self._left_out:
            self._left_out[key] = left_out(self, list(columns))
        return self._left_out[key]


def _scores(totals: Totals, columns: list[int], theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # per cell: Gram (B, p, p) of the columns, and products (B, p) of the columns with the residuals
    gram = totals.grams(columns)
    return gram, totals.products.target[:, columns] - gram @ theta


def _judge(totals: Totals, scores, energy, bandwidth: int) -> tuple[np.ndarray, np.ndarray]:
    # scores (B, q) of single columns with the residuals of a model without them, energy (B, q) of the columns per cell
    total = totals.weights @ scores
    whole = totals.weights @ energy
    whole = np.where(whole > 0.0, whole, np.inf)
    share = np.clip(energy / whole, 0.0, 1.0 - 1e-9)
    # what is left once the column is in, freed of the part that each cell bends the fit towards itself
    left = (scores - share * total) / np.sqrt(1.0 - share)
    left[totals.weights == 0.0] = 0.0
    variance, shared = totals.weights @ left**2, totals.weights @ share**2
    for weight, later, before in _neighbours(totals, bandwidth):
        variance += 2.0 * weight * np.einsum("bq,bq->q", left[later], left[before])
        # Satterthwaite: of a weighted sum of products, squares of the weights count
        shared += 2.0 * weight**2 * np.einsum("bq,bq->q", share[later], share[before])
    with np.errstate(all="ignore"):
        t = np.where(variance > 0.0, total / np.sqrt(variance), 0.0)
    return t, np.maximum(1.0 / np.maximum(shared, 1e-12) - 1.0, 0.1)


def _neighbours(totals: Totals, bandwidth: int) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    # Bartlett weight, and the cells that lie so far apart within one flight
    flight = totals.products.flight
    for lag in range(1, min(bandwidth, len(flight))):
        before = np.flatnonzero(flight[lag:] == flight[:-lag])
        yield 1.0 - lag / bandwidth, before + lag, before


def entering(totals: Totals, columns: list[int], bandwidth: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Student's t and its degrees of freedom, (m,) each, of every column, were it added to the model of `columns`.

    bandwidth  neighbouring cells whose scores may still resemble each other, the cell itself counted
    """
    products = totals.products
    inverse = totals.inverse(columns)
    theta = inverse @ totals.target[columns]
    onto = inverse @ np.array([totals.cross(k) for k in columns])
    gram, own = _scores(totals, columns, theta)
    scores = products.target - own @ onto
    energy = products.square.copy()
    for i, k in enumerate(columns):
        cross = products.cross(k)
        scores -= theta[i] * cross
        energy += onto[i] * (gram[:, i] @ onto - 2.0 * cross)
    reached = totals.weights @ energy > INDEPENDENT * totals.square
    reached[columns] = False
    t, freedom = _judge(totals, scores, np.maximum(energy, 0.0), bandwidth)
    return np.where(reached, t, 0.0), freedom


def standing(totals: Totals, columns: list[int], bandwidth: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Student's t and its degrees of freedom, (p,) each, of every column of a model given its others."""
    inverse = totals.inverse(columns)
    theta = inverse @ totals.target[columns]
    gram, own = _scores(totals, columns, theta)
    apart = inverse / np.diag(inverse)  # column k: what is left of column k after the others
    energy = ((gram @ apart) * apart).sum(axis=1)
    return _judge(totals, own @ apart + theta * energy, np.maximum(energy, 0.0), bandwidth)


def probability(t: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """Probability of so large a |t| of a term that is nothing."""
    return 2.0 * stdtr(freedom, -np.abs(t))


def left_out(totals: Totals, columns: list[int]) -> np.ndarray:
    """Squared error (F,) of each flight under the coefficients that the others have in common.

    Infinite where these do not separate the columns; flights without weight do not count.
    """
    products, weights = totals.products, totals.weights
    member = (products.flight == np.unique(products.flight[weights > 0.0])[:, None]) * weights
    gram = np.tensordot(member, totals.grams(columns), axes=1)
    target, errors = member @ products.target[:, columns], member @ products.target_square
    rest = gram.sum(axis=0) - gram
    scale = np.sqrt(np.maximum(np.diagonal(rest, axis1=1, axis2=2), 1e-300))
    rest = rest / (scale[:, :, None] * scale[:, None, :])
    apart = ~(np.linalg.cond(rest) > 1.0 / INDEPENDENT)
    goal = (target.sum(axis=0) - target) / scale
    found = np.linalg.solve(rest[apart], goal[apart][:, :, None])[:, :, 0] / scale[apart]
    errors[~apart] = np.inf
    for f, theta in zip(np.flatnonzero(apart), found):
        errors[f] = max(errors[f] - 2.0 * theta @ target[f] + theta @ gram[f] @ theta, 0.0)
    return errors


def interchangeable(totals: Totals, columns: list[int], bandwidth: int = 1) -> dict[int, list[dict[str, float]]]:
    """Columns that could stand for one of the model's own without the data noticing.

    Returns {column: [{"column", "share of gain", "worse by"}, ...]} for the columns that are not fixed, best first.
    "share of gain" compares how much the two lower the squared error; "worse by" is the difference of the squared
    errors in its own standard errors, from its scatter over cells: below LEAST_DISTINGUISHABLE_T
    the data cannot distinguish the two.
    """
    products, found = totals.products, {}
    for taken in columns[totals.fixed :]:
        rest = [k for k in columns if k != taken]
        inverse = totals.inverse(rest)
        theta = inverse @ totals.target[rest]
        onto = inverse @ np.array([totals.cross(k) for k in rest])
        gram, own = _scores(totals, rest, theta)
        scores, energy = products.target - own @ onto, products.square.copy()
        for i, k in enumerate(rest):
            cross = products.cross(k)
            scores -= theta[i] * cross
            energy += onto[i] * (gram[:, i] @ onto - 2.0 * cross)
        total, whole = totals.weights @ scores, totals.weights @ energy
        usable = whole > INDEPENDENT * totals.square
        usable[rest] = False
        whole = np.where(usable, whole, 1.0)
        gain = np.where(usable, total**2 / whole, 0.0)
        slope = np.where(usable, total / whole, 0.0)
        # squared error per cell less that of the model without either
        change = -2.0 * slope * scores + slope**2 * energy
        worse = change - change[:, [taken]]
        mean = totals.weights @ worse
        centred = worse - mean / totals.weights.sum()
        spread = totals.weights @ centred**2
        for weight, later, before in _neighbours(totals, bandwidth):
            spread += 2.0 * weight * np.einsum("bq,bq->q", centred[later], centred[before])
        with np.errstate(all="ignore"):
            distance = np.where(spread > 0.0, mean / np.sqrt(spread), np.where(mean > 0.0, np.inf, 0.0))
        alike = usable & (distance < LEAST_DISTINGUISHABLE_T) & (gain > 0.5 * gain[taken])
        alike[taken] = False
        order = sorted(np.flatnonzero(alike), key=lambda k: -gain[k])
        found[taken] = [
            {"column": int(k), "share of gain": float(gain[k] / gain[taken]), "worse by": float(distance[k])}
            for k in order
        ]
    return found
