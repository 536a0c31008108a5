"""Sources of one flight against each other, once their clocks are tied: gyro, accelerometer, attitudes, position."""

from dataclasses import replace

import numpy as np

from quasi.attitude import interpolate
from quasi.importing.contradictions import length_ratio, rate_gains, specific_force_residual
from quasi.importing.onboard_log import ATTITUDE, POSITION, Onboard
from quasi.importing.series import Series
from quasi.importing.synchronisation import Synchronisation
from quasi.plausibility import Contradiction, check_length_ratio, check_rate_gains, check_residual

CAPTURED, ONBOARD = "captured attitude", "on-board attitude"


def cross_check(board: Onboard, capture: Series | None, sync: Synchronisation | None) -> list[Contradiction]:
    """Contradictions between the sources of a flight beyond the limits of `quasi.plausibility`.

    capture  on its own clock, which `sync` ties to the on-board clock; None where it has that clock
    """
    found, motion = [], board.motion()
    logged = board.attitude_source == "onboard"
    if logged:
        gains = rate_gains(board.gyro.t, board.gyro.values, board.attitude.t, board.attitude.values)
        found += check_rate_gains(gains, ONBOARD)
    if capture is None:
        return found
    there = sync.to_onboard(capture.t) if sync else capture.t
    position = np.stack([capture.values[n] for n in POSITION], axis=-1)
    captured = np.stack([capture.values[n] for n in ATTITUDE], axis=-1) if "qw" in capture.values else None
    if captured is not None:
        found += check_rate_gains(rate_gains(board.gyro.t, board.gyro.values, there, captured), CAPTURED)
        residual = specific_force_residual(motion, there, position, there, captured)
        found += check_residual(residual, CAPTURED, "captured position")
    if logged or captured is None:
        residual = specific_force_residual(motion, there, position, board.attitude.t, board.attitude.values)
        found += check_residual(residual, ONBOARD if logged else None, "captured position")
    if captured is not None:
        fine = np.isfinite(captured).all(axis=1)
        motion = replace(motion, quaternion=interpolate(captured[fine], there[fine], motion.t))
    # a tilted attitude says nothing about lengths, nor does one that took every acceleration for gravity
    if (logged or captured is not None) and not any("accelerometer" in c.between for c in found):
        found += check_length_ratio(length_ratio(motion, there, position), "captured position")
    return found
