"""Rotor speeds that were logged late."""

import numpy as np

from quasi.gap.effect import Effect, Extension, Parameter, Values, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.instruments import reread
from quasi.model.columns import ROTORS
from quasi.model.extensions import correct_rotor_speeds
from quasi.model.model import Model


def _columns(evidence: Evidence, _: Values) -> dict[str, np.ndarray]:
    slope = evidence.gradient(*ROTORS)
    return {"delay": np.einsum("nij,nj->ni", slope, evidence.spin_up)}


def _corrected(evidence: Evidence, values: Values) -> Evidence:
    return reread(evidence, correct_rotor_speeds(evidence.columns, values["delay"], 1.0))


def _whole(evidence: Evidence, _: Vehicle, values: Values) -> np.ndarray:
    # beyond first order a late moment looks like another moment of inertia
    return _corrected(evidence, values).predicted - evidence.predicted


def _extension(values: Values, _: Vehicle, __: Model) -> Extension:
    return Extension(actuators={"telemetry delay": values["delay"]})


EFFECT = Effect(
    id="telemetry_delay",
    level="forces",
    sentence="rotor speeds were logged late against the motion that they cause",
    opposite="rotor speeds were logged early against the motion that they cause",
    equation="W_log(t) = W(t - delay): residual delay dF/dW dW/dt, the same delay on every channel",
    source="definition",
    parameters={"delay": Parameter("s", 0.0, "f", -0.01, 0.1, 0.005)},
    channels=("Fz", "Mx", "My", "Mz"),
    rivals=("inflow_lag", "command_delay", "rotor_acceleration_torque"),
    tie_breaker="sharp doublets about all axes",
    columns=_columns,
    full_effect=_whole,
    corrected=_corrected,
    extension=_extension,
    absorbed_by_model=True,
    corrects=("telemetry", "age"),
)
