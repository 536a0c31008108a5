"""Controllers: PID, NDI and INDI, from measurement and setpoint to commanded rotor speeds; compiled.

All three share the outer loops (outer_loop.py) and the allocation (allocation.py). They differ in how they compute the
rotor speeds for a wanted angular acceleration nu and thrust T. With u the squared rotor speeds, B their effectiveness:

    PID   B u = I (nu + integral - derivative), Fz of hover + B_z (u - u_hover) = -T; B from geometry, one thrust factor
    NDI   M(x, W) + B (u - W^2) = I nu + omega x I omega;  F(x, W) likewise; M and F of the whole model
    INDI  B (u - W^2_f) = I (nu - omega_dot_f) + the change of omega x I omega since omega_f;
          T from the measured specific force likewise; f: the same low-pass filter

The yaw moment of rotor accelerations is part of B u where the model has it: B u + D du/dt, solved for the u of this
step. INDI: Smeur, Chu, de Croon, Adaptive incremental nonlinear dynamic inversion for attitude control of micro air
vehicles, J. Guidance, Control and Dynamics 39(3), 2016, and the paper named in outer_loop.py. Where a rotor lags
more than the actuators' lag explains, its limit is learnt, so that the allocation can reduce yaw.

    kind, parameters, size = make_controller({"controller": "INDI"}, model)
    memory = np.zeros(size)
    controller_step(kind, parameters, memory, t, dt, measurement, setpoint, commands)

measurement (26,): attitude w x y z, u v w, p q r, x y z, rotor speeds (rad/s), specific force ax ay az (m/s2),
reserved; setpoint (20,): see outer_loop.py; commands (4,): filled with rotor speeds, rad/s. dt must be constant.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.model.hover import list_usual_inputs
from quasi.model.model import Model
from quasi.simulation.control import gains as g
from quasi.simulation.control.allocation import allocate_rotors, invert_matrix
from quasi.simulation.control.control_model import make_control_model, use_geometric_mixer
from quasi.simulation.control.outer_loop import (
    CONTROLLER_STATUS,
    RATES_SETPOINT,
    RUNNING,
    SATURATED,
    SETPOINT_KIND,
    WANTED_RATES,
    rotation_matrix,
    run_outer_loop,
)
from quasi.simulation.vehicle.dynamics import euler_angles
from quasi.terms.kernel import Kernel, compute_wrench
from quasi.terms.lanes import all_lanes, any_lane, choose, common_value, count_lanes, get_entry, set_entry

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
_MAX_TIME_BEHIND = 0.05  # s that a rotor may lag before its limit is learnt
_LIMIT_RECOVERY_TIME = 0.5  # s in which an outdated learnt limit doubles


def make_controller(
    settings: Mapping[str, Any],
    model: Model,
    actuators: Mapping[str, Any] | None = None,
    offset: np.ndarray | None = None,
) -> tuple[int, np.ndarray, int]:
    """Kind, parameters and size of the memory for `controller_step`.

    settings   see `gains.settle`; {"controller": "INDI"} takes every default
    model      the vehicle; its forces and moments about hover give the effectiveness
    actuators  see `make_control_model`
    offset     (6,) N, N m that the simulation subtracts from the model's forces and moments; NDI subtracts it too
    Raises ConfigError for impossible settings, DataError for a model that cannot be controlled.
    """
    vehicle = make_control_model(model, actuators)
    complete = g.complete_settings(settings, vehicle)
    kind = g.find_kind(complete["controller"])
    parameters = g.pack_parameters(complete, use_geometric_mixer(vehicle) if kind == g.PID else vehicle)
    if kind != g.NDI:
        return kind, parameters, MODEL_INPUTS
    if len(model.axes) < 6:
        raise DataError(f"controller NDI inverts forces and moments, but model {model.id} has only {model.axes}")
    packed = _pack_model(model, np.zeros(6) if offset is None else np.asarray(offset, float))
    return kind, np.concatenate([parameters, packed]), MODEL_INPUTS + len(model.inputs) + len(model.kernel.work)


@njit(cache=True, error_model="numpy")
def controller_step(kind, parameters, memory, t, dt, measurement, setpoint, commands):
    """Run one step of the controller `kind`: fill commands (4,), rad/s, and update the memory."""
    if memory[CONTROLLER_STATUS] == 0.0:
        initialise_memory(parameters, memory, dt, measurement)
    run_controller(kind, parameters, parameters, memory, dt, measurement, setpoint, commands)


@njit(cache=True, error_model="numpy")
def run_controller(kind, parameters, packed, memory, dt, measurement, setpoint, commands):
    """Run one step with an initialised memory; arrays, or views of eight drones (`quasi.terms.lanes`).

    packed  parameters of one drone as an array, of which NDI reads its model
    """
    if kind == g.PID:
        _run_pid(parameters, memory, dt, measurement, setpoint)
    elif kind == g.NDI:
        _run_ndi(parameters, packed, memory, dt, measurement, setpoint)
    else:
        _run_indi(parameters, memory, dt, measurement, setpoint)
    _allocate_commands(parameters, memory, dt, measurement, commands)


@njit(cache=True, error_model="numpy")
def initialise_memory(p, m, dt, measurement):
    """Initialise the filters with the measurement and invert the effectiveness of one step."""
    for k in range(16):
        m[STEP_EFFECTIVENESS + k] = p[g.EFFECTIVENESS + k]
    for i in range(4):
        m[STEP_EFFECTIVENESS + 8 + i] += p[g.YAW_REACTION + i] / (2.0 * p[g.HOVER_SPEED] * dt)
        m[LAST_COMMANDS_SQUARED + i] = measurement[13 + i] ** 2
        m[EXPECTED_SPEEDS + i] = m[LAST_COMMANDS + i] = measurement[13 + i]
        m[LEARNT_LIMITS + i] = p[g.HIGHEST_SPEED]
        m[SPEED_FILTERS + 3 * i] = m[SPEED_FILTERS + 3 * i + 2] = measurement[13 + i] ** 2
    for k in range(3):
        m[RATE_FILTERS + 3 * k] = m[RATE_FILTERS + 3 * k + 2] = measurement[7 + k]
    invert_matrix(
        m[STEP_EFFECTIVENESS : STEP_EFFECTIVENESS + 16], m[INVERSE_EFFECTIVENESS : INVERSE_EFFECTIVENESS + 16]
    )
    w, half = p[g.FILTER_FREQUENCY], 0.5 * dt
    damp, stiff = 2.0 * p[g.FILTER_DAMPING] * w * half, (w * half) ** 2
    m[FILTER_KEEP], m[FILTER_GAIN] = (1.0 - damp - stiff) / (1.0 + damp + stiff), w * w * half / (1.0 + damp + stiff)
    m[LAG_SHARE] = 1.0 - math.exp(-dt / p[g.ACTUATOR_LAG])
    m[CONTROLLER_STATUS] = RUNNING


@njit(cache=True, error_model="numpy")
def _filter_value(m, at, half, value):
    """Second-order low-pass filter by the trapezoidal rule over two halves of a step, s.

    m[at:at+3]: output, its derivative, last input; m[FILTER_KEEP], m[FILTER_GAIN] from `initialise_memory`.
    """
    y, v = m[at], m[at + 1]
    new = m[FILTER_KEEP] * v + m[FILTER_GAIN] * (m[at + 2] + value - 2.0 * y)
    m[at] = y + half * (v + new)
    m[at + 1] = new
    m[at + 2] = value


@njit(cache=True, error_model="numpy")
def _thrust_force(p, u0, u1, u2, u3):
    """Compute Fz of the rotors, N, from squared speeds, linear about hover."""
    e, h2 = g.EFFECTIVENESS + 12, p[g.HOVER_SPEED] * p[g.HOVER_SPEED]
    return (
        -p[g.CONTROL_MASS] * GRAVITY
        + p[e] * (u0 - h2) + p[e + 1] * (u1 - h2) + p[e + 2] * (u2 - h2) + p[e + 3] * (u3 - h2)
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _set_wanted_loads(p, m, dt, mx, my, mz, thrust):
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
def _multiply_inertia(p, a, b, c):
    """Multiply the inertia by an angular acceleration."""
    i = g.CONTROL_INERTIA
    return (
        p[i] * a + p[i + 1] * b + p[i + 2] * c,
        p[i + 3] * a + p[i + 4] * b + p[i + 5] * c,
        p[i + 6] * a + p[i + 7] * b + p[i + 8] * c,
    )


@njit(cache=True, error_model="numpy")
def _set_angular_acceleration(p, m, measurement):
    """Set the wanted angular accelerations from the wanted rates."""
    for k in range(3):
        m[ANGULAR_ACCELERATION + k] = p[g.RATE_GAINS + k] * (m[WANTED_RATES + k] - measurement[7 + k])


@njit(cache=True, error_model="numpy")
def _compute_moments(p, m, measurement, setpoint):
    """Moments for the wanted angular accelerations of a body that spins: I nu + omega x I omega.

    The wanted rates are constant in earth axes, so they rotate in body axes against the yaw rate. Their change and the
    rotors' lag are compensated (exact for a steady spin).
    """
    p_, q, r = measurement[7], measurement[8], measurement[9]
    keeps_heading = common_value(setpoint[SETPOINT_KIND]) != RATES_SETPOINT
    if keeps_heading:
        m[ANGULAR_ACCELERATION] += r * m[WANTED_RATES + 1]
        m[ANGULAR_ACCELERATION + 1] -= r * m[WANTED_RATES]
    mx, my, mz = _multiply_inertia(p, m[ANGULAR_ACCELERATION], m[ANGULAR_ACCELERATION + 1], m[ANGULAR_ACCELERATION + 2])
    hx, hy, hz = _multiply_inertia(p, p_, q, r)
    mx, my, mz = mx + q * hz - r * hy, my + r * hx - p_ * hz, mz + p_ * hy - q * hx
    if not keeps_heading:
        return mx, my, mz
    lead = min(max(p[g.ACTUATOR_LAG] * r, -1.0), 1.0)
    return mx + lead * my, my - lead * mx, mz


@njit(cache=True, error_model="numpy")
def _run_pid(p, m, dt, measurement, setpoint):
    thrust = run_outer_loop(p, m, dt, measurement, setpoint, 0.0, 0.0, 0.0)
    _set_angular_acceleration(p, m, measurement)
    for k in range(3):
        _filter_value(m, RATE_FILTERS + 3 * k, 0.5 * dt, measurement[7 + k])
        error = m[WANTED_RATES + k] - measurement[7 + k]
        # anti-windup: no integration further into a limit of the rotors
        integrates = (m[CONTROLLER_STATUS] == RUNNING) | (error * m[RATE_INTEGRAL + k] < 0.0)
        most = p[g.RATE_GAINS + k] * p[g.MAX_TILT_RATE]
        total = m[RATE_INTEGRAL + k] + p[g.RATE_INTEGRAL_GAINS + k] * error * dt
        m[RATE_INTEGRAL + k] = choose(integrates, min(max(total, -most), most), m[RATE_INTEGRAL + k])
        m[ANGULAR_ACCELERATION + k] += (
            m[RATE_INTEGRAL + k] - p[g.RATE_DERIVATIVE_GAINS + k] * m[RATE_FILTERS + 3 * k + 1]
        )
    mx, my, mz = _multiply_inertia(p, m[ANGULAR_ACCELERATION], m[ANGULAR_ACCELERATION + 1], m[ANGULAR_ACCELERATION + 2])
    _set_wanted_loads(p, m, dt, mx, my, mz, thrust)


@njit(cache=True, error_model="numpy")
def _run_indi(p, m, dt, measurement, setpoint):
    # acceleration not caused by thrust: accelerometer and rotor speeds of the same instant, with the same filter
    u0, u1 = measurement[13] * measurement[13], measurement[14] * measurement[14]
    u2, u3 = measurement[15] * measurement[15], measurement[16] * measurement[16]
    ax, ay = measurement[17], measurement[18]
    az = measurement[19] - _thrust_force(p, u0, u1, u2, u3) / p[g.CONTROL_MASS]
    r = rotation_matrix(measurement)
    _filter_value(m, ACCELERATION_FILTERS, 0.5 * dt, r[0] * ax + r[1] * ay + r[2] * az)
    _filter_value(m, ACCELERATION_FILTERS + 3, 0.5 * dt, r[3] * ax + r[4] * ay + r[5] * az)
    _filter_value(m, ACCELERATION_FILTERS + 6, 0.5 * dt, r[6] * ax + r[7] * ay + r[8] * az)
    thrust = run_outer_loop(
        p,
        m,
        dt,
        measurement,
        setpoint,
        m[ACCELERATION_FILTERS],
        m[ACCELERATION_FILTERS + 3],
        m[ACCELERATION_FILTERS + 6],
    )
    _set_angular_acceleration(p, m, measurement)
    for k in range(3):
        _filter_value(m, RATE_FILTERS + 3 * k, 0.5 * dt, measurement[7 + k])
    for i in range(4):
        _filter_value(m, SPEED_FILTERS + 3 * i, 0.5 * dt, measurement[13 + i] * measurement[13 + i])
    mx, my, mz = _compute_moments(p, m, measurement, setpoint)
    # moments of neither rotors nor gyroscopic terms: rates and rotor speeds with the same filter
    ax, ay, az = _multiply_inertia(p, m[RATE_FILTERS + 1], m[RATE_FILTERS + 4], m[RATE_FILTERS + 7])
    hx, hy, hz = _multiply_inertia(p, m[RATE_FILTERS], m[RATE_FILTERS + 3], m[RATE_FILTERS + 6])
    mx -= ax + m[RATE_FILTERS + 3] * hz - m[RATE_FILTERS + 6] * hy
    my -= ay + m[RATE_FILTERS + 6] * hx - m[RATE_FILTERS] * hz
    mz -= az + m[RATE_FILTERS] * hy - m[RATE_FILTERS + 3] * hx
    e = g.EFFECTIVENESS
    for i in range(4):
        u, slope = m[SPEED_FILTERS + 3 * i], m[SPEED_FILTERS + 3 * i + 1]
        mx += p[e + i] * u
        my += p[e + 4 + i] * u
        mz += p[e + 8 + i] * u + p[g.YAW_REACTION + i] / (2.0 * p[g.HOVER_SPEED]) * slope
    _set_wanted_loads(p, m, dt, mx, my, mz, thrust)


@njit(cache=True, error_model="numpy")
def _run_ndi(p, packed, m, dt, measurement, setpoint):
    kernel, offset, further = _unpack_model(packed)
    inputs = m[MODEL_INPUTS : MODEL_INPUTS + 20 + len(further)]
    work = m[MODEL_INPUTS + 20 + len(further) :]
    out = m[MODEL_LOADS : MODEL_LOADS + 6]
    euler_angles(measurement, inputs)
    for i in range(13):
        inputs[3 + i] = measurement[4 + i]
    for i in range(4):
        inputs[16 + i] = 0.0  # the moment of rotor accelerations is part of the unknowns
    for i in range(20, len(inputs)):
        inputs[i] = further[i - 20]
    compute_wrench(kernel, inputs, work, out)
    for k in range(6):
        out[k] -= offset[k]
    r = rotation_matrix(measurement)
    mass = p[g.CONTROL_MASS]
    if packed[g.MODEL_START] == 0.0:  # the model's forces include the weight
        for k in range(3):
            out[k] -= mass * GRAVITY * r[6 + k]
    u0, u1 = measurement[13] * measurement[13], measurement[14] * measurement[14]
    u2, u3 = measurement[15] * measurement[15], measurement[16] * measurement[16]
    ax, ay = out[0] / mass, out[1] / mass
    az = (out[2] - _thrust_force(p, u0, u1, u2, u3)) / mass
    thrust = run_outer_loop(
        p, m, dt, measurement, setpoint,
        r[0] * ax + r[1] * ay + r[2] * az, r[3] * ax + r[4] * ay + r[5] * az, r[6] * ax + r[7] * ay + r[8] * az,
    )  # fmt: skip
    _set_angular_acceleration(p, m, measurement)
    mx, my, mz = _compute_moments(p, m, measurement, setpoint)
    mx, my, mz = mx - out[3], my - out[4], mz - out[5]
    e = g.EFFECTIVENESS
    for i in range(4):
        u = measurement[13 + i] * measurement[13 + i]
        mx += p[e + i] * u
        my += p[e + 4 + i] * u
        mz += p[e + 8 + i] * u
    _set_wanted_loads(p, m, dt, mx, my, mz, thrust)


@njit(cache=True, error_model="numpy")
def _allocate_commands(p, m, dt, measurement, commands):
    """Compute rotor speeds for the wanted loads within the rotors' limits, and monitor whether the rotors follow."""
    if any_lane(p[g.LEARNS_ROTOR_LIMITS] > 0.0):
        _learn_limits(p, m, dt, measurement)
    inside = True
    for i in range(4):
        low, high = p[g.LOWEST_SPEED] * p[g.LOWEST_SPEED], m[LEARNT_LIMITS + i] * m[LEARNT_LIMITS + i]
        u = 0.0
        for k in range(4):
            u += m[INVERSE_EFFECTIVENESS + 4 * i + k] * m[WANTED_LOADS + k]
        inside = inside & (low <= u) & (u <= high)
        m[LOWEST_INPUTS + i], m[HIGHEST_INPUTS + i] = low, high
        m[ALLOCATED_INPUTS + i] = min(max(u, low), high)
    m[CONTROLLER_STATUS] = choose(inside, RUNNING, SATURATED)
    if not all_lanes(inside):
        _allocate_saturated(p, m)
    for i in range(4):
        u = m[ALLOCATED_INPUTS + i]
        m[LAST_COMMANDS_SQUARED + i] = u
        commands[i] = m[LAST_COMMANDS + i] = math.sqrt(u)


