"""Conditions of made data sets at random: noise, vibration, filters, delays and sessions of one vehicle's world."""

import math
from typing import Any

import numpy as np

from quasi_synthesis.conditions import FIRMWARES


def draw_world(seed: int) -> dict[str, Any]:
    """Conditions and log rate of one data set, drawn from a seed, as keys of a campaign."""
    rng = np.random.default_rng([seed, 29])

    def log_uniform(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    firmware = str(rng.choice(FIRMWARES))
    kinds = ("PT1", "biquad") if firmware < "4.3" else ("PT1", "PT2", "biquad")
    return {
        "log rate": int(rng.choice([250, 500, 1000, 2000])),
        "accelerometer noise": log_uniform(0.05, 1.0),
        "gyro noise": log_uniform(0.05, 1.5),
        "structural modes": {
            axis: {
                "frequency": log_uniform(10.0, 60.0),
                "damping": float(rng.uniform(0.02, 0.05)),
                "acceleration": log_uniform(0.1, 1.0),
                "rate": log_uniform(0.1, 1.0),
            }
            for axis in "xyz"
        },
        "filters": {
            "firmware": firmware,
            "gyro": [
                {"type": str(rng.choice(kinds)), "cutoff": float(round(rng.uniform(low, high)))}
                for low, high in ((100.0, 300.0), (250.0, 500.0))
            ],
            "accelerometer": float(rng.choice([25.0, 50.0, 100.0])),
        },
        "sensor delay": {name: float(rng.uniform(0.0, 0.001)) for name in ("gyro", "accelerometer")},
        "telemetry": {name: float(rng.uniform(0.0, 0.1)) for name in ("lost", "repeated")},
        "sessions": {"between": 0.02, "within": 0.005},
        "fixed heading": bool(rng.random() < 0.25),
        "airframe": {"thrust exponent": float(rng.uniform(1.85, 2.1)), "flapping": log_uniform(0.5, 2.5)},
    }
