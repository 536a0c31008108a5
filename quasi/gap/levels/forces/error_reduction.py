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
from quasi.gap.statistics.whitening import Whitener, thin, whiten
from quasi.model.columns import STATE
from quasi.model.model import AXES, Model

BLOCK = 5.0  # s
DRAWS = 200
LEVEL = 0.95


class Score(NamedTuple):
    """Mean squared error in a block; blocks of all flights one after another. values (B, C), weight (B,) samples."""

    values: np.ndarray
    weight: np.ndarray

    def mean(self) -> np.ndarray:
        """(C,) over all blocks."""
        return self.weight @ self.values / self.weight.sum()


def joined(first: Score, last: Score) -> Score:
    """Blocks of both."""
    return Score(*(np.concatenate(parts) for parts in zip(first, last)))


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
    """`wrench_squares` by blocks."""
    return scored_in_blocks(wrench_squares(flights, residual, centred))


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

    A constant error of a moment, say, is as likely after an extension as before, and tells nothing about it.
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
        part = thin(columns, flight.breaks, flight.t, BAND, 2 * ORDER)
        return whiten(part.columns, part.breaks, self.whitener)[0].reshape(-1, columns.shape[2])


def before(flight: Evidence) -> np.ndarray:
    """Residual of the model as it is (n, 6)."""
    return flight.residual


def after(extended: Model, base: Model) -> Callable[[Evidence], np.ndarray]:
    """Residual of an extended model."""
    return lambda flight: flight.measured - shown(extended, base, flight)


def fraction(
    old: Score, new: Score, floor: np.ndarray | None = None, seed: int = 0
) -> dict[str, dict[str, float | None]]:
    """Share of the removable squared error that is gone, per axis, with its interval over resampled blocks.

    floor (6,) mean squared noise; the share is None where the floor holds 90 % of the old error. The floor is not drawn
    with the errors, which makes the interval cautious: what decides whether a cause matters asks for it. What is told
    of a gain has the interval of `removed`.
    """
    rng = np.random.default_rng(seed)
    noise = np.zeros(old.values.shape[1]) if floor is None else floor
    draws = []
    for _ in range(DRAWS):
        pick = rng.integers(0, len(old.weight), len(old.weight))
        w = old.weight[pick]
        draws.append([w @ s.values[pick] / w.sum() for s in (old, new)])
    result = {}
    for k, axis in enumerate(AXES[: len(noise)]):
        first, last = old.mean()[k], new.mean()[k]
        if noise[k] >= 0.9 * first:
            result[axis] = {"value": None, "low": None, "high": None}
            continue
        shares = [(d[0][k] - d[1][k]) / max(d[0][k] - noise[k], 0.1 * d[0][k]) for d in draws]
        low, high = np.quantile(shares, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
        result[axis] = {"value": float((first - last) / (first - noise[k])), "low": float(low), "high": float(high)}
    return result


def surely(old: Score, new: Score, removable: np.ndarray, seed: int = 0) -> np.ndarray:
    """Lower ends (6,) of the intervals of the squared error that is gone, as shares of what is removable.

    removable (6,) mean square, held: blocks in which there is little to remove say little, whatever their share is
    """
    rng = np.random.default_rng(seed)
    picks = rng.integers(0, len(old.weight), (DRAWS, len(old.weight)))
    weight = old.weight[picks]
    gone = np.einsum("db,dbc->dc", weight, (old.values - new.values)[picks]) / weight.sum(axis=1)[:, None]
    return np.quantile(gone, 0.5 - 0.5 * LEVEL, axis=0) / removable


def removed(
    old: Squares, new: Squares, floor: Squares, least: np.ndarray, reached: Squares | None = None
) -> dict[str, dict[str, float | None]]:
    """Share of the removable squared error that is gone, per axis, with its interval, see `blocks.shares`.

    old, new, floor, reached  of the same flights; least (6,) mean square of the floor at its best, where a better one
    than `floor` is known
    """
    best = (reached or new).mean()
    known = np.where(least < best, least / np.maximum(floor.mean(), 1e-300), 1.0)
    told = blocks.shares(old.flight, old.t, old.values, new.values, known * floor.values, reached and reached.values)
    return dict(zip(AXES, told))


def states_of(flight: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What a roll-out starts from and is judged by, of a filtered flight."""
    states = np.stack([np.asarray(flight[name], float) for name in STATE], axis=1)
    speeds = np.stack([np.asarray(flight[f"w{i}"], float) for i in range(1, 5)], axis=1)
    valid = np.isfinite(states).all(axis=1) & np.isfinite(speeds).all(axis=1)
    if "valid" in flight:
        valid &= np.asarray(flight["valid"], float) > 0.5
    states, speeds = (np.where(np.isfinite(part), part, 0.0) for part in (states, speeds))
    return np.asarray(flight["t"], float), states, speeds, valid
