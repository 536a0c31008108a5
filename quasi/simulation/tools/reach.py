"""Reachable positions of a quadrotor after a horizon, with targets all around it.

Targets lie on a sphere about the start. The simulation's controller flies to each of them for the horizon, with wind,
noise and faults, as one batch. The hull of the end positions is an inner estimate for that controller, and not the
limit of the vehicle: another controller may reach further.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import ConvexHull, QhullError

from quasi.attitude import rotate_inverse, to_euler
from quasi.errors import ConfigError, DataError
from quasi.model.hover import list_usual_inputs
from quasi.model.model import Model
from quasi.simulation.control.references import HOVER_REFERENCE
from quasi.simulation.loop.run import simulate_many
from quasi.simulation.loop.setup import Setup, make_setup

REACH_SCHEMA = "quasi.reach/1"
REACH_DEFAULTS = {"horizon": 1.0, "radius": 4.0, "spacing": 20.0}  # s, m, deg: those of the reference's script


REACH_UNITS = {
    "target": ("1", "", "number of the target"),
    **{f"target_{a}": ("m", "earth NED", f"{a} of the target") for a in "xyz"},
}


@dataclass(frozen=True)
class Reach:
    """Reached positions of a batch.

    setup      the simulated closed loop
    targets    (B, 3) m, earth NED
    t          (R,) s; positions (B, R, 3) m, NaN after a divergence
    distance   (B,) greatest distance outside the region of the model's data, in units of the covered range; NaN where
               the model has none
    ended      {number of the target: sentence} of simulations that ended early
    """

    setup: Setup
    targets: np.ndarray
    t: np.ndarray
    positions: np.ndarray
    distance: np.ndarray
    ended: dict[int, str]

    def at(self, time: float) -> np.ndarray:
        """Positions (B', 3) at the logged instant nearest to `time`, s, of the simulations that lasted until then."""
        there = self.positions[:, int(np.argmin(np.abs(self.t - time)))]
        return there[np.all(np.isfinite(there), axis=1)]

    def table(self) -> pd.DataFrame:
        """One row per target and instant: target, t, x y z, and the target target_x target_y target_z."""
        many, rows = self.positions.shape[:2]
        columns = {"target": np.repeat(np.arange(many, dtype=float), rows), "t": np.tile(self.t, many)}
        columns |= {a: self.positions[:, :, k].ravel() for k, a in enumerate("xyz")}
        columns |= {f"target_{a}": np.repeat(self.targets[:, k], rows) for k, a in enumerate("xyz")}
        return pd.DataFrame(columns)

    def summary(self) -> dict[str, Any]:
        """Extremes and hull at half and at the whole horizon, plain data."""
        horizon = float(self.t[-1])
        start = self.setup.start[10:13]
        whole = [r for r in range(len(self.targets)) if r not in self.ended]
        return {
            "schema": REACH_SCHEMA,
            "simulation": self.setup.name,
            "model": self.setup.model.id,
            "controller": self.setup.settings["controller"],
            "horizon": {"value": horizon, "unit": "s"},
            "targets": len(self.targets),
            "start": [float(c) for c in start],
            "on the way": _find_extremes(self.positions[whole].reshape(-1, 3)) if whole else None,
            "at half": _describe_set(self.at(0.5 * horizon)),
            "at the horizon": _describe_set(self.at(horizon)),
            "outside the model's region": {
                "share of targets": float(np.mean(self.distance > 0.0)) if np.any(np.isfinite(self.distance)) else None,
                "greatest distance": float(np.nanmax(self.distance)) if np.any(np.isfinite(self.distance)) else None,
            },
            "ended before": {str(b): sentence for b, sentence in self.ended.items()},
        }


def place_targets(radius: float, spacing: float) -> np.ndarray:
    """Points (B, 3) on a sphere: azimuth and elevation in equal steps of about `spacing` degrees, each pole once."""
    around, rings = max(round(360.0 / spacing), 3), max(round(180.0 / spacing), 2)
    azimuth = 2.0 * np.pi * np.arange(around) / around
    elevation = np.pi * (np.arange(1, rings) / rings - 0.5)
    a, e = (m.ravel() for m in np.meshgrid(azimuth, elevation))
    points = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    return radius * np.vstack([points, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])


def find_reachable(
    settings: Mapping[str, Any],
    model: Model,
    horizon: float = REACH_DEFAULTS["horizon"],
    radius: float = REACH_DEFAULTS["radius"],
    spacing: float = REACH_DEFAULTS["spacing"],
    wind: Any = None,
    name: str = "simulation",
) -> Reach:
    """Fly from the initial conditions of a configuration to targets all around.

    settings  as for `make_setup`; references and duration are replaced
    horizon s; radius m, of the sphere of targets; spacing deg, between them; wind  see `make_setup`
    Raises ConfigError for impossible numbers, DataError when every simulation ended early.
    """
    for key, value, most in (("horizon", horizon, 600.0), ("radius", radius, 1e4), ("spacing", spacing, 90.0)):
        if not 0.0 < value <= most:
            raise ConfigError(f"reach: the {key} is {value!r}, expected a number above 0 and at most {most:g}")
    step = float((settings.get("simulation") or {}).get("time step", 0.004))
    duration = max(round(horizon / step), 1) * step
    settings = {
        **settings,
        "simulation": {**(settings.get("simulation") or {}), "duration": duration},
        "references": {"kind": "hover"},
    }
    setup = make_setup(settings, model, wind=wind, name=name)
    start = setup.start[10:13]
    targets = start + place_targets(radius, spacing)
    yaw = float(to_euler(setup.start[:4])[2])
    path = np.column_stack([targets, np.full(len(targets), yaw)])
    if setup.loop_parameters.reference != HOVER_REFERENCE:
        raise ConfigError("reach: the reference of the simulation could not be replaced by targets")
    # the last logged instant is the horizon itself
    every = max(d for d in range(1, max(setup.steps // 50, 1) + 1) if setup.steps % d == 0)
    many = simulate_many(setup, len(targets), path=path, every=every)
    ended = {b: many.stopped(setup, b) for b in range(len(targets)) if many.stopped(setup, b)}
    if len(ended) == len(targets):
        raise DataError(f"reach: every simulation ended early: {ended[0]}")
    return Reach(setup, targets, many.t, many.states[:, :, 10:13], _distances(setup, many.t, many.states), ended)


def _distances(setup: Setup, t: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Greatest distance outside the model's region by simulation, (B,), with the velocity through the steady air."""
    model, air = setup.model, setup.loop_parameters.wind[:3]
    usual = dict(zip(model.inputs[20:], list_usual_inputs(model)))
    if not model.document.get("envelope"):
        return np.full(len(states), np.nan)
    result = np.full(len(states), np.nan)
    for b, rows in enumerate(states):
        fine = np.all(np.isfinite(rows), axis=1)
        rows = rows[fine]
        if len(rows):
            through = rows[:, 4:7] - rotate_inverse(rows[:, :4], air)
            whole = np.column_stack([to_euler(rows[:, :4]), through, rows[:, 7:13]])
            further = {n: t[fine] if n == "t" else np.full(len(rows), value) for n, value in usual.items()}
            result[b] = float(np.max(model.distance(whole, rows[:, 13:], extra=further)[0]))
    return result


def _find_extremes(points: np.ndarray) -> dict[str, Any]:
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    return {a: {"min": float(low[k]), "max": float(high[k]), "unit": "m"} for k, a in enumerate("xyz")}


def _describe_set(points: np.ndarray) -> dict[str, Any] | None:
    """Describe a set of points: extremes and volume of the hull."""
    if not len(points):
        return None
    found = find_hull(points)
    return {
        "extremes": _find_extremes(points),
        "volume": {"value": None if found is None else float(found.volume), "unit": "m3"},
    }


def find_hull(points: np.ndarray) -> ConvexHull | None:
    """Find the convex hull of points (B, 2) or (B, 3); None for degenerate points."""
    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return None
