"""Other moments of inertia than configured."""

from collections.abc import Callable

import numpy as np

from quasi.gap.effect import Effect, Extension, Parameter, Values, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.model.model import Model
from quasi.sensor_limits import INERTIA_ERROR

ENTRIES = {"Ixx": (0, 0), "Iyy": (1, 1), "Izz": (2, 2), "Ixy": (0, 1), "Ixz": (0, 2), "Iyz": (1, 2)}

DIAGONAL = ("Ixx", "Iyy", "Izz")


def change(name: str) -> np.ndarray:
    """Change of the tensor by one unit of a moment, or of a product I_xy = integral of x y dm (3, 3)."""
    i, j = ENTRIES[name]
    tensor = np.zeros((3, 3))
    tensor[i, j] = tensor[j, i] = 1.0 if name in DIAGONAL else -1.0
    return tensor


def _tenth(i: int, j: int) -> Callable[[Vehicle], float]:
    return lambda vehicle: 0.1 * float(vehicle.inertia[i, j])


def _body(vehicle: Vehicle) -> list[tuple[Values, float]]:
    """No body has a moment of inertia that is more than the two others together: I_xx + I_yy - I_zz = 2 int z^2 dm.

    The deviations are those from configured moments, which err.
    """
    moments = {f"I{a}{a}": float(vehicle.inertia[k, k]) for k, a in enumerate("xyz")}
    return [
        (
            {n: -1.0 if n == largest else 1.0 for n in moments},
            own - (1.0 + INERTIA_ERROR) * (sum(moments.values()) - own),
        )
        for largest, own in moments.items()
    ]


def _columns(evidence: Evidence, _: Values) -> dict[str, np.ndarray]:
    result = {}
    for name in ENTRIES:
        tensor = change(name)
        moment = evidence.angular_acceleration @ tensor.T + evidence.gyroscopic(tensor)
        result[name] = evidence.moments_only(-moment)
    return result


def _exact(values: Values, vehicle: Vehicle) -> Values:
    # the residual is (I J^-1 - 1) M of a true inertia J, the fit's is -C I^-1 M
    fitted = sum(value * change(name) for name, value in values.items())
    left = vehicle.inertia - fitted
    if np.linalg.eigvalsh(left).min() <= 0.0:  # no body: refused by its range
        return values
    true = vehicle.inertia @ np.linalg.solve(left, vehicle.inertia) - vehicle.inertia
    return {name: float(true[ENTRIES[name]]) * (1.0 if name in DIAGONAL else -1.0) for name in values}


def _apparent(values: Values, vehicle: Vehicle) -> Values:
    true = vehicle.inertia + sum(value * change(name) for name, value in values.items())
    if np.linalg.eigvalsh(true).min() <= 0.0:
        return values
    fitted = vehicle.inertia - vehicle.inertia @ np.linalg.solve(true, vehicle.inertia)
    return {name: float(fitted[ENTRIES[name]]) * (1.0 if name in DIAGONAL else -1.0) for name in values}


def _extension(values: Values, vehicle: Vehicle, _: Model) -> Extension:
    tensor = vehicle.inertia + sum(values[name] * change(name) for name in ENTRIES)
    return Extension(airframe={"inertia": tensor.tolist()})


EFFECT = Effect(
    id="inertia",
    level="forces",
    sentence="the moments of inertia are not the configured ones",
    equation="dM = dI domega/dt + omega x dI omega",
    source="Euler's equations",
    parameters={
        name: Parameter("kg m2", None, "s", -0.05, 0.05, _tenth(*entry) if entry[0] == entry[1] else None)
        for name, entry in ENTRIES.items()
    },
    channels=("Mx", "My", "Mz"),
    rivals=("gyro_scale", "rotor_gyroscopic", "torque_factor"),
    tie_breaker="excite the three axes together; a bifilar pendulum test",
    columns=_columns,
    extension=_extension,
    exact=_exact,
    apparent=_apparent,
    sums=_body,
    parts="paired",  # products alone are no other mass distribution, but most often the error of another form
    absorbed_by_model=True,
)
