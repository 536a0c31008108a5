"""Unrest of the air."""

from quasi.gap.effect import Effect

EFFECT = Effect(
    id="gusts",
    level="forces",
    sentence="gusts move the vehicle; they do not repeat between equal flights",
    equation="coloured force through the response of the model to airspeed; the noise floor, never fitted",
    source="MIL-F-8785C, section 3.7.2 (Dryden spectra)",
    channels=("Fx", "Fy", "Fz"),
    rivals=("wind", "vortex_ring", "payload_swing"),
    tie_breaker="fly the same trajectory twice: what does not repeat is the air",
    finding=True,
)
