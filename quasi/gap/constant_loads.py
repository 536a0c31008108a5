"""Constant forces far beyond what flights differ by: reported as a tie, never silently absorbed.

A flight's constant force and moment are nuisances: trim, seating and biases make them. A force of a twentieth of the
weight is none of these. At one heading and one place the cause of a horizontal one stays open: wind, a tether or an
accelerometer bias all push alike. A vertical one is another mass, another thrust or another scale of the accelerometer.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from quasi.attitude import GRAVITY, rotate
from quasi.gap.effect import Effect
from quasi.gap.flights.covariates import EVERYWHERE
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.sessions import SESSION_THRUST
from quasi.gap.levels.forces.nuisance import FORCE_BIAS, MASS_SPREAD, THRUST_SPREAD

Residual = Callable[[Evidence], np.ndarray]


class Load(NamedTuple):
    """A direction of a constant force: its earth axes by name, axes of the vehicle on which a smaller one counts as
    well where held-out flights show it, causes that push so, others that would explain it where they are named, what
    settles the tie, and the shares of the weight by which flights, and sessions, differ anyway (standard deviations). A
    model is identified with some vertical force, so that only a change of it shows; a small one may be a drift."""

    axes: dict[str, int]
    channels: tuple[str, ...]
    causes: tuple[str, ...]
    also: tuple[str, ...]
    tie_breaker: str
    spread: float
    of_sessions: float = 0.0
    needs_references: bool = False


LOADS = (
    Load(
        {"north": 0, "east": 1},
        ("Fx", "Fy"),
        ("wind", "tether", "accelerometer_bias"),
        ("room_tilt", "imu_misalignment", "mocap_misalignment"),
        "hover at several headings and at several places: wind keeps its direction in the room, an accelerometer bias "
        "keeps its direction on the vehicle, a tether points to its anchor",
        FORCE_BIAS,
    ),
    Load(
        {"down": 2},
        (),
        ("mass", "thrust_factor", "rotor_speed_scale", "accelerometer_scale"),
        (
            "rotor_effectiveness",
            "wind",
            "accelerometer_bias",
            "tether",
            "payload_swing",
            "ground_effect",
            "thrust_drift",
            "thrust_curve",
        ),
        "weigh the vehicle; at rest the accelerometer shows 9.81 m/s2; if both are right, the thrust has changed, "
        "or the rotor speeds are logged wrong",
        float(np.sqrt(FORCE_BIAS**2 + MASS_SPREAD**2 + THRUST_SPREAD**2)),
        SESSION_THRUST,
        needs_references=True,
    ),
)


def constant_force_ties(
    compared: Sequence[Evidence], reference: Sequence[Evidence], left: Residual, named: Sequence[str],
    effects: Mapping[str, Effect], level: float, share: float, shown: Collection[str] = (),
    suspected: Collection[str] = (),
) -> list[dict[str, Any]]:  # fmt: skip
    """Tie entries of diagnosis.json where the compared flights feel a constant force.

    left   residual (n, 6) of a flight under the extended model; named  causes that have a name or stand in a tie
    level  probability of nothing below which the force is significant; share  of the weight that is material; shown
    axes on which held-out flights show a constant error that no cause explains: a smaller force is material there;
    suspected  causes that are nearly significant: of those that would explain the force, they stand in the tie
    Means are taken in earth axes (room) and are compared with what flights differ by and with the spread of the
    reference flights. A force that these have alike on the vehicle is no change either, whatever the heading.
    Forces of the causes are not separable here, so each parameter is what the force would take.
    What two reference flights and more have of a constant force needs no model that explains the axis.
    """
    if len(reference) > 1:
        compared, reference = ([replace(e, excluded=()) for e in flights] for flights in (compared, reference))
    ties = []
    for load in LOADS:
        asked = [c for c in (*load.causes, *(n for n in load.also if n in suspected)) if c in effects]
        lacking = load.needs_references and len(reference) < 2
        if not compared or not asked or lacking or set(named) & {*load.causes, *load.also}:
            continue
        axes = list(load.axes.values())
        means = np.array([_mean_force(e, left)[axes] for e in compared])
        usual = np.array([_mean_force(e, left)[axes] for e in reference]) if reference else np.zeros((0, len(axes)))
        spread = usual.std(axis=0, ddof=1) if len(usual) > 1 else np.zeros(len(axes))
        center = usual.mean(axis=0) if len(usual) else np.zeros(len(axes))
        weights = np.array([e.mass * GRAVITY for e in compared])
        away, known = means - center, _covariances(load, compared, reference, spread)
        usual_on_board = np.mean([_on_board(e, left) for e in reference], axis=0) if reference else np.zeros(3)
        beyond = means - [rotate(e.quaternion, usual_on_board).mean(axis=0)[axes] for e in compared]
        p = max(
            float(chi2.sf(sum(a @ np.linalg.solve(c, a) for a, c in zip(of.T, known)), of.size))
            for of in (away, beyond)
        )
        sizes = np.linalg.norm(away, axis=1) / weights
        small = np.median(sizes) < share and not set(load.channels) & set(shown)
        if p >= level or small or _varies(compared, left, axes, away, usual_on_board):
            continue
        mean, error = away.mean(axis=0), np.sqrt([c.mean() for c in known])
        force = {n: {"value": float(v), "std": float(s), "unit": "N"} for n, v, s in zip(load.axes, mean, error)}
        ties.append(
            {"ids": asked, "since": "changed" if len(usual) else "always", "separability": 0.0,
             "tie_breaker": load.tie_breaker, "parameters": {c: {} for c in asked},
             "constant force": {**force, "share of the weight": float(np.median(sizes)), "p": p,
                                "by flight": {e.key: m.tolist() for e, m in zip(compared, away)}}}
        )  # fmt: skip
    return ties


def _covariances(
    load: Load, compared: Sequence[Evidence], reference: Sequence[Evidence], spread: np.ndarray
) -> list[np.ndarray]:
    """Covariance (F, F), N2, along each axis of what healthy compared flights are off the mean of the reference ones.

    spread  (k,) standard deviation of the reference flights, N. All compared flights are off by what that mean errs,
    and those of a session by what it differs by. Flights of unknown sessions may be of one, but compared and reference
    flights of two.
    """
    flights, count = [*compared, *reference], len(compared)
    weights = np.array([e.mass * GRAVITY for e in flights])
    off = np.eye(len(flights))[:count]
    if reference:
        off[:, count:] -= 1.0 / len(reference)
    sessions = np.array([e.session or f"unknown, {k < count}" for k, e in enumerate(flights)])
    shared = sessions[:, None] == sessions[None, :]
    both = load.of_sessions**2 * shared * np.outer(weights, weights)
    return [off @ (np.diag((load.spread * weights) ** 2 + s**2) + both) @ off.T for s in spread]


def in_ties(entry: Mapping[str, Any], ties: Sequence[Mapping[str, Any]]) -> bool:
    """Whether an unexplained error of diagnosis.json is the constant force of a tie."""
    pushed = {tuple(load.axes): load.channels for load in LOADS}
    return any(
        entry["where"] == EVERYWHERE and entry.get("since") == tie["since"] and entry["channel"] in channels
        for tie in ties for names, channels in pushed.items() if set(names) <= set(tie.get("constant force", ()))
    )  # fmt: skip


def _varies(
    compared: Sequence[Evidence], left: Residual, axes: Sequence[int], away: np.ndarray, usual_on_board: np.ndarray
) -> bool:
    """Whether the force is not constant: flights differ by more than they have in common, in the room and on the
    vehicle, or over the flight with the largest range of time or of height it changes by half of it and more. The slope
    is fitted to the two halves of every flight."""
    on_board = np.array([(_on_board(e, left) - usual_on_board)[axes] for e in compared])
    if all(_scatters(forces) for forces in (away, on_board)):
        return True
    usual = np.median(np.linalg.norm(away, axis=1))
    for name in ("t", "z"):
        halves = [_halves(f, left, name, axes) for f in compared if name in f.columns]
        distances = np.array([distance for distance, _ in halves])
        if not distances.any():
            continue
        slope = distances @ np.array([change for _, change in halves]) / (distances @ distances)
        if 2.0 * distances.max() * np.linalg.norm(slope) > usual:
            return True
    return False


def _scatters(forces: np.ndarray) -> bool:
    """Whether forces (F, k) differ by more than they have in common."""
    common = forces.mean(axis=0)
    return bool(np.sqrt(np.mean(np.sum((forces - common) ** 2, axis=1))) > np.linalg.norm(common))


def _halves(flight: Evidence, left: Residual, name: str, axes: Sequence[int]) -> tuple[float, np.ndarray]:
    """Distance of the means of a column below and above its median, and change of the mean residual force, N."""
    column = flight.columns[name]
    below = column <= np.median(column)
    if below.all():
        return 0.0, np.zeros(len(axes))
    first, last = (_mean_force(flight, left, rows)[axes] for rows in (below, ~below))
    return float(column[~below].mean() - column[below].mean()), last - first


def _mean_force(flight: Evidence, left: Residual, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Mean residual force (3,) north, east and down, N, of some rows of a flight; excluded axes are 0."""
    return rotate(flight.quaternion, flight.heard(left(flight))[:, :3])[rows].mean(axis=0)


def _on_board(flight: Evidence, left: Residual) -> np.ndarray:
    """Mean residual force (3,) along the body's axes, N; excluded axes are 0."""
    return flight.heard(left(flight))[:, :3].mean(axis=0)
