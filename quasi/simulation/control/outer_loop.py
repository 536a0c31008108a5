"""From a goal to wanted body rates and thrust: the position, velocity and attitude loops that all controllers share.

    v_wish = v_ref + (x_ref - x)/T_x,  a_wish = a_ref + (v_wish - v)/T_v + integral
    thrust vector per mass: s = a_wish - g - d,  d the acceleration that is not the thrust's

d is nothing for PID (its integral finds it), the model's for NDI, the measured one for INDI, which is the increment of
Smeur, de Croon, Chu, Cascaded incremental nonlinear dynamic inversion for MAV disturbance rejection, Control
Engineering Practice 73, 2018, written for the whole vector. Attitude errors are split in tilt and yaw, tilt first:
Brescianini, D'Andrea, Tilt-prioritized quadrocopter attitude control, IEEE T-CST 28(2), 2020.

Goal (20,): kind; x y z (m, earth); vx vy vz (m/s, earth); roll pitch yaw (rad); p q r (rad/s); thrust (N, upwards in
the body; NaN carries the weight); yaw rate (rad/s, about the vertical); ax ay az (m/s2, earth, fed forward).
"""

import math

from numba import njit

from quasi.attitude import GRAVITY
from quasi.simulation.control import gains as g

GOAL = 20
POSITION_GOAL, VELOCITY_GOAL, ATTITUDE_GOAL, RATES_GOAL = 0.0, 1.0, 2.0, 3.0
KIND, PLACE, SPEED, ANGLES, RATES, THRUST, YAW_RATE, FORWARD = 0, 1, 4, 7, 10, 13, 14, 15

# places in the memory that belong to these loops; see controllers.py for the others. STARTED holds 0 before the first
# step, then RUNNING, or SATURATED where the last step's commands met a limit of the rotors
STARTED, RUNNING, SATURATED = 0, 1.0, 2.0
INTEGRAL, LAST_FORWARD, WISH = 49, 55, 168
_BRAKE = 0.4  # share of the greatest acceleration (vertically: of gravity's) that is counted on to stop
_SLIGHT = 0.4  # m/s, greatest error of velocity that an integral counts
_JERK = 80.0  # m/s3; beyond it a change of the fed forward acceleration is a jump, which has no rate


@njit(cache=True, error_model="numpy")
def rotation(q):
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
    # the shortest way that carries the body's z axis onto the wanted one
    sine = math.sqrt(nx * nx + ny * ny)
    if sine > 1e-9:
        factor = math.atan2(sine, nz) / sine
        out[0], out[1] = -parameters[g.ATTITUDE] * factor * ny, parameters[g.ATTITUDE] * factor * nx
    else:
        # upside down: any axis will do
        out[0], out[1] = (0.0 if nz > 0.0 else parameters[g.ATTITUDE] * math.pi), 0.0
    # what is left then is a turn about z (swing and twist of the error's quaternion)
    out[2] = parameters[g.YAW] * math.atan2(e10 - e01, e00 + e11)


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
def _shorten(x, y, most):
    size = math.sqrt(x * x + y * y)
    return (x, y) if size <= most else (x * most / size, y * most / size)


@njit(cache=True, error_model="numpy")
def _approach(distance, gain, brake, most):
    """Wanted speed per distance, 1/s: the gain when near; when far no more than can be braked, nor than `most`, m/s."""
    linear = brake / (gain * gain)
    speed = gain * distance if distance <= linear else math.sqrt(2.0 * brake * distance - brake * linear)
    return min(speed, most) / distance if distance > 0.0 else gain


