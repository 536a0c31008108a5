"""Selection of causes, the same for sensors, drive and forces: forward search, dominance, ties, backward elimination.

A cause is accepted when it is significant with all accepted causes given, at a false alarm rate that all tests of the
step share, and when it dominates its rivals: it stays significant with a rival given, and the rival does not with it
given. Causes that explain each other away form a tie, and none of them is named. Every accepted cause must stay
significant with all causes that are accepted later.

What changed between reference and compared flights is selected first, then what all flights have in common. The levels
differ in the tests that they provide (`quasi.gap.statistics.mixed`) and in `Rules`.
Source: forward selection and backward elimination, Draper & Smith, Applied Regression Analysis, 3rd ed., 1998, ch. 15.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from quasi.gap.profile import Profile
from quasi.gap.statistics.candidates import Candidate, Test
from quasi.gap.statistics.mixed import MixedModel, ranked, share_of_rate

COMPARED_RIVALS = 6  # most significant causes that are compared with each other in one step
MOST_CAUSES = 12  # causes that one search accepts
FORM_ERROR = 0.05  # share of a cause's Wald statistic that the error of its form may explain, in forces and moments
SUSPECT = 0.01  # p-value below which a declared rival has to be ruled out
RESAMPLES = 40  # of the blocks of each flight
UNPHYSICAL = "its size would be outside what is physical"
TINY = 1e-300  # p-value below which none is distinguished
EXCESSIVE = "it would make so much that the error of its form alone exceeds all that the model leaves of an axis"


class Rules(NamedTuple):
    """How a level selects.

    form_error  share of a cause's Wald statistic that the error of its form may explain: 0 where columns are exact
    witness     {pair: cause}: of two causes with nearly the same signature the one is there without which this third
                cause is needed; judge  tests for that, None for the level's own
    overlap     (test, another one) -> share of what the first cause explains that lies where the other one explains as
                well: an error of its form can only be there
    excess      test -> mean square of what a change makes of an axis, as a multiple of all that the model leaves there
    """

    form_error: float = FORM_ERROR
    witness: Mapping[frozenset[str], str] = {}
    judge: MixedModel | None = None
    overlap: Callable[[Test, Test], float] = lambda _, __: 1.0
    excess: Callable[[Test], float] = lambda _: 0.0

    def is_excessive(self, test: Test) -> bool:
        """Whether the error of a cause's form alone exceeds all that the model leaves of an axis."""
        return self.form_error * self.excess(test) > 1.0


FORCES = Rules()  # forms of forces and moments err
EXACT = Rules(form_error=0.0)  # columns of sensors and drive are exact


class Rival(NamedTuple):
    """A cause that was significant when another was named: p-values alone and with the other given."""

    id: str
    p: float
    p_given_cause: float


class Named(NamedTuple):
    """An accepted cause, its test with all other accepted causes given, and the rivals that it dominates."""

    test: Test
    rivals: list[Rival]


class Tie(NamedTuple):
    """Causes that explain each other away; the test of each with the accepted causes given."""

    tests: list[Test]
    separability: float  # |t| of the first with its nearest rival given
    apart: float = 1.0  # how many times further apart the axes of the first are than its standard errors say


