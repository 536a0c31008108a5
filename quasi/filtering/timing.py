"""What the doubt about the capture's clock adds to the standard errors of position and velocity.

A lag that is wrong by s shifts the captured path by s: to first order position errs by v s and velocity by a s, the
same s all along. Attitude follows the gyro, which needs no alignment, and is left as it is.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from quasi import attitude
from quasi.filtering.ekf import FilterResult, Inputs

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


def widen(run: FilterResult, inputs: Inputs, seconds: np.ndarray) -> FilterResult:
    """The pass with the clock's doubt (N,), s, in the covariance of velocity and position."""
    if not seconds.any():
        return run
    force = attitude.rotate(run.quaternion, inputs.accel - run.state[:, 9:12])
    force[:, 2] += attitude.GRAVITY
    shift = np.hstack([force, run.state[:, :3]]) * seconds[:, None]  # of velocity and position, per standard error
    covariance = run.covariance.copy()
    for i in range(6):
        row = VELOCITY_ROW + i
        for j in range(i + 1):
            covariance[:, row * (row + 1) // 2 + VELOCITY_ROW + j] += shift[:, i] * shift[:, j]
    return run._replace(covariance=covariance)
