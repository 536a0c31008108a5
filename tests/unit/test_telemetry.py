"""The age of the rotor telemetry, from yaw: planted delays come back, also where thrust leads in roll and pitch."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from quasi.importing import imu_and_telemetry
from quasi.importing.clocks.telemetry import Age, rotor_age, rotor_lag
from quasi.importing.onboard_log import Onboard, Track
from quasi.importing.readers.table_reader import read_table_log

RATE = 1000.0
SPIN = np.array([1.0, -1.0, -1.0, 1.0])
LEFT, FRONT = np.array([-1.0, -1.0, 1.0, 1.0]), np.array([-1.0, 1.0, -1.0, 1.0])
IZ, DRAG, ROTOR = 1.7e-3, 1.8e-9, 7e-7


def flight(age, seconds=40.0, yaw=1.0, seed=1, noise=0.5):
    """Rotor speeds that vary as in flight, and the rates that follow, with an inflow lead in roll and pitch."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1 / RATE)
    low = np.exp(-2 * np.pi * 8.0 / RATE)
    shaped = lfilter([1 - low], [1, -low], lfilter([1 - low], [1, -low], rng.normal(size=(len(t), 4)), axis=0), axis=0)
    shaped *= np.array([60.0, 80.0, 80.0, 60.0 * yaw]) / shaped.std(axis=0)
    speeds = 2100 + shaped[:, :1] + shaped[:, 1:2] * LEFT + shaped[:, 2:3] * FRONT + shaped[:, 3:] * SPIN
    acceleration = np.gradient(speeds, t, axis=0)
    leading = speeds**2 + 2 * speeds * acceleration * 0.004  # thrust before the inflow has built up
    moments = np.column_stack([leading @ LEFT * 1.3e-8, leading @ FRONT * 1.3e-8])
    rates, trapezoid = np.zeros((len(t), 3)), [0.5 / RATE, 0.5 / RATE]
    rates[:, :2] = lfilter(trapezoid, [1, -(1 - 3.0 / RATE)], moments / 1e-3, axis=0)
    torque = -(speeds**2) @ SPIN * DRAG - acceleration @ SPIN * ROTOR
    rates[:, 2] = lfilter(trapezoid, [1, -(1 - 0.5 / RATE)], torque / IZ)
    rates += rng.normal(scale=0.006, size=rates.shape)
    return t + age, speeds + rng.normal(scale=noise, size=speeds.shape), t, rates


@pytest.mark.parametrize("age", [-0.002, 0.0, 0.0031, 0.012])
def test_planted_age_is_found_within_its_standard_error_whatever_roll_and_pitch_do(age):
    found = rotor_age(*flight(age))
    assert found.value == pytest.approx(age, abs=max(4 * found.std, 0.2e-3))
    assert found.std < 0.5e-3
    assert found.explained > 0.9


@pytest.mark.parametrize("repeated", [1, 4])
def test_noise_of_the_speeds_does_not_age_them(repeated):
    """Noise makes the reaction to a rotor's acceleration look too small; later speeds would stand in for it."""
    t_rotor, speeds, t, rates = flight(0.003, yaw=0.2, noise=40.0)
    held = np.arange(len(t)) // repeated * repeated  # a logger that is faster than the telemetry repeats its values
    found = rotor_age(t_rotor, speeds[held], t, rates)
    assert found.value == pytest.approx(0.003, abs=3 * found.std)
    assert found.std < 2e-3


def test_an_age_beyond_those_that_are_tried_is_not_precise():
    found = rotor_age(*flight(0.06))
    assert found.std > 0.04


def test_flight_without_yaw_is_honest_about_it():
    sharp, dull = rotor_age(*flight(0.003)), rotor_age(*flight(0.003, yaw=0.01))
    assert dull.std > 3 * sharp.std


