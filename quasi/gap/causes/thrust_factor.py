"""All rotors stronger or weaker.

Air that is thinner changes torque as it changes thrust; blades of another shape do not: torque is a parameter of its
own, asked together with thrust. So is what velocity makes of the rotors (inflow, hub forces, damping): thinner air
takes it with the thrust, blades of another pitch leave it as it was. Asked with one factor for both, five per cent less
thrust without less inflow had been missed: an inertia and a drag took up the difference.

In the fit and in the extended model it is four rotors of one `rotor_effectiveness`: what sessions differ by has the
same columns, and no form of its own gives one away.
"""

from collections.abc import Mapping

import numpy as np

from quasi.gap.causes.rotor_effectiveness import EFFECT as ROTOR
from quasi.gap.effect import Effect, Extension, Parameter, Terms, Values, Vehicle, number, thrust_wrench
from quasi.gap.flights.evidence import Evidence
from quasi.model.model import Model

ROTOR_PARTS = {"factor": "rotor", "torque": "torque"}  # parameters here and there


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    up = thrust_wrench(vehicle, [f"{number(vehicle.thrust)}*w{i}^2" for i in range(1, 5)])
    yaw = " + ".join(f"{number(-s * vehicle.torque)}*w{i}^2" for i, s in enumerate(vehicle.spin, 1))
    return {"factor": up, "torque": {"Mz": yaw}, "airflow": {}}


def _columns(evidence: Evidence, values: Values) -> Mapping[str, np.ndarray]:
    each = ROTOR.columns(evidence, values)
    columns = {name: sum(each[f"{kind}{i}"] for i in range(1, 5)) for name, kind in ROTOR_PARTS.items()}
    return columns | {"airflow": columns["factor"] - evidence.thrust_wrench(evidence.thrust)}


def _extension(values: Values, vehicle: Vehicle, model: Model) -> Extension:
    flow = values.get("airflow", 0.0)
    shares = {"factor": values.get("factor", 0.0) + flow, "torque": values.get("torque", 0.0)}
    alike = {f"{ROTOR_PARTS[name]}{i}": value for name, value in shares.items() for i in range(1, 5)}
    found = ROTOR.extension(alike, vehicle, model)
    for axis, text in _terms(vehicle)["factor"].items() if flow else ():
        found.terms.setdefault(axis, []).append((text, -flow))
    return found


EFFECT = Effect(
    id="thrust_factor",
    level="forces",
    sentence="all rotors make more or less thrust than before (other propellers, thinner air)",
    equation="T_i = factor T0_i, roll and pitch effectiveness with it; Q_i = torque Q0_i; what velocity makes of T0_i "
    "and of hub forces times factor + airflow - 1",
    source="Leishman, Principles of Helicopter Aerodynamics, 2nd ed., 2006, equation 2.30",
    parameters={
        "factor": Parameter("1", 1.0, "s", 0.3, 3.0, 0.03),
        "torque": Parameter("1", 1.0, "s", 0.3, 3.0, None),
        "airflow": Parameter("1", 1.0, "s", -1.0, 3.0, None),
    },
    parts="first",
    channels=("Fz", "Mx", "My"),
    rivals=("mass", "rotor_speed_scale", "accelerometer_scale"),
    tie_breaker="weigh the quadrotor, and check the logged speed of one rotor with a tachometer",
    terms=_terms,
    columns=_columns,
    extension=_extension,
    always_tied_with=("rotor_speed_scale",),
    absorbed_by_model=True,
)
