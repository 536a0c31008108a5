"""The physics of a simulated quadrotor, once: rigid body, rotor lag and model as one compiled derivative.

State x (17,): 0:4 attitude w x y z (body to earth); 4:7 u v w over ground (m/s, body); 7:10 p q r (rad/s);
10:13 x y z (m, earth NED); 13:17 rotor speeds W1..W4 (rad/s), the states of the rotors. Where parts of the vehicle have
states of their own, these stand behind (`parts`).

    dq/dt = q (0, omega) / 2
    dv/dt = (F - F0)/m + R' g - omega x v            (R' g only where the model's forces leave gravity out)
    domega/dt = I^-1 (M - M0 - omega x I omega)
    dx/dt = R v
    dW/dt = (target - W)/tau, tau by the direction, bounded by the rate limit; or a given slope

F, M come from the compiled model at the velocity through the air v - R' wind, with the rotor speeds that act:
W bounded by a fault's cap, times the root of the rotor's effectiveness (a rotor that makes a share e of the thrust and
torque at its speed acts like a whole one at sqrt(e) W). Rotor accelerations go to the terms that ask for them.

What does not change within a step stands in `held` (HELD + extras,), what never changes in `body` (BODY,); where, says
`layout`. Compiled functions take their arrays one by one: taking one out of a tuple counts a reference, and in a
step of two microseconds that would cost more than the physics.
Source: Stevens, Lewis & Johnson, Aircraft Control and Simulation, 3rd ed., 2016, section 1.7.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.attitude import POLE
from quasi.simulation.vehicle.layout import (
    ANGLES,
    BODY,
    CAP,
    DOWN,
    EXTRAS,
    GRAVITY_ADDED,
    INERTIA,
    INVERSE,
    MASS,
    OFFSET,
    OWN,
    RATE,
    ROTORS,
    SHARE,
    SLOPE,
    STATES,
    TARGET,
    UP,
    WIND,
)
from quasi.simulation.vehicle.payload_and_inflow import own_loads, own_slopes, settle, straighten
from quasi.terms.kernel import Kernel, wrench


class Scratch(NamedTuple):
    """Room that the derivative and the integrators work in, one for each thread; `scratch_of` makes it."""

    inputs: np.ndarray
    work: np.ndarray
    loads: np.ndarray  # (6,) forces and moments at the step's beginning
    last: np.ndarray  # (6,) and at its last stage
    slopes: np.ndarray  # (4, 17 + own states) of the stages
    middle: np.ndarray  # (17 + own states,)


@njit(cache=True, error_model="numpy")
def inputs_of(kernel: Kernel) -> int:
    """Number of inputs of a kernel."""
    return int(kernel.code[6])


@njit(cache=True, error_model="numpy")
def scratch_of(kernel: Kernel, own: int = 0) -> Scratch:
    """Room for one simulation of this model. own  number of states beyond the seventeen."""
    code = kernel.code
    return Scratch(
        np.zeros(inputs_of(kernel)), np.zeros(int(code[0]) + int(code[1]) + int(code[3])), np.zeros(6), np.zeros(6),
        np.zeros((4, STATES + own)), np.zeros(STATES + own),
    )  # fmt: skip


def body_of(
    mass: float,
    inertia: np.ndarray,
    kernel: Kernel,
    gravity: float,
    up: np.ndarray | float = 0.0,
    down: np.ndarray | float = 0.0,
    rate: float = math.inf,
    offset: np.ndarray | float = 0.0,
) -> np.ndarray:
    """The constants of a rigid body and its rotors (BODY,).

    mass kg; inertia (3, 3) kg m2; kernel  of the model; gravity m/s2, 0 where the model's forces hold it;
    up, down (4,) s; rate rad/s2; offset (6,) N, N m
    """
    body = np.zeros(BODY)
    body[MASS], body[GRAVITY_ADDED], body[RATE] = mass, gravity, rate
    body[INERTIA : INERTIA + 9] = np.asarray(inertia, float).ravel()
    body[INVERSE : INVERSE + 9] = np.linalg.inv(np.asarray(inertia, float)).ravel()
    body[OFFSET : OFFSET + 6] = offset
    body[UP : UP + 4], body[DOWN : DOWN + 4] = up, down
    body[ANGLES] = float(kernel.used[:3].any())
    return body


@njit(cache=True, error_model="numpy", inline="always")
def rotor_slope(i, speed, held, body):
    """Acceleration of rotor i at this speed, rad/s2."""
    given = held[SLOPE + i]
    if given == given:
        return given
    gap = held[TARGET + i] - speed
    slope = gap / (body[UP + i] if gap > 0.0 else body[DOWN + i])
    return min(max(slope, -body[RATE]), body[RATE])


@njit(cache=True, error_model="numpy", inline="always")
def euler_angles(q, out):
    """Roll, pitch, yaw into out[0:3]; the same formulas as `attitude.to_euler`."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    north, east = 1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y)
    level = math.sqrt(north * north + east * east)
    out[1] = math.atan2(2.0 * (w * y - z * x), level)
    if level < POLE:
        out[0] = 0.0
        out[2] = math.atan2(2.0 * (w * z - x * y), 1.0 - 2.0 * (x * x + z * z))
    else:
        out[0] = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        out[2] = math.atan2(east, north)