@pytest.mark.parametrize("late", [-0.03, 0.04])
def test_yaw_takes_off_a_lag_by_roll_and_pitch_what_inflow_and_damping_add(late, tmp_path):
    t_rotor, speeds, t, rates = flight(late)
    names = {"imu": ("p", "q", "r"), "motors": ("w1", "w2", "w3", "w4")}
    columns = {"t": t, "stamp": t_rotor} | dict(zip(names["imu"], rates.T)) | dict(zip(names["motors"], speeds.T))
    pd.DataFrame(columns).iloc[::4].to_csv(tmp_path / "log.csv", index=False)
    sources = [{"name": n, "time": k, "columns": {c: c for c in names[n]}} for n, k in zip(names, ("t", "stamp"))]
    lag = read_table_log(tmp_path / "log.csv", {"time": "t", "sources": sources}).metadata["sources"]["motors"]
    lag = lag["lag of main stamps"]
    assert lag["applied"] and abs(lag["value"] + late) < max(4 * lag["std"], 0.5e-3), lag


@pytest.mark.parametrize("late", [0.0, 0.03])
@pytest.mark.parametrize("damping", [0.0, 6.0])
def test_slow_turns_that_are_damped_do_not_look_like_speeds_that_are_late(late, damping):
    t, rng = np.arange(0.0, 40.0, 1 / 250.0), np.random.default_rng(3)
    slow = sum(np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0.0, 6.0, 2)) for f in (0.3, 0.5, 0.8, 1.1))
    speeds = 500.0 + slow @ np.array([LEFT, FRONT]) * 5.0
    push = speeds**2 @ np.column_stack([LEFT, FRONT]) * 1e-4
    rates = lfilter([0.5 / 250.0] * 2, [1.0, damping / 250.0 - 1.0], push, axis=0)
    rates = np.column_stack([rates, 0.0 * t]) + rng.normal(scale=0.003, size=(len(t), 3))
    found = rotor_lag(t + late, speeds + rng.normal(scale=0.3, size=speeds.shape), t, rates)
    assert found.lag == pytest.approx(-late, abs=max(4 * found.lag_std, 1e-3))
    assert found.lag_std < 2e-3


def test_short_or_grounded_record_tells_nothing():
    t_rotor, speeds, t, rates = flight(0.003, seconds=4.0)
    assert rotor_age(t_rotor, speeds, t, rates) is None
    t_rotor, speeds, t, rates = flight(0.003)
    speeds = np.where(t_rotor[:, None] < 38.0, 0.0, speeds)
    assert rotor_age(t_rotor, speeds, t, rates) is None


@pytest.mark.parametrize(
    ("age", "late", "taken"),
    [(0.004, 0.0, True), (-0.0005, 0.0, True), (-0.0015, 0.0, False), (-0.0015, 2e-3, True), (-0.0099, 2e-3, False)],
)
def test_telemetry_that_would_run_ahead_of_the_motion_is_not_corrected(age, late, taken, monkeypatch):
    """By more than the gyro's own delay is uncertain, which is part of the age's standard error."""
    t = np.arange(100) / 100.0
    track = Track(t, np.zeros((100, 4)))
    delays = {"gyro": {"std": late}}
    board = Onboard(track, track, track, "onboard", 0.0, None, None, None, {"w1": track}, track, delays)
    monkeypatch.setattr(imu_and_telemetry, "rotor_age", lambda *_: Age(age, 1e-4, 0.99))
    notes = []
    settled, about = imu_and_telemetry.remove_telemetry_age(board, "here", notes)
    assert about["applied"] == taken and bool(notes) != taken
    assert taken or "the rotor telemetry seems to be ahead of the gyro" in notes[0]
    assert about["age"]["std"] == pytest.approx(np.hypot(1e-4, late))
    expected = t - (age if taken else 0.0)
    np.testing.assert_allclose(settled.rotors.t, expected)
    np.testing.assert_allclose(settled.others["w1"].t, expected)
