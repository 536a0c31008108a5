"""Other models made of a model: with its extensions in place, or the simple one that was identified beside it."""

from collections.abc import Mapping
from typing import Any

from quasi.errors import ConfigError, DataError
from quasi.standalone.model import AXES, Model

_SIMPLE = {"Fz": ("w2_1 + w2_2 + w2_3 + w2_4", "kappaFz", -1.0), "Mx": ("U_p", "kappaMx", 1.0),
           "My": ("U_q", "kappaMy", 1.0), "Mz": ("U_r", "kappaMz", 1.0)}  # fmt: skip


def given_term(expression: str, coefficient: float, unit: str = "") -> dict[str, Any]:
    """A term whose coefficient was not estimated from the model's own flights."""
    return {"name": expression, "expression": expression, "coefficient": float(coefficient), "std": 0.0, "unit": unit,
            "given": True}  # fmt: skip


def extended(model: Model) -> Model:
    """The model with the terms of its extensions added to its axes; the model itself where it has none.

    document["extensions"] is a list of {"id": ..., "terms": {axis: [{"expression", "coefficient"}]}, ...}
    Raises ConfigError for an extension that cannot be understood or needs a state of its own.
    """
    extensions = model.document.get("extensions") or []
    if not any(isinstance(e, Mapping) and e.get("terms") for e in extensions):
        _refuse_states(model, extensions)
        return model
    _refuse_states(model, extensions)
    if model.normalisation:
        raise ConfigError(
            f"model {model.id} is normalised, while its extensions are in N and N m; identify it with 'normalize data' "
            "false"
        )
    document = {**model.document, "axes": {a: dict(part) for a, part in model.document["axes"].items()}}
    for extension in extensions:
        where = f"model {model.id}, extension '{extension.get('id')}'"
        for axis, terms in extension.get("terms", {}).items():
            if axis not in document["axes"]:
                raise ConfigError(f"{where} adds to {axis}, which the model lacks; identify that axis too")
            added = [given_term(t["expression"], t["coefficient"], t.get("unit", "")) for t in terms]
            part = document["axes"][axis]
            part["terms"] = [*part["terms"], *added]
    return Model(document, f"model {model.id} with its extensions")


def _refuse_states(model: Model, extensions: list[Any]) -> None:
    for extension in extensions:
        if not isinstance(extension, Mapping):
            raise ConfigError(f"model {model.id} holds an extension that is no section; make the model anew")
        if extension.get("states"):
            raise ConfigError(
                f"model {model.id}, extension '{extension.get('id')}' has states of its own, which this version cannot "
                "simulate; take it out of the model"
            )


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
