"""Identification of one axis: from filtered flights to terms with coefficients, errors and how they were chosen."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.airframe import Airframe
from quasi.errors import DataError, ExpressionError, nearest
from quasi.identification.candidates import BIAS, Specification, Term
from quasi.identification.evidence import Totals, interchangeable
from quasi.identification.offsets import OFFSET_ROUNDS, LessOffsets, less_means, offsets_of, shape_of, shares_of_pool
from quasi.identification.partition import TRAINING
from quasi.identification.products import Pool, Products
from quasi.identification.redundancy import drop_redundant
from quasi.identification.regression import Fit, count_pairs, least_squares, memory_window
from quasi.identification.steps import biases
from quasi.identification.stepwise import RIVALS, Options, Selection, select
from quasi.identification.structure import inclusion, leave_one_flight_out
from quasi.identification.warnings import warnings
from quasi.terms.expressions import Program, Tree, names
from quasi.terms.normalisation import Normalisation
from quasi.terms.singularities import remove_singularities
from quasi.terms.variables import Variables, base_columns, derive_unit

AXIS_UNITS = {**dict.fromkeys(("Fx", "Fy", "Fz"), "N"), **dict.fromkeys(("Mx", "My", "Mz"), "N m")}
ROTORS = ("w1", "w2", "w3", "w4")
NEAR_KEPT = 128  # candidates that came near being chosen, among which flights are left out and data resampled
SAME_SHARE = 0.02  # of a flight's means, and of the largest offset: a change that chooses no other terms
CONSTANT = Term(BIAS, ("number", 1.0))


def fit_axis(
    axis: str,
    flights: Mapping[str, pd.DataFrame],
    partition: Mapping[str, np.ndarray],
    airframe: Airframe,
    shared: Mapping[str, Any],
    config: Mapping[str, Any],
    specification: Specification,
    normalisation: Normalisation | None = None,
) -> dict[str, Any]:
    """Choose and fit the terms of one axis on the training rows.

    axis           "Fx" .. "Mz", a column of the flights
    flights        {key: filtered flight}; partition {key: (n,) role codes}
    shared         what `shared` found (the hover speed is used)
    config         "regressor cap", "entry test", "significance level", "F in", "F out", "stop criterion",
                   "structure choice", "bootstrap", "confidence level"; see the schema of a model. Resampling is
                   left out when "bootstrap" is
    specification  fixed regressors and candidates, and whether a constant belongs to the model
    normalisation  the non-dimensional scheme, or None; under it coefficients, covariance and sigma2 are those of F / N
                   or M / (N b), while R2 and RMSE compare the forces and moments themselves
    Returns plain data: terms, coefficients, units, standard errors, covariance, log, stop reason, sigma2, R2, n, ...
    Raises DataError or ExpressionError naming flight, column or regressor.
    """
    hover = shared.get("hover speed", {}).get("value")
    repeated: list[str] = []
    if normalisation:
        specification, repeated = drop_redundant(specification, normalisation, airframe)
    evaluated = {
        t.expression: _evaluated(t, airframe, normalisation) for t in (*specification.fixed, *specification.candidates)
    }
    # the written names too: a column that is missing is reported for the variable that the file names
    every = [t.tree for t in (*specification.fixed, *specification.candidates)]
    wanted = list(dict.fromkeys(n for tree in (*every, *evaluated.values()) for n in names(tree)))
    blocks, targets, shapes, series, dropped, scales = _training_rows(
        axis, flights, partition, airframe, hover, wanted, normalisation
    )
    raw = np.concatenate(targets)
    total = float(np.sum((raw - raw.mean()) ** 2))
    if total <= 0:
        raise DataError(f"{axis} is constant over the training rows; there is nothing to fit")
    targets = _less_known(targets, blocks, specification, evaluated)
    free = [t for t in specification.fixed if t.expression not in specification.known]
    first = [CONSTANT] if specification.bias else []
    terms = [*first, *free, *specification.candidates]
    described = [t.expression for t in terms]
    trees = [evaluated.get(t.expression, t.tree) for t in terms]
    if len(terms) == 0:
        raise DataError(f"{axis}: every fixed coefficient is given and there is no candidate; there is nothing to fit")

    rows = list(series.values())
    fixed = len(first) + len(free)
    pool = Pool(trees, fixed, blocks, targets, rows, specification.bias, shapes)
    options = options_of(config, len(specification.candidates))
    selection, near, held_out, share, offsets, products = choose(pool, options, config, described, total, rows)
    pool = pool.less_bends(offsets)
    chosen = [*range(fixed), *selection.chosen]
    log = [{**e, "bias": b} for e, b in zip(selection.log, biases(selection.log, pool, described))]
    if not chosen:
        raise DataError(f"{axis}: every fixed coefficient is given and no candidate entered; there is nothing to fit")

    program = Program([trees[k] for k in chosen])
    columns = np.vstack([program.run(block, len(z)).T for block, z in zip(blocks, targets)])
    sizes = [len(z) for z in targets]
    fit = least_squares(*(less_means(v, sizes, share) for v in (columns, np.concatenate(pool.targets))), rows)
    left = np.concatenate(targets) - columns @ fit.coefficients
    estimated = [described[k] for k in chosen]
    entries = _terms(axis, specification, terms, chosen, fixed, fit)
    if normalisation:
        entries = [{**entry, "unit": "1"} for entry in entries]
    alike = interchangeable(Totals(products), chosen, selection.bandwidth)
    _add_rivals(entries, alike, described)
    resampled = _resample(pool, products, near, selection, options, config, described, entries)
    measured, residuals = (raw, left) if scales is None else (raw * scales, left * scales)
    error, total = float(residuals @ residuals), float(np.sum((measured - measured.mean()) ** 2))
    return {
        "schema": "quasi.identified/1",
        "axis": axis,
        "unit": AXIS_UNITS[axis],
        "normalisation": normalisation.to_plain() if normalisation else None,
        "terms": entries,
        "estimated": estimated,
        "covariance": fit.covariance.tolist(),
        "sigma2": float(left @ left) / (len(left) - len(chosen)),
        "R2": 1.0 - error / total,
        "RMSE": float(np.sqrt(error / len(raw))),
        "n": len(raw),
        "effective rows": fit.effective_rows,
        "bandwidth": fit.bandwidth,
        "condition number": fit.condition,
        "confidence level": float(config.get("confidence level", 0.95)),
        "entry test": options.test,
        "log": log,
        "stop reason": selection.reason,
        "structure choice": held_out or {"by": "entry test"},
        "bootstrap": resampled,
        "candidates": len(specification.candidates),
        "duplicates": [list(pair) for pair in specification.duplicates],
        "unusable": {described[k]: why for k, why in pool.unusable.items()},
        "flights": {key: len(z) for key, z in zip(series, targets)},
        "share of flight means taken off": dict(zip(series, share.tolist())),
        "offsets of flights": dict(zip(series, offsets.tolist())),
        "dropped rows": dropped,
        "notes": repeated
        + _notes(axis, dropped, pool, described)
        + warnings(axis, entries, selection.log, fit, resampled),
    }


def _notes(axis: str, dropped: dict[str, int], pool: Pool, names: list[str]) -> list[str]:
    lost = [
        f"{axis}: {rows} training rows of flight {key} hold missing values and are left out"
        for key, rows in dropped.items()
    ]
    out = [f"{axis}: the candidate {names[k]} {why}; it is left out of the pool" for k, why in pool.unusable.items()]
    return lost + out


def options_of(config: Mapping[str, Any], candidates: int) -> Options:
    """How to select, from a model's configuration.

    A constant "F in" without a "significance level" is the manual's test; otherwise "entry test" decides, whose default
    is the significance over the whole pool.
    """
    manual = "F in" in config and "significance level" not in config
    return Options(
        cap=int(config.get("regressor cap", 10)),
        test=str(config.get("entry test", "F" if manual else "significance")),
        level=float(config.get("significance level", 0.05)),
        f_in=float(config.get("F in", 4.0)),
        f_out=float(config.get("F out", 4.0)),
        stop=str(config.get("stop criterion", "PSE")),
        pool=max(candidates, 1),
    )


class Choice(NamedTuple):
    """What `choose` found: the selection, the columns that came near, the result of leaving flights out or None, and
    the share (F,) of each flight's means that is taken off, the flights' offsets (F,), with the products that these
    leave."""

    selection: Selection
    near: list[int]
    held_out: dict[str, Any] | None
    share: np.ndarray
    offsets: np.ndarray
    products: Products


def choose(
    pool: Pool, options: Options, config: Mapping[str, Any], names: list[str], total: float, series: list[np.ndarray]
) -> Choice:
    """Select the terms, and with them how much flights differ by an offset; the manual's test knows none."""
    share, offsets, sizes = np.zeros(len(series)), np.zeros(len(series)), [len(rows) for rows in series]
    bare, products = pool, pool
    for _ in range(OFFSET_ROUNDS):
        selection, near, held_out = _choose(pool, products, share, options, config, names, total, series)
        columns = [*range(pool.fixed), *selection.chosen]
        if not (pool.constant and options.test == "significance"):
            break
        left = pool.residuals(columns, products.coefficients(columns))
        before, share = (share, offsets), shares_of_pool(pool, columns, left, series)
        offsets = offsets_of(left, share, sizes)
        pool = bare.less_bends(offsets)
        products = LessOffsets(pool, share) if share.any() else pool
        change = np.abs(offsets - before[1]).max() if pool.bends else 0.0
        if np.allclose(share, before[0], atol=SAME_SHARE) and change <= SAME_SHARE * np.abs(offsets).max():
            break
        total = float(products.target_square.sum() - products.target[:, 0].sum() ** 2 / products.square[:, 0].sum())
    return Choice(selection, near, held_out, share, offsets, products)


