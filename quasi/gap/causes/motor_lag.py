"""Rotors that follow their commands more slowly or faster than the model says."""

from quasi.gap.effect import Effect, Extension, Parameter, Values, Vehicle
from quasi.model.model import Model


def _extension(values: Values, _: Vehicle, __: Model) -> Extension:
    return Extension(actuators={"time constant": values["time_constant"]})


EFFECT = Effect(
    id="motor_lag",
    level="drive",
    sentence="the rotors follow their commands with another lag than the model's",
    equation="dW/dt = (W_wanted - W) / time_constant",
    source="Klein & Morelli, 2006, section 6.3",
    parameters={"time_constant": Parameter("s", None, "a", 0.002, 0.4, 0.008)},
    channels=("w1", "w2", "w3", "w4"),
    rivals=("command_delay",),
    tie_breaker="a sweep of the throttle to high frequencies: a lag loses gain, a delay keeps it",
    extension=_extension,
)
