"""Scores of a model: errors and interval coverage per flight and role, and over all flights of a role."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.model.model import Model

POOLED = "all"
FULL_ROLE = "full"  # role of all rows together, training, test and validation
# N and N m, rms about the mean, below which an axis was not measured: 10 ug and 1e-6 rad/s2 of a vehicle of 1 g, which
# no inertial sensor resolves
LEAST_MEASURED = {"F": 1e-7, "M": 1e-13}
SCORE_UNITS = {
    "flight": ("", "", "flight key, or all"),
    "role": ("", "", "training, test or validation; full: all of them together"),
    "axis": ("", "", "force or moment"),
    "n": ("1", "", "rows"),
    "rmse": ("SI", "", "root mean square error, N or N m"),
    "relative_rmse": ("1", "", "rmse over the root mean square of the measurement"),
    "r2": ("1", "", "explained share of the variance about the mean of the rows"),
    "bias": ("SI", "", "mean of measured minus predicted, N or N m"),
    "coverage": ("1", "", "share of measurements inside the prediction interval"),
    "confidence": ("1", "", "nominal share inside"),
    "interval_width": ("SI", "", "mean width of the prediction interval, N or N m"),
}


class AxisComparison(NamedTuple):
    """Predictions of one axis compared with measurements, over the used rows of all flights in sequence.

    keys of the flights; flight (n,) number of each row's flight; t (n,) s; role (n,) codes of this axis, 0 where
    isolation excludes a training row; measured, predicted, lower, upper (n,) N or N m, NaN where unknown.
    """

    keys: tuple[str, ...]
    flight: np.ndarray
    t: np.ndarray
    role: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def compare_with_measurements(
    model: Model,
    flights: Mapping[str, pd.DataFrame],
    partition: Mapping[str, np.ndarray],
    excluded: Mapping[str, Mapping[str, np.ndarray]] | None = None,
) -> dict[str, AxisComparison]:
    """Collect measurements, predictions and intervals of every axis, {axis: AxisComparison}.

    flights  filtered flights with the measured Fx .. Mz; partition {flight: (n,) role codes}, 0 for unused rows
    excluded {axis: {flight: (n,) bool}} rows that isolation excludes
    Raises DataError when a measured axis is missing.
    """
    pieces: dict[str, list[tuple[np.ndarray, ...]]] = {axis: [] for axis in model.axes}
    for number, (key, flight) in enumerate(flights.items()):
        codes = np.asarray(partition[key])
        used = codes > 0
        chosen = flight[used]
        missing = [axis for axis in model.axes if axis not in flight]
        if missing:
            raise DataError(f"flight {key} has no column '{missing[0]}' to compare with; filter it again")
        if not len(chosen):
            continue
        bands = model.interval(chosen)
        for axis in model.axes:
            role = codes[used].astype(np.int8)
            if excluded and key in excluded.get(axis, {}):
                role = np.where(excluded[axis][key][used], 0, role)
            columns = (chosen[axis], bands[axis], bands[f"{axis}_lower"], bands[f"{axis}_upper"])
            pieces[axis].append(
                (
                    np.full(len(chosen), number, np.int16), chosen["t"].to_numpy(float), role,
                    *(c.to_numpy(float) for c in columns),
                )
            )  # fmt: skip
    keys = tuple(flights)
    nothing = (np.zeros(0, np.int16), np.zeros(0), np.zeros(0, np.int8), *(np.zeros(0) for _ in range(4)))
    return {
        axis: AxisComparison(keys, *map(np.concatenate, zip(*(found or [nothing])))) for axis, found in pieces.items()
    }


def score_comparisons(
    comparisons: Mapping[str, AxisComparison], model: Model, roles: Mapping[str, int]
) -> pd.DataFrame:
    """Score a model per flight, role and axis.

    The rows per role and axis over all flights ("all") follow, then one per axis over the rows of all roles ("full").
    roles    {name: code}, for example {"training": 1, "test": 2, "validation": 3}
    Returns columns flight, role, axis, n, rmse, relative_rmse, r2, bias, coverage, confidence, interval_width.
    """
    rows, pooled = [], []
    for axis, found in comparisons.items():
        table = np.column_stack([found.measured, found.predicted, found.lower, found.upper])
        finite = np.isfinite(table[:, :2]).all(axis=1)  # a published model has no intervals
        for role, code in roles.items():
            of_role = found.role == code
            if not of_role.any():
                continue
            for number, key in enumerate(found.keys):
                here = of_role & (found.flight == number)
                if here.any():
                    rows.append(_score_rows(key, role, axis, table[here & finite], model))
            pooled.append(_score_rows(POOLED, role, axis, table[of_role & finite], model))
        of_any = np.isin(found.role, list(roles.values()))
        if of_any.any():
            pooled.append(_score_rows(POOLED, FULL_ROLE, axis, table[of_any & finite], model))
    order = {role: k for k, role in enumerate([*roles, FULL_ROLE])}
    pooled.sort(key=lambda row: order[row["role"]])
    return pd.DataFrame([*rows, *pooled], columns=list(SCORE_UNITS))


def _score_rows(flight: str, role: str, axis: str, table: np.ndarray, model: Model) -> dict:
    confidence = model.document["axes"][axis]["confidence level"]
    if not len(table):
        return {"flight": flight, "role": role, "axis": axis, "n": 0, "confidence": confidence}
    measured, predicted, lower, upper = table.T
    error = measured - predicted
    bounded = bool(np.isfinite(table[:, 2:]).all())
    square = float(np.mean(error**2))
    variance, power = float(np.var(measured)), float(np.mean(measured**2))
    return {
        "flight": flight,
        "role": role,
        "axis": axis,
        "n": len(table),
        "rmse": square**0.5,
        "relative_rmse": (square / power) ** 0.5 if power > 0 else np.nan,
        "r2": 1.0 - square / variance if variance > LEAST_MEASURED[axis[0]] ** 2 else np.nan,
        "bias": float(np.mean(error)),
        "coverage": float(np.mean((measured >= lower) & (measured <= upper))) if bounded else np.nan,
        "confidence": confidence,
        "interval_width": float(np.mean(upper - lower)),
    }


def format_scores(scores: pd.DataFrame, model: Model) -> str:
    """Format the pooled scores as a text table: R2 and RMSE per axis on training, test, validation and all rows."""
    pooled = scores[scores["flight"] == POOLED].set_index(["role", "axis"])
    roles = [r for r in ("training", "test", "validation", FULL_ROLE) if r in pooled.index.get_level_values("role")]
    lines = [f"Model {model.id}: R2 and RMSE (forces N, moments N m)"]
    lines.append("axis  " + "".join(f"{role:>24}" for role in roles))
    for axis in model.axes:
        cells = ""
        for role in roles:
            row = pooled.loc[(role, axis)]
            # a held-out R2 far below zero needs no digits
            r2 = f"{row['r2']:.4f}" if row["r2"] > -100 else f"{row['r2']:.1e}"
            cells += f"{r2:>12}{row['rmse']:>12.3e}"
        lines.append(f"{axis:<6}{cells}")
    roles_of_flights: dict[str, list[str]] = {}
    for role in (r for r in roles if r != FULL_ROLE):
        flights = sorted(set(scores[scores["role"] == role]["flight"]) - {POOLED})
        roles_of_flights.setdefault(", ".join(flights), []).append(role)
    lines += [f"{' and '.join(of)}: {flights}" for flights, of in roles_of_flights.items()]
    return "\n".join(lines) + "\n"
