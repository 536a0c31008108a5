"""All rotors with more or less reaction torque at the same speed and thrust."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, number


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    yaw = " + ".join(f"{number(-s * vehicle.torque)}*w{i}^2" for i, s in enumerate(vehicle.spin, 1))
    return {"factor": {"Mz": yaw}}


EFFECT = Effect(
    id="torque_factor",
    level="forces",
    sentence="all rotors take more or less torque than before at the same speed (propellers of another pitch or blade)",
    equation="Q_i = factor Q0_i: yaw effectiveness alone",
    source="definition of the torque coefficient",
    parameters={"factor": Parameter("1", 1.0, "s", 0.3, 3.0, 0.1)},
    channels=("Mz",),
    rivals=("inertia", "rotor_tilt", "rotor_acceleration_torque"),
    tie_breaker="yaw doublets with pitching and rolling at the same time: an inertia acts on their coupling as well",
    terms=_terms,
    absorbed_by_model=True,
)
