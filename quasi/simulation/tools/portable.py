"""A closed loop as plain named numbers, for exports that fly it elsewhere.

Only what such an export can carry: the INDI controller, rotors with lag, delay and limits, steady wind, a battery at
rest.
"""

import math
from typing import Any

import numpy as np

from quasi.errors import ConfigError
from quasi.model.model import Model
from quasi.simulation.control import gains as g
from quasi.simulation.loop.setup import Setup, make_setup
from quasi.simulation.vehicle.dynamics import RK4
from quasi.simulation.vehicle.layout import (
    DOWN,
    GRAVITY_ADDED,
    INERTIA,
    INVERSE,
    MASS,
    OFFSET,
    RATE,
    ROTORS,
    STATES,
    UP,
)
from quasi.simulation.vehicle.sensors_and_wind import GUST, STEADY
from quasi.simulation.vehicle.variants import named, parts_of


def portable_setup(model: Model, time_step: float = 0.004) -> Setup:
    """The closed loop that travels with a model: INDI with its default gains, rotors as the model knows them.

    Raises ConfigError or DataError, as `make_setup` does, for a model that cannot be flown: by the variable that a
    simulation cannot know, the axes or the mass that it lacks.
    """
    settings = {
        "model": {"model ID": model.id},
        "simulation": {"time step": time_step},
        "controller": {"controller": "drone_INDI"},
        "noise": {"add": False},
    }
    return make_setup(settings, model, name=f"closed loop of model {model.id}")


def loop_constants(setup: Setup) -> dict[str, Any]:
    """The constants of a closed loop; SI units, body and earth axes as in `dynamics` and `controllers`.

    Raises ConfigError naming what cannot be carried: another controller, noise, gusts, faults, a battery that empties.
    """
    machine = setup.machine
    _refuse(setup)
    body, gains = machine.body, machine.gains
    return {
        "model": setup.model.id,
        "time step": machine.dt,
        "substeps": machine.substeps,
        "integrator": "rk4" if machine.method == RK4 else "euler",
        "mass": body[MASS],
        "gravity added": body[GRAVITY_ADDED],
        "inertia": body[INERTIA : INERTIA + 9].reshape(3, 3),
        "inverse inertia": body[INVERSE : INVERSE + 9].reshape(3, 3),
        "offset": body[OFFSET : OFFSET + 6],
        "time constants up": body[UP : UP + 4],
        "time constants down": body[DOWN : DOWN + 4],
        "rate limit": body[RATE],
        "lowest": machine.drive.low,
        "highest": machine.drive.high,
        "delay": machine.drive.delay,
        "wind": machine.wind[STEADY : STEADY + 3],
        "battery voltage": machine.battery.start if machine.battery.place >= 0 else None,
        "start speeds": setup.start[ROTORS:STATES],
        "controller": {
            "mass": gains[g.MASS],
            "inertia": gains[g.INERTIA : g.INERTIA + 9].reshape(3, 3),
            "effectiveness": gains[g.EFFECT : g.EFFECT + 16].reshape(4, 4),
            "yaw reaction": gains[g.REACTION : g.REACTION + 4],
            "hover speed": gains[g.HOVER],
            "lowest": gains[g.LOWEST],
            "highest": gains[g.HIGHEST],
            "lag": gains[g.LAG],
            "weights": gains[g.WEIGHTS : g.WEIGHTS + 4],
            "weighted": bool(gains[g.METHOD]),
            "learn rotor limits": bool(gains[g.LEARN]),
            "position": gains[g.POSITION],
            "velocity": gains[g.VELOCITY],
            "velocity integral": gains[g.VELOCITY_INTEGRAL],
            "attitude": gains[g.ATTITUDE],
            "yaw": gains[g.YAW],
            "rates": gains[g.RATES : g.RATES + 3],
            "cut-off": gains[g.CUT_OFF],
            "damping": gains[g.DAMPING],
            "tilt": gains[g.TILT],
            "speed": gains[g.SPEED],
            "climb": gains[g.CLIMB],
            "acceleration": gains[g.ACCELERATION],
            "rate": gains[g.RATE],
            "yaw rate": gains[g.YAW_RATE],
            "integral": gains[g.INTEGRAL],
        },
    }


def _refuse(setup: Setup) -> None:
    machine = setup.machine
    battery = machine.battery
    found = {
        f"the controller {g.LABELS[machine.controller]}": machine.controller != g.INDI,
        "sensor noise": any(machine.sensors),
        "gusts": bool(np.any(machine.wind[GUST : GUST + 3])),
        "a wind that changes": len(machine.wind_table) > 0,
        "a rotor fault": math.isfinite(machine.fault[0]),
        **{f"the {what} of the model's extensions": True for what in named(parts_of(setup.model))},
        "a term in the time": machine.clock >= 0,
        "a battery that moves the rotor speeds or empties": bool(battery.exponent or battery.drain or battery.sag),
    }
    for what, there in found.items():
        if there:
            raise ConfigError(
                f"{setup.name}: {what} cannot be exported; only the INDI controller in steady wind, without noise and "
                "faults, with a battery at rest, travels"
            )
