"""Commands that reach the rotors late."""

import numpy as np

from quasi.gap.effect import Effect, Extension, Parameter, Values, Vehicle
from quasi.model.extensions import drive_of
from quasi.model.model import Model


def _extension(values: Values, _: Vehicle, model: Model) -> Extension:
    """The delay found is beyond what the model has."""
    own = drive_of(model.document).get("delay")
    held = float(np.mean(own["value"])) if own else 0.0
    return Extension(actuators={"delay": values["delay"] + held})


EFFECT = Effect(
    id="command_delay",
    level="drive",
    sentence="commands reach the rotors late",
    opposite="commands reach the rotors sooner than the model says",
    equation="W(t) = f(W_wanted(t - delay)), one delay for all rotors",
    source="definition",
    parameters={"delay": Parameter("s", 0.0, "a", -0.05, 0.1, 0.008)},
    channels=("w1", "w2", "w3", "w4"),
    rivals=("motor_lag", "telemetry_delay"),
    tie_breaker="quick yaw inputs: the motion determines the delay of the telemetry",
    extension=_extension,
)
