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
from quasi.identification.offsets import OFFSET_ROUNDS, less_means, offsets_of, shape_of
from quasi.identification.partition import TRAINING
from quasi.identification.regression import ends_within
from quasi.terms.expressions import Program, parse
from quasi.terms.normalisation import Normalisation
from quasi.terms.rotor_map import FORMS, ranges_of
from quasi.terms.singularities import remove_singularities
from quasi.terms.variables import Variables

Speeds = Callable[[Mapping[str, Any]], Mapping[str, pd.DataFrame]]


def moved_drives(drive: Mapping[str, Any]) -> list[tuple[dict[str, Any], dict[str, Any], float]]:
    """For each estimated parameter the map with it one standard error higher and lower, no further than its bounds,
    and the distance of both."""
    shape, asked = FORMS[drive["form"]].names, drive["estimated"]
    low, high = ranges_of(drive["form"], asked)

    def entry(of: Mapping[str, Any], name: str) -> dict[str, Any]:
        return of["parameters"][name] if name in shape else of[name]

    def at(x: np.ndarray) -> dict[str, Any]:
        moved = copy.deepcopy(dict(drive))
        for name, value in zip(asked, x):
            entry(moved, name)["value"] = float(value)
        return moved

    x = np.array([entry(drive, name)["value"] for name in asked])
    steps = np.sqrt(np.diag(np.asarray(drive["covariance"], float)))
    ends = [ends_within(x, k, step, low, high) for k, step in enumerate(steps)]
    return [(at(up), at(down), apart) for up, down, apart in ends]


def add_map_error(
    result: dict[str, Any],
    axis: str,
    drive: Mapping[str, Any],
    speeds: Speeds,
    roles: Mapping[str, np.ndarray],
    airframe: Airframe,
    hover: float | None,
    scheme: Normalisation | None = None,
) -> dict[str, Any]:
    """The identified axis with the error of the map in its covariance and standard errors.

    result  of `fit.fit_axis`; drive  section "rotor speeds"; speeds(drive)  the training flights with rotor speeds by
    that map; roles  codes of their rows; hover  rad/s; scheme  the non-dimensional one, None for SI
    """
    trees = [parse(t["expression"]) for t in result["terms"]]
    trees = trees if scheme else [remove_singularities(tree, airframe.radius) for tree in trees]
    given = np.array([bool(t.get("given")) for t in result["terms"]])
    known = np.array([t["coefficient"] for t in result["terms"]])[given]
    program = Program(trees)
    shares, offsets = result["share of flight means taken off"], result["offsets of flights"]

    def coefficients(drive: Mapping[str, Any]) -> np.ndarray:
        tables, bends, part_of, own = [], [], [], []
        for key, flight in speeds(drive).items():
            rows = roles[key] == TRAINING
            if not rows.any():
                continue
            part = flight[rows]
            values = {c: part[c].to_numpy(float) for c in part}
            a = program.run(Variables(values, airframe, hover, scheme).__getitem__, len(part)).T
            scale = scheme.scale_of(axis, values) if scheme else 1.0
            table = np.column_stack([a[:, ~given], values[axis] / scale - a[:, given] @ known])
            good = np.isfinite(table).all(axis=1)  # as in the fit: induced velocity lacks in a descent
            tables.append(table[good])
            bends.append(shape_of(axis, values, np.flatnonzero(good), scale) - 1.0)
            part_of.append(shares[key])
            own.append(offsets[key])
        sizes, plain = [len(t) for t in tables], np.concatenate(tables)
        for _ in range(OFFSET_ROUNDS):  # with the map, what flights differ by changes too
            table = plain.copy()
            table[:, -1] -= np.concatenate([u * bend for u, bend in zip(own, bends)])
            table = less_means(table, sizes, part_of)
            theta = np.linalg.lstsq(table[:, :-1], table[:, -1], rcond=None)[0]
            own = offsets_of(plain[:, -1] - plain[:, :-1] @ theta, np.array(part_of), sizes)
        return theta

    ends = moved_drives(drive)
    slopes = [(coefficients(up) - coefficients(down)) / apart if apart else np.zeros(sum(~given))
              for up, down, apart in ends]  # fmt: skip
    change = np.stack(slopes, axis=1)
    covariance = np.asarray(result["covariance"], float) + change @ np.asarray(drive["covariance"], float) @ change.T
    result["covariance"] = covariance.tolist()
    spread = iter(np.sqrt(np.diag(covariance)))
    for term in result["terms"]:
        if not term.get("given"):
            term["std"] = float(next(spread))
            if term.get("t") is not None and term["std"] > 0.0:
                term["t"] = float(term["coefficient"] / term["std"])
    return result
