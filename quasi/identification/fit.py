"""Identification of one axis: from filtered flights to terms with coefficients, errors and how they were chosen."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.airframe import Airframe
from quasi.errors import DataError, ExpressionError, nearest
from quasi.expressions import Program
from quasi.identification.candidates import Specification, names_of
from quasi.identification.partition import TRAINING
from quasi.identification.regression import Fit, least_squares, probability_of_nothing
from quasi.identification.stepwise import Options, Pool, Selection, select
from quasi.variables import Variables, base_columns, unit_of

UNITS = {**dict.fromkeys(("Fx", "Fy", "Fz"), "N"), **dict.fromkeys(("Mx", "My", "Mz"), "N m")}
TIE = 0.98  # a runner-up with this share of the best candidate's gain is reported as a tie
ILL_CONDITIONED = 1e4  # of the scaled columns; beyond it terms are interchangeable


def fit_axis(
    axis: str,
    flights: Mapping[str, pd.DataFrame],
    partition: Mapping[str, np.ndarray],
    airframe: Airframe,
    shared: Mapping[str, Any],
    config: Mapping[str, Any],
    specification: Specification,
) -> dict[str, Any]:
    """Choose and fit the terms of one axis on the training rows.

    axis           "Fx" .. "Mz", a column of the flights
    flights        {key: filtered flight}; partition {key: (n,) role codes}
    shared         what `shared` found (the hover speed is used)
    config         "regressor cap", "F in", "F out", "stop criterion", "confidence level"; each has a default.
                   "significance level" (say 0.05, of the whole pool) adds an entry test that counts the residuals'
                   memory
    specification  fixed regressors and candidates, and whether a constant belongs to the model
    Returns plain data: terms, coefficients, units, standard errors, covariance, log, stop reason, sigma2, R2, n, ...
    Raises DataError or ExpressionError naming flight, column or regressor.
    """
    hover = shared.get("hover speed", {}).get("value")
    blocks, targets, series, dropped = _training_rows(axis, flights, partition, airframe, hover, specification)
    raw = np.concatenate(targets)
    targets = _less_known(targets, blocks, specification)
    free = [t for t in specification.fixed if t.expression not in specification.known]
    terms = [*free, *specification.candidates]
    trees, names = [t.tree for t in terms], [t.expression for t in terms]

    pool = Pool(trees, len(free), blocks, targets, centred=specification.bias)
    options = Options(
        cap=int(config.get("regressor cap", 10)),
        f_in=float(config.get("F in", 4.0)),
        f_out=float(config.get("F out", 4.0)),
        stop=str(config.get("stop criterion", "PSE")),
    )
    total = float(np.sum((raw - raw.mean()) ** 2))
    if total <= 0:
        raise DataError(f"{axis} is constant over the training rows; there is nothing to fit")
    level = config.get("significance level")
    doubt = None if level is None else _doubt(trees, blocks, targets, series, specification.bias)
    share = float(level or 0.0) / max(len(specification.candidates), 1)
    selection = select(pool, options, names, total, doubt, share)
    chosen = [*range(len(free)), *selection.chosen]

    columns = _columns(Program([trees[k] for k in chosen]), blocks, specification.bias)
    if not columns.shape[1]:
        raise DataError(f"{axis}: every fixed coefficient is given and no candidate entered; there is nothing to fit")
    fit = least_squares(columns, np.concatenate(targets), list(series.values()))
    estimated = ["bias"] * specification.bias + [names[k] for k in chosen]
    entries = _terms(axis, specification, estimated, [trees[k] for k in chosen], len(free), fit)
    error = float(fit.residuals @ fit.residuals)
    return {
        "schema": "quasi.identified/1",
        "axis": axis,
        "unit": UNITS[axis],
        "terms": entries,
        "estimated": estimated,
        "covariance": fit.covariance.tolist(),
        "plain covariance": fit.plain_covariance.tolist(),
        "sigma2": fit.sigma2,
        "R2": 1.0 - error / total,
        "RMSE": float(np.sqrt(error / len(raw))),
        "n": len(raw),
        "effective rows": fit.effective_rows,
        "bandwidth": fit.bandwidth,
        "condition number": fit.condition,
        "confidence level": float(config.get("confidence level", 0.95)),
        "log": selection.log,
        "stop reason": selection.reason,
        "candidates": len(specification.candidates),
        "duplicates": [list(pair) for pair in specification.duplicates],
        "unusable": {names[k]: why for k, why in selection.unusable.items()},
        "flights": {key: len(z) for key, z in zip(series, targets)},
        "dropped rows": dropped,
        "notes": _notes(axis, entries, selection, fit, dropped, names),
    }


def _training_rows(axis, flights, partition, airframe, hover, specification) -> tuple[list, list, dict, dict]:
    wanted = names_of(specification)
    needed = sorted(set().union(*(base_columns(n) for n in wanted), set()))
    blocks, targets, series, dropped = [], [], {}, {}
    for key, flight in flights.items():
        rows = np.flatnonzero(partition[key] == TRAINING)
        if not len(rows):
            continue
        if axis not in flight:
            raise DataError(f"flight {key} has no column '{axis}'{nearest(axis, flight.columns)}; filter it anew")
        columns = {name: flight[name].to_numpy(float)[rows] for name in flight.columns if name != "t"}
        variables = Variables(columns, airframe, hover)
        try:
            values = {name: variables[name] for name in wanted}
        except ExpressionError as error:
            raise ExpressionError(f"{axis}, flight {key}: {error}") from None
        air = [f"{c}_air" for c in "uvw" if c in needed and f"{c}_air" in columns]
        good = np.isfinite(columns[axis])
        for name in {*(c for c in needed if c in columns), *air}:
            if f"{name}_air" not in air:
                good &= np.isfinite(columns[name])
        if not good.all():
            dropped[key] = int(np.count_nonzero(~good))
        blocks.append({name: np.ascontiguousarray(v[good]) for name, v in values.items()})
        targets.append(columns[axis][good])
        series[key] = rows[good]
    if not sum(map(len, targets)):
        raise DataError(
            f"{axis}: no training rows are left in the flights {', '.join(map(str, flights))} "
            f"({sum(dropped.values())} lost to missing values); check the columns that the specification names"
        )
    return blocks, targets, series, dropped


def _less_known(targets: list[np.ndarray], blocks: list[dict], specification: Specification) -> list[np.ndarray]:
    known = [t for t in specification.fixed if t.expression in specification.known]
    if not known:
        return targets
    program = Program([t.tree for t in known])
    weights = np.array([specification.known[t.expression] for t in known])
    return [z - weights @ program.run(block, len(z)) for z, block in zip(targets, blocks)]


def _columns(program: Program, blocks: list[dict], bias: bool) -> np.ndarray:
    parts = []
    for block in blocks:
        rows = len(next(iter(block.values()))) if block else 0
        part = program.run(block, rows).T
        parts.append(np.hstack([np.ones((rows, 1)), part]) if bias else part)
    return np.vstack(parts)


def _doubt(trees, blocks, targets, series, bias: bool) -> Callable[[list[int]], float]:
    """Entry test that counts the residuals' memory, for the last of some columns of the pool."""
    z, rows = np.concatenate(targets), list(series.values())

    def test(chosen: list[int]) -> float:
        return probability_of_nothing(_columns(Program([trees[k] for k in chosen]), blocks, bias), z, rows)

    return test


