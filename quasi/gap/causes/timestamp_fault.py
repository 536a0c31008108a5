"""Torn or uneven time stamps."""

from quasi.gap.effect import Effect

EFFECT = Effect(
    id="timestamp_fault",
    level="sensors",
    sentence="a recording has gaps or uneven time stamps",
    equation="gaps and jitter of each source's samples",
    source="definition",
    channels=("clock",),
    rivals=("clock_drift",),
    tie_breaker="log at a lower rate, or on a faster card",
    finding=True,
)
