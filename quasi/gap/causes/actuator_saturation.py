"""Commands at a limit."""

from quasi.gap.effect import Effect

EFFECT = Effect(
    id="actuator_saturation",
    level="drive",
    sentence="commands sit at a limit, where a simulation without one goes on",
    equation="share of samples at the highest or lowest command, where commands pile up",
    source="definition",
    channels=("w1", "w2", "w3", "w4"),
    rivals=("battery_sag", "motor_lag"),
    tie_breaker="fly again with less thrust, or raise the limit",
    finding=True,
)
