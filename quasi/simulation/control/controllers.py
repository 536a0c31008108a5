"""Controllers: PID, NDI and INDI, from what is seen and a goal to commanded rotor speeds; compiled.

All three share the outer loops (outer_loop.py) and the allocation (allocation.py), and differ in how they find the
rotor speeds for a wanted angular acceleration nu and thrust T. With u the squared rotor speeds, B their effectiveness:

    PID   B u = I (nu + integral - derivative), Fz of hover + B_z (u - u_hover) = -T; B from geometry, one thrust factor
    NDI   M(x, W) + B (u - W^2) = I nu + omega x I omega;  F(x, W) likewise; M and F being the whole model's
    INDI  B (u - W^2_f) = I (nu - omega_dot_f) + the change of omega x I omega since omega_f;
          T from the measured specific force likewise; f: the same low-pass filter

The yaw moment of rotor accelerations is part of B u where the model has it: B u + D du/dt, solved for the u of this
step. INDI: Smeur, Chu, de Croon, Adaptive incremental nonlinear dynamic inversion for attitude control of micro air
vehicles, J. Guidance, Control and Dynamics 39(3), 2016, and the paper named in outer_loop.py. Rotor limits are learnt
where a rotor stays behind what the actuators' lag explains, so that the allocation can give up yaw for it.

    kind, parameters, size = make_controller({"controller": "INDI"}, model)
    memory = np.zeros(size)
    controller_step(kind, parameters, memory, t, dt, seen, goal, commands)

seen (26,): attitude w x y z, u v w, p q r, x y z, rotor speeds (rad/s), specific force ax ay az (m/s2), reserved;
goal (20,): see outer_loop.py; commands (4,): filled with rotor speeds, rad/s. dt must not change between the steps.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.model.model import Model
from quasi.simulation.control import gains as g
from quasi.simulation.control.allocation import allocate, invert
from quasi.simulation.control.control_model import by_geometry, control_model, extras
from quasi.simulation.control.outer_loop import (
    KIND,
    RATES_GOAL,
    RUNNING,
    SATURATED,
    STARTED,
    WISH,
    outer_loop,
    rotation,
)
from quasi.simulation.vehicle.dynamics import euler_angles
from quasi.terms.kernel import Kernel, wrench

# first entries in the memory, beside those of outer_loop.py
INVERSE, EFFECT = 1, 17  # (16,) inverse and effectiveness of one step, row by row
SENT, SPEEDS = 33, 180  # (4,) the last commands, squared and as they are
EXPECTED, HIGHEST, LATE = 37, 41, 45  # (4,) speeds by the rotors' lag, their limits, how long they have been behind, s
RATE_INTEGRAL = 52  # (3,) rad/s2
RATES, SQUARES, OTHER = 58, 67, 79  # filters, three numbers each: of 3 rates, 4 squared speeds, 3 accelerations
WANTED, LOW, HIGH, INPUT, SCRATCH = 88, 92, 96, 100, 104  # of the allocation
NU, MODEL_OUT = 171, 174  # (3,) wanted angular accelerations; (6,) forces and moments of the model
KEEP, GAIN, FOLLOW = 184, 185, 186  # what filters and rotors do within one step
INPUTS = 188  # from here on what NDI's model works in
_LATE = 0.05  # s that a rotor may stay behind before its limit is learnt
_RECOVER = 0.5  # s in which a learnt limit that holds no longer grows by its own size


def make_controller(
    settings: Mapping[str, Any],
    model: Model,
    actuators: Mapping[str, Any] | None = None,
    offset: np.ndarray | None = None,
) -> tuple[int, np.ndarray, int]:
    """Kind, parameters and size of the memory for `controller_step`.

    settings   see `gains.settle`; {"controller": "INDI"} takes every default
    model      what is flown; its forces and moments about hover give the effectiveness
    actuators  see `control_model`
    offset     (6,) N, N m that the simulation takes off the model's forces and moments, so that NDI does too
    Raises ConfigError for impossible settings, DataError for a model that cannot be controlled.
    """
    known = control_model(model, actuators)
    settled = g.settle(settings, known)
    kind = g.kind_of(settled["controller"])
    parameters = g.pack(settled, by_geometry(known) if kind == g.PID else known)
    if kind != g.NDI:
        return kind, parameters, INPUTS
    if len(model.axes) < 6:
        raise DataError(f"controller NDI inverts forces and moments, but model {model.id} has only {model.axes}")
    packed = _pack_model(model, np.zeros(6) if offset is None else np.asarray(offset, float))
    return kind, np.concatenate([parameters, packed]), INPUTS + len(model.inputs) + len(model.kernel.work)


@njit(cache=True, error_model="numpy")
def controller_step(kind, parameters, memory, t, dt, seen, goal, commands):
    """One step of the controller `kind`: fills commands (4,), rad/s, and carries memory on."""
    if memory[STARTED] == 0.0:
        _start(kind, parameters, memory, dt, seen)
    if kind == g.PID:
        _pid(parameters, memory, dt, seen, goal)
    elif kind == g.NDI:
        _ndi(parameters, memory, dt, seen, goal)
    else:
        _indi(parameters, memory, dt, seen, goal)
    _send(parameters, memory, dt, seen, commands)


@njit(cache=True, error_model="numpy")
def _start(kind, p, m, dt, seen):
    """First step: filters begin at what is seen, and the effectiveness of one step is inverted."""
    for k in range(16):
        m[EFFECT + k] = p[g.EFFECT + k]
    for i in range(4):
        m[EFFECT + 8 + i] += p[g.REACTION + i] / (2.0 * p[g.HOVER] * dt)
        m[SENT + i] = seen[13 + i] ** 2
        m[EXPECTED + i] = m[SPEEDS + i] = seen[13 + i]
        m[HIGHEST + i] = p[g.HIGHEST]
        m[SQUARES + 3 * i] = m[SQUARES + 3 * i + 2] = seen[13 + i] ** 2
    for k in range(3):
        m[RATES + 3 * k] = m[RATES + 3 * k + 2] = seen[7 + k]
    invert(m[EFFECT : EFFECT + 16], m[INVERSE : INVERSE + 16])
    w, half = p[g.CUT_OFF], 0.5 * dt
    damp, stiff = 2.0 * p[g.DAMPING] * w * half, (w * half) ** 2
    m[KEEP], m[GAIN] = (1.0 - damp - stiff) / (1.0 + damp + stiff), w * w * half / (1.0 + damp + stiff)
    m[FOLLOW] = 1.0 - math.exp(-dt / p[g.LAG])
    m[STARTED] = RUNNING


@njit(cache=True, error_model="numpy")
def _filter(m, at, half, value):
    """Second-order low-pass filter by the trapezoidal rule over two halves of a step, s.

    m[at:at+3]: output, its derivative, last input; m[KEEP], m[GAIN] from `_start`.
    """
    y, v = m[at], m[at + 1]
    new = m[KEEP] * v + m[GAIN] * (m[at + 2] + value - 2.0 * y)
    m[at] = y + half * (v + new)
    m[at + 1] = new
    m[at + 2] = value


@njit(cache=True, error_model="numpy")
def _thrust_force(p, u0, u1, u2, u3):
    """Fz of the rotors, N, of squared speeds: the hover's, and the effectiveness for what differs from it."""
    e, h2 = g.EFFECT + 12, p[g.HOVER] ** 2
    return (
        -p[g.MASS] * GRAVITY
        + p[e] * (u0 - h2) + p[e + 1] * (u1 - h2) + p[e + 2] * (u2 - h2) + p[e + 3] * (u3 - h2)
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _want(p, m, dt, mx, my, mz, thrust):
    """Right-hand side for u: moments of B u + D du/dt, N m, and thrust, N."""
    e = g.EFFECT + 12
    m[WANTED], m[WANTED + 1] = mx, my
    m[WANTED + 3] = -thrust + p[g.MASS] * GRAVITY + p[g.HOVER] ** 2 * (p[e] + p[e + 1] + p[e + 2] + p[e + 3])
    for i in range(4):
        mz += p[g.REACTION + i] / (2.0 * p[g.HOVER] * dt) * m[SENT + i]
    m[WANTED + 2] = mz


@njit(cache=True, error_model="numpy")
def _moment(p, a, b, c):
    """Inertia times an angular acceleration."""
    i = g.INERTIA
    return (
        p[i] * a + p[i + 1] * b + p[i + 2] * c,
        p[i + 3] * a + p[i + 4] * b + p[i + 5] * c,
        p[i + 6] * a + p[i + 7] * b + p[i + 8] * c,
    )


@njit(cache=True, error_model="numpy")
def _turn(p, m, seen):
    """Wanted angular accelerations into m[NU:NU+3], from the wanted rates."""
    for k in range(3):
        m[NU + k] = p[g.RATES + k] * (m[WISH + k] - seen[7 + k])


@njit(cache=True, error_model="numpy")
def _moment_to_turn(p, m, seen, goal):
    """Moments for the wanted angular accelerations of a body that spins: I nu + omega x I omega.

    What is wanted stands still in earth axes and so turns in the body's, against its yaw rate: the wanted rates change
    by themselves, and the rotors' lag is led by its own share of a turn (exact for a steady spin).
    """
    p_, q, r = seen[7], seen[8], seen[9]
    if goal[KIND] != RATES_GOAL:
        m[NU] += r * m[WISH + 1]
        m[NU + 1] -= r * m[WISH]
    mx, my, mz = _moment(p, m[NU], m[NU + 1], m[NU + 2])
    hx, hy, hz = _moment(p, p_, q, r)
    mx, my, mz = mx + q * hz - r * hy, my + r * hx - p_ * hz, mz + p_ * hy - q * hx
    if goal[KIND] == RATES_GOAL:
        return mx, my, mz
    lead = min(max(p[g.LAG] * r, -1.0), 1.0)
    return mx + lead * my, my - lead * mx, mz


@njit(cache=True, error_model="numpy")
def _pid(p, m, dt, seen, goal):
    thrust = outer_loop(p, m, dt, seen, goal, 0.0, 0.0, 0.0)
    _turn(p, m, seen)
    for k in range(3):
        _filter(m, RATES + 3 * k, 0.5 * dt, seen[7 + k])
        error = m[WISH + k] - seen[7 + k]
        # no integration further into a limit of the rotors
        if m[STARTED] == RUNNING or error * m[RATE_INTEGRAL + k] < 0.0:
            most = p[g.RATES + k] * p[g.RATE]
            total = m[RATE_INTEGRAL + k] + p[g.RATES_INTEGRAL + k] * error * dt
            m[RATE_INTEGRAL + k] = min(max(total, -most), most)
        m[NU + k] += m[RATE_INTEGRAL + k] - p[g.RATES_DERIVATIVE + k] * m[RATES + 3 * k + 1]
    mx, my, mz = _moment(p, m[NU], m[NU + 1], m[NU + 2])
    _want(p, m, dt, mx, my, mz, thrust)


@njit(cache=True, error_model="numpy")
def _indi(p, m, dt, seen, goal):
    # acceleration that is not the thrust's, by accelerometer and rotor speeds of the same moment, filtered alike
    u0, u1, u2, u3 = seen[13] ** 2, seen[14] ** 2, seen[15] ** 2, seen[16] ** 2
    ax, ay = seen[17], seen[18]
    az = seen[19] - _thrust_force(p, u0, u1, u2, u3) / p[g.MASS]
    r = rotation(seen)
    _filter(m, OTHER, 0.5 * dt, r[0] * ax + r[1] * ay + r[2] * az)
    _filter(m, OTHER + 3, 0.5 * dt, r[3] * ax + r[4] * ay + r[5] * az)
    _filter(m, OTHER + 6, 0.5 * dt, r[6] * ax + r[7] * ay + r[8] * az)
    thrust = outer_loop(p, m, dt, seen, goal, m[OTHER], m[OTHER + 3], m[OTHER + 6])
    _turn(p, m, seen)
    for k in range(3):
        _filter(m, RATES + 3 * k, 0.5 * dt, seen[7 + k])
    for i in range(4):
        _filter(m, SQUARES + 3 * i, 0.5 * dt, seen[13 + i] ** 2)
    mx, my, mz = _moment_to_turn(p, m, seen, goal)
    # moments that are neither the rotors' nor the spinning body's, by rates and rotor speeds filtered alike
    ax, ay, az = _moment(p, m[RATES + 1], m[RATES + 4], m[RATES + 7])
    hx, hy, hz = _moment(p, m[RATES], m[RATES + 3], m[RATES + 6])
    mx -= ax + m[RATES + 3] * hz - m[RATES + 6] * hy
    my -= ay + m[RATES + 6] * hx - m[RATES] * hz
    mz -= az + m[RATES] * hy - m[RATES + 3] * hx
    e = g.EFFECT
    for i in range(4):
        u, slope = m[SQUARES + 3 * i], m[SQUARES + 3 * i + 1]
        mx += p[e + i] * u
        my += p[e + 4 + i] * u
        mz += p[e + 8 + i] * u + p[g.REACTION + i] / (2.0 * p[g.HOVER]) * slope
    _want(p, m, dt, mx, my, mz, thrust)


@njit(cache=True, error_model="numpy")
def _ndi(p, m, dt, seen, goal):
    kernel, offset, further = _unpack_model(p)
    inputs = m[INPUTS : INPUTS + 20 + len(further)]
    work = m[INPUTS + 20 + len(further) :]
    out = m[MODEL_OUT : MODEL_OUT + 6]
    euler_angles(seen, inputs)
    for i in range(13):
        inputs[3 + i] = seen[4 + i]
    for i in range(4):
        inputs[16 + i] = 0.0  # the moment of rotor accelerations is part of what is solved for
    for i in range(20, len(inputs)):
        inputs[i] = further[i - 20]
    wrench(kernel, inputs, work, out)
    for k in range(6):
        out[k] -= offset[k]
    r = rotation(seen)
    mass = p[g.MASS]
    if p[g.MODEL] == 0.0:  # the model's forces hold the weight
        for k in range(3):
            out[k] -= mass * GRAVITY * r[6 + k]
    u0, u1, u2, u3 = seen[13] ** 2, seen[14] ** 2, seen[15] ** 2, seen[16] ** 2
    ax, ay = out[0] / mass, out[1] / mass
    az = (out[2] - _thrust_force(p, u0, u1, u2, u3)) / mass
    thrust = outer_loop(
        p, m, dt, seen, goal,
        r[0] * ax + r[1] * ay + r[2] * az, r[3] * ax + r[4] * ay + r[5] * az, r[6] * ax + r[7] * ay + r[8] * az,
    )  # fmt: skip
    _turn(p, m, seen)
    mx, my, mz = _moment_to_turn(p, m, seen, goal)
    mx, my, mz = mx - out[3], my - out[4], mz - out[5]
    e = g.EFFECT
    for i in range(4):
        u = seen[13 + i] ** 2
        mx += p[e + i] * u
        my += p[e + 4 + i] * u
        mz += p[e + 8 + i] * u
    _want(p, m, dt, mx, my, mz, thrust)


@njit(cache=True, error_model="numpy")
def _send(p, m, dt, seen, commands):
    """Rotor speeds for what is wanted, within the rotors' limits; watches whether the rotors follow."""
    if p[g.LEARN] > 0.0:
        _learn_limits(p, m, dt, seen)
    u = m[INPUT : INPUT + 4]
    low, high = m[LOW : LOW + 4], m[HIGH : HIGH + 4]
    inside = True
    for i in range(4):
        low[i], high[i] = p[g.LOWEST] ** 2, m[HIGHEST + i] ** 2
        u[i] = 0.0
        for k in range(4):
            u[i] += m[INVERSE + 4 * i + k] * m[WANTED + k]
        if not low[i] <= u[i] <= high[i]:
            inside = False
    if not inside:
        if p[g.METHOD] > 0.0:
            for i in range(4):
                u[i] = min(max(u[i], low[i]), high[i])
            allocate(
                m[EFFECT : EFFECT + 16], m[WANTED : WANTED + 4], p[g.WEIGHTS : g.WEIGHTS + 4], low, high,
                p[g.HOVER] ** 2, u, m[SCRATCH : SCRATCH + 64],
            )  # fmt: skip
        else:
            for i in range(4):
                u[i] = min(max(u[i], low[i]), high[i])
    m[STARTED] = RUNNING if inside else SATURATED
    for i in range(4):
        m[SENT + i] = u[i]
        commands[i] = m[SPEEDS + i] = math.sqrt(u[i])


@njit(cache=True, error_model="numpy")
def _learn_limits(p, m, dt, seen):
    """Upper limits of the rotors, rad/s, from how they follow the commands sent through the actuators' lag.

    What the rotor that follows best falls short by, all do, for want of volts: it is the limit of none.
    """
    alike = 0.0
    for i in range(4):
        m[EXPECTED + i] += (m[SPEEDS + i] - m[EXPECTED + i]) * m[FOLLOW]
        alike = max(alike, seen[13 + i] / max(m[EXPECTED + i], 1e-3))
    alike = min(alike, 1.0)
    for i in range(4):
        behind = alike * m[EXPECTED + i] - seen[13 + i] > 0.03 * p[g.HOVER]
        m[LATE + i] = max(m[LATE + i] + (dt if behind else -dt), 0.0)
        if m[LATE + i] > _LATE:
            m[HIGHEST + i] = max(1.01 * seen[13 + i], 1.001 * p[g.LOWEST])
            m[EXPECTED + i] = seen[13 + i]
            m[LATE + i] = 0.0
        elif m[HIGHEST + i] < p[g.HIGHEST] and not behind:
            m[HIGHEST + i] = min(m[HIGHEST + i] * (1.0 + dt / _RECOVER), p[g.HIGHEST])


def _pack_model(model: Model, offset: np.ndarray) -> np.ndarray:
    """The model as float64: 1 or 0 for forces without or with weight in them, offset (6,), lengths, extras, arrays.

    The code's whole numbers are laid into the floats' bytes, two to a float; `_unpack_model` reads them in place.
    """
    kernel, further = model.kernel, extras(model)
    code = np.concatenate([kernel.code, np.zeros(len(kernel.code) % 2, np.uint32)]).astype(np.uint32)
    head = [float(model.with_gravity), *offset, len(further), len(kernel.code), len(kernel.numbers)]
    return np.concatenate([head, further, kernel.numbers, code.view(np.float64)])


@njit(cache=True, error_model="numpy")
def _unpack_model(p):
    """Kernel, offset (6,) and extras that `_pack_model` laid down, without a copy."""
    at = g.MODEL + 10
    extra, whole, numbers = int(p[at - 3]), int(p[at - 2]), int(p[at - 1])
    begin = at + extra + numbers
    code = p[begin : begin + (whole + 1) // 2].view(np.uint32)[:whole]
    return Kernel(code, p[at + extra : begin]), p[g.MODEL + 1 : g.MODEL + 7], p[at : at + extra]
