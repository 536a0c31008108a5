"""Linear mixed models on cross-products: what a candidate cause explains beyond what flights differ by anyway.

Whitened residual y of flight f:

    y_f = B beta + N_f nu_f + C (theta g_f + e_f) + noise,   nu_f ~ N(0, S),  e_f ~ N(0, tau^2 D_f)

B: the model's own terms, fitted anew, common to all flights. N: nuisances that each flight has its own value of, with
known spread (mass, thrust factor, seating, biases). Each of several sessions adds values of its own, with known spreads
as well (trim of the rotors, biases), that its flights share. C: the columns of a cause, theta its parameters; g_f = 1
where the cause is offered (all flights, or the compared ones alone). e_f: how much the cause's apparent parameters
differ between flights; the size of that spread, tau, is estimated by restricted maximum likelihood. It is the spread
between flights, not that between samples, that decides whether a cause is there. Its form is the likelier of two: D
alike for all, where the thing itself differs from flight to flight, or D_f in proportion to the inverse of the flight's
own information, where a model that errs a little looks like a large parameter in flights that hardly excite it.

Everything works on per-flight cross-products of the columns (y, B, N, C...), so that a test costs small linear algebra
however long the flights are.
Sources: Pinheiro & Bates, MixedModel-Effects Models in S and S-PLUS, 2000, sections 2.2 and 2.4; Harville, Maximum
likelihood approaches to variance component estimation, JASA 72, 1977; Vovk & Wang, Combining p-values via averaging,
Biometrika 107, 2020.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import fdtrc

from quasi.gap.statistics.candidates import MOST_FREEDOM, Candidate, Columns, Test

SPREADS = 2.0 ** np.arange(0, 11)  # tau, in standard errors that one flight alone would give
ALL_NEEDED_P = 0.05  # p-value of the other parameters with the likeliest one given, below which all of them are needed
FAINT = 1e-6  # of the usual information, that a flight without any is taken to have
COMMON_SHARE = 0.2  # share of the false alarm rate for what reference and compared flights have in common
PATIENCE = 3  # spreads in a row that are less likely before the search for the likeliest ends
SPANNED = 0.02  # share of a column that others leave
CERTAIN = 1e-3  # as good as no spread
RIDGE = 1e-9  # of scaled columns, so that interchangeable ones share instead of breaking the solution


def marginal(gram: np.ndarray, columns: Sequence[int], spread: np.ndarray) -> np.ndarray:
    """Cross-products (P, P) once the columns' random coefficients, N(0, spread^2), are integrated out."""
    columns = list(columns)
    if not columns:
        return gram
    inner = gram[np.ix_(columns, columns)] + np.diag(1.0 / np.asarray(spread) ** 2)
    return gram - gram[:, columns] @ np.linalg.solve(inner, gram[columns, :])


