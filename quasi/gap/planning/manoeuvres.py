"""A small library of manoeuvres that distinguish causes, worked out for a model's vehicle.

Each is about 20 s long, begins and ends in hover, and is made smaller until the model's rotors can fly it. Speeds are
those of a room; sharp turns reach about 100 rad/s2 where the rotors can.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.gap.flights.evidence import RATE
from quasi.gap.planning.flatness import planned, turning
from quasi.model.model import Model

SMALLER = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15)  # shares of the full size, tried in turn
REST = 1.0  # s of hover between parts
SHARP = 100.0  # rad/s2
LEAST_HEIGHT = 1.0  # m, of what is not flown near the floor


class Manoeuvre(NamedTuple):
    """name; what a pilot has to do, with numbers; flight: the columns of a filtered flight."""

    name: str
    text: str
    flight: pd.DataFrame


def library(model: Model, place: Sequence[float], yaw: float = 0.0) -> list[Manoeuvre]:
    """All manoeuvres about a place (earth NED, m), in the order of least trouble; what cannot be flown is left out."""
    start = np.array([place[0], place[1], min(float(place[2]), -LEAST_HEIGHT)])
    found = []
    for make in MAKERS:
        for size in SMALLER:
            try:
                name, text, flight = make(model, start, yaw, size)
            except DataError:
                continue  # too much for its rotors: smaller
            found.append(Manoeuvre(name, text, flight))
            break
    return found


Made = tuple[str, str, pd.DataFrame]


def _still(seconds: float) -> np.ndarray:
    return np.zeros(round(seconds * RATE))


def _smooth(n: int) -> np.ndarray:
    """From 0 to 1 in n samples, smooth to the third derivative (degree 7)."""
    s = np.linspace(0.0, 1.0, n)
    return s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)


def _move(distance: float, speed: float) -> np.ndarray:
    """Smooth way of a distance (m) whose highest speed is `speed` m/s."""
    return distance * _smooth(max(round(35.0 / 16.0 * abs(distance) / speed * RATE), 20))


def _joined(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Ways one after the other, each beginning where the last ended."""
    result = [np.zeros(0)]
    at = 0.0
    for part in parts:
        result.append(part + at)
        at = float(result[-1][-1]) if len(part) else at
    return np.concatenate(result)


def _flown(model: Model, start: np.ndarray, yaw: float, way: np.ndarray, turn: np.ndarray, name: str) -> pd.DataFrame:
    t = np.arange(len(way)) / RATE
    return planned(t, start + way, yaw + turn, model, name)


def _along(angle: float, way: np.ndarray) -> np.ndarray:
    """(n, 3): a way in the level, at an angle from north."""
    return way[:, None] * np.array([np.cos(angle), np.sin(angle), 0.0])


def _yaw_sweep(model: Model, start: np.ndarray, yaw: float, size: float) -> Made:
    speed = 2.0 * size
    legs = [_move(d, speed) for d in (2.0, -4.0, 4.0, -2.0)]
    way = _joined([_still(REST), *legs, _still(REST)])
    turn = 4.0 * np.pi * _smooth(len(way))
    text = f"out and back at {speed:.2g} m/s while turning twice through all headings, {len(way) / RATE:.0f} s"
    return "yaw sweep", text, _flown(model, start, yaw, _along(yaw, way), turn, "yaw sweep")


def _speed_steps(model: Model, start: np.ndarray, yaw: float, size: float) -> Made:
    speeds = [s * size for s in (2.0, 4.0, 6.0)]
    legs = [leg for s in speeds for leg in (_move(4.0, s), _still(REST), _move(-4.0, s), _still(REST))]
    way = _joined([_still(REST), *legs])
    text = f"out and back over 4 m at {', '.join(f'{s:.2g}' for s in speeds)} m/s, nose ahead, {len(way) / RATE:.0f} s"
    return "speed steps", text, _flown(model, start, yaw, _along(yaw, way), 0.0 * way, "speed steps")