def _terms(axis, specification, estimated, trees, free, fit: Fit) -> list[dict[str, Any]]:
    entries = []
    bias = int(specification.bias)
    for k, name in enumerate(estimated):
        tree = ("number", 1.0) if bias and k == 0 else trees[k - bias]
        std, plain = (float(np.sqrt(c[k, k])) for c in (fit.covariance, fit.plain_covariance))
        value = float(fit.coefficients[k])
        entries.append(
            {
                "name": name,
                "expression": "1" if bias and k == 0 else name,
                "coefficient": value,
                "std": std,
                "plain std": plain,
                "t": value / std if std > 0 else None,
                "unit": unit_of(tree, axis),
                "fixed": k < free + bias,
                "inflation": float(fit.inflation[k]),
            }
        )
    for term in specification.fixed:
        if term.expression in specification.known:
            entries.append(
                {
                    "name": term.expression,
                    "expression": term.expression,
                    "coefficient": specification.known[term.expression],
                    "std": 0.0,
                    "plain std": 0.0,
                    "t": None,
                    "unit": unit_of(term.tree, axis),
                    "fixed": True,
                    "given": True,
                }
            )
    return entries


def _notes(axis: str, terms: list[dict], selection: Selection, fit: Fit, dropped: dict, names: list[str]) -> list[str]:
    notes = [
        f"{axis}: {rows} training rows of flight {key} hold missing values and are left out"
        for key, rows in dropped.items()
    ]
    for column, why in selection.unusable.items():
        notes.append(f"{axis}: the candidate {names[column]} {why}; it is left out of the pool")
    for entry in selection.log[1:]:
        rival = entry["runner up"]
        if rival and rival["share of gain"] > TIE:
            notes.append(
                f"{axis}: step {entry['step']} took {entry['selected']}, but {rival['expression']} would do "
                f"{100 * rival['share of gain']:.1f} % as well; the data hardly tell them apart"
            )
    weak = [t["name"] for t in terms if t["t"] is not None and abs(t["t"]) < 2 and not t["fixed"]]
    if weak:
        notes.append(f"{axis}: {', '.join(weak)} cannot be told from zero, the residuals' memory counted (|t| < 2)")
    if fit.condition > ILL_CONDITIONED:
        notes.append(f"{axis}: the terms are nearly interchangeable (condition number {fit.condition:.1e})")
    return notes
