"""One rotor that turns slower or faster than the others."""

from quasi.gap.effect import Effect

EFFECT = Effect(
    id="weak_motor",
    level="drive",
    sentence="one rotor turns slower or faster at the same command than the others",
    equation="each rotor's share of the common map from command to speed, against the mean of the four",
    source="definition",
    channels=("w1", "w2", "w3", "w4"),
    rivals=("rotor_effectiveness",),
    tie_breaker="rotor telemetry: a weak motor turns slower, a chipped propeller does not",
    finding=True,
)
