"""Thrust lost in a climb, won in a descent."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, hub_velocity, thrust_wrench


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    wrench = thrust_wrench(vehicle, [f"w{i + 1}*{hub_velocity(vehicle, i)[2]}" for i in range(4)])
    # what rolling and pitching add has other sources as well: a size of its own
    return {"k": {"Fz": wrench["Fz"]}, "damping": {axis: wrench[axis] for axis in ("Mx", "My")}}


EFFECT = Effect(
    id="axial_inflow",
    level="forces",
    sentence="the rotors lose thrust in a climb and win it in a descent",
    opposite="the rotors lose less thrust in a climb, and win less in a descent, than the model says",
    equation="dT = -k W V_climb at each hub, V_climb = -w; damping = k as far as it damps roll and pitch",
    source="Leishman, Principles of Helicopter Aerodynamics, 2nd ed., 2006, section 3.3",
    parameters={
        "k": Parameter(
            "N s2/(m rad)", 0.0, "a", -1e-3, 1e-3, lambda v: 0.35 * v.weight / (4.0 * v.hover_speed * v.hover_induced)
        ),
        "damping": Parameter("N s2/(m rad)", 0.0, "a", -1e-3, 1e-3),
    },
    channels=("Fz", "Mx", "My"),
    rivals=("body_drag", "vortex_ring"),
    tie_breaker="a vertical sine at two amplitudes",
    terms=_terms,
    parts="first",
)
