"""Drag of the frame, with the square of the speed."""

from quasi.gap.effect import Effect, Parameter, Vehicle

_SPEED = "(u^2 + v^2 + w^2)^0.5"


def _terms(_: Vehicle) -> dict[str, dict[str, str]]:
    return {
        "c": {"Fx": f"-{_SPEED}*u", "Fy": f"-{_SPEED}*v", "Fz": f"-{_SPEED}*w"},
        "cz": {"Mx": f"{_SPEED}*v", "My": f"-{_SPEED}*u"},  # r x F, r = (0, 0, z)
        "vertical": {"Fz": f"-{_SPEED}*w"},
    }


EFFECT = Effect(
    id="body_drag",
    level="forces",
    sentence="the frame drags through the air with the square of the speed",
    opposite="the frame drags less through the air than the model says",
    equation="F = -c |V| V, of a flat frame more along z: -vertical |V| w; at a centre of pressure z below the cg: "
    "M = cz |V| (v, -u, 0)",
    source="Hoerner, Fluid-Dynamic Drag, 1965, chapter 3",
    parameters={
        "c": Parameter("N s2/m2", 0.0, "a", -0.1, 0.5, lambda v: 0.12 * v.weight / v.hover_induced**2),
        "cz": Parameter("N s2/m", 0.0, "a", -0.02, 0.02),
        "vertical": Parameter("N s2/m2", 0.0, "a", -0.1, 1.0),
    },
    channels=("Fx", "Fy", "Fz", "Mx", "My"),
    parts="led",
    rivals=("rotor_drag", "wind"),
    tie_breaker="fly a 2:1 range of speeds with throttle changes",
    terms=_terms,
)
