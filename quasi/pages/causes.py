"""Where the causes that an extended model carries act, in words."""

from collections.abc import Mapping
from typing import Any

STATES = {
    "swinging load": "swings, with states of its own, in simulations and roll-outs; predictions hold its quasi-steady "
    "part, a load at rest along the apparent vertical; no export carries it",
    "inflow lag": "has states of its own in simulations and roll-outs; predictions and exported functions hold it to "
    "first order in the rotor accelerations, and its quasi-steady part, nothing, where these are zero",
}
ACTUATORS = {
    "time constant": "rotors of simulations, roll-outs with commands and exported vehicles",
    "delay": "rotors of simulations, roll-outs with commands and exported vehicles",
    "voltage exponent": "rotors of simulations that know the battery's voltage, and of exported vehicles",
    "reference voltage": "rotors of simulations that know the battery's voltage, and of exported vehicles",
    "telemetry delay": "taken off recorded rotor speeds in roll-outs",
    "rotor speed scale": "taken off recorded rotor speeds in roll-outs",
}
REPLACED = ("time constant", "voltage exponent", "reference voltage")  # constants of rotors that stand as they are
AIRFRAME = {
    "mass": "the vehicle's mass",
    "inertia": "the vehicle's inertia",
    "cg offset": "moments about the true centre of gravity, among the terms",
}


def where_it_acts(extension: Mapping[str, Any]) -> str:
    """Where an extension of a model acts: terms, vehicle, rotors, wind, states of its own."""
    said = [STATES.get(name, f"{name}, which nothing here knows") for name in extension.get("states") or ()]
    said += [ACTUATORS.get(name, name) for name in extension.get("actuators") or ()]
    said += [AIRFRAME.get(name, name) for name in extension.get("airframe") or ()]
    if (extension.get("environment") or {}).get("wind") is not None:
        said.append("blows in simulations and roll-outs; predictions take the velocity through the air")
    return "; ".join(dict.fromkeys(said)) or "among the terms"
