"""Level W: causes of what the model leaves of measured forces and moments, and what they gain on held-out flights."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from quasi.errors import ConfigError
from quasi.gap.agreement import contradiction, disagreement, voices
from quasi.gap.catalogue import beyond_slope, columns_of, corrected
from quasi.gap.effect import Effect, Vehicle
from quasi.gap.evidence import Evidence
from quasi.gap.extension import extend
from quasi.gap.gain import Likelihood, Score, after, before, joined, wrench_score
from quasi.gap.left_out import LeftOut
from quasi.gap.level import shares_of
from quasi.gap.mixed import Mixed, Offer, Test, Witnessed
from quasi.gap.naming import Named, Tie, leads, possible, search
from quasi.gap.starts import chords, flatness, started
from quasi.gap.study import Study, base_columns, gather_study, in_stretches, moved, refit
from quasi.gap.worth import ASIDE, EXCITED, LACKING, Cause, Common, Deviations, Judged, material, simplest, strength
from quasi.standalone.model import AXES, Model

SURELY = 2.0  # standard errors, widened, that some parameter must differ by
ASTRAY = 0.5  # of its size, that a cause may move when it is linearised there
LOOKS = 4  # how often curved causes are linearised anew, and contradicted ones left out
RIDGES = (1e-3, 1e-2, 1e-1)  # of fits of everything at once, on scaled columns
KNOWN = 0.05  # share to which the forms hold and what they are made of is known: thrust of a rotor, hubs, own drag
WEIGHING = ("mass", "cg_offset")
NET = "the model is of net forces (noGravity), which hold the weight; identify it withGravity"
DRAWS = 40  # resamples of the flights' blocks


@dataclass
class Found:
    """Result of the level. level {since: p that had to be passed}; scores {"before", "after", ...}: mean squares per
    axis on held-out flights.

    unjudged  those of the causes that the held-out flights do not excite; contradicted {cause: test, why}: those whose
    axes do not agree; stand_ins  the first cause of each tie
    """

    causes: list[Cause]
    ties: list[tuple[str, Tie]]
    immaterial: list[Cause]
    ranking: list[Test]
    level: dict[str, float]
    lacking: dict[str, str]
    study: Study
    scores: dict[str, np.ndarray]
    wrong: str | None
    extended: dict[str, Any]
    unjudged: list[Cause] = field(default_factory=list)
    contradicted: dict[str, tuple[Test, str]] = field(default_factory=dict)
    stand_ins: list[Cause] = field(default_factory=list)


def examine(
    flights: Sequence[Evidence],
    compared: Sequence[bool],
    held: Sequence[Evidence],
    model: Model,
    effects: Mapping[str, Effect],
    vehicle: Vehicle,
    rate: float,
    share: float,
    name: str,
    where: str,
    unheard: float | None = None,
) -> Found:
    """Name the causes in `flights`, extend the model and measure the gain on `held` flights.

    compared  (F,) bool, False for reference flights; rate  family-wise false alarm rate; share  least share of the
    removable error of some axis that a cause must remove on held-out flights to be material
    name      of the extended model; where  what asked, for provenance
    unheard   false alarm rate of what held-out flights do not show and so cannot judge, where that is another
    Raises ConfigError without two compared flights to learn from, or without a held-out one.
    """
    compared = np.asarray(compared, bool)
    if compared.sum() < 2:
        raise ConfigError(
            f"{compared.sum()} compared flights are left to learn from, expected at least 2; one flight cannot tell a "
            "cause from what flights merely differ by"
        )
    if not held:
        raise ConfigError("no flight is held out; name at least one in 'rows of flights held out'")
    asked = {n: e for n, e in effects.items() if e.level == "W" and not e.finding}
    # net forces hold the weight: a model of these cannot carry another mass, nor forces to another point
    weightless = {} if model.with_gravity else {n: NET for n in WEIGHING if n in asked}
    asked = {n: e for n, e in asked.items() if n not in weightless}
    within = {n: e.limits(vehicle) for n, e in asked.items()}
    neutral: set[str] = set()  # curved causes whose slope where they were found does not show them any more
    contradicted: dict[str, tuple[Test, str]] = {}
    study = started(gather_study(flights, asked, vehicle), asked, vehicle, compared)
    values = {flag: dict(study.values[0]) for flag in (True, False)}  # of compared flights and of reference flights
    for look in range(LOOKS):
        study = moved(study, asked, vehicle, [values[bool(flag)] for flag in compared]) if look else study
        mixed = study.witnessed(range(len(flights)), compared)
        lacking = (*study.lacking, *contradicted)
        named, ties, ranking, level = _search(mixed, asked, compared, rate, lacking, within)
        causes = _merged(named, asked, mixed, _given(named, ties))
        found = [(c.effect, c.since, c.value) for c in causes] + [_as_found(tie, since, asked) for since, tie in ties]
        bent = [(e.id, since, sizes) for e, since, sizes in found if e.bends]
        now = _sizes(bent, True)
        neutral |= {n for n, old in values[True].items() if not asked[n].starts and _astray(now.get(n, {}), old)}
        straight = [b for b in bent if b[0] not in neutral]
        curved = chords(asked, {flag: _sizes(straight, flag) for flag in (True, False)}, values[True])
        elsewhere = any(_elsewhere(curved[flag], values[flag]) for flag in (True, False))
        values = curved
        torn = _contradicted(causes, ties, asked, mixed, study, compared)
        contradicted |= torn
        if not elsewhere and not torn:
            break
    ties = [(s, tie) for s, tie in ties if not any(t.offer.cause in contradicted for t in tie.tests)]
    named = [n for n in named if n.test.offer.cause not in contradicted]
    named, ties, twins = _with_twins(named, ties, contradicted, asked, mixed)
    contradicted = {name: why for name, why in contradicted.items() if name not in twins}
    causes = _merged(named, asked, mixed, _given(named, ties))
    firsts = [Named(tie.tests[0], []) for _, tie in ties]
    stand_ins = _merged(firsts, asked, mixed, _given(named, ties))
    _count([*causes, *stand_ins], study, asked, compared, min(level.values()))
    old = wrench_score(held, before)
    floor = _floor(study, asked, vehicle, compared, values[True], held, old)

    def made(of: Sequence[Cause], ident: str, fitted_anew: bool) -> dict[str, Any]:
        changes = None
        if fitted_anew:
            own = {(c.effect.id, c.since): {c.effect.fitted.index(n): v for n, v in c.value.items()} for c in of}
            changes = refit(study, range(len(flights)), compared, own)
        return extend(model, [(c.effect, c.value) for c in of], vehicle, ident, where, changes)

    likelihood = Likelihood(held, study.whitener)

    def score(of: Sequence[Cause], fitted_anew: bool) -> Judged:
        left = after(Model(made(of, "trial", fitted_anew), "trial"), model)
        return Judged(wrench_score(held, left), wrench_score(held, left, True), likelihood(left))

    def excited(cause: Cause) -> bool:
        there = [f for f, flag in zip(flights, compared) if flag]
        here, usual = (strength(cause, some, vehicle, old.mean()) for some in (held, there))
        return here > EXCITED * usual

    common = Common(lambda of, again: score(of, again).centred, old, floor, max(share, ASIDE))
    if compared.all():
        # no flight is healthy: what all show, each of them may judge by what the others tell
        in_turn, every = LeftOut(study, compared), [*held, *flights]
        before_all = joined(old, in_turn([], False))
        least = _floor(study, asked, vehicle, compared, values[True], every, before_all)
        common = Common(lambda of, again: joined(score(of, again).centred, in_turn(of, again)), before_all, least,
                        LACKING * share, made_of(model, flights), share)  # fmt: skip
    kept, immaterial, unjudged = material([*causes, *stand_ins], score, excited, old, floor, share, common)
    for cause in _faint(unjudged, level, 1.0 if unheard is None else unheard / rate):
        kept.remove(cause)
        unjudged.remove(cause)
        why = f"held-out flights do not show it, and of the others alone p = {cause.test.p:.2g} does not do"
        contradicted[cause.effect.id] = cause.test, why
    ties = [(since, tie) for since, tie in ties if any(c in kept for c in stand_ins if _stands_for(c, since, tie))]
    immaterial = [c for c in immaterial if not any(_stands_for(c, *tie) for tie in ties)]
    beside = [c for c in kept if c.since == "always"]

    def tied(of: Sequence[Cause]) -> list[tuple[str, Tie]]:
        """The ties whose first is among some causes, and those of what all flights show, which are not chosen from."""
        return [tie for tie in ties if tie[0] == "always" or any(_stands_for(c, *tie) for c in of)]

    def estimated(of: Sequence[Cause]) -> list[Cause] | None:
        offers = {*_given([], tied(of)), *(c.test.offer for c in (*of, *beside))}
        found = _merged([Named(c.test, c.rivals) for c in of], asked, mixed, sorted(offers, key=str))
        return found if all(possible(c.test, within) for c in found) else None

    changed = [c for c in kept if c.since == "changed"]
    fewer = simplest(changed, estimated, lambda of: score([*beside, *of], bool(beside)), old, floor, share,
                     [c for c in changed if c in unjudged])  # fmt: skip
    # one that was significant beside another that is needless may not be without it
    fewer = [c for c in fewer if c.test.p < level["changed"] and leads(c.test, asked)]
    ties = tied(fewer)
    immaterial += [c for c in changed if not any(c.effect.id == f.effect.id for f in fewer)]
    immaterial = [c for c in immaterial if not any(_stands_for(c, *tie) for tie in ties)]
    kept = [c for c in (*fewer, *beside) if not any(_stands_for(c, *tie) for tie in ties)]
    kept = sorted(kept, key=lambda c: c.test.p)
    there = [c.test.offer for c in immaterial if c.since == "always" and c not in stand_ins]
    kept, vague = _widened(kept, [*_given([], ties), *there], asked, mixed, study, compared)
    ties = [(since, _anew(tie, since, [*(c.test.offer for c in kept), *there], ties, mixed)) for since, tie in ties]
    for cause in kept:
        cause.std = {n: s * flatness(cause.effect, study, vehicle, cause.value) for n, s in cause.std.items()}
    contradicted |= vague
    unjudged = [c for c in kept if any((c.effect.id, c.since) == (u.effect.id, u.since) for u in unjudged)]
    extended = made(kept, name, any(c.since == "always" for c in kept))
    new = wrench_score(held, after(Model(extended, name), model))
    scores = {"before": old.mean(), "after": new.mean(), "noise_floor": np.minimum(floor, new.mean())}
    wrong = None
    if kept:
        wrong, scores["best_wrong_cause"] = _best_wrong(mixed, kept, ranking, asked, model, vehicle, held, old)
    return Found(
        kept, ties, immaterial, ranking, level, study.lacking | weightless, study, scores, wrong, extended, unjudged,
        contradicted, [c for c in stand_ins if any(_stands_for(c, *tie) for tie in ties)],
    )  # fmt: skip


def made_of(model: Model, flights: Sequence[Evidence]) -> bool:
    """Whether the model was identified from some of the flights."""
    trained = set((model.document.get("flights") or {}).get("training") or ())
    return any(e.key in trained for e in flights)


def _faint(causes: Sequence[Cause], level: Mapping[str, float], share: float) -> list[Cause]:
    """Causes that are significant by less than `share` of the level."""
    return [c for c in causes if c.test.p >= share * level[c.since]]


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


def _astray(new: Deviations, old: Deviations) -> bool:
    """Whether a cause that was linearised at its sizes is found elsewhere altogether, or not at all."""
    return any(abs(new.get(p, 0.0) - value) > ASTRAY * abs(value) for p, value in old.items())


def _elsewhere(new: Mapping[str, Deviations], old: Mapping[str, Deviations]) -> bool:
    """Whether causes have to be linearised anew."""
    return new.keys() != old.keys() or any(
        abs(value - old[n].get(p, 0.0)) > 0.02 * abs(value) for n, own in new.items() for p, value in own.items()
    )


def _widened(
    causes: Sequence[Cause], given: Sequence[Offer], asked: Mapping[str, Effect], mixed: Mixed, study: Study,
    compared: np.ndarray,
) -> tuple[list[Cause], dict[str, tuple[Test, str]]]:  # fmt: skip
    """The causes, estimated beside each other and what is given, with wider standard errors where the axes of a cause
    differ by more: then its form is not quite right, and which axis has the say decides on the value. Where nothing of
    a cause is sure any more, it is left out, with the reason, and the others are estimated without it.
    """
    kept, vague = list(causes), {}
    while True:
        for cause in kept:
            pooled = mixed.pooled(cause.since)
            others = [c.test.offer for c in kept if c is not cause] + list(given)
            again = mixed.test(cause.test.offer, others, pooled)
            cause.test, cause.value, cause.std = again, *_estimate(again, cause.effect)
            cause.apart = disagreement(voices(study, compared, cause.test, pooled, others))
        unsure = [c for c in kept if c.apart > 1.0 and not leads(c.test, asked, SURELY * c.apart)]
        if not unsure:
            break
        worst = max(unsure, key=lambda c: c.apart)
        kept = [c for c in kept if c is not worst]
        why = f"its axes differ by {worst.apart:.1f} times their standard errors, so that none of it is sure"
        vague[worst.effect.id] = worst.test, why
    for cause in kept:
        cause.value, cause.std = _estimate(cause.test, cause.effect, cause.apart)
    return kept, vague


def _estimate(test: Test, effect: Effect, wider: float = 1.0) -> tuple[Deviations, Deviations]:
    """Deviations and standard errors by name; how well the vehicle's constants are known in these.

    wider  by which the test's own standard errors are too small
    """
    names = [effect.fitted[k] for k in test.offer.which]
    known = max(KNOWN, effect.rough)
    value, std = map(float, test.value), map(float, np.hypot(wider * test.std, known * test.value))
    return dict(zip(names, value)), dict(zip(names, std))


def _contradicted(
    causes: Sequence[Cause], ties: Sequence[tuple[str, Tie]], asked: Mapping[str, Effect], mixed: Mixed, study: Study,
    compared: np.ndarray,
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
            why = contradiction(voices(study, compared, test, pooled, others))
            if why:
                torn[test.offer.cause] = test, why
    return torn


def _with_twins(
    named: Sequence[Named], ties: Sequence[tuple[str, Tie]], contradicted: Mapping[str, tuple[Test, str]],
    asked: Mapping[str, Effect], mixed: Mixed,
) -> tuple[list[Named], list[tuple[str, Tie]], set[str]]:  # fmt: skip
    """Named causes and ties, and what stands again: a cause that is contradicted does not leave the one that is
    indistinct from it named alone, for what contradicts it is what the model makes of it, and the two are a tie."""
    clear, tied, twins = [], list(ties), set()
    for one in named:
        offer = one.test.offer
        alike = [contradicted[n][0] for n in asked[offer.cause].indistinct if n in contradicted]
        alike = [t for t in alike if t.offer.since == offer.since]
        if not alike:
            clear.append(one)
            continue
        given = [o for o in _given(named, ties) if o != offer]
        beside = mixed.test(offer, [*given, alike[0].offer], mixed.pooled(offer.since))
        tied.append((offer.since, Tie([one.test, *alike], float((beside.wald / len(offer.which)) ** 0.5))))
        twins |= {t.offer.cause for t in alike}
    return clear, tied, twins


def _tied_with(one: str, other: str, ties: Sequence[tuple[str, Tie]]) -> bool:
    return any({one, other} <= {t.offer.cause for t in tie.tests} for _, tie in ties)


def _anew(tie: Tie, since: str, given: Sequence[Offer], ties: Sequence[tuple[str, Tie]], mixed: Mixed) -> Tie:
    """A tie with its sizes beside what is named in the end; later causes may resemble it."""
    others = [*given, *_given([], [t for t in ties if t[1] is not tie])]
    return tie._replace(tests=[mixed.test(t.offer, others, mixed.pooled(since)) for t in tie.tests])


def _stands_for(cause: Cause, since: str, tie: Tie) -> bool:
    return (cause.effect.id, cause.since) == (tie.tests[0].offer.cause, since)


def _search(
    mixed: Mixed, asked: Mapping[str, Effect], compared: np.ndarray, rate: float,
    lacking: Sequence[str], within: Mapping[str, list[tuple[float, float]]],
) -> tuple[list[Named], list[tuple[str, Tie]], list[Test], dict[str, float]]:  # fmt: skip
    """First what changed, then what all flights have alike; the false alarm rate is shared between the two."""
    named: list[Named] = []
    ties: list[tuple[str, Tie]] = []
    rankings: list[Test] = []
    level: dict[str, float] = {}
    for since, part in shares_of(compared).items():
        names = search(mixed, asked, (since,), rate * part, lacking, within, _given(named, ties))
        named += names.named
        ties += [(since, tie) for tie in names.ties]
        rankings += names.ranking
        level[since] = names.level
    return named, ties, sorted(rankings, key=lambda test: test.p), level


def _given(named: Sequence[Named], ties: Sequence[tuple[str, Tie]]) -> list[Offer]:
    return [*(n.test.offer for n in named), *(tie.tests[0].offer for _, tie in ties)]


def _merged(named: Sequence[Named], asked: Mapping[str, Effect], mixed: Mixed, given: Sequence[Offer]) -> list[Cause]:
    """One cause for each (id, since), its parameters estimated together beside all other causes."""
    which: dict[tuple[str, str], list[int]] = {}
    rivals: dict[tuple[str, str], list[Any]] = {}
    for n in named:
        key = n.test.offer.cause, n.test.offer.since
        which.setdefault(key, []).extend(n.test.offer.which)
        rivals.setdefault(key, []).extend(n.rivals)
    causes = []
    for (cause, since), picked in which.items():
        offer = Offer(cause, since, tuple(sorted(picked)))
        others = [g for g in given if (g.cause, g.since) != (cause, since)]
        pooled = mixed.pooled(since)
        test = mixed.test(offer, others, pooled)
        causes.append(Cause(asked[cause], since, *_estimate(test, asked[cause]), test, rivals[cause, since]))
    return sorted(causes, key=lambda c: c.test.p)


def _count(
    causes: Sequence[Cause],
    study: Study,
    asked: Mapping[str, Effect],
    compared: np.ndarray,
    level: float,
    seed: int = 0,
) -> None:
    """Share of resamples, each flight's blocks drawn anew, in which each cause is significant again."""
    if not causes:
        return
    rng = np.random.default_rng(seed)
    counts = np.zeros(len(causes))
    offers = [c.test.offer for c in causes]
    for _ in range(DRAWS):
        grams = [in_stretches(b[rng.integers(0, len(b), len(b))], len(study.blocks)) for b in study.blocks]
        mixed = Witnessed(grams, compared, study.columns)
        for k, offer in enumerate(offers):
            pooled = mixed.pooled(offer.since)
            counts[k] += mixed.test(offer, [o for o in offers if o != offer], pooled).p < level
    for cause, count in zip(causes, counts):
        cause.probability = float(count / DRAWS)


