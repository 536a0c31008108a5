"""The flying controller of made flights: position, attitude and rate loops on sensed signals, and a motor mixer.

It plays the pilot's and the flight controller's part; its structure is no part of what is identified.
Axes and signs as in physics.py. Kernels only.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi_synthesis.vehicle import Vehicle, hover_factors


class Control(NamedTuple):
    """Gains, and what the controller believes of the vehicle."""

    mass: float
    inertia: np.ndarray  # (3,) kg m2
    hubs: np.ndarray  # (4, 2) m
    spin: np.ndarray  # (4,)
    thrust_factor: float  # N s2
    torque_per_thrust: float  # m
    idle_speed: float
    max_speed: float
    curvature: float
    position: float = 6.0  # 1/s2
    velocity: float = 4.5  # 1/s
    velocity_integral: float = 3.0  # 1/s2
    attitude: float = 8.0  # 1/s
    rate: np.ndarray = np.array([30.0, 28.0, 14.0])  # (3,) 1/s
    rate_integral: float = 60.0  # 1/s2
    rate_forward: float = 0.5  # share of the wanted rate's derivative fed forward
    tilt_limit: float = math.radians(62.0)  # rad
    rate_limit: float = 9.0  # rad/s


def control_of(vehicle: Vehicle) -> Control:
    """A controller tuned for the vehicle as configured."""
    physics, drive = vehicle.physics, vehicle.drive
    factors = hover_factors(physics)
    return Control(
        mass=physics.mass,
        inertia=np.diag(physics.inertia).copy(),
        hubs=physics.hubs[:, :2].copy(),
        spin=physics.spin.copy(),
        thrust_factor=factors["thrust"],
        torque_per_thrust=factors["torque"] / factors["thrust"],
        idle_speed=drive.idle_speed,
        max_speed=drive.max_speed,
        curvature=drive.curvature,
    )


@njit(cache=True, error_model="numpy")
def command_for(speed, idle, top, curvature):
    """Command 0..1 whose steady speed at reference voltage is `speed`; inverse of `steady_speed`."""
    share = min(max((speed - idle) / (top - idle), 0.0), 1.0)
    b = 1.0 + curvature
    return (b - math.sqrt(b * b - 4.0 * curvature * share)) / (2.0 * curvature)


@njit(cache=True, error_model="numpy")
def steady_speed(command, idle, top, curvature):
    """Steady rotor speed, rad/s, of a command 0..1 at reference voltage: concave, as motors with drag are."""
    return idle + (top - idle) * command * (1.0 + curvature * (1.0 - command))


@njit(cache=True, error_model="numpy")
def outer_loop(ref, position, velocity, quaternion, integral, dt, c: Control, rates):
    """Wanted body rates (filled into rates (3,), rad/s) and collective thrust, N, returned.

    ref (16,) row of the pilot's table; position, velocity earth; integral (3,) m/s2 is updated.
    """
    wish = np.empty(3)
    for k in range(3):
        error_v = ref[3 + k] - velocity[k]
        error_p = min(max(ref[k] - position[k], -1.5), 1.5)
        integral[k] = min(max(integral[k] + c.velocity_integral * error_p * dt, -4.0), 4.0)
        wish[k] = ref[6 + k] + c.position * error_p + c.velocity * error_v + integral[k]
    # force wanted per mass, without gravity, pointing up: -(a - g)
    up = max(GRAVITY - wish[2], 2.0)
    plane = math.sqrt(wish[0] ** 2 + wish[1] ** 2)
    top = up * math.tan(c.tilt_limit)
    if plane > top:
        wish[0] *= top / plane
        wish[1] *= top / plane
    norm = math.sqrt(wish[0] ** 2 + wish[1] ** 2 + up * up)
    zx, zy, zz = -wish[0] / norm, -wish[1] / norm, up / norm  # wanted body z axis (down) in earth axes
    # wanted attitude: yaw first, then the shortest tilt that carries earth z onto the wanted z
    half = 0.5 * ref[9]
    cy, sy = math.cos(half), math.sin(half)
    tw = math.sqrt(max(0.5 * (1.0 + zz), 1e-6))
    tx, ty = -zy / (2.0 * tw), zx / (2.0 * tw)
    dw, dx, dy, dz = tw * cy, tx * cy + ty * sy, ty * cy - tx * sy, tw * sy
    q = quaternion
    ew = q[0] * dw + q[1] * dx + q[2] * dy + q[3] * dz
    ex = q[0] * dx - q[1] * dw - q[2] * dz + q[3] * dy
    ey = q[0] * dy + q[1] * dz - q[2] * dw - q[3] * dx
    ez = q[0] * dz - q[1] * dy + q[2] * dx - q[3] * dw
    sign = 2.0 if ew >= 0.0 else -2.0
    rates[0] = c.attitude * sign * ex
    rates[1] = c.attitude * sign * ey
    rates[2] = 0.5 * c.attitude * sign * ez + ref[10] * zz
    for k in range(3):
        rates[k] = min(max(rates[k], -c.rate_limit), c.rate_limit)
    # along the present thrust axis only
    bz_x = 2.0 * (q[1] * q[3] + q[0] * q[2])
    bz_y = 2.0 * (q[2] * q[3] - q[0] * q[1])
    bz_z = 1.0 - 2.0 * (q[1] ** 2 + q[2] ** 2)
    return c.mass * max(-wish[0] * bz_x - wish[1] * bz_y + up * bz_z, 0.15 * GRAVITY)


@njit(cache=True, error_model="numpy")
def rate_loop(wanted, rates, forward, integral, dt, c: Control, terms):
    """Wanted moments, N m, as P, I and feed-forward terms (3, 3) in `terms`; integral (3,) rad is updated."""
    for k in range(3):
        error = wanted[k] - rates[k]
        integral[k] = min(max(integral[k] + error * dt, -0.6), 0.6)
        terms[0, k] = c.inertia[k] * c.rate[k] * error
        terms[1, k] = c.inertia[k] * c.rate_integral * integral[k]
        terms[2, k] = c.inertia[k] * c.rate_forward * min(max(forward[k], -250.0), 250.0)


@njit(cache=True, error_model="numpy")
def mix(collective, terms, limit, c: Control, commands):
    """Motor commands (4,), 0..limit, for a collective thrust, N, and the moments' terms (3, 3), N m.

    A left rotor rolls right, a front rotor pitches up, a clockwise rotor yaws left: the inverse of M = r x F.
    When a rotor would leave its range the collective gives way first, as flight controllers do ("air mode").
    """
    roll = terms[0, 0] + terms[1, 0] + terms[2, 0]
    pitch = terms[0, 1] + terms[1, 1] + terms[2, 1]
    yaw = terms[0, 2] + terms[1, 2] + terms[2, 2]
    most = c.thrust_factor * (0.97 * c.max_speed) ** 2
    least = c.thrust_factor * (1.15 * c.idle_speed) ** 2
    room = 0.35 * collective * c.torque_per_thrust + 0.004
    yaw = min(max(yaw, -room), room)
    low, high = 1e9, -1e9
    for i in range(4):
        x, y = c.hubs[i, 0], c.hubs[i, 1]
        commands[i] = -roll / (4.0 * y) + pitch / (4.0 * x) - c.spin[i] * yaw / (4.0 * c.torque_per_thrust)
        low, high = min(low, commands[i]), max(high, commands[i])
    share = 1.0
    if high - low > most - least:
        share = (most - least) / (high - low)
    base = 0.25 * collective
    base = min(base, most - share * high)
    base = max(base, least - share * low)
    for i in range(4):
        speed = math.sqrt(max(base + share * commands[i], 0.0) / c.thrust_factor)
        commands[i] = min(command_for(speed, c.idle_speed, c.max_speed, c.curvature), limit)
