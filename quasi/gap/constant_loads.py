"""Constant forces far beyond what flights differ by: reported as a tie, never silently absorbed.

A flight's constant force and moment are nuisances: trim, seating and biases make them. A force of a twentieth of the
weight is none of these. At one heading and one place its cause stays open: wind, a tether or an accelerometer bias all
push alike.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from quasi.attitude import GRAVITY, rotate
from quasi.gap.effect import Effect
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.nuisance import FORCE_BIAS

FORCE_CAUSES = ("wind", "tether", "accelerometer_bias")
# what holds or moves a whole flight sideways as well; where one of these is named, the force has a cause
LEANING_CAUSES = ("room_tilt", "imu_misalignment", "mocap_misalignment")
TIE_BREAKER = (
    "hover at several headings and at several places: wind keeps its direction in the room, an accelerometer bias "
    "keeps its direction on the vehicle, a tether points to its anchor"
)
Residual = Callable[[Evidence], np.ndarray]


def constant_force_tie(
    compared: Sequence[Evidence], reference: Sequence[Evidence], left: Residual, named: Sequence[str],
    effects: Mapping[str, Effect], level: float, share: float,
) -> list[dict[str, Any]]:  # fmt: skip
    """A tie entry of diagnosis.json where the compared flights feel a constant horizontal force, else nothing.

    left   residual (n, 6) of a flight under the extended model; named  causes that have a name or stand in a tie
    level  probability of nothing below which the force is significant; share  of the weight that is material
    Means are taken in earth axes (room) and are compared with FORCE_BIAS of the weight and with the spread of the
    reference flights. Forces of the causes are not separable here, so each parameter is what the force would take.
    """
    asked = [c for c in FORCE_CAUSES if c in effects]
    if not compared or not asked or set(named) & {*FORCE_CAUSES, *LEANING_CAUSES}:
        return []
    means = np.array([_mean_force(e, left) for e in compared])
    usual = np.array([_mean_force(e, left) for e in reference]) if reference else np.zeros((0, 2))
    spread = usual.std(axis=0, ddof=1) if len(usual) > 1 else np.zeros(2)
    center = usual.mean(axis=0) if len(usual) else np.zeros(2)
    weights = np.array([e.mass * GRAVITY for e in compared])
    std = np.hypot(FORCE_BIAS * weights[:, None], spread)
    away = means - center
    p = float(chi2.sf(np.sum((away / std) ** 2), away.size))
    sizes = np.linalg.norm(away, axis=1) / weights
    if p >= level or np.median(sizes) < share:
        return []
    mean = away.mean(axis=0)
    error = np.sqrt((std**2).mean(axis=0) / len(compared))
    force = {n: {"value": float(v), "std": float(s), "unit": "N"} for n, v, s in zip(("north", "east"), mean, error)}
    return [
        {"ids": asked, "since": "changed" if len(usual) else "always", "separability": 0.0,
         "tie_breaker": TIE_BREAKER, "parameters": {c: {} for c in asked},
         "constant force": {**force, "share of the weight": float(np.median(sizes)), "p": p,
                            "by flight": {e.key: m.tolist() for e, m in zip(compared, away)}}}
    ]  # fmt: skip


def _mean_force(flight: Evidence, left: Residual) -> np.ndarray:
    """Mean residual force (2,) north and east, N; axes that do not count are taken as 0."""
    residual = left(flight)[:, :3].copy()
    residual[:, [k for k in flight.excluded if k < 3]] = 0.0
    return rotate(flight.quaternion, residual)[:, :2].mean(axis=0)
