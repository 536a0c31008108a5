"""More thrust in the flow along the discs."""

from quasi.gap.effect import Effect, Parameter, Vehicle


def _terms(_: Vehicle) -> dict[str, dict[str, str]]:
    return {"k": {"Fz": "-(u^2 + v^2)"}}


EFFECT = Effect(
    id="translational_lift",
    level="forces",
    sentence="the rotors make more thrust in sideways and forward flight",
    opposite="the rotors make less thrust in sideways and forward flight than the model says",
    equation="dFz = -k (u^2 + v^2)",
    source="Leishman, Principles of Helicopter Aerodynamics, 2nd ed., 2006, section 2.14",
    parameters={"k": Parameter("N s2/m2", 0.0, "a", -0.1, 0.1, lambda v: 0.1 * v.weight / v.hover_induced**2)},
    channels=("Fz",),
    rivals=("imu_misalignment", "rotor_interference"),
    tie_breaker="steps of speed at constant height, both ways",
    terms=_terms,
)