@njit(cache=True, error_model="numpy")
def _allocate_saturated(p, m):
    """Solve the weighted allocation of each drone whose rotors reach a limit, one after another."""
    known = np.empty(ALLOCATION_SCRATCH + 64 - STEP_EFFECTIVENESS)  # of the memory, so that offsets stay the same
    weights = np.empty(4)
    for lane in range(count_lanes(m)):
        if get_entry(m, CONTROLLER_STATUS, lane) == RUNNING or get_entry(p, g.USES_WEIGHTED_ALLOCATION, lane) == 0.0:
            continue
        for part, size in ((STEP_EFFECTIVENESS, 16), (WANTED_LOADS, 16)):
            for i in range(part, part + size):
                known[i - STEP_EFFECTIVENESS] = get_entry(m, i, lane)
        for i in range(4):
            weights[i] = get_entry(p, g.ALLOCATION_WEIGHTS + i, lane)
        hover = get_entry(p, g.HOVER_SPEED, lane)
        wanted, low, high, u, scratch = (
            known[WANTED_LOADS - STEP_EFFECTIVENESS :], known[LOWEST_INPUTS - STEP_EFFECTIVENESS :],
            known[HIGHEST_INPUTS - STEP_EFFECTIVENESS :], known[ALLOCATED_INPUTS - STEP_EFFECTIVENESS :],
            known[ALLOCATION_SCRATCH - STEP_EFFECTIVENESS :],
        )  # fmt: skip
        allocate_rotors(known, wanted, weights, low, high, hover * hover, u, scratch)
        for i in range(4):
            set_entry(m, ALLOCATED_INPUTS + i, lane, u[i])


