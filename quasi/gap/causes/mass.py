"""Another mass than configured."""

import numpy as np

from quasi.gap.effect import Effect, Extension, Parameter, Values, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.model.model import Model


def _columns(evidence: Evidence, _: Values) -> dict[str, np.ndarray]:
    # measured force = configured mass x specific force, true force = true mass x specific force = the model's
    return {"mass": evidence.forces_only(-evidence.force / evidence.mass)}


def _exact(values: Values, vehicle: Vehicle) -> Values:
    # the residual is -F dm / (m + dm), the fit's is -F c / m
    own, most = vehicle.mass, EFFECT.parameters["mass"].high
    found = min(values["mass"], own * most / (own + most))
    return {"mass": own * found / (own - found)}


def _apparent(values: Values, vehicle: Vehicle) -> Values:
    return {"mass": vehicle.mass * values["mass"] / (vehicle.mass + values["mass"])}


def _extension(values: Values, vehicle: Vehicle, _: Model) -> Extension:
    return Extension(airframe={"mass": vehicle.mass + values["mass"]})


EFFECT = Effect(
    id="mass",
    level="forces",
    sentence="the vehicle is heavier or lighter than configured",
    equation="F = m a: all of dF along the specific force",
    source="Newton's second law",
    parameters={"mass": Parameter("kg", None, "s", -0.5, 2.0, lambda v: 0.03 * v.mass)},
    channels=("Fx", "Fy", "Fz"),
    rivals=("thrust_factor", "accelerometer_scale", "payload_swing"),
    tie_breaker="weigh it; or roll and pitch doublets with a rich thrust range",
    columns=_columns,
    extension=_extension,
    exact=_exact,
    apparent=_apparent,
    absorbed_by_model=True,
)
