"""What an extended model gains, on flights that had no part in choosing or fitting it.

What flights merely differ by (mass, thrust, seating, constant errors) stays in the error, before and after alike: it is
part of what no model of other flights can know.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.instruments import shown
from quasi.gap.levels.forces.design import BAND, ORDER
from quasi.gap.levels.forces.nuisance import nuisances
from quasi.gap.statistics import blocks
from quasi.gap.statistics.blocks import BLOCK
from quasi.gap.statistics.scores import Score
from quasi.gap.statistics.whitening import Whitener, thin, whiten
from quasi.model.columns import ROTORS, STATE
from quasi.model.model import AXES, Model


class Squares(NamedTuple):
    """Squared errors of flights sample by sample: flight (n,) its number, t (n,) s, values (n, C)."""

    flight: np.ndarray
    t: np.ndarray
    values: np.ndarray

    def mean(self) -> np.ndarray:
        """(C,) over all samples."""
        return self.values.mean(axis=0)


def wrench_squares(
    flights: Sequence[Evidence], residual: Callable[[Evidence], np.ndarray], centred: bool = False
) -> Squares:
    """Squared residuals of the wrench (n, 6) in the band of the analysis.

    residual  flight -> (n, 6); centred  each flight's mean taken off: constant errors are what flights differ by
    """
    found = [Squares(np.zeros(0, int), np.zeros(0), np.zeros((0, len(AXES))))]
    for number, flight in enumerate(flights):
        part = thin(residual(flight)[:, :, None], flight.breaks, flight.t, BAND, 2 * ORDER)
        if len(part.rows):
            left = part.columns[:, :, 0] - (part.columns[:, :, 0].mean(axis=0) if centred else 0.0)
            found.append(Squares(np.full(len(left), number), flight.t[part.rows], left**2))
    return Squares(*(np.concatenate(parts) for parts in zip(*found)))


def wrench_score(
    flights: Sequence[Evidence], residual: Callable[[Evidence], np.ndarray], centred: bool = False
) -> Score:
    """`wrench_squares` by blocks, as judges have it: excluded axes have no error."""
    return scored_in_blocks(wrench_squares(flights, lambda flight: flight.heard(residual(flight)), centred))


def scored_in_blocks(found: Squares) -> Score:
    """Mean squared errors of BLOCK seconds each, no block across two flights."""
    values, weight = [], []
    for flight in np.unique(found.flight):
        own = found.flight == flight
        t, left = found.t[own], found.values[own]
        number = ((t - t[0]) / BLOCK).astype(int)
        for n in np.unique(number):
            rows = number == n
            values.append(np.mean(left[rows], axis=0))
            weight.append(np.count_nonzero(rows))
    return Score(np.array(values), np.array(weight, float))


class Likelihood:
    """How likely residuals of flights are, whatever nuisances these flights have: -2 log, up to a constant.

    A constant error of a moment, say, is as likely after an extension as before.
    """

    def __init__(self, flights: Sequence[Evidence], whitener: Whitener) -> None:
        self.flights, self.whitener = flights, whitener
        self._known: list[tuple[np.ndarray, np.ndarray]] = []
        for flight in flights:
            own = nuisances(flight)
            columns = self._white(flight, np.stack([column for _, column, _ in own], axis=2))
            inner = columns.T @ columns + np.diag([1.0 / spread**2 for *_, spread in own])
            self._known.append((columns, np.linalg.inv(inner)))

    def __call__(self, residual: Callable[[Evidence], np.ndarray]) -> float:
        total = 0.0
        for flight, (columns, inverse) in zip(self.flights, self._known):
            left = self._white(flight, residual(flight)[:, :, None])[:, 0]
            cross = columns.T @ left
            total += float(left @ left - cross @ inverse @ cross)
        return total

    def _white(self, flight: Evidence, columns: np.ndarray) -> np.ndarray:
        part = thin(flight.heard(columns), flight.breaks, flight.t, BAND, 2 * ORDER)
        return whiten(part.columns, part.breaks, self.whitener)[0].reshape(-1, columns.shape[2])


def before(flight: Evidence) -> np.ndarray:
    """Residual of the model as it is (n, 6)."""
    return flight.residual


def after(extended: Model, base: Model) -> Callable[[Evidence], np.ndarray]:
    """Residual of an extended model."""
    return lambda flight: flight.measured - shown(extended, base, flight)


def removed(
    old: Squares, new: Squares, floor: Squares, least: np.ndarray, reached: Squares | None = None
) -> dict[str, dict[str, float | None]]:
    """Share of the removable squared error that is gone, per axis, with its interval, see `blocks.shares`.

    old, new, floor, reached  of the same flights; least (6,) mean square of the floor at its best, where a better one
    than `floor` is known
    """
    best = (reached or new).mean()
    known = np.where(least < best, least / np.maximum(floor.mean(), 1e-300), 1.0)
    shares = blocks.shares(old.flight, old.t, old.values, new.values, known * floor.values, reached and reached.values)
    return dict(zip(AXES, shares))


def states_of(flight: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What a roll-out starts from and is judged by, of a filtered flight."""
    states = np.stack([np.asarray(flight[name], float) for name in STATE], axis=1)
    speeds = np.stack([np.asarray(flight[w], float) for w in ROTORS], axis=1)
    valid = np.isfinite(states).all(axis=1) & np.isfinite(speeds).all(axis=1)
    if "valid" in flight:
        valid &= np.asarray(flight["valid"], float) > 0.5
    states, speeds = (np.where(np.isfinite(part), part, 0.0) for part in (states, speeds))
    return np.asarray(flight["t"], float), states, speeds, valid
