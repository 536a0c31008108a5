"""Steady wind."""

import numpy as np

from quasi import attitude
from quasi.gap.effect import Effect, Extension, Parameter, Values, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.instruments import reread
from quasi.model.model import Model

WINDS = ("north", "east", "down")


def _columns(evidence: Evidence, _: Values) -> dict[str, np.ndarray]:
    slope = evidence.gradient("u", "v", "w")
    result = {}
    for k, name in enumerate(WINDS):
        along = attitude.rotate_inverse(evidence.quaternion, np.eye(3)[k])
        result[name] = -np.einsum("nij,nj->ni", slope, along)
    return result


def _whole(evidence: Evidence, _: Vehicle, values: Values) -> np.ndarray:
    # drag and lift go with the square of airspeed: at twice the speed of the flights the slope lacks half of them
    along = attitude.rotate_inverse(evidence.quaternion, np.array([values[name] for name in WINDS]))
    air = {f"{a}_air": evidence.velocity[:, k] - along[:, k] for k, a in enumerate("uvw")}
    return reread(evidence, air).predicted - evidence.predicted


def _extension(values: Values, _: Vehicle, __: Model) -> Extension:
    return Extension(environment={"wind": [values[name] for name in WINDS]})


EFFECT = Effect(
    id="wind",
    level="forces",
    sentence="a steady wind blows through the room",
    equation="V = V_ground - R' W",
    source="definition of airspeed",
    parameters={name: Parameter("m/s", 0.0, "f", -15.0, 15.0, None if name == "down" else 1.0) for name in WINDS},
    channels=("Fx", "Fy", "Fz"),
    rivals=("accelerometer_bias", "room_tilt", "tether"),
    tie_breaker="out and back, and a yaw sweep",
    columns=_columns,
    full_effect=_whole,
    extension=_extension,
    parts="all",
    sized_by=("Fx", "Fy", "Fz"),  # terms of airspeed in moments are learnt in manoeuvres, and hardly hold beyond them
    absent_when_healthy=True,
)
