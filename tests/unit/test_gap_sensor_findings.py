"""Errors of IMU against capture that no cause explains: found where they come back, not where noise grew."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from quasi.gap.levels.sensors.findings import NO_CAUSE, errors_beyond_references

ROWS, RATE = 600, 20.0
UNITS = {"p": "rad/s", "down": "m/s2"}


def flight(seed, compared, sensed=0.0, noise=1.0, effort=1.0):
    """A flight and the errors of its sensors; sensed  share of the downward acceleration that the gyro reads."""
    random = np.random.default_rng(seed)
    t = np.arange(ROWS) / RATE
    down = effort * np.convolve(random.standard_normal(ROWS + 20), np.ones(21), "valid") / 4.6
    rates = effort * random.standard_normal((ROWS, 3))
    frame = pd.DataFrame(rates, columns=["p", "q", "r"]).assign(ax=0.0, ay=0.0, az=down)
    left = 0.002 * noise * random.standard_normal((ROWS, 2))
    left[:, 0] += sensed * down
    key = f"f{seed}"
    rows = pd.DataFrame({"t": t, "flight": key, "p_after": left[:, 0], "down_after": left[:, 1]})
    return SimpleNamespace(key=key, compared=compared, filtered=frame), rows


def found(references, others, **how):
    made = [flight(k, False) for k in range(references)] + [flight(10 + k, True, **how) for k in range(others)]
    return errors_beyond_references([f for f, _ in made], pd.concat([r for _, r in made]), UNITS, 0.01)


def test_a_gyro_that_feels_acceleration_is_found_in_its_channel_with_its_size():
    [finding] = found(6, 2, sensed=0.006)
    assert finding["id"] == NO_CAUSE
    assert finding["evidence"]["channel"] == "p"
    assert finding["evidence"]["size"] == pytest.approx(0.006, rel=0.3)


@pytest.mark.parametrize(
    ("references", "others", "how"),
    [
        (6, 2, {}),
        (6, 3, {"noise": 3.0}),  # a log that folds more vibration
        (6, 2, {"sensed": 0.006, "effort": 40.0, "noise": 1e-3}),  # errors grew less than the motion
        (1, 2, {"sensed": 0.006}),
        (6, 1, {"sensed": 0.006}),
    ],
)
def test_noise_effort_and_single_flights_make_no_finding(references, others, how):
    if how.get("effort"):
        how = {**how, "sensed": how["sensed"] / 20.0}
    assert not found(references, others, **how)
