"""From identified axes to a model: assembly of the plain data, and the region that its data covered."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.airframe import Airframe, to_plain
from quasi.errors import ConfigError
from quasi.expressions import names, parse
from quasi.standalone.model import AXES, SCHEMA, STATE, Model
from quasi.tables import COLUMNS
from quasi.variables import Variables

PERCENTILES = (1, 5, 25, 50, 75, 95, 99)


def assemble(
    parts: Mapping[str, Mapping[str, Any]], shared: Mapping[str, Any], meta: Mapping[str, Any]
) -> dict[str, Any]:
    """The whole model as plain data ("quasi.model/1"), checked by reading it.

    parts   {axis: what the identification of the axis found}
    shared  hover speed, simple model, actuators, gravity kind, training flights
    meta    "id", "airframe" (Airframe); optional "logged to rad/s", "validation flights", "envelope", "provenance",
            "notes"
    Raises ConfigError when no axis is given.
    """
    if not parts:
        raise ConfigError(f"model {meta['id']} has no identified axis; switch at least one 'identify ...' on")
    keep = ("unit", "terms", "estimated", "covariance", "sigma2", "R2", "RMSE", "n", "effective rows", "bandwidth",
            "condition number", "confidence level", "log", "stop reason", "candidates", "flights")  # fmt: skip
    document = {
        "schema": SCHEMA,
        "id": meta["id"],
        "gravity": shared["gravity"],
        "airframe": to_plain(meta["airframe"]),
        "logged to rad/s": meta.get("logged to rad/s"),
        "hover speed": shared["hover speed"],
        "simple model": shared["simple model"],
        "actuators": shared["actuators"],
        "flights": {
            "training": list(shared["training flights"]),
            "validation": list(meta.get("validation flights", [])),
        },
        "axes": {axis: {k: parts[axis][k] for k in keep if k in parts[axis]} for axis in AXES if axis in parts},
        "envelope": dict(meta.get("envelope", {})),
        "extensions": [],
        "notes": [
            *meta.get("notes", []),
            *shared["notes"],
            *(n for a in AXES if a in parts for n in parts[a]["notes"]),
        ],
        "provenance": dict(meta.get("provenance", {})),
    }
    Model(document, f"model {meta['id']}")
    return document


def envelope(
    flights: Mapping[str, pd.DataFrame],
    rows: Mapping[str, np.ndarray],
    airframe: Airframe,
    hover_speed: float | None,
    parts: Mapping[str, Mapping[str, Any]] | None = None,
) -> dict[str, dict[str, Any]]:
    """Region of the training data: per variable its smallest and largest value and percentiles.

    flights  filtered flights; rows {flight: (n,) bool} the training rows
    parts    identified axes, whose terms' variables are included beside the state and the rotor speeds
    """
    wanted = [*STATE, "w1", "w2", "w3", "w4"]
    for part in (parts or {}).values():
        for term in part["terms"]:
            wanted += [n for n in names(parse(term["expression"])) if n not in wanted]
    gathered: dict[str, list[np.ndarray]] = {}
    for key, flight in flights.items():
        use = np.asarray(rows[key], bool)
        if not use.any():
            continue
        columns = {c: flight[c].to_numpy(float)[use] for c in flight if pd.api.types.is_numeric_dtype(flight[c])}
        variables = Variables(columns, airframe, hover_speed)
        for name in wanted:
            if name in STATE and name not in columns:
                continue
            values = variables[name]
            gathered.setdefault(name, []).append(values[np.isfinite(values)])
    result = {}
    for name, chunks in gathered.items():
        values = np.concatenate(chunks)
        if len(values):
            shares = np.percentile(values, PERCENTILES)
            result[name] = {
                "min": float(values.min()),
                "max": float(values.max()),
                "percentiles": {str(p): float(s) for p, s in zip(PERCENTILES, shares)},
            } | ({"unit": COLUMNS[name][0]} if name in COLUMNS else {})
    return result
