"""Rear rotors in the wake of the front ones."""

from math import hypot

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, number, positive, thrust_wrench


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    speed2 = "(u^2 + v^2)"
    plane = f"({speed2}/{number(vehicle.hover_induced**2)})"
    wake = f"({plane}/(0.16 + {plane}))"
    thrusts = []
    for i, (x, y, _) in enumerate(vehicle.hubs):
        behind = positive(f"-({number(x)}*u + {number(y)}*v)/{number(hypot(x, y))}")
        share = f"{wake}*{behind}^2/({speed2} + 1e-6)"
        thrusts.append(f"-{number(vehicle.thrust)}*w{i + 1}^2*{share}")
    return {"k": thrust_wrench(vehicle, thrusts)}


EFFECT = Effect(
    id="rotor_interference",
    level="forces",
    sentence="the rear rotors lose thrust in the wake of the front ones",
    opposite="the rear rotors lose less thrust in the wake of the front ones than the model says",
    equation="T_i = T0 (1 - k s b_i^2), b_i how far rotor i lies behind, s = m/(0.16 + m), m = (u^2 + v^2)/v_h^2",
    source="effects of wakes on following rotors: Ventura Diaz & Yoon, AIAA 2018-1266, section 4",
    parameters={"k": Parameter("1", 0.0, "a", -0.5, 0.8, 0.1)},
    channels=("Fz", "Mx", "My"),
    rivals=("blade_flapping", "rotor_drag", "translational_lift"),
    tie_breaker="fly the same speed at 0, 45 and 90 deg sideslip",
    terms=_terms,
)