def _sideslip(model: Model, start: np.ndarray, yaw: float, size: float) -> Made:
    speed = 5.0 * size
    way, turn = [_still(REST)], [_still(REST)]
    at = 0.0
    for angle in (0.0, np.pi / 4, np.pi / 2):
        swing = (angle - at) * _smooth(round(REST * RATE)) + at
        legs = _joined([_move(4.0, speed), _still(0.5), _move(-4.0, speed), _still(0.5)])
        way += [0.0 * swing, legs]
        turn += [swing, np.full(len(legs), angle)]
        at = angle
    whole, heading = np.concatenate(way), np.concatenate(turn)
    text = f"out and back at {speed:.2g} m/s with the nose 0, 45 and 90 deg off the way, {len(whole) / RATE:.0f} s"
    return "sideslip", text, _flown(model, start, yaw, _along(yaw, whole), heading, "sideslip")


def _heave(model: Model, start: np.ndarray, yaw: float, size: float) -> Made:
    rates, up = (1.0 * size, 2.5 * size), []
    for rate in rates:
        span = rate / 1.5  # m
        n = round(2.0 * 2.0 * np.pi / 1.5 * RATE)
        grow = np.clip(np.minimum(np.arange(n), n - 1 - np.arange(n)) / RATE, 0.0, 1.0)
        grow = grow**3 * (10.0 - 15.0 * grow + 6.0 * grow**2)
        up += [span * np.sin(1.5 * np.arange(n) / RATE) * grow, _still(0.5)]
    way = np.concatenate([_still(REST), *up])
    place = start - [0.0, 0.0, max(0.0, rates[1] / 1.5 + 0.5 + start[2])]
    flight = _flown(model, place, yaw, -way[:, None] * [0, 0, 1.0], 0.0 * way, "vertical sines")
    half = len(up[0])
    most = [float(flight["w"].abs()[part].max()) for part in (slice(None, half), slice(half, None))]
    text = f"sines up and down at 1.5 rad/s, {most[0]:.2g} and {most[1]:.2g} m/s at most, {len(way) / RATE:.0f} s"
    return "vertical sines", text, flight


def _descents(model: Model, start: np.ndarray, yaw: float, size: float) -> Made:
    speeds = [s * size for s in (2.0, 4.0, 6.0)]
    legs = [leg for s in speeds for leg in (_move(3.0, 2.0), _still(0.5), _move(-3.0, s), _still(0.5))]
    way = _joined([_still(REST), *legs])
    text = f"descents over 3 m at {', '.join(f'{s:.2g}' for s in speeds)} m/s, {len(way) / RATE:.0f} s"
    return "descents", text, _flown(model, start, yaw, -way[:, None] * [0, 0, 1.0], 0.0 * way, "descents")


def _throttle(model: Model, start: np.ndarray, yaw: float, size: float) -> Made:
    share = 0.4 * size
    n = round(0.2 * RATE)
    pulse = np.concatenate([_smooth(8), np.ones(n), _smooth(8)[::-1]])
    push = np.concatenate([pulse, -pulse, -pulse, pulse, _still(0.8)])
    push = np.concatenate([_still(REST), *[sign * push for sign in (1, -1) * 5], _still(REST)])
    climb = np.cumsum(share * 9.81 * push) / RATE
    way = np.cumsum(climb) / RATE
    text = f"steps of throttle by {100 * share:.0f} % up and down in hover, 0.2 s each, {len(way) / RATE:.0f} s"
    return "throttle steps", text, _flown(model, start, yaw, -way[:, None] * [0, 0, 1.0], 0 * way, "throttle steps")


def _doublets(model: Model, start: np.ndarray, yaw: float, size: float) -> Made:
    sizes = [size, size, 0.1 * size]
    angles = [[], [], []]
    order = [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2)] * 2
    for k, axes in enumerate(order):
        for axis in range(3):
            hertz = 3.0 if axis < 2 else 2.0
            n = round(0.9 * RATE)
            s = np.arange(n) / RATE
            window = np.sin(np.pi * np.arange(n) / (n - 1)) ** 2
            top = SHARP * sizes[axis] / (2.0 * np.pi * hertz) ** 2 / len(axes)  # they share the rotors' range
            wave = top * np.sin(2.0 * np.pi * hertz * s) * window * (-1.0) ** k
            angles[axis] += [wave if axis in axes else 0.0 * wave, _still(0.5)]
    turns = np.array([np.concatenate([_still(REST), *part]) for part in angles]).T
    turns[:, 2] += yaw
    t = np.arange(len(turns)) / RATE
    flight = turning(t, turns, start, model, "doublets")
    most = SHARP * size
    text = (
        f"sharp doublets in roll and pitch ({most:.0f} rad/s2) and yaw ({0.1 * most:.0f} rad/s2), alone and, each by "
        f"half or a third of that, together, {t[-1]:.0f} s"
    )
    return "doublets", text, flight


