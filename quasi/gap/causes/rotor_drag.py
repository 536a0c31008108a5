"""Drag of the rotors in the flow along their discs."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, hub_velocity, total


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    forces: list[Terms] = []
    moments: list[Terms] = []
    turning: list[Terms] = []
    for i, (x, y, z) in enumerate(vehicle.hubs):
        u, v, _ = hub_velocity(vehicle, i)
        forces.append({"Fx": f"-w{i + 1}*{u}", "Fy": f"-w{i + 1}*{v}"})
        # the rotor plane's height above the cg is rarely configured: its lever is a parameter of its own
        forces[-1] |= {"Mx": f"({z})*w{i + 1}*{v}", "My": f"-({z})*w{i + 1}*{u}"}
        moments.append({"Mx": f"-w{i + 1}*{v}", "My": f"w{i + 1}*{u}"})
        # shares of the hubs nearly cancel in yaw, and drag of frame and guards adds to them
        turning.append({"Mz": f"w{i + 1}*({y}*{u} - ({x})*{v})"})
    return {"k": total(forces), "lever": total(moments), "yaw": total(turning)}


EFFECT = Effect(
    id="rotor_drag",
    level="forces",
    sentence="the rotors drag through the air in proportion to speed and rotor speed",
    opposite="the rotors drag less through the air than the model says",
    equation="H_i = -k W_i V_i,xy at each hub; lever = k times the height of the rotor plane above the configured hubs"
    ", yaw = k as far as it acts at the hubs",
    source="Mahony, Kumar & Corke, Multirotor aerial vehicles, IEEE RAM 19(3), 2012, equation 11",
    parameters={
        "k": Parameter("N s2/(m rad)", 0.0, "a", -1e-3, 1e-3, lambda v: 0.15 * v.weight / v.flow),
        "lever": Parameter("N m s2/(m rad)", 0.0, "a", -5e-5, 5e-5),
        "yaw": Parameter("N s2/(m rad)", 0.0, "a", -1e-3, 1e-3),
    },
    channels=("Fx", "Fy", "Mx", "My"),
    rivals=("body_drag", "wind", "blade_flapping"),
    tie_breaker="fly the same speeds at different throttle, out and back",
    terms=_terms,
    parts="first",
)
