"""More thrust in the flow along the discs."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, hub_velocity, thrust_wrench


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    # a hub that yaws into the flow has more of it: without that, roll and pitch look like another inertia about z
    squares = ["({})^2 + ({})^2".format(*hub_velocity(vehicle, i)[:2]) for i in range(4)]
    return {"k": thrust_wrench(vehicle, [f"0.25*({square})" for square in squares])}


EFFECT = Effect(
    id="translational_lift",
    level="forces",
    sentence="the rotors make more thrust in sideways and forward flight",
    opposite="the rotors make less thrust in sideways and forward flight than the model says",
    equation="dT_i = k/4 V_i,xy^2 at each hub",
    source="Leishman, Principles of Helicopter Aerodynamics, 2nd ed., 2006, section 2.14",
    parameters={"k": Parameter("N s2/m2", 0.0, "a", -0.1, 0.1, lambda v: 0.1 * v.weight / v.hover_induced**2)},
    channels=("Fz",),
    rivals=("imu_misalignment", "rotor_interference"),
    tie_breaker="steps of speed at constant height, both ways",
    terms=_terms,
)
