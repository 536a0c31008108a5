"""Linear mixed models on cross-products: what a candidate cause explains beyond what flights differ by anyway.

Whitened residual y of flight f:

    y_f = B beta + N_f nu_f + C (theta g_f + e_f) + noise,   nu_f ~ N(0, S),  e_f ~ N(0, tau^2 D)

B: the model's own terms, fitted anew, common to all flights. N: nuisances that each flight has its own value of, with
known spread (mass, thrust factor, seating, biases). C: the columns of a cause, theta its parameters; g_f = 1 where the
cause is offered (all flights, or the compared ones alone). e_f: how much the cause's apparent parameters differ between
flights; the size of that spread, tau, is estimated by restricted maximum likelihood. It is the spread between flights,
not that between samples, that decides whether a cause is there.

Everything works on per-flight cross-products of the columns (y, B, N, C...), so that a test costs small linear algebra
however long the flights are.
Sources: Pinheiro & Bates, Mixed-Effects Models in S and S-PLUS, 2000, sections 2.2 and 2.4; Harville, Maximum
likelihood approaches to variance component estimation, JASA 72, 1977.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import f as f_distribution

SPREADS = 2.0 ** np.arange(0, 11)  # tau, in standard errors that one flight alone would give
RIDGE = 1e-9  # of scaled columns, so that interchangeable ones share instead of breaking the solution
PRIOR_FREEDOM = 4.0  # degrees of freedom that the floor of tau stands for

Offer = tuple[str, str]  # cause and "always" or "changed"


class Columns(NamedTuple):
    """Which columns of the cross-products are what; column 0 is the target."""

    shared: list[int]
    nuisance: list[int]
    spread: np.ndarray  # (len(nuisance),) standard deviations of the nuisances
    causes: dict[str, list[int]]


class Test(NamedTuple):
    """One cause beside what is given: parameters (m,), their covariance, Wald statistic, probability of nothing."""

    offer: Offer
    value: np.ndarray
    covariance: np.ndarray
    tau: float
    wald: float
    p: float

    @property
    def std(self) -> np.ndarray:
        """Standard errors (m,)."""
        return np.sqrt(np.diag(self.covariance))


def marginal(gram: np.ndarray, columns: Sequence[int], spread: np.ndarray) -> np.ndarray:
    """Cross-products (P, P) once the columns' random coefficients, N(0, spread^2), are integrated out."""
    columns = list(columns)
    if not columns:
        return gram
    inner = gram[np.ix_(columns, columns)] + np.diag(1.0 / np.asarray(spread) ** 2)
    return gram - gram[:, columns] @ np.linalg.solve(inner, gram[columns, :])


class Mixed:
    """Flights' cross-products and the tests on them.

    grams     (P, P) per flight; compared  (F,) bool, False for reference flights; columns  what is where
    """

    def __init__(self, grams: Sequence[np.ndarray], compared: Sequence[bool], columns: Columns) -> None:
        self.columns = columns
        self.compared = np.asarray(compared, bool)
        self.grams = [marginal(g, columns.nuisance, columns.spread) for g in grams]
        self.freedom = max(len(grams) - (1 if self.compared.all() else 2), 1) + PRIOR_FREEDOM

    def offered(self, since: str) -> np.ndarray:
        """(F,) bool: flights that a cause is offered to."""
        return self.compared if since == "changed" else np.ones(len(self.compared), bool)

    def test(self, offer: Offer, given: Sequence[Offer] = (), pooled: Sequence[str] = ()) -> Test:
        """A cause beside what is given.

        offer   (cause, since); given  offers already accepted; pooled  causes whose columns belong to the base here:
                fitted in all flights alike, without being claimed
        """
        cause, since = offer
        own = self.columns.causes[cause]
        others = [(self.columns.causes[c], self.offered(s)) for c, s in given]
        others += [(self.columns.causes[c], self.offered("always")) for c in pooled if (c, "always") not in given]
        # a pooled cause under test is offered twice: to all, and to the compared flights
        blocks = [*others, (own, self.offered(since))]
        typical = sum(g[own, own] for g in self.grams) / len(self.grams)
        unit = 1.0 / np.sqrt(np.maximum(typical, 1e-300))
        best = None
        for tau in SPREADS:
            spread = tau * unit
            grams, logs = [], 0.0
            for g in self.grams:
                inner = g[np.ix_(own, own)] + np.diag(1.0 / spread**2)
                logs += np.linalg.slogdet(inner * np.outer(spread, spread))[1]
                grams.append(g - g[:, own] @ np.linalg.solve(inner, g[own, :]))
            left, value, covariance, information = self._solve(grams, blocks)
            criterion = left + logs + information
            if best is None or criterion < best[0]:
                best = criterion, tau, value[-len(own) :], covariance[-len(own) :, -len(own) :]
        _, tau, value, covariance = best
        wald = float(value @ np.linalg.solve(covariance, value))
        p = float(f_distribution.sf(wald / len(own), len(own), self.freedom))
        return Test(offer, value, covariance, float(tau), wald, p)

    def _solve(self, grams: Sequence[np.ndarray], blocks: Sequence[tuple[list[int], np.ndarray]]) -> tuple:
        """Squared error left, the blocks' coefficients with covariance, log determinant of the information."""
        base = self.columns.shared
        size = 1 + len(base) + sum(len(c) for c, _ in blocks)
        total = np.zeros((size, size))
        for f, gram in enumerate(grams):
            source, place = [0, *base], list(range(1 + len(base)))
            at = len(place)
            for columns, offered in blocks:
                if offered[f]:
                    source += columns
                    place += range(at, at + len(columns))
                at += len(columns)
            total[np.ix_(place, place)] += gram[np.ix_(source, source)]
        scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
        scaled = total / np.outer(scale, scale)
        inner = scaled[1:, 1:] + RIDGE * np.eye(size - 1)
        inverse = np.linalg.inv(inner)
        solution = inverse @ scaled[1:, 0]
        left = scale[0] ** 2 * float(1.0 - scaled[1:, 0] @ solution)
        part = slice(len(base), size - 1)
        unit = scale[1:][part]
        information = float(np.linalg.slogdet(inner)[1] + 2.0 * np.log(scale[1:]).sum())
        return left, solution[part] * scale[0] / unit, inverse[part, part] / np.outer(unit, unit), information


def ranked(
    mixed: Mixed, offers: Sequence[Offer], given: Sequence[Offer] = (), pooled: Sequence[str] = ()
) -> list[Test]:
    """Tests of several offers, the least probable to be nothing first."""
    tests = [mixed.test(offer, given, pooled) for offer in offers if offer not in given]
    return sorted(tests, key=lambda test: (test.p, -test.wald))
