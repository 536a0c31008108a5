"""Commanded speeds by a map that is identified on the flight, against rotors that are integrated here by hand."""

import numpy as np
import pandas as pd
import pytest

from quasi.gap.levels.drive.fit import commanded
from quasi.importing.command_map import add_commanded_speeds
from quasi.tables import IDENTIFIED_MAP, drop_identified_commands

RATE, TAU, DELAY, EXPONENT = 500.0, 0.04, 0.012, 0.8
MAPS = np.array([[320.0, 2500.0, -700.0], [300.0, 2600.0, -650.0], [340.0, 2450.0, -720.0], [310.0, 2550.0, -600.0]])
NOISE = 8.0  # rad/s


def flown(seed: int, seconds: float = 40.0, sagging: bool = True) -> tuple[pd.DataFrame, np.ndarray]:
    """A flight whose rotors follow their commands, and the commanded speeds (n, 4) that the map truly asks for."""
    draw = np.random.default_rng(seed)
    fine = 4  # Euler steps per sample
    t = np.arange(round(seconds * RATE * fine)) / (RATE * fine)
    waves = np.stack(
        [sum(np.sin(2 * np.pi * f * t + draw.uniform(0, 6.3)) for f in (0.3, 0.9, 2.1, 5.3)) for _ in MAPS]
    )
    command = np.clip(0.45 + 0.08 * waves, 0.05, 0.95)
    volts = 16.4 - (2.0 * t / t[-1] if sagging else 0.0 * t)
    ratio = (volts / np.median(volts)) ** EXPONENT
    wanted = ratio * (MAPS[:, :1] + MAPS[:, 1:2] * command + MAPS[:, 2:] * command**2)
    late = np.stack([np.interp(t - DELAY, t, row) for row in wanted])
    speed = late.copy()
    for k in range(1, len(t)):
        speed[:, k] = speed[:, k - 1] + (late[:, k - 1] - speed[:, k - 1]) / (RATE * fine * TAU)
    kept = slice(None, None, fine)
    speed = speed[:, kept] + NOISE * draw.standard_normal(speed[:, kept].shape)
    columns = {"t": t[kept], "battery_voltage": volts[kept]}
    columns |= {f"command{i + 1}": command[i, kept] for i in range(4)} | {f"w{i + 1}": speed[i] for i in range(4)}
    return pd.DataFrame(columns), wanted[:, kept].T


def test_the_map_of_a_flight_is_found_within_its_standard_errors():
    flight, wanted = flown(1)
    notes = []
    mapped, about = add_commanded_speeds(flight, None, "a", notes)
    assert about["source"] == IDENTIFIED_MAP
    for name, true in (("time constant", TAU), ("delay", DELAY), ("voltage exponent", EXPONENT)):
        assert abs(about[name]["value"] - true) < 4 * about[name]["std"] + 1e-3, name
    found, std = (np.array(about["coefficients"][k]) for k in ("value", "std"))
    assert np.all(np.abs(found - MAPS) < 5 * std)
    assert np.all(std[:, 1] < 0.1 * MAPS[:, 1])
    # averages over 4 samples of the log keep half of its noise
    assert about["rms error"]["value"] == pytest.approx([NOISE / 2] * 4, rel=0.2)
    error = mapped[[f"w{i}_CMD" for i in range(1, 5)]].to_numpy() - wanted
    assert np.sqrt(np.mean(error**2)) < 5.0
    assert len(notes) == 1


def test_a_steady_battery_gives_no_exponent():
    about = add_commanded_speeds(flown(2, sagging=False)[0], None, "a", [])[1]
    assert about["voltage exponent"] is None
    assert about["reference voltage"] is None
    assert abs(about["time constant"]["value"] - TAU) < 2e-3


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda f: f.drop(columns=[f"w{i}" for i in range(1, 5)]), "no speeds"),
        (lambda f: f.drop(columns=[f"command{i}" for i in range(1, 5)]), "no commands"),
        (lambda f: f.assign(w2=1000.0), "rotor 2 varies"),
        (lambda f: f.iloc[:1500], "are needed"),
        (lambda f: f.assign(command3=f["command3"].to_numpy()[::-1]), "rotor 3"),
        (lambda f: f.assign(w1=3000.0 - f["w1"]), "rotor 1"),
    ],
    ids=["no telemetry", "no commands", "still", "short", "command of another time", "falling"],
)
def test_nothing_is_made_where_the_flight_shows_no_map(change, why):
    flight = change(flown(3, seconds=20.0)[0])
    result, about = add_commanded_speeds(flight, None, "a", [])
    assert list(result) == list(flight)
    assert about["source"] is None
    assert why in about["why"]


def test_identified_speeds_take_no_part_in_what_judges_the_drive():
    class Flown:
        pass

    flight = Flown()
    flight.filtered, about = add_commanded_speeds(flown(4, seconds=20.0)[0], None, "a", [])
    flight.metadata = {"commanded speeds": about}
    assert commanded(flight) == "shares"
    assert "w1_CMD" not in drop_identified_commands(flight.filtered, flight.metadata)
    flight.metadata = {"commanded speeds": {"source": "logged"}}
    assert commanded(flight) == "speeds"
    assert "w1_CMD" in drop_identified_commands(flight.filtered, flight.metadata)
