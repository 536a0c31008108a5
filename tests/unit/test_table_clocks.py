"""Sources of a table without clocks of their own: frozen rows and the lag of one source against the gyro's."""

import copy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_motion import body
from recordings import SHARED

from quasi.airframe import read_airframe
from quasi.filtering.flight import filter_flight
from quasi.importing.clocks.table_clocks import in_long_runs
from quasi.importing.flight import import_flight
from quasi.importing.readers.table_reader import read_table_log
from quasi.tables import read_json

ROOT = Path(__file__).parents[2]
NANODRONE = SHARED.parent / "nanodrone"


def table(seconds=14.0, rate=100.0, rotors_late=0.0, attitude_late=0.0):
    """Mapping and table (earth NED, body FRD, SI) of a motion; motors that make its roll and pitch acceleration."""
    truth = body(seconds, rate)
    change = np.gradient(truth.rates, truth.t, axis=0)
    squares = 800.0**2 + 4e3 * np.stack(
        [change[:, 0] + change[:, 1], change[:, 0] - change[:, 1], change[:, 1] - change[:, 0], -change.sum(axis=1)],
        axis=1,
    )
    speeds = np.sqrt(np.clip(squares, 300.0**2, None))
    columns = {"t": truth.t}
    columns |= dict(zip("pqr", truth.rates.T)) | dict(zip(("ax", "ay", "az"), truth.force.T))
    columns |= dict(zip(("qw", "qx", "qy", "qz"), delayed(truth.t, truth.quaternion, attitude_late).T))
    columns |= dict(zip(("w1", "w2", "w3", "w4"), delayed(truth.t, speeds, rotors_late).T))
    sources = [
        {"name": "imu", "columns": {n: n for n in ("p", "q", "r", "ax", "ay", "az")}},
        {"name": "attitude", "columns": {n: n for n in ("qw", "qx", "qy", "qz")}},
        {"name": "motors", "columns": {f"w{i}": f"w{i}" for i in range(1, 5)}},
    ]
    return {"time": "t", "sources": sources}, pd.DataFrame(columns)


def delayed(t, values, late):
    """Values that a row holds when their source is written `late` s after the gyro."""
    return np.stack([np.interp(t - late, t, v) for v in values.T], axis=1)


def read(folder, mapping, frame):
    path = folder / "log.csv"
    frame.to_csv(path, index=False)
    return read_table_log(path, mapping)


@pytest.mark.parametrize(("source", "late"), [("motors", 0.04), ("motors", -0.03), ("attitude", 0.05)])
def test_the_lag_of_a_source_without_a_clock_follows_from_the_motion(tmp_path, source, late):
    mapping, frame = table(**{f"{'rotors' if source == 'motors' else source}_late": late})
    recording = read(tmp_path, mapping, frame)
    lag = recording.metadata["sources"][source]["lag of main stamps"]
    assert lag["applied"] and abs(lag["value"] + late) < max(4 * lag["std"], 2e-3), lag
    series = recording.series[f"onboard {source}"]
    k = -1 if late > 0 else 50  # beyond the ends of the motion rows repeat each other
    assert series.t[k] == pytest.approx(frame["t"].iloc[k] - late, abs=3e-3)


def test_sources_that_agree_stay_where_they_are(tmp_path):
    mapping, frame = table()
    recording = read(tmp_path, mapping, frame)
    for source in ("motors", "attitude"):
        lag = recording.metadata["sources"][source]["lag of main stamps"]
        assert not lag["applied"] and abs(lag["value"]) < 2e-3
        np.testing.assert_array_equal(recording.series[f"onboard {source}"].t, frame["t"])


@pytest.mark.parametrize(("late", "moved"), [(0.008, False), (0.04, True)])
def test_stamps_of_its_own_do_not_make_a_lag_of_what_inflow_and_damping_do(tmp_path, late, moved):
    # roll and pitch lead the rotors by up to 10 ms in logs whose clocks agree, whoever stamped the rows
    mapping, frame = table(rotors_late=late)
    frame["stamp"] = frame["t"] + 3e-4
    mapping["sources"][0]["time"], mapping["sources"][2]["time"] = "t", "stamp"
    recording = read(tmp_path, mapping, frame)
    lag = recording.metadata["sources"]["motors"]["lag of main stamps"]
    assert abs(lag["value"] + late) < 2e-3 and lag["std"] < 1e-3
    assert lag["applied"] is moved


@pytest.mark.parametrize("flying", [True, False])
def test_frozen_rows_are_samples_at_rest_and_none_in_flight(tmp_path, flying):
    mapping, frame = table()
    values = [c for c in frame if c != "t"]
    frame.loc[500:560, values] = frame.loc[500, values].to_numpy()
    if not flying:
        frame.loc[480:600, ["w1", "w2", "w3", "w4"]] = 0.0
    t = read(tmp_path, mapping, frame).series["onboard"].t
    inside = np.count_nonzero((t > frame["t"][500] + 1e-6) & (t < frame["t"][560] - 1e-6))
    assert inside == (0 if flying else 59)


def test_long_runs_are_those_longer_than_the_limit():
    same = np.array([0, 1, 1, 0, 1, 1, 1, 0], bool)
    assert in_long_runs(same, 2).tolist() == [False] * 4 + [True] * 3 + [False]


@pytest.mark.skipif(not NANODRONE.is_dir(), reason=f"the nano-drone recordings are not at {NANODRONE}")
def test_a_real_flight_without_clocks_per_source_keeps_its_attitude():
    config = copy.deepcopy(read_json(ROOT / "examples/nanodrone/config/NanoDroneConfig.json"))
    for source in config["table columns"]["sources"]:
        source.pop("time")
        if source.get("motion capture"):
            source["columns"] = {n: c for n, c in source["columns"].items() if n in "xyz"}
        elif source["name"] == "state":
            source["columns"] = {
                n: c for n, c in source["columns"].items() if n not in ("x", "y", "z", "vx", "vy", "vz")
            }
    flight = {"flight": "run1", "quadrotor": "NanoDrone", "flight controller": "table", "capture": None,
              "onboard": str(NANODRONE / "square_run1.csv")}  # fmt: skip
    imported, about = import_flight(flight, config, {"resampling rate": 100.0, "use onboard attitude": True})
    lag = about["sources"]["onboard"]["sources"]["motors"]["lag of main stamps"]
    assert lag["applied"] and lag["value"] == pytest.approx(0.033, abs=0.003)  # as its declared stamps give
    found = filter_flight(imported, about, read_airframe(config, "NanoDrone"), {"bias policy": "whole flight"})
    assert np.abs(found.metadata["biases"]["accelerometer"]["value"]).max() < 0.3
    assert found.metadata["NIS"]["attitude"]["mean"] < 2.0
    valid = found.with_gravity["valid"].to_numpy() > 0
    for name in ("roll", "pitch"):
        assert np.degrees(np.abs(found.with_gravity[name] - imported[name])[valid]).max() < 8.0
