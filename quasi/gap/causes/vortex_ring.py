"""Thrust lost in its own wake."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, hub_velocity, number, positive, thrust_wrench


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    thrusts = []
    for i in range(4):
        ratio = f"{hub_velocity(vehicle, i)[2]}/{number(vehicle.hover_induced)}"
        bump = f"({positive(ratio)}*{positive(f'2 - {ratio}')})^2"
        thrusts.append(f"-{number(vehicle.thrust)}*w{i + 1}^2*{bump}")
    return {"depth": thrust_wrench(vehicle, thrusts)}


EFFECT = Effect(
    id="vortex_ring",
    level="forces",
    sentence="thrust is lost in a fast descent, in the rotors' own wake",
    opposite="less thrust is lost in a fast descent than the model says",
    equation="T = T0 (1 - depth b(w/v_h)), b = (x (2 - x))^2 for 0 < x < 2",
    source="Leishman, Principles of Helicopter Aerodynamics, 2nd ed., 2006, section 2.13.6",
    parameters={"depth": Parameter("1", 0.0, "a", -1.0, 1.0, 0.3)},
    channels=("Fz",),  # the ring is unsteady: from rotor to rotor the loss differs at random, and so do the moments
    rivals=("gusts", "axial_inflow", "thrust_drift"),
    tie_breaker="descents at several speeds; the residual's variance grows with descent ratio alone",
    terms=_terms,
)
