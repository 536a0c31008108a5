"""Equations of motion of a simulated quadrotor: rigid body, rotor lag and model as one compiled derivative.

State x (17,): 0:4 attitude w x y z (body to earth); 4:7 u v w over ground (m/s, body); 7:10 p q r (rad/s);
10:13 x y z (m, earth NED); 13:17 rotor speeds W1..W4 (rad/s), the states of the rotors. The states of a payload and of
the inflow follow (`payload_and_inflow`).

    dq/dt = q (0, omega) / 2
    dv/dt = (F - F0)/m + R' g - omega x v            (R' g only where the model's forces leave gravity out)
    domega/dt = I^-1 (M - M0 - omega x I omega)
    dx/dt = R v
    dW/dt = (target - W)/tau, tau by the direction, bounded by the rate limit; or a given slope

F and M come from the compiled model at the velocity through the air, v - R' wind, with the acting rotor speeds. The
acting speed is W limited by a fault's cap, times the square root of the rotor's effectiveness e: a rotor with a share e
of the thrust and torque acts like a healthy one at sqrt(e) W. Terms in rotor accelerations receive them.

The step inputs (STEP_INPUTS_SIZE + extras,) are constant within one step; `body` (BODY_SIZE,) is constant throughout
(`layout`). Compiled functions take their arrays one by one. Reading an array from a tuple counts a reference, and in a
step of two microseconds that would cost more than the physics. They accept arrays, or views of eight drones
(`quasi.terms.lanes`).
Source: Stevens, Lewis & Johnson, Aircraft Control and Simulation, 3rd ed., 2016, section 1.7.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.attitude import POLE
from quasi.simulation.vehicle.layout import (
    ADDED_GRAVITY,
    BODY_SIZE,
    EXTRA_INPUTS,
    EXTRA_STATES,
    GIVEN_ACCELERATION,
    INERTIA,
    INVERSE_INERTIA,
    LAG_DOWN,
    LAG_UP,
    LOADS_OFFSET,
    MASS,
    MAX_ROTOR_ACCELERATION,
    ROOT_EFFECTIVENESS,
    ROTOR_SPEEDS,
    SPEED_CAP,
    STATE_SIZE,
    TARGET_SPEED,
    USES_ANGLES,
    WIND_VELOCITY,
)
from quasi.simulation.vehicle.payload_and_inflow import (
    add_payload_and_inflow_loads,
    differentiate_payload_and_inflow,
    project_constraints,
    trim_payload_and_inflow,
)
from quasi.terms.kernel import Kernel, compute_wrench
from quasi.terms.lanes import any_lane, choose


class Scratch(NamedTuple):
    """Work arrays of the derivative and the integrators, one set for each thread; `make_scratch` makes it."""

    inputs: np.ndarray
    work: np.ndarray
    loads: np.ndarray  # (6,) forces and moments at the step's beginning
    last_loads: np.ndarray  # (6,) and at its last stage
    derivatives: np.ndarray  # (4, 17 + own states) of the stages
    stage_state: np.ndarray  # (17 + own states,)


@njit(cache=True, error_model="numpy")
def count_inputs(kernel: Kernel) -> int:
    """Number of inputs of a kernel."""
    return int(kernel.code[6])


@njit(cache=True, error_model="numpy")
def make_scratch(kernel: Kernel, extra_states: int = 0) -> Scratch:
    """Work arrays for one simulation of this model. extra_states  number of states beyond the seventeen."""
    code = kernel.code
    return Scratch(
        np.zeros(count_inputs(kernel)), np.zeros(int(code[0]) + int(code[1]) + int(code[3])), np.zeros(6), np.zeros(6),
        np.zeros((4, STATE_SIZE + extra_states)), np.zeros(STATE_SIZE + extra_states),
    )  # fmt: skip


def make_body_constants(
    mass: float,
    inertia: np.ndarray,
    kernel: Kernel,
    gravity: float,
    up: np.ndarray | float = 0.0,
    down: np.ndarray | float = 0.0,
    rate: float = math.inf,
    offset: np.ndarray | float = 0.0,
) -> np.ndarray:
    """The constants of a rigid body and its rotors (BODY_SIZE,).

    mass kg; inertia (3, 3) kg m2; kernel  of the model; gravity m/s2, 0 where the model's forces hold it;
    up, down (4,) s; rate rad/s2; offset (6,) N, N m
    """
    body = np.zeros(BODY_SIZE)
    body[MASS], body[ADDED_GRAVITY], body[MAX_ROTOR_ACCELERATION] = mass, gravity, rate
    body[INERTIA : INERTIA + 9] = np.asarray(inertia, float).ravel()
    body[INVERSE_INERTIA : INVERSE_INERTIA + 9] = np.linalg.inv(np.asarray(inertia, float)).ravel()
    body[LOADS_OFFSET : LOADS_OFFSET + 6] = offset
    body[LAG_UP : LAG_UP + 4], body[LAG_DOWN : LAG_DOWN + 4] = up, down
    body[USES_ANGLES] = float(kernel.used[:3].any())
    return body


@njit(cache=True, error_model="numpy", inline="always")
def rotor_acceleration(i, speed, step_inputs, body):
    """Acceleration of rotor i at this speed, rad/s2."""
    given = step_inputs[GIVEN_ACCELERATION + i]
    gap = step_inputs[TARGET_SPEED + i] - speed
    slope = gap / choose(gap > 0.0, body[LAG_UP + i], body[LAG_DOWN + i])
    lagged = min(max(slope, -body[MAX_ROTOR_ACCELERATION]), body[MAX_ROTOR_ACCELERATION])
    return choose(given == given, given, lagged)


@njit(cache=True, error_model="numpy", inline="always")
def euler_angles(q, out):
    """Roll, pitch, yaw into out[0:3]; the same formulas as `attitude.to_euler`."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    north, east = 1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y)
    level = math.sqrt(north * north + east * east)
    out[1] = math.atan2(2.0 * (w * y - z * x), level)
    at_pole = level < POLE  # where roll is 0 and yaw takes the whole rotation
    out[0] = math.atan2(choose(at_pole, 0.0, 2.0 * (w * x + y * z)), choose(at_pole, 1.0, 1.0 - 2.0 * (x * x + y * y)))
    out[2] = math.atan2(
        choose(at_pole, 2.0 * (w * z - x * y), east), choose(at_pole, 1.0 - 2.0 * (x * x + z * z), north)
    )


