"""A made-up 3-inch quadrotor of 0.43 kg: its true physical constants.

Frames and units as everywhere: body x forward, y right, z down, SI, mechanical rad/s, spin +1 = clockwise from above.
The figures are plausible for the class (4S, 3-inch three-blade propellers); none belongs to a real vehicle.
"""

import math
from typing import NamedTuple

import numpy as np

from quasi.attitude import AIR_DENSITY, GRAVITY

BASE_HOVER_SPEED = 2100.0  # rad/s, 20,000 rpm: a 3-inch propeller that carries 1.06 N
POLES = 14
REFERENCE_VOLTAGE = 15.2  # V, at which the command map holds


BASE_MASS = 0.433
BASE_INERTIA = np.diag([8.65e-4, 1.07e-3, 1.71e-3])
RADIUS = 0.0381
ARM = 0.077
HUB_HEIGHT = 0.012  # m above the cg
ROTOR_CONFIG = {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3}
ROTOR_1 = "CW"
MARKER_OFFSET = np.array([0.0, -0.01, -0.048])


def _place_hubs() -> np.ndarray:
    """Hubs (4, 3), m, body axes, of the four rotors."""
    half = ARM / math.sqrt(2.0)
    places = {"front left": (1, -1), "front right": (1, 1), "aft right": (-1, 1), "aft left": (-1, -1)}
    hubs = np.zeros((4, 3))
    for place, number in ROTOR_CONFIG.items():
        front, right = places[place]
        hubs[number - 1] = front * half, right * half, -HUB_HEIGHT
    return hubs


def blade_pitch(
    thrust: float, speed: float, radius: float, density: float, solidity: float, lift_slope: float
) -> float:
    """Blade angle, rad, at which one hovering rotor makes `thrust` N at `speed` rad/s by blade-element momentum theory.

    Source: Leishman, Principles of Helicopter Aerodynamics, 2nd ed., 2006, equation 3.75 with uniform inflow.
    """
    area = math.pi * radius**2
    induced = math.sqrt(thrust / (2.0 * density * area))
    gain = 0.25 * density * lift_slope * solidity * area * speed * radius
    return 1.5 * (thrust / gain + induced) / (speed * radius)


HUBS = _place_hubs()
# rotor 1 clockwise, its diagonal neighbour alike, the other two against them
SPIN = np.where(HUBS[:, 0] * HUBS[:, 1] * HUBS[0, 0] * HUBS[0, 1] > 0, 1.0, -1.0)
SOLIDITY, LIFT_SLOPE = 0.276, 5.0
BLADE_PITCH = blade_pitch(BASE_MASS * GRAVITY / 4.0, BASE_HOVER_SPEED, RADIUS, AIR_DENSITY, SOLIDITY, LIFT_SLOPE)