@dataclass
class Selection:
    """Result of a search.

    named, ties  accepted causes, most significant first, and ties; ranking  the last tests of all candidates
    level        {since: p-value that a cause had to fall below}
    order        accepted causes and firsts of ties, as they were accepted
    marginal     {offer: test} of every candidate before anything was accepted
    rejected     {offer: why} of significant candidates that were not accepted
    """

    named: list[Named] = field(default_factory=list)
    ties: list[Tie] = field(default_factory=list)
    ranking: list[Test] = field(default_factory=list)
    marginal: dict[Candidate, Test] = field(default_factory=dict)
    level: dict[str, float] = field(default_factory=dict)
    rejected: dict[Candidate, str] = field(default_factory=dict)
    order: list[Candidate] = field(default_factory=list)

    @property
    def offers(self) -> list[Candidate]:
        """Accepted causes and the first of each tie: what other tests are given."""
        return [*(n.test.offer for n in self.named), *(tie.tests[0].offer for tie in self.ties)]

    def test(
        self, mixed: MixedModel, offer: Candidate, without: Sequence[Candidate] = (), given: Sequence[Candidate] = ()
    ) -> Test:
        """A cause with all others given but its own tie and `without`."""
        own = {o for tie in self.ties if offer in (members := [t.offer for t in tie.tests]) for o in members}
        others = [o for o in self.offers if o not in own | {offer, *without}]
        return mixed.test(offer, [*others, *given], mixed.pooled(offer.since))

    def why_not(self, offer: Candidate) -> str:
        """Why a candidate was not accepted."""
        if offer in self.rejected:
            return self.rejected[offer]
        last, level = next((t for t in self.ranking if t.offer == offer), None), self.level[offer.since]
        if offer in self.marginal and self.marginal[offer].p < level:
            return f"explained by {', '.join(sorted({o.cause for o in self.offers}))}"
        return f"p = {last.p:.2g}, not below {level:.2g}" if last else "another parameter of it was accepted"

    def reproducibility(
        self, draw: Callable[[np.random.Generator], list[np.ndarray]], build: Callable[[list[np.ndarray]], MixedModel],
        seed: int = 0,
    ) -> dict[Candidate, float]:  # fmt: skip
        """Share of resamples in which each accepted cause is significant again.

        draw  per-flight cross-products (P, P) with each flight's blocks drawn anew; build  makes the tests of them
        """
        rng = np.random.default_rng(seed)
        counts = dict.fromkeys(self.offers, 0)
        for _ in range(RESAMPLES if counts else 0):
            drawn = build(draw(rng))
            for offer in counts:
                counts[offer] += self.test(drawn, offer).p < self.level[offer.since]
        return {offer: count / RESAMPLES for offer, count in counts.items()}


def select_causes(
    mixed: MixedModel, profiles: Mapping[str, Profile], rate: float, rules: Rules = FORCES,
    excluded: Sequence[str] = (), known: Sequence[Candidate] = (),
) -> Selection:  # fmt: skip
    """Select the causes of the residual: what changed, then what all flights have in common.

    rate  family-wise false alarm rate; excluded  causes that cannot be asked; known  offers that are given throughout
    """
    found = Selection()
    for since, share in share_of_rate(mixed.compared).items():
        given = [*known, *found.offers]
        one = Search(mixed, profiles, since, rate * share, rules, excluded, given).run()
        found.named += one.named
        found.ties += one.ties
        found.ranking += one.ranking
        found.marginal |= one.marginal
        found.level |= one.level
        found.rejected |= one.rejected
        found.order += one.order
    found.ranking.sort(key=lambda test: test.p)
    return found


