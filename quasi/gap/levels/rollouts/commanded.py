"""What drives the rotors in simulations with commands, as the learning flights determine it.

The drive level fits the drive's constants (lag up and down, delay, map, battery exponent, each rotor's share) to
every flight.
Their mean over the compared flights is the drive of a model that knows all that flights can teach; each cause of level
A that was not named, fitted alone, is a wrong cause that a named one has to beat.
"""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from quasi.errors import ConfigError
from quasi.gap.effect import Effect, Vehicle
from quasi.gap.extension import extend
from quasi.gap.levels.drive.fit import CONSTANTS
from quasi.gap.levels.drive.prediction import own_lag
from quasi.gap.levels.rollouts.open_loop import Flight
from quasi.model.extensions import read_rotor_constants
from quasi.model.model import Model
from quasi.simulation.tools.replay import ActuatorDynamics, read_actuator_dynamics
from quasi.terms.rotor_map import COMMANDED, LOW_VOLTAGE, SHARES


def learned(known: Mapping[str, Any], flight: Flight, model: Model) -> tuple[np.ndarray, ActuatorDynamics] | None:
    """Settled speeds that a flight's commands ask for (N, 4), rad/s, and how rotors follow; None without its commands.

    known  {"kind": "speeds" or "shares", "values": (15,) by `fit.CONSTANTS`, "voltage": V or None}
    model  whose limits of rotor speed hold, and what it knows of the age of the telemetry, which is no delay
    """
    names = COMMANDED if known["kind"] == "speeds" else SHARES
    if not all(n in flight.table for n in names):
        return None
    x = dict(zip(CONSTANTS, known["values"]))
    command = flight.table[list(names)].to_numpy(float)
    wanted = x["a0"] + x["a1"] * command + x["a2"] * command**2
    wanted *= 1.0 + np.array([x[f"rotor{i}"] for i in range(1, 5)])
    if known["voltage"] and "battery_voltage" in flight.table:
        ratio = flight.table["battery_voltage"].to_numpy(float) / known["voltage"]
        wanted *= np.where(ratio > LOW_VOLTAGE, ratio, 1.0)[:, None] ** x["exponent"]
    late = max(x["delay"] - read_rotor_constants(model).get("telemetry delay", 0.0), 0.0)
    limits = read_actuator_dynamics(model)
    values = np.array(known["values"])
    up, down = np.transpose([own_lag(values, i) for i in range(4)])
    return wanted, limits._replace(up=up, down=down, delay=late)


def wrong_ones(
    healthy: Mapping[str, Any], named: Collection[str], effects: Mapping[str, Effect], model: Model, vehicle: Vehicle
) -> dict[str, Model]:
    """{cause: the model extended by it alone} of the causes of the drive that are not named.

    healthy  of the drive: "alone" {cause: {parameter: value} where it stands alone}
    """
    found = {}
    for cause, alone in (healthy.get("alone") or {}).items():
        if cause in named or cause not in effects or effects[cause].level != "drive":
            continue
        own = effects[cause].parameters
        value = {n: float(np.clip(v, own[n].low, own[n].high)) - (own[n].neutral or 0.0) for n, v in alone.items()}
        try:
            document = extend(model, [(effects[cause], value)], vehicle, "wrong", "trial")
        except ConfigError:
            continue  # what cannot be simulated has nothing to be compared with
        found[cause] = Model(document, f"{cause}, wrong")
    return found
