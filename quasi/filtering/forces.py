"""Zero-phase filters of one band for everything a regression compares; forces, moments, induced velocity.

One symmetric kernel, a sinc of the cut-off frequency under a Kaiser window, serves as the low-pass filter; the same
kernel under an eighth-order central difference serves as the differentiator, so that `derivative(x)` is the time
derivative of `low_pass(x)` and has its band.
Sources: Oppenheim & Schafer, Discrete-Time Signal Processing, 3rd ed., 2010, section 7.5 (Kaiser window);
Fornberg, Generation of finite difference formulas on arbitrarily spaced grids, Math. Comp. 51, 1988, table 1.
"""

import numpy as np

from quasi.attitude import AIR_DENSITY, GRAVITY, rotate_inverse
from quasi.errors import DataError

BETA = 6.0  # Kaiser: -63 dB beyond the transition band
TRANSITION = 0.8  # width of the transition band over the cut-off frequency
HIGHEST_CUTOFF = 0.2  # cut-off over sampling rate: beyond, the central difference is no derivative any more
SLOPE = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])  # times the sampling rate
SINKING = 0.25  # of the hover induced velocity: faster descent leaves the range of momentum theory


def kernel(cutoff: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Low-pass and differentiating weights, each (2 m + 1,), to be convolved with a signal sampled at `rate` Hz.

    cutoff  Hz, where the gain is one half. The low-pass keeps constants, the differentiator slopes, exactly.
    """
    attenuation = BETA / 0.1102 + 8.7
    half = int(np.ceil((attenuation - 7.95) / (2 * 14.36) * rate / (TRANSITION * cutoff)))
    n = np.arange(-half, half + 1)
    low = np.kaiser(2 * half + 1, BETA) * np.sinc(2.0 * cutoff / rate * n)
    low /= low.sum()
    reach = len(SLOPE) // 2
    return np.pad(low, reach), np.convolve(low, -SLOPE * rate)


def half_length(cutoff: float, rate: float) -> int:
    """Samples on either side that a filtered value depends on."""
    return len(kernel(cutoff, rate)[0]) // 2


def _convolve(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    half = len(weights) // 2
    if len(values) <= half:
        raise DataError(f"a flight of {len(values)} samples is shorter than the low-pass filter ({half}); log longer")
    # mirrored through the end point, so that a slope goes on
    before = 2.0 * values[0] - values[half:0:-1]
    after = 2.0 * values[-1] - values[-2 : -half - 2 : -1]
    return np.convolve(np.concatenate([before, values, after]), weights, mode="valid")


def _convolve_columns(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    values = np.asarray(values, float)
    if values.ndim == 1:
        return _convolve(values, weights)
    return np.stack([_convolve(column, weights) for column in values.T], axis=1)


def low_pass(values: np.ndarray, cutoff: float, rate: float) -> np.ndarray:
    """Zero-phase low-pass of the columns of (N,) or (N, m), finite. cutoff, rate Hz. Same shape."""
    return _convolve_columns(values, kernel(cutoff, rate)[0])


def derivative(values: np.ndarray, cutoff: float, rate: float) -> np.ndarray:
    """Time derivative of `low_pass(values)`, per second. Same shape."""
    return _convolve_columns(values, kernel(cutoff, rate)[1])


def spread(mask: np.ndarray, samples: int) -> np.ndarray:
    """True (N,) within `samples` of a True of mask."""
    if not mask.any():
        return np.array(mask, bool)
    return np.convolve(mask.astype(float), np.ones(2 * samples + 1))[samples : samples + len(mask)] > 0.5


def forces(specific: np.ndarray, mass: float) -> np.ndarray:
    """Force without weight (N, 3), N, body axes: mass times specific force; in hover Fz = -m g."""
    return mass * np.asarray(specific, float)


def net_forces(specific: np.ndarray, quaternion: np.ndarray, mass: float) -> np.ndarray:
    """Force with weight (N, 3), N, body axes: mass times acceleration, zero in hover. quaternion (N, 4)."""
    return mass * (np.asarray(specific, float) + rotate_inverse(quaternion, np.array([0.0, 0.0, GRAVITY])))


def moments(rates: np.ndarray, rates_dot: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Moment about the cg (N, 3), N m, body axes, by Euler's equation I w' + w x I w.

    rates, rates_dot (N, 3) rad/s, rad/s2; inertia (3, 3) kg m2
    """
    rates = np.asarray(rates, float)
    return np.asarray(rates_dot, float) @ inertia.T + np.cross(rates, rates @ inertia.T)


def induced_velocity(air_velocity: np.ndarray, mass: float, radius: float) -> np.ndarray:
    """Induced velocity (N,), m/s, that carries the weight by momentum theory; NaN in descent, where the theory fails.

    air_velocity (N, 3) m/s, body axes; mass kg; radius m of one of four rotors. Solves v2 ((u2 + v2) + (v - w)2) =
    v_h4 with v_h2 = m g / (2 rho 4 pi R2), its greatest root.
    Source: Leishman, Principles of Helicopter Aerodynamics, 2nd ed., 2006, sections 2.13 and 2.14.
    """
    hover = mass * GRAVITY / (2.0 * AIR_DENSITY * 4.0 * np.pi * radius**2)
    w = np.asarray(air_velocity, float)[:, 2]
    across = np.sum(np.asarray(air_velocity, float)[:, :2] ** 2, axis=1)
    # from beyond the greatest root, where the quartic is convex, Newton's steps fall onto it
    v = np.maximum(w, 0.0) + np.sqrt(hover) * 1.5
    for _ in range(60):
        value = v * v * (across + (v - w) ** 2) - hover * hover
        slope = 2.0 * v * (across + (v - w) ** 2) + 2.0 * v * v * (v - w)
        change = value / slope
        v = v - change
        if np.max(np.abs(change), initial=0.0) < 1e-12:
            break
    return np.where(w > SINKING * np.sqrt(hover), np.nan, v)
