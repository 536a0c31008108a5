"""Thrust that is not the square of rotor speed.

The term linear in speed alone. A constant c0 of each rotor is a constant force, which mass and accelerometer make too,
and with c1 it imitates a factor of the thrust: T = c0 + c1 W is a tangent of W^2 over the speeds of a flight.
"""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, number, thrust_wrench


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    """Thrust, and the torque that its flow draws."""
    drawn = [number(-s * vehicle.drawn / vehicle.thrust) for s in vehicle.spin]
    torque = " + ".join(f"{d}*w{i}" for i, d in enumerate(drawn, 1))
    return {"c1": {**thrust_wrench(vehicle, [f"w{i}" for i in range(1, 5)]), "Mz": torque}}


EFFECT = Effect(
    id="thrust_curve",
    level="forces",
    sentence="thrust does not follow the square of rotor speed",
    equation="T = c1 W + c2 W^2, and the torque that its flow draws",
    source="static thrust tests: Deters, Ananda & Selig, AIAA 2014-2151",
    parameters={"c1": Parameter("N s/rad", 0.0, "a", -1e-3, 1e-3, lambda v: 0.03 * v.thrust * v.hover_speed)},
    channels=("Fz", "Mx", "My"),
    rivals=("battery_sag", "axial_inflow"),
    tie_breaker="steps of throttle at rest in the air",
    terms=_terms,
)
