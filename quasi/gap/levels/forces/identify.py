"""Forces and moments: causes of what the model leaves of measured forces and moments, and what they gain on held-out
flights."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from quasi.errors import ConfigError
from quasi.gap.effect import Effect, Limits, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.sessions import units
from quasi.gap.levels.forces.axis_consistency import hear
from quasi.gap.levels.forces.design import Design, in_stretches
from quasi.gap.levels.forces.error_reduction import after, before, wrench_squares
from quasi.gap.levels.forces.held_out import HeldOut
from quasi.gap.levels.forces.nonlinear import flatness
from quasi.gap.levels.forces.search import Contradicts, Sought, estimate, merged, offers_of, seek, share_on_axes
from quasi.gap.materiality import Cause, material, simplest
from quasi.gap.profile import Profile
from quasi.gap.selection import EXCESSIVE, FORM_ERROR, UNPHYSICAL, Named, Tie, is_absent
from quasi.gap.statistics.candidates import Candidate, Test
from quasi.gap.statistics.clustered import ClusteredMixedModel
from quasi.model.model import AXES, Model

# p-value, with standard errors widened, up to which the leading parameters of a tie, which names nothing, together
# differ from neutral: two standard errors of a single one
SURELY = 2.0 * float(norm.sf(2.0))
WEIGHING = ("mass", "cg_offset")
NET = "the model is of net forces (noGravity), which hold the weight; identify it withGravity"
RESAMPLED_SEARCHES = 40  # resamples of the flights' blocks


@dataclass
class Found:
    """Result of the level. level {since: p that had to be passed}; scores {"before", "noise_floor"}: mean squares per
    axis on held-out flights; "centred floor": with each flight's mean taken off.

    unjudged  those of the causes that the held-out flights do not excite; contradicted {cause: test, why}: those whose
    axes do not agree; stand_ins  the first cause of each tie; passed  why significant offers were passed over
    refused  of the contradicted, those that axes or the trim refused in the search
    """

    causes: list[Cause]
    ties: list[tuple[str, Tie]]
    immaterial: list[Cause]
    ranking: list[Test]
    level: dict[str, float]
    lacking: dict[str, str]
    study: Design
    scores: dict[str, np.ndarray]
    extended: dict[str, Any]
    unjudged: list[Cause] = field(default_factory=list)
    contradicted: dict[str, tuple[Test, str]] = field(default_factory=dict)
    stand_ins: list[Cause] = field(default_factory=list)
    passed: dict[Candidate, str] = field(default_factory=dict)
    refused: dict[str, tuple[Test, str]] = field(default_factory=dict)


def examine(
    flights: Sequence[Evidence], compared: Sequence[bool], held: Sequence[Evidence], model: Model,
    effects: Mapping[str, Effect], vehicle: Vehicle, rate: float, share: float, name: str, where: str,
    unheard: float | None = None, against: Contradicts | None = None,
) -> Found:  # fmt: skip
    """Name the causes in `flights`, extend the model and measure the gain on `held` flights.

    compared  (F,) bool, False for reference flights; rate  family-wise false alarm rate; share  least share of the
    removable error of some axis that a cause must remove on held-out flights to be material
    name      of the extended model; where  what asked, for provenance
    unheard   false alarm rate of what held-out flights do not show and so cannot judge, where that is another
    against   what the trim in steady flight contradicts, see `seek`
    Raises ConfigError without two compared flights to learn from, or without a held-out one.
    """
    compared = np.asarray(compared, bool)
    if compared.sum() < 2:
        raise ConfigError(
            f"{compared.sum()} compared flights are left to learn from, expected at least 2; one flight cannot "
            "distinguish a cause from usual differences between flights"
        )
    if not held:
        raise ConfigError("no flight is held out; name at least one in 'rows of flights held out'")
    asked = {n: e for n, e in effects.items() if e.level == "forces" and not e.finding}
    # net forces hold the weight: a model of these cannot carry another mass, nor forces to another point
    weightless = {} if model.with_gravity else {n: NET for n in WEIGHING if n in asked}
    unbearable = weightless | _carried(asked, model)
    asked = {n: e for n, e in asked.items() if n not in unbearable}
    within = {n: e.limits(vehicle) for n, e in asked.items()}
    sought = seek(flights, asked, vehicle, compared, rate, within, against)
    study, mixed, ties = sought.study, sought.mixed, sought.ties
    given = offers_of(sought.named, ties)
    causes = merged(sought.named, asked, mixed, given, sought.flown)
    stand_ins = merged([Named(tie.tests[0], []) for _, tie in ties], asked, mixed, given, sought.flown)
    _count([*causes, *stand_ins], study, compared, min(sought.level.values()))
    judge = HeldOut(held, sought, asked, flights, compared, model, vehicle, share, where)
    kept, immaterial, unjudged = material(
        [*causes, *stand_ins], judge.score, judge.excited, judge.old, judge.floor, share, judge.common(), judge.acting
    )
    contradicted = dict(sought.contradicted)
    for cause in _faint(unjudged, sought.level, 1.0 if unheard is None else unheard / rate):
        kept.remove(cause)
        unjudged.remove(cause)
        why = f"held-out flights do not show it, and of the others alone p = {cause.test.p:.2g} does not do"
        contradicted[cause.effect.id] = cause.test, why
    ties = [(since, tie) for since, tie in ties if any(c in kept for c in stand_ins if _stands_for(c, since, tie))]
    fewer, ties = _fewest(kept, unjudged, ties, sought, judge, asked, within)
    changed, common = ([c for c in kept if c.since == since] for since in ("changed", "always"))
    immaterial += [c for c in changed if not any(c.effect.id == f.effect.id for f in fewer)]
    immaterial = [c for c in immaterial if not any(_stands_for(c, *tie) for tie in ties)]
    kept = [c for c in (*fewer, *common) if not any(_stands_for(c, *tie) for tie in ties)]
    kept = sorted(kept, key=lambda c: c.test.p)
    there = [c.test.offer for c in immaterial if c.since == "always" and c not in stand_ins]
    kept, ties, vague = _widened(kept, ties, there, sought, compared, asked, within)
    for cause in kept:
        cause.std = {n: s * flatness(cause.effect, study, vehicle, cause.value) for n, s in cause.std.items()}
    unjudged = [c for c in kept if any((c.effect.id, c.since) == (u.effect.id, u.since) for u in unjudged)]
    extended = judge.made(kept, name, any(c.since == "always" for c in kept))
    left = after(Model(extended, name), model)
    old, new, centred = (wrench_squares(held, *of).mean() for of in ((before,), (left,), (left, True)))
    deaf = [k in {k for flight in flights for k in flight.excluded} for k in range(len(AXES))]
    floor = np.where(deaf, old, np.minimum(judge.floor, new))  # on axes that do not count nothing can be removed
    scores = {"before": old, "noise_floor": floor, "centred floor": np.minimum(judge.centred[1], centred)}
    return Found(
        kept, ties, immaterial, sought.ranking, sought.level, study.lacking | unbearable, study, scores,
        extended, unjudged, contradicted | vague,
        [c for c in stand_ins if any(_stands_for(c, *tie) for tie in ties)],
        sought.passed, sought.contradicted,
    )  # fmt: skip


def _carried(asked: Mapping[str, Effect], model: Model) -> dict[str, str]:
    """{cause: why} of causes with states of their own that an earlier extension put into the model: there is room for
    one of a kind."""
    there = {e["id"] for e in model.document.get("extensions") or [] if e.get("states")}
    why = f"model {model.id} carries it already; compare the flights with the model that this one was extended from"
    return {n: why for n in asked if n in there}


def _fewest(
    kept: Sequence[Cause], unjudged: Sequence[Cause], ties: Sequence[tuple[str, Tie]], sought: Sought, judge: HeldOut,
    asked: Mapping[str, Effect], within: Mapping[str, Limits],
) -> tuple[list[Cause], list[tuple[str, Tie]]]:  # fmt: skip
    """The fewest of the causes that changed that explain as much as all of them, and the ties that are left then."""
    changed, common = ([c for c in kept if c.since == since] for since in ("changed", "always"))

    def possible(c: Cause) -> bool:
        return Profile.of(c.effect, within.get(c.effect.id)).is_possible(c.test)

    absent = {c.test.offer for c in kept if not possible(c)}  # the search found that reference flights have more of it

    def tied(of: Sequence[Cause]) -> list[tuple[str, Tie]]:
        """The ties whose first is among some causes, and those of what all flights show, which are not chosen from."""
        return [tie for tie in ties if tie[0] == "always" or any(_stands_for(c, *tie) for c in of)]

    def estimated(of: Sequence[Cause]) -> list[Cause] | None:
        offers = {*offers_of([], tied(of)), *(c.test.offer for c in (*of, *common))}
        found = merged(
            [Named(c.test, c.rivals) for c in of], asked, sought.mixed, sorted(offers, key=str), sought.flown
        )
        return found if all(possible(c) or c.test.offer in absent for c in found) else None

    fewer = simplest(
        changed, estimated, lambda of: judge.score([*common, *of], bool(common)), judge.old, judge.floor, judge.share,
        [c for c in changed if c in unjudged], judge.acting,
    )  # fmt: skip
    # one that was significant with a needless one given may not be without it
    fewer = [
        c for c in fewer if c.test.p < sought.level["changed"] and Profile.of(c.effect).has_leading_deviation(c.test)
    ]
    return fewer, tied(fewer)


def _faint(causes: Sequence[Cause], level: Mapping[str, float], share: float) -> list[Cause]:
    """Causes that are significant by less than `share` of the level."""
    return [c for c in causes if c.test.p >= share * level[c.since]]


def compute_leading_p(profile: Profile, test: Test, widening: float) -> float:
    """p-value of the leading parameters together (all where none leads), with standard errors times `widening`.

    Of a vector one component is far from neutral by chance more often than a single parameter is.
    """
    leading = [i for i, k in enumerate(test.offer.which) if profile.leading and profile.leading[k]]
    about = leading or list(range(len(test.value)))
    value, covariance = test.value[about], test.covariance[np.ix_(about, about)]
    return float(chi2.sf(value @ np.linalg.solve(covariance, value) / widening**2, len(about)))


def _widened(
    causes: Sequence[Cause], ties: Sequence[tuple[str, Tie]], there: Sequence[Candidate], sought: Sought,
    compared: np.ndarray, asked: Mapping[str, Effect], within: Mapping[str, Limits],
) -> tuple[list[Cause], list[tuple[str, Tie]], dict[str, tuple[Test, str]]]:  # fmt: skip
    """The causes and ties, estimated together and with what is given, with wider standard errors where the axes of one
    differ by more: then its form is not quite right, and which axis has the say decides on the value. A cause that is
    not significant with wider errors, or a tie that nothing is sure of, is left out, with the reason, and the others
    are estimated without it; of these, those that were significant only with it given go as well, one that only axes
    without a say show, and one that is excessive or not physical any more. What was left out, or is impossible, stands
    for something unknown; what explains next to nothing of it may be the error of its form. So may a small change of
    what all flights show anyway, next to a clearer one; and a cause that needs one of a tie is as unsure as that.
    """
    kept, tied, vague, torn = list(causes), list(ties), {}, []

    def beyond(test: Test, every: Sequence[Candidate]) -> bool:
        profile = Profile.of(asked[test.offer.cause], within.get(test.offer.cause))
        others, pooled = [o for o in every if o != test.offer], sought.mixed.pooled(test.offer.since)
        level = sought.level[test.offer.since]
        return not (profile.is_possible(test) or is_absent(test, profile, sought.mixed, others, pooled, level))

    def leans(test: Test, every: Sequence[Candidate]) -> str:
        """Why a cause is there with the first cause of a tie alone, not with another in its place; "" where it is."""
        for first, *others in (tie.tests for _, tie in tied):
            for other in others:
                given = [other.offer if o == first.offer else o for o in every if o != test.offer]
                again = sought.mixed.test(test.offer, given, sought.mixed.pooled(test.offer.since))
                same = test.value @ np.linalg.solve(again.covariance, again.value) > 0.0
                if again.p >= sought.level[test.offer.since] or not same:
                    how = f"p = {again.p:.2g}" if same else "it has the other sign"
                    return f"with {other.offer.cause} in place of {first.offer.cause}, which look alike, {how}"
        return ""

    def enough(one: tuple) -> float:
        return sought.level[one[1].offer.since] if isinstance(one[0], Cause) else SURELY

    unknown = [t for t in sought.ranking if sought.passed.get(t.offer) in (UNPHYSICAL, EXCESSIVE)]
    while True:
        every = [*(c.test.offer for c in kept), *offers_of([], tied), *there]
        for cause in kept:
            others = [g for g in every if g != cause.test.offer]
            cause.test, cause.apart = _again(cause.test.offer, others, cause.effect, sought, compared)
            cause.value, cause.std = estimate(cause.test, cause.effect, sought.flown)
        for k, (since, tie) in enumerate(tied):
            others = [g for g in every if g != tie.tests[0].offer]
            heard = [_again(t.offer, others, asked[t.offer.cause], sought, compared) for t in tie.tests]
            tied[k] = since, tie._replace(tests=[t for t, _ in heard], apart=heard[0][1])
        listed = [(c, c.test, c.apart) for c in kept] + [(pair, pair[1].tests[0], pair[1].apart) for pair in tied]
        unsure = [one for one in listed if one[2] > 1.0 and _leading_p(one[1], one[2], asked) >= enough(one)]
        faint = [one for one in listed if one[1].p >= sought.level[one[1].offer.since]]
        large = [one for one in listed if sought.rules.is_excessive(one[1])]
        small = [one for one in listed if any(_may_be_form(one[1], u, sought, compared, asked) for u in unknown)]
        clearest = min((one[1].p for one in listed if one[1].offer.since == "changed"), default=1.0)
        usual = [one for one in listed if one[1].p > clearest and _is_form_of_usual(one[1], every, sought)]
        outside = [one for one in listed if isinstance(one[0], Cause) and beyond(one[1], every)]
        leaning = [(one, why) for one in listed if isinstance(one[0], Cause) and (why := leans(one[1], every))]
        if outside:
            worst, test, _ = max(outside, key=lambda one: one[1].p)
            unknown.append(test)
            why = UNPHYSICAL
        elif large:
            worst, test, _ = max(large, key=lambda one: sought.rules.excess(one[1]))
            why = EXCESSIVE
        elif unsure:
            worst, test, apart = max(unsure, key=lambda one: one[2])
            unknown.append(test)
            why = f"its axes differ, which widens its errors {apart:.1f} times; with these it is not significant"
            torn.append(test.offer.cause.replace("_", " "))
        elif faint:
            worst, test, _ = max(faint, key=lambda one: one[1].p)
            where = f"without {' and '.join(torn)}, whose axes differ" if torn else "on the axes where its form holds"
            why = f"p = {test.p:.2g} {where}"
        elif leaning:
            (worst, test, _), why = max(leaning, key=lambda one: one[0][1].p)
        elif small:
            worst, test, _ = min(small, key=lambda one: one[1].wald)
            why = "it explains so little that it may be the error of the form of what no cause explains on its axes"
        elif usual:
            worst, test, _ = max(usual, key=lambda one: one[1].p)
            why = "it is so small a part of what all flights show that it may be the error of its form, next to another"
        else:
            break
        kept = [c for c in kept if c is not worst]
        tied = [pair for pair in tied if pair is not worst]
        for lost in [test] if isinstance(worst, Cause) else worst[1].tests:
            vague[lost.offer.cause] = lost, why
    for cause in kept:
        cause.value, cause.std = estimate(cause.test, cause.effect, sought.flown, cause.apart)
    return kept, tied, vague


def _may_be_form(
    test: Test, unknown: Test, sought: Sought, compared: np.ndarray, asked: Mapping[str, Effect]
) -> bool:  # fmt: skip
    """Whether a cause explains less than the share that an error of form may have of what an unknown one does on its
    axes, see `quasi.gap.selection.Rules`; where the unknown one has no known form on an axis, of all that it does."""
    if test.offer.since != "changed" or unknown.offer.since != "changed" or test.offer.cause == unknown.offer.cause:
        return False
    sized_by, own = asked[unknown.offer.cause].sized_by, asked[test.offer.cause].channels
    formless = sized_by and not set(own or AXES) <= set(sized_by)
    shared = 1.0 if formless else share_on_axes(sought.study, compared, asked, unknown, test.offer.cause)
    return test.wald < FORM_ERROR * unknown.wald * shared


def _is_form_of_usual(test: Test, every: Sequence[Candidate], sought: Sought) -> bool:
    """Whether a change is, in its squares, a smaller part of what all flights have of its cause than a form errs by."""
    own = next((o for o in every if (o.cause, o.since) == (test.offer.cause, "always")), None)
    if test.offer.since != "changed" or own is None:
        return False
    usual = sought.mixed.test(own, [o for o in every if o != own], sought.mixed.pooled("always"))
    sizes = dict(zip(own.which, usual.value))
    return all(v**2 < FORM_ERROR * sizes.get(k, 0.0) ** 2 for k, v in zip(test.offer.which, test.value))


def _again(
    offer: Candidate, others: Sequence[Candidate], effect: Effect, sought: Sought, compared: np.ndarray
) -> tuple[Test, float]:
    """The test of an offer with others given, its p-value with errors widened where axes differ, and how much."""
    pooled = sought.mixed.pooled(offer.since)
    test = sought.mixed.test(offer, others, pooled)
    p, apart = hear(sought.study, compared, test, pooled, others, effect.channels)
    return test._replace(p=max(p, float(chi2.sf(test.wald / apart**2, len(test.value))))), apart


def _leading_p(test: Test, apart: float, asked: Mapping[str, Effect]) -> float:
    return compute_leading_p(Profile.of(asked[test.offer.cause]), test, apart)


def _stands_for(cause: Cause, since: str, tie: Tie) -> bool:
    return (cause.effect.id, cause.since) == (tie.tests[0].offer.cause, since)


def _count(causes: Sequence[Cause], study: Design, compared: np.ndarray, level: float) -> None:
    """Share of resamples, each flight's blocks drawn anew, in which each cause is significant again."""
    if not causes:
        return
    rng = np.random.default_rng(0)
    counts = np.zeros(len(causes))
    offers = [c.test.offer for c in causes]
    for _ in range(RESAMPLED_SEARCHES):
        grams = [in_stretches(b[rng.integers(0, len(b), len(b))], len(study.blocks)) for b in study.blocks]
        sessions = [flight.session for flight in study.flights]
        mixed = ClusteredMixedModel(grams, compared, study.columns, units(sessions, compared), sessions)
        for k, offer in enumerate(offers):
            pooled = mixed.pooled(offer.since)
            counts[k] += mixed.test(offer, [o for o in offers if o != offer], pooled).p < level
    for cause, count in zip(causes, counts):
        cause.probability = float(count / RESAMPLED_SEARCHES)
