"""Vibration in the inertial sensors."""

from quasi.gap.effect import Effect

EFFECT = Effect(
    id="vibration",
    level="K",
    sentence="the accelerometer vibrates",
    equation="rms of the specific force above any motion's band",
    source="definition",
    channels=("ax", "ay", "az"),
    finding=True,
)
