"""Models derived from a model: with its extensions applied, or the simple model identified with it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from quasi.errors import ConfigError, DataError, nearest
from quasi.model.extensions import extensions_of
from quasi.model.model import AXES, Model
from quasi.simulation.vehicle.payload_and_inflow import PayloadAndInflow

_SIMPLE_TERMS = {"Fz": ("w2_1 + w2_2 + w2_3 + w2_4", "kappaFz", -1.0), "Mx": ("U_p", "kappaMx", 1.0),
           "My": ("U_q", "kappaMy", 1.0), "Mz": ("U_r", "kappaMz", 1.0)}  # fmt: skip


def make_fixed_term(expression: str, coefficient: float, unit: str = "") -> dict[str, Any]:
    """Make a term whose coefficient was not estimated from the model's own flights."""
    return {"name": expression, "expression": expression, "coefficient": float(coefficient), "std": 0.0, "unit": unit,
            "given": True}  # fmt: skip


def apply_extensions(model: Model) -> Model:
    """Add the terms of the extensions to the axes; return the model itself where they are there already.

    document["extensions"] is a list of sections: "id"; optional "terms" {axis: [{"expression", "coefficient"}]};
    "actuators" and "environment", see `quasi.model.extensions`; "states", parts with states of their own, see
    `read_payload_and_inflow`. Raises ConfigError for an invalid extension.
    """
    document = {**model.document, "axes": {a: dict(part) for a, part in model.document["axes"].items()}}
    changed = False
    for extension in extensions_of(model):
        name = extension.get("id")
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
                continue  # the axis has them already
            added = [make_fixed_term(t["expression"], t["coefficient"], t.get("unit", "")) for t in terms]
            added = [{**term, "extension": name} for term in added]
            part["terms"] = [*part["terms"], *added]
            changed = True
    return Model(document, f"model {model.id} with its extensions") if changed else model


_CONSTANTS_OF_PARTS = {  # name of the part: {key in the model: constant of `PayloadAndInflow`}
    "inflow lag": {"time constant": "inflow_lag", "gain": "inflow_gain"},
    "swinging load": {"mass": "load_mass", "length": "load_length", "damping ratio": "load_damping"},
}


def read_payload_and_inflow(model: Model) -> PayloadAndInflow:
    """Constants of the payload and the inflow that the model's extensions define; the simulator integrates them.

    Raises ConfigError naming the extension for a part that the simulator does not know, or a second one of a kind.
    """
    constants: dict[str, float] = {}
    for extension in extensions_of(model):
        what = f"model {model.id}, extension '{extension.get('id')}'"
        states = extension.get("states") or {}
        for part in states:
            if part not in _CONSTANTS_OF_PARTS:
                raise ConfigError(
                    f"{what} has states of its own ({part}), which the simulator does not know; extend the model "
                    f"without it{nearest(str(part), _CONSTANTS_OF_PARTS)}"
                )
            try:
                found = {_CONSTANTS_OF_PARTS[part][key]: float(value) for key, value in states[part].items()}
            except (KeyError, TypeError, ValueError, AttributeError):
                found = {}
            least = {name: 0.0 if name == "load_damping" else 1e-9 for name in _CONSTANTS_OF_PARTS[part].values()}
            lacking = set(least) - {"load_damping"} - set(found)
            if lacking or not all(least[n] <= v < np.inf for n, v in found.items()):
                given = states[part] if isinstance(states, Mapping) else states
                raise ConfigError(
                    f"{what}: '{part}' is {given!r}, expected positive numbers for "
                    f"{', '.join(_CONSTANTS_OF_PARTS[part])}; make the extended model anew"
                )
            if set(found) & set(constants):
                raise ConfigError(f"{what} is the second {part} of the model, which can have one; extend it again")
            constants |= found
    return PayloadAndInflow(**constants)


def list_part_names(parts: PayloadAndInflow) -> list[str]:
    """List the names of the parts that exist."""
    return [n for n, there in (("inflow lag", parts.inflow_lag), ("swinging load", parts.load_mass)) if there > 0.0]


def drop_quasi_steady_terms(model: Model) -> Model:
    """Remove the terms that replace a part in quasi-steady predictions, because the simulator integrates the part."""
    parts = list_part_names(read_payload_and_inflow(model))
    axes = model.document["axes"]
    kept = {a: [t for t in part["terms"] if t.get("stands for") not in parts] for a, part in axes.items()}
    if all(len(kept[a]) == len(axes[a]["terms"]) for a in axes):
        return model
    document = {**model.document, "axes": {a: {**part, "terms": kept[a]} for a, part in axes.items()}}
    return Model(document, f"model {model.id} with its parts")


def make_simple_model(model: Model) -> Model:
    """Thrust and torques proportional to the squared rotor speeds: Fz = -kappaFz sum W^2, Mx = kappaMx U_p, and so on.

    Raises DataError where the model carries no simple model.
    """
    factors = model.document.get("simple model") or {}
    missing = [key for _, key, _ in _SIMPLE_TERMS.values() if (factors.get(key) or {}).get("value") is None]
    if missing:
        raise DataError(
            f"model {model.id} carries no '{missing[0]}' of the simple model; set 'use identified model' to true"
        )
    axes = {}
    for axis in AXES:
        expression, key, sign = _SIMPLE_TERMS.get(axis, ("1", None, 0.0))
        value = sign * factors[key]["value"] if key else 0.0
        axes[axis] = {
            "unit": "N" if axis[0] == "F" else "N m", "terms": [make_fixed_term(expression, value)], "covariance": [],
            "sigma2": 0.0, "R2": 0.0, "RMSE": 0.0, "n": 0, "effective rows": 0.0, "confidence level": 0.95,
        }  # fmt: skip
    document = {**model.document, "axes": axes, "extensions": [], "normalisation": None}
    document["gravity"] = "withGravity"  # its thrust is one, whatever the model's forces are
    return Model(document, f"simple model of {model.id}")