def _inverse_root(matrix: np.ndarray) -> np.ndarray:
    """R with R matrix R' = 1; where rounding makes the matrix indefinite, its least eigenvalues are raised to RIDGE."""
    try:
        return np.linalg.inv(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(matrix)
        return (vectors / np.sqrt(np.maximum(values, RIDGE))).T


class _Given(NamedTuple):
    """What a test is conditioned on: the model's terms, given and pooled causes, ready to be taken out.

    source (z,) their columns; acting (z, F) 1 where a flight is offered one; size (z,) for scaling; root (z, z) that
    makes their scaled cross-products one; target (z,) root times their products with the target
    """

    source: np.ndarray
    acting: np.ndarray
    size: np.ndarray
    root: np.ndarray
    target: np.ndarray


class _Spectrum(NamedTuple):
    """A cause with deviations of one form, all that is given taken out, in the directions in which these are apart.

    known (n,) information on the deviations in units of their precision at tau = 1; cross (n, 1 + m) products of the
    deviations with target and cause; inner (1 + m, 1 + m) products of target and cause; least (m,) that rounding
    leaves of the cause's own
    """

    known: np.ndarray
    cross: np.ndarray
    inner: np.ndarray
    least: np.ndarray

    def at(self, taus: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """At each tau (T,): -2 log restricted likelihood but for a constant (T,), coefficients (T, m), covariance
        (T, m, m), squared error left (T,)."""
        count, size = self.cross.shape
        squares = (self.cross[:, :, None] * self.cross[:, None, :]).reshape(count, size * size)
        weights = 1.0 / (self.known + 1.0 / taus[:, None] ** 2)
        rest = self.inner - (weights @ squares).reshape(len(taus), size, size)
        own, diagonal = rest[:, 1:, 0], np.arange(size - 1)
        sizes = np.sqrt(np.maximum(rest[:, 1 + diagonal, 1 + diagonal], self.least))
        outer = sizes[:, :, None] * sizes[:, None, :]
        scaled = rest[:, 1:, 1:] / outer
        # what the compared flights do not show at all has no slope: nothing is known of it
        scaled[:, diagonal, diagonal] = np.maximum(scaled[:, diagonal, diagonal], RIDGE)
        inverse = np.linalg.inv(scaled) / outer
        value = (inverse @ own[:, :, None])[:, :, 0]
        left = rest[:, 0, 0] - (own * value).sum(axis=1)
        information = np.log1p(self.known * taus[:, None] ** 2).sum(axis=1)
        information += np.linalg.slogdet(scaled)[1] + 2.0 * np.log(sizes).sum(axis=1)
        return left + information, value, inverse, left


class MixedModel:
    """Flights' cross-products and the tests on them.

    grams     (P, P) per flight, or (K, P, P) where a flight is cut into K stretches, each with a deviation of its own;
              compared  (F,) bool, False for reference flights; columns  what is where
    prior     precision (S, S) of the shared columns' coefficients about 0, where they are known from elsewhere
    informed  whether a spread in proportion to a flight's information is considered as well
    sessions  name of each flight's session; () where they are not known
    """

    informed = True

    def __init__(
        self,
        grams: Sequence[np.ndarray],
        compared: Sequence[bool],
        columns: Columns,
        prior: np.ndarray | None = None,
        sessions: Sequence[str] = (),
    ) -> None:
        self.columns = columns
        labels = np.array(sessions, dtype=str)
        self.prior = prior
        self.compared = np.asarray(compared, bool)
        # one session among references and compared flights has no effect; compared with a model alone it has
        known = len(set(labels)) > 1 or (self.compared.all() and "" not in labels)
        self._sessions = [labels == name for name in sorted(set(labels))] if known else []
        parts = [g[None] if g.ndim == 2 else g for g in map(np.asarray, grams)]
        self._flight = np.repeat(np.arange(len(parts)), [len(g) for g in parts])
        self._stretch = np.concatenate([0.5 * (g + np.swapaxes(g, 1, 2)) for g in parts])
        self.count = len(self._stretch)
        self.freedom = max(self.count - (1 if self.compared.all() else 2), 1)
        # nuisances integrated out: what they take of a stretch, by half, is what couples the stretches of a flight
        own, size = columns.nuisance, self._stretch.shape[-1]
        flights = np.arange(len(parts))[:, None] == self._flight

        def summed(stretches: np.ndarray) -> np.ndarray:
            """Sums (F, ...) over the stretches (K, ...) of each flight."""
            return np.tensordot(flights.astype(float), stretches, 1)

        whole = summed(self._stretch)
        self._half = np.zeros((self.count, len(own), size))
        if own:
            inner = whole[:, own][:, :, own] + np.diag(1.0 / columns.spread**2)
            scale = np.sqrt(np.einsum("fii->fi", inner))
            root = np.linalg.inv(np.linalg.cholesky(inner / (scale[:, :, None] * scale[:, None, :])))
            self._half = (root / scale[:, None, :])[self._flight] @ self._stretch[:, own, :]
        halves = summed(self._half)
        self._within = self._stretch - np.swapaxes(self._half, 1, 2) @ halves[self._flight]  # stretch against flight
        self.grams = whole - np.swapaxes(halves, 1, 2) @ halves
        self._typical = np.einsum("fii->i", self.grams)
        self._taken_out: dict[tuple, _Given] = {}

    def offered(self, since: str) -> np.ndarray:
        """(F,) bool: flights that a cause is offered to."""
        if since == "reference":
            return ~self.compared
        return self.compared if since == "changed" else np.ones(len(self.compared), bool)

    def pooled(self, since: str | Sequence[str]) -> list[str]:
        """Causes whose columns belong to the base where changes between flights are asked: what all have alike is none.

        That holds for what the model's own terms take up as well: of other flights, and never quite.
        """
        return [c for c in self.columns.causes if c not in self.columns.unpooled] if "changed" in since else []

    def test(self, offer: Candidate, given: Sequence[Candidate] = (), pooled: Sequence[str] = ()) -> Test:
        """A cause with others given.

        given   offers already accepted; pooled  causes whose columns belong to the base here: fitted in all flights
                alike, without being claimed
        """
        own, flags = self.columns.of(offer), self.offered(offer.since)
        key = tuple(given), tuple(pooled)
        if key not in self._taken_out:
            self._taken_out[key] = self._given(given, pooled)
        unit = 1.0 / np.sqrt(np.maximum(self._typical[own] / self.count, 1e-300))
        alike = np.broadcast_to(np.eye(len(own)), (self.count, len(own), len(own)))
        forms = [alike]
        if self.informed:
            seen = self._stretch[:, own][:, :, own] * np.outer(unit, unit)
            forms.append(seen + FAINT * alike)
        among = self._among(own, unit)
        spectra = self._spectra(own, unit, flags, self._taken_out[key], forms, among)
        best = None
        for form, spectrum in zip(forms, spectra):
            criteria, *fits = spectrum.at(SPREADS)
            least, worse = np.inf, 0
            for k, criterion in enumerate(criteria):
                if best is None or criterion < best[0]:
                    best = criterion, SPREADS[k], form, *(fit[k] for fit in fits)
                worse = 0 if criterion < least else worse + 1
                least = min(least, criterion)
                if worse == PATIENCE:
                    break
        _, tau, form, value, covariance, left = best
        wald = float(value @ np.linalg.solve(covariance, value))
        # only the part of the variance that rests on tau is uncertain for want of flights (Satterthwaite)
        certain = spectra[0].at(np.array([CERTAIN]))[2][0]
        share = 1.0 - float(np.mean(np.diag(certain) / np.diag(covariance)))
        freedom = min(self.freedom / max(share, 1e-3) ** 2, MOST_FREEDOM)
        p = float(fdtrc(len(own), freedom, wald / len(own)))
        unlikely = left + self._spread_out(among, form / tau**2)
        return Test(offer, value * unit, covariance * np.outer(unit, unit), float(tau), wald, p, unlikely)

    def spans(self, wide: Candidate, narrow: Candidate, given: Sequence[Candidate] = ()) -> bool:
        """Whether the columns of one offer hold those of another, base and given taken out of both."""
        of_wide, of_narrow = self.columns.of(wide), self.columns.of(narrow)
        use = self.offered(wide.since) & self.offered(narrow.since)
        total = sum(g for g, used in zip(self.grams, use) if used)
        scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
        total = total / np.outer(scale, scale)
        # the base fits what all flights have alike; it cannot take up what the compared ones alone have
        base = self.columns.shared if wide.since == "always" else []
        known = list(dict.fromkeys([*base, *(c for o in given for c in self.columns.of(o))]))

        def left(columns: list[int], of: list[int]) -> np.ndarray:
            inner = total[np.ix_(columns, columns)] + RIDGE * np.eye(len(columns))
            cross = total[np.ix_(columns, of)]
            return np.diag(total[np.ix_(of, of)] - cross.T @ np.linalg.solve(inner, cross))

        before = left(known, of_narrow)
        after = left([*known, *(c for c in of_wide if c not in of_narrow)], of_narrow)
        return bool(np.all(after < SPANNED * before))

    def _given(self, given: Sequence[Candidate], pooled: Sequence[str]) -> _Given:
        """The model's terms, given and pooled causes, ready to be taken out."""
        everywhere = np.ones(len(self.compared), bool)
        blocks = [(self.columns.shared, everywhere), *((self.columns.of(o), self.offered(o.since)) for o in given)]
        known = {c for columns, offered in blocks[1:] if offered.all() for c in columns}
        precision = [0.0] * sum(len(columns) for columns, _ in blocks)
        # a pooled cause under test is offered twice: to all, and to the compared flights
        for cause in pooled:
            columns = self.columns.base.get(cause, self.columns.causes[cause])
            sizes = self.columns.bounds.get(cause, np.full(len(columns), np.inf))
            free = [(c, size) for c, size in zip(columns, sizes, strict=True) if c not in known]
            blocks.append(([c for c, _ in free], everywhere))
            precision += [size**-2.0 for _, size in free]
        for members in self._sessions:
            blocks.append((list(self.columns.session), members))
            precision += [size**-2.0 for size in self.columns.session_spread]
        source = np.array([c for columns, _ in blocks for c in columns], int)
        if not len(source):
            nothing = np.zeros(0)
            return _Given(source, np.zeros((0, len(everywhere))), nothing, np.zeros((0, 0)), nothing)
        acting = np.array([offered for columns, offered in blocks for _ in columns], float)
        total = np.einsum("if,jf,fij->ij", acting, acting, self.grams[:, source][:, :, source], optimize=True)
        if self.prior is not None:
            first = len(self.columns.shared)
            total[:first, :first] += self.prior
        total[np.diag_indices_from(total)] += precision
        size = np.sqrt(np.maximum(np.diag(total), 1e-300))
        root = _inverse_root(total / np.outer(size, size) + RIDGE * np.eye(len(size)))
        target = root @ (np.einsum("if,fi->i", acting, self.grams[:, 0][:, source]) / size)
        return _Given(source, acting, size, root, target)

    def _spectra(
        self, own: Sequence[int], unit: np.ndarray, flags: np.ndarray, given: _Given, forms: Sequence[np.ndarray],
        among: np.ndarray,
    ) -> list[_Spectrum]:  # fmt: skip
        """The cause of columns `own`, scaled by unit, offered to the flights of flags, with others given.

        forms  (K, m, m) precision of each stretch's deviation at tau = 1; among  see `_among`
        """
        place, m = [0, *own], len(own)
        scale = np.array([1.0, *unit])
        act = np.hstack([np.ones((len(flags), 1)), np.repeat(flags[:, None], m, axis=1)])  # (F, 1 + m)
        inner = np.einsum("fi,fj,fij->ij", act, act, self.grams[:, place][:, :, place]) * np.outer(scale, scale)
        least = RIDGE * np.diag(inner)[1:]
        inner[range(1, m + 1), range(1, m + 1)] += least
        rows = self._within[:, own] * unit[:, None]  # (K, m, P)
        deviations = (rows[:, :, place] * (act * scale)[self._flight][:, None, :]).reshape(-1, 1 + m)
        if len(given.source):
            with_own = np.einsum("if,f,fij->ij", given.acting, flags, self.grams[:, given.source][:, :, own])
            taken = np.column_stack([given.target, given.root @ (with_own * unit / given.size[:, None])])
            mixed = rows[:, :, given.source] * (given.acting.T / given.size)[self._flight][:, None, :]
            taking = mixed.reshape(-1, len(given.source)) @ given.root.T
            inner = inner - taken.T @ taken
            deviations = deviations - taking @ taken
            among = among - taking @ taking.T
        result = []
        for form in forms:
            root = np.linalg.inv(np.linalg.cholesky(form))  # (K, m, m)
            half = (root @ among.reshape(self.count, m, -1)).reshape(among.shape)
            whole = (root @ half.T.reshape(self.count, m, -1)).reshape(among.shape)
            known, directions = np.linalg.eigh(whole)
            cross = (root @ deviations.reshape(self.count, m, -1)).reshape(deviations.shape)
            result.append(_Spectrum(np.maximum(known, 0.0), directions.T @ cross, inner, np.maximum(least, 1e-200)))
        return result

    def _among(self, own: Sequence[int], unit: np.ndarray) -> np.ndarray:
        """Products (K m, K m) of the columns of every stretch with those of every other, nuisances integrated out."""
        m = len(own)
        half = self._half[:, :, own] * unit
        same = self._flight[:, None] == self._flight[None, :]
        among = -np.einsum("ani,bnj->aibj", half, half, optimize=True) * same[:, None, :, None]
        each = np.arange(self.count)
        among[each, :, each] += self._stretch[:, own][:, :, own] * np.outer(unit, unit)
        return among.reshape(self.count * m, self.count * m)

    def _spread_out(self, among: np.ndarray, precision: np.ndarray) -> float:
        """Log determinant that deviations of this precision (K, m, m) leave in the likelihood; among  see `_among`."""
        root = np.linalg.inv(np.linalg.cholesky(precision))
        m = precision.shape[1]
        half = (root @ among.reshape(self.count, m, -1)).reshape(self.count * m, -1)
        whole = (root @ half.T.reshape(self.count, m, -1)).reshape(self.count * m, -1)
        return float(np.linalg.slogdet(np.eye(len(whole)) + whole)[1])

    def best(
        self, cause: str, since: str, given: Sequence[Candidate] = (), pooled: Sequence[str] = (), parts: str = "any"
    ) -> Test | None:
        """The most significant selection of a cause's parameters that are not given yet; None when all are given.

        parts  "any": all of them, or one alone (the likeliest); "all": only together; "alike": together, equal or not;
        "rotors": equal, or one alone, the likeliest; "first": the first, or the first few; "one": one alone, the
        likeliest; "led": the first, and once that is given each other; "paired": as "any" of the first half, the first
        one with its partner of the second half where that is needed, and of the second half those whose partner is
        given
        """
        count = len(self.columns.causes[cause])
        taken = {k for o in given if o.cause == cause and o.since == since for k in o.which}
        barred = self.columns.barred.get(cause, frozenset()) if since == "changed" else frozenset()
        free = tuple(k for k in range(count) if k not in taken | barred and (count not in taken or parts == "rotors"))
        partners: list[tuple[int, ...]] = []
        if parts == "paired":
            half = count // 2
            partners = [(k,) for k in free if k >= half and k - half in taken]
            free = tuple(k for k in free if k < half)
        if not free and not partners:
            return None
        selections = [free] if free else []
        if parts in ("any", "paired") and len(free) > 1:
            selections += [(k,) for k in free]
        elif parts == "alike" and cause in self.columns.alike:
            selections.append((count,))
        elif parts == "rotors":
            selections = [*(() if taken else [(count,)]), *((k,) for k in free)]
        elif parts == "led":
            selections = [(k,) for k in free] if 0 in taken else [free[:1]]
        elif parts == "one":
            selections = [(k,) for k in free]
        elif parts == "first":
            selections = [free[: n + 1] for n in range(len(free))]
        tests, paired = (
            [self.test(Candidate(cause, since, which), given, pooled) for which in of] for of in (selections, partners)
        )
        if parts in ("any", "paired", "alike") and len(tests) > 1:
            best = self._single_or_all(tests[0], tests[1:], given, pooled)
        else:
            best = min(tests, key=lambda test: test.unlikely if parts in ("one", "rotors") else test.p, default=None)
        if parts == "paired" and best is not None and len(best.offer.which) == 1 and not taken:
            best = self._with_partner(best, count // 2, given, pooled)
        best = min((t for t in (best, *paired) if t is not None), key=lambda test: test.p)
        return best._replace(p=min(best.p * (len(selections) + len(partners)) * self.columns.tries.get(cause, 1), 1.0))

    def _with_partner(self, single: Test, half: int, given: Sequence[Candidate], pooled: Sequence[str]) -> Test:
        """A parameter together with the one that accompanies it, where each is needed with the other given."""
        cause, since, (k,) = single.offer
        pair = [Candidate(cause, since, (n,)) for n in (k, k + half)]
        needed = all(self.test(a, [*given, b], pooled).p < ALL_NEEDED_P for a, b in (pair, pair[::-1]))
        both = self.test(Candidate(cause, since, (k, k + half)), given, pooled)
        return both if needed and both.p < single.p else single

    def _single_or_all(
        self, whole: Test, singles: Sequence[Test], given: Sequence[Candidate], pooled: Sequence[str]
    ) -> Test:
        """All parameters of a cause together, or the likeliest single one, or what they have in common.

        The likelihood chooses between single parameters. Their p-values cannot: the true parameter's may be larger than
        that of another one, because its spread between stretches is estimated anew. A test of all parameters counts for
        the single one where the others are not significant with it given.
        """
        single = min(singles, key=lambda test: test.unlikely)
        if single.p <= whole.p:
            return single
        common = single.offer.which == (len(whole.offer.which),)
        rest = whole.offer.which[1:] if common else tuple(k for k in whole.offer.which if k not in single.offer.which)
        others = self.test(Candidate(*whole.offer[:2], rest), [*given, single.offer], pooled)
        return whole if others.p < ALL_NEEDED_P else single._replace(p=whole.p)


def ranked(
    mixed: MixedModel,
    causes: Sequence[tuple[str, str]],
    given: Sequence[Candidate] = (),
    pooled: Sequence[str] = (),
    parts: Mapping[str, str] | None = None,
) -> list[Test]:
    """Tests of (cause, since) pairs, the least probable to be nothing first.

    parts  {cause: how its parameters may be selected}, see MixedModel.best
    """
    tests = [mixed.best(cause, since, given, pooled, (parts or {}).get(cause, "any")) for cause, since in causes]
    return sorted((t for t in tests if t is not None), key=lambda test: (test.p, -test.wald))


def share_of_rate(compared: Sequence[bool]) -> dict[str, float]:
    """{since: share of the false alarm rate}: changes between the groups are selected first, with most of it."""
    return {"always": 1.0} if np.all(compared) else {"changed": 1.0 - COMMON_SHARE, "always": COMMON_SHARE}
