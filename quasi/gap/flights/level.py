"""What the levels below aerodynamics share: flights as imported and filtered, their finding, and how causes are chosen.

A cause is taken when it stays significant beside all that is taken already, at a family-wise error rate. Of two causes
that explain the same, one beats the other when it stays significant with the other given and the other does not with
it given; when both lose, this data cannot tell them apart, and they are reported as a tie.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import f as f_distribution

from quasi.airframe import Airframe
from quasi.gap.statistics.mixed import Columns, Mixed, Offer, Test

MOST_TIED = 3
MOST_CAUSES = 8
DRAWS = 40  # resamples of a flight's blocks
COMMON = 0.2  # share of the false alarm rate for what reference and compared flights have in common


@dataclass(frozen=True)
class Flown:
    """One flight as it went through import and filter.

    compared  False for a reference flight, which is believed clean
    imported, filtered        their tables, row by row alike; metadata, filtered_metadata  what came with them
    """

    key: str
    compared: bool
    imported: pd.DataFrame
    metadata: Mapping[str, Any]
    filtered: pd.DataFrame
    filtered_metadata: Mapping[str, Any]
    airframe: Airframe


@dataclass
class Level:
    """What one level found; plain data but for the tables, written as the diagnosis writes it.

    effects           accepted causes, strongest first: id, since, parameters, p, wald, tau, evidence
    ties              ids that this data cannot split, with separability and tie_breaker
    findings          stated faults that are no cause
    candidates        causes that lost: id, since, score (Wald statistic), why_not
    cannot_be_asked   id and why
    tables            {name: table} of residuals for the report
    noise_floor       {channel: rms} that no cause of this level can explain
    tests             what causes were tested on, None where nothing could be asked
    found_on          what `material` needs to know of the flights that causes were found on
    healthy           of level A: constants ("values") and voltage that flights were compared with
    """

    level: str
    effects: list[dict[str, Any]] = field(default_factory=list)
    ties: list[dict[str, Any]] = field(default_factory=list)
    findings: list[dict[str, Any]] = field(default_factory=list)
    candidates: list[dict[str, Any]] = field(default_factory=list)
    cannot_be_asked: list[dict[str, Any]] = field(default_factory=list)
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    noise_floor: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    tests: "Tests | None" = None
    found_on: dict[str, Any] = field(default_factory=dict)
    healthy: dict[str, Any] = field(default_factory=dict)


@dataclass
class Choice:
    """Causes taken, the tie that each is in (alone if none), and the marginal test of every one that was offered."""

    taken: list[Offer] = field(default_factory=list)
    tied: dict[Offer, list[Offer]] = field(default_factory=dict)
    marginal: dict[Offer, Test] = field(default_factory=dict)
    why_not: dict[Offer, str] = field(default_factory=dict)
    witness: Mapping[frozenset[str], str] = field(default_factory=dict)

    @property
    def given(self) -> list[Offer]:
        """The taken causes and those tied with them."""
        return [offer for taken in self.taken for offer in self.tied[taken]]

    def rules_out(self, offer: Offer) -> bool:
        """Whether the offer is taken, or its twin is: only one of them is there."""
        return offer in self.given or any(
            offer.since == g.since and frozenset({offer.cause, g.cause}) in self.witness for g in self.given
        )

    def alternatives(self, without: Sequence[Offer] = ()) -> list[list[Offer]]:
        """What a test has to stand beside: of twins that are tied, one or the other."""
        ways: list[list[Offer]] = [[]]
        for taken in self.taken:
            tie = self.tied[taken]
            if any(o in without for o in tie):
                continue
            twins = [o for o in tie if any(frozenset({o.cause, t.cause}) in self.witness for t in tie)]
            others = [o for o in tie if o not in twins]
            ways = [[*way, *others, *one] for way in ways for one in ([[t] for t in twins] or [[]])]
        return ways

    def test(self, mixed: "Tests", offer: Offer, beside: Sequence[Offer] = (), without: Sequence[Offer] = ()) -> Test:
        """The offer beside everything taken: the least favourable alternative, with what they differ in as doubt."""
        pooled = mixed.pooled(offer.since)
        tests = [mixed.test(offer, [*way, *beside], pooled) for way in self.alternatives(without)]
        worst = max(tests, key=lambda test: (test.p, -test.wald))
        apart = np.array([test.value - worst.value for test in tests])
        return worst._replace(covariance=worst.covariance + apart.T @ apart)


class Tests(Mixed):
    """Tests whose nuisances have spreads known from many flights, not told by the few at hand.

    freedom   degrees of freedom that those spreads stand for, beside the flights' own
    unpooled  causes that the base holds already, with what is known of them
    common    {cause: standard deviation of what healthy set-ups have in all flights alike}, added to the covariance of
              what all flights have in common
    """

    informed = False

    def __init__(
        self, grams: Sequence[np.ndarray], compared: Sequence[bool], columns: Columns, freedom: float,
        prior: np.ndarray | None = None, unpooled: Sequence[str] = (), common: Mapping[str, float] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(grams, compared, columns._replace(unpooled=tuple(unpooled)), prior)
        self.common = dict(common or {})
        groups = 1 if self.compared.all() else 2
        self.freedom = max(len(grams) - groups, 1) + freedom

    def test(self, offer: Offer, given: Sequence[Offer] = (), pooled: Sequence[str] = ()) -> Test:
        """A cause with other causes given, see `Mixed.test`; what healthy set-ups have in common is no fault."""
        test = super().test(offer, given, pooled)
        size = self.common.get(offer.cause)
        if size is None or offer.since != "always":
            return test
        covariance = test.covariance + size**2 * np.eye(len(test.value))
        wald = float(test.value @ np.linalg.solve(covariance, test.value))
        p = float(f_distribution.sf(wald / len(test.value), len(test.value), self.freedom))
        return test._replace(covariance=covariance, wald=wald, p=max(p, test.p))


def offers_of(mixed: Tests, since: str) -> list[Offer]:
    """Every cause with all its parameters."""
    return [Offer(cause, since, tuple(range(len(columns)))) for cause, columns in mixed.columns.causes.items()]


def shares_of(compared: Sequence[bool]) -> dict[str, float]:
    """{since: share of the false alarm rate}: what changed between the groups is asked first, and costs most of it."""
    return {"always": 1.0} if np.all(compared) else {"changed": 1.0 - COMMON, "always": COMMON}


def choose(
    mixed: Tests, levels: Mapping[str, float], twinned: Sequence[frozenset[str]] = (),
    witness: Mapping[frozenset[str], str] | None = None, doubtful: Tests | None = None,
) -> Choice:  # fmt: skip
    """Take causes one after the other while the best is less probable by chance than allowed.

    levels    {since: probability}, in the order in which they are asked: changes between reference and compared flights
              are settled before what all flights have in common
    twinned   pairs of causes whose signatures are nearly the same: both stand in the tie unless one beats the other
    witness   {pair: cause}: twins of which only one can be there; one beats the other when, with the other given, this
              third cause is needed too, and with itself given it is not
    doubtful  the same tests with wider nuisances, which alone hear witnesses in what all flights have in common
    """
    choice = Choice(witness=witness or {})
    for since, level in levels.items():
        judge = mixed if doubtful is None or since == "changed" else doubtful
        while len(choice.taken) < MOST_CAUSES:
            offers = [o for o in offers_of(mixed, since) if not choice.rules_out(o)]
            tests = [choice.test(mixed, offer) for offer in offers]
            for test in tests:
                choice.marginal.setdefault(test.offer, test)
            found = sorted((t for t in tests if t.p < level), key=lambda t: (t.p, -t.wald))
            if not found:
                break
            best, tie = _duel(mixed, judge, found, choice, level, [*twinned, *choice.witness])
            choice.taken.append(best)
            choice.tied[best] = tie
            _drop(mixed, choice, levels)
    for offer, test in choice.marginal.items():
        if offer not in choice.given and offer not in choice.why_not:
            last, level = choice.test(mixed, offer), levels[offer.since]
            choice.why_not[offer] = (
                f"explained by {', '.join(sorted({o.cause for o in choice.given}))}"
                if test.p < level
                else f"p = {last.p:.2g}, not below {level:.2g}"
            )
    return choice


def _duel(
    mixed: Tests, judge: Tests, found: Sequence[Test], choice: Choice, level: float,
    twinned: Sequence[frozenset[str]],
) -> tuple[Offer, list[Offer]]:  # fmt: skip
    """The winner of the significant causes by the nested rule, and all that are tied with it, itself first."""

    def stands(offer: Offer, beside: Offer) -> bool:
        third = choice.witness.get(frozenset({offer.cause, beside.cause}))
        if third is None:
            return choice.test(mixed, offer, [beside]).p < level
        called = next(o for o in offers_of(mixed, offer.since) if o.cause == third)
        if called in choice.given:
            return False  # it is there anyway and tells nothing
        needed = [choice.test(judge, called, [o]).p < level for o in (beside, offer)]
        return needed[0] and not needed[1]

    champion = found[0].offer
    for rival in (t.offer for t in found[1:]):
        if stands(rival, champion) and not stands(champion, rival):
            choice.why_not[champion] = f"{rival.cause} explains the same and more"
            champion = rival
    tie = [champion]
    offers = [t.offer for t in found]
    # a twin that fell short by a little is a twin all the same
    twins = {c for pair in twinned if champion.cause in pair for c in pair}
    offers += [o for o in offers_of(mixed, champion.since) if o.cause in twins and o not in offers]
    for rival in offers:
        if rival == champion or choice.rules_out(rival) or len(tie) == MOST_TIED:
            continue
        own, other = stands(champion, rival), stands(rival, champion)
        if not own and not other:
            tie.append(rival)
        elif own and not other:
            choice.why_not[rival] = f"{champion.cause} explains the same and more"
    return champion, tie


def _drop(mixed: Tests, choice: Choice, levels: Mapping[str, float]) -> None:
    """Take back causes that later ones made needless."""
    for offer in choice.taken[:-1]:
        if choice.test(mixed, offer, without=choice.tied[offer]).p >= levels[offer.since]:
            choice.taken.remove(offer)
            del choice.tied[offer]
            choice.why_not[offer] = f"needless beside {choice.taken[-1].cause}"


def final_test(mixed: Tests, choice: Choice, offer: Offer) -> Test:
    """A cause beside all others that were taken, those of its own tie left out."""
    own = next(tie for tie in choice.tied.values() if offer in tie)
    return choice.test(mixed, offer, without=own)


class Clear(NamedTuple):
    """Standard errors by which a cause of some size stands out: alone, and beside each rival that is offered too."""

    detectability: float
    beside: dict[str, float]

    @property
    def nearest(self) -> str | None:
        """The rival beside which it stands out least."""
        return min(self.beside, key=self.beside.get, default=None)

    @property
    def separability(self) -> float:
        """Standard errors beside the nearest rival."""
        return self.beside[self.nearest] if self.beside else self.detectability


def clear(mixed: Tests, cause: str, since: str, size: np.ndarray) -> Clear:
    """How clearly a cause of a given size (m,) shows in the flights: sqrt(size' covariance^-1 size).

    size  deviation from healthy in the units of the cause's columns. The covariance is that of the cause's parameters
    once base, nuisances and the spread between flights are projected out, then the rival too.
    """
    offer = next(o for o in offers_of(mixed, since) if o.cause == cause)
    pooled = mixed.pooled(since)

    def shown(given: Sequence[Offer]) -> float:
        covariance = mixed.test(offer, given, pooled).covariance
        return float(np.sqrt(max(size @ np.linalg.solve(covariance, size), 0.0)))

    return Clear(shown([]), {o.cause: shown([o]) for o in offers_of(mixed, since) if o.cause != cause})


def separability(mixed: Tests, choice: Choice, first: Offer, second: Offer) -> float:
    """Standard errors by which the first stands out with the second given as well."""
    own = next(tie for tie in choice.tied.values() if first in tie)
    return float(np.sqrt(max(choice.test(mixed, first, [second], own).wald, 0.0)))


def probability(
    draw: Callable[[np.random.Generator], list[np.ndarray]], build: Callable[[list[np.ndarray]], Tests], choice: Choice,
    levels: Mapping[str, float], seed: int = 0,
) -> dict[Offer, float]:  # fmt: skip
    """Share of resamples, each flight's blocks drawn anew, in which each taken cause is significant again.

    draw  makes per-flight cross-products (P, P) of one resample; build  makes the tests of them
    """
    rng = np.random.default_rng(seed)
    counts = dict.fromkeys(choice.taken, 0)
    if not counts:
        return {}
    for _ in range(DRAWS):
        drawn = build(draw(rng))
        for offer in counts:
            counts[offer] += final_test(drawn, choice, offer).p < levels[offer.since]
    return {offer: count / DRAWS for offer, count in counts.items()}


def resampled(blocks: Sequence[np.ndarray]) -> Callable[[np.random.Generator], list[np.ndarray]]:
    """Draws of flights whose cross-products are sums over blocks (B, P, P)."""
    return lambda rng: [b[rng.integers(0, len(b), len(b))].sum(axis=0) for b in blocks]
