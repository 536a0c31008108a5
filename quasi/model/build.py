"""Assembly of a model's plain data from identified axes."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from quasi.airframe import to_plain
from quasi.errors import ConfigError
from quasi.model.document import AXES, MODEL_SCHEMA
from quasi.model.model import Model
from quasi.terms.differential import RATES
from quasi.terms.variables import check_system_inputs


def assemble_model(
    parts: Mapping[str, Mapping[str, Any]], shared: Mapping[str, Any], meta: Mapping[str, Any]
) -> dict[str, Any]:
    """Assemble the whole model as plain data ("quasi.model/1"), checked by reading it.

    parts   {axis: what the identification of the axis found}
    shared  hover speed, simple model, actuators, gravity kind, training flights
    meta    "id", "airframe" (Airframe); optional "logged to rad/s", "validation flights", "provenance", "notes", and
            "envelope", "joint envelope" as `quasi.model.envelope.measure_coverage` finds them
    Raises ConfigError when no axis is given.
    """
    if not parts:
        raise ConfigError(f"model {meta['id']} has no identified axis; switch at least one 'identify ...' on")
    keep = ("unit", "terms", "estimated", "covariance", "sigma2", "R2", "RMSE", "n", "effective rows", "bandwidth",
            "condition number", "confidence level", "log", "stop reason", "candidates", "flights", "bootstrap",
            "structure choice", "entry test")  # fmt: skip
    document = {
        "schema": MODEL_SCHEMA,
        "id": meta["id"],
        "gravity": shared["gravity"],
        "airframe": to_plain(meta["airframe"]),
        "logged to rad/s": meta.get("logged to rad/s"),
        "hover speed": shared["hover speed"],
        "simple model": shared["simple model"],
        "actuators": shared["actuators"],
        "rotor speeds": shared.get("rotor speeds"),
        "flights": {
            "training": list(shared["training flights"]),
            "validation": list(meta.get("validation flights", [])),
        },
        "recordings": dict(shared.get("recordings", {})),
        "axes": {axis: {k: parts[axis][k] for k in keep if k in parts[axis]} for axis in AXES if axis in parts},
        "normalisation": _read_scheme(parts, meta["id"]),
        "envelope": dict(meta.get("envelope", {})),
        "joint envelope": dict(meta.get("joint envelope", {})),
        "extensions": [],
        "contradictions": list(shared.get("contradictions", [])),
        "notes": [
            *meta.get("notes", []),
            *shared["notes"],
            *(n for a in AXES if a in parts for n in parts[a]["notes"]),
        ],
        "provenance": dict(meta.get("provenance", {})),
    }
    Model(document, f"model {meta['id']}")
    return document


def _read_scheme(parts: Mapping[str, Mapping[str, Any]], name: str) -> dict[str, float] | None:
    schemes = [part.get("normalisation") for part in parts.values()]
    if any(scheme != schemes[0] for scheme in schemes):
        raise ConfigError(f"model {name}: its axes differ in normalisation; identify all of them again")
    return schemes[0]


def add_differential_form(document: Mapping[str, Any], u: Iterable[str], where: str) -> dict[str, Any]:
    """The model with the inputs of its differential form, and notes on what it keeps constant or never uses.

    Raises ConfigError for inputs that cannot be, or when a moment was not identified.
    """
    model = Model(document, where)
    u = check_system_inputs(u, where)
    lacking = [axis for axis in AXES[3:] if axis not in model.axes]
    if lacking:
        raise ConfigError(
            f"{where}: a differential form needs all three moments, but {', '.join(lacking)} is not identified; "
            "identify it or set 'make moment DiffSys' to false"
        )
    kept, kernel = model.held_constant(u), model.derivative_kernel(u)
    notes = []
    if kept:
        notes.append(
            f"differential form: B keeps constant what else depends on the rotor speeds ({', '.join(kept)}); "
            "the inputs w1, w2, w3, w4 keep nothing constant"
        )
    for k, name in enumerate(u):
        if not kernel.depends(np.arange(3, 6) * len(u) + k):
            notes.append(f"differential form: no moment depends on {name}; its column of B is zero")
    form = {"x": list(RATES), "u": list(u), "kept constant": kept}
    return {**document, "differential form": form, "notes": [*document["notes"], *notes]}
