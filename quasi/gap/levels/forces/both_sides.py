"""Whether both sides of F = m a and M = I domega/dt show a cause that divides the wrench by its own value.

The model's wrench holds the errors of rotor speeds, and its residual holds them with the other sign: where a flight is
gentle, they look like rotors that do less, as with a larger moment of inertia. The measured wrench holds errors of its
own, which look like the opposite. The slope without errors lies between those of both sides.
Source: Frisch, Statistical Confluence Analysis by Means of Complete Regression Systems, 1934, chapter 5.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quasi.gap.catalogue import whole_of
from quasi.gap.effect import Effect, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.materiality import Cause


def within_errors(
    flights: Sequence[Evidence], compared: Sequence[bool], cause: Cause, others: Sequence[Cause], vehicle: Vehicle
) -> bool:
    """Whether errors of both sides may make all of a change: its parameters lie between the same bounds in compared
    and in reference flights, or between bounds that hold zero where there is no reference flight.

    others  causes that are taken off the residual where they act; vehicle  as the compared flights were processed
    """
    if cause.effect.exact is None or cause.effect.columns is None:
        return False
    names = [cause.effect.fitted[k] for k in cause.test.offer.which]
    bounds = []
    for flag in (True, False):
        group = [f for f, own in zip(flights, compared) if bool(own) == flag]
        acting = [c for c in others if flag or c.since == "always"]
        bounds.append(_bounds(group, cause.effect, names, acting, vehicle))
    (low, high), (usual_low, usual_high) = bounds
    return bool(np.all((low <= usual_high) & (usual_low <= high)))


def _bounds(
    flights: Sequence[Evidence], effect: Effect, names: Sequence[str], others: Sequence[Cause], vehicle: Vehicle
) -> tuple[np.ndarray, np.ndarray]:
    """The smaller and the larger one of both sides' slopes, of each parameter; 0 and 0 without flights."""
    cross, square = np.zeros((2, len(names))), np.zeros((2, len(names)))
    for flight in flights:
        left = flight.residual - sum(whole_of(c.effect, flight, vehicle, c.value) for c in others)
        left = flight.heard(left)
        for k, side in enumerate((flight, replace(flight, predicted=flight.measured))):
            columns = effect.columns(side, dict.fromkeys(effect.parameters, 0.0))
            for n, name in enumerate(names):
                column = flight.heard(columns[name])
                cross[k, n] += np.sum(left * column)
                square[k, n] += np.sum(column**2)
    slopes = cross / np.maximum(square, 1e-300)
    return slopes.min(axis=0), slopes.max(axis=0)
