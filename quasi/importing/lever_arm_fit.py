"""Where the IMU sits from the captured point, by the acceleration of both.

An accelerometer at r from the captured point feels f = c + wdot x r + w x (w x r) + b + c x e + d dc/dt, with
c = R' (a - g): a the acceleration of the point in earth axes, R' its turn into body axes, b the accelerometer's bias, e
the small turn from captured to sensor axes, d what is left of the lag. Linear in r, b, e, d: least squares over
band-limited signals. The standard errors are robust to correlation within blocks.

Source: rigid-body kinematics; Cameron, Gelbach & Miller, J. Human Resources 50(2), 2015, for block-robust errors.
"""

from typing import NamedTuple

import numpy as np

from quasi.attitude import GRAVITY, continuous, interpolate, rotate_inverse
from quasi.importing.clocks.clock_fit import uniform
from quasi.importing.clocks.synchronisation import GRID, SLOW_BAND, Motion, Synchronisation
from quasi.importing.series import interpolate_columns
from quasi.terms.differential import cross_matrix

ARM_BLOCK = 2.0  # s, longer than what correlates accelerations band-limited to SLOW_BAND
LEAST_ARM_BLOCKS = 5


class ArmFit(NamedTuple):
    """position (3,) m of the IMU from the captured point, body axes, and std (3,) m; explained: share of the variance
    of the accelerometer's rest that the arm explains; seconds used."""

    position: np.ndarray
    std: np.ndarray
    explained: float
    seconds: float


def fit_arm(onboard: Motion, capture: Motion, clocks: Synchronisation) -> ArmFit | None:
    """The arm from a synchronised flight; None without a captured attitude or LEAST_ARM_BLOCKS blocks."""
    if capture.quaternion is None or capture.position is None:
        return None
    spacing = float(np.median(np.diff(capture.t)))
    cutoff = min(SLOW_BAND, 0.2 / spacing)
    at = clocks.to_onboard(capture.t)
    place = uniform(at, capture.position, GRID, cutoff)
    force = uniform(onboard.t, onboard.specific_force, GRID, cutoff)
    rates = uniform(onboard.t, onboard.rates, GRID, cutoff)
    if place is None or force is None or rates is None:
        return None
    velocity = np.gradient(place.values, place.step, axis=0)
    acceleration = np.gradient(velocity, place.step, axis=0)
    good = place.good.copy()
    good[:3] = good[-3:] = False
    t = place.t
    known = np.isfinite(capture.quaternion).all(axis=1)
    quaternion = interpolate(continuous(capture.quaternion[known]), at[known], t)
    turning = np.gradient(rates.values, rates.step, axis=0)
    sensed, w, wdot = (interpolate_columns(t, force.t, v) for v in (force.values, rates.values, turning))
    for signal in (force, rates):
        good &= (t >= signal.t[0]) & (t <= signal.t[-1])
        good &= np.interp(t, signal.t, signal.good.astype(float)) > 0.99
    blocks = np.floor((t - t[0]) / ARM_BLOCK).astype(int)[good]
    if len(np.unique(blocks)) < LEAST_ARM_BLOCKS:
        return None
    captured = rotate_inverse(quaternion, acceleration - np.array([0.0, 0.0, GRAVITY]))
    late = np.gradient(captured, place.step, axis=0)
    rest = (sensed - captured)[good]
    bias = np.broadcast_to(np.eye(3), (len(rest), 3, 3))
    parts = [_arm_matrix(w[good], wdot[good]), bias, cross_matrix(captured[good]), late[good][:, :, None]]
    design = np.concatenate(parts, axis=2)
    scale = np.sqrt(np.mean(design**2, axis=(0, 1)))  # mm, rad and s: without it the normal matrix is ill-conditioned
    design = design / scale
    normal = np.linalg.pinv(np.einsum("nij,nik->jk", design, design), hermitian=True)
    solution = normal @ np.einsum("nij,ni->j", design, rest)
    residual = rest - design @ solution
    scores = np.einsum("nij,ni->nj", design, residual)
    sums = np.array([scores[blocks == b].sum(axis=0) for b in np.unique(blocks)])
    count = len(sums)
    covariance = normal @ (sums.T @ sums) @ normal * count / (count - 1)
    centred = rest - rest.mean(axis=0)
    explained = 1.0 - float(np.sum(residual**2) / np.sum(centred**2))
    std = np.sqrt(np.diag(covariance)) / scale
    return ArmFit((solution / scale)[:3], std[:3], explained, float(np.count_nonzero(good) * place.step))


def _arm_matrix(w: np.ndarray, wdot: np.ndarray) -> np.ndarray:
    """(n, 3, 3): what times r gives wdot x r + w x (w x r)."""
    turn = cross_matrix(wdot)
    centripetal = np.einsum("ni,nj->nij", w, w) - np.sum(w**2, axis=1)[:, None, None] * np.eye(3)
    return turn + centripetal
