"""A load on a string below the vehicle, driven by the forces that a model predicts."""

import numpy as np
from numba import njit

from quasi import attitude
from quasi.attitude import GRAVITY
from quasi.gap.flights.evidence import Evidence

FADING = 0.15  # damping ratio: an unknown beginning and errors of the forces are forgotten within a swing or two
SUBSTEPS = 4  # per sample


@njit(cache=True)
def swing(acceleration, height, t, breaks, length, fading):
    """Pull on the cg per kg of a load on a string, earth axes (n, 3), m/s2.

    A spherical pendulum below a point that moves with `acceleration` (n, 3), earth, m/s2. Its direction n follows
    L n'' = f - (f.n) n - L |n'|^2 n with f = g - a, and the string pulls with f.n + L |n'|^2. It hangs still after a
    gap (`breaks`, (n,) bool), and pulls nothing while it lies on the floor. height (n,) m, of the cg; fading  damping
    ratio of small swings. Source: Goodarzi, Lee & Lee, Geometric control of a quadrotor UAV transporting a payload,
    IJCAS 13(6), 2015.
    """
    pull = np.zeros((len(t), 3))
    n = np.array([0.0, 0.0, 1.0])
    v = np.zeros(3)
    f = np.empty(3)
    loss = 2.0 * fading * np.sqrt(GRAVITY / length)
    for k in range(len(t)):
        f[0], f[1], f[2] = -acceleration[k, 0], -acceleration[k, 1], GRAVITY - acceleration[k, 2]
        if breaks[k] or height[k] < length:
            n[:] = 0.0
            n[2] = 1.0
            v[:] = 0.0
            if height[k] < length:
                continue
        else:
            h = (t[k] - t[k - 1]) / SUBSTEPS
            keep = np.exp(-loss * h)
            for _ in range(SUBSTEPS):
                along = f[0] * n[0] + f[1] * n[1] + f[2] * n[2]
                for j in range(3):
                    v[j] = keep * v[j] + h * (f[j] - along * n[j]) / length
                speed = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
                # along the sphere: the velocity turns with the direction and keeps its size
                for j in range(3):
                    n[j] += h * v[j]
                n /= np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
                slip = v[0] * n[0] + v[1] * n[1] + v[2] * n[2]
                for j in range(3):
                    v[j] -= slip * n[j]
                left = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
                if left > 1e-12:
                    v *= speed / left
        tension = f[0] * n[0] + f[1] * n[1] + f[2] * n[2]
        tension += length * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        for j in range(3):
            pull[k, j] = max(tension, 0.0) * n[j]
    return pull


def pull_of(evidence: Evidence, length: float, specific: np.ndarray | None = None) -> np.ndarray:
    """Force on the cg per kg of load, body axes (n, 3), m/s2.

    specific  force per mass of the model (n, 3), body axes, m/s2; None where the model carries no load itself

    The vehicle's acceleration is that of the model's forces: the measured one holds the answer to the load already,
    and near resonance a small error of it is all that there is.
    """
    specific = evidence.force / evidence.mass if specific is None else specific
    forces = attitude.rotate(evidence.quaternion, specific)
    pull = swing(
        forces + [0.0, 0.0, GRAVITY], -evidence.position[:, 2], evidence.t, evidence.breaks, float(length), FADING
    )
    return attitude.rotate_inverse(evidence.quaternion, pull)
