"""Where the IMU sits from the cg, and what it measures too much there.

An accelerometer at r from the cg feels a = a_cg + wdot x r + w x (w x r). The arm r is configured or
estimated from hover. Without angular acceleration the rotors' moments about the cg cancel: the cg lies at
sum(r_i W_i^2) / sum(W_i^2) of the hubs, in x and y. That takes rotors for equal and the IMU for sitting at the centre
of the hubs: a weak rotor passes for an offset.

Source: QuaSI user manual V1.0.a, listing 2 ("do onboard c.g. correction"), for the idea; moment balance for the
formula.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from quasi.attitude import GRAVITY
from quasi.importing.resampling import angular_acceleration

HOVER_BAND = 2.0  # Hz
STILL, SPINNING_UP, LEANING, CLIMBING = 0.15, 0.5, 0.6, 0.3  # rad/s, rad/s2, m/s2 sideways, m/s2 off g
SHORTEST_HOVER = 1.0  # s of hover


class Arm(NamedTuple):
    """Position (3,) m of the IMU from the cg, body axes; std (3,) m; seconds of hover used."""

    position: np.ndarray
    std: np.ndarray
    seconds: float


def hover_arm(at: np.ndarray, rates: np.ndarray, force: np.ndarray, speeds: np.ndarray, hubs: np.ndarray) -> Arm | None:
    """The arm from hover, or None where the flight hovers for less than a second.

    at (n,) s, even; rates (n, 3) rad/s, force (n, 3) m/s2 specific, speeds (n, 4) rad/s; hubs (4, 3) m
    Standard error from the spread between the stretches of hover, a second long each.
    """
    rate = 1.0 / float(np.median(np.diff(at)))
    low = butter(2, HOVER_BAND, fs=rate, output="sos")
    w, a, rotors = (sosfiltfilt(low, np.nan_to_num(x), axis=0) for x in (rates, force, speeds))
    hover = np.abs(w).max(axis=1) < STILL
    hover &= np.abs(np.gradient(w, at, axis=0)).max(axis=1) < SPINNING_UP
    hover &= (np.hypot(a[:, 0], a[:, 1]) < LEANING) & (np.abs(a[:, 2] + GRAVITY) < CLIMBING)
    # on the ground the accelerometer feels g as well
    hover &= rotors.min(axis=1) > 0.5 * np.percentile(rotors.mean(axis=1), 90)
    rows = np.flatnonzero(hover)
    if len(rows) < SHORTEST_HOVER * rate:
        return None
    thrust = rotors[rows] ** 2
    centre = thrust @ (hubs - hubs.mean(axis=0)) / thrust.sum(axis=1, keepdims=True)
    second = (at[rows] - at[rows[0]]).astype(int)
    means = np.array([centre[second == s].mean(axis=0) for s in np.unique(second)])
    value = -np.median(centre, axis=0)
    value[2] = 0.0
    spread = means.std(axis=0, ddof=1) / np.sqrt(len(means)) if len(means) > 1 else np.full(3, np.nan)
    return Arm(value, spread, len(rows) / rate)


def felt_too_much(at: np.ndarray, rates: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """wdot x r + w x (w x r), (n, 3) m/s2, of an IMU at arm r (3,) m from the cg turning with rates (n, 3) rad/s."""
    return np.cross(angular_acceleration(at, rates), arm) + np.cross(rates, np.cross(rates, arm))
