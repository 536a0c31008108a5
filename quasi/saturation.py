"""Detection of clipped sensor channels by flat tops, with a known or unknown full scale.

A sensor beyond its range repeats one extreme value, for a long time or repeatedly. A smooth peak of a quantised signal
is flat too, but leaves its top slowly: half its length later it has fallen by about three steps, a clipped signal by
many. A signal held between slow updates repeats all its values, and not only the extreme.
"""

from typing import NamedTuple

import numpy as np

from quasi.attitude import GRAVITY

# usual full scales of inertial sensors, rad/s and m/s2
FULL_SCALES = {
    "gyro": tuple(float(x) for x in np.radians([125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0])),
    "accelerometer": tuple(GRAVITY * x for x in (2.0, 4.0, 8.0, 16.0, 24.0, 32.0)),
}
MIN_CLIPPED_LEVEL = {"gyro": 1.0, "accelerometer": 12.0}  # half of the smallest full scale, and more than in hover
MAX_LEVEL_ERROR = 0.01  # of a full scale; bias and alignment change the clipping level
MAX_CREEP = 0.005  # of a full scale; on-board filters let a clipped signal approach it slowly
LEVEL_TOLERANCE = 1e-6  # of the extreme, for an unknown full scale
MIN_FLAT_SAMPLES, MIN_TOTAL_SAMPLES = 3, 6  # samples of one flat top, and of all flat tops of a level
# fall of a clipped signal next to a flat top: steps of the log, and share of the extreme
MIN_FALL_STEPS, MIN_FALL_SHARE = 6.0, 0.01
MIN_FALL_WIDTHS = 8.0  # times the width of the top band; a smooth peak falls by 4 widths
MIN_HOLD_RATIO = 3.0  # hold of the top over the usual hold of the signal
# for tops shortened by noise: separate visits of the extreme, and its samples over those of neighbouring values
# (2.4 at the top of a smooth peak)
MIN_VISITS, MIN_PILE_RATIO = 6, 5.0
NEIGHBOUR_WIDTH = 0.002  # of the extreme, for an unknown step of the log: width of the neighbouring values


class Clipped(NamedTuple):
    """One end of one channel: its level (signed, SI), the full scale it belongs to or None, and where (N,) bool."""

    level: float
    full_scale: float | None
    where: np.ndarray


def runs_of(mask: np.ndarray) -> np.ndarray:
    """First and one-past-last index (k, 2) of each run of True in mask (N,)."""
    return np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask, np.int8), [0]]))).reshape(-1, 2)


def _measure_fall(signal: np.ndarray, first: np.ndarray, last: np.ndarray, top: float) -> np.ndarray:
    """Measure the fall of a signal half a run's length before and after each run [first, last): the smaller one."""
    margin = np.maximum(2, (last - first) // 2)
    before, after = first - margin, last - 1 + margin
    left = np.where(before >= 0, top - signal[np.maximum(before, 0)], np.inf)
    right = np.where(after < len(signal), top - signal[np.minimum(after, len(signal) - 1)], np.inf)
    fall = np.minimum(left, right)
    return np.where(np.isfinite(fall), fall, -np.inf)  # a record that is flat throughout has no fall


def _find_usual_hold(signal: np.ndarray, top: float, at_top: np.ndarray) -> float:
    """Find the usual hold of a value, in samples, where the signal is large but not at its top."""
    large = (np.abs(signal) > 0.3 * top) & ~at_top
    changes = np.count_nonzero(large[1:] & (np.diff(signal) != 0.0))
    return np.count_nonzero(large) / changes if changes else 1.0


def _is_piled(signal: np.ndarray, top: float, at_top: np.ndarray, step: float) -> bool:
    """Whether the extreme has far more samples than its neighbours, on many separate visits."""
    near = (signal >= top - 1.5 * (step or NEIGHBOUR_WIDTH * top)) & ~at_top
    return len(runs_of(at_top)) >= MIN_VISITS and int(at_top.sum()) > MIN_PILE_RATIO * int(near.sum())


def find_clipping(values: np.ndarray, sensor: str, step: float = 0.0) -> list[Clipped]:
    """Find the ends at which one channel is clipped: none, one or both.

    values  (N,) rad/s or m/s2, finite, evenly sampled; sensor  "gyro" or "accelerometer"; step  of the log's numbers,
    in the same unit, 0 where it is not known
    A flat top that no step explains counts where it recurs or lasts, one near a full scale from MIN_FLAT_SAMPLES
    samples on; peaks below MIN_CLIPPED_LEVEL are ignored, because no sensor has such a small range.
    """
    found: list[Clipped] = []
    values = np.asarray(values, float)
    for sign in (1.0, -1.0):
        signal = sign * values
        top = float(signal.max()) if len(signal) else 0.0
        if top < MIN_CLIPPED_LEVEL[sensor]:
            continue
        full = next((r for r in FULL_SCALES[sensor] if abs(top - r) <= MAX_LEVEL_ERROR * r), None)
        within = MAX_CREEP * full if full is not None else LEVEL_TOLERANCE * top
        at_top = signal >= top - within
        first, last = runs_of(at_top).T
        long = last - first >= max(MIN_FLAT_SAMPLES, MIN_HOLD_RATIO * _find_usual_hold(signal, top, at_top))
        first, last = first[long], last[long]
        steep = _measure_fall(signal, first, last, top) > max(
            MIN_FALL_STEPS * step, MIN_FALL_SHARE * top, MIN_FALL_WIDTHS * within
        )
        together = int(np.sum((last - first)[steep]))
        if together >= (MIN_TOTAL_SAMPLES if full is None else MIN_FLAT_SAMPLES) or _is_piled(
            signal, top, at_top, step
        ):
            found.append(Clipped(sign * top, full, at_top))
    return found
