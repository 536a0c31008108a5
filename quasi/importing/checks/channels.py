"""Channels of gyro and accelerometer that keep one value in flight."""

from collections.abc import Mapping

import numpy as np

from quasi.importing.checks.spans import InvalidSpan, constant_runs, is_quiet, log_step

SENSOR_CHANNELS = {"gyro": ("p", "q", "r"), "accelerometer": ("ax", "ay", "az")}
# s: a gyro that logs whole deg/s repeats a value for 0.16 s at most in flight of the recordings that the tests read
SHORTEST_FREEZE = 1.0


def frozen_sensor_spans(
    t: np.ndarray, values: Mapping[str, np.ndarray], flying: np.ndarray | None
) -> list[InvalidSpan]:
    """Spans in which a channel is constant while the quadrotor flies; none where it is not known when it flies.

    t (n,) s; values {quantity: (n,)}, NaN where missing; flying (n,) bool or None
    """
    spans: list[InvalidSpan] = []
    if flying is None:
        return spans
    for sensor, names in SENSOR_CHANNELS.items():
        for name in (n for n in names if n in values):
            step = log_step(values[name])
            for a, b in constant_runs(t, np.where(flying, values[name], np.nan), SHORTEST_FREEZE):
                if not is_quiet(values[name], a, b, step):
                    spans.append(
                        InvalidSpan(float(t[a]), float(t[b - 1]), f"{sensor} channel '{name}' is constant in flight")
                    )
    return spans
