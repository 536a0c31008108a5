"""What compiled controllers declare and share: their entry, their memory, and kernels for the loads that they want.

All share the outer loops (outer_loop.py) and the allocation (controllers.py). They differ in the loads that they want
for an angular acceleration and a thrust: B u = WANTED_LOADS, u the squared rotor speeds, B their effectiveness. The yaw
moment of rotor accelerations is part of B u where the model has it: B u + D du/dt, solved for the u of this step.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi.model.model import Model
from quasi.simulation.control import parameters as g
from quasi.simulation.control.control_model import ControlModel
from quasi.simulation.control.outer_loop import RATES_SETPOINT, SETPOINT_KIND, WANTED_RATES
from quasi.terms.lanes import common_value

# first entries in the memory; outer_loop.py has further ones
INVERSE_EFFECTIVENESS, STEP_EFFECTIVENESS = 1, 17  # (16,) inverse and effectiveness of one step, row by row
LAST_COMMANDS_SQUARED, LAST_COMMANDS = 33, 180  # (4,) the last commands, squared and as they are
# (4,) speeds by the rotors' lag, their limits, how long they have lagged, s
EXPECTED_SPEEDS, LEARNT_LIMITS, TIME_BEHIND = (37, 41, 45)
RATE_INTEGRAL = 52  # (3,) rad/s2
# filters, three numbers each: of 3 rates, 4 squared speeds, 3 accelerations
RATE_FILTERS, SPEED_FILTERS, ACCELERATION_FILTERS = (58, 67, 79)
# of the allocation
WANTED_LOADS, LOWEST_INPUTS, HIGHEST_INPUTS, ALLOCATED_INPUTS, ALLOCATION_SCRATCH = (88, 92, 96, 100, 104)
ANGULAR_ACCELERATION, MODEL_LOADS = 171, 174  # (3,) wanted angular accelerations; (6,) forces and moments of the model
FILTER_KEEP, FILTER_GAIN, LAG_SHARE = 184, 185, 186  # constants of the filters and of the rotor lag for one step
MODEL_INPUTS = 188  # first entry of the work array of NDI's model


class Law(NamedTuple):
    """One compiled controller, as `registry.LAWS` lists it.

    name           in configurations, also after "drone_"
    gains          {block: keys} of the gains that it has beyond the time constants of all
    memory         what it carries from step to step: (first entry, count, whether squared rotor speeds)
    integral       default integral time of the velocity over its time constant
    learns_limits  default of 'learn rotor limits'
    yaw            factor of the default yaw time constants, of the vehicle and the sum of small time constants, s
    vehicle        the vehicle as it takes it, from the one that the model describes
    pack           (model, offset) -> further parameters, and size of further memory
    """

    name: str
    gains: Mapping[str, tuple[str, ...]]
    memory: tuple[tuple[int, int, bool], ...]
    integral: float = 8.0
    learns_limits: bool = False
    yaw: Callable[[ControlModel, float], float] = lambda vehicle, small_time_constant: 1.0
    vehicle: Callable[[ControlModel], ControlModel] = lambda vehicle: vehicle
    pack: Callable[[Model, np.ndarray], tuple[np.ndarray, int]] = lambda model, offset: (np.empty(0), 0)


@njit(cache=True, error_model="numpy")
def filter_value(m, at, half, value):
    """Second-order low-pass filter by the trapezoidal rule over two halves of a step, s.

    m[at:at+3]: output, its derivative, last input; m[FILTER_KEEP], m[FILTER_GAIN] from `initialise_memory`.
    """
    y, v = m[at], m[at + 1]
    new = m[FILTER_KEEP] * v + m[FILTER_GAIN] * (m[at + 2] + value - 2.0 * y)
    m[at] = y + half * (v + new)
    m[at + 1] = new
    m[at + 2] = value


@njit(cache=True, error_model="numpy")
def thrust_force(p, u0, u1, u2, u3):
    """Compute Fz of the rotors, N, from squared speeds, linear about hover."""
    e, h2 = g.EFFECTIVENESS + 12, p[g.HOVER_SPEED] * p[g.HOVER_SPEED]
    return (
        -p[g.CONTROL_MASS] * GRAVITY
        + p[e] * (u0 - h2) + p[e + 1] * (u1 - h2) + p[e + 2] * (u2 - h2) + p[e + 3] * (u3 - h2)
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def set_wanted_loads(p, m, dt, mx, my, mz, thrust):
    """Set the right-hand side for u: moments of B u + D du/dt, N m, and thrust, N."""
    e = g.EFFECTIVENESS + 12
    m[WANTED_LOADS], m[WANTED_LOADS + 1] = mx, my
    m[WANTED_LOADS + 3] = (
        -thrust
        + p[g.CONTROL_MASS] * GRAVITY
        + p[g.HOVER_SPEED] * p[g.HOVER_SPEED] * (p[e] + p[e + 1] + p[e + 2] + p[e + 3])
    )
    for i in range(4):
        mz += p[g.YAW_REACTION + i] / (2.0 * p[g.HOVER_SPEED] * dt) * m[LAST_COMMANDS_SQUARED + i]
    m[WANTED_LOADS + 2] = mz


@njit(cache=True, error_model="numpy")
def multiply_inertia(p, a, b, c):
    """Multiply the inertia by an angular acceleration."""
    i = g.CONTROL_INERTIA
    return (
        p[i] * a + p[i + 1] * b + p[i + 2] * c,
        p[i + 3] * a + p[i + 4] * b + p[i + 5] * c,
        p[i + 6] * a + p[i + 7] * b + p[i + 8] * c,
    )


@njit(cache=True, error_model="numpy")
def set_angular_acceleration(p, m, measurement):
    """Set the wanted angular accelerations from the wanted rates."""
    for k in range(3):
        m[ANGULAR_ACCELERATION + k] = p[g.RATE_GAINS + k] * (m[WANTED_RATES + k] - measurement[7 + k])


@njit(cache=True, error_model="numpy")
def compute_moments(p, m, measurement, setpoint):
    """Moments for the wanted angular accelerations of a body that spins: I nu + omega x I omega.

    The wanted rates are constant in earth axes, so they rotate in body axes against the yaw rate. Their change and the
    rotors' lag are compensated (exact for a steady spin).
    """
    p_, q, r = measurement[7], measurement[8], measurement[9]
    keeps_heading = common_value(setpoint[SETPOINT_KIND]) != RATES_SETPOINT
    if keeps_heading:
        m[ANGULAR_ACCELERATION] += r * m[WANTED_RATES + 1]
        m[ANGULAR_ACCELERATION + 1] -= r * m[WANTED_RATES]
    mx, my, mz = multiply_inertia(p, m[ANGULAR_ACCELERATION], m[ANGULAR_ACCELERATION + 1], m[ANGULAR_ACCELERATION + 2])
    hx, hy, hz = multiply_inertia(p, p_, q, r)
    mx, my, mz = mx + q * hz - r * hy, my + r * hx - p_ * hz, mz + p_ * hy - q * hx
    if not keeps_heading:
        return mx, my, mz
    lead = min(max(p[g.ACTUATOR_LAG] * r, -1.0), 1.0)
    return mx + lead * my, my - lead * mx, mz