def _choose(
    pool: Pool, products: Products, share: np.ndarray, options: Options, config, names, total: float, series
) -> tuple[Selection, list[int], dict[str, Any] | None]:
    known: dict[tuple[int, ...], int] = {}
    sizes, pairs = [len(rows) for rows in series], count_pairs(series)

    def memory(columns: list[int]) -> int:
        key = tuple(sorted(columns))
        if key not in known:
            left = less_means(pool.residuals(columns, products.coefficients(columns)), sizes, share)
            known[key] = 1 + round(memory_window(left, series, pairs) / pool.length)
        return known[key]

    about = {"unusable": pool.unusable, "constant": pool.constant}
    if config.get("structure choice", "entry test") == "entry test":
        selection = select(products, options, names, total, memory=memory, **about)
        return selection, _near(pool, selection), None
    bare = Options(cap=options.cap, f_in=0.0, f_out=0.0, stop="none")
    near = _near(pool, select(products, bare, names, total, **about))
    found = leave_one_flight_out(products.subset(near), options.cap, [names[k] for k in near], pool.constant)
    selection = select(products, replace(bare, cap=found["steps"]), names, total, **about)
    reason = (
        f"left-out flights are predicted as well after {found['steps']} steps as after any number up to {options.cap} "
        f"(the smallest error is that after {found['smallest at']})"
    )
    bandwidth = memory([*range(pool.fixed), *selection.chosen])
    return replace(selection, reason=reason, bandwidth=bandwidth), near, {"by": "leave one flight out", **found}


