"""Contact with the floor while the rotors turn: its force is none of the vehicle's."""

import numpy as np

from quasi.attitude import GRAVITY
from quasi.filtering.bias import LIFTED

# m from the height at which the vehicle stands: legs spring, and capture and attitude err by millimetres
TOUCHING = 0.01
STAND = 0.5  # s of flight below the place where a vehicle stands; a bounce without capture is shorter
CONTACT = 0.5  # of the weight: what hovering rotors do not give


def find_contacts(height: np.ndarray, specific: np.ndarray, in_flight: np.ndarray, dt: float) -> np.ndarray:
    """True (N,) where a vehicle may touch the floor although it counts as in flight.

    height (N,) m, up; specific (N, 3) specific force, m/s2; in_flight (N,) bool; dt s
    The height of the floor is that at which the vehicle stands before take-off and after landing, each for the half of
    the flight next to it. What the vehicle flies below is a stand and no floor. A landing whose rotors still turn fast,
    and each bounce of it, counts as flight elsewhere.
    """
    touched = np.zeros(len(height), bool)
    flying = np.flatnonzero(in_flight)
    if not len(flying):
        return touched
    first_half = np.arange(len(height)) <= (flying[0] + flying[-1]) // 2
    hit = np.abs(np.linalg.norm(specific, axis=1) / GRAVITY - 1.0) > CONTACT
    for rest, half in ((height[: flying[0]], first_half), (height[flying[-1] + 1 :], ~first_half)):
        above = height - np.median(rest) if len(rest) else height
        if len(rest) and (above[half & in_flight] < -LIFTED).sum() * dt < STAND:
            touched |= half & ((above < TOUCHING) | (hit & (above < LIFTED)))
    return touched & in_flight
