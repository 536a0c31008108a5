"""Sources of one flight against each other, once their clocks are tied: gyro, accelerometer, attitudes, position."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from quasi.attitude import interpolate
from quasi.importing.clocks.synchronisation import Motion, Synchronisation
from quasi.importing.contradictions import align_forces, compare_forces, exchanged_axes, length_ratio, rate_gains
from quasi.importing.onboard_log import POSITION_COLUMNS, QUATERNION, Onboard
from quasi.importing.path_errors import find_delay, is_velocity_of_body
from quasi.importing.series import Series, Track
from quasi.sensor_limits import (
    Contradiction,
    check_axis_order,
    check_delay,
    check_directions,
    check_length_bounds,
    check_length_ratio,
    check_rate_gains,
    check_residual,
    check_velocity_axes,
)

CAPTURED, ONBOARD_ATTITUDE, CAPTURED_POSITION = "captured attitude", "on-board attitude", "captured position"
ONBOARD_POSITION, ONBOARD_VELOCITY = "on-board position", "on-board velocity"


def cross_check(
    board: Onboard, motion: Motion, capture: Series | None, sync: Synchronisation | None
) -> list[Contradiction]:
    """Contradictions between the sources of a flight beyond the limits of `quasi.sensor_limits`.

    motion  of `board`; capture  on its own clock, which `sync` ties to the on-board clock; None where it has that clock
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
        paths = {ONBOARD_POSITION: board.position, ONBOARD_VELOCITY: board.velocity}
        for path, track in paths.items():
            if track is not None:
                derivatives = 2 if path == ONBOARD_POSITION else 1
                measured = "accelerometer" not in board.made  # one that was made cannot judge its source
                found += _check_path(motion, track.t, track.values, attitudes, path, derivatives, measured)
        return found
    position = capture.matrix(POSITION_COLUMNS)
    wrong = _check_path(motion, there, position, attitudes, CAPTURED_POSITION)
    if wrong:  # it says nothing about lengths then
        return found + wrong
    for t, attitude in attitudes.values():
        fine = np.isfinite(attitude).all(axis=1)
        turned = replace(motion, quaternion=interpolate(attitude[fine], t[fine], motion.t))
        found += check_length_ratio(length_ratio(turned, there, position), CAPTURED_POSITION)
    return found


def _check_path(
    motion: Motion, t: np.ndarray, values: np.ndarray, attitudes: Mapping[str, tuple[np.ndarray, np.ndarray]],
    path: str, derivatives: int = 2, sized: bool = False,
) -> list[Contradiction]:  # fmt: skip
    """Accelerometer against each attitude and a path: a position or velocity (n, 3), named by `path`.

    sized  whether the size and time of its accelerations are compared as well
    """
    found = []
    if not attitudes:  # levelled by the accelerometer: only the vertical says something
        forces = compare_forces(motion, t, values, motion.t, motion.quaternion, True, derivatives)
        if forces is not None:
            vertical = forces._replace(gains={}, horizontal=(1.0, 0.0), exchanged={}, tilt=None, misread=None)
            found = check_residual(forces.residual, None, path) or check_directions(vertical, "", path)
    for name, (q_t, attitude) in attitudes.items():
        # a capture's heading is aligned later; on board, attitude and path have to share their axes
        free = name == ONBOARD_ATTITUDE and path == CAPTURED_POSITION
        forces = compare_forces(motion, t, values, q_t, attitude, free, derivatives)
        if forces is not None:
            found += check_residual(forces.residual, name, path) or check_directions(forces, name, path)
            if sized and not found:
                shared = align_forces(motion, t, values, q_t, attitude, derivatives)
                found += check_delay(find_delay(shared), path) or check_length_bounds(forces.lengths, path)
            if sized and not found and path == ONBOARD_VELOCITY:
                found += check_velocity_axes(is_velocity_of_body(motion, Track(t, values), q_t, attitude), path)
    return found