@njit(cache=True, error_model="numpy", inline="always")
def loads_at(x, held, kernel, body, inputs, work, out):
    """Forces and moments that act in this state, into out (6,), N and N m, body axes."""
    if body[ANGLES] != 0.0:
        euler_angles(x, inputs)
    w, rx, ry, rz = x[0], x[1], x[2], x[3]
    # wind into body axes by the conjugate quaternion
    ax, ay, az = held[WIND], held[WIND + 1], held[WIND + 2]
    tx, ty, tz = 2.0 * (rz * ay - ry * az), 2.0 * (rx * az - rz * ax), 2.0 * (ry * ax - rx * ay)
    inputs[3] = x[4] - (ax + w * tx + rz * ty - ry * tz)
    inputs[4] = x[5] - (ay + w * ty + rx * tz - rz * tx)
    inputs[5] = x[6] - (az + w * tz + ry * tx - rx * ty)
    for i in range(6):
        inputs[6 + i] = x[7 + i]
    for i in range(4):
        speed, slope = x[ROTORS + i], rotor_slope(i, x[ROTORS + i], held, body)
        if speed > held[CAP + i]:
            speed, slope = held[CAP + i], 0.0
        inputs[12 + i] = speed * held[SHARE + i]
        inputs[16 + i] = slope
    for i in range(20, len(inputs)):
        inputs[i] = held[EXTRAS + i - 20]
    wrench(kernel, inputs, work, out)
    for i in range(6):
        out[i] -= body[OFFSET + i]
    if body[OWN] != 0.0:
        own_loads(x, body, inputs, out)


@njit(cache=True, error_model="numpy")
def rest(x, held, kernel, body, inputs, work, out):
    """Put the states of the parts in x (17 + own,) to rest, see `parts.settle`; the others stay. out (6,) is room."""
    if body[OWN] != 0.0:
        bare = body.copy()
        bare[OWN] = 0.0
        loads_at(x, held, kernel, bare, inputs, work, out)
        settle(x, inputs, out, body)


def with_rest(x: np.ndarray, held: np.ndarray, kernel: Kernel, body: np.ndarray) -> np.ndarray:
    """The state x (17,) followed by the states of the parts at rest; (17 + own,)."""
    own = int(body[OWN])
    whole = np.concatenate([np.asarray(x, float), np.zeros(own)])
    scratch = scratch_of(kernel, own)
    rest(whole, held, kernel, body, scratch.inputs, scratch.work, scratch.loads)
    return whole


