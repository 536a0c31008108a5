"""Two models on the same flights: whose errors are smaller, by more than blocks of the flights differ."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from quasi.errors import DataError
from quasi.gap.comparing.differences import (
    FALSE_RATE,
    Difference,
    Estimate,
    differences_plain,
    differences_text,
    reject_by_holm,
)
from quasi.gap.comparing.flight_comparison import SCHEMA
from quasi.gap.comparing.flight_quantities import LEAST_BLOCKS, rows_in_flight
from quasi.gap.levels.rollouts.open_loop import (
    ERROR_UNITS,
    HORIZON,
    finite,
    flight_of,
    simulated,
    sizes,
    vectors,
    windows,
)
from quasi.gap.statistics.blocks import BLOCK
from quasi.model.extensions import correct_flight
from quasi.model.model import Model
from quasi.simulation.tools.replay import count_steps


def compare_models(
    a: Model, b: Model, flights: Mapping[str, pd.DataFrame], masses: Mapping[str, float | None] | None = None
) -> list[Difference]:
    """Root mean square errors of both models: of forces and moments, and of open-loop simulations after HORIZON.

    flights  {key: filtered flight}; masses  {key: kg that it was logged with}
    The difference of squared errors is tested over blocks of BLOCK s, in pairs: what neither model knows, gusts and
    noise, is in both. Source: Diebold & Mariano, J. Business & Economic Statistics 13, 1995.
    Raises DataError for models without a common axis, or flights of less than LEAST_BLOCKS blocks.
    """
    masses = masses or {}
    axes = [axis for axis in a.axes if axis in b.axes]
    if not axes:
        raise DataError(f"models {a.id} and {b.id} have no axis in common; identify the same axes")
    squares: dict[str, list[np.ndarray]] = {}
    for key, flight in flights.items():
        rows = rows_in_flight(flight)
        at = flight["t"].to_numpy(float)[rows]
        for model, column in ((a, 0), (b, 1)):
            own = correct_flight(model, flight, masses.get(key))
            predicted = model.predict_columns(own)
            for axis in axes:
                error = (own[axis].to_numpy(float) - predicted[axis].to_numpy(float))[rows]
                squares.setdefault(axis, [[], []])[column].append(_block_means(at, error**2))
        if len(a.axes) == len(b.axes) == 6:
            for column, found in enumerate(_rolled((a, b), key, flight, masses.get(key))):
                for quantity, blocks in found.items():
                    squares.setdefault(f"{quantity} after {HORIZON:g} s", [[], []])[column].append(blocks)
    rows = [_difference(name, *(np.concatenate(side) for side in sides)) for name, sides in squares.items()]
    count = max(len(np.concatenate(sides[0])) for sides in squares.values())
    if count < LEAST_BLOCKS:
        raise DataError(
            f"the flights hold {count} blocks of {BLOCK:g} s, at least {LEAST_BLOCKS} are needed; give more flights"
        )
    rejected = reject_by_holm([row.p_value for row in rows], FALSE_RATE)
    return [row._replace(differs=bad) for row, bad in zip(rows, rejected)]


def models_plain(
    rows: Sequence[Difference], constants: Sequence[Difference], names: tuple[str, str], flights: Sequence[str]
) -> dict[str, Any]:
    """The comparison as plain data ("quasi.comparison/1")."""
    return {
        "schema": SCHEMA,
        "kind": "models",
        "a": names[0],
        "b": names[1],
        "flights": list(flights),
        "false alarm rate": FALSE_RATE,
        "errors": differences_plain(rows),
        "constants": differences_plain(constants),
    }


def models_text(
    rows: Sequence[Difference], constants: Sequence[Difference], names: tuple[str, str], flights: Sequence[str]
) -> str:
    """The comparison as text: whose errors are smaller, the table of errors, the table of constants."""
    better = {name: [] for name in names}
    for row in rows:
        if row.differs:
            better[names[0] if row.change > 0.0 else names[1]].append(row.name)
    lines = [f"On {', '.join(flights)}: root mean square errors, tested in pairs over blocks of {BLOCK:g} s."]
    lines += [f"{name} has smaller errors of {', '.join(found)}." for name, found in better.items() if found]
    if not any(better.values()):
        lines.append("No error differs beyond the spread.")
    lines.append(differences_text(rows, names))
    if constants:
        lines += ["Constants of the models about hover:", differences_text(constants, names)]
        lines.append("Both models' standard errors are taken as independent; models of the same flights share data.")
    lines.append(f"* differs; {100 * FALSE_RATE:g} % risk of any false mark in a table (Holm).")
    return "\n".join(lines)


def _rolled(models: Sequence[Model], key: str, table: pd.DataFrame, mass: float | None) -> list[dict[str, np.ndarray]]:
    """{quantity: block means of squared errors} of each model's open-loop simulations with measured rotor speeds."""
    flight = flight_of(key, table, mass)
    flight = flight._replace(valid=flight.valid & rows_in_flight(table))
    starts = windows(flight, HORIZON)
    if not len(starts):
        return []
    last = np.array([count_steps(flight.t, HORIZON)])
    found = [sizes(vectors(simulated(m, flight, starts, HORIZON), flight, starts, last)[:, 0]) for m in models]
    kept = [{q: finite(of[q], *(other[q] for other in found)) for q in ERROR_UNITS} for of in found]
    return [{q: _block_means(flight.t[starts], v**2) for q, v in of.items()} for of in kept]


def _block_means(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    if not len(t):
        return np.zeros(0)
    block = np.floor((t - t[0]) / BLOCK).astype(int)
    return np.array([values[block == b].mean() for b in np.unique(block)])


def _difference(name: str, a: np.ndarray, b: np.ndarray) -> Difference:
    """Of block means of squared errors (B,) of both models: root mean squares, and a test of the squares in pairs."""
    count = len(a)
    rms_a, rms_b = (float(np.sqrt(np.mean(side))) for side in (a, b))
    freedom = max(count - 1, 1)

    def error(squares: np.ndarray, rms: float) -> float:
        return float(squares.std(ddof=1) / np.sqrt(count) / (2.0 * rms)) if count > 1 and rms > 0.0 else np.nan

    gap = b - a
    spread = float(gap.std(ddof=1) / np.sqrt(count)) if count > 1 else np.nan
    mean = float(gap.mean())
    if spread > 0.0:
        p_value = float(2.0 * student.sf(abs(mean) / spread, freedom))
    else:
        p_value = 1.0 if mean == 0.0 or not np.isfinite(spread) else 0.0
    total = max(rms_a + rms_b, 1e-300)
    unit = _unit_of(name)
    return Difference(
        name, unit, Estimate(rms_a, error(a, rms_a), freedom), Estimate(rms_b, error(b, rms_b), freedom),
        rms_b - rms_a, spread / total, p_value, False,
    )  # fmt: skip


def _unit_of(name: str) -> str:
    quantity = name.split(" after ")[0]
    return ERROR_UNITS[quantity] if quantity in ERROR_UNITS else "N" if name.startswith("F") else "N m"