def _yaw_doublets(model: Model, start: np.ndarray, yaw: float, size: float) -> Made:
    hertz, top = 1.5, 40.0 * size
    n = round(2.0 * RATE)
    s = np.arange(n) / RATE
    wave = top / (2.0 * np.pi * hertz) ** 2 * np.sin(2.0 * np.pi * hertz * s) * np.sin(np.pi * s / s[-1]) ** 2
    turn = np.concatenate([_still(REST), *[part for k in range(7) for part in ((-1) ** k * wave, _still(0.5))]])
    text = f"quick turns of the nose left and right, {top:.0f} rad/s2, {len(turn) / RATE:.0f} s"
    return "yaw doublets", text, _flown(model, start, yaw, np.zeros((len(turn), 3)), turn, "yaw doublets")


def _staircase(model: Model, start: np.ndarray, yaw: float, size: float) -> Made:
    radius = float(model.airframe.radius)
    heights = [max(h, 1.2 * radius) for h in (1.5 * radius, 2.5 * radius, 4.0 * radius, 7.0 * radius, 13.0 * radius)]
    parts, at = [np.full(round(2.0 * RATE), heights[0])], heights[0]
    for height in (*heights[1:], *heights[-2::-1]):
        parts += [at + (height - at) * _smooth(round(RATE / size)), np.full(round(1.2 * RATE), height)]
        at = height
    way = np.concatenate(parts)
    hub = float(np.asarray(model.airframe.hubs)[:, 2].mean())
    place = np.column_stack([np.zeros((len(way), 2)), -way - hub])
    base = np.array([start[0], start[1], 0.0])
    text = f"hovers with the rotors {', '.join(f'{100 * h:.0f}' for h in heights)} cm above the floor, up and down, "
    text += f"{len(way) / RATE:.0f} s"
    return "staircase near the floor", text, _flown(model, base, yaw, place, 0.0 * way, "staircase near the floor")


def _stops(model: Model, start: np.ndarray, yaw: float, size: float) -> Made:
    speed = 4.0 * size
    out = _joined([_still(REST), _move(2.5, speed), _still(4.0), _move(-2.5, speed), _still(4.0)])
    both = np.concatenate([_along(yaw, out), _along(yaw + np.pi / 2, out)])
    text = f"short dashes at {speed:.2g} m/s, ahead and sideways, each with 4 s of hover after it, "
    text += f"{len(both) / RATE:.0f} s"
    return "stops", text, _flown(model, start, yaw, both, np.zeros(len(both)), "stops")


def _places(model: Model, start: np.ndarray, yaw: float, size: float) -> Made:
    corners = np.array([[0, 0, 0], [2, 1, -1.0], [-2, 1.5, 0], [-1, -2, -1.5], [1.5, -1.5, -0.5], [0, 0, 0]])
    parts = [np.zeros((round(REST * RATE), 3))]
    for here, there in pairwise(corners):
        far = float(np.linalg.norm(there - here))
        parts += [
            here + _move(1.0, 1.2 * size / far)[:, None] * (there - here),
            np.repeat(there[None], round(RATE), axis=0),
        ]
    way = np.concatenate(parts)
    text = f"slow moves to several heights at several places, 4 m apart, {len(way) / RATE:.0f} s"
    return "places", text, _flown(model, start, yaw, way, np.zeros(len(way)), "places")


MAKERS: tuple[Callable[[Model, np.ndarray, float, float], Made], ...] = (
    _yaw_sweep, _speed_steps, _sideslip, _throttle, _heave, _places, _stops, _descents, _yaw_doublets, _doublets,
    _staircase,
)  # fmt: skip
