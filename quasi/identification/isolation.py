"""Regions of excitation: which part of a flight moves enough to teach an axis something.

Forces are judged by their variance: the standard deviation over the last hundredth of the flight, against the largest
one that remains when the top 5 % are left out. Moments are judged by peaks of their magnitude that are high and stand
out. Both judge within one flight, so that calm and lively flights each keep their own manoeuvres.

Source: QuaSI user manual V1.0.a, 6.5.4, 9.4.1 and listing 4 ("manoeuvre excitations").
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.signal import find_peaks

from quasi.airframe import Airframe
from quasi.attitude import GRAVITY
from quasi.errors import DataError, nearest
from quasi.identification.partition import UNUSED

VARIANCE_WINDOW = 0.01  # of the flight, over which the variance is taken
YARDSTICK_SHARE = 0.05  # share of the largest standard deviations that is no yardstick
FLOOR = 0.06  # of weight x arm: smaller moments are no manoeuvre (0.02 N m on the manual's quadrotor)
HEIGHT, PROMINENCE = 0.5, 0.9  # of threshold x largest magnitude, that a peak must reach


def varied(values: np.ndarray, threshold: float, spread: float) -> np.ndarray:
    """Rows (n,) bool of a force whose standard deviation over the last n/100 rows reaches a share of the yardstick.

    values  (n,) finite; threshold  that share; spread  of the flight, kept on each side of what is found
    The start is reflected, so that the first rows have a past.
    """
    n = len(values)
    window = max(int(VARIANCE_WINDOW * n), 2)
    if n < window:
        return np.zeros(n, bool)
    centred = np.concatenate([values[window - 1 : 0 : -1], values]) - np.mean(values)
    running = np.cumsum(np.concatenate([[[0.0, 0.0]], np.column_stack([centred, centred**2])]), axis=0)
    mean, square = ((running[window:] - running[:-window]) / window).T
    deviation = np.sqrt(np.maximum(square - mean**2, 0.0))
    yardstick = np.sort(deviation)[max(n - int(YARDSTICK_SHARE * n) - 1, 0)]
    if yardstick <= 0:
        return np.zeros(n, bool)
    return widened(deviation >= threshold * yardstick, int(spread * n))


def peaked(values: np.ndarray, threshold: float, spread: float, floor: float) -> np.ndarray:
    """Rows (n,) bool around peaks of a moment's magnitude.

    values  (n,) finite; threshold  sets how high and prominent a peak must be, as shares of the largest magnitude
    spread  of the flight, kept on each side of a peak; floor  N m, the least height
    """
    magnitude = np.abs(values)
    largest = float(magnitude.max(initial=0.0))
    found = np.zeros(len(values), bool)
    peaks, _ = find_peaks(
        magnitude, height=max(floor, HEIGHT * threshold * largest), prominence=PROMINENCE * threshold * largest
    )
    found[peaks] = True
    return widened(found, int(spread * len(values)))


def widened(rows: np.ndarray, reach: int) -> np.ndarray:
    """Rows (n,) bool within so many rows of a true one."""
    hits = np.concatenate([[0], np.cumsum(rows)])
    at = np.arange(len(rows))
    return hits[np.minimum(at + reach + 1, len(rows))] > hits[np.maximum(at - reach, 0)]


def excited(
    flights: Mapping[str, pd.DataFrame],
    roles: Mapping[str, np.ndarray],
    airframe: Airframe,
    axes: Iterable[str],
    options: Mapping[str, Any],
) -> dict[str, dict[str, np.ndarray]]:
    """Regions of excitation {axis: {flight: (n,) bool}} over the used rows of each flight.

    roles    {flight: (n,) role codes}; unused rows are no part of a region
    options  "excitation threshold", "spread"
    Raises DataError when an axis is missing from a flight.
    """
    threshold, spread = float(options["excitation threshold"]), float(options["spread"])
    floor = FLOOR * airframe.mass * GRAVITY * airframe.arm if airframe.mass else 0.0
    found: dict[str, dict[str, np.ndarray]] = {}
    for axis in axes:
        found[axis] = {}
        for key, flight in flights.items():
            if axis not in flight:
                raise DataError(f"flight {key} has no column '{axis}'{nearest(axis, flight.columns)}; filter it anew")
            values = flight[axis].to_numpy(float)
            used = (np.asarray(roles[key]) != UNUSED) & np.isfinite(values)
            region = np.zeros(len(values), bool)
            if used.any():
                part = values[used]
                region[used] = (
                    varied(part, threshold, spread) if axis[0] == "F" else peaked(part, threshold, spread, floor)
                )
            found[axis][key] = region
    return found
