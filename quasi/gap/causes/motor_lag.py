"""Rotors that follow their commands more slowly or faster than the model says."""

from quasi.gap.effect import Effect, Extension, Parameter, Values, Vehicle
from quasi.model.model import Model
from quasi.terms.rotor_map import ROTOR_NUMBERS, WAYS_RATIO

LAG_NAMES = tuple(f"rotor{i}" for i in ROTOR_NUMBERS)


def _extension(values: Values, _: Vehicle, __: Model) -> Extension:
    constants = {"time constant": values["time_constant"]} if values["time_constant"] else {}
    constants |= {WAYS_RATIO: values["down_over_up"]} if values["down_over_up"] else {}
    factors = {f"{n} lag factor": 1.0 + values[n] for n in LAG_NAMES if values[n]}
    return Extension(actuators=constants | factors)


EFFECT = Effect(
    id="motor_lag",
    level="drive",
    sentence="the rotors follow their commands with another lag than the model's",
    partial="the lag of {} behind commands is another than the model's",
    equation="dW_i/dt = (W_wanted - W_i) / time_constant, of all rotors, the mean of slowing down and speeding up; or "
    "of rotor i times its factor",
    source="Klein & Morelli, 2006, section 6.3",
    parameters={
        "time_constant": Parameter("s", None, "a", 0.002, 0.4, 0.008),
        **{n: Parameter("1", 1.0, "a", 0.1, 10.0) for n in LAG_NAMES},
        "down_over_up": Parameter("1", None, "a", 0.1, 10.0),
    },
    channels=("w1", "w2", "w3", "w4"),
    rivals=("command_delay",),
    tie_breaker="a sweep of the throttle to high frequencies: a lag loses gain, a delay keeps it",
    extension=_extension,
)