class Search:
    """One search, for changes or for what all flights have in common; arguments as for `select_causes`."""

    def __init__(
        self, mixed: MixedModel, profiles: Mapping[str, Profile], since: str, rate: float, rules: Rules = FORCES,
        excluded: Sequence[str] = (), known: Sequence[Candidate] = (),
    ) -> None:  # fmt: skip
        self.mixed, self.profiles, self.since, self.rules, self.known = mixed, profiles, since, rules, list(known)
        asked = [name for name in mixed.columns.causes if name not in excluded]
        self.pairs = [(n, since) for n in asked if not (since == "always" and profiles[n].absorbed)]
        self.level = rate / max(len(self.pairs), 1)
        self.parts = {name: profiles[name].parts for name in asked}
        self.pooled = mixed.pooled(since)
        self.given: list[Candidate] = list(known)
        self.found: dict[Candidate, list[Rival]] = {}
        self.ties: list[Tie] = []
        self.clear: list[Test] = []  # accepted, as they were found
        self.strong: list[Test] = []  # these, and the first of each tie
        self.marginal: dict[Candidate, Test] = {}
        self.rejected: dict[Candidate, str] = {}

    def run(self) -> Selection:
        ranking: list[Test] = []
        while len(self.given) < len(self.known) + MOST_CAUSES:
            ranking = ranked(self.mixed, self.pairs, self.given, self.pooled, self.parts)
            self.marginal = self.marginal or {t.offer: t for t in ranking}
            significant = [t for t in ranking if t.p < self.level]
            self.rejected = {t.offer: why for t in significant if (why := self._why_rejected(t))}
            accepted = [t for t in significant if t.offer not in self.rejected]
            if not accepted:
                break
            self._accept(*self._step(accepted, ranking))
        named, simpler = self._one_for_several(self._eliminate())
        level = {self.since: self.level}
        order = self.given[len(self.known) :]
        return Selection(named, [*self.ties, *simpler], ranking, self.marginal, level, self.rejected, order)

    def _test(self, offer: Candidate, *given: Candidate) -> Test:
        return self.mixed.test(offer, [*self.given, *given], self.pooled)

    def _accept(self, best: Test | None, rivals: list[Rival], tie: Tie | None) -> None:
        if tie is not None:
            # a further parameter of a cause that is accepted already needs no new cause
            more = next((t for t in tie.tests if any(g.cause == t.offer.cause for g in self.found)), None)
            if more is None:
                self.ties.append(tie)
                self.strong.append(tie.tests[0])
                self.given.append(tie.tests[0].offer)  # the search goes on without what the tie explains
                return
            best, rivals = more, []
        self.clear.append(best)
        self.strong.append(best)
        self.given.append(best.offer)
        self.found[best.offer] = rivals

    def _step(self, accepted: list[Test], ranking: list[Test]) -> tuple[Test | None, list[Rival], Tie | None]:
        """The best of the significant causes with the rivals that it dominates, or a tie."""
        best, rivals, tie = self._dominant(accepted[:COMPARED_RIVALS])
        if tie is None:
            free = [t for t in ranking if t.offer.cause not in self._tied and not self._duplicates(t.offer)]
            tie = self._not_ruled_out(best, free)
        return best, rivals, tie

    @property
    def _tied(self) -> set[str]:
        return {t.offer.cause for tie in self.ties for t in tie.tests}

    def _why_rejected(self, t: Test) -> str:
        """Why a significant cause is not accepted; nothing for one that may be named."""
        profile = self.profiles[t.offer.cause]
        if t.offer.cause in self._tied:
            return "it stands in a tie already"
        if self._duplicates(t.offer):
            return "it looks the same as a named cause, and the two would only correct each other"
        for c in self.clear:
            if self._is_form(t, c, [g for g in self.given if g != c.offer]):
                return f"it has more parameters than {c.offer.cause} and explains hardly more"
        others = [c for c in self.strong if c.offer.cause != t.offer.cause]  # its own parameters are its form
        strongest = max(others, key=lambda c: c.wald, default=None)
        form_error = self.rules.form_error * strongest.wald if strongest is not None else 0.0
        small = t.offer.since == "changed" and t.wald < form_error
        if small and t.wald < form_error * self.rules.overlap(strongest, t):
            return f"it explains so little that it may be the error of the form of {strongest.offer.cause}"
        if self.rules.is_excessive(t):
            return EXCESSIVE
        if not profile.is_possible(t) and not is_absent(t, profile, self.mixed, self.given, self.pooled, self.level):
            return UNPHYSICAL
        return "" if profile.has_leading_deviation(t) else "only its accompanying parameters differ"

    def _duplicates(self, offer: Candidate) -> bool:
        """Whether an offer is, or spans, what no data distinguish from an accepted cause: the two of them, large and
        opposite, would only correct the model's form."""
        alike = {n for g in self.given if g.cause in self.profiles for n in self.profiles[g.cause].always_tied_with}
        columns = self.mixed.columns.causes
        complete = [Candidate(n, offer.since, tuple(range(len(columns[n])))) for n in alike if n in columns]
        return any(o.cause == offer.cause or self.mixed.spans(offer, o, self.given) for o in complete)

    def _is_form(self, wide: Test, simple: Test, given: Sequence[Candidate]) -> bool:
        """Whether a cause with more parameters explains a simpler accepted one away but hardly more than that: it may
        be the error of the simple one's form. wide  its test with the simple one and the others given
        """
        if len(wide.offer.which) <= len(simple.offer.which) or wide.wald >= self.rules.form_error * simple.wald:
            return False
        return self.mixed.test(simple.offer, [*given, wide.offer], self.pooled).p >= self.level

    def _stays(self, a: Candidate, b: Candidate, test: Test) -> bool:
        """Whether a stays significant with b given. test  of a with b given"""
        third = self.rules.witness.get(frozenset({a.cause, b.cause}))
        if third is None or third not in self.mixed.columns.causes:
            return test.p < self.level
        # two causes with nearly the same signature: with the wrong one given the witness is needed as well
        witness = Candidate(third, a.since, tuple(range(len(self.mixed.columns.causes[third]))))
        if any(g.cause == third for g in self.given):
            return False
        judge = self.rules.judge if self.rules.judge is not None and a.since == "always" else self.mixed
        with_b, with_a = (judge.test(witness, [*self.given, o], self.pooled).p < self.level for o in (b, a))
        return with_b and not with_a

    def _not_ruled_out(self, best: Test, ranking: Sequence[Test]) -> Tie | None:
        """A tie with declared rivals that are not ruled out although they are not significant themselves.

        Those are: one that is always tied with the cause; one with which given the cause is not significant any more;
        and, where forms err, one that makes the flights likelier, but whose size differs too much between them: a load
        whose swing is only roughly known next to a mass, say.
        """
        own, tied, separability = self.profiles[best.offer.cause], [], best.separability
        for rival in ranking:
            name = rival.offer.cause
            declared = name in own.rivals or best.offer.cause in self.profiles[name].rivals
            suspect = declared and rival.p < SUSPECT
            if name == best.offer.cause or not (suspect or name in own.always_tied_with):
                continue
            given = self._test(best.offer, rival.offer)
            # a spread in many parameters can take up anything
            simple = len(rival.offer.which) <= len(best.offer.which)
            likelier = self.rules.form_error > 0.0 and simple and rival.unlikely < best.unlikely
            stays = self._stays(best.offer, rival.offer, given)
            if name in own.always_tied_with or likelier or (simple and not stays):
                tied.append(rival)
                separability = min(separability, given.separability)
        return Tie([best, *tied[:2]], separability) if tied else None

    def _dominant(self, tests: Sequence[Test]) -> tuple[Test | None, list[Rival], Tie | None]:
        """The cause that explains the others away, or the tie of those that explain each other away."""
        given = {(a.offer, b.offer): self._test(a.offer, b.offer) for a in tests for b in tests if a is not b}
        kept = {pair: self._stays(*pair, test) for pair, test in given.items()}

        def stays(a: Test, b: Test) -> bool:
            return kept[a.offer, b.offer]

        balances = {a.offer: [stays(a, b) - stays(b, a) for b in tests if b is not a] for a in tests}
        undisputed = {a.offer: -np.log(max(a.p, TINY)) for a in tests if min(balances[a.offer], default=0) >= 0}
        clearest = (1.0 - FORM_ERROR) * max(undisputed.values(), default=0.0)

        def merit(a: Test) -> tuple[bool, bool, int, float]:
            """One that another explains away ranks below all that none does, however many it explains away itself. Of
            these, a change that is fainter by more than forms err ranks below: of a clear cause's form, a faint one may
            explain more rivals away. What all flights have is mostly form, and clear in any case."""
            clear = self.since == "always" or undisputed.get(a.offer, 0.0) >= clearest
            return a.offer in undisputed, clear, sum(balances[a.offer]), -a.p

        def explains_more(wide: Test, simple: Test) -> bool:
            """Whether a cause whose columns span those of a simpler one explains more."""
            if self._is_form(given[wide.offer, simple.offer], simple, self.given):
                return False
            return stays(wide, simple) or not self.mixed.spans(wide.offer, simple.offer, self.given)

        best = max(tests, key=merit)
        # a cause whose columns span those of a simpler one explains no more than that one: the simpler is named
        for simple in sorted(tests, key=lambda t: len(t.offer.which)):
            if len(simple.offer.which) < len(best.offer.which) and not explains_more(best, simple):
                best = simple
                break
        others = [b for b in tests if b is not best]
        # a rival ties when neither stays with the other given, and also when only the rival stays
        equal = [
            b
            for b in others
            if b.offer.cause in self.profiles[best.offer.cause].always_tied_with
            or (not stays(best, b) and (len(b.offer.which) <= len(best.offer.which) or explains_more(b, best)))
        ]
        if equal:
            separability = min(given[best.offer, b.offer].separability for b in equal)
            return None, [], Tie([best, *sorted(equal, key=lambda b: b.p)[:2]], separability)
        rivals = [
            Rival(b.offer.cause, b.p, given[b.offer, best.offer].p)
            for b in sorted(others, key=lambda b: b.p)
            if not stays(b, best)
        ]
        return best, rivals, None

    def _eliminate(self) -> list[Named]:
        """Backward elimination: with all others given every accepted cause must stay significant, and not excessive."""
        kept = list(self.given)
        while True:
            tests = {o: self.mixed.test(o, [g for g in kept if g != o], self.pooled) for o in kept if o in self.found}
            weak = [
                o
                for o, t in tests.items()
                if t.p >= self.level or self._lacks_partner(o, kept) or self.rules.is_excessive(t)
            ]
            if not weak:
                self.given = kept
                order = sorted(tests.values(), key=lambda test: test.p)
                return [Named(test, self.found[test.offer]) for test in order]
            kept.remove(max(weak, key=lambda o: tests[o].p))

    def _lacks_partner(self, offer: Candidate, kept: Sequence[Candidate]) -> bool:
        """Whether an offer holds a parameter that accompanies another one, which is not accepted."""
        if self.profiles[offer.cause].parts != "paired":
            return False
        half = len(self.mixed.columns.causes[offer.cause]) // 2
        there = {k for o in kept if (o.cause, o.since) == (offer.cause, offer.since) for k in o.which}
        return any(k >= half and k - half not in there for k in offer.which)

    def _one_for_several(self, named: Sequence[Named]) -> tuple[list[Named], list[Tie]]:
        """Named causes, and ties of a cause that needs several of its parameters with a simpler or a declared rival.

        Two rotors on one side, equally weak, are a moved centre of gravity; all four are a thrust factor. Where the
        several parameters together are not significant with the rival given, the rival is the simpler explanation and
        stands first.
        """
        kept, ties = list(named), []
        others = [g for g in self.given if g not in self.found]
        several: dict[str, list[Named]] = {}
        for one in named:
            several.setdefault(one.test.offer.cause, []).append(one)
        for cause, parts in several.items():
            which = tuple(sorted(k for one in parts for k in one.test.offer.which))
            if self.profiles[cause].parts == "paired":
                which = tuple(k for k in which if k < len(self.mixed.columns.causes[cause]) // 2)
            if len(which) < 2 or self.profiles[cause].parts not in ("any", "paired"):
                continue
            given = [*others, *(n.test.offer for n in kept if n not in parts)]
            together = self.mixed.test(Candidate(cause, self.since, which), given, self.pooled)
            there = {g.cause for g in given}
            simpler = []
            for name, _ in self.pairs:
                if name == cause or name in there:
                    continue
                declared = name in self.profiles[cause].rivals or cause in self.profiles[name].rivals
                best = self.mixed.best(name, self.since, given, self.pooled, self.profiles[name].parts)
                if best is None or best.p >= SUSPECT or not (declared or len(best.offer.which) < len(which)):
                    continue
                without = self.mixed.test(together.offer, [*given, best.offer], self.pooled)
                if without.p >= self.level:
                    simpler.append((best, without))
            if simpler:
                first, without = min(simpler, key=lambda pair: pair[0].p)
                ties.append(Tie([first, together], without.separability))
                kept = [n for n in kept if n not in parts]
        return kept, ties


def is_absent(
    test: Test, profile: Profile, mixed: MixedModel, given: Sequence[Candidate], pooled: Sequence[str], level: float
) -> bool:
    """Whether a change is that reference flights show the cause and the compared ones less of it: what each have by
    themselves is physical, and the references' part is significant.

    given  accepted causes; pooled  names of those whose spread between flights is shared
    """
    if test.offer.since != "changed" or profile.absorbed:  # a model of the reference flights holds their part
        return False
    parts = [test.offer._replace(since=since) for since in ("reference", "changed")]
    others = [n for n in pooled if n != test.offer.cause]
    seen, left = (mixed.test(a, [*given, b], others) for a, b in (parts, parts[::-1]))
    return seen.p < level and profile.is_possible(seen) and profile.is_possible(left)