@njit(cache=True, error_model="numpy", inline="always")
def compute_loads(x, step_inputs, kernel, body, inputs, work, out):
    """Forces and moments that act in this state, into out (6,), N and N m, body axes."""
    if any_lane(body[USES_ANGLES] != 0.0):
        euler_angles(x, inputs)
    w, rx, ry, rz = x[0], x[1], x[2], x[3]
    # wind into body axes by the conjugate quaternion
    ax, ay, az = step_inputs[WIND_VELOCITY], step_inputs[WIND_VELOCITY + 1], step_inputs[WIND_VELOCITY + 2]
    tx, ty, tz = 2.0 * (rz * ay - ry * az), 2.0 * (rx * az - rz * ax), 2.0 * (ry * ax - rx * ay)
    inputs[3] = x[4] - (ax + w * tx + rz * ty - ry * tz)
    inputs[4] = x[5] - (ay + w * ty + rx * tz - rz * tx)
    inputs[5] = x[6] - (az + w * tz + ry * tx - rx * ty)
    for i in range(6):
        inputs[6 + i] = x[7 + i]
    for i in range(4):
        speed, slope = x[ROTOR_SPEEDS + i], rotor_acceleration(i, x[ROTOR_SPEEDS + i], step_inputs, body)
        capped = speed > step_inputs[SPEED_CAP + i]
        inputs[12 + i] = choose(capped, step_inputs[SPEED_CAP + i], speed) * step_inputs[ROOT_EFFECTIVENESS + i]
        inputs[16 + i] = choose(capped, 0.0, slope)
    for i in range(20, len(inputs)):
        inputs[i] = step_inputs[EXTRA_INPUTS + i - 20]
    compute_wrench(kernel, inputs, work, out)
    for i in range(6):
        out[i] -= body[LOADS_OFFSET + i]
    if any_lane(body[EXTRA_STATES] != 0.0):
        add_payload_and_inflow_loads(x, body, inputs, out)


@njit(cache=True, error_model="numpy")
def trim_extra_states(x, step_inputs, kernel, body, inputs, work, out):
    """Trim the states of payload and inflow in x (17 + own,); the others stay. out (6,) is scratch."""
    if body[EXTRA_STATES] != 0.0:
        bare = body.copy()
        bare[EXTRA_STATES] = 0.0
        compute_loads(x, step_inputs, kernel, bare, inputs, work, out)
        trim_payload_and_inflow(x, inputs, out, body)


def append_extra_states(x: np.ndarray, step_inputs: np.ndarray, kernel: Kernel, body: np.ndarray) -> np.ndarray:
    """The state x (17,) followed by the states of the parts at rest; (17 + own,)."""
    extra_states = int(body[EXTRA_STATES])
    whole = np.concatenate([np.asarray(x, float), np.zeros(extra_states)])
    scratch = make_scratch(kernel, extra_states)
    trim_extra_states(whole, step_inputs, kernel, body, scratch.inputs, scratch.work, scratch.loads)
    return whole


