"""How much the moment factors of a joint fit differ from flight to flight, and the standard errors that follow.

A joint fit states errors as if one factor held in all flights and its residuals were white. Clocks, batteries and
command limits differ by flight. The factor of flight f is therefore estimated by itself, with a variance from blocks
of its scores, and is taken as drawn about the common one with the variance tau2 between flights:

    theta_f = theta + b_f + e_f,    var b_f = tau2,    var e_f = v_f,    theta = sum s_f theta_f
    var theta = max(plain, sum s_f2 v_f) + tau2 sum s_f2,    s_f  share of the information of flight f

Source: Liang & Zeger, Biometrika 73, 1986 (blocks); DerSimonian & Laird, Controlled Clinical Trials 7, 1986 (tau2).
"""

import numpy as np
from scipy.signal import lfilter

from quasi.identification.joint_fit import JointFit, PreparedFlight

BLOCK = 5.0  # s of a block, longer than the memory of gusts, as in the statistics of gaps
FEWEST_BLOCKS = 3  # below it the variance between blocks has a single degree of freedom


def flight_factor(fit: JointFit, flight: PreparedFlight, axis: str) -> tuple[float, float, float] | None:
    """Factor of a moment in one flight, with the map of the fit; its standard error; its information.

    The information is the inverse of the variance for residuals of variance 1. None where the flight has fewer than
    FEWEST_BLOCKS blocks of compared rows.
    """
    size = round(BLOCK / flight.h)
    if np.count_nonzero(flight.rows) < FEWEST_BLOCKS * size:
        return None
    target, columns = fit.equations(flight, fit.x)[axis]
    both = np.column_stack([target, columns])
    both = lfilter(np.concatenate([[1.0], -fit.colour[axis]]), [1.0], both, axis=0)[flight.rows]
    both = both - both.mean(axis=0)
    scale = np.linalg.norm(both[:, 1:], axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    x = both[:, 1:] / scale
    inverse = np.linalg.pinv(x.T @ x)
    theta = inverse @ (x.T @ both[:, 0])
    scores = x * (both[:, 0] - x @ theta)[:, None]
    count = len(scores) // size
    blocks = np.array([part.sum(axis=0) for part in np.array_split(scores, count)]) @ inverse
    variance = float(np.sum(blocks[:, 0] ** 2)) * count / (count - 1)
    return float(theta[0] / scale[0]), float(np.sqrt(variance) / scale[0]), float(scale[0] ** 2 / inverse[0, 0])


def variance_between(values: np.ndarray, variances: np.ndarray) -> float:
    """Variance between flights of estimates (F,) with variances (F,), F at least 2, by the method of moments."""
    weights = 1.0 / np.maximum(variances, 1e-300)
    mean = np.sum(weights * values) / np.sum(weights)
    excess = float(np.sum(weights * (values - mean) ** 2)) - (len(values) - 1)
    return max(excess / float(np.sum(weights) - np.sum(weights**2) / np.sum(weights)), 0.0)


def factor_error(fit: JointFit, axis: str, plain: float) -> tuple[float, float | None]:
    """Standard error of the factor of a moment, and the standard deviation of that factor between flights.

    plain  its standard error by the fit. The deviation is None where fewer than two flights are long enough.
    """
    found = [one for one in (flight_factor(fit, f, axis) for f in fit.flights) if one is not None]
    if len(found) < 2:
        return plain, None
    value, std, information = np.array(found).T
    share = information / np.sum(information)
    between = variance_between(value, std**2)
    within = max(plain**2, float(np.sum((share * std) ** 2)))
    return float(np.sqrt(within + between * np.sum(share**2))), float(np.sqrt(between))
