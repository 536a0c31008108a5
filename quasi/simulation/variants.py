"""Other models made of a model: with its extensions in place, or the simple one that was identified beside it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from quasi.errors import ConfigError, DataError
from quasi.standalone.model import AXES, Model

_SIMPLE = {"Fz": ("w2_1 + w2_2 + w2_3 + w2_4", "kappaFz", -1.0), "Mx": ("U_p", "kappaMx", 1.0),
           "My": ("U_q", "kappaMy", 1.0), "Mz": ("U_r", "kappaMz", 1.0)}  # fmt: skip


def given_term(expression: str, coefficient: float, unit: str = "") -> dict[str, Any]:
    """A term whose coefficient was not estimated from the model's own flights."""
    return {"name": expression, "expression": expression, "coefficient": float(coefficient), "std": 0.0, "unit": unit,
            "given": True}  # fmt: skip


def extended(model: Model) -> Model:
    """The model with the terms of its extensions in its axes; the model itself where they stand there already.

    document["extensions"] is a list of sections: "id"; optional "terms" {axis: [{"expression", "coefficient"}]};
    "actuators" and "environment", see `actuators_of` and `wind_of`; "states", parts with a memory of their own.
    Raises ConfigError for an extension that cannot be understood or has such states.
    """
    document = {**model.document, "axes": {a: dict(part) for a, part in model.document["axes"].items()}}
    changed = False
    for extension in extensions_of(model):
        name = extension.get("id")
        if extension.get("states"):
            raise ConfigError(
                f"model {model.id}, extension '{name}' has states of its own ({', '.join(extension['states'])}), which "
                "the simulator does not know; extend the model without it"
            )
        for axis, terms in (extension.get("terms") or {}).items():
            if axis not in document["axes"]:
                raise ConfigError(
                    f"model {model.id}, extension '{name}' adds to {axis}, which the model lacks; identify that axis"
                )
            if model.normalisation:
                raise ConfigError(
                    f"model {model.id} is normalised, while extension '{name}' is in N and N m; identify the model "
                    "with 'normalize data' false"
                )
            part = document["axes"][axis]
            if any(term.get("extension") == name for term in part["terms"]):
                continue  # they stand among the axis's own terms
            added = [given_term(t["expression"], t["coefficient"], t.get("unit", "")) for t in terms]
            part["terms"] = [*part["terms"], *added]
            changed = True
    return Model(document, f"model {model.id} with its extensions") if changed else model


def extensions_of(model: Model) -> list[Mapping[str, Any]]:
    """The extensions of a model. Raises ConfigError where they are damaged."""
    found = model.document.get("extensions") or []
    if not all(isinstance(e, Mapping) for e in found):
        raise ConfigError(f"model {model.id} holds an extension that is no section; make the model anew")
    return list(found)


def actuators_of(model: Model) -> dict[str, float]:
    """What extensions say of the rotors: "time constant" (s), "delay" (s), "voltage exponent"; {} without any."""
    found: dict[str, float] = {}
    for extension in extensions_of(model):
        for key, value in (extension.get("actuators") or {}).items():
            if key in ("time constant", "delay", "voltage exponent"):
                found[key] = float(value)
    return found


def wind_of(model: Model) -> np.ndarray:
    """Velocity of the air (3,), m/s, north east down, that the model's extensions found in its flights."""
    wind = np.zeros(3)
    for extension in extensions_of(model):
        wind = wind + np.asarray((extension.get("environment") or {}).get("wind", np.zeros(3)), float)
    return wind


def simple_model(model: Model) -> Model:
    """Thrust and torques proportional to the squared rotor speeds: Fz = -kappaFz sum W^2, Mx = kappaMx U_p, and so on.

    Raises DataError where the model carries no simple model.
    """
    factors = model.document.get("simple model") or {}
    missing = [key for _, key, _ in _SIMPLE.values() if (factors.get(key) or {}).get("value") is None]
    if missing:
        raise DataError(
            f"model {model.id} carries no '{missing[0]}' of the simple model; set 'use identified model' to true"
        )
    axes = {}
    for axis in AXES:
        expression, key, sign = _SIMPLE.get(axis, ("1", None, 0.0))
        value = sign * factors[key]["value"] if key else 0.0
        axes[axis] = {
            "unit": "N" if axis[0] == "F" else "N m", "terms": [given_term(expression, value)], "covariance": [],
            "sigma2": 0.0, "R2": 0.0, "RMSE": 0.0, "n": 0, "effective rows": 0.0, "confidence level": 0.95,
        }  # fmt: skip
    document = {**model.document, "axes": axes, "extensions": [], "normalisation": None}
    return Model(document, f"simple model of {model.id}")
