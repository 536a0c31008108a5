"""How much a named cause does, in newtons or as a share of the thrust, and where it does most: for a pilot."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quasi.gap.catalogue import whole_of
from quasi.gap.effect import Vehicle
from quasi.gap.flights.covariates import DIRECTED, HEADING, places
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.ranges import MOSTLY
from quasi.gap.materiality import Cause
from quasi.gap.selection import FORM_ERROR
from quasi.model.model import AXES

EFFECT_CELLS = 16  # along a place, each with as many rows
EXPLAINED = 0.5  # share of the variance of what a cause does, from which a place is reported
STEADY_EFFECT = 0.2  # of its mean: what spreads less is the same everywhere
ONE_WAY = 0.9  # of its square that has to have one sign more than the other for the sign to be reported
# places of single flights are no way to fly; the size of what a cause does has no direction
NEVER = ("time", "volts", "room x", "room y", *DIRECTED)
SLOPE_STEP = 1e-3  # of a standard error, of slopes


def acting(cause: Cause, flights: Sequence[Evidence], vehicle: Vehicle, channel: str | None) -> dict[str, Any] | None:
    """What a cause of forces and moments does to a channel (its first one where None) where it does most.

    None for nothing at all, and for a cause that adds no forces: a mass or a wind is described by its parameters.

    {"channel", "unit", "value", "std", "signed", "share", "where", "range"}: newtons or newton metres as the mean where
    the sign is always the same (signed), else as root mean square; its standard error by the parameters'; "share"
    {"value", "std"} of the model's thrust, of Fz alone; "where" the place and "range" [low, high] of it, SI, heading in
    rad, both None for what acts everywhere alike or where no place explains enough.
    """
    if cause.effect.terms is None and cause.effect.nonlinear_terms is None:
        return None
    axis = channel or (cause.effect.channels or AXES)[0]
    k = AXES.index(axis)

    def made(value: Mapping[str, float]) -> np.ndarray:
        return np.concatenate([whole_of(cause.effect, f, vehicle, value)[:, k] for f in flights])

    does = made(cause.value)
    if not does.any():
        return None
    where, within = _place(does, flights)
    rows = np.ones(len(does), bool) if within is None else within
    squares = does[rows] * np.abs(does[rows])
    signed = bool(abs(squares.sum()) > ONE_WAY * np.abs(squares).sum())

    def size(values: np.ndarray) -> float:
        return float(values[rows].mean()) if signed else float(np.sqrt(np.mean(values[rows] ** 2)))

    names, value = list(cause.value), size(does)
    steps = {n: SLOPE_STEP * cause.std[n] for n in names}
    slopes = [
        (size(made({**cause.value, n: cause.value[n] + steps[n]})) - value) / steps[n] if steps[n] > 0.0 else 0.0
        for n in names
    ]
    parts = np.array(slopes) * [cause.std[n] for n in names]
    std = float(np.sqrt(max(parts @ _correlation(cause) @ parts, 0.0)))
    thrust = float(np.mean(np.concatenate([-f.force[:, 2] for f in flights])[rows]))
    share = {"value": -value / thrust if signed else value / thrust, "std": std / thrust}
    span = None
    if where is not None:
        along = np.concatenate([_along(f, where) for f in flights])[rows]
        span = [float(along.min()), float(along.max())]
    return {"channel": axis, "unit": "N" if k < 3 else "N m", "value": value, "std": std, "signed": signed,
            "share": share if axis == "Fz" and thrust > 0.0 else None, "where": where, "range": span}  # fmt: skip


def _place(does: np.ndarray, flights: Sequence[Evidence]) -> tuple[str | None, np.ndarray | None]:
    """The place that explains most of how much is done, and the rows (n,) of its range where most is done."""
    size = np.abs(does)
    if size.std() < STEADY_EFFECT * size.mean():
        return None, None
    known = [set(places(f)) for f in flights]
    best, most, there = None, EXPLAINED, None
    for where in places(flights[0]):
        if where in NEVER or not all(where in k for k in known):
            continue
        along = np.concatenate([_along(f, where) for f in flights])
        edges = np.unique(np.quantile(along, np.linspace(0.0, 1.0, EFFECT_CELLS + 1)))
        if len(edges) < 3:
            continue
        cell = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, len(edges) - 2)
        count = np.bincount(cell)
        mean = np.bincount(cell, size) / np.maximum(count, 1)
        explained = float(np.sum(count * (mean - size.mean()) ** 2) / np.sum((size - size.mean()) ** 2))
        if explained > most:
            best, most, there = where, explained, np.isin(cell, _about(mean))
    return best, there


def _along(flight: Evidence, where: str) -> np.ndarray:
    along = places(flight)[where]
    return np.angle(np.exp(1j * along)) if where == HEADING else along


def _about(mean: np.ndarray) -> list[int]:
    """Neighbouring cells about the largest that are nearly as large."""
    top = int(np.argmax(mean))
    low = high = top
    while low > 0 and mean[low - 1] >= MOSTLY * mean[top]:
        low -= 1
    while high < len(mean) - 1 and mean[high + 1] >= MOSTLY * mean[top]:
        high += 1
    return list(range(low, high + 1))


def _correlation(cause: Cause) -> np.ndarray:
    """Of the parameters (m, m), as the test has it."""
    covariance = np.asarray(cause.test.covariance)
    if covariance.shape != (len(cause.value),) * 2:
        return np.eye(len(cause.value))
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return covariance / np.outer(scale, scale)


def drowned(own: np.ndarray, usual: np.ndarray, unknown: np.ndarray) -> bool:
    """Whether most of what a cause makes, in units of each axis' error, lies on axes where an unknown error is so much
    larger that the error of its form would exceed the cause. Mean squares (6,)"""
    parts = own / np.maximum(usual, 1e-300)
    return bool(parts[own < FORM_ERROR * unknown].sum() > 0.5 * parts.sum())
