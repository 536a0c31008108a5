"""What flights could show before they are flown: the standard error that each cause's parameter would have.

The same mixed model that names causes (`quasi.gap.statistics.mixed`): the model's own terms fitted anew, what flights
differ by with its usual spread, and a deviation of the cause from stretch to stretch whose size restricted
maximum likelihood finds. Flights that are repeats of each other are worked out once and counted as often as they are
flown.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import f as f_distribution

from quasi.gap.effect import Effect
from quasi.gap.statistics.candidates import MOST_FREEDOM, Candidate, Columns
from quasi.gap.statistics.mixed import (
    CERTAIN,
    FAINT,
    PATIENCE,
    RIDGE,
    SPANNED,
    SPREADS,
    MixedModel,
    marginal,
    share_of_rate,
)

EMPTY_COLUMN = 1e-70  # of a column that is nothing
POWER = 1.28  # standard errors above the threshold: nine of ten repeats are named


class Repeated(NamedTuple):
    """Stretches (K, P + D N, ...) of one flight that is flown N = compared + reference times.

    The first P columns are those of the study (the first is not used); after them the residuals, N for each of D draws.
    """

    stretches: np.ndarray
    compared: int
    reference: int

    @property
    def count(self) -> int:
        """How often it is flown."""
        return self.compared + self.reference


class Spread(NamedTuple):
    """Size of a cause's deviations between stretches, in standard errors of one; informed  in proportion to each
    stretch's own information, otherwise alike."""

    tau: float
    informed: bool


class Sight(NamedTuple):
    """What is expected of one parameter.

    size (its unit), std (alike), t = size/std of it alone; with_rival (t with the nearest rival given) and that rival
    needed  t at which nine of ten repeats are named
    absorbed  whether the model's own terms take the cause up whatever is flown; taken  whether they do here
    """

    cause: str
    parameter: str
    size: float
    t: float
    with_rival: float
    rival: str | None
    needed: float
    absorbed: bool = False
    taken: bool = False

    @property
    def verdict(self) -> str:
        """ "seen", "tie" or "not seen"."""
        if self.absorbed or self.t < self.needed:
            return "not seen"
        return "seen" if self.with_rival >= self.needed else "tie"


class Row(NamedTuple):
    """One cause. sight  of its least visible parameter; all  of every one that has a typical size"""

    effect: Effect
    sight: Sight
    all: tuple[Sight, ...]


