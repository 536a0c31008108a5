"""Thrust that fades with time."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, number, thrust_wrench


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    up = thrust_wrench(vehicle, [f"{number(vehicle.thrust)}*w{i}^2*t" for i in range(1, 5)])
    yaw = " + ".join(f"{number(-s * vehicle.drawn)}*w{i}^2*t" for i, s in enumerate(vehicle.spin, 1))
    return {"rate": {**up, "Mz": yaw}}


EFFECT = Effect(
    id="thrust_drift",
    level="forces",
    sentence="thrust at the same rotor speed changes steadily during a flight (heating)",
    equation="T = T0 (1 + rate t), t since the log began, and the power that thrust draws with it",
    source="definition",
    parameters={"rate": Parameter("1/s", 0.0, "a", -0.01, 0.01, 5e-4)},
    channels=("Fz", "Mx", "My"),
    rivals=("battery_sag", "thrust_factor"),
    tie_breaker="a pause at rest: sag recovers and tracks volts, heating cools",
    terms=_terms,
    absent_when_healthy=True,
)
