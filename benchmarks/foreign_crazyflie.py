"""Flights of RotorPy's Crazyflie, a vehicle of 30 g: `foreign_rotorpy` with other parameters."""

import copy
from typing import Any

import foreign_rotorpy
from foreign_flights import Motion, Vehicle
from foreign_pilot import Course

ALWAYS = foreign_rotorpy.ALWAYS
SENSORS: dict[str, Any] = {"hover": 1790.0}  # rad/s: sqrt(m g / 4 k_eta)
RADIUS = 0.0225  # m, of its propellers of 45 mm


def parameters() -> dict[str, Any]:
    """RotorPy's Crazyflie with a motor of 20 ms, and a body drag that its parameters lack."""
    from rotorpy.vehicles.crazyflie_params import quad_params

    drag = dict.fromkeys(("c_Dx", "c_Dy", "c_Dz"), 5e-4)  # N s2/m2: of a plate of 8 cm2
    return {**copy.deepcopy(quad_params), "tau_m": 0.02, "rotor_radius": RADIUS, **drag}


def vehicle() -> Vehicle:
    """What the lab writes down about it."""
    return foreign_rotorpy.written_down("Crazyflie", parameters())


def fly(course: Course, **changes: Any) -> Motion:
    """One flight, see `foreign_rotorpy.fly`."""
    return foreign_rotorpy.fly(course, **changes, of=parameters)
