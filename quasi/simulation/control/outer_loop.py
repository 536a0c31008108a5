"""Position, velocity and attitude loops of all controllers: from a setpoint to wanted body rates and thrust.

    v_wanted = v_ref + (x_ref - x)/T_x,  a_wanted = a_ref + (v_wanted - v)/T_v + integral
    thrust vector per mass: s = a_wanted - g - d,  d the acceleration not caused by thrust

d is zero for PID (its integral estimates it), the model's for NDI, and the measured one for INDI: the increment of
Smeur, de Croon, Chu, Cascaded incremental nonlinear dynamic inversion for MAV disturbance rejection, Control
Engineering Practice 73, 2018, written for the whole vector. Attitude errors are split in tilt and yaw, tilt first:
Brescianini, D'Andrea, Tilt-prioritized quadrocopter attitude control, IEEE T-CST 28(2), 2020.

Setpoint (20,): kind; x y z (m, earth); vx vy vz (m/s, earth); roll pitch yaw (rad); p q r (rad/s); thrust (N, upwards
in the body; NaN carries the weight); yaw rate (rad/s, about the vertical); ax ay az (m/s2, earth, feedforward).
"""

import math

from numba import njit

from quasi.attitude import GRAVITY
from quasi.simulation.control import parameters as g
from quasi.terms.lanes import any_lane, choose, common_value

SETPOINT_SIZE = 20
POSITION_SETPOINT, VELOCITY_SETPOINT, ATTITUDE_SETPOINT, RATES_SETPOINT = 0.0, 1.0, 2.0, 3.0
(
    SETPOINT_KIND,
    SETPOINT_POSITION,
    SETPOINT_VELOCITY,
    SETPOINT_ANGLES,
    SETPOINT_RATES,
    SETPOINT_THRUST,
    SETPOINT_YAW_RATE,
    SETPOINT_ACCELERATION,
) = 0, 1, 4, 7, 10, 13, 14, 15

# entries of these loops in the memory; see controllers.py for the others. CONTROLLER_STATUS is 0 before the first step,
# then RUNNING, or SATURATED where the last commands reached a limit of the rotors
CONTROLLER_STATUS, RUNNING, SATURATED = 0, 1.0, 2.0
VELOCITY_INTEGRAL, LAST_ACCELERATION, WANTED_RATES = 49, 55, 168
_BRAKING_SHARE = 0.4  # share of the greatest acceleration (vertically: of gravity) assumed for braking
_MAX_INTEGRATED_ERROR = 0.4  # m/s, greatest velocity error that is integrated
_MAX_JERK = 80.0  # m/s3; a faster change of the feedforward acceleration is a jump and has no rate


