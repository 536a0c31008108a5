"""From identified axes to a model: assembly of the plain data."""

from collections.abc import Mapping
from typing import Any

from quasi.airframe import to_plain
from quasi.errors import ConfigError
from quasi.standalone.document import AXES, SCHEMA
from quasi.standalone.model import Model


def assemble(
    parts: Mapping[str, Mapping[str, Any]], shared: Mapping[str, Any], meta: Mapping[str, Any]
) -> dict[str, Any]:
    """The whole model as plain data ("quasi.model/1"), checked by reading it.

    parts   {axis: what the identification of the axis found}
    shared  hover speed, simple model, actuators, gravity kind, training flights
    meta    "id", "airframe" (Airframe); optional "logged to rad/s", "validation flights", "provenance", "notes", and
            "envelope", "joint envelope" as `quasi.standalone.envelope.covered` finds them
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
        "joint envelope": dict(meta.get("joint envelope", {})),
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
