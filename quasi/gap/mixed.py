"""Linear mixed models on cross-products: what a candidate cause explains beyond what flights differ by anyway.

Whitened residual y of flight f:

    y_f = B beta + N_f nu_f + C (theta g_f + e_f) + noise,   nu_f ~ N(0, S),  e_f ~ N(0, tau^2 D_f)

B: the model's own terms, fitted anew, common to all flights. N: nuisances that each flight has its own value of, with
known spread (mass, thrust factor, seating, biases). C: the columns of a cause, theta its parameters; g_f = 1 where the
cause is offered (all flights, or the compared ones alone). e_f: how much the cause's apparent parameters differ between
flights; the size of that spread, tau, is estimated by restricted maximum likelihood. It is the spread between flights,
not that between samples, that decides whether a cause is there. Its form is the likelier of two: D alike for all, where
the thing itself differs from flight to flight, or D_f in proportion to the inverse of the flight's own information,
where a model that errs a little looks like a large parameter in flights that hardly excite it.

Everything works on per-flight cross-products of the columns (y, B, N, C...), so that a test costs small linear algebra
however long the flights are.
Sources: Pinheiro & Bates, Mixed-Effects Models in S and S-PLUS, 2000, sections 2.2 and 2.4; Harville, Maximum
likelihood approaches to variance component estimation, JASA 72, 1977.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import f as f_distribution

SPREADS = 2.0 ** np.arange(0, 11)  # tau, in standard errors that one flight alone would give
FAINT = 1e-6  # of the usual information, that a flight without any is taken to have
PATIENCE = 3  # spreads in a row that are less likely before the search for the likeliest ends
SPANNED = 0.02  # share of a column that others leave
CERTAIN = 1e-3  # as good as no spread
MOST_FREEDOM = 40.0  # the known spreads are not that well known
RIDGE = 1e-9  # of scaled columns, so that interchangeable ones share instead of breaking the solution


class Offer(NamedTuple):
    """A cause, the flights it is offered to ("always": all, "changed": the compared ones), which of its parameters."""

    cause: str
    since: str
    which: tuple[int, ...]


class Columns(NamedTuple):
    """Which columns of the cross-products are what; column 0 is the target."""

    shared: list[int]
    nuisance: list[int]
    spread: np.ndarray  # (len(nuisance),) standard deviations of the nuisances
    causes: dict[str, list[int]]


class Test(NamedTuple):
    """One cause beside what is given: parameters (m,), their covariance, Wald statistic, probability of nothing.

    p counts that the best of several selections of the cause's parameters was taken.
    """

    offer: Offer
    value: np.ndarray
    covariance: np.ndarray
    tau: float
    wald: float
    p: float
    unlikely: float = 0.0  # -2 log likelihood at this spread, up to a constant: for choosing between selections

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


def _integrated(grams: np.ndarray, columns: Sequence[int], precision: np.ndarray) -> tuple[np.ndarray, float]:
    """Cross-products (..., n, n) with the columns' random coefficients of this precision (..., m, m) integrated out,
    each its own, and the log determinant that this leaves in the likelihood."""
    cross = grams[..., columns, :]
    size = np.sqrt(np.diagonal(precision, axis1=-2, axis2=-1))
    scaled = precision / (size[..., :, None] * size[..., None, :])
    inner = cross[..., columns] / (size[..., :, None] * size[..., None, :]) + scaled
    cross = cross / size[..., :, None]
    weighted = np.linalg.solve(inner, cross)
    log = float(np.linalg.slogdet(inner)[1].sum())
    log -= float(np.linalg.slogdet(scaled)[1].sum()) * (inner.size // scaled.size)
    return grams - np.swapaxes(cross, -1, -2) @ weighted, log


class Mixed:
    """Flights' cross-products and the tests on them.

    grams     (P, P) per flight, or (K, P, P) where a flight is cut into K stretches, each with a deviation of its own;
              compared  (F,) bool, False for reference flights; columns  what is where
    prior     precision (S, S) of the shared columns' coefficients about 0, where they are known from elsewhere
    informed  whether a spread in proportion to a flight's information is considered as well
    """

    informed = True

    def __init__(
        self,
        grams: Sequence[np.ndarray],
        compared: Sequence[bool],
        columns: Columns,
        prior: np.ndarray | None = None,
    ) -> None:
        self.columns = columns
        self.prior = prior
        self.compared = np.asarray(compared, bool)
        self._stretches = [g[None] if g.ndim == 2 else g for g in map(np.asarray, grams)]
        self.grams = [marginal(g.sum(axis=0), columns.nuisance, columns.spread) for g in self._stretches]
        self._typical = sum(np.diag(g) for g in self.grams)
        # flights side by side; those with fewer stretches have empty ones, which say nothing
        most = max(len(g) for g in self._stretches)
        self._all = np.zeros((len(self._stretches), most, *self._stretches[0].shape[1:]))
        for padded, stretches in zip(self._all, self._stretches):
            padded[: len(stretches)] = stretches
        self.count = sum(len(g) for g in self._stretches)
        self.freedom = max(self.count - (1 if self.compared.all() else 2), 1)

    def offered(self, since: str) -> np.ndarray:
        """(F,) bool: flights that a cause is offered to."""
        return self.compared if since == "changed" else np.ones(len(self.compared), bool)

    def test(self, offer: Offer, given: Sequence[Offer] = (), pooled: Sequence[str] = ()) -> Test:
        """A cause beside what is given.

        given   offers already accepted; pooled  causes whose columns belong to the base here: fitted in all flights
                alike, without being claimed
        """
        own = self._of(offer)
        others = [(self._of(o), self.offered(o.since)) for o in given]
        known = {c for columns, offered in others if offered.all() for c in columns}
        for cause in pooled:
            free = [c for c in self.columns.causes[cause] if c not in known]
            others += [(free, self.offered("always"))] if free else []
        # a pooled cause under test is offered twice: to all, and to the compared flights
        blocks = [*others, (own, self.offered(offer.since))]
        unit = 1.0 / np.sqrt(np.maximum(self._typical[own] / self.count, 1e-300))
        use = list(dict.fromkeys([0, *self.columns.shared, *self.columns.nuisance, *(c for b, _ in blocks for c in b)]))
        place = {column: k for k, column in enumerate(use)}
        grams = self._all[:, :, use][:, :, :, use]
        mine = [place[c] for c in own]
        alike = np.broadcast_to(np.diag(1.0 / unit**2), (*grams.shape[:2], len(own), len(own)))
        forms = [alike]
        if self.informed:
            forms.append(grams[:, :, mine][:, :, :, mine] + FAINT * alike)
        certain = self._fitted(grams, mine, alike / CERTAIN**2, blocks, place)[2]
        best = None
        for form in forms:
            least, worse = np.inf, 0
            for tau in SPREADS:
                criterion, *fit = self._fitted(grams, mine, form / tau**2, blocks, place)
                if best is None or criterion < best[0]:
                    best = criterion, tau, *fit
                worse = 0 if criterion < least else worse + 1
                least = min(least, criterion)
                if worse == PATIENCE:
                    break
        _, tau, value, covariance, unlikely = best
        wald = float(value @ np.linalg.solve(covariance, value))
        # only the part of the variance that rests on tau is uncertain for want of flights (Satterthwaite)
        share = 1.0 - float(np.mean(np.diag(certain) / np.diag(covariance)))
        freedom = min(self.freedom / max(share, 1e-3) ** 2, MOST_FREEDOM)
        p = float(f_distribution.sf(wald / len(own), len(own), freedom))
        return Test(offer, value, covariance, float(tau), wald, p, float(unlikely))

    def spans(self, wide: Offer, narrow: Offer, given: Sequence[Offer] = ()) -> bool:
        """Whether the columns of one offer hold those of another, base and given taken out of both."""
        of_wide, of_narrow = self._of(wide), self._of(narrow)
        use = self.offered(wide.since) & self.offered(narrow.since)
        total = sum(g for g, used in zip(self.grams, use) if used)
        scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
        total = total / np.outer(scale, scale)
        # the base fits what all flights have alike; it cannot take up what the compared ones alone have
        base = self.columns.shared if wide.since == "always" else []
        known = list(dict.fromkeys([*base, *(c for o in given for c in self._of(o))]))

        def left(columns: list[int], of: list[int]) -> np.ndarray:
            inner = total[np.ix_(columns, columns)] + RIDGE * np.eye(len(columns))
            cross = total[np.ix_(columns, of)]
            return np.diag(total[np.ix_(of, of)] - cross.T @ np.linalg.solve(inner, cross))

        before = left(known, of_narrow)
        after = left([*known, *(c for c in of_wide if c not in of_narrow)], of_narrow)
        return bool(np.all(after < SPANNED * before))

    def _of(self, offer: Offer) -> list[int]:
        columns = self.columns.causes[offer.cause]
        return [columns[k] for k in offer.which]

    def _fitted(
        self, grams: np.ndarray, own: Sequence[int], precision: np.ndarray,
        blocks: Sequence[tuple[list[int], np.ndarray]], place: Mapping[int, int],
    ) -> tuple[float, np.ndarray, np.ndarray, float]:  # fmt: skip
        """At a spread of the cause under test: restricted likelihood (-2 log), coefficients, covariance, likelihood.

        grams (F, K, n, n) of the columns in use, place {column: position among them}, own  positions of the cause's,
        precision (F, K, m, m) of its deviations
        """
        rest, log = _integrated(grams, own, precision)
        rest = rest.sum(axis=1)
        if self.columns.nuisance:
            known = np.diag(1.0 / self.columns.spread**2)
            rest, more = _integrated(rest, [place[c] for c in self.columns.nuisance], known)
            log += more
        left, value, covariance, information = self._solve(rest, blocks, place)
        own = slice(len(value) - len(own), len(value))
        return left + log + information, value[own], covariance[own, own], left + log

    def _solve(
        self, rest: np.ndarray, blocks: Sequence[tuple[list[int], np.ndarray]], place: Mapping[int, int]
    ) -> tuple:
        """Squared error left, the blocks' coefficients with covariance, log determinant of the information."""
        base = [place[c] for c in self.columns.shared]
        size = 1 + len(base) + sum(len(c) for c, _ in blocks)
        total = np.zeros((size, size))
        groups: dict[tuple[bool, ...], list[int]] = {}
        for f in range(len(rest)):
            groups.setdefault(tuple(bool(offered[f]) for _, offered in blocks), []).append(f)
        for pattern, flights in groups.items():
            source, at = [0, *base], list(range(1 + len(base)))
            first = len(at)
            for (columns, _), offered in zip(blocks, pattern):
                if offered:
                    source += [place[c] for c in columns]
                    at += range(first, first + len(columns))
                first += len(columns)
            total[np.ix_(at, at)] += rest[flights].sum(axis=0)[np.ix_(source, source)]
        if self.prior is not None:
            own = slice(1, 1 + len(base))
            total[own, own] += self.prior
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

    def best(
        self, cause: str, since: str, given: Sequence[Offer] = (), pooled: Sequence[str] = (), parts: str = "any"
    ) -> Test | None:
        """The most significant selection of a cause's parameters that are not given yet; None when all are given.

        parts  "any": all of them, or one alone; "all": only together; "first": the first, or the first few; "one": one
        alone, the likeliest
        """
        taken = {k for o in given if o.cause == cause and o.since == since for k in o.which}
        free = tuple(k for k in range(len(self.columns.causes[cause])) if k not in taken)
        if not free:
            return None
        selections = [free]
        if parts == "any" and len(free) > 1:
            selections += [(k,) for k in free]
        elif parts == "one":
            selections = [(k,) for k in free]
        elif parts == "first":
            selections = [free[: n + 1] for n in range(len(free))]
        tests = [self.test(Offer(cause, since, which), given, pooled) for which in selections]
        best = min(tests, key=lambda test: test.unlikely if parts == "one" else test.p)
        return best._replace(p=min(best.p * len(selections), 1.0))


def ranked(
    mixed: Mixed,
    causes: Sequence[tuple[str, str]],
    given: Sequence[Offer] = (),
    pooled: Sequence[str] = (),
    parts: Mapping[str, str] | None = None,
) -> list[Test]:
    """Tests of (cause, since) pairs, the least probable to be nothing first.

    parts  {cause: how its parameters may be selected}, see Mixed.best
    """
    tests = [mixed.best(cause, since, given, pooled, (parts or {}).get(cause, "any")) for cause, since in causes]
    return sorted((t for t in tests if t is not None), key=lambda test: (test.p, -test.wald))
