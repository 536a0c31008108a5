"""Rotor speeds that follow the battery otherwise than the model says."""

from quasi.gap.effect import Effect, Extension, Parameter, Values, Vehicle
from quasi.model.model import Model

VOLTAGE = "reference voltage"


def _extension(values: Values, _: Vehicle, __: Model) -> Extension:
    # a command map without a voltage of its own holds at the voltage of the flights that gave the exponent
    volts = {"reference voltage": values[VOLTAGE]} if values[VOLTAGE] else {}
    return Extension(actuators={"voltage exponent": values["exponent"], **volts})


EFFECT = Effect(
    id="battery_sag",
    level="drive",
    sentence="rotor speeds at the same command follow the battery's voltage otherwise than the model says",
    equation="W = map(command) (V / V_ref)^exponent",
    source="steady speed of an open-loop speed controller",
    parameters={"exponent": Parameter("1", None, "a", -1.0, 3.0, 0.3), VOLTAGE: Parameter("V", None, "a", 0.0, 100.0)},
    channels=("w1", "w2", "w3", "w4"),
    rivals=("thrust_drift",),
    tie_breaker="a long flight, or batteries of different charge",
    extension=_extension,
)
