"""Effects of the causes of an extended model, in words."""

from collections.abc import Mapping
from typing import Any

from quasi.terms.rotor_map import LAG_FACTORS

STATE_TEXTS = {
    "swinging load": "a swinging payload with states of its own in simulations and roll-outs; predictions contain "
    "its quasi-steady part, a payload at rest along the apparent vertical; exports do not contain it",
    "inflow lag": "has states of its own in simulations and roll-outs; predictions and exported functions contain it "
    "to first order in the rotor accelerations, which is zero where these are zero",
}
ACTUATOR_TEXTS = {
    "time constant": "rotors of simulations, roll-outs with commands and exported vehicles",
    "delay": "rotors of simulations, roll-outs with commands and exported vehicles",
    "voltage exponent": "rotors of simulations with a battery voltage, and of exported vehicles",
    "reference voltage": "rotors of simulations with a battery voltage, and of exported vehicles",
    "telemetry delay": "corrects recorded rotor speeds in roll-outs",
    "rotor speed scale": "corrects recorded rotor speeds in roll-outs",
    **dict.fromkeys(LAG_FACTORS, "one rotor of simulations, roll-outs with commands and exported vehicles"),
}
# rotor constants that replace the values of the model
REPLACED_CONSTANTS = ("time constant", "voltage exponent", "reference voltage")
AIRFRAME_TEXTS = {
    "mass": "the vehicle's mass",
    "inertia": "the vehicle's inertia",
    "cg offset": "moments about the true centre of gravity, among the terms",
}


def describe_effects(extension: Mapping[str, Any]) -> str:
    """Describe the effects of an extension: terms, vehicle, rotors, wind, states of its own."""
    text = [
        STATE_TEXTS.get(name, f"{name}, which this version does not know") for name in extension.get("states") or ()
    ]
    text += [ACTUATOR_TEXTS.get(name, name) for name in extension.get("actuators") or ()]
    text += [AIRFRAME_TEXTS.get(name, name) for name in extension.get("airframe") or ()]
    if (extension.get("environment") or {}).get("wind") is not None:
        text.append("wind in simulations and roll-outs; predictions use the velocity through the air")
    return "; ".join(dict.fromkeys(text)) or "among the terms"
