"""One rotor weaker than the others."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, number, thrust_wrench, total

LEVERS_KNOWN = 0.1  # share, from rotors planted in real recordings: docs/measured.md


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    result = {}
    for i in range(1, 5):
        thrusts = ["", "", "", ""]
        thrusts[i - 1] = f"{number(vehicle.thrust)}*w{i}^2"
        yaw = {"Mz": f"{number(-vehicle.spin[i - 1] * vehicle.drawn)}*w{i}^2"}
        result[f"rotor{i}"] = total([thrust_wrench(vehicle, thrusts), yaw])
    return result


EFFECT = Effect(
    id="rotor_effectiveness",
    level="forces",
    sentence="one rotor makes less or more thrust than its speed says (chipped or wrong propeller)",
    equation="T_i = e_i T0_i: dFz : dMx : dMy in the ratio of the hub's place, dMz by the power saved",
    source="definition",
    parameters={f"rotor{i}": Parameter("1", 1.0, "s", 0.3, 2.0, 0.1) for i in range(1, 5)},
    channels=("Fz", "Mx", "My"),
    rivals=("cg_offset", "rotor_tilt"),
    tie_breaker="heave with a large range of thrust, and steps of each axis",
    terms=_terms,
    absent_when_healthy=True,
    form_uncertainty=LEVERS_KNOWN,
)
