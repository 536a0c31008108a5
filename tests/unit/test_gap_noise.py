"""Noise makes no cause: on flights without it, every cause of forces and moments is 0 within its standard error."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from test_unexplained import RATE, flight, ground, smooth  # noqa: F401

from quasi.gap.catalogue import catalogue
from quasi.gap.effect import room_of, vehicle_of
from quasi.gap.levels.forces.design import gather_design
from quasi.gap.statistics.candidates import Candidate
from quasi.model.model import AXES, Model

EFFECTS = {n: e for n, e in catalogue().items() if e.level == "forces" and not e.finding}
LENGTH = 2400  # rows
CUTOFF = 10.0  # Hz of the capture's velocity
ARM = 0.05  # m, by which an accelerometer's noise is brought to a moment: inertia over mass and arm
ROTOR_NOISE = 5.0  # rad/s
ERRORS = 4.5  # standard errors: one of 1e5 normal estimates is beyond them


def noisy(ground, seed, imu, capture):  # noqa: F811
    """A healthy flight: the truth makes the forces, and everything that is logged errs on its own.

    imu  m/s2 per sample; capture  m per sample, differentiated below CUTOFF
    """
    clean, rng = flight(ground, seed, rows=LENGTH), np.random.default_rng([seed, 8])
    columns = dict(clean.columns)

    def error(size, memory):
        return smooth(rng, size, memory, LENGTH)

    velocity = capture * 2.0 * np.pi * CUTOFF
    for names, size, memory in (
        ("uvw", velocity, 0.5 / CUTOFF), ("pqr", 0.01 * imu, 0.02), (("roll", "pitch", "yaw"), capture / 0.1, 0.05),
        ("xyz", capture, 0.05), (("w1", "w2", "w3", "w4"), ROTOR_NOISE, 0.01),
    ):  # fmt: skip
        columns |= {name: columns[name] + error(size, memory) for name in names}
    columns |= {f"w{i}_dot": np.gradient(columns[f"w{i}"]) * RATE for i in range(1, 5)}
    mass, scale = clean.mass, np.array([1.0, 1.0, 1.0, ARM, ARM, ARM])
    force = np.stack([error(mass * imu, 0.01) for _ in AXES], axis=1) * scale
    predicted = ground[1].predict_columns(pd.DataFrame(columns))[list(AXES)].to_numpy()
    made = dataclasses.replace(clean, columns=columns, measured=clean.measured + force, predicted=predicted)
    made.__dict__.pop("_slopes", None)
    return made


@pytest.mark.parametrize(("imu", "capture"), [(0.05, 1e-4), (0.3, 3e-4), (1.0, 1e-3)])
def test_noise_makes_no_cause_of_forces_and_moments(ground, imu, capture):  # noqa: F811
    flights, compared = [noisy(ground, k, imu, capture) for k in range(6)], [False] * 3 + [True] * 3
    vehicle = vehicle_of(Model(ground[1].document, "test"), room=room_of({"north": [-5, 5], "east": [-5, 5]}))
    design = gather_design(flights, EFFECTS, vehicle)
    assert len(design.columns.causes) > 20, design.lacking
    mixed, beyond = design.witnessed(range(6), compared), {}
    for cause, columns in design.columns.causes.items():
        for since in ("changed", "always"):
            offer = Candidate(cause, since, tuple(range(len(columns))))
            test = mixed.test(offer, (), mixed.pooled(since))
            if np.any(np.abs(test.value) > ERRORS * test.std) or test.p < 1e-4:
                beyond[cause, since] = (test.value / test.std, test.p)
    assert not beyond
