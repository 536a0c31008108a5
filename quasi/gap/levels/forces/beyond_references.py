"""What the compared flights leave beyond what the reference flights leave, whatever it depends on.

Functions of a place and peaks in time find what a single place orders. An effect of two places at once, or one that no
column knows, still leaves larger errors than the flights before it had. Each flight is one observation: rows of a
flight are not independent, and how much flights differ is seen between them. All flights may show the effect, or those
with the manoeuvre that it takes: the mean is tested, and so is each flight by itself, of which two have to show it.
A battery that is seated half a millimetre to the side makes a moment that follows the thrust. That is usual between
sessions and no error of the model: what the usual differences explain is taken off every flight.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from quasi.gap.flights.covariates import UNPLACED
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.design import ROW_MEMORY
from quasi.gap.levels.forces.nuisance import nuisances, session_nuisances
from quasi.gap.statistics.log_ratio import BY_EFFORT, LEAST_FLIGHTS, beyond_references
from quasi.gap.statistics.memory import lagged_products, lags_of_flight
from quasi.model.model import AXES


def left_beyond_references(
    references: Sequence[Evidence], others: Sequence[Evidence],
    before: Callable[[Evidence], np.ndarray], left: Callable[[Evidence], np.ndarray], rate: float,
) -> list[dict[str, Any]]:  # fmt: skip
    """Entries of "unexplained": channels whose errors are larger than in the reference flights.

    references  healthy flights; others  compared and held-out flights
    before, left  flight -> (n, 6) residual, N and N m, in body axes: of the base model in reference flights, fitted to
    the other ones where they made it; of the extended model (ties taken into account) in the others
    rate        family-wise false alarm rate over the six channels
    Errors about each flight's mean are compared: constant forces are the business of the trim. Noise of instruments is
    no error of the model, and may be larger in a log of another rate: where less than half of what the errors grew by
    comes back within a second, that is what grew. Flights that were flown
    harder than the reference flights have larger errors of any model: scaled down in proportion they must be larger as
    well. Errors of flights that were flown more gently are not scaled up: part of them is noise.
    """
    if min(len(references), len(others)) < LEAST_FLIGHTS:
        return []
    errors = [np.array([_power(of(f)) for f in flights]) for of, flights in ((left, others), (before, references))]
    effort = [np.array([_power(f.measured) for f in flights]) for flights in (others, references)]
    instruments = _is_noise([(f, left(f)) for f in others], [(f, before(f)) for f in references])
    entries = []
    for k, axis in enumerate(AXES):
        if any(k in f.excluded for f in (*references, *others)) or min(e[:, k].min() for e in (*errors, *effort)) <= 0:
            continue
        now, usual = (e[:, k] for e in errors)
        harder = np.maximum(effort[0][:, k] / np.exp(np.log(effort[1][:, k]).mean()), 1.0)
        gain, p, by_effort = beyond_references(now, usual, harder)
        if p < rate / len(AXES) and by_effort < BY_EFFORT and not instruments[k]:
            size = np.sqrt(max(errors[0][:, k].mean() - errors[1][:, k].mean(), 0.0))
            entries.append({
                "channel": axis, "where": UNPLACED, "judged": True, "share": None, "size": float(size),
                "unit": "N" if k < 3 else "N m", "since": "changed", "mostly": [],
                "evidence": {"p": p, "times the reference flights": float(np.exp(0.5 * gain))},
            })  # fmt: skip
    return entries


def less_usual_differences(left: Callable[[Evidence], np.ndarray]) -> Callable[[Evidence], np.ndarray]:
    """Residual (n, 6) without what flights and sessions usually differ in, each as large as its spread makes likely.

    Constant errors stay. An error that is much larger than the usual differences loses little: they are bounded.
    """

    def rest(flight: Evidence) -> np.ndarray:
        usual, errors = [*nuisances(flight), *session_nuisances(flight)], left(flight)
        columns = flight.heard(np.stack([spread * column for _, column, spread in usual], axis=2))
        columns = columns - columns.mean(axis=0)
        level = ROW_MEMORY * _power(errors)
        weight = np.divide(1.0, level, out=np.zeros(len(level)), where=level > 0.0)
        inner = np.einsum("k,nki,nkj->ij", weight, columns, columns, optimize=True) + np.eye(len(usual))
        right = np.einsum("k,nki,nk->i", weight, columns, errors - errors.mean(axis=0), optimize=True)
        return errors - columns @ np.linalg.solve(inner, right)

    return rest


def grown_by(flights: Sequence[Evidence], usual: Sequence[Evidence]) -> np.ndarray:
    """Factor (6,) by which squared residuals exceed the usual ones: as they stand or, where larger, about the means."""

    def powers(of: Sequence[Evidence]) -> np.ndarray:
        about = np.mean([_power(f.residual) for f in of], axis=0)
        return np.stack([about, np.mean([np.mean(f.residual**2, axis=0) for f in of], axis=0)])

    return np.max(powers(flights) / np.maximum(powers(usual), 1e-300), axis=0)


def _power(values: np.ndarray) -> np.ndarray:
    """Mean square (6,) about the mean."""
    return np.var(values, axis=0)


Errors = Sequence[tuple[Evidence, np.ndarray]]  # flights with what is left of them (n, 6)


def _is_noise(others: Errors, references: Errors) -> np.ndarray:
    """Whether less than half of what the errors (6,) grew by comes back within a second; no where that is unknown."""
    flights = [f for f, _ in (*others, *references)]
    cutoffs = [(f.metadata.get("filters") or {}).get("low-pass cutoff Hz") for f in flights]
    rates = [1.0 / float(np.median(np.diff(f.t))) for f in flights]
    lags = lags_of_flight(cutoffs, rates[0]) if max(rates) < 1.01 * min(rates) else None
    if lags is None:
        return np.zeros(len(AXES), bool)

    def power(errors: Errors) -> tuple[np.ndarray, np.ndarray]:
        """Of all, and of what comes back."""
        rows = sum(len(e) for _, e in errors)
        products = sum(lagged_products(e, f.breaks, *lags) for f, e in errors)
        return sum(len(e) * _power(e) for _, e in errors) / rows, np.abs(products).max(axis=0) / rows

    grown = [now - usual for now, usual in zip(power(others), power(references))]
    return grown[1] < 0.5 * grown[0]
