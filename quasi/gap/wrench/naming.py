"""Which causes a residual has: forward selection with dominance, removal, ties.

A cause is accepted when it is significant beside what was accepted before, at the false alarm rate shared by all tests
of the step, and when it dominates its rivals: it stays significant with a rival given, and the rival does not with it
given. Two causes that explain each other away are a tie; none of them is named. Whatever was accepted must stay
significant beside all others accepted later.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from quasi.gap.effect import Effect, Limits
from quasi.gap.statistics.mixed import Mixed, Offer, Test, ranked

RIVALS = 6  # of the most significant causes that are weighed against each other
MOST = 12  # causes that one search names: a model may lack much of its own vehicle besides
FORM = 0.05  # of what a cause explains, that another has to explain beyond it: no form is quite right
SUSPECT = 0.01  # probability of nothing below which a declared rival has to be ruled out


class Rival(NamedTuple):
    """A cause that was significant when another was named: p of each beside the other."""

    id: str
    p: float
    beside_named: float
    named_beside: float


class Named(NamedTuple):
    """An accepted cause, the test beside everything else accepted, and the rivals it beat."""

    test: Test
    rivals: list[Rival]


class Tie(NamedTuple):
    """Causes that explain each other away; tests of each alone beside what else is accepted."""

    tests: list[Test]
    separability: float  # |t| of the first beside its nearest rival


class Names(NamedTuple):
    """Result of the search: accepted causes strongest first, ties, the last ranking; p had to pass level.

    passed  why offers of the ranking that were significant were passed over
    """

    named: list[Named]
    ties: list[Tie]
    ranking: list[Test]
    level: float
    tests: int
    passed: dict[Offer, str]


def search(
    mixed: Mixed,
    effects: Mapping[str, Effect],
    since: Sequence[str],
    rate: float,
    lacking: Sequence[str] = (),
    within: Mapping[str, Limits] | None = None,
    known: Sequence[Offer] = (),
) -> Names:
    """Name the causes of the residual.

    effects  the catalogue; since  "changed", "always" or both; rate  family-wise false alarm rate
    lacking  causes that cannot be asked
    within   {cause: what is physical of its parameters' deviations}; an estimate outside by more than three standard
             errors disqualifies the cause
    """
    asked = [name for name in mixed.columns.causes if name not in lacking]
    pairs = [(name, s) for s in since for name in asked if not (s == "always" and effects[name].absorbed)]
    level = rate / max(len(pairs), 1)
    parts = {name: effects[name].parts for name in asked}
    given: list[Offer] = list(known)
    found: dict[Offer, list[Rival]] = {}
    ties: list[Tie] = []
    tied: set[str] = set()
    ranking: list[Test] = []
    clear: list[Test] = []  # as they were found
    strong: list[Test] = []  # these, and the first of each tie
    passed: dict[Offer, str] = {}

    def why_not(t: Test) -> str:
        """Why a significant cause is passed over; nothing for one that may be named."""
        if t.offer.cause in tied:
            return "it stands in a tie already"
        if _mends(mixed, t.offer, given, effects):
            return "it is no other than what is named, and the two would only mend each other"
        for c in clear:
            if _is_form(mixed, t, c, [g for g in given if g != c.offer], pooled, level):
                return f"it has more parameters than {c.offer.cause} and explains hardly more"
        strongest = max(strong, key=lambda c: c.wald, default=None)
        if t.offer.since == "changed" and strongest is not None and t.wald < FORM * strongest.wald:
            return f"it explains so little beside {strongest.offer.cause} that it may be what that one's form is off by"
        if not possible(t, within):
            return "its size would be outside what is physical"
        return "" if leads(t, effects) else "only what accompanies it differs, not what it is about"

    while len(given) < len(known) + MOST:
        pooled = mixed.pooled(since)
        ranking = ranked(mixed, pairs, given, pooled, parts)
        significant = [t for t in ranking if t.p < level]
        passed = {t.offer: why for t in significant if (why := why_not(t))}
        open_ = [t for t in significant if t.offer not in passed]
        if not open_:
            break
        best, rivals, tie = _dominant(mixed, open_[:RIVALS], given, pooled, level, effects)
        if tie is None:
            free = [t for t in ranking if t.offer.cause not in tied and not _mends(mixed, t.offer, given, effects)]
            tie = _doubt(mixed, best, free, given, pooled, level, effects)
        if tie is not None:
            # a further parameter of a cause that is there anyway needs no new cause
            more = next((t for t in tie.tests if any(g.cause == t.offer.cause for g in found)), None)
            if more is not None:
                best, rivals, tie = more, [], None
        if tie is not None:
            ties.append(tie)
            tied |= {t.offer.cause for t in tie.tests}
            strong.append(tie.tests[0])
            given.append(tie.tests[0].offer)  # so that the search goes on with what the tie explains taken out
            continue
        clear.append(best)
        strong.append(best)
        given.append(best.offer)
        found[best.offer] = rivals
    named = _confirmed(mixed, effects, since, found, given, level)
    named, simpler = _several_or_one(mixed, effects, named, [g for g in given if g not in found], level)
    return Names(named, [*ties, *simpler], ranking, level, len(pairs), passed)


def _several_or_one(
    mixed: Mixed, effects: Mapping[str, Effect], named: Sequence[Named], others: Sequence[Offer], level: float
) -> tuple[list[Named], list[Tie]]:
    """Named causes, and ties of a cause that needs several of its parameters with a simpler or a declared rival.

    Two rotors on one side, equally weak, are a moved centre of gravity; all four are a thrust factor. Where the several
    parameters together are not significant with the rival given, the rival is the simpler explanation and stands first.
    others  offers that ties put among what is given
    """
    kept, ties = list(named), []
    several = {}
    for one in named:
        several.setdefault((one.test.offer.cause, one.test.offer.since), []).append(one)
    for (cause, when), parts in several.items():
        which = tuple(sorted(k for one in parts for k in one.test.offer.which))
        if len(which) < 2 or effects[cause].parts != "any":
            continue
        pooled = mixed.pooled(when)
        given = [*others, *(n.test.offer for n in kept if n not in parts)]
        together = mixed.test(Offer(cause, when, which), given, pooled)
        there = {g.cause for g in given}
        rivals = [n for n in effects if n != cause and n not in there and n in mixed.columns.causes]
        simpler = []
        for name in rivals:
            declared = name in effects[cause].rivals or cause in effects[name].rivals
            best = mixed.best(name, when, given, pooled, effects[name].parts)
            if best is None or best.p >= level or not (declared or len(best.offer.which) < len(which)):
                continue
            beside = mixed.test(together.offer, [*given, best.offer], pooled)
            if beside.p >= level:
                simpler.append((best, beside))
        if simpler:
            first, beside = min(simpler, key=lambda pair: pair[0].p)
            ties.append(Tie([first, together], float((beside.wald / len(which)) ** 0.5)))
            kept = [n for n in kept if n not in parts]
    return kept, ties


def _mends(mixed: Mixed, offer: Offer, given: Sequence[Offer], effects: Mapping[str, Effect]) -> bool:
    """Whether an offer is, or holds, what is indistinct from a cause taken already: the two of them, large and
    opposite, would only mend the model's form."""
    alike = {name for g in given if g.cause in effects for name in effects[g.cause].indistinct}
    columns = mixed.columns.causes
    whole = [Offer(n, offer.since, tuple(range(len(columns[n])))) for n in alike if n in columns]
    return any(o.cause == offer.cause or mixed.spans(offer, o, given) for o in whole)


def _is_form(
    mixed: Mixed, wide: Test, simple: Test, given: Sequence[Offer], pooled: Sequence[str], level: float
) -> bool:
    """Whether a cause with more parameters that explains away a clear simpler one explains but a little beside it,
    which may be the simple one's form that is not quite right. wide  its test beside the simple one and what is given
    """
    if len(wide.offer.which) <= len(simple.offer.which) or wide.wald >= FORM * simple.wald:
        return False
    return mixed.test(simple.offer, [*given, wide.offer], pooled).p >= level


def _doubt(
    mixed: Mixed, best: Test, ranking: Sequence[Test], given: Sequence[Offer], pooled: Sequence[str], level: float,
    effects: Mapping[str, Effect],
) -> Tie | None:  # fmt: skip
    """A tie with declared rivals that are not ruled out although they are not significant themselves.

    Those are: one that is indistinct from the cause; one beside which the cause is not significant any more; and one
    that makes the flights likelier, but whose size differs too much between them: a load whose swing is only roughly
    known beside a mass, say.
    """
    effect, open_, wald = effects[best.offer.cause], [], best.wald
    for rival in ranking:
        name = rival.offer.cause
        declared = name in effect.rivals or best.offer.cause in effects[name].rivals
        suspect = declared and rival.p < SUSPECT
        if name == best.offer.cause or not (suspect or name in effect.indistinct):
            continue
        beside = mixed.test(best.offer, [*given, rival.offer], pooled)
        # a spread in many parameters can take up anything
        simple = len(rival.offer.which) <= len(best.offer.which)
        likelier = simple and rival.unlikely < best.unlikely
        if name in effect.indistinct or likelier or (simple and beside.p >= level):
            open_.append(rival)
            wald = min(wald, beside.wald)
    return Tie([best, *open_[:2]], float((wald / len(best.offer.which)) ** 0.5)) if open_ else None


def possible(test: Test, within: Mapping[str, Limits] | None) -> bool:
    """Whether the parameters are physical, give or take three standard errors."""
    limits = (within or {}).get(test.offer.cause)
    if limits is None:
        return True
    which = list(test.offer.which)
    low, high = np.array(limits.ranges, float)[which].T
    inside = (low - 3.0 * test.std <= test.value) & (test.value <= high + 3.0 * test.std)
    sums = [(w[which], least) for w, least in limits.sums]
    return bool(inside.all()) and all(
        w @ test.value + 3.0 * np.sqrt(w @ test.covariance @ w) >= least for w, least in sums
    )


def leads(test: Test, effects: Mapping[str, Effect], errors: float = 3.0) -> bool:
    """Whether a parameter that the cause is about differs from neutral, not only those that accompany it.

    Air that is still but for a draught downwards, or a cg that is off in height alone, stand in for something else.
    errors  standard errors that it must differ by
    """
    effect = effects[test.offer.cause]
    about = [effect.parameters[effect.fitted[k]].typical is not None for k in test.offer.which]
    far = [abs(value) > errors * std for value, std in zip(test.value, test.std)]
    return not any(about) or any(a and f for a, f in zip(about, far))


def _dominant(
    mixed: Mixed, tests: Sequence[Test], given: Sequence[Offer], pooled: Sequence[str], level: float,
    effects: Mapping[str, Effect],
) -> tuple[Test | None, list[Rival], Tie | None]:  # fmt: skip
    """The cause that explains the others away, or the tie of those that explain each other away."""
    beside = {
        (a.offer, b.offer): mixed.test(a.offer, [*given, b.offer], pooled) for a in tests for b in tests if a is not b
    }

    def stands(a: Test, b: Test) -> bool:
        return beside[a.offer, b.offer].p < level

    def merit(a: Test) -> tuple[bool, int, float]:
        """One that another explains away comes after all that none does, however many it explains away itself."""
        weighed = [stands(a, b) - stands(b, a) for b in tests if b is not a]
        return min(weighed, default=0) >= 0, sum(weighed), -a.p

    def more(wide: Test, simple: Test) -> bool:
        """Whether a cause whose columns hold those of a simpler one explains more."""
        if _is_form(mixed, beside[wide.offer, simple.offer], simple, given, pooled, level):
            return False
        return stands(wide, simple) or not mixed.spans(wide.offer, simple.offer, given)

    best = max(tests, key=merit)
    # a cause whose columns hold those of a simpler one explains no more than that one: the simpler is named
    for simple in sorted(tests, key=lambda t: len(t.offer.which)):
        if len(simple.offer.which) < len(best.offer.which) and not more(best, simple):
            best = simple
            break
    others = [b for b in tests if b is not best]
    # a rival ties when neither stands beside the other, and also when it is the rival that stands
    equal = [
        b
        for b in others
        if b.offer.cause in effects[best.offer.cause].indistinct
        or (not stands(best, b) and (len(b.offer.which) <= len(best.offer.which) or more(b, best)))
    ]
    if equal:
        nearest = min(equal, key=lambda b: beside[best.offer, b.offer].wald)
        separability = (beside[best.offer, nearest.offer].wald / len(best.offer.which)) ** 0.5
        return None, [], Tie([best, *sorted(equal, key=lambda b: b.p)[:2]], float(separability))
    rivals = [
        Rival(b.offer.cause, b.p, beside[b.offer, best.offer].p, beside[best.offer, b.offer].p)
        for b in sorted(others, key=lambda b: b.p)
        if not stands(b, best)
    ]
    return best, rivals, None


def _confirmed(
    mixed: Mixed,
    effects: Mapping[str, Effect],
    since: Sequence[str],
    found: Mapping[Offer, list[Rival]],
    given: Sequence[Offer],
    level: float,
) -> list[Named]:
    """Backward removal: every accepted cause must stay significant beside all the others."""
    kept, pooled = list(given), mixed.pooled(since)
    while True:
        tests = {o: mixed.test(o, [g for g in kept if g != o], pooled) for o in kept if o in found}
        weak = [o for o, test in tests.items() if test.p >= level]
        if not weak:
            order = sorted(tests.values(), key=lambda test: test.p)
            return [Named(test, found[test.offer]) for test in order]
        kept.remove(max(weak, key=lambda o: tests[o].p))
