"""Sources of one flight against each other, once their clocks are tied: gyro, accelerometer, attitudes, position."""

from dataclasses import replace

import numpy as np

from quasi.attitude import interpolate
from quasi.importing.clocks.synchronisation import Synchronisation
from quasi.importing.contradictions import compare_forces, exchanged_axes, length_ratio, rate_gains
from quasi.importing.onboard_log import POSITION_COLUMNS, QUATERNION, Onboard
from quasi.importing.series import Series
from quasi.sensor_limits import (
    Contradiction,
    check_axis_order,
    check_directions,
    check_length_ratio,
    check_rate_gains,
    check_residual,
)

CAPTURED, ONBOARD_ATTITUDE, CAPTURED_POSITION = "captured attitude", "on-board attitude", "captured position"


def cross_check(board: Onboard, capture: Series | None, sync: Synchronisation | None) -> list[Contradiction]:
    """Contradictions between the sources of a flight beyond the limits of `quasi.sensor_limits`.

    capture  on its own clock, which `sync` ties to the on-board clock; None where it has that clock
    """
    found: list[Contradiction] = []
    logged = board.attitude_source == "onboard"
    attitudes = {ONBOARD_ATTITUDE: (board.attitude.t, board.attitude.values)} if logged else {}
    if capture is not None:
        there = sync.to_onboard(capture.t) if sync else capture.t
        if "qw" in capture.values:
            attitudes[CAPTURED] = there, capture.matrix(QUATERNION)
    for name, (t, attitude) in attitudes.items():
        both = (board.gyro.t, board.gyro.values, t, attitude)
        found += check_axis_order(exchanged_axes(*both), name) or check_rate_gains(rate_gains(*both), name)
    if capture is None:
        return found
    motion, position = board.motion(), capture.matrix(POSITION_COLUMNS)
    if not attitudes:  # levelled by the accelerometer: only the vertical says something
        forces = compare_forces(motion, there, position, board.attitude.t, board.attitude.values, True)
        return found + check_residual(None if forces is None else forces.residual, None, CAPTURED_POSITION)
    for name, (t, attitude) in attitudes.items():
        forces = compare_forces(motion, there, position, t, attitude, name == ONBOARD_ATTITUDE)
        if forces is None:
            continue
        wrong = check_residual(forces.residual, name, CAPTURED_POSITION) or check_directions(
            forces.gains, forces.vertical, forces.horizontal, name, CAPTURED_POSITION
        )
        found += wrong
        if not wrong:  # else it says nothing about lengths
            fine = np.isfinite(attitude).all(axis=1)
            turned = replace(motion, quaternion=interpolate(attitude[fine], t[fine], motion.t))
            found += check_length_ratio(length_ratio(turned, there, position), CAPTURED_POSITION)
    return found