@njit(cache=True, error_model="numpy")
def outer_loop(parameters, memory, dt, seen, goal, dx, dy, dz):
    """Wanted body rates into memory[WISH:WISH+3], rad/s; returns the wanted thrust, N, upwards in the body.

    dx dy dz: acceleration that is neither gravity nor thrust, m/s2, earth axes.
    """
    p, wish = parameters, memory[WISH : WISH + 3]
    kind, mass = goal[KIND], p[g.MASS]
    if kind == RATES_GOAL:
        for k in range(3):
            wish[k] = goal[RATES + k]
        return goal[THRUST] if goal[THRUST] == goal[THRUST] else mass * GRAVITY
    r = rotation(seen)
    if kind == ATTITUDE_GOAL:
        turn_towards(r, attitude_of_angles(goal[ANGLES], goal[ANGLES + 1], goal[ANGLES + 2]), p, wish)
        for k in range(3):
            wish[k] += goal[RATES + k] + r[6 + k] * goal[YAW_RATE]
        _limit_rates(p, wish)
        if goal[THRUST] == goal[THRUST]:
            return goal[THRUST]
        return mass * GRAVITY / max(r[8], math.cos(p[g.TILT]))

    vx = r[0] * seen[4] + r[1] * seen[5] + r[2] * seen[6]
    vy = r[3] * seen[4] + r[4] * seen[5] + r[5] * seen[6]
    vz = r[6] * seen[4] + r[7] * seen[5] + r[8] * seen[6]
    wx, wy, wz = goal[SPEED], goal[SPEED + 1], goal[SPEED + 2]
    if kind == POSITION_GOAL:
        ex, ey, ez = goal[PLACE] - seen[10], goal[PLACE + 1] - seen[11], goal[PLACE + 2] - seen[12]
        near = _approach(math.sqrt(ex * ex + ey * ey), p[g.POSITION], _BRAKE * p[g.ACCELERATION], p[g.SPEED])
        climb = _approach(abs(ez), p[g.POSITION], _BRAKE * GRAVITY, p[g.CLIMB])
        wx, wy, wz = wx + near * ex, wy + near * ey, wz + climb * ez
    ex, ey, ez = wx - vx, wy - vy, wz - vz
    fx, fy, fz = goal[FORWARD], goal[FORWARD + 1], goal[FORWARD + 2]
    ax, ay = _shorten(
        fx + p[g.VELOCITY] * ex + memory[INTEGRAL], fy + p[g.VELOCITY] * ey + memory[INTEGRAL + 1], p[g.ACCELERATION]
    )
    most = 0.7 * GRAVITY
    az = min(max(fz + p[g.VELOCITY] * ez + memory[INTEGRAL + 2], -p[g.ACCELERATION]), most)
    # thrust per mass; at least a fifth of the weight upwards, and no more tilt than allowed
    sz = min(az - GRAVITY - dz, -0.2 * GRAVITY)
    wide_x, wide_y = ax - dx, ay - dy
    sx, sy = _shorten(wide_x, wide_y, -sz * p[g.SLOPE])
    turn_towards(r, attitude_of_thrust(sx, sy, sz, goal[ANGLES + 2]), p, wish)

    # rates that the fed forward acceleration and heading ask for by themselves
    size = math.sqrt(sx * sx + sy * sy + sz * sz)
    jx, jy, jz = (
        (fx - memory[LAST_FORWARD]) / dt,
        (fy - memory[LAST_FORWARD + 1]) / dt,
        (fz - memory[LAST_FORWARD + 2]) / dt,
    )
    if jx * jx + jy * jy + jz * jz < _JERK * _JERK:
        wish[0] += (r[1] * jx + r[4] * jy + r[7] * jz) / size
        wish[1] -= (r[0] * jx + r[3] * jy + r[6] * jz) / size
    for k in range(3):
        memory[LAST_FORWARD + k] = goal[FORWARD + k]
        wish[k] += r[6 + k] * goal[YAW_RATE]
    _limit_rates(p, wish)

    # integrals stand still where more of them would only push further against a limit, and count large errors, which
    # are those of a manoeuvre, as small ones
    gain = p[g.VELOCITY_INTEGRAL] * dt
    if gain > 0.0:
        inside = sx == wide_x and sy == wide_y
        if inside or ex * wide_x + ey * wide_y < 0.0:
            ex, ey = _shorten(ex, ey, _SLIGHT)
            x, y = _shorten(memory[INTEGRAL] + gain * ex, memory[INTEGRAL + 1] + gain * ey, p[g.INTEGRAL])
            memory[INTEGRAL], memory[INTEGRAL + 1] = x, y
        if (sz < -0.2 * GRAVITY or ez < 0.0) and memory[STARTED] != SATURATED:
            z = memory[INTEGRAL + 2] + gain * min(max(ez, -_SLIGHT), _SLIGHT)
            memory[INTEGRAL + 2] = min(max(z, -p[g.INTEGRAL]), p[g.INTEGRAL])
    # thrust along the present axis only: none of it is spent sideways while the body still turns
    return max(-mass * (sx * r[2] + sy * r[5] + sz * r[8]), 0.0)


@njit(cache=True, error_model="numpy")
def _limit_rates(p, wish):
    wish[0], wish[1] = _shorten(wish[0], wish[1], p[g.RATE])
    wish[2] = min(max(wish[2], -p[g.YAW_RATE]), p[g.YAW_RATE])
