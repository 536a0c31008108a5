"""Does the model hold beyond its training rows, and if not, why: the checks of the manual and a verdict in words.

- RMSE on training, test and validation rows, their relative differences, and the manual's 10 % rules;
- the same per quartile of the measured range, with how the rows of each role are spread over it;
- coverage of the prediction intervals;
- coverage of the validation data by the training data, variable by variable.

Source: QuaSI user manual V1.0.a, 6.5.2 and 6.5.3.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.model.envelope import HIGH, LOW, limited_names
from quasi.model.model import Model
from quasi.scoring.score import POOLED, Judged
from quasi.scoring.verdict import ORDER, beside_base, headline, shortly, verdict
from quasi.tables import ANY
from quasi.terms.expressions import names, parse
from quasi.terms.variables import Variables

SCHEMA = "quasi.diagnostics/1"
RULE = 0.10  # relative difference in RMSE from which it is significant
BINS = 60
BANDS = ("lower 25 %", "middle 50 %", "upper 25 %")
COVERAGE_UNITS = {
    "variable": ("", "", "variable of the model's terms; 'any of Fx' all of that axis"),
    "below": ("1", "", "share of validation rows below the 0.01 % percentile of the training rows"),
    "above": ("1", "", "share of validation rows above the 99.99 % percentile of the training rows"),
    **{f"training_{c}": ("SI", "", f"{c} of the training rows") for c in ("min", "max", "p1", "p99")},
    **{c: ("SI", "", f"{c} of the validation rows") for c in ("min", "max", "p1", "p99")},
}


def diagnose(
    model: Model,
    judged: Mapping[str, Judged],
    scores: pd.DataFrame,
    coverage: pd.DataFrame,
    beyond: Mapping[str, np.ndarray],
    roles: Mapping[str, int],
    partitioning: Mapping[str, Any] | None = None,
    base: tuple[str, pd.DataFrame] | None = None,
) -> dict[str, Any]:
    """The checks of every axis and a verdict in words, as plain data ("quasi.diagnostics/1").

    judged, scores  of the same rows (`judge`, `score_judged`); coverage, beyond  of `covered_share`
    roles           {name: code}; partitioning  the model's "data partitioning"
    base            ID and scores, on the same rows, of the model that a gap extended; None for any other
    """
    axes = {}
    for axis in model.axes:
        pooled = scores[(scores["flight"] == POOLED) & (scores["axis"] == axis)].set_index("role")
        facts = _facts(pooled)
        facts["quartiles"] = quartiles(judged[axis], roles)
        facts["histogram"] = histogram(judged[axis], roles)
        facts["interval"] = _interval(judged[axis], pooled, roles)
        facts["outside"] = _outside(model, axis, coverage, beyond.get(axis), judged[axis], roles)
        facts["unit"] = model.document["axes"][axis]["unit"]
        facts["base"] = _base(*base, axis) if base else None
        facts |= verdict(axis, facts, bool(model.document.get("extensions")))
        axes[axis] = facts
    worst = max((facts["verdict"] for facts in axes.values()), key=ORDER.index)
    # scores do not show it: a polynomial fits whatever the rotors are called, and flies another vehicle
    wrong = model.document.get("contradictions") or []
    if wrong:
        worst = ORDER[2]
    return {
        "schema": SCHEMA,
        "model": model.id,
        "verdict": worst,
        "shortly": "; ".join([*wrong, *beside_base(axes), shortly(axes)]),
        "summary": [*wrong, *beside_base(axes), *headline(axes)],
        "partition": _leak(partitioning or {}, scores),
        "axes": axes,
    }


def _base(name: str, scores: pd.DataFrame, axis: str) -> dict[str, Any] | None:
    """Name and validation scores of an axis of the base, None where it was not judged."""
    of_axis = scores[(scores["flight"] == POOLED) & (scores["axis"] == axis) & (scores["role"] == "validation")]
    if not len(of_axis) or not of_axis["n"].iloc[0]:
        return None
    return {"id": name, "rmse": _plain(of_axis["rmse"].iloc[0]), "r2": _plain(of_axis["r2"].iloc[0])}


def _facts(pooled: pd.DataFrame) -> dict[str, Any]:
    known = [r for r in ("training", "test", "validation") if r in pooled.index and pooled.loc[r, "n"] > 0]
    facts = {
        name: {role: _plain(pooled.loc[role, column]) for role in known}
        for name, column in (
            ("rmse", "rmse"), ("relative rmse", "relative_rmse"), ("r2", "r2"), ("bias", "bias"), ("rows", "n"),
        )
    }  # fmt: skip
    rmse = facts["rmse"]
    # the manual's two figures, in its own sense: 100 (1 - training / test), 100 (1 - validation / test)
    facts["relative difference"] = {
        "test and training": _difference(rmse, "training", "test"),
        "test and validation": _difference(rmse, "validation", "test"),
        "validation above training": _above(rmse, "validation", "training"),
        "test above training": _above(rmse, "test", "training"),
        "validation above training, relative": _above(facts["relative rmse"], "validation", "training"),
    }
    test, validation = (facts["relative difference"][k] for k in ("test and training", "test and validation"))
    facts["warnings"] = {
        "test": test is not None and test > 100 * RULE,
        "validation": validation is not None and validation < -100 * RULE,
    }
    return facts


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _difference(values: Mapping[str, float | None], of: str, against: str) -> float | None:
    a, b = values.get(of), values.get(against)
    return 100.0 - 100.0 * a / b if a is not None and b else None


def _above(values: Mapping[str, float | None], of: str, against: str) -> float | None:
    a, b = values.get(of), values.get(against)
    return 100.0 * (a / b - 1.0) if a is not None and b else None


def quartiles(found: Judged, roles: Mapping[str, int]) -> list[dict[str, Any]]:
    """RMSE and share of the rows of each role in the lowest 25 %, middle 50 % and highest 25 % of what was measured.

    The bounds are those of all rows of these roles together. Each band also holds the manual's ratios X/T and V/T.
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
    for k, name in enumerate(BANDS):
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
                "X/T": _ratio(rmse, "training", "test"), "V/T": _ratio(rmse, "validation", "test"),
            }
        )  # fmt: skip
    return result