def _near(pool: Pool, selection: Selection) -> list[int]:
    order = sorted(selection.seen, key=lambda k: -selection.seen[k])[:NEAR_KEPT]
    return [*range(pool.fixed), *sorted(order)]


def _resample(pool, products, near, selection, options, config, names, entries) -> dict[str, Any] | None:
    resamples = int(config.get("bootstrap", 0))
    if not resamples or len(near) == pool.fixed:
        return None
    if config.get("structure choice", "entry test") != "entry test":
        options = Options(cap=len(selection.log) - 1, f_in=0.0, f_out=0.0, stop="none")
    shown = [names[k] for k in near]
    found = inclusion(products.subset(near), options, shown, pool.constant, resamples, selection.bandwidth)
    share = dict(zip(shown, found["share"]))
    place = {name: i for i, name in enumerate(shown)}
    for term in entries:
        if not term["fixed"]:
            rivals = [r["expression"] for r in term["interchangeable with"] if r["expression"] in place]
            which = [place[term["name"]], *(place[r] for r in rivals)]
            term["inclusion frequency"] = float(share[term["name"]])
            term["inclusion frequency with rivals"] = float(found["together"][:, which].any(axis=1).mean())
    taken = {t["name"] for t in entries}
    others = sorted((n for n in shown if n not in taken and share[n] > 0.0), key=lambda n: -share[n])
    return {
        "resamples": found["resamples"],
        "of": found["of"],
        "units": found["units"],
        "candidates": len(near) - pool.fixed,
        "others": [{"expression": n, "inclusion frequency": float(share[n])} for n in others[:10]],
    }


