"""Thrust that is not the square of rotor speed."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, number, thrust_wrench


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    def made(of: str) -> Terms:
        """Thrust, and the torque that its flow draws."""
        thrusts = [of.format(i) for i in range(1, 5)]
        drawn = [number(-s * vehicle.drawn / vehicle.thrust) for s in vehicle.spin]
        return {**thrust_wrench(vehicle, thrusts), "Mz": " + ".join(f"{d}*{t}" for d, t in zip(drawn, thrusts))}

    return {"c1": made("w{}"), "c0": made("1")}


EFFECT = Effect(
    id="thrust_curve",
    level="forces",
    sentence="thrust does not follow the square of rotor speed",
    equation="T = c0 + c1 W + c2 W^2, and the torque that its flow draws",
    source="static thrust tests: Deters, Ananda & Selig, AIAA 2014-2151",
    parameters={
        "c1": Parameter("N s/rad", 0.0, "a", -1e-3, 1e-3, lambda v: 0.03 * v.thrust * v.hover_speed),
        "c0": Parameter("N", 0.0, "a", -1.0, 1.0),
    },
    channels=("Fz", "Mx", "My"),
    rivals=("battery_sag", "axial_inflow"),
    tie_breaker="steps of throttle at rest in the air",
    terms=_terms,
)
