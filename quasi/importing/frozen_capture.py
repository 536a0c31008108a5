"""A capture that keeps its last pose though the quadrotor turns: tracking was lost, and the export does not say so."""

import numpy as np

from quasi.errors import add_caution
from quasi.importing.captured_sensors import POSITION_COLUMNS, QUATERNION
from quasi.importing.checks.channels import SHORTEST_FREEZE
from quasi.importing.checks.spans import constant_runs
from quasi.importing.clocks.synchronisation import Synchronisation
from quasi.importing.series import Series, Track

# rad, range of the angle that the gyro turns by within a window, without the mean rate: beyond last digits and a bias
FELT_TURN = np.radians(2.0)
TURN_WINDOW = 2.0 * SHORTEST_FREEZE  # s; integrated noise and drift stay far below the least turn within it


def remove_frozen_poses(
    capture: Series, gyro: Track, sync: Synchronisation | None, where: str, notes: list[str]
) -> Series:
    """The capture, NaN where it keeps one pose to the last digit while the gyro turns; a note names the first.

    The reader finds a pose that is frozen in fast flight by its jump. A hovering body neither stops dead nor jumps
    where the tracking is lost to the end; only the gyro contradicts then. A body at rest, or on a stand, does not turn.

    gyro  t (n,) s on the log's clock, values (n, 3) rad/s; sync  ties the capture's clock to it, None for one clock
    A capture without attitude is returned as it is.
    """
    q = capture.matrix(QUATERNION)
    if q is None:
        return capture
    pose = np.hstack([capture.matrix(POSITION_COLUMNS), q])
    number = np.append(0, np.cumsum((pose[1:] != pose[:-1]).any(axis=1)))  # of the pose, for neighbours to compare
    label = np.where(np.isfinite(pose).all(axis=1), number, np.nan)
    there = sync.to_onboard(capture.t) if sync else capture.t
    fine = np.isfinite(gyro.values).all(axis=1)
    t, rates = gyro.t[fine], gyro.values[fine]
    frozen = np.zeros(len(pose), bool)
    largest = 0.0
    for a, b in constant_runs(capture.t, label):
        if there[b - 1] - there[a] < SHORTEST_FREEZE:
            continue
        turned = _largest_turn(t, rates, there[a], there[b - 1])
        if turned > FELT_TURN:
            frozen[a + 1 : b] = True
            largest = max(largest, turned)
    if not frozen.any():
        return capture
    add_caution(
        notes,
        f"{where}: the capture keeps one pose to the last digit in {np.count_nonzero(frozen)} frames, first from "
        f"{capture.t[np.argmax(frozen)]:.2f} s of its own time, while the gyro turns by {np.degrees(largest):.0f} deg "
        f"within {TURN_WINDOW:g} s: tracking was lost there and the frames count as not "
        "seen; export lost frames as empty cells",
    )
    return Series(capture.t, {n: np.where(frozen, np.nan, column) for n, column in capture.values.items()})


def _largest_turn(t: np.ndarray, rates: np.ndarray, begin: float, end: float) -> float:
    """Largest range of an angle, rad, within a window between begin and end, s, from rates (n, 3) less their mean."""
    largest = 0.0
    for start in np.arange(begin, end, TURN_WINDOW):
        inside = slice(*np.searchsorted(t, [start, min(start + TURN_WINDOW, end)]))
        if len(t[inside]) > 1:
            rate = rates[inside] - rates[inside].mean(axis=0)
            angle = np.cumsum(rate[1:] * np.diff(t[inside])[:, None], axis=0)
            largest = max(largest, float(np.ptp(angle, axis=0).max()))
    return largest