@njit(cache=True, error_model="numpy", inline="always")
def equations(x, loads, held, body, slopes, row):
    """State derivative from forces and moments: fills slopes[row] (17,)."""
    w, rx, ry, rz = x[0], x[1], x[2], x[3]
    vx, vy, vz = x[4], x[5], x[6]
    p, q, r = x[7], x[8], x[9]
    slopes[row, 0] = 0.5 * (-rx * p - ry * q - rz * r)
    slopes[row, 1] = 0.5 * (w * p + ry * r - rz * q)
    slopes[row, 2] = 0.5 * (w * q + rz * p - rx * r)
    slopes[row, 3] = 0.5 * (w * r + rx * q - ry * p)
    # gravity into body axes by the conjugate quaternion
    mass, gravity = body[MASS], body[GRAVITY_ADDED]
    tx, ty = -2.0 * ry * gravity, 2.0 * rx * gravity
    slopes[row, 4] = loads[0] / mass - (q * vz - r * vy) + (w * tx + rz * ty)
    slopes[row, 5] = loads[1] / mass - (r * vx - p * vz) + (w * ty - rz * tx)
    slopes[row, 6] = loads[2] / mass - (p * vy - q * vx) + (gravity + ry * tx - rx * ty)
    hx = body[INERTIA] * p + body[INERTIA + 1] * q + body[INERTIA + 2] * r
    hy = body[INERTIA + 3] * p + body[INERTIA + 4] * q + body[INERTIA + 5] * r
    hz = body[INERTIA + 6] * p + body[INERTIA + 7] * q + body[INERTIA + 8] * r
    mx = loads[3] - (q * hz - r * hy)
    my = loads[4] - (r * hx - p * hz)
    mz = loads[5] - (p * hy - q * hx)
    for k in range(3):
        slopes[row, 7 + k] = (
            body[INVERSE + 3 * k] * mx + body[INVERSE + 3 * k + 1] * my + body[INVERSE + 3 * k + 2] * mz
        )
    tx, ty, tz = 2.0 * (ry * vz - rz * vy), 2.0 * (rz * vx - rx * vz), 2.0 * (rx * vy - ry * vx)
    slopes[row, 10] = vx + w * tx + ry * tz - rz * ty
    slopes[row, 11] = vy + w * ty + rz * tx - rx * tz
    slopes[row, 12] = vz + w * tz + rx * ty - ry * tx
    for i in range(4):
        slopes[row, ROTORS + i] = rotor_slope(i, x[ROTORS + i], held, body)
    if body[OWN] != 0.0:
        own_slopes(x, loads, held, body, slopes, row)


@njit(cache=True, error_model="numpy")
def derivative(x, held, kernel, body, inputs, work, loads, slopes):
    """State derivative into slopes[0] (17,), forces and moments into loads (6,)."""
    loads_at(x, held, kernel, body, inputs, work, loads)
    equations(x, loads, held, body, slopes, 0)


@njit(cache=True, error_model="numpy", inline="always")
def unit(x):
    """Scale the quaternion of a state to unit length."""
    norm = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + x[3] * x[3])
    for i in range(4):
        x[i] /= norm


EULER, RK4 = 0, 1
INTEGRATORS = {"euler": EULER, "rk4": RK4}


@njit(cache=True, error_model="numpy")
def advance(method, dt, x, held, kernel, body, inputs, work, loads, last, slopes, middle):
    """One step of dt in place, Euler or classical Runge-Kutta; the last six arguments are a Scratch's.

    loads are left as the forces and moments at its beginning, last as those at its end (of its last stage with RK4).
    """
    # one place that calls the model: the compiler then works it into the loop
    for stage in range(4 if method == RK4 else 2):
        share = 0.0 if stage == 0 else 0.5 * dt if method == RK4 and stage < 3 else dt
        before = max(stage - 1, 0)
        for i in range(STATES):
            middle[i] = x[i] + share * slopes[before, i]
        for i in range(STATES, len(x)):
            middle[i] = x[i] + share * slopes[before, i]
        loads_at(middle, held, kernel, body, inputs, work, last)
        equations(middle, last, held, body, slopes, stage)
        if stage == 0:
            for i in range(6):
                loads[i] = last[i]
    if method == EULER:
        for i in range(STATES):
            x[i] += dt * slopes[0, i]
        for i in range(STATES, len(x)):
            x[i] += dt * slopes[0, i]
    else:
        for i in range(STATES):
            x[i] += dt / 6.0 * (slopes[0, i] + 2.0 * slopes[1, i] + 2.0 * slopes[2, i] + slopes[3, i])
        for i in range(STATES, len(x)):
            x[i] += dt / 6.0 * (slopes[0, i] + 2.0 * slopes[1, i] + 2.0 * slopes[2, i] + slopes[3, i])
    unit(x)
    if body[OWN] != 0.0:
        straighten(x, body)
