"""Reaction of rotors that change speed."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    change = " + ".join(f"({s:g})*w{i}_dot" for i, s in enumerate(vehicle.spin, 1))
    return {"inertia": {"Mz": f"-({change})"}}


EFFECT = Effect(
    id="rotor_acceleration_torque",
    level="forces",
    sentence="rotors that speed up turn the vehicle the other way",
    opposite="rotors that speed up turn the vehicle less than the model says",
    equation="dMz = -J_r sum(s_i dW_i/dt)",
    source="Stevens, Lewis & Johnson, Aircraft Control and Simulation, 3rd ed., 2016, section 1.7",
    parameters={"inertia": Parameter("kg m2", 0.0, "a", -1e-4, 1e-4, lambda v: 1.6e-3 * v.mass * v.radius**2)},
    channels=("Mz",),
    rivals=("telemetry_delay", "inertia"),
    tie_breaker="sharp yaw doublets",
    terms=_terms,
)