class Physics(NamedTuple):
    """What the equations of motion need; arrays are float64. Passed whole to the compiled kernel."""

    mass: float = BASE_MASS  # kg
    inertia: np.ndarray = BASE_INERTIA  # (3, 3) kg m2 about the true cg
    inverse_inertia: np.ndarray = np.linalg.inv(BASE_INERTIA)  # (3, 3)
    hubs: np.ndarray = HUBS  # (4, 3) m from the true cg, body axes
    thrust_axis: np.ndarray = np.tile([0.0, 0.0, -1.0], (4, 1))  # (4, 3) unit vectors along positive thrust, body axes
    spin: np.ndarray = SPIN  # (4,) +1 clockwise from above
    radius: float = RADIUS  # m
    density: float = AIR_DENSITY  # kg/m3
    solidity: float = SOLIDITY  # blade area / disc area
    lift_slope: float = LIFT_SLOPE  # 1/rad
    pitch: float = BLADE_PITCH  # rad, mean blade angle from zero lift
    profile_drag: float = 0.05  # mean drag coefficient of the blade section
    induced_factor: float = 1.15  # induced power above the ideal
    inflow_lag: float = 0.007  # s, of the induced velocity behind its equilibrium
    vortex_depth: float = 0.3  # share of thrust lost in vertical descent at the induced speed of hover
    vortex_buffet: float = 0.9  # standard deviation of the thrust lost to the vortex ring, as a share of its mean
    h_force: float = 1.5e-5  # N s2/(m rad), in-plane drag per rotor speed and airspeed
    disc_tilt: float = 0.8  # rad per advance ratio, backward tilt of the thrust by flapping
    flapping_moment: float = 7.0e-8  # N m s2/(m rad), hub moment per rotor speed and airspeed
    flapping_damping: float = 2.0e-8  # N m s2/rad2, hub moment per rotor speed and body rate
    interference: float = 0.06  # thrust share a rotor straight downstream of the cg loses at high speed
    body_drag: np.ndarray = np.array([0.004, 0.005, 0.009])  # (3,) N s2/m2, force -c_k |V| V_k
    body_lift: float = 0.009  # N s2/m2, upward force k |V| u of the canopy, which is not the same fore and aft
    drag_centre: np.ndarray = np.array([0.0, 0.0, -0.004])  # (3,) m, where it acts, from the true cg
    rotor_inertia: float = 7.0e-7  # kg m2, as felt through rotor acceleration
    gyroscopic_inertia: float = (
        7.0e-7  # kg m2, as felt through rotor angular momentum; the same but for a planted effect
    )
    thrust_gain: np.ndarray = np.ones(4)  # (4,) 1 = healthy
    thrust_drift: float = 0.0  # 1/s
    thrust_per_speed: float = 0.0  # N s/rad added per rotor
    thrust_constant: float = 0.0  # N added per turning rotor
    thrust_exponent: float = 2.0  # of thrust over rotor speed; any but 2 is applied about BASE_HOVER_SPEED
    axial_gain: float = 0.0  # N s2/(m rad), extra thrust change -k W V_climb per rotor
    translational_gain: float = 0.0  # N s2/m2, extra thrust k (u2 + v2) of all rotors, by the flow at each hub
    ground_gain: float = 0.0  # c of T/T0 = 1/(1 - c (R/4z)^2)
    proximity_gain: float = 0.0  # share of thrust lost at a wall of the room
    room: np.ndarray = np.array([5.0, 5.0, 5.0])  # (3,) m, half length north, half length east, height
    wind: np.ndarray = np.zeros(3)  # (3,) m/s, velocity of the air, earth NED
    tether: float = 0.0  # N/m, spring to the origin of the floor
    load_mass: float = 0.0  # kg, hung from the cg
    load_length: float = 0.5  # m
    lag_up: float = 0.022  # s, motor lag when speeding up
    lag_down: float = 0.030  # s, motor lag when slowing down
    leg: np.ndarray = np.array([0.06, 0.06, 0.03])  # (3,) m, |x|, |y| and z of the four feet from the true cg
    unlisted: np.ndarray = np.zeros(7)  # (7,) sizes of what belongs to no known cause, see `quasi_synthesis.physics`


class Drive(NamedTuple):
    """Motors, speed controllers and battery."""

    idle_speed: float = 370.0  # rad/s at command 0
    max_speed: float = 3700.0  # rad/s at command 1 and reference voltage
    curvature: float = 0.35  # of the command map
    sag_exponent: float = 1.0  # steady speed ~ (V / reference)^exponent
    command_delay: float = 0.0  # s
    command_limit: float = 1.0  # the most the output stage lets through, of 0..1
    efficiency: float = 0.72  # shaft power / electric power
    resistance: float = 0.035  # ohm, battery and leads
    capacity: float = 0.85 * 3600.0  # A s
    charge: float = 0.85 * 3600.0 * 0.97  # A s left at the start
    cells: float = 4.0
    reference_voltage: float = REFERENCE_VOLTAGE  # V


class Vehicle(NamedTuple):
    """The truth of one flight's vehicle, before sensors."""

    physics: Physics = Physics()
    drive: Drive = Drive()
    cg_offset: np.ndarray = np.zeros(3)  # (3,) m, true minus configured cg


def base_vehicle() -> Vehicle:
    """The vehicle as its maker meant it: no flight-to-flight variation, no effect beyond its honest aerodynamics."""
    return Vehicle()


def hover_factors(physics: Physics, gain: float = 1.0) -> dict[str, float]:
    """Thrust and torque of one hovering rotor over its speed squared: dT/d(W2), N s2, and dQ/d(W2), N m s2.

    gain  of its thrust, 1 for a healthy one: induced power falls with the thrust, profile power stays
    In hover every speed in blade-element momentum theory is in proportion to W, so both are exactly ~ W2.
    """
    area = math.pi * physics.radius**2
    # T = slope W (top W - v)
    slope = 0.25 * physics.density * physics.lift_slope * physics.solidity * area * physics.radius
    top = 2.0 / 3.0 * physics.pitch * physics.radius
    # v = x W: 2 rho A x2 = slope (top - x)
    a = 2.0 * physics.density * area
    x = (-slope + math.sqrt(slope**2 + 4.0 * a * slope * top)) / (2.0 * a)
    thrust = a * x**2
    profile = 0.125 * physics.density * physics.solidity * physics.profile_drag * area * physics.radius**3
    return {"thrust": gain * thrust, "torque": profile + gain * physics.induced_factor * thrust * x}
