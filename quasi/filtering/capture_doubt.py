"""What doubts about the capture add to the standard errors of position and velocity.

Its clock: a lag that is wrong by s shifts the captured path by s. To first order position errs by v s and velocity by
a s, the same s all along.
Its point: a captured point that lies r apart from the one whose acceleration is measured moves with W x r about it.
A velocity by both is nearly that of the captured point, and errs by that.
Attitude follows the gyro, which needs neither, and is left as it is.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quasi import attitude
from quasi.filtering.ekf import POSITION_KIND, FilterResult, Inputs, forward

LEVER_STEP = 1e-3  # m, over which the innovations' slopes are taken: they are nearly linear in it
USED = 1  # outcome of a measurement that no gate has met
VELOCITY_ROW = 3  # of the error covariance; position follows it


def clock_uncertainty(metadata: Mapping[str, Any], t: np.ndarray) -> np.ndarray:
    """Standard error (N,) of the capture's times, s, at the grid's times t (N,); zero where nothing was aligned.

    metadata  of the import: "synchronisation" with "lag" (its value and error hold at "at capture time") and
    "clock rate", and "start" of the grid on the on-board clock
    """
    sync = metadata.get("synchronisation") or {}
    lag, rate = sync.get("lag") or {}, sync.get("clock rate") or {}
    if not lag.get("std"):
        return np.zeros(len(t))
    start = float((metadata.get("start") or {}).get("value") or 0.0)
    middle = float(lag.get("at capture time") or 0.0) + float(lag.get("value") or 0.0) - start
    return np.hypot(float(lag["std"]), (t - middle) * float(rate.get("std") or 0.0))


def find_lever(inputs: Inputs, run: FilterResult) -> tuple[np.ndarray, np.ndarray] | None:
    """Where the captured point lies from the one whose acceleration is measured, and its standard error (3,), m, body.

    run  the forward pass by the inputs; None where too little turns or is captured to say it. With a point that is
    moved by r the innovations change in proportion to r; the r that explains them best is found by least squares.
    Source: Friedland, Treatment of bias in recursive filtering, IEEE Trans. Automatic Control 14(4), 1969.
    """
    use, slopes = run.outcome == USED, []
    for direction in LEVER_STEP * np.eye(3):
        arm = attitude.rotate(run.quaternion, np.broadcast_to(direction, inputs.position.shape))
        moved = forward(inputs._replace(position=inputs.position - arm))
        use &= moved.outcome == USED
        slopes.append((moved.whitened - run.whitened) / LEVER_STEP)
    if not use[:, POSITION_KIND].any():
        return None
    columns, left = np.stack([s[use].ravel() for s in slopes], axis=1), run.whitened[use].ravel()
    information = columns.T @ columns
    if np.linalg.matrix_rank(information) < len(information):
        return None
    covariance = np.linalg.inv(information)
    return -covariance @ (columns.T @ left), np.sqrt(np.diag(covariance))


def clock_shift(run: FilterResult, inputs: Inputs, seconds: np.ndarray) -> np.ndarray:
    """What velocity and position (N, 6) err by where the clock errs by seconds (N,)."""
    force = attitude.rotate(run.quaternion, inputs.accel - run.state[:, 9:12])
    force[:, 2] += attitude.GRAVITY
    return np.hstack([force, run.state[:, :3]]) * seconds[:, None]


def lever_shift(run: FilterResult, inputs: Inputs, lever: np.ndarray) -> np.ndarray:
    """What velocity and position (N, 6) err by where the captured point lies a lever (3,) apart, m, body axes.

    Position is that of the captured point, and stays.
    """
    turning = attitude.rotate(run.quaternion, np.cross(inputs.gyro - run.state[:, 6:9], lever))
    return np.hstack([turning, np.zeros_like(turning)])


def widen(run: FilterResult, shifts: Sequence[np.ndarray]) -> FilterResult:
    """The pass with doubts of one standard error each, (N, 6) of velocity and position, in its covariance."""
    covariance = run.covariance.copy()
    for shift in shifts:
        for i in range(6):
            row = VELOCITY_ROW + i
            for j in range(i + 1):
                covariance[:, row * (row + 1) // 2 + VELOCITY_ROW + j] += shift[:, i] * shift[:, j]
    return run._replace(covariance=covariance)