@njit(cache=True, error_model="numpy", inline="always")
def equations_of_motion(x, loads, step_inputs, body, derivatives, row):
    """State derivative from forces and moments: fills slopes[row] (17,)."""
    w, rx, ry, rz = x[0], x[1], x[2], x[3]
    vx, vy, vz = x[4], x[5], x[6]
    p, q, r = x[7], x[8], x[9]
    derivatives[row, 0] = 0.5 * (-rx * p - ry * q - rz * r)
    derivatives[row, 1] = 0.5 * (w * p + ry * r - rz * q)
    derivatives[row, 2] = 0.5 * (w * q + rz * p - rx * r)
    derivatives[row, 3] = 0.5 * (w * r + rx * q - ry * p)
    # gravity into body axes by the conjugate quaternion
    mass, gravity = body[MASS], body[ADDED_GRAVITY]
    tx, ty = -2.0 * ry * gravity, 2.0 * rx * gravity
    derivatives[row, 4] = loads[0] / mass - (q * vz - r * vy) + (w * tx + rz * ty)
    derivatives[row, 5] = loads[1] / mass - (r * vx - p * vz) + (w * ty - rz * tx)
    derivatives[row, 6] = loads[2] / mass - (p * vy - q * vx) + (gravity + ry * tx - rx * ty)
    hx = body[INERTIA] * p + body[INERTIA + 1] * q + body[INERTIA + 2] * r
    hy = body[INERTIA + 3] * p + body[INERTIA + 4] * q + body[INERTIA + 5] * r
    hz = body[INERTIA + 6] * p + body[INERTIA + 7] * q + body[INERTIA + 8] * r
    mx = loads[3] - (q * hz - r * hy)
    my = loads[4] - (r * hx - p * hz)
    mz = loads[5] - (p * hy - q * hx)
    for k in range(3):
        derivatives[row, 7 + k] = (
            body[INVERSE_INERTIA + 3 * k] * mx
            + body[INVERSE_INERTIA + 3 * k + 1] * my
            + body[INVERSE_INERTIA + 3 * k + 2] * mz
        )
    tx, ty, tz = 2.0 * (ry * vz - rz * vy), 2.0 * (rz * vx - rx * vz), 2.0 * (rx * vy - ry * vx)
    derivatives[row, 10] = vx + w * tx + ry * tz - rz * ty
    derivatives[row, 11] = vy + w * ty + rz * tx - rx * tz
    derivatives[row, 12] = vz + w * tz + rx * ty - ry * tx
    for i in range(4):
        derivatives[row, ROTOR_SPEEDS + i] = rotor_acceleration(i, x[ROTOR_SPEEDS + i], step_inputs, body)
    if any_lane(body[EXTRA_STATES] != 0.0):
        differentiate_payload_and_inflow(x, loads, step_inputs, body, derivatives, row)


@njit(cache=True, error_model="numpy", inline="always")
def normalise_quaternion(x):
    """Scale the quaternion of a state to unit length."""
    norm = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + x[3] * x[3])
    for i in range(4):
        x[i] /= norm


EULER, RK4 = 0, 1
INTEGRATORS = {"euler": EULER, "rk4": RK4}


@njit(cache=True, error_model="numpy")
def integrate_step(method, dt, x, step_inputs, kernel, body, inputs, work, loads, last_loads, derivatives, stage_state):
    """One step of dt in place, Euler or classical Runge-Kutta; the last six arguments are a Scratch's.

    loads are left as the forces and moments at its beginning, last as those at its end (of its last stage with RK4).
    """
    # one place that calls the model: the compiler then works it into the loop
    for stage in range(4 if method == RK4 else 2):
        share = 0.0 if stage == 0 else 0.5 * dt if method == RK4 and stage < 3 else dt
        before = max(stage - 1, 0)
        for i in range(STATE_SIZE):
            stage_state[i] = x[i] + share * derivatives[before, i]
        for i in range(STATE_SIZE, len(x)):
            stage_state[i] = x[i] + share * derivatives[before, i]
        compute_loads(stage_state, step_inputs, kernel, body, inputs, work, last_loads)
        equations_of_motion(stage_state, last_loads, step_inputs, body, derivatives, stage)
        if stage == 0:
            for i in range(6):
                loads[i] = last_loads[i]
    if method == EULER:
        for i in range(STATE_SIZE):
            x[i] += dt * derivatives[0, i]
        for i in range(STATE_SIZE, len(x)):
            x[i] += dt * derivatives[0, i]
    else:
        for i in range(STATE_SIZE):
            x[i] += (
                dt / 6.0 * (derivatives[0, i] + 2.0 * derivatives[1, i] + 2.0 * derivatives[2, i] + derivatives[3, i])
            )
        for i in range(STATE_SIZE, len(x)):
            x[i] += (
                dt / 6.0 * (derivatives[0, i] + 2.0 * derivatives[1, i] + 2.0 * derivatives[2, i] + derivatives[3, i])
            )
    normalise_quaternion(x)
    if any_lane(body[EXTRA_STATES] != 0.0):
        project_constraints(x, body)
