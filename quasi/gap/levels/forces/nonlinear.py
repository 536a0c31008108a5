"""Causes that bend so much that they are looked for by their whole effect instead of its slope at nothing.

Air that follows a rotor 30 ms late makes another thrust than ten times what 3 ms make. Such a cause is first looked for
by the chord, the whole effect over its size, of one of a few sizes, the likeliest; once it is found, by the chord of
the size it was found with, until that stays. Reference flights without it keep the chord of the others: what all
flights have of it must not look like a change for the form of its column.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from quasi.gap.catalogue import columns_of, whole_of
from quasi.gap.effect import Effect, Values, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.design import Design, moved
from quasi.gap.materiality import Deviations
from quasi.gap.statistics.candidates import Candidate
from quasi.model.model import AXES

Sizes = dict[str, dict[str, float]]  # {cause: {parameter: size}}
ASTRAY = 0.5  # of its size, that a cause may move when it is linearised there
STAYS = 0.02  # of its size, by which a cause that moves less stays where it is
ALONE_ITERATIONS = 8  # how often a cause that stands alone is linearised anew


def started(study: Design, effects: Mapping[str, Effect], vehicle: Vehicle, compared: Sequence[bool]) -> Design:
    """The study with each cause that has starts by its likeliest chord.

    effects  the catalogue; compared (F,) bool. That several forms were tried is counted in `Columns.tries`.
    """
    since = "always" if np.all(compared) else "changed"
    for name in study.columns.causes:
        effect = effects[name]
        if not effect.starts:
            continue
        parameter, offer = effect.fitted[0], Candidate(name, since, (0,))
        sizes = [[{**own, name: {parameter: size}} for own in study.values] for size in effect.starts]
        forms = [study, *(moved(study, effects, vehicle, values) for values in sizes)]

        def unlikely(form: Design, offer: Candidate = offer) -> float:
            mixed = form.mixed(range(len(compared)), compared)
            return mixed.test(offer, (), mixed.pooled(since)).unlikely

        best = min(forms, key=unlikely)
        study = best._replace(columns=best.columns._replace(tries={**best.columns.tries, name: len(forms)}))
    return study


def found_alone(
    study: Design, effects: Mapping[str, Effect], vehicle: Vehicle, compared: Sequence[bool], rate: float
) -> tuple[Sizes, dict[str, Effect]]:
    """Sizes of curved causes that lie far from what their slope at nothing says, and these causes as they act there.

    Wind of 6 m/s makes many times what slopes in the air of slow flights say. Next to such a slope other causes look
    right. Each cause that its slope shows (p below rate) is fitted as if it stood alone, and linearised anew until it
    stays. Its size is a start where it lies more than ASTRAY away and is likelier. Where a cause is sized by some axes,
    its action on the others is taken as the model says, or as none, whichever is likelier.
    """
    since = "always" if np.all(compared) else "changed"
    sizes: Sizes = {}
    acting: dict[str, Effect] = {}
    for name in study.columns.causes:
        effect = effects[name]
        if not effect.is_nonlinear or effect.starts:
            continue
        forms = [effect, *([on_its_axes(effect)] if effect.sized_by and effect.full_effect else [])]
        ends = [_alone(study, {**effects, name: form}, vehicle, compared, (name, since), rate) for form in forms]
        best = min((k for k, end in enumerate(ends) if end is not None), key=lambda k: ends[k][0], default=None)
        if best is not None:
            sizes[name], acting[name] = ends[best][1], forms[best]
    return sizes, acting


def on_its_axes(effect: Effect) -> Effect:
    """A cause that acts on no other axes than those that size it."""
    asked, full = np.array([axis in effect.sized_by for axis in AXES]), effect.full_effect

    def acting(evidence: Evidence, vehicle: Vehicle, values: Values) -> np.ndarray:
        return np.where(asked, full(evidence, vehicle, values), 0.0)

    return replace(effect, full_effect=acting)


def _alone(
    study: Design, effects: Mapping[str, Effect], vehicle: Vehicle, compared: Sequence[bool], asked: tuple[str, str],
    rate: float,
) -> tuple[float, dict[str, float]] | None:  # fmt: skip
    """-2 log likelihood and sizes of a cause (id, since) without others; None where its slope at nothing serves."""
    name, since = asked
    effect, first, at, start = effects[name], 0.0, {}, {}
    for look in range(ALONE_ITERATIONS):
        own = [{**old, name: at} if flag and at else old for old, flag in zip(study.values, compared)]
        form = moved(study, effects, vehicle, own) if at else study
        mixed = form.mixed(range(len(compared)), compared)
        test = mixed.test(Candidate(name, since, tuple(range(len(effect.fitted)))), (), mixed.pooled(since))
        if look == 0 and test.p >= rate:
            return None
        limits = effect.limits(vehicle).ranges
        new = {p: float(np.clip(v, *ends)) for p, v, ends in zip(effect.fitted, test.value, limits)}
        if look == 0:
            first, start = test.unlikely, new
        elif distance(effect, new, at) <= STAYS:
            far = distance(effect, new, start) > ASTRAY
            return (test.unlikely, new) if far and test.unlikely < first else None
        at = new
    return None


def distance(effect: Effect, new: Deviations, old: Deviations) -> float:
    """How far the sizes of a cause are from those that it was linearised at, as a share of these. Parameters count in
    units of their ranges and together: of a wind, the component that is not there moves by all of its size."""

    def length(sizes: Deviations) -> float:
        return float(np.sqrt(sum((v / (effect.parameters[p].high - effect.parameters[p].low)) ** 2
                                 for p, v in sizes.items())))  # fmt: skip

    away = {p: new.get(p, 0.0) - old.get(p, 0.0) for p in {**old, **new}}
    return length(away) / max(length(old), 1e-300)


def chords(effects: Mapping[str, Effect], found: Mapping[bool, Sizes], before: Sizes) -> dict[bool, Sizes]:
    """What causes are taken at next, of compared flights (True) and reference flights (False): those with starts as
    found, else as before, in reference flights as in the others.
    """
    kept = {n: own for n, own in before.items() if effects[n].starts and n not in found[True]}
    compared = {**found[True], **kept}
    same = {n: own for n, own in compared.items() if effects[n].starts and n not in found[False]}
    return {True: compared, False: {**found[False], **same}}


def flatness(effect: Effect, study: Design, vehicle: Vehicle, value: Mapping[str, float]) -> float:
    """How many times less a cause with starts changes with its size than its chord says: that much less it is known."""
    if not effect.starts or not all(value.values()):
        return 1.0
    ((name, size),) = value.items()
    step = 0.01 * size
    chord = slope = 0.0
    for flight in study.flights:
        near = [whole_of(effect, flight, vehicle, {name: size + s * step}) for s in (-1, 1)]
        slope += np.square((near[1] - near[0]) / (2.0 * step)).sum(axis=0)
        chord += np.square(columns_of(effect, flight, vehicle, value)[name]).sum(axis=0)
    seen = chord > 0.0
    return max(float(np.sqrt(np.mean(chord[seen]) / max(np.mean(slope[seen]), 1e-300))), 1.0)
