"""Constants of a closed loop as named numbers, for exports to other simulators.

An export supports the INDI controller, rotors with lag, delay and limits, steady wind and a constant battery voltage.
"""

import math
from typing import Any

import numpy as np

from quasi.errors import ConfigError
from quasi.model.model import Model
from quasi.simulation.control import parameters as g
from quasi.simulation.control.registry import INDI, LAWS
from quasi.simulation.loop.setup import Setup, make_setup
from quasi.simulation.vehicle.dynamics import RK4
from quasi.simulation.vehicle.layout import (
    ADDED_GRAVITY,
    INERTIA,
    INVERSE_INERTIA,
    LAG_DOWN,
    LAG_UP,
    LOADS_OFFSET,
    MASS,
    MAX_ROTOR_ACCELERATION,
    ROTOR_SPEEDS,
    STATE_SIZE,
)
from quasi.simulation.vehicle.sensors_and_wind import GUST_DEVIATION, STEADY_WIND
from quasi.simulation.vehicle.variants import list_part_names, read_payload_and_inflow


def portable_setup(model: Model) -> Setup:
    """Set up the closed loop that is exported with a model: INDI with default gains and the rotors of the model.

    Raises ConfigError or DataError, as `make_setup` does, for a model that cannot be flown. The message names
    the variable that a simulation cannot provide, or the missing axes or mass.
    """
    settings = {
        "model": {"model ID": model.id},
        "simulation": {"time step": 0.004},
        "controller": {"controller": "drone_INDI"},
        "noise": {"add": False},
    }
    return make_setup(settings, model, name=f"closed loop of model {model.id}")


def loop_constants(setup: Setup) -> dict[str, Any]:
    """Return the constants of a closed loop; SI units, body and earth axes as in `dynamics` and `controllers`.

    Raises ConfigError naming what cannot be exported: another controller, noise, gusts, faults, a draining battery.
    """
    loop_parameters = setup.loop_parameters
    _refuse(setup)
    body, gains = loop_parameters.body, loop_parameters.gains
    return {
        "model": setup.model.id,
        "time step": loop_parameters.dt,
        "substeps": loop_parameters.substeps,
        "integrator": "rk4" if loop_parameters.method == RK4 else "euler",
        "mass": body[MASS],
        "gravity added": body[ADDED_GRAVITY],
        "inertia": body[INERTIA : INERTIA + 9].reshape(3, 3),
        "inverse inertia": body[INVERSE_INERTIA : INVERSE_INERTIA + 9].reshape(3, 3),
        "offset": body[LOADS_OFFSET : LOADS_OFFSET + 6],
        "time constants up": body[LAG_UP : LAG_UP + 4],
        "time constants down": body[LAG_DOWN : LAG_DOWN + 4],
        "rate limit": body[MAX_ROTOR_ACCELERATION],
        "lowest": loop_parameters.drive.low,
        "highest": loop_parameters.drive.high,
        "delay": loop_parameters.drive.delay,
        "wind": loop_parameters.wind[STEADY_WIND : STEADY_WIND + 3],
        "battery voltage": loop_parameters.battery.start if loop_parameters.battery.place >= 0 else None,
        "start speeds": setup.start[ROTOR_SPEEDS:STATE_SIZE],
        "controller": {
            "mass": gains[g.CONTROL_MASS],
            "inertia": gains[g.CONTROL_INERTIA : g.CONTROL_INERTIA + 9].reshape(3, 3),
            "effectiveness": gains[g.EFFECTIVENESS : g.EFFECTIVENESS + 16].reshape(4, 4),
            "yaw reaction": gains[g.YAW_REACTION : g.YAW_REACTION + 4],
            "hover speed": gains[g.HOVER_SPEED],
            "lowest": gains[g.LOWEST_SPEED],
            "highest": gains[g.HIGHEST_SPEED],
            "lag": gains[g.ACTUATOR_LAG],
            "weights": gains[g.ALLOCATION_WEIGHTS : g.ALLOCATION_WEIGHTS + 4],
            "weighted": bool(gains[g.USES_WEIGHTED_ALLOCATION]),
            "learn rotor limits": bool(gains[g.LEARNS_ROTOR_LIMITS]),
            "position": gains[g.POSITION_GAIN],
            "velocity": gains[g.VELOCITY_GAIN],
            "velocity integral": gains[g.VELOCITY_INTEGRAL_GAIN],
            "attitude": gains[g.ATTITUDE_GAIN],
            "yaw": gains[g.YAW_GAIN],
            "rates": gains[g.RATE_GAINS : g.RATE_GAINS + 3],
            "cut-off": gains[g.FILTER_FREQUENCY],
            "damping": gains[g.FILTER_DAMPING],
            "tilt": gains[g.MAX_TILT],
            "speed": gains[g.MAX_SPEED],
            "climb": gains[g.MAX_CLIMB],
            "acceleration": gains[g.MAX_ACCELERATION],
            "rate": gains[g.MAX_TILT_RATE],
            "yaw rate": gains[g.MAX_YAW_RATE],
            "integral": gains[g.MAX_INTEGRAL],
        },
    }


def _refuse(setup: Setup) -> None:
    loop_parameters = setup.loop_parameters
    battery = loop_parameters.battery
    found = {
        f"the controller {LAWS[loop_parameters.controller].name}": LAWS[loop_parameters.controller] is not INDI,
        "sensor noise": any(loop_parameters.sensors),
        "gusts": bool(np.any(loop_parameters.wind[GUST_DEVIATION : GUST_DEVIATION + 3])),
        "a changing wind": len(loop_parameters.wind_table) > 0,
        "a rotor fault": math.isfinite(loop_parameters.fault[0]),
        **{
            f"the {what} of the model's extensions": True
            for what in list_part_names(read_payload_and_inflow(setup.model))
        },
        "a term in the time": loop_parameters.clock >= 0,
        "a battery that changes the rotor speeds or drains": bool(battery.exponent or battery.drain or battery.sag),
    }
    for what, there in found.items():
        if there:
            raise ConfigError(
                f"{setup.name}: {what} cannot be exported; only the INDI controller in steady wind, without noise and "
                "faults, with a constant battery voltage, can be exported"
            )
