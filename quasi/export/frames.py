"""Body axes of simulators: x forward, y left, z up (FLU), from quasi's x forward, y right, z down (FRD), and back.

Both are the same turn by 180 degrees about x, so that each function undoes itself.
"""

import numpy as np

from quasi.attitude import HALF_TURN


def swap_vector(vector: np.ndarray) -> np.ndarray:
    """(..., 3) a position, velocity, force, moment or rate in the other axes."""
    return np.asarray(vector, float) * HALF_TURN


def swap_inertia(inertia: np.ndarray) -> np.ndarray:
    """(3, 3) an inertia tensor in the other axes: Ixy and Ixz change their sign, Iyz keeps it."""
    return np.asarray(inertia, float) * np.outer(HALF_TURN, HALF_TURN)
