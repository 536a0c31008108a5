"""The logs of benchmarks/foreign.py: axes, units and clocks, by a motion whose signs are known."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from foreign_flights import Motion, Sensors, Vehicle, film, measure, write_arrays, write_csv, write_vicon

from quasi.importing.flight import import_flight

HUBS = np.array([[0.1, 0.1, 0.0], [0.1, -0.1, 0.0], [-0.1, -0.1, 0.0], [-0.1, 0.1, 0.0]])


def motion():
    """It waits, then moves forward, to the left and up, and turns left, nose down and left side up."""
    t = np.arange(0.0, 14.0, 0.004)
    s = np.clip((t - 4.0) / 8.0, 0.0, 1.0)
    way, speed = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / 8.0
    wobble = 0.2 * np.sin(3.0 * t) * np.sin(np.pi * s) ** 2
    turns = Rotation.from_euler("ZYX", np.column_stack([1.2 * way, wobble, np.roll(wobble, 100)]))
    rates = np.gradient(turns.as_matrix(), t, axis=0)
    skew = np.einsum("nji,njk->nik", turns.as_matrix(), rates)
    rates = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    velocity = np.outer(speed, [2.0, 1.0, 0.5])
    force = turns.inv().apply(np.gradient(velocity, t, axis=0) + [0.0, 0.0, 9.81])
    speeds = 500.0 + np.outer(np.sin(np.pi * s), [10.0, 20.0, 30.0, 40.0])
    return Motion(t, np.outer(way, [2.0, 1.0, 0.5]), turns.as_quat(), rates, np.gradient(rates, t, axis=0), force,
                  speeds, speeds / 1000.0)  # fmt: skip


@pytest.mark.parametrize("arrays", [False, True])
def test_a_foreign_log_is_read_with_the_axes_it_was_flown_in(tmp_path, arrays):
    places = {"front left": 1, "front right": 2, "aft right": 3, "aft left": 4}
    vehicle = Vehicle("craft", 0.5, (3e-3, 3e-3, 6e-3), HUBS, "CW", 0.1, 1000.0, places, arrays)
    truth, rng = motion(), np.random.default_rng(1)
    board, capture = measure(truth, Sensors(vibration=0.0), rng), film(truth, Sensors(), rng)
    if arrays:
        write_arrays(tmp_path / "a.npz", board, capture)
    else:
        write_csv(tmp_path / "a.csv", board)
        write_vicon(tmp_path / "b.csv", capture)
    source = {
        "flight": "a", "quadrotor": "craft", "flight controller": "table", "log number": None,
        "rigid body": "" if arrays else "Quad", "onboard": str(tmp_path / ("a.npz" if arrays else "a.csv")),
        "capture": None if arrays else str(tmp_path / "b.csv"),
    }  # fmt: skip
    table, about = import_flight(source, vehicle.document(), {})
    assert about["verdict"] == "good"
    last, middle = table.iloc[-100], table.iloc[(table["z"] + 0.25).abs().argmin()]
    assert [last[a] for a in "xyz"] == pytest.approx([2.0, -1.0, -0.5], abs=0.02)
    assert last["yaw"] == pytest.approx(-1.2, abs=0.02)
    assert table[["ax", "ay", "az"]].iloc[:500].mean().to_numpy() == pytest.approx([0.0, 0.0, -9.81], abs=0.2)
    # half a turn about x leads from the simulator's axes to quasi's
    k = np.argmin(np.abs(truth.position[:, 2] - 0.25))
    shown = table[["p", "q", "r"]].iloc[middle.name - 10 : middle.name + 10].mean().to_numpy()
    assert shown == pytest.approx(truth.rates[k - 5 : k + 5].mean(axis=0) * [1.0, -1.0, -1.0], abs=0.03)
    assert [middle[f"w{i}"] for i in range(1, 5)] == pytest.approx(truth.speeds[k], rel=0.01)