@njit(cache=True, error_model="numpy")
def _learn_limits(p, m, dt, measurement):
    """Learn upper limits of the rotors, rad/s, from how they follow the commands with the actuators' lag.

    The shortfall of the best rotor is attributed to low voltage, common to all rotors, and to no limit.
    """
    alike = 0.0
    for i in range(4):
        m[EXPECTED_SPEEDS + i] += (m[LAST_COMMANDS + i] - m[EXPECTED_SPEEDS + i]) * m[LAG_SHARE]
        alike = max(alike, measurement[13 + i] / max(m[EXPECTED_SPEEDS + i], 1e-3))
    alike = min(alike, 1.0)
    for i in range(4):
        limit, speed = m[LEARNT_LIMITS + i], measurement[13 + i]
        behind = alike * m[EXPECTED_SPEEDS + i] - speed > 0.03 * p[g.HOVER_SPEED]
        time = max(m[TIME_BEHIND + i] + choose(behind, dt, -dt), 0.0)
        learns = (time > _MAX_TIME_BEHIND) & (p[g.LEARNS_ROTOR_LIMITS] > 0.0)
        recovered = min(limit * (1.0 + dt / _LIMIT_RECOVERY_TIME), p[g.HIGHEST_SPEED])
        kept = choose(behind, limit, choose(limit < p[g.HIGHEST_SPEED], recovered, limit))
        m[LEARNT_LIMITS + i] = choose(learns, max(1.01 * speed, 1.001 * p[g.LOWEST_SPEED]), kept)
        m[EXPECTED_SPEEDS + i] = choose(learns, speed, m[EXPECTED_SPEEDS + i])
        m[TIME_BEHIND + i] = choose(learns, 0.0, time)


def _pack_model(model: Model, offset: np.ndarray) -> np.ndarray:
    """Pack the model as float64: 1 or 0 for forces without or with weight, offset (6,), lengths, extras, arrays.

    Two integers of the code occupy the bytes of one float; `_unpack_model` reads them in place.
    """
    kernel, further = model.kernel, list_usual_inputs(model)
    code = np.concatenate([kernel.code, np.zeros(len(kernel.code) % 2, np.uint32)]).astype(np.uint32)
    head = [float(model.with_gravity), *offset, len(further), len(kernel.code), len(kernel.numbers)]
    return np.concatenate([head, further, kernel.numbers, code.view(np.float64)])


@njit(cache=True, error_model="numpy")
def _unpack_model(p):
    """Read kernel, offset (6,) and extras that `_pack_model` wrote, without a copy."""
    at = g.MODEL_START + 10
    extra, whole, numbers = int(p[at - 3]), int(p[at - 2]), int(p[at - 1])
    begin = at + extra + numbers
    code = p[begin : begin + (whole + 1) // 2].view(np.uint32)[:whole]
    return Kernel(code, p[at + extra : begin]), p[g.MODEL_START + 1 : g.MODEL_START + 7], p[at : at + extra]
