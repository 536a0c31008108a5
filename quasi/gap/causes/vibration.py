"""Vibration in the inertial sensors."""

from quasi.gap.effect import Effect

EFFECT = Effect(
    id="vibration",
    level="sensors",
    sentence="the accelerometer vibrates",
    equation="rms of the specific force above any motion's band",
    source="definition",
    channels=("ax", "ay", "az"),
    rivals=("thrust_curve", "accelerometer_bias"),
    tie_breaker="steps of throttle: the line tracks rotor speed modulo the sampling rate",
    finding=True,
)