def _floor(
    study: Study, asked: Mapping[str, Effect], vehicle: Vehicle, compared: np.ndarray,
    values: Mapping[str, Deviations], held: Sequence[Evidence], old: Score,
) -> np.ndarray:  # fmt: skip
    """Mean square (6,) that the model's terms and all causes together, fitted to the other flights, leave at best."""
    least = old.mean()
    for ridge in RIDGES:
        left = wrench_score(held, everything(study, asked, vehicle, compared, values, ridge))
        least = np.minimum(least, left.mean())
    return least


def everything(
    study: Study, asked: Mapping[str, Effect], vehicle: Vehicle, compared: Sequence[bool],
    values: Mapping[str, Deviations], ridge: float = RIDGES[0],
) -> Callable[[Evidence], np.ndarray]:  # fmt: skip
    """Fit the model's terms and all causes together; returns flight -> (n, 6), what they leave of its wrench.

    values  that the study's compared flights are linearised at; ridge  of the fit, on scaled columns
    """
    mixed = study.mixed(range(len(study.flights)), compared)
    use = [*study.columns.shared, *(c for cause in study.columns.causes.values() for c in cause)]
    # of the compared flights alone: what they have is what a held-out one has
    total = sum(g for g, c in zip(mixed.grams, compared) if c)
    scale = np.sqrt(np.maximum(np.diag(total)[use], 1e-300))
    inner = total[np.ix_(use, use)] / np.outer(scale, scale) + ridge * np.eye(len(use))
    coefficients = np.linalg.solve(inner, total[use, 0] / scale) / scale

    def residual(flight: Evidence) -> np.ndarray:
        bent, true = np.zeros((len(flight), len(AXES))), corrected(flight, asked, values)
        columns = [c for _, c in base_columns(true)]
        for cause in study.columns.causes:
            at = values.get(cause) or dict.fromkeys(asked[cause].parameters, 0.0)
            shown = flight if asked[cause].corrected else true
            columns += list(columns_of(asked[cause], shown, vehicle, at).values())
            bent += beyond_slope(asked[cause], shown, vehicle, at)
        return flight.residual - bent - np.einsum("k,knj->nj", coefficients, np.array(columns))

    return residual