def _ratio(values: Mapping[str, float], a: str, b: str) -> float | None:
    return values[a] / values[b] if a in values and values.get(b) else None


def histogram(found: Judged, roles: Mapping[str, int]) -> dict[str, Any]:
    """Density of the measured values of each role over common bins, 1 / unit; the end bins hold all beyond them."""
    fine = np.isfinite(found.measured) & np.isin(found.role, list(roles.values()))
    if not fine.any():
        return {"edges": [], "density": {}}
    low, high = np.percentile(found.measured[fine], [0.1, 99.9])
    edges = np.linspace(low, high if high > low else low + 1.0, BINS + 1)
    density = {}
    for word, code in roles.items():
        values = found.measured[fine & (found.role == code)]
        if len(values):
            density[word] = np.histogram(np.clip(values, edges[0], edges[-1]), edges, density=True)[0].tolist()
    return {"edges": edges.tolist(), "density": density}


def _interval(found: Judged, pooled: pd.DataFrame, roles: Mapping[str, int]) -> dict[str, Any]:
    known = np.isin(found.role, list(roles.values())) & np.isfinite(found.measured) & np.isfinite(found.upper)
    inside = (found.measured >= found.lower) & (found.measured <= found.upper)
    span = float(np.ptp(found.measured[known])) if known.any() else 0.0
    width = float(np.mean((found.upper - found.lower)[known])) if known.any() else None
    return {
        "confidence": float(pooled["confidence"].iloc[0]),
        "coverage": {"all": float(np.mean(inside[known])) if known.any() else None}
        | {role: _plain(pooled.loc[role, "coverage"]) for role in pooled.index},
        "mean width": width,
        "width over measured range": width / span if width is not None and span > 0 else None,
    }


def covered_share(
    model: Model, flights: Mapping[str, pd.DataFrame], rows: Mapping[str, np.ndarray]
) -> tuple[pd.DataFrame, dict[str, np.ndarray]]:
    """How far the training data cover these rows, one line per variable of the model's terms.

    flights  held-out flights; rows {flight: (n,) bool} those to look at
    Returns a table and {axis: (m,) bool}, those of all these rows with some variable of the axis beyond the training
    rows' 0.01 % to 99.99 % percentiles. The table's columns: variable; below, above (shares of the rows beyond them);
    the training rows' and these rows' least, largest, 1 % and 99 % percentile. Its last lines, "any of Fx" and so on,
    hold under `above` the share of rows with some variable of that axis beyond. Empty without rows.
    """
    known = model.document["envelope"]
    of_axis = {axis: [n for n in _variables(model, axis) if LOW in known.get(n, {}).get("percentiles", {})]
               for axis in model.axes}  # fmt: skip
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
        below, above = here < there[LOW], here > there[HIGH]
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
    lines += [{"variable": f"{ANY}{a}", "below": 0.0, "above": float(np.mean(b))} for a, b in beyond.items()]
    return pd.DataFrame(lines, columns=list(COVERAGE_UNITS)), beyond


def _variables(model: Model, axis: str) -> list[str]:
    terms = model.document["axes"][axis]["terms"]
    return limited_names(n for term in terms for n in names(parse(term["expression"])))


def _outside(
    model: Model,
    axis: str,
    coverage: pd.DataFrame,
    beyond: np.ndarray | None,
    found: Judged,
    roles: Mapping[str, int],
) -> dict[str, Any]:
    """Share of the validation rows beyond the training data, the variables that say so, the RMSE of the others."""
    if beyond is None or not len(beyond):
        return {"share": None, "variables": {}, "rmse inside": None}
    lines = coverage.set_index("variable")
    shares = {
        name: float(lines.loc[name, "below"] + lines.loc[name, "above"])
        for name in _variables(model, axis)
        if name in lines.index
    }
    worst = dict(sorted(((n, s) for n, s in shares.items() if s > 0.002), key=lambda pair: -pair[1])[:5])
    held = found.role == roles["validation"]
    square = (found.measured[held] - found.predicted[held])[~beyond] ** 2
    square = square[np.isfinite(square)]
    inside = float(np.sqrt(np.mean(square))) if len(square) else None
    return {"share": float(beyond.mean()), "variables": worst, "rmse inside": inside}


def _leak(partitioning: Mapping[str, Any], scores: pd.DataFrame) -> dict[str, Any]:
    by = partitioning.get("partition by", "samples") if partitioning.get("random partition", True) else None
    note = None
    if by == "samples" and (scores["role"] == "test").any():
        note = (
            "the test rows are single samples whose neighbours train, so that they leak: they say little about new "
            'flights; judge by validation flights, or set \'partition by\' to "blocks" or "flights"'
        )
    elif by is None:
        judged = "; the validation flights stand for them" if (scores["role"] == "validation").any() else ""
        note = f"no test rows were drawn{judged}"
    return {"by": by, "note": note}
