"""All rotors stronger or weaker.

Air that is thinner changes torque as it changes thrust; blades of another shape do not: torque is a parameter of its
own, asked together with thrust.
"""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, number, thrust_wrench


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    up = thrust_wrench(vehicle, [f"{number(vehicle.thrust)}*w{i}^2" for i in range(1, 5)])
    yaw = " + ".join(f"{number(-s * vehicle.torque)}*w{i}^2" for i, s in enumerate(vehicle.spin, 1))
    return {"factor": up, "torque": {"Mz": yaw}}


EFFECT = Effect(
    id="thrust_factor",
    level="forces",
    sentence="all rotors make more or less thrust than before (other propellers, thinner air)",
    equation="T_i = factor T0_i, roll and pitch effectiveness with it; Q_i = torque Q0_i",
    source="Leishman, Principles of Helicopter Aerodynamics, 2nd ed., 2006, equation 2.30",
    parameters={"factor": Parameter("1", 1.0, "s", 0.3, 3.0, 0.03), "torque": Parameter("1", 1.0, "s", 0.3, 3.0, None)},
    parts="first",
    channels=("Fz", "Mx", "My"),
    rivals=("mass", "rotor_speed_scale", "accelerometer_scale"),
    tie_breaker="roll and pitch doublets: a mass leaves their effectiveness alone",
    terms=_terms,
    always_tied_with=("rotor_speed_scale",),
    absorbed_by_model=True,
)
