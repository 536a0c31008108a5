"""Causes sought in the flights that learn: searched, linearised where found, searched again until they stay."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from quasi.gap.effect import Effect, Limits, Vehicle, as_flown
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.axis_consistency import AXIS_T, contradiction, voices
from quasi.gap.levels.forces.both_sides import within_errors
from quasi.gap.levels.forces.design import Design, gather_design, moved
from quasi.gap.levels.forces.nonlinear import ASTRAY, STAYS, chords, distance, found_alone, started
from quasi.gap.materiality import Cause, Deviations, seen_in
from quasi.gap.profile import Profile
from quasi.gap.selection import FORCES, SUSPECT, Named, Rules, Tie, select_causes
from quasi.gap.statistics.candidates import Candidate, Test
from quasi.gap.statistics.clustered import ClusteredMixedModel
from quasi.gap.statistics.mixed import ALL_NEEDED_P, MixedModel

FORCE_ITERATIONS = 4  # how often curved causes are linearised anew, and contradicted ones left out
# [(id, deviations)] of all changes together -> {position of one that is contradicted: why}, the worst first
Contradicts = Callable[[Sequence[tuple[str, Deviations]]], Mapping[int, str]]
BY_ERRORS = "errors of rotor speeds and of the measured accelerations may make all of it"
KNOWN = 0.05  # share to which the forms hold and what they are made of is known: thrust of a rotor, hubs, own drag


class Sought(NamedTuple):
    """What the search ended with.

    study, mixed  at the sizes found; values {compared or reference: {cause: sizes}} that causes are linearised at
    named, ties, ranking, level  see `quasi.gap.selection.Selection`; ties with their since
    contradicted  {cause: test, why}: those whose axes do not agree; passed  why others of the ranking were passed over
    flown  the vehicle as the compared flights were processed; rules  of the selection
    """

    study: Design
    mixed: ClusteredMixedModel
    values: dict[bool, dict[str, Deviations]]
    named: list[Named]
    ties: list[tuple[str, Tie]]
    ranking: list[Test]
    level: dict[str, float]
    contradicted: dict[str, tuple[Test, str]]
    passed: dict[Candidate, str]
    flown: Vehicle
    rules: Rules


def seek(
    flights: Sequence[Evidence], asked: Mapping[str, Effect], vehicle: Vehicle, compared: np.ndarray, rate: float,
    within: Mapping[str, Limits], against: Contradicts | None = None,
) -> Sought:  # fmt: skip
    """Search causes in flights.

    asked  the causes, by id; compared (F,) bool, False for reference flights; rate  family-wise false alarm rate
    within {cause: what is physical of its parameters' deviations}; against  what the trim in steady flight contradicts
    A cause that its axes or the trim contradict is left out, and the others are sought without it.
    """
    flown = as_flown(vehicle, [flight for flight, flag in zip(flights, compared) if flag])
    neutral: set[str] = set()  # curved causes whose slope where they were found does not show them any more
    contradicted: dict[str, tuple[Test, str]] = {}
    barred: dict[str, frozenset[int]] = {}
    study = started(gather_design(flights, asked, vehicle), asked, vehicle, compared)
    values = {flag: dict(study.values[0]) for flag in (True, False)}  # of compared flights and of reference flights
    far, acting = found_alone(study, asked, vehicle, compared, rate)
    asked = {**asked, **acting}
    values[True] |= far
    for look in range(FORCE_ITERATIONS):
        if look or far:
            study = moved(study, asked, vehicle, [values[bool(flag)] for flag in compared])
        mixed = study.witnessed(range(len(flights)), compared)
        mixed.columns = mixed.columns._replace(barred=barred)
        lacking = (*study.lacking, *contradicted)
        profiles = {n: Profile.of(e, within.get(n)) for n, e in asked.items()}
        rules = FORCES._replace(
            overlap=partial(share_in_common, study, compared), excess=partial(excess_of, study, compared)
        )
        selection = select_causes(mixed, profiles, rate, rules, lacking)
        named, ties = selection.named, [(tie.tests[0].offer.since, tie) for tie in selection.ties]
        causes = merged(named, asked, mixed, offers_of(named, ties), flown)
        found = [(c.effect, c.since, c.value) for c in causes] + [_as_found(tie, since, asked) for since, tie in ties]
        bent = [(e.id, since, sizes) for e, since, sizes in found if e.is_nonlinear]
        now = _sizes(bent, True)
        neutral |= {
            n
            for n, old in values[True].items()
            if not asked[n].starts and distance(asked[n], now.get(n, {}), old) > ASTRAY
        }
        straight = [b for b in bent if b[0] not in neutral]
        curved = chords(asked, {flag: _sizes(straight, flag) for flag in (True, False)}, values[True])
        elsewhere = any(_elsewhere(asked, curved[flag], values[flag]) for flag in (True, False))
        values = curved
        torn = _contradicted(causes, ties, asked, mixed, study, compared)
        alone, refused = ({}, {}) if torn else _against_trim(causes, against, selection.order)
        contradicted |= torn | refused
        barred = {**barred, **{n: which | barred.get(n, frozenset()) for n, which in alone.items()}}
        if not (elsewhere or torn or alone or refused):
            break
    ties = [(s, tie) for s, tie in ties if not any(t.offer.cause in contradicted for t in tie.tests)]
    # they are left out only here: in their place, a search without them would name what resembles them most
    by_errors = _made_by_errors(causes, study, compared)
    named = [n for n in _standing(named, contradicted, barred) if n.test.offer not in [t.offer for t in by_errors]]
    named, ties, twins = _with_twins(named, ties, contradicted, asked, mixed)
    contradicted = {name: why for name, why in contradicted.items() if name not in twins}
    named, ties = _with_weaker_rotors(named, ties, asked, mixed, flown)
    named, ties = _with_another_mass(named, ties, asked, mixed, flown)
    named, ties = _with_mass_or_thrust(named, ties, asked, mixed, study, compared)
    level, ranking = selection.level, [*selection.ranking, *by_errors]
    passed = selection.rejected | {test.offer: BY_ERRORS for test in by_errors}
    return Sought(study, mixed, values, named, ties, ranking, level, contradicted, passed, flown, rules)


def _standing(
    named: Sequence[Named], contradicted: Mapping[str, tuple[Test, str]], barred: Mapping[str, frozenset[int]]
) -> list[Named]:
    """Named causes that are not contradicted, without changes of parameters of which no change is asked."""
    offers = [(one, one.test.offer) for one in named if one.test.offer.cause not in contradicted]
    return [one for one, o in offers if o.since != "changed" or not barred.get(o.cause, frozenset()) & set(o.which)]


def share_on_axes(
    study: Design, compared: Sequence[bool], asked: Mapping[str, Effect], test: Test, other: str
) -> float:
    """Share of what a tested cause adds to the compared flights that lies on the axes of another cause."""
    parts = _added(study, compared, test)
    return float(parts[seen_in(asked[other])].sum() / max(parts.sum(), 1e-300))


def share_in_common(study: Design, compared: Sequence[bool], test: Test, other: Test) -> float:
    """Share of what one tested cause adds to the compared flights that lies where another adds as well: over the axes,
    the sum of the smaller of both shares. An axis on which the first adds little holds little of the error of its form.
    """
    shares = []
    for one in (test, other):
        parts = _added(study, compared, one)
        shares.append(parts / max(parts.sum(), 1e-300))
    return float(np.minimum(*shares).sum())


def excess_of(study: Design, compared: Sequence[bool], test: Test) -> float:
    """Mean square of what a change adds to an axis of the compared flights, as a multiple of the residual's there; the
    largest of the axes. What is there by itself adds no more than is left; causes that cancel may add any amount.
    """
    if test.offer.since != "changed":
        return 0.0
    return float(_added(study, compared, test).max())


def _added(study: Design, compared: Sequence[bool], test: Test) -> np.ndarray:
    """Mean square (6,) of what a tested cause adds to the compared flights, in units of the residual's."""
    own = [study.columns.causes[test.offer.cause][k] for k in test.offer.which]
    raw = sum(gram for gram, flag in zip(study.raw, compared) if flag)  # (6, P, P)
    added = np.einsum("i,kij,j->k", test.value, raw[:, own][:, :, own], test.value)
    return added / np.maximum(raw[:, 0, 0], 1e-300)


def _as_found(tie: Tie, since: str, asked: Mapping[str, Effect]) -> tuple[Effect, str, Deviations]:
    """The first cause of a tie, with its sizes as they were when the tie was met: later causes may resemble it."""
    test = tie.tests[0]
    effect = asked[test.offer.cause]
    return effect, since, {effect.fitted[k]: float(v) for k, v in zip(test.offer.which, test.value)}


def _sizes(causes: Sequence[tuple[str, str, Deviations]], compared: bool) -> dict[str, Deviations]:
    """Deviations that causes (id, since, sizes) give a compared flight, or a reference flight."""
    found: dict[str, Deviations] = {}
    for name, since, sizes in causes:
        if compared or since == "always":
            own = found.setdefault(name, {})
            for parameter, value in sizes.items():
                own[parameter] = own.get(parameter, 0.0) + value
    return found


def _elsewhere(asked: Mapping[str, Effect], new: Mapping[str, Deviations], old: Mapping[str, Deviations]) -> bool:
    """Whether causes have to be linearised anew."""
    return new.keys() != old.keys() or any(distance(asked[n], own, old[n]) > STAYS for n, own in new.items())


def _contradicted(
    causes: Sequence[Cause], ties: Sequence[tuple[str, Tie]], asked: Mapping[str, Effect], mixed: MixedModel,
    study: Design, compared: np.ndarray,
) -> dict[str, tuple[Test, str]]:  # fmt: skip
    """Of causes and ties, those that one axis wants and another does not; what healthy flights show as well is no
    matter of names alone, and not asked where others are compared with them."""
    since = "always" if compared.all() else "changed"
    pooled = mixed.pooled(since)
    tests = [c.test for c in causes] + [test for _, tie in ties for test in tie.tests]
    given = [*(c.test.offer for c in causes), *(tie.tests[0].offer for _, tie in ties)]
    torn = {}
    for test in tests:
        if test.offer.since == since:
            others = [g for g in given if g.cause != test.offer.cause]
            others = [g for g in others if not _tied_with(g.cause, test.offer.cause, ties)]
            why = contradiction(voices(study, compared, test, pooled, others, asked[test.offer.cause].channels))
            if why:
                torn[test.offer.cause] = test, why
    return torn


def _made_by_errors(causes: Sequence[Cause], study: Design, compared: np.ndarray) -> list[Test]:
    """Tests of the causes that only one side of the equation of motion shows; of healthy flights as above."""
    since, flown = "always" if compared.all() else "changed", study.flown(compared)
    made = []
    for cause in causes:
        others = [c for c in causes if c is not cause]
        if cause.since == since and within_errors(study.flights, compared, cause, others, flown):
            made.append(cause.test)
    return made


def _against_trim(
    causes: Sequence[Cause], against: Contradicts | None, order: Sequence[Candidate]
) -> tuple[dict[str, frozenset[int]], dict[str, tuple[Test, str]]]:
    """The change that the trim contradicts most: those of its parameters that are contradicted by themselves, where
    another one may be meant, as another rotor; or the cause, with its test and why. Of causes that it contradicts only
    together, the one that was accepted last goes: it helps the form of the other.

    order  offers as they were accepted
    """
    changed = [c for c in causes if c.since == "changed"]
    sizes = [(c.effect.id, c.value) for c in changed]
    refused = against(sizes) if against and changed else {}
    if not refused:
        return {}, {}
    k, why = next(iter(refused.items()))
    effect, which = changed[k].effect, changed[k].test.offer.which
    if against(sizes[k : k + 1]):
        half = len(effect.fitted) // 2 if effect.parts == "paired" else len(effect.fitted)
        single = {n: {effect.fitted[n]: changed[k].value.get(effect.fitted[n], 0.0)} for n in which if n < half}
        wrong = frozenset(n for n, value in single.items() if against([(effect.id, value)]))
        if effect.parts in ("any", "paired", "one") and 0 < len(wrong) < half:
            return {effect.id: wrong}, {}
        return {}, {effect.id: (changed[k].test, why)}
    accepted = [o.cause for o in order]
    helps = [n for n in range(len(sizes)) if n == k or not against([*sizes[:n], *sizes[n + 1 :]])]
    last = max(helps, key=lambda n: accepted.index(changed[n].effect.id))
    return {}, {changed[last].effect.id: (changed[last].test, why)}


def _with_twins(
    named: Sequence[Named], ties: Sequence[tuple[str, Tie]], contradicted: Mapping[str, tuple[Test, str]],
    asked: Mapping[str, Effect], mixed: MixedModel,
) -> tuple[list[Named], list[tuple[str, Tie]], set[str]]:  # fmt: skip
    """Named causes and ties, and what stands again: a cause that is contradicted does not leave the one that is
    indistinct from it named alone, for what contradicts it is what the model makes of it, and the two are a tie."""
    clear, tied, twins = [], list(ties), set()
    for one in named:
        offer = one.test.offer
        alike = [contradicted[n][0] for n in asked[offer.cause].always_tied_with if n in contradicted]
        alike = [t for t in alike if t.offer.since == offer.since]
        if not alike:
            clear.append(one)
            continue
        given = [o for o in offers_of(named, ties) if o != offer]
        given_twin = mixed.test(offer, [*given, alike[0].offer], mixed.pooled(offer.since))
        tied.append((offer.since, Tie([one.test, *alike], given_twin.separability)))
        twins |= {t.offer.cause for t in alike}
    return clear, tied, twins


def _with_weaker_rotors(
    named: Sequence[Named], ties: Sequence[tuple[str, Tie]], asked: Mapping[str, Effect], mixed: MixedModel,
    flown: Vehicle,
) -> tuple[list[Named], list[tuple[str, Tie]]]:  # fmt: skip
    """Named causes and ties: a mass and moments of inertia that grew in proportion are all that the rotors do, shrunk.

    Thinner air takes thrust, torque and hub forces alike, and F = m a, M = I domega/dt do not show which side changed.
    """
    own = {"mass": {"mass": flown.mass}} | {"inertia": {f"I{a}{a}": flown.inertia[k, k] for k, a in enumerate("xyz")}}
    rest, tied = list(named), list(ties)
    for since in ("changed", "always") if "thrust_factor" in mixed.columns.causes else ():
        pair = [n for n in rest if n.test.offer.since == since and n.test.offer.cause in own]
        if {n.test.offer.cause for n in pair} != set(own):
            continue
        if not _in_proportion([n.test for n in pair], own, asked):
            continue
        rest = [n for n in rest if n not in pair]
        rotors = Candidate("thrust_factor", since, (0, 1))
        test = mixed.test(rotors, offers_of(rest, tied), mixed.pooled(since))
        tied.append((since, Tie([test, *(n.test for n in pair)], 0.0)))
    return rest, tied


def _with_another_mass(
    named: Sequence[Named], ties: Sequence[tuple[str, Tie]], asked: Mapping[str, Effect], mixed: MixedModel,
    flown: Vehicle,
) -> tuple[list[Named], list[tuple[str, Tie]]]:  # fmt: skip
    """Named causes and ties: rotors that do less of all, and moments of inertia that shrank in proportion, are a mass
    that grew: the other half of what `_with_weaker_rotors` says."""
    own = {"thrust_factor": {"factor": 1.0}}
    own |= {"inertia": {f"I{a}{a}": flown.inertia[k, k] for k, a in enumerate("xyz")}}
    rest, tied = list(named), []
    for since, tie in ties:
        first = tie.tests[0]
        turned = [n for n in rest if (n.test.offer.cause, n.test.offer.since) == ("inertia", since)]
        fits = first.offer.cause == "thrust_factor" and turned and "mass" in mixed.columns.causes
        if fits and _in_proportion([first, turned[0].test], own, asked):
            rest.remove(turned[0])
            others = [(s, t) for s, t in ties if t is not tie]
            mass = mixed.test(Candidate("mass", since, (0,)), offers_of(rest, others), mixed.pooled(since))
            tie = tie._replace(tests=[mass, *(t for t in tie.tests if t.offer.cause != "mass")], separability=0.0)
        tied.append((since, tie))
    return rest, tied


def _with_mass_or_thrust(
    named: Sequence[Named], ties: Sequence[tuple[str, Tie]], asked: Mapping[str, Effect], mixed: MixedModel,
    study: Design, compared: np.ndarray,
) -> tuple[list[Named], list[tuple[str, Tie]]]:  # fmt: skip
    """Named causes and ties: another mass and other thrust are a tie where the axes on which one of them acts alone do
    not decide. By F = m a they make the same of the vertical force; between its two columns noise would choose."""
    taken = {n.test.offer.cause for n in named} | {t.offer.cause for _, tie in ties for t in tie.tests}

    def rival_of(test: Test) -> tuple[Test, float] | None:
        """The test of the other one, where it cannot be excluded, and |t| of this one with it given."""
        cause, since, which = test.offer
        other = {"mass": "thrust_factor", "thrust_factor": "mass"}.get(cause)
        if other not in mixed.columns.causes or other in taken or which != (0,):
            return None
        offer, pooled = Candidate(other, since, which), mixed.pooled(since)
        given = [o for o in offers_of(named, ties) if o != test.offer]
        rival = mixed.test(offer, given, pooled)
        alone = [set(asked[a].channels) - set(asked[b].channels) for a, b in ((cause, other), (other, cause))]
        heard = [v for t, axes in zip((test, rival), alone) for v in voices(study, compared, t, pooled, given, axes)]
        if rival.p >= SUSPECT or sum(v.std**-2.0 for v in heard) >= AXIS_T**2:
            return None
        return rival, float(mixed.test(test.offer, [*given, offer], pooled).wald ** 0.5)

    clear, tied = [], []
    for one in named:
        if found := rival_of(one.test):
            tied.append((one.test.offer.since, Tie([one.test, found[0]], found[1])))
        else:
            clear.append(one)
    for since, tie in ties:
        first, *others = tie.tests
        tied.append((since, tie._replace(tests=[first, found[0], *others]) if (found := rival_of(first)) else tie))
    return clear, tied


def _in_proportion(tests: Sequence[Test], own: Mapping[str, Mapping[str, float]], asked: Mapping[str, Effect]) -> bool:
    """Whether what causes change is, within its errors, one share of what was there. own  {cause: {parameter: it}}"""
    sizes = [
        (value / own[test.offer.cause][name], std / own[test.offer.cause][name])
        for test in tests
        for name, value, std in zip(
            (asked[test.offer.cause].fitted[k] for k in test.offer.which), test.value, test.std
        )
        if name in own[test.offer.cause]
    ]  # fmt: skip
    share, error = np.array(sizes).T
    mean = (share / error**2).sum() / (error**-2.0).sum()
    return bool(chi2.sf((((share - mean) / error) ** 2).sum(), len(share) - 1) >= ALL_NEEDED_P)


def _tied_with(one: str, other: str, ties: Sequence[tuple[str, Tie]]) -> bool:
    return any({one, other} <= {t.offer.cause for t in tie.tests} for _, tie in ties)


def offers_of(named: Sequence[Named], ties: Sequence[tuple[str, Tie]]) -> list[Candidate]:
    return [*(n.test.offer for n in named), *(tie.tests[0].offer for _, tie in ties)]


def merged(
    named: Sequence[Named], asked: Mapping[str, Effect], mixed: MixedModel, given: Sequence[Candidate], flown: Vehicle
) -> list[Cause]:
    """One cause for each (id, since), its parameters estimated together with all other causes.

    flown  the vehicle as the compared flights were processed
    """
    which: dict[tuple[str, str], list[int]] = {}
    rivals: dict[tuple[str, str], list[Any]] = {}
    for n in named:
        key = n.test.offer.cause, n.test.offer.since
        which.setdefault(key, []).extend(n.test.offer.which)
        rivals.setdefault(key, []).extend(n.rivals)
    causes = []
    for (cause, since), picked in which.items():
        offer = Candidate(cause, since, tuple(sorted(picked)))
        others = [g for g in given if (g.cause, g.since) != (cause, since)]
        pooled = mixed.pooled(since)
        test = mixed.test(offer, others, pooled)
        causes.append(Cause(asked[cause], since, *estimate(test, asked[cause], flown), test, rivals[cause, since]))
    return sorted(causes, key=lambda c: c.test.p)


def estimate(test: Test, effect: Effect, flown: Vehicle, wider: float = 1.0) -> tuple[Deviations, Deviations]:
    """Deviations and standard errors by name; how well the vehicle's constants are known in these.

    flown  as in `merged`; wider  by which the test's own standard errors are too small
    """
    names = [effect.fitted[k] for k in test.offer.which]
    known = max(KNOWN, effect.form_uncertainty)
    value, std = map(float, test.value), map(float, np.hypot(wider * test.std, known * test.value))
    found, error = dict(zip(names, value)), dict(zip(names, std))
    if effect.exact is None:
        return found, error
    exact = dict(effect.exact(found, flown))  # may leave out what only accompanies
    sides = {n: [effect.exact({**found, n: found[n] + s * error[n]}, flown)[n] for s in (-0.5, 0.5)] for n in exact}
    return exact, {n: abs(high - low) for n, (low, high) in sides.items()}
