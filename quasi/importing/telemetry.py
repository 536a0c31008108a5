"""How old the telemetry of one on-board source is against another's: both saw one motion, each stamps it its own way.

Two relations hold whatever the airframe: roll and pitch acceleration are a mix of the squared rotor speeds; and the
derivative of an estimated velocity is the measured acceleration in world axes. Rates of change of the rotor speeds stay
out of the mix: with them any delay could be explained away. So does yaw, which needs them.
"""

from collections.abc import Sequence

import numpy as np

from quasi.importing.clocks import ClockFit, Pair, Uniform, fit, uniform

GRID = 200.0  # Hz
BAND = 12.0  # Hz
LONGEST = 0.15  # s


def rotor_lag(t_rotor: np.ndarray, speeds: np.ndarray, t_motion: np.ndarray, rates: np.ndarray) -> ClockFit | None:
    """Lag of the motion's stamps behind the rotors' (t_motion = t_rotor + lag): how much later the gyro is stamped.

    t_rotor (n,) s with speeds (n, k) rad/s; t_motion (m,) s with rates (m, 3) rad/s. The age of the rotor telemetry
    against the gyro is minus the lag. None where the motion is too poor to tell.
    """
    moving, squares = uniform(t_motion, rates[:, :2], GRID, BAND), uniform(t_rotor, speeds**2 / 1e6, GRID, BAND)
    if moving is None or squares is None:
        return None
    first = Uniform(moving.start, moving.step, np.gradient(moving.values, moving.step, axis=0), moving.good)
    return best_fit([Pair("roll and pitch acceleration", first, squares)])


def acceleration_lag(
    t_force: np.ndarray, acceleration: np.ndarray, t_state: np.ndarray, velocity: np.ndarray
) -> ClockFit | None:
    """Lag of the velocity's stamps behind the acceleration's (t_state = t_force + lag).

    acceleration (n, 3) m/s2 and velocity (m, 3) m/s in the same world axes. None where the motion is too poor to tell.
    """
    moving, pushed = uniform(t_state, velocity, GRID, BAND), uniform(t_force, acceleration, GRID, BAND)
    if moving is None or pushed is None:
        return None
    first = Uniform(moving.start, moving.step, np.gradient(moving.values, moving.step, axis=0), moving.good)
    return best_fit([Pair("velocity derivative", first, pushed)])


def best_fit(pairs: Sequence[Pair]) -> ClockFit | None:
    """The best constant lag within LONGEST, searched from several beginnings, for the mix may fit at the wrong one."""
    reference = pairs[0].other.start + 0.5 * pairs[0].other.step * len(pairs[0].other.values)
    fits = [fit(pairs, start, 0.0, reference, fit_rate=False) for start in (-0.06, -0.02, 0.02, 0.06)]
    fits = [f for f in fits if f is not None and abs(f.lag) < LONGEST]
    return max(fits, key=lambda f: f.explained, default=None)
