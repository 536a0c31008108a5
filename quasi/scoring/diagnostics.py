"""Generalisation of a model beyond its training rows: the checks of the manual, and a verdict.

- RMSE on training, test and validation rows, their relative differences, and the manual's 10 % rules;
- the same per quartile of the measured range, with the distribution of the rows of each role;
- coverage of the prediction intervals;
- coverage of the validation data by the training data, variable by variable.

Source: QuaSI user manual V1.0.a, 6.5.2 and 6.5.3.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.model.envelope import HIGH_PERCENTILE, LOW_PERCENTILE, list_limited_names
from quasi.model.model import Model
from quasi.scoring.score import POOLED, AxisComparison
from quasi.scoring.verdict import VERDICTS, compare_with_base, derive_verdict, group_axes_by_kind, summarise_axes
from quasi.tables import ANY_PREFIX
from quasi.terms.expressions import names, parse
from quasi.terms.variables import Variables

DIAGNOSTICS_SCHEMA = "quasi.diagnostics/2"
SIGNIFICANT_SHARE = 0.10  # relative difference in RMSE from which it is significant
HISTOGRAM_BINS = 60
QUARTILE_BANDS = ("lower 25 %", "middle 50 %", "upper 25 %")
COVERAGE_UNITS = {
    "variable": ("", "", "variable of the model's terms; 'any of Fx' all of that axis"),
    "below": ("1", "", "share of validation rows below the 0.01 % percentile of the training rows"),
    "above": ("1", "", "share of validation rows above the 99.99 % percentile of the training rows"),
    **{f"training_{c}": ("SI", "", f"{c} of the training rows") for c in ("min", "max", "p1", "p99")},
    **{c: ("SI", "", f"{c} of the validation rows") for c in ("min", "max", "p1", "p99")},
}


def diagnose(
    model: Model,
    comparisons: Mapping[str, AxisComparison],
    scores: pd.DataFrame,
    coverage: pd.DataFrame,
    beyond: Mapping[str, np.ndarray],
    roles: Mapping[str, int],
    partitioning: Mapping[str, Any] | None = None,
    base: tuple[str, pd.DataFrame] | None = None,
) -> dict[str, Any]:
    """Check every axis and derive a verdict, as plain data ("quasi.diagnostics/2").

    comparisons, scores  of the same rows, see `quasi.scoring.score`; coverage, beyond  of `compute_coverage`
    roles  {name: code}; partitioning  the model's "data partitioning"
    base   ID and scores, on the same rows, of the model that a gap extended; None for any other
    """
    axes = {}
    for axis in model.axes:
        pooled = scores[(scores["flight"] == POOLED) & (scores["axis"] == axis)].set_index("role")
        facts = _collect_facts(pooled)
        facts["quartiles"] = compute_quartiles(comparisons[axis], roles)
        facts["histogram"] = compute_histogram(comparisons[axis], roles)
        facts["interval"] = _describe_interval(comparisons[axis], pooled, roles)
        facts["outside"] = _describe_outside(model, axis, coverage, beyond.get(axis), comparisons[axis], roles)
        facts["unit"] = model.document["axes"][axis]["unit"]
        facts["base"] = _read_base_scores(*base, axis) if base else None
        facts |= derive_verdict(axis, facts, bool(model.document.get("extensions")))
        axes[axis] = facts
    worst = max((facts["verdict"] for facts in axes.values()), key=VERDICTS.index)
    # scores do not show wrong rotor numbers: the polynomial fits, but describes another vehicle
    wrong = model.document.get("contradictions") or []
    if wrong:
        worst = VERDICTS[2]
    return {
        "schema": DIAGNOSTICS_SCHEMA,
        "model": model.id,
        "verdict": worst,
        "in short": "; ".join([*wrong, *compare_with_base(axes), group_axes_by_kind(axes)]),
        "summary": [*wrong, *compare_with_base(axes), *summarise_axes(axes)],
        "partition": _describe_partition(partitioning or {}, scores),
        "axes": axes,
    }


def _read_base_scores(name: str, scores: pd.DataFrame, axis: str) -> dict[str, Any] | None:
    """Read name and validation scores of an axis of the base, None without scores."""
    of_axis = scores[(scores["flight"] == POOLED) & (scores["axis"] == axis) & (scores["role"] == "validation")]
    if not len(of_axis) or not of_axis["n"].iloc[0]:
        return None
    return {"id": name, "rmse": _finite_or_none(of_axis["rmse"].iloc[0]), "r2": _finite_or_none(of_axis["r2"].iloc[0])}


def _collect_facts(pooled: pd.DataFrame) -> dict[str, Any]:
    known = [r for r in ("training", "test", "validation") if r in pooled.index and pooled.loc[r, "n"] > 0]
    facts = {
        name: {role: _finite_or_none(pooled.loc[role, column]) for role in known}
        for name, column in (
            ("rmse", "rmse"), ("relative rmse", "relative_rmse"), ("r2", "r2"), ("bias", "bias"), ("rows", "n"),
        )
    }  # fmt: skip
    rmse = facts["rmse"]
    # the manual's two figures, as it defines them: 100 (1 - training / test), 100 (1 - validation / test)
    facts["relative difference"] = {
        "test and training": _percent_difference(rmse, "training"),
        "test and validation": _percent_difference(rmse, "validation"),
        "validation above training": _percent_above_training(rmse, "validation"),
        "test above training": _percent_above_training(rmse, "test"),
        "validation above training, relative": _percent_above_training(facts["relative rmse"], "validation"),
    }
    test, validation = (facts["relative difference"][k] for k in ("test and training", "test and validation"))
    facts["warnings"] = {
        "test": test is not None and test > 100 * SIGNIFICANT_SHARE,
        "validation": validation is not None and validation < -100 * SIGNIFICANT_SHARE,
    }
    return facts


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _percent_difference(values: Mapping[str, float | None], of: str) -> float | None:
    a, b = values.get(of), values.get("test")
    return 100.0 - 100.0 * a / b if a is not None and b else None


def _percent_above_training(values: Mapping[str, float | None], of: str) -> float | None:
    a, b = values.get(of), values.get("training")
    return 100.0 * (a / b - 1.0) if a is not None and b else None


def compute_quartiles(found: AxisComparison, roles: Mapping[str, int]) -> list[dict[str, Any]]:
    """RMSE and share of the rows of each role in the lowest 25 %, middle 50 % and highest 25 % of the measurements.

    The bounds are those of all rows of these roles. Each band also has the manual's ratios X/T and V/T.
    """
    fine = np.isfinite(found.measured) & np.isfinite(found.predicted) & np.isin(found.role, list(roles.values()))
    measured = found.measured[fine]
    if not len(measured):
        return []
    bounds = np.percentile(measured, [25, 75])
    band = np.searchsorted(bounds, measured, side="left")
    square = (measured - found.predicted[fine]) ** 2
    role = found.role[fine]
    edges = [float(measured.min()), *bounds.tolist(), float(measured.max())]
    result = []
    for k, name in enumerate(QUARTILE_BANDS):
        rmse, share = {}, {}
        for word, code in roles.items():
            here = role == code
            inside = here & (band == k)
            if here.any():
                share[word] = float(np.count_nonzero(inside) / np.count_nonzero(here))
            if inside.any():
                rmse[word] = float(np.sqrt(np.mean(square[inside])))
        result.append(
            {
                "band": name, "from": edges[k], "to": edges[k + 1], "rmse": rmse, "share": share,
                "X/T": _over_test(rmse, "training"), "V/T": _over_test(rmse, "validation"),
            }
        )  # fmt: skip
    return result


def _over_test(values: Mapping[str, float], of: str) -> float | None:
    return values[of] / values["test"] if of in values and values.get("test") else None


def compute_histogram(found: AxisComparison, roles: Mapping[str, int]) -> dict[str, Any]:
    """Density of the measured values of each role over common bins, 1 / unit; the end bins include all values
    beyond.
    """
    fine = np.isfinite(found.measured) & np.isin(found.role, list(roles.values()))
    if not fine.any():
        return {"edges": [], "density": {}}
    low, high = np.percentile(found.measured[fine], [0.1, 99.9])
    edges = np.linspace(low, high if high > low else low + 1.0, HISTOGRAM_BINS + 1)
    density = {}
    for word, code in roles.items():
        values = found.measured[fine & (found.role == code)]
        if len(values):
            density[word] = np.histogram(np.clip(values, edges[0], edges[-1]), edges, density=True)[0].tolist()
    return {"edges": edges.tolist(), "density": density}


def _describe_interval(found: AxisComparison, pooled: pd.DataFrame, roles: Mapping[str, int]) -> dict[str, Any]:
    known = np.isin(found.role, list(roles.values())) & np.isfinite(found.measured) & np.isfinite(found.upper)
    inside = (found.measured >= found.lower) & (found.measured <= found.upper)
    span = float(np.ptp(found.measured[known])) if known.any() else 0.0
    width = float(np.mean((found.upper - found.lower)[known])) if known.any() else None
    return {
        "confidence": float(pooled["confidence"].iloc[0]),
        "coverage": {"all": float(np.mean(inside[known])) if known.any() else None}
        | {role: _finite_or_none(pooled.loc[role, "coverage"]) for role in pooled.index},
        "mean width": width,
        "width over measured range": width / span if width is not None and span > 0 else None,
    }


def compute_coverage(
    model: Model, flights: Mapping[str, pd.DataFrame], rows: Mapping[str, np.ndarray]
) -> tuple[pd.DataFrame, dict[str, np.ndarray]]:
    """Compute how far the training data cover these rows, one line per variable of the model's terms.

    flights  held-out flights; rows {flight: (n,) bool} to evaluate
    Returns a table and {axis: (m,) bool}, the rows with some variable of the axis beyond the training rows' 0.01 % to
    99.99 % percentiles. The table's columns: variable; below, above (shares of the rows beyond the percentiles); least,
    largest, 1 % and 99 % percentile of the training rows and of these rows. In its last lines, "any of Fx" and so on,
    `above` is the share of rows with some variable of that axis beyond. Empty without rows.
    """
    known = model.document["envelope"]
    of_axis = {}
    for axis in model.axes:
        variables = _list_variables(model, axis)
        of_axis[axis] = [n for n in variables if LOW_PERCENTILE in known.get(n, {}).get("percentiles", {})]
    wanted = list(dict.fromkeys(n for some in of_axis.values() for n in some))
    values: dict[str, list[np.ndarray]] = {n: [] for n in wanted}
    for key, flight in flights.items():
        part = flight[np.asarray(rows[key], bool)]
        lookup = Variables(
            {c: part[c].to_numpy(float) for c in part if pd.api.types.is_numeric_dtype(part[c])},
            model.airframe,
            model.hover_speed,
            slowest=model.slowest,
        )
        for name in wanted:
            values[name].append(lookup[name])
    if not flights or not sum(map(len, next(iter(values.values()), []))):
        return pd.DataFrame(columns=list(COVERAGE_UNITS)), {}
    lines, out = [], {}
    for name in wanted:
        here = np.concatenate(values[name])
        there = known[name]["percentiles"]
        below, above = here < there[LOW_PERCENTILE], here > there[HIGH_PERCENTILE]
        out[name] = below | above
        fine = here[np.isfinite(here)]
        shares = np.percentile(fine, [1, 99]) if len(fine) else [np.nan, np.nan]
        lines.append(
            {
                "variable": name, "below": float(below.mean()), "above": float(above.mean()),
                "training_min": known[name]["min"], "training_max": known[name]["max"],
                "training_p1": there["1"], "training_p99": there["99"],
                "min": float(fine.min()) if len(fine) else np.nan, "max": float(fine.max()) if len(fine) else np.nan,
                "p1": float(shares[0]), "p99": float(shares[1]),
            }
        )  # fmt: skip
    count = sum(int(np.count_nonzero(r)) for r in rows.values())
    beyond = {
        axis: np.any([out[n] for n in some], axis=0) if some else np.zeros(count, bool)
        for axis, some in of_axis.items()
    }
    lines += [{"variable": f"{ANY_PREFIX}{a}", "below": 0.0, "above": float(np.mean(b))} for a, b in beyond.items()]
    return pd.DataFrame(lines, columns=list(COVERAGE_UNITS)), beyond


def _list_variables(model: Model, axis: str) -> list[str]:
    terms = model.document["axes"][axis]["terms"]
    return list_limited_names(n for term in terms for n in names(parse(term["expression"])))


def _describe_outside(
    model: Model,
    axis: str,
    coverage: pd.DataFrame,
    beyond: np.ndarray | None,
    found: AxisComparison,
    roles: Mapping[str, int],
) -> dict[str, Any]:
    """Share of the validation rows beyond the training data, the responsible variables, the RMSE of the other rows."""
    if beyond is None or not len(beyond):
        return {"share": None, "variables": {}, "rmse inside": None}
    lines = coverage.set_index("variable")
    shares = {
        name: float(lines.loc[name, "below"] + lines.loc[name, "above"])
        for name in _list_variables(model, axis)
        if name in lines.index
    }
    worst = dict(sorted(((n, s) for n, s in shares.items() if s > 0.002), key=lambda pair: -pair[1])[:5])
    held = found.role == roles["validation"]
    square = (found.measured[held] - found.predicted[held])[~beyond] ** 2
    square = square[np.isfinite(square)]
    inside = float(np.sqrt(np.mean(square))) if len(square) else None
    return {"share": float(beyond.mean()), "variables": worst, "rmse inside": inside}


def _describe_partition(partitioning: Mapping[str, Any], scores: pd.DataFrame) -> dict[str, Any]:
    by = partitioning.get("partition by", "samples") if partitioning.get("random partition", True) else None
    note = None
    if by == "samples" and (scores["role"] == "test").any():
        note = (
            "the test rows are single samples between training samples, so they leak and prove little about new "
            'flights; judge by validation flights, or set \'partition by\' to "blocks" or "flights"'
        )
    elif by is None:
        comparisons = "; the validation flights replace them" if (scores["role"] == "validation").any() else ""
        note = f"no test rows were drawn{comparisons}"
    return {"by": by, "note": note}
