"""Flights left out in turn: what causes that all flights share do for a flight that had no part in fitting them.

One held-out flight of half a minute has few stretches that show a cause at all, and what cannot be sure there may be
sure of all flights together. Everything is linear in the columns of the study: no model is written for it. Source:
Stone, J. Royal Statistical Society B 36, 1974.
"""

from collections.abc import Callable, Sequence

import numpy as np

from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.design import Design, base_columns, refit
from quasi.gap.levels.forces.error_reduction import Squares, scored_in_blocks
from quasi.gap.materiality import Cause
from quasi.gap.statistics.mixed import MixedModel
from quasi.gap.statistics.scores import Score


class LeftOut:
    """Errors of flights, each with values from the others. compared (F,) bool, False for reference flights."""

    def __init__(self, study: Design, compared: Sequence[bool]) -> None:
        self.study, self.compared = study, np.asarray(compared, bool)
        self._others: list[tuple[np.ndarray, MixedModel]] = []
        for flight in range(len(study.flights)):
            rest = np.delete(np.arange(len(study.flights)), flight)
            self._others.append((rest, study.mixed(rest, self.compared[rest])))

    def __call__(self, causes: Sequence[Cause], fitted_anew: bool) -> Score:
        """Mean squared errors by blocks, each flight's mean taken off, with some causes taken into account.

        fitted_anew  whether the model's own terms are fitted to the other flights with the causes
        """
        study, columns, found = self.study, self.study.columns, []
        for number, (rest, mixed) in enumerate(self._others):
            own = self._sizes(mixed, causes)
            target = np.zeros(len(study.names))
            target[0] = 1.0
            for (cause, since), deviations in own.items():
                if self.compared[number] or since == "always":
                    for position, deviation in deviations.items():
                        target[columns.causes[cause][position]] -= deviation
            if fitted_anew:
                target[columns.shared] -= refit(study, rest, self.compared[rest], own)
            part = study.thinned[number]
            left = part.columns @ target
            t = study.flights[number].t[part.rows]
            found.append(Squares(np.full(len(left), number), t, (left - left.mean(axis=0)) ** 2))
        return scored_in_blocks(Squares(*(np.concatenate(parts) for parts in zip(*found))))

    def _sizes(self, mixed: MixedModel, causes: Sequence[Cause]) -> dict[tuple[str, str], dict[int, float]]:
        """Deviations from some flights, of each cause with the others given."""
        sizes = {}
        for cause in causes:
            others = [c.test.offer for c in causes if c is not cause]
            test = mixed.test(cause.test.offer, others, mixed.pooled(cause.since))
            sizes[cause.effect.id, cause.since] = dict(zip(test.offer.which, map(float, test.value)))
        return sizes


def residual_of_others(study: Design, references: Sequence[Evidence]) -> Callable[[Evidence], np.ndarray]:
    """Residual (n, 6), N and N m, of a reference flight with the model's own terms fitted to the other ones alone.

    A model fits flights that it was made from better than new ones. references  at least two, all in the study
    """
    places = {flight.key: number for number, flight in enumerate(study.flights)}

    def residual(flight: Evidence) -> np.ndarray:
        rest = [places[other.key] for other in references if other.key != flight.key]
        changes = refit(study, rest, [False] * len(rest), {})
        return flight.residual - sum(x * column for x, (_, column) in zip(changes, base_columns(flight)))

    return residual