class Outlook:
    """Expected tests on repeated flights.

    flights   what is flown how often; columns  what is what in them; size, draws  P and D of `Repeated`
    effects   the causes of the columns; rate  false alarm rate shared by them
    together  whether a cause is always tested with all its parameters, as the levels below aerodynamics do
    freedom   degrees of freedom that the nuisances' spreads stand for in addition to the flights' own
    prior     precision (S, S) of the shared columns' coefficients about 0
    """

    def __init__(
        self,
        flights: Sequence[Repeated],
        columns: Columns,
        size: int,
        draws: int,
        effects: Mapping[str, Effect],
        rate: float,
        together: bool = False,
        freedom: float = 0.0,
        prior: np.ndarray | None = None,
    ) -> None:
        self.together, self.prior = together, prior
        self.flights, self.columns, self.size, self.draws, self.effects = list(flights), columns, size, draws, effects
        self.since = "changed" if any(f.reference for f in flights) else "always"
        self.asked = [c for c in columns.causes if not self.absorbed(c)]
        shares = share_of_rate([not f.reference for f in self.flights])
        self.level = rate * shares[self.since] / max(len(self.asked), 1)
        count = sum(f.count * len(f.stretches) for f in self.flights)
        self.freedom = max(count - (2 if self.since == "changed" else 1), 1) + freedom
        alone = [f.stretches[:, :size, :size] for f in self.flights]  # how many residuals follow depends on the flight
        self._whole = MixedModel(alone, [True] * len(self.flights), columns)
        self._kept: tuple[tuple[Candidate, Spread] | None, list[tuple[np.ndarray, float]]] = None, []

    def absorbed(self, cause: str) -> bool:
        """Whether the model's own terms take the cause up, so that without reference flights nothing is left of it."""
        return self.since == "always" and self.effects[cause].absorbed_by_model

    def taken_up(self, offer: Candidate) -> bool:
        """Whether terms that the model has anyway hold the cause's columns: fitted anew, they leave nothing of them."""
        if self.since == "changed" or not self.columns.shared:
            return False
        own = [self.columns.causes[offer.cause][k] for k in offer.which]
        total = sum(g * f.count for g, f in zip(self._whole.grams, self.flights))
        scale = np.maximum(np.sqrt(np.maximum(np.diag(total), 0.0)), EMPTY_COLUMN)
        total = total / np.outer(scale, scale)
        base = self.columns.shared
        inner = total[np.ix_(base, base)] + RIDGE * np.eye(len(base))
        cross = total[np.ix_(base, own)]
        left = np.diag(total[np.ix_(own, own)] - cross.T @ np.linalg.solve(inner, cross))
        return bool(np.all(left < SPANNED))

    def sight(self, cause: str, parameter: str, size: float) -> Sight:
        """What is expected of a parameter of a cause at a size, the nearest rival looked for among all causes."""
        offer = self.offer(cause, parameter)
        if self.absorbed(cause):
            return Sight(cause, parameter, size, 0.0, 0.0, None, np.inf, True)
        spread, covariance, share = self.test(offer)
        nearest, least = None, np.inf
        for other in self.asked:
            if other == cause or self._simpler(offer, other):
                continue
            t = self._t(offer, parameter, size, self.covariance(offer, spread, self.whole(other)))
            nearest, least = (other, t) if t < least else (nearest, least)
        t = self._t(offer, parameter, size, covariance)
        needed = self.needed(offer, share)
        taken = t < needed and self.prior is None and self.taken_up(offer)
        return Sight(cause, parameter, size, t, min(least, t), nearest, needed, False, taken)

    def look(self, cause: str, parameter: str, size: float, rivals: Sequence[str]) -> Sight:
        """As `sight`, among some rivals alone: for comparing many plans."""
        rivals = [r for r in rivals if r in self.asked]
        offer = self.offer(cause, parameter)
        spread, covariance, share = self.test(offer)
        t = self._t(offer, parameter, size, covariance)
        by_rival = {r: self._t(offer, parameter, size, self.covariance(offer, spread, self.whole(r))) for r in rivals}
        nearest = min(by_rival, key=by_rival.get, default=None)
        return Sight(cause, parameter, size, t, min([t, *by_rival.values()]), nearest, self.needed(offer, share))

    def offer(self, cause: str, parameter: str) -> Candidate:
        """The parameter alone, or all of a cause whose parameters are found together."""
        effect = self.effects[cause]
        names = effect.fitted
        if self.together or effect.parts in ("all", "alike"):
            return self.whole(cause)
        return Candidate(cause, self.since, (names.index(parameter),))

    def whole(self, cause: str) -> Candidate:
        """A cause with all its parameters."""
        return Candidate(cause, self.since, tuple(range(len(self.columns.causes[cause]))))

    def needed(self, offer: Candidate, share: float) -> float:
        """|t| at which nine of ten repeats pass the threshold of naming. share  of the variance that rests on tau."""
        effect, m = self.effects[offer.cause], len(offer.which)
        n = len(effect.fitted)
        numbers = {
            "any": n + 1 if n > 1 else 1,
            "paired": n // 2 + 1,
            "first": n,
            "one": n,
            "all": 1,
            "alike": 2,
            "led": 1,
        }
        selections = (1 if self.together else numbers[effect.parts]) * self.columns.tries.get(offer.cause, 1)
        freedom = min(self.freedom / max(share, 1e-3) ** 2, MOST_FREEDOM)
        return float(np.sqrt(m * f_distribution.isf(self.level / selections, m, freedom)) + POWER)

    def _t(self, offer: Candidate, parameter: str, size: float, covariance: np.ndarray) -> float:
        theta = np.zeros(len(offer.which))
        theta[offer.which.index(self.effects[offer.cause].fitted.index(parameter))] = size
        return float(np.sqrt(max(theta @ np.linalg.solve(covariance, theta), 0.0)))

    def _simpler(self, offer: Candidate, other: str) -> bool:
        """Whether the other is no rival because it only holds this one among more parameters: the simpler is named."""
        wide = self.whole(other)
        return len(wide.which) > len(offer.which) and self._whole.spans(wide, offer)

    def test(self, offer: Candidate) -> tuple[Spread, np.ndarray, float]:
        """The spread, covariance (m, m) of the parameters and the share of the variance that rests on the spread."""
        spread, covariance = self.spread(offer)
        _, certain = self._solve(offer, Spread(CERTAIN, False), None)
        return spread, covariance, 1.0 - float(np.mean(np.diag(certain) / np.diag(covariance)))

    def spread(self, offer: Candidate) -> tuple[Spread, np.ndarray]:
        """The most likely of the spreads that the search tries, and the covariance there."""
        best = None
        # without residuals nothing speaks for more than the least
        for informed in (False, True) if self.draws else (False,):
            least, worse = np.inf, 0
            for tau in SPREADS if self.draws else SPREADS[:1]:
                spread = Spread(float(tau), informed)
                criterion, covariance = self._solve(offer, spread, None)
                if best is None or criterion < best[0]:
                    best = criterion, spread, covariance
                worse = 0 if criterion < least else worse + 1
                least = min(least, criterion)
                if worse == PATIENCE:
                    break
        return best[1], best[2]

    def covariance(self, offer: Candidate, spread: Spread, given: Candidate) -> np.ndarray:
        """Covariance (m, m) of the parameters with another cause, at a spread that is known."""
        return self._solve(offer, spread, given)[1]

    def _remainders(self, offer: Candidate, assumed: Spread, alike: np.ndarray) -> list[tuple[np.ndarray, float]]:
        """Each flight's `_left`. No other cause enters it: it is kept for all rivals, which are looked at in turn."""
        if self._kept[0] != (offer, assumed):
            own, found = [self.columns.causes[offer.cause][k] for k in offer.which], []
            for flight in self.flights:
                precision = np.broadcast_to(alike, (len(flight.stretches), *alike.shape))
                if assumed.informed:
                    precision = flight.stretches[:, own][:, :, own] + FAINT * alike
                found.append(_left(flight.stretches, own, precision / assumed.tau**2, self.columns))
            self._kept = (offer, assumed), found
        return self._kept[1]

    def _solve(self, offer: Candidate, assumed: Spread, given: Candidate | None) -> tuple[float, np.ndarray]:
        """-2 log likelihood, averaged over the residuals, and covariance; with a given cause the covariance alone."""
        columns = self.columns
        own = [columns.causes[offer.cause][k] for k in offer.which]
        others = [] if given is None else [columns.causes[given.cause][k] for k in given.which]
        pooled = []
        if self.since == "changed":
            pooled = [c for n, part in columns.causes.items() if n not in columns.unpooled for c in part]
        common = [*columns.shared, *pooled]
        count = sum(len(f.stretches) * f.count for f in self.flights)
        typical = sum(f.count * self._whole.grams[k][own, own] for k, f in enumerate(self.flights))
        alike = np.diag(np.maximum(typical / count, EMPTY_COLUMN**2))
        # those that all flights have, then what is offered to the compared ones alone
        source, head, wide = [*common, *others, *own], self.draws if given is None else 0, len(common)
        total, logs = np.zeros((head + len(source),) * 2), 0.0
        for flight, (gram, log) in zip(self.flights, self._remainders(offer, assumed, alike)):
            logs += flight.count * log
            total[head:, head:] += flight.compared * gram[np.ix_(source, source)]
            total[head : head + wide, head : head + wide] += flight.reference * gram[np.ix_(common, common)]
            at = self.size + np.arange(head * flight.count).reshape(head, flight.count)
            total[range(head), range(head)] += gram[at, at].sum(axis=1)
            cross = gram[at][:, :, source]
            cross[:, flight.compared :, wide:] = 0.0
            total[:head, head:] += cross.sum(axis=1)
        if self.prior is not None:
            base = slice(head, head + len(columns.shared))
            total[base, base] += self.prior
        # what all flights have alike is bounded, as in MixedModel.test
        bounds = {c: b for n in columns.bounds for c, b in zip(columns.causes[n], columns.bounds[n])}
        for k, column in enumerate(pooled, head + len(columns.shared)):
            total[k, k] += bounds.get(column, np.inf) ** -2.0
        scale = np.maximum(np.sqrt(np.maximum(np.diag(total), 0.0)), EMPTY_COLUMN)
        scaled = total / np.outer(scale, scale)
        inner = scaled[head:, head:] + RIDGE * np.eye(len(source))
        inverse = np.linalg.inv(inner)
        explained = np.einsum("ij,jk,ik->i", scaled[:head, head:], inverse, scaled[:head, head:])
        squares = float(np.sum(scale[:head] ** 2 * (1.0 - explained))) / max(head, 1)
        information = float(np.linalg.slogdet(inner)[1] + 2.0 * np.log(scale[head:]).sum())
        part, unit = slice(len(source) - len(own), None), scale[-len(own) :]
        return squares + logs + information, inverse[part, part] / np.outer(unit, unit)


def _left(
    stretches: np.ndarray, own: Sequence[int], precision: np.ndarray, columns: Columns
) -> tuple[np.ndarray, float]:
    """A flight's cross-products once the stretches' deviations, of this precision (K, m, m), and the flight's nuisances
    are integrated out; the log determinant that this leaves."""
    own = list(own)
    cross = stretches[:, own, :]
    inner = cross[:, :, own] + precision
    size = stretches.shape[-1]
    weighted = np.linalg.solve(inner, cross).reshape(-1, size)
    rest = stretches.sum(axis=0) - cross.reshape(-1, size).T @ weighted
    log = float(np.linalg.slogdet(inner)[1].sum() - np.linalg.slogdet(precision)[1].sum())
    if columns.nuisance:
        part = rest[np.ix_(columns.nuisance, columns.nuisance)] * np.outer(columns.spread, columns.spread)
        log += float(np.linalg.slogdet(np.eye(len(part)) + part)[1])
        rest = marginal(rest, columns.nuisance, columns.spread)
    return rest, log
