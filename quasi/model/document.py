"""Check of a model's plain data when it is read, so that later code can rely on it."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from quasi.airframe import Airframe, from_plain
from quasi.errors import ConfigError, ExpressionError, QuasiError, quoted
from quasi.project.logbook import NAME_RULE, VALID_NAME
from quasi.terms.expressions import Tree, parse

MODEL_SCHEMA = "quasi.model/1"
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
_TOP = {"schema", "id", "gravity", "airframe", "hover speed", "axes"}


def check_document(document: Any, where: str) -> None:
    """Check the plain data of a model. Raises ConfigError naming `where` and the key."""
    if not isinstance(document, Mapping) or document.get("schema") != MODEL_SCHEMA:
        found = document.get("schema") if isinstance(document, Mapping) else type(document).__name__
        raise ConfigError(
            f"{where} is not a model of this version (schema {found!r}, expected '{MODEL_SCHEMA}'); build it again"
        )
    missing = sorted(_TOP - set(document))
    if missing:
        raise ConfigError(f"{where} lacks the key '{missing[0]}'; build the model again")
    if not isinstance(document["id"], str) or not VALID_NAME.fullmatch(document["id"]):
        raise ConfigError(f"{where}: 'id' is {quoted(document['id'])}, expected {NAME_RULE}; build it again")
    if document["gravity"] not in ("withGravity", "noGravity"):
        raise ConfigError(f"{where}: 'gravity' is {document['gravity']!r}, expected 'withGravity' or 'noGravity'")
    hover = document["hover speed"]
    if not isinstance(hover, Mapping) or not (
        hover.get("value") is None or (is_number(hover["value"]) and hover["value"] > 0.0)
    ):
        raise ConfigError(
            f"{where}: 'hover speed' must hold a positive number of rad/s under 'value'; build the model again"
        )
    axes = document["axes"]
    if not isinstance(axes, Mapping) or not axes or set(axes) - set(AXES):
        raise ConfigError(f"{where}: 'axes' must hold some of {', '.join(AXES)}; build the model again")
    for axis, part in axes.items():
        _check_axis(part, f"{where}, {axis}")
    if document.get("normalisation") is not None and any("extension" in t for p in axes.values() for t in p["terms"]):
        raise ConfigError(
            f"{where} is normalised, while terms of an extension are in N and N m; identify it with 'normalize data' "
            "false"
        )


def _check_axis(part: Any, where: str) -> None:
    if not isinstance(part, Mapping) or not isinstance(part.get("terms"), list) or not part["terms"]:
        raise ConfigError(f"{where} holds no terms; build the model again")
    for number, term in enumerate(part["terms"], 1):
        for key in ("expression", "name", "unit"):
            if not isinstance(term, Mapping) or not isinstance(term.get(key), str):
                raise ConfigError(f"{where}, term {number} has no {key}; build the model again")
        if term.get("t") is not None and not is_number(term["t"]):
            raise ConfigError(f"{where}, term {number}: 't' is {term['t']!r}, expected a number; build the model again")
        for key in ("coefficient", "std"):
            if not is_number(term.get(key)):
                raise ConfigError(
                    f"{where}, term {term['expression']!r}: '{key}' is {term.get(key)!r}, expected a finite number; "
                    "build the model again"
                )
    covariance = part.get("covariance")
    try:
        covariance = np.array(covariance, float) if covariance else np.zeros((0, 0))
    except (TypeError, ValueError):
        covariance = np.zeros(0)
    estimated = sum(not t.get("given", False) for t in part["terms"])
    if covariance.shape != (estimated, estimated) or not np.all(np.isfinite(covariance)):
        raise ConfigError(
            f"{where}: 'covariance' must be {estimated} x {estimated} finite numbers; build the model again"
        )
    for key in ("sigma2", "effective rows", "confidence level", "R2", "RMSE", "n"):
        if not is_number(part.get(key)):
            raise ConfigError(f"{where}: '{key}' is {part.get(key)!r}, expected a finite number; build the model again")
    if part.get("unit") not in ("N", "N m"):
        raise ConfigError(f"{where}: 'unit' is {part.get('unit')!r}, expected 'N' or 'N m'; build the model again")


def is_number(value: Any) -> bool:
    """Whether a value of plain data is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def airframe_of(plain: Any, where: str) -> Airframe:
    """Airframe of a model. Raises ConfigError when it is damaged."""
    try:
        frame = from_plain(plain)
        good = frame.hubs.shape == (4, 3) and frame.spin.shape == (4,) and frame.inertia.shape == (3, 3)
        lengths = is_number(frame.radius) and is_number(frame.arm) and frame.radius > 0 and frame.arm > 0
        weighs = frame.mass is None or (is_number(frame.mass) and frame.mass > 0)
        tensor = np.all(np.isfinite(frame.inertia)) and np.min(np.linalg.eigvalsh(frame.inertia)) > 0
    except QuasiError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{where}: 'airframe' is damaged ({error}); build the model again") from None
    if not good:
        raise ConfigError(f"{where}: 'airframe' has hubs, spins or inertia of the wrong shape; build the model again")
    if not (lengths and weighs and tensor and np.all(np.isfinite(frame.hubs)) and np.all(np.abs(frame.spin) == 1.0)):
        raise ConfigError(f"{where}: 'airframe' has impossible lengths, mass, spins or inertia; build the model again")
    return frame


def trees_of(part: Mapping[str, Any], axis: str, where: str) -> list[Tree]:
    """Expressions of an axis. Raises ExpressionError naming `where` and the axis."""
    try:
        return [parse(t["expression"]) for t in part["terms"]]
    except ExpressionError as error:
        raise ExpressionError(f"{where}, {axis}: {' '.join(str(error).split())}") from None
