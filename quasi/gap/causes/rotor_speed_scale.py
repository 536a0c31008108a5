"""Rotor speeds in the wrong unit."""

import numpy as np

from quasi.gap.effect import Effect, Extension, Parameter, Values, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.instruments import reread
from quasi.model.columns import ROTORS
from quasi.model.model import Model


def _columns(evidence: Evidence, _: Values) -> dict[str, np.ndarray]:
    slope = evidence.gradient(*ROTORS)
    return {"scale": -np.einsum("nij,nj->ni", slope, evidence.speeds)}


def _turned(evidence: Evidence, values: Values) -> dict[str, np.ndarray]:
    """The columns of rotor speeds and accelerations as they were."""
    names = [name for rotor in ROTORS for name in (rotor, f"{rotor}_dot") if name in evidence.columns]
    return {name: evidence.columns[name] / (1.0 + values["scale"]) for name in names}


def _whole(evidence: Evidence, _: Vehicle, values: Values) -> np.ndarray:
    return reread(evidence, _turned(evidence, values)).predicted - evidence.predicted


def _corrected(evidence: Evidence, values: Values) -> Evidence:
    return reread(evidence, _turned(evidence, values))


def _extension(values: Values, _: Vehicle, __: Model) -> Extension:
    return Extension(actuators={"rotor speed scale": 1.0 + values["scale"]})


EFFECT = Effect(
    id="rotor_speed_scale",
    level="forces",
    sentence="rotor speeds are logged too high or too low by one factor (a wrong pole count)",
    equation="W_log = scale W",
    source="definition",
    parameters={"scale": Parameter("1", 1.0, "a", 0.2, 5.0, 1.0 / 6.0)},
    channels=("Fz", "Mx", "My", "Mz"),
    rivals=("thrust_factor",),
    tie_breaker="a tachometer, or the vibration line against the logged speed",
    columns=_columns,
    full_effect=_whole,
    corrected=_corrected,
    extension=_extension,
    always_tied_with=("thrust_factor",),
    absorbed_by_model=True,
)
