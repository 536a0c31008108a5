"""The error of estimated rotor speeds in the coefficients of an axis: they are refitted with the map moved by its own
errors, and what they move by is added to their covariance (delta method).

Source: van der Vaart, Asymptotic Statistics, 1998, section 3.1.
"""

import copy
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.airframe import Airframe
from quasi.identification.partition import TRAINING
from quasi.terms.expressions import Program, parse
from quasi.terms.rotor_map import FORMS
from quasi.terms.singularities import remove_singularities
from quasi.terms.variables import Variables

Speeds = Callable[[Mapping[str, Any]], Mapping[str, pd.DataFrame]]


def moved_drives(drive: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The map moved by one standard error along each principal direction of its covariance."""
    values, vectors = np.linalg.eigh(np.asarray(drive["covariance"], float))
    result = []
    for size, direction in zip(np.sqrt(np.maximum(values, 0.0)), vectors.T):
        moved = copy.deepcopy(dict(drive))
        for name, change in zip(drive["estimated"], size * direction):
            entry = moved["parameters"][name] if name in FORMS[drive["form"]].names else moved[name]
            entry["value"] += float(change)
        moved["time constant"]["value"] = max(moved["time constant"]["value"], 1e-4)
        result.append(moved)
    return result


def add_map_error(
    result: dict[str, Any],
    axis: str,
    drive: Mapping[str, Any],
    speeds: Speeds,
    roles: Mapping[str, np.ndarray],
    airframe: Airframe,
    hover: float | None,
) -> dict[str, Any]:
    """The identified axis with the error of the map in its covariance and standard errors.

    result  of `fit.fit_axis`; drive  section "rotor speeds"; speeds(drive)  the training flights with rotor speeds by
    that map; roles  codes of their rows; hover  rad/s
    """
    trees = [remove_singularities(parse(t["expression"]), airframe.radius) for t in result["terms"]]
    given = np.array([bool(t.get("given")) for t in result["terms"]])
    known = np.array([t["coefficient"] for t in result["terms"]])[given]
    program = Program(trees)

    def coefficients(drive: Mapping[str, Any]) -> np.ndarray:
        columns, target = [], []
        for key, flight in speeds(drive).items():
            rows = roles[key] == TRAINING
            if not rows.any():
                continue
            part = flight[rows]
            values = {c: part[c].to_numpy(float) for c in part}
            columns.append(program.run(Variables(values, airframe, hover).__getitem__, len(part)).T)
            target.append(values[axis])
        a, z = np.concatenate(columns), np.concatenate(target)
        return np.linalg.lstsq(a[:, ~given], z - a[:, given] @ known, rcond=None)[0]

    centre = coefficients(drive)
    change = np.stack([coefficients(moved) - centre for moved in moved_drives(drive)], axis=1)
    covariance = np.asarray(result["covariance"], float) + change @ change.T
    result["covariance"] = covariance.tolist()
    spread = iter(np.sqrt(np.diag(covariance)))
    for term in result["terms"]:
        if not term.get("given"):
            term["std"] = float(next(spread))
            if term.get("t") is not None and term["std"] > 0.0:
                term["t"] = float(term["coefficient"] / term["std"])
    return result
