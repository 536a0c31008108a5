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


class Physics(NamedTuple):
    """What the equations of motion need; arrays are float64. Passed whole to the compiled kernel."""

    mass: float  # kg
    inertia: np.ndarray  # (3, 3) kg m2 about the true cg
    inverse_inertia: np.ndarray  # (3, 3)
    hubs: np.ndarray  # (4, 3) m from the true cg, body axes
    thrust_axis: np.ndarray  # (4, 3) unit vectors along positive thrust, body axes
    spin: np.ndarray  # (4,) +1 clockwise from above
    radius: float  # m
    density: float  # kg/m3
    solidity: float  # blade area / disc area
    lift_slope: float  # 1/rad
    pitch: float  # rad, mean blade angle from zero lift
    profile_drag: float  # mean drag coefficient of the blade section
    induced_factor: float  # induced power above the ideal
    inflow_lag: float  # s, of the induced velocity behind its equilibrium
    vortex_depth: float  # share of thrust lost in vertical descent at the induced speed of hover
    vortex_buffet: float  # standard deviation of the thrust lost to the vortex ring, as a share of its mean
    h_force: float  # N s2/(m rad), in-plane drag per rotor speed and airspeed
    disc_tilt: float  # rad per advance ratio, backward tilt of the thrust by flapping
    flapping_moment: float  # N m s2/(m rad), hub moment per rotor speed and airspeed
    flapping_damping: float  # N m s2/rad2, hub moment per rotor speed and body rate
    interference: float  # thrust share a rotor straight downstream of the cg loses at high speed
    body_drag: np.ndarray  # (3,) N s2/m2, force -c_k |V| V_k
    body_lift: float  # N s2/m2, upward force k |V| u of the canopy, which is not the same fore and aft
    drag_centre: np.ndarray  # (3,) m, where it acts, from the true cg
    rotor_inertia: float  # kg m2, as felt through rotor acceleration
    gyroscopic_inertia: float  # kg m2, as felt through rotor angular momentum; the same but for a planted effect
    thrust_gain: np.ndarray  # (4,) 1 = healthy
    thrust_drift: float  # 1/s
    thrust_per_speed: float  # N s/rad added per rotor
    thrust_constant: float  # N added per turning rotor
    thrust_exponent: float  # of thrust over rotor speed; any but 2 is applied about HOVER_SPEED
    axial_gain: float  # N s2/(m rad), extra thrust change -k W V_climb per rotor
    translational_gain: float  # N s2/m2, extra lift k (u2 + v2)
    ground_gain: float  # c of T/T0 = 1/(1 - c (R/4z)^2)
    proximity_gain: float  # share of thrust lost at a wall of the room
    room: np.ndarray  # (3,) m, half length north, half length east, height
    wind: np.ndarray  # (3,) m/s, velocity of the air, earth NED
    tether: float  # N/m, spring to the origin of the floor
    load_mass: float  # kg, hung from the cg
    load_length: float  # m
    lag_up: float  # s, motor lag when speeding up
    lag_down: float  # s, motor lag when slowing down
    leg: np.ndarray  # (3,) m, |x|, |y| and z of the four feet from the true cg
    unlisted: np.ndarray  # (7,) sizes of what belongs to no known cause, see `quasi.synthesis.physics`


class Drive(NamedTuple):
    """Motors, speed controllers and battery."""

    idle_speed: float  # rad/s at command 0
    max_speed: float  # rad/s at command 1 and reference voltage
    curvature: float  # of the command map
    sag_exponent: float  # steady speed ~ (V / reference)^exponent
    command_delay: float  # s
    command_limit: float  # the most the output stage lets through, of 0..1
    efficiency: float  # shaft power / electric power
    resistance: float  # ohm, battery and leads
    capacity: float  # A s
    charge: float  # A s left at the start
    cells: float
    reference_voltage: float  # V


class Vehicle(NamedTuple):
    """The truth of one flight's vehicle, before sensors."""

    physics: Physics
    drive: Drive
    cg_offset: np.ndarray  # (3,) m, true minus configured cg


BASE_MASS = 0.433
BASE_INERTIA = np.diag([8.65e-4, 1.07e-3, 1.71e-3])
RADIUS = 0.0381
ARM = 0.077
HUB_HEIGHT = 0.012  # m above the cg
ROTOR_CONFIG = {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3}
ROTOR_1 = "CW"
MARKER_OFFSET = np.array([0.0, -0.01, -0.048])


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