def _add_rivals(entries: list[dict[str, Any]], alike: dict[int, list[dict]], names: list[str]) -> None:
    by_name = {names[k]: rivals for k, rivals in alike.items()}
    for entry in entries:
        if entry["name"] in by_name:
            rivals = by_name[entry["name"]]
            entry["interchangeable with"] = [
                {"expression": names[r["column"]], "share of gain": r["share of gain"], "worse by": r["worse by"]}
                for r in rivals[:RIVALS]
            ]
            entry["rivals"] = len(rivals)


def _training_rows(
    axis, flights, partition, airframe, hover, wanted, normalisation
) -> tuple[list, list, list, dict, dict, np.ndarray | None]:
    needed = sorted(set().union(*(base_columns(n, normalisation) for n in wanted), ROTORS if normalisation else ()))
    blocks, targets, shapes, series, dropped, scales = [], [], [], {}, {}, []
    for key, flight in flights.items():
        rows = np.flatnonzero(partition[key] == TRAINING)
        if not len(rows):
            continue
        if axis not in flight:
            raise DataError(f"flight {key} has no column '{axis}'{nearest(axis, flight.columns)}; filter it anew")
        columns = {name: flight[name].to_numpy(float)[rows] for name in flight.columns if name != "t"}
        variables = Variables(columns, airframe, hover, normalisation)
        try:
            scale = normalisation.scale_of(axis, {w: variables.column(w) for w in ROTORS}) if normalisation else 1.0
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
        targets.append((columns[axis] / scale)[good])
        shapes.append(shape_of(axis, columns, np.flatnonzero(good), scale))
        if normalisation:
            scales.append(scale[good])
        series[key] = rows[good]
    if not sum(map(len, targets)):
        raise DataError(
            f"{axis}: no training rows are left in the flights {', '.join(map(str, flights))} "
            f"({sum(dropped.values())} lost to missing values); check the columns that the specification names"
        )
    return blocks, targets, shapes, series, dropped, np.concatenate(scales) if scales else None


def _evaluated(term: Term, airframe: Airframe, normalisation: Normalisation | None) -> Tree:
    """The expression that is evaluated for a term."""
    return term.tree if normalisation else remove_singularities(term.tree, airframe.radius)


def _less_known(
    targets: list[np.ndarray], blocks: list[dict], specification: Specification, evaluated: Mapping[str, Tree]
) -> list[np.ndarray]:
    known = [t for t in specification.fixed if t.expression in specification.known]
    if not known:
        return targets
    program = Program([evaluated[t.expression] for t in known])
    weights = np.array([specification.known[t.expression] for t in known])
    return [z - weights @ program.run(block, len(z)) for z, block in zip(targets, blocks)]


def _terms(axis, specification, terms, chosen, fixed, fit: Fit) -> list[dict[str, Any]]:
    entries = []
    for i, k in enumerate(chosen):
        std, plain = (float(np.sqrt(c[i, i])) for c in (fit.covariance, fit.plain_covariance))
        value = float(fit.coefficients[i])
        entries.append(
            {
                "name": terms[k].expression,
                "expression": "1" if terms[k] is CONSTANT else terms[k].expression,
                "coefficient": value,
                "std": std,
                "plain std": plain,
                "t": value / std if std > 0 else None,
                "unit": derive_unit(terms[k].tree, axis),
                "fixed": k < fixed,
                "inflation": float(fit.inflation[i]) if np.isfinite(fit.inflation[i]) else None,
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
                    "unit": derive_unit(term.tree, axis),
                    "fixed": True,
                    "given": True,
                }
            )
    return entries
