"""Where a sensor sits at the end of its range: flat tops, found with the range known or not.

A sensor that is driven beyond its range repeats one extreme value, for long or again and again. A smooth peak of a
signal logged in steps is flat too, but leaves its top slowly: within half its length it has fallen by some three steps,
where a clipped signal falls by many. A signal that is held between slow updates repeats all its values, not the extreme
alone.
"""

from typing import NamedTuple

import numpy as np

from quasi.attitude import GRAVITY

# full scales that inertial sensors are made with, rad/s and m/s2
RANGES = {
    "gyro": tuple(float(x) for x in np.radians([125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0])),
    "accelerometer": tuple(GRAVITY * x for x in (2.0, 4.0, 8.0, 16.0, 24.0, 32.0)),
}
LEAST = {"gyro": 1.0, "accelerometer": 12.0}  # half of the smallest full scale, and more than hover asks for
OFF = 0.01  # of a full scale: bias and alignment move the level at which a channel clips
NEAR = 0.005  # of a full scale: filters on board let a clipped signal creep up to it
EXACT = 1e-6  # of the extreme, where the full scale is not known
HELD, TOGETHER = 3, 6  # samples of one flat top, and of all flat tops of a level together, at least
STEPS, SHARE = 6.0, 0.01  # of the log and of the extreme: what a clipped signal falls by beside a flat top, at least
ROUND = 8.0  # times the width of the band that counts as the top: a smooth peak falls by 4 widths there
LONGER = 3.0  # than the values of the same signal elsewhere are held, at least
# or, where noise keeps the tops short: separate visits of the extreme, and how many more samples it has than the values
# next to it (2.4 at the top of a smooth peak)
VISITS, PILE = 6, 5.0
NEXT = 0.002  # of the extreme, where the log's step is not known: how near the values next to it are


class Clipped(NamedTuple):
    """One end of one channel: its level (signed, SI), the full scale it belongs to or None, and where (N,) bool."""

    level: float
    full_scale: float | None
    where: np.ndarray


def _runs(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and one-past-last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2]


def _falls(signal: np.ndarray, first: np.ndarray, last: np.ndarray, top: float) -> np.ndarray:
    """By how much a signal has fallen half a run's length before and after each run [first, last): the lesser."""
    beside = np.maximum(2, (last - first) // 2)
    before, after = first - beside, last - 1 + beside
    left = np.where(before >= 0, top - signal[np.maximum(before, 0)], np.inf)
    right = np.where(after < len(signal), top - signal[np.minimum(after, len(signal) - 1)], np.inf)
    fall = np.minimum(left, right)
    return np.where(np.isfinite(fall), fall, -np.inf)  # a record that is flat from end to end falls nowhere


def _usual_hold(signal: np.ndarray, top: float, at_top: np.ndarray) -> float:
    """Samples for which the signal usually keeps one value, where it is large but not at its top."""
    large = (np.abs(signal) > 0.3 * top) & ~at_top
    changes = np.count_nonzero(large[1:] & (np.diff(signal) != 0.0))
    return np.count_nonzero(large) / changes if changes else 1.0


def _piled(signal: np.ndarray, top: float, at_top: np.ndarray, step: float) -> bool:
    """Whether far more samples stand at the extreme than next to it, on many separate visits."""
    near = (signal >= top - 1.5 * (step or NEXT * top)) & ~at_top
    return len(_runs(at_top)[0]) >= VISITS and int(at_top.sum()) > PILE * int(near.sum())


def clipped(values: np.ndarray, sensor: str, step: float = 0.0) -> list[Clipped]:
    """The ends at which one channel is clipped: none, one or both.

    values  (N,) rad/s or m/s2, finite, evenly sampled; sensor  "gyro" or "accelerometer"; step  of the log's numbers,
    in the same unit, 0 where it is not known
    A flat top that no step explains counts where it recurs or lasts, one near a full scale from HELD samples on;
    peaks beneath LEAST are left alone, for no sensor has so small a range.
    """
    found: list[Clipped] = []
    values = np.asarray(values, float)
    for sign in (1.0, -1.0):
        signal = sign * values
        top = float(signal.max()) if len(signal) else 0.0
        if top < LEAST[sensor]:
            continue
        full = next((r for r in RANGES[sensor] if abs(top - r) <= OFF * r), None)
        within = NEAR * full if full is not None else EXACT * top
        at_top = signal >= top - within
        first, last = _runs(at_top)
        long = last - first >= max(HELD, LONGER * _usual_hold(signal, top, at_top))
        first, last = first[long], last[long]
        steep = _falls(signal, first, last, top) > max(STEPS * step, SHARE * top, ROUND * within)
        together = int(np.sum((last - first)[steep]))
        if together >= (TOGETHER if full is None else HELD) or _piled(signal, top, at_top, step):
            found.append(Clipped(sign * top, full, at_top))
    return found
