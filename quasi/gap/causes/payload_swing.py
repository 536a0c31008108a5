"""A load that swings below the vehicle."""

import numpy as np

from quasi.gap.effect import Effect, Extension, Parameter, Size, Values, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.pendulum import pull_of
from quasi.model.model import Model

LENGTH_SPREAD = 0.2  # of a length, to which it is known: the lengths are 1.6 apart
# m; a length between two of them shows in the next shorter one
LOAD_LENGTHS = {f"mass at {length:g} m": length for length in (0.12, 0.2, 0.32, 0.5, 0.8, 1.3)}


def _columns(evidence: Evidence, _: Values) -> dict[str, np.ndarray]:
    return {name: evidence.forces_only(pull_of(evidence, length)) for name, length in LOAD_LENGTHS.items()}


def _load(values: Values) -> tuple[float, float]:
    """Mass of the whole load, kg, and the length that its parts hang at in the middle, m."""
    masses = {length: values[name] for name, length in LOAD_LENGTHS.items() if values.get(name)}
    total = float(sum(masses.values()))
    if total <= 0.0:
        return total, 0.0
    middle = float(np.exp(sum(m * np.log(length) for length, m in masses.items()) / total))
    return total, float(np.clip(middle, min(LOAD_LENGTHS.values()), max(LOAD_LENGTHS.values())))


def _extension(values: Values, _: Vehicle, __: Model) -> Extension:
    mass, length = _load(values)
    return Extension(states={"swinging load": {"mass": mass, "length": length}}) if length else Extension()


def _report(values: Values, stds: Values) -> dict[str, Size]:
    mass, length = _load(values)
    return {
        "mass": Size(mass, float(np.linalg.norm(list(stds.values()))), "kg"),
        "length": Size(length, LENGTH_SPREAD * length, "m"),
    }


EFFECT = Effect(
    id="payload_swing",
    level="forces",
    sentence="a load hangs below the vehicle and swings",
    equation="L n'' = f - (f.n) n - L |n'|^2 n, f = g - a; pull m (f.n + L |n'|^2) along the string n",
    source="Goodarzi, Lee & Lee, Geometric control of a quadrotor UAV transporting a payload, IJCAS 13(6), 2015",
    parameters={
        name: Parameter("kg", 0.0, "s", 0.0, 0.5, (lambda v: 0.035 * v.mass) if length == 0.5 else None)
        for name, length in LOAD_LENGTHS.items()
    },
    channels=("Fx", "Fy", "Fz"),
    rivals=("mass", "wind", "tether"),
    tie_breaker="stop sharply and hover: a load goes on swinging",
    parts="one",
    form_uncertainty=0.4,  # how it swung before, and errors of the forces that drive it, dilute the estimate
    columns=_columns,
    extension=_extension,
    reported=_report,
    absent_when_healthy=True,
)