def base_vehicle() -> Vehicle:
    """The vehicle as its maker meant it: no flight-to-flight variation, no effect beyond its honest aerodynamics."""
    half = ARM / math.sqrt(2.0)
    places = {"front left": (1, -1), "front right": (1, 1), "aft right": (-1, 1), "aft left": (-1, -1)}
    hubs = np.zeros((4, 3))
    for place, number in ROTOR_CONFIG.items():
        front, right = places[place]
        hubs[number - 1] = front * half, right * half, -HUB_HEIGHT
    # rotor 1 clockwise, its diagonal neighbour alike, the other two against them
    spin = np.where(hubs[:, 0] * hubs[:, 1] * hubs[0, 0] * hubs[0, 1] > 0, 1.0, -1.0)
    solidity, lift_slope = 0.276, 5.0
    physics = Physics(
        mass=BASE_MASS,
        inertia=BASE_INERTIA.copy(),
        inverse_inertia=np.linalg.inv(BASE_INERTIA),
        hubs=hubs,
        thrust_axis=np.tile([0.0, 0.0, -1.0], (4, 1)),
        spin=spin,
        radius=RADIUS,
        density=AIR_DENSITY,
        solidity=solidity,
        lift_slope=lift_slope,
        pitch=blade_pitch(BASE_MASS * GRAVITY / 4.0, BASE_HOVER_SPEED, RADIUS, AIR_DENSITY, solidity, lift_slope),
        profile_drag=0.05,
        induced_factor=1.15,
        inflow_lag=0.007,
        vortex_depth=0.3,
        vortex_buffet=0.9,
        h_force=1.5e-5,
        disc_tilt=0.8,
        flapping_moment=7.0e-8,
        flapping_damping=2.0e-8,
        interference=0.06,
        body_drag=np.array([0.004, 0.005, 0.009]),
        body_lift=0.009,
        drag_centre=np.array([0.0, 0.0, -0.004]),
        rotor_inertia=7.0e-7,
        gyroscopic_inertia=7.0e-7,
        thrust_gain=np.ones(4),
        thrust_drift=0.0,
        thrust_per_speed=0.0,
        thrust_constant=0.0,
        thrust_exponent=2.0,
        axial_gain=0.0,
        translational_gain=0.0,
        ground_gain=0.0,
        proximity_gain=0.0,
        room=np.array([5.0, 5.0, 5.0]),
        wind=np.zeros(3),
        tether=0.0,
        load_mass=0.0,
        load_length=0.5,
        lag_up=0.022,
        lag_down=0.030,
        leg=np.array([0.06, 0.06, 0.03]),
        unlisted=np.zeros(7),
    )
    drive = Drive(
        idle_speed=370.0,
        max_speed=3700.0,
        curvature=0.35,
        sag_exponent=1.0,
        command_delay=0.0,
        command_limit=1.0,
        efficiency=0.72,
        resistance=0.035,
        capacity=0.85 * 3600.0,
        charge=0.85 * 3600.0 * 0.97,
        cells=4.0,
        reference_voltage=REFERENCE_VOLTAGE,
    )
    return Vehicle(physics, drive, np.zeros(3))


def hover_factors(physics: Physics) -> dict[str, float]:
    """Thrust and torque of one healthy hovering rotor over its speed squared: dT/d(W2), N s2, and dQ/d(W2), N m s2.

    In hover every speed in blade-element momentum theory is in proportion to W, so both are exactly ~ W2.
    """
    area = math.pi * physics.radius**2
    gain = (
        0.25 * physics.density * physics.lift_slope * physics.solidity * area * physics.radius
    )  # T = gain W (top W - v)
    top = 2.0 / 3.0 * physics.pitch * physics.radius
    # v = x W: 2 rho A x2 = gain (top - x)
    a = 2.0 * physics.density * area
    x = (-gain + math.sqrt(gain**2 + 4.0 * a * gain * top)) / (2.0 * a)
    thrust = a * x**2
    profile = 0.125 * physics.density * physics.solidity * physics.profile_drag * area * physics.radius**3
    return {"thrust": thrust, "torque": profile + physics.induced_factor * thrust * x}
