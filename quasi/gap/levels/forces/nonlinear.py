"""Causes that bend so much that they are looked for by their whole effect instead of its slope at nothing.

Air that follows a rotor 30 ms late makes another thrust than ten times what 3 ms make. Such a cause is first looked for
by the chord, the whole effect over its size, of one of a few sizes, the likeliest; once it is found, by the chord of
the size it was found with, until that stays. Reference flights without it keep the chord of the others: what all
flights have of it must not look like a change for the form of its column.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from quasi.gap.catalogue import columns_of, whole_of
from quasi.gap.effect import Effect, Vehicle
from quasi.gap.levels.forces.design import Design, moved
from quasi.gap.statistics.candidates import Candidate

Sizes = dict[str, dict[str, float]]  # {cause: {parameter: size}}


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