def _best_wrong(
    mixed: Mixed, kept: Sequence[Cause], ranking: Sequence[Test], asked: Mapping[str, Effect], model: Model,
    vehicle: Vehicle, held: Sequence[Evidence], old: Score,
) -> tuple[str | None, np.ndarray]:  # fmt: skip
    """The best that any other cause alone gains: its id and its mean squares (6,)."""
    named = {c.effect.id for c in kept}
    since = kept[0].since
    best, least = None, old.mean()
    for cause in mixed.columns.causes:
        if cause in named:
            continue
        pooled = mixed.pooled(since)
        test = mixed.best(cause, since, (), pooled, asked[cause].parts)
        values = {asked[cause].fitted[k]: float(v) for k, v in zip(test.offer.which, test.value)}
        try:
            document = extend(model, [(asked[cause], values)], vehicle, "wrong", "trial")
        except ConfigError:
            continue
        mean = wrench_score(held, after(Model(document, "wrong"), model)).mean()
        if np.mean(mean / old.mean()) < np.mean(least / old.mean()):
            best, least = cause, mean
    return best, least


def axes_of(values: np.ndarray) -> dict[str, float]:
    """{axis: root mean square} of mean squares (6,)."""
    return {axis: float(np.sqrt(v)) for axis, v in zip(AXES, values)}
