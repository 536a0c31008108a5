"""Hub moments of flapping blades."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, hub_velocity, total


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    moments: list[Terms] = []
    for i in range(4):
        u, v, _ = hub_velocity(vehicle, i)
        moments.append({"Mx": f"-w{i + 1}*{v}", "My": f"w{i + 1}*{u}"})
    return {"k": total(moments)}


EFFECT = Effect(
    id="blade_flapping",
    level="forces",
    sentence="the rotors pitch the nose up in forward flight and push the left side down when sliding right",
    opposite="the rotors pitch the nose up less in forward flight than the model says",
    equation="M = k W (z x V) = k W (-v, u, 0) at each hub",
    source="Bramwell, Done & Balmford, Bramwell's Helicopter Dynamics, 2nd ed., 2001, chapter 3",
    parameters={"k": Parameter("N m s2/(m rad)", 0.0, "a", -1e-5, 1e-5, lambda v: 0.015 * v.weight * v.arm / v.flow)},
    channels=("Mx", "My"),
    rivals=("rotor_drag", "rotor_interference"),
    tie_breaker="pure rate inputs at zero airspeed, then the same speeds at 0, 45 and 90 deg sideslip",
    terms=_terms,
)
