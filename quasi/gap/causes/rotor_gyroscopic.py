"""Gyroscopic moments of the spinning rotors."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    momentum = " + ".join(f"({s:g})*w{i}" for i, s in enumerate(vehicle.spin, 1))
    return {"inertia": {"Mx": f"-q*({momentum})", "My": f"p*({momentum})"}}


EFFECT = Effect(
    id="rotor_gyroscopic",
    level="forces",
    sentence="the spinning rotors act as gyroscopes when the vehicle turns",
    opposite="the spinning rotors act less as gyroscopes than the model says",
    equation="M = -omega x h, h = J_r sum(s_i W_i) z",
    source="Stevens, Lewis & Johnson, Aircraft Control and Simulation, 3rd ed., 2016, section 1.7",
    parameters={"inertia": Parameter("kg m2", 0.0, "a", -1e-4, 1e-4, lambda v: 1.6e-3 * v.mass * v.radius**2)},
    channels=("Mx", "My"),
    rivals=("inertia",),
    tie_breaker="yaw and pitch together",
    terms=_terms,
)
