"""A position, velocity or accelerometer that is late, and a velocity in the body's axes, against the other sources."""

import numpy as np
import pandas as pd
import pytest

from quasi.attitude import GRAVITY, body_rates, from_euler, rotate_inverse
from quasi.errors import cautions
from quasi.importing import flight as importing

GYRO, FORCE, Q = ("p", "q", "r"), ("ax", "ay", "az"), ("qw", "qx", "qy", "qz")
PLACE, VELOCITY, ROTORS = ("x", "y", "z"), ("vx", "vy", "vz"), ("w1", "w2", "w3", "w4")
RATE = 100.0  # Hz
ALL = (*GYRO, *FORCE, *Q, *PLACE, *VELOCITY, *ROTORS)


@pytest.fixture(scope="module")
def logged():
    """Columns of a flight with small angles that are those of its acceleration, noise on each sensor."""
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 30.0, 1.0 / RATE)
    waves = [(rng.uniform(0.2, 0.7, 4), rng.uniform(0.0, 2.0 * np.pi, 4)) for _ in range(3)]
    place = 0.1 * np.stack([np.sin(2 * np.pi * np.outer(t, f) + p).sum(axis=1) for f, p in waves], axis=-1)
    velocity = np.gradient(place, t, axis=0)
    acceleration = np.gradient(velocity, t, axis=0)
    yaw = 0.05 * np.sin(0.8 * t)
    q = from_euler(acceleration[:, 1] / GRAVITY, -acceleration[:, 0] / GRAVITY, yaw)
    force = rotate_inverse(q, acceleration - np.array([0.0, 0.0, GRAVITY]))
    columns = {"t": t} | dict(zip(Q, q.T))
    for names, values, noise in (
        (GYRO, body_rates(q, t), 0.01), (FORCE, force, 0.1), (PLACE, place, 1e-4), (VELOCITY, velocity, 1e-3),
    ):  # fmt: skip
        columns |= dict(zip(names, (values + rng.normal(0.0, noise, values.shape)).T))
    return columns | {n: 800.0 + 20.0 * np.sin(3.0 * t + i) for i, n in enumerate(ROTORS)}


def late(columns, names, seconds):
    steps = round(seconds * RATE)
    rows = np.clip(np.arange(len(columns["t"])) - steps, 0, None)
    return columns | {n: columns[n][rows] for n in names}


def in_body(columns):
    q, velocity = (np.stack([columns[n] for n in names], axis=-1) for names in (Q, VELOCITY))
    return columns | dict(zip(VELOCITY, rotate_inverse(q, velocity).T))


def contradictions(columns, folder, names=ALL):
    pd.DataFrame(columns).to_csv(folder / "log.csv", index=False)
    config = {"table columns": {"time": "t", "sources": [{"name": "log", "columns": {n: n for n in names}}]}}
    asked = {"flight": "made", "quadrotor": "made", "flight controller": "table", "capture": None}
    asked |= {"onboard": str(folder / "log.csv")}
    _, about = importing.import_flight(asked, config, {"resampling rate": RATE, "use onboard attitude": True})
    assert (about["verdict"] == "unusable") == bool(about["contradictions"])
    return about["contradictions"]


MOTION = (*PLACE, *VELOCITY), {"delay of the position", "delay of the velocity"}
MEASURED = FORCE, {"delay of the accelerometer"}


@pytest.mark.parametrize(
    ("names", "quantities", "seconds"), [(*MOTION, 0.5), (*MOTION, 0.2), (*MOTION, -0.3), (*MEASURED, 0.2)]
)
def test_what_is_late_on_board_is_named_with_its_delay(logged, tmp_path, names, quantities, seconds):
    found = contradictions(late(logged, names, abs(seconds)) if seconds > 0 else ahead(logged, names), tmp_path)
    assert {c["quantity"] for c in found} == quantities
    assert all(c["value"] == pytest.approx(seconds, abs=0.02) for c in found)


def ahead(columns, names):
    """All but `names` 0.3 s late."""
    return late(columns, [n for n in ALL if n not in names], 0.3)


def test_a_velocity_in_the_axes_of_the_body_is_none_in_those_of_the_earth(logged, tmp_path):
    [found] = contradictions(in_body(logged), tmp_path)
    assert set(found["between"]) == {"accelerometer", "on-board velocity"} and found["quantity"] == "frame"


@pytest.mark.parametrize("seconds", [0.0, 0.02])
def test_what_fits_or_nearly_does_is_no_contradiction(logged, tmp_path, seconds):
    assert contradictions(late(logged, (*PLACE, *VELOCITY), seconds), tmp_path) == []


def test_a_hover_says_nothing_of_times_and_axes(logged, tmp_path):
    rng, n = np.random.default_rng(3), len(logged["t"])
    still = logged | {n_: rng.normal(0.0, 0.01, n) for n_ in (*GYRO, *PLACE, *VELOCITY)}
    still |= {"ax": rng.normal(0.0, 0.1, n), "ay": rng.normal(0.0, 0.1, n), "az": rng.normal(-GRAVITY, 0.1, n)}
    still |= {"qw": np.ones(n), "qx": np.zeros(n), "qy": np.zeros(n), "qz": np.zeros(n)}
    assert contradictions(still, tmp_path) == []


def new_cautions(columns, logged, folder):
    """Cautions that the import of `columns` has beyond those of the flight as it was logged."""
    found = []
    for values in (columns, logged):
        pd.DataFrame(values).to_csv(folder / "log.csv", index=False)
        config = {"table columns": {"time": "t", "sources": [{"name": "log", "columns": {n: n for n in ALL}}]}}
        asked = {"flight": "made", "quadrotor": "made", "flight controller": "table", "capture": None}
        asked |= {"onboard": str(folder / "log.csv")}
        _, about = importing.import_flight(asked, config, {"resampling rate": RATE, "use onboard attitude": True})
        found.append(cautions(about["notes"]))
    return [c for c in found[0] if c not in found[1]]


def test_a_position_that_jumps_and_stays_there_is_reported_with_its_time(logged, tmp_path):
    jumped = logged | {"x": logged["x"] + 1.0 * (logged["t"] > 15.0)}
    [found] = new_cautions(jumped, logged, tmp_path)
    assert " 1 m at 15.0 s" in found


def test_late_samples_of_a_position_are_no_jump(logged, tmp_path):
    rows = np.arange(len(logged["t"]))
    rows[1500:1515] = 1500  # 0.15 s without a new one
    assert new_cautions(logged | {n: logged[n][rows] for n in PLACE}, logged, tmp_path) == []
