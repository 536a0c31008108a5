"""Flights of RotorPy's other vehicles: `foreign_rotorpy` with their parameters."""

import copy
import importlib
from functools import partial
from types import SimpleNamespace
from typing import Any

import foreign_rotorpy
import numpy as np
from foreign_flights import GRAVITY

# module of its parameters, and what these lack: propellers as sold with it, m; a body drag that flights can show,
# N s2/m2, of a plate of 8 cm2. Motors of 20 ms in place of 5 ms, or of 50 ms, with which RotorPy's controller
# oscillates
LAG: dict[str, Any] = {"tau_m": 0.02}
PLATE = dict.fromkeys(("c_Dx", "c_Dy", "c_Dz"), 5e-4)
VEHICLES: dict[str, tuple[str, dict[str, Any]]] = {
    "crazyflie": ("crazyflie_params", {**LAG, **PLATE, "rotor_radius": 0.0225}),
    "brushless": ("crazyfliebrushless_params", {**LAG, **PLATE, "rotor_radius": 0.0275}),
    # 1 kg, body drag alone, rotors in PX4's order; at RotorPy's gains its motors hit both stops in every step of yaw
    "sih": (
        "px4_sihsim_quadx_params",
        {**LAG, "rotor_radius": 0.127, "kp_att": np.array([400.0, 400.0, 2.0]), "kd_att": np.array([57.0, 57.0, 1.5])},
    ),
}
TERMS = {"rotor_drag": "k_d", "body_drag": "c_Dx", "axial_inflow": "k_z", "translational_lift": "k_h"}


def of(name: str) -> SimpleNamespace:
    """The vehicle `name` of `VEHICLES`, with the contents of `foreign_rotorpy`."""
    p = parameters(name)
    hover = float(np.sqrt(p["mass"] * GRAVITY / 4 / p["k_eta"]))
    return SimpleNamespace(
        ALWAYS=frozenset(effect for effect, key in TERMS.items() if p[key]),
        SENSORS={"hover": hover},
        parameters=partial(parameters, name),
        vehicle=lambda: foreign_rotorpy.written_down(name.capitalize(), p),
        fly=partial(foreign_rotorpy.fly, of=partial(parameters, name)),
    )


def parameters(name: str) -> dict[str, Any]:
    """RotorPy's parameters of a vehicle, with what they lack."""
    module, further = VEHICLES[name]
    published = importlib.import_module(f"rotorpy.vehicles.{module}").quad_params
    return {**copy.deepcopy(published), **further}