@njit(cache=True, error_model="numpy")
def rotation_matrix(q):
    """Rotation matrix body to earth, row by row, of a quaternion w x y z."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def turn_towards(r, d, parameters, out):
    """Body rates (into out (3,), rad/s) that turn from the attitude r to d, both nine entries row by row."""
    # e = r' d, the wanted axes in body axes
    e00 = r[0] * d[0] + r[3] * d[3] + r[6] * d[6]
    e01 = r[0] * d[1] + r[3] * d[4] + r[6] * d[7]
    e10 = r[1] * d[0] + r[4] * d[3] + r[7] * d[6]
    e11 = r[1] * d[1] + r[4] * d[4] + r[7] * d[7]
    nx = r[0] * d[2] + r[3] * d[5] + r[6] * d[8]
    ny = r[1] * d[2] + r[4] * d[5] + r[7] * d[8]
    nz = r[2] * d[2] + r[5] * d[5] + r[8] * d[8]
    # the shortest rotation of the body's z axis onto the wanted one
    sine = math.sqrt(nx * nx + ny * ny)
    gain, tilted = parameters[g.ATTITUDE_GAIN], sine > 1e-9
    factor = math.atan2(sine, nz) / sine
    # upside down: any axis will do
    out[0] = choose(tilted, -gain * factor * ny, choose(nz > 0.0, 0.0, gain * math.pi))
    out[1] = choose(tilted, gain * factor * nx, 0.0)
    # the remaining rotation is about z (swing and twist of the error quaternion)
    out[2] = parameters[g.YAW_GAIN] * math.atan2(e10 - e01, e00 + e11)


@njit(cache=True, error_model="numpy")
def attitude_of_thrust(sx, sy, sz, yaw):
    """Attitude (nine entries row by row) whose z axis is against the thrust s and whose heading is yaw (3-2-1)."""
    size = math.sqrt(sx * sx + sy * sy + sz * sz)
    zx, zy, zz = -sx / size, -sy / size, -sz / size
    cy, sy_ = math.cos(yaw), math.sin(yaw)
    # x lies above or below the heading: across z and across the level axis to the right of the heading
    xx, xy, xz = cy * zz, sy_ * zz, -sy_ * zy - cy * zx
    norm = math.sqrt(xx * xx + xy * xy + xz * xz)
    xx, xy, xz = xx / norm, xy / norm, xz / norm
    return (
        xx, zy * xz - zz * xy, zx,
        xy, zz * xx - zx * xz, zy,
        xz, zx * xy - zy * xx, zz,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def attitude_of_angles(roll, pitch, yaw):
    """Attitude (nine entries row by row) of Euler angles 3-2-1."""
    cr, sr, cp, sp, cy, sy = (
        math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw),
    )  # fmt: skip
    return (
        cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy,
        cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy,
        -sp, sr * cp, cr * cp,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _limit_length(x, y, most):
    size = math.sqrt(x * x + y * y)
    return choose(size <= most, x, x * most / size), choose(size <= most, y, y * most / size)


@njit(cache=True, error_model="numpy")
def _limit_approach_gain(distance, gain, brake, most):
    """Wanted speed per distance, 1/s: the gain when near; when far no more than can be braked, nor than `most`, m/s."""
    linear = brake / (gain * gain)
    speed = choose(distance <= linear, gain * distance, math.sqrt(2.0 * brake * distance - brake * linear))
    return choose(distance > 0.0, min(speed, most) / distance, gain)


@njit(cache=True, error_model="numpy")
def _given_or(given, default):
    """`given` unless it is NaN."""
    return choose(given == given, given, default)


@njit(cache=True, error_model="numpy")
def run_outer_loop(parameters, memory, dt, measurement, setpoint, dx, dy, dz):
    """Write the wanted body rates, rad/s, to memory[WANTED_RATES:WANTED_RATES+3]; return the wanted thrust, N, upwards.

    dx dy dz: acceleration caused by neither gravity nor thrust, m/s2, earth axes.
    """
    p, wanted_rates = parameters, memory[WANTED_RATES : WANTED_RATES + 3]
    kind, mass = common_value(setpoint[SETPOINT_KIND]), p[g.CONTROL_MASS]
    if kind == RATES_SETPOINT:
        for k in range(3):
            wanted_rates[k] = setpoint[SETPOINT_RATES + k]
        return _given_or(setpoint[SETPOINT_THRUST], mass * GRAVITY)
    r = rotation_matrix(measurement)
    if kind == ATTITUDE_SETPOINT:
        turn_towards(
            r,
            attitude_of_angles(setpoint[SETPOINT_ANGLES], setpoint[SETPOINT_ANGLES + 1], setpoint[SETPOINT_ANGLES + 2]),
            p,
            wanted_rates,
        )
        for k in range(3):
            wanted_rates[k] += setpoint[SETPOINT_RATES + k] + r[6 + k] * setpoint[SETPOINT_YAW_RATE]
        _limit_rates(p, wanted_rates)
        return _given_or(setpoint[SETPOINT_THRUST], mass * GRAVITY / max(r[8], math.cos(p[g.MAX_TILT])))

    vx = r[0] * measurement[4] + r[1] * measurement[5] + r[2] * measurement[6]
    vy = r[3] * measurement[4] + r[4] * measurement[5] + r[5] * measurement[6]
    vz = r[6] * measurement[4] + r[7] * measurement[5] + r[8] * measurement[6]
    wx, wy, wz = setpoint[SETPOINT_VELOCITY], setpoint[SETPOINT_VELOCITY + 1], setpoint[SETPOINT_VELOCITY + 2]
    if kind == POSITION_SETPOINT:
        ex, ey, ez = (
            setpoint[SETPOINT_POSITION] - measurement[10],
            setpoint[SETPOINT_POSITION + 1] - measurement[11],
            setpoint[SETPOINT_POSITION + 2] - measurement[12],
        )
        near = _limit_approach_gain(
            math.sqrt(ex * ex + ey * ey), p[g.POSITION_GAIN], _BRAKING_SHARE * p[g.MAX_ACCELERATION], p[g.MAX_SPEED]
        )
        climb = _limit_approach_gain(abs(ez), p[g.POSITION_GAIN], _BRAKING_SHARE * GRAVITY, p[g.MAX_CLIMB])
        wx, wy, wz = wx + near * ex, wy + near * ey, wz + climb * ez
    ex, ey, ez = wx - vx, wy - vy, wz - vz
    fx, fy, fz = (
        setpoint[SETPOINT_ACCELERATION],
        setpoint[SETPOINT_ACCELERATION + 1],
        setpoint[SETPOINT_ACCELERATION + 2],
    )
    ax, ay = _limit_length(
        fx + p[g.VELOCITY_GAIN] * ex + memory[VELOCITY_INTEGRAL],
        fy + p[g.VELOCITY_GAIN] * ey + memory[VELOCITY_INTEGRAL + 1],
        p[g.MAX_ACCELERATION],
    )
    most = 0.7 * GRAVITY
    az = min(max(fz + p[g.VELOCITY_GAIN] * ez + memory[VELOCITY_INTEGRAL + 2], -p[g.MAX_ACCELERATION]), most)
    # thrust per mass; at least a fifth of the weight upwards, and no more tilt than allowed
    sz = min(az - GRAVITY - dz, -0.2 * GRAVITY)
    wide_x, wide_y = ax - dx, ay - dy
    sx, sy = _limit_length(wide_x, wide_y, -sz * p[g.MAX_TILT_TANGENT])
    turn_towards(r, attitude_of_thrust(sx, sy, sz, setpoint[SETPOINT_ANGLES + 2]), p, wanted_rates)

    # feedforward rates of the feedforward acceleration and heading
    size = math.sqrt(sx * sx + sy * sy + sz * sz)
    jx, jy, jz = (
        (fx - memory[LAST_ACCELERATION]) / dt,
        (fy - memory[LAST_ACCELERATION + 1]) / dt,
        (fz - memory[LAST_ACCELERATION + 2]) / dt,
    )
    smooth = jx * jx + jy * jy + jz * jz < _MAX_JERK * _MAX_JERK
    wanted_rates[0] += choose(smooth, (r[1] * jx + r[4] * jy + r[7] * jz) / size, 0.0)
    wanted_rates[1] -= choose(smooth, (r[0] * jx + r[3] * jy + r[6] * jz) / size, 0.0)
    for k in range(3):
        memory[LAST_ACCELERATION + k] = setpoint[SETPOINT_ACCELERATION + k]
        wanted_rates[k] += r[6 + k] * setpoint[SETPOINT_YAW_RATE]
    _limit_rates(p, wanted_rates)

    # anti-windup: integrals stop at a limit; large errors belong to a manoeuvre and are limited
    gain = p[g.VELOCITY_INTEGRAL_GAIN] * dt
    if any_lane(gain > 0.0):
        inside = (sx == wide_x) & (sy == wide_y)
        level = inside | (ex * wide_x + ey * wide_y < 0.0)
        ex, ey = _limit_length(ex, ey, _MAX_INTEGRATED_ERROR)
        old_x, old_y, old_z = (
            memory[VELOCITY_INTEGRAL], memory[VELOCITY_INTEGRAL + 1], memory[VELOCITY_INTEGRAL + 2]
        )  # fmt: skip
        x, y = _limit_length(old_x + gain * ex, old_y + gain * ey, p[g.MAX_INTEGRAL])
        memory[VELOCITY_INTEGRAL] = choose(level, x, old_x)
        memory[VELOCITY_INTEGRAL + 1] = choose(level, y, old_y)
        vertical = ((sz < -0.2 * GRAVITY) | (ez < 0.0)) & (memory[CONTROLLER_STATUS] != SATURATED)
        z = old_z + gain * min(max(ez, -_MAX_INTEGRATED_ERROR), _MAX_INTEGRATED_ERROR)
        memory[VELOCITY_INTEGRAL + 2] = choose(vertical, min(max(z, -p[g.MAX_INTEGRAL]), p[g.MAX_INTEGRAL]), old_z)
    # thrust along the present axis only, so that none acts sideways while the body still turns
    return max(-mass * (sx * r[2] + sy * r[5] + sz * r[8]), 0.0)


@njit(cache=True, error_model="numpy")
def _limit_rates(p, wanted_rates):
    wanted_rates[0], wanted_rates[1] = _limit_length(wanted_rates[0], wanted_rates[1], p[g.MAX_TILT_RATE])
    wanted_rates[2] = min(max(wanted_rates[2], -p[g.MAX_YAW_RATE]), p[g.MAX_YAW_RATE])
