"""Lag, delay and torque factor by the yaw moment alone, on the map of a joint fit.

The torque of drag and inertia follows the rotor's own speed. Thrust follows air that the blades meet, and leads that
speed; a lag common to all axes is that of thrust, and makes the torque factor wrong. The fit is a prediction-error
method with its own autoregressive disturbance, as that of the other moments.

Source: Ljung, System Identification, 2nd ed., 1999, sections 7.2 and 10.2; Schwarz, Annals of Statistics 6, 1978.
"""

import copy
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from quasi.identification.joint_fit import DISTURBANCE_ROUNDS, JointFit


def fit_yaw(fit: JointFit) -> dict[str, dict[str, Any]] | None:
    """{"time constant": s, "delay": s, "factor": m, torque over thrust}, each with "value", "std"; None where the yaw
    moment does not ask for a lag of its own (BIC), or draws it to the limit of its range.
    """
    yaw = copy.copy(fit)
    yaw.colour, yaw.scale = dict(fit.colour), dict(fit.scale)
    low, high, size = fit.low[:2], fit.high[:2], fit.size[:2]

    def moved(z: np.ndarray) -> np.ndarray:
        return np.concatenate([z, fit.x[2:]])

    def residual(z: np.ndarray) -> np.ndarray:
        return yaw.solve(moved(z), ["Mz"])["Mz"][2]

    z = fit.x[:2]
    for _ in range(DISTURBANCE_ROUNDS):
        z = least_squares(residual, z, bounds=(low, high), x_scale=size, diff_step=1e-2, max_nfev=15).x
        yaw.update_noise(yaw.solve(moved(z)))
    theta, inverse, left = yaw.solve(moved(z), ["Mz"])["Mz"]
    variance = float(np.mean(left**2))
    gain = float(np.sum(residual(fit.x[:2]) ** 2) / variance) - len(left)
    if gain < len(z) * np.log(len(left)) or np.any(z < low + 0.01 * size) or np.any(z > high - 0.01 * size):
        return None
    steps = 1e-2 * size
    ends = [[yaw.solve(moved(z + sign * step * (np.arange(2) == k)), ["Mz"])["Mz"] for sign in (1, -1)]
            for k, step in enumerate(steps)]  # fmt: skip
    jacobian = np.stack([(a[2] - b[2]) / (2 * h) for (a, b), h in zip(ends, steps)], axis=1) * size
    normal = jacobian.T @ jacobian
    covariance = variance * np.linalg.pinv(normal) * np.outer(size, size)
    slope = np.array([(a[0][0] - b[0][0]) / (2 * h) for (a, b), h in zip(ends, steps)])
    std = np.sqrt(np.diag(covariance))
    own = float(np.sqrt(variance * inverse[0, 0] + slope @ covariance @ slope))
    return {
        "time constant": {"value": float(z[0]), "std": float(std[0]), "unit": "s"},
        "delay": {"value": float(z[1]), "std": float(std[1]), "unit": "s"},
        "factor": {"value": float(theta[0]), "std": own},
    }
