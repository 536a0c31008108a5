"""A contradiction that is planted in a sound flight makes it unusable and is named with both sources."""

import copy
import gzip
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_motion import body
from recordings import SHARED
from rigid_body import quadrotor

from quasi import sensor_limits as plausibility
from quasi.airframe import read_airframe
from quasi.attitude import from_euler, multiply, rotate, rotate_inverse
from quasi.errors import DataError, ReadError
from quasi.filtering.flight import filter_flight
from quasi.identification.shared import left_out_notes, unusable_flights
from quasi.importing import contradictions
from quasi.importing import flight as importing
from quasi.importing.series import Series
from quasi.tables import read_json

ROOT = Path(__file__).parents[2]
NANODRONE = SHARED.parent / "nanodrone"
NANOBENCH = SHARED.parent / "nanobench"
GYRO, FORCE, Q, PLACE = ("p", "q", "r"), ("ax", "ay", "az"), ("qw", "qx", "qy", "qz"), ("x", "y", "z")


def changed(series, **values):
    return Series(series.t, series.values | values)


def tilt(series, names=Q):
    q = multiply(np.stack([series.values[n] for n in names], axis=-1), from_euler(np.radians(30.0), 0.0, 0.0))
    return changed(series, **dict(zip(names, q.T)))


def scaled(series, names, by):
    return changed(series, **{n: series.values[n] * by for n in names})


# what is planted, in which series, and the sources that must be named; None: the import settles it
PLANTS = {
    "tilted attitude": (tilt, "attitude", {"accelerometer", "{attitude}"}),
    "accelerometer offset": (lambda s: changed(s, ax=s.values["ax"] + 3.0), "force", {"accelerometer", "{attitude}"}),
    "accelerometer scale": (lambda s: scaled(s, FORCE, 1.3), "force", {"accelerometer", "captured position"}),
    "roll rate reversed": (lambda s: scaled(s, "p", -1.0), "rates", {"gyro", "{attitude}"}),
    "yaw rate reversed": (lambda s: scaled(s, "r", -1.0), "rates", {"gyro", "{attitude}"}),
    "position in another scale": (lambda s: scaled(s, PLACE, 2.0), "capture", {"accelerometer", "captured position"}),
    "gyro axes exchanged": (lambda s: changed(s, p=s.values["q"], q=s.values["p"]), "rates", {"gyro", "{attitude}"}),
    "position mirrored": (
        lambda s: changed(s, x=s.values["y"], y=s.values["x"]),
        "capture",
        {"accelerometer", "captured position"},
    ),
    "y up taken for z up": (
        lambda s: changed(s, y=s.values["z"], z=-s.values["y"]),
        "capture",
        {"accelerometer", "captured position"},
    ),
    "height reversed": (lambda s: scaled(s, "z", -1.0), "capture", {"accelerometer", "captured position"}),
    "late capture": (lambda s: Series(s.t + 0.06, s.values), "capture", None),
    "nothing": (lambda s: s, "capture", None),
}


READ = {}  # recordings by their log and what else they were read with, each read once


def planted(monkeypatch, plant, attitude_in):
    """Let the import read what it reads with a plant in it. attitude_in  series whose attitude is tilted"""
    change, where, _ = PLANTS[plant]
    read = importing.read_onboard

    def altered(*arguments):
        what = repr(arguments)
        if what not in READ:
            READ[what] = read(*arguments)
        recording = copy.deepcopy(READ[what])
        series = recording.series
        names = {
            "capture": "capture",
            "attitude": attitude_in,
            "rates": "onboard",
            "force": next(n for n, s in series.items() if n.startswith("onboard") and "ax" in s.values),
        }
        series[names[where]] = change(series[names[where]])
        return recording

    monkeypatch.setattr(importing, "read_onboard", altered)


def check(plant, imported, filtered, name):
    """The verdicts of import and filter agree with the plant."""
    wanted = PLANTS[plant][2]
    if wanted is None:
        assert imported["verdict"] != "unusable" and filtered["verdict"] != "unusable", filtered["verdict because"]
        assert filtered["contradictions"] == []
        return
    between = [set(c["between"]) for c in imported["contradictions"]]
    wanted = {w.format(attitude=name) for w in wanted}
    assert imported["verdict"] == filtered["verdict"] == "unusable"
    assert wanted in between and between == [set(c["between"]) for c in filtered["contradictions"]][: len(between)]
    assert all(w in imported["verdict because"] and w in filtered["verdict because"] for w in wanted)


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """A made flight as a table with a captured attitude and position; its quadrotor configuration."""
    truth = body(30.0, rate=100.0)
    rng = np.random.default_rng(0)
    columns = {"t": truth.t} | dict(zip(GYRO, (truth.rates + rng.normal(0, 0.01, truth.rates.shape)).T))
    columns |= dict(zip(FORCE, (truth.force + rng.normal(0, 0.1, truth.force.shape)).T))
    columns |= dict(zip(Q, truth.quaternion.T)) | dict(zip(PLACE, truth.position.T))
    columns |= {f"w{i}": 800.0 + 20.0 * np.sin(3.0 * truth.t + i) for i in range(1, 5)}
    path = tmp_path_factory.mktemp("made") / "log.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    sources = [
        {"name": "imu", "columns": {n: n for n in (*GYRO, *FORCE, "w1", "w2", "w3", "w4")}},
        {"name": "room", "motion capture": True, "columns": {n: n for n in (*Q, *PLACE)}},
    ]
    return path, {"table columns": {"time": "t", "sources": sources}}


@pytest.mark.parametrize("plant", PLANTS)
def test_what_is_planted_in_a_made_flight_is_named(table, monkeypatch, plant):
    path, config = table
    planted(monkeypatch, plant, "capture")
    asked = {"flight": "made", "quadrotor": "made", "flight controller": "table", "capture": None, "onboard": str(path)}
    frame, about = importing.import_flight(asked, config, {"resampling rate": 100.0})
    result = filter_flight(frame, about, quadrotor(), {})
    check(plant, about, result.metadata, "captured attitude")
    if plant == "late capture":
        assert about["synchronisation"]["lag"]["value"] == pytest.approx(-0.06, abs=2e-3)


@pytest.mark.parametrize("unseen", [slice(2000, None), slice(1400, 1450)])
def test_captured_frames_of_zeros_were_not_seen(table, tmp_path, unseen):
    path, config = table
    columns = pd.read_csv(path)
    asked = {"flight": "made", "quadrotor": "made", "flight controller": "table", "capture": None, "onboard": str(path)}
    whole, _ = importing.import_flight(asked, config, {"resampling rate": 100.0})
    columns.loc[columns.index[unseen], [*Q, *PLACE]] = 0.0
    columns.to_csv(tmp_path / "log.csv", index=False)
    frame, about = importing.import_flight(asked | {"onboard": str(tmp_path / "log.csv")}, config, {})
    assert about["contradictions"] == []
    seen = frame["velocity_sample"] > 0
    for name in ("u", "v", "w"):
        np.testing.assert_allclose(frame[name][seen], np.interp(frame["t"], whole["t"], whole[name])[seen], atol=0.1)


@pytest.mark.parametrize(("known", "words"), [(1, "neither position nor velocity"), (500, "for 83 % of the flight")])
def test_a_flight_is_not_good_whose_logged_position_is_hardly_there(table, tmp_path, known, words):
    path, config = table
    columns = pd.read_csv(path)
    columns.loc[columns.index[known:], list(PLACE)] = np.nan
    columns.to_csv(tmp_path / "log.csv", index=False)
    imu, room = config["table columns"]["sources"]
    plan = {"time": "t", "sources": [imu, {"name": "estimate", "columns": room["columns"]}]}
    asked = {"flight": "made", "quadrotor": "made", "flight controller": "table", "capture": None,
             "onboard": str(tmp_path / "log.csv")}  # fmt: skip
    _, about = importing.import_flight(asked, {"table columns": plan}, {"resampling rate": 100.0})
    assert about["verdict"] == ("unusable" if known == 1 else "usable with care")
    assert words in about["verdict because"]


VELOCITY, ROTORS = ("vx", "vy", "vz"), ("w1", "w2", "w3", "w4")
# of flights whose attitude, position and velocity were logged on board
ONBOARD_PLANTS = {
    "height reversed": (lambda v: v | {"z": -v["z"]}, "on-board position"),
    "position mirrored": (lambda v: v | {"x": v["y"], "y": v["x"]}, "on-board position"),
    "position turned by half": (lambda v: v | {"x": -v["x"], "y": -v["y"]}, "on-board position"),
    "y up taken for z up": (lambda v: v | {"y": v["z"], "z": -v["y"]}, "on-board position"),
    "velocity mirrored": (lambda v: v | {"vx": v["vy"], "vy": v["vx"]}, "on-board velocity"),
    "velocity in feet": (lambda v: v | {n: v[n] / 0.3048 for n in VELOCITY}, "on-board velocity"),
    "position halved": (lambda v: v | {n: 0.5 * v[n] for n in PLACE}, "on-board position"),
    "vertical velocity reversed": (lambda v: v | {"vz": -v["vz"]}, "on-board velocity"),
    "x and y of the accelerometer": (lambda v: v | {"ax": v["ay"], "ay": v["ax"]}, "on-board attitude"),
    "accelerometer in the earth's axes": (lambda v: v | turned(v, rotate), "on-board attitude"),
    "accelerometer turned once too often": (lambda v: v | turned(v, rotate_inverse), "on-board attitude"),
    "nothing": (lambda v: v, None),
}


def turned(columns, turn):
    """The accelerometer's values turned by the attitude or back."""
    q, force = (np.stack([columns[n] for n in names], axis=-1) for names in (Q, FORCE))
    return dict(zip(FORCE, turn(q, force).T))


@pytest.fixture(scope="module")
def logged():
    """Columns of a made flight whose attitude, position and velocity were logged on board."""
    truth = body(30.0, rate=100.0, seed=5)
    rng = np.random.default_rng(0)
    columns = {"t": truth.t} | dict(zip(GYRO, (truth.rates + rng.normal(0, 0.01, truth.rates.shape)).T))
    columns |= dict(zip(FORCE, (truth.force + rng.normal(0, 0.1, truth.force.shape)).T))
    columns |= dict(zip(Q, truth.quaternion.T)) | dict(zip(PLACE, truth.position.T))
    columns |= {f"w{i}": 800.0 + 20.0 * np.sin(3.0 * truth.t + i) for i in range(1, 5)}
    return columns | dict(zip(VELOCITY, np.gradient(truth.position, truth.t, axis=0).T))


@pytest.mark.parametrize("plant", ONBOARD_PLANTS)
def test_a_position_or_velocity_logged_on_board_is_held_against_the_accelerometer(logged, tmp_path, plant):
    change, path = ONBOARD_PLANTS[plant]
    pd.DataFrame(change(logged)).to_csv(tmp_path / "log.csv", index=False)
    source = {"name": "log", "columns": {n: n for n in (*GYRO, *FORCE, *Q, *PLACE, *VELOCITY, *ROTORS)}}
    config = {"table columns": {"time": "t", "sources": [source]}}
    asked = {"flight": "made", "quadrotor": "made", "flight controller": "table", "capture": None}
    asked |= {"onboard": str(tmp_path / "log.csv")}
    _, about = importing.import_flight(asked, config, {"resampling rate": 100.0, "use onboard attitude": True})
    between = [set(c["between"]) for c in about["contradictions"]]
    if plant == "nothing":
        assert not between and about["verdict"] != "unusable"
    else:
        assert about["verdict"] == "unusable"
        assert between and all(pair == {"accelerometer", path} for pair in between)


def test_a_capture_in_the_log_that_leaves_any_room_states_its_unit(table, tmp_path):
    path, config = table
    frame = pd.read_csv(path)
    frame[list(PLACE)] *= 1000.0
    frame.to_csv(tmp_path / "log.csv", index=False)
    asked = {"flight": "made", "quadrotor": "made", "flight controller": "table", "capture": None}
    with pytest.raises(ReadError, match=r"log\.csv: the captured position moves through \d+ m if .*'table columns'"):
        importing.import_flight(asked | {"onboard": str(tmp_path / "log.csv")}, config, {"resampling rate": 100.0})


@pytest.mark.skipif(not NANODRONE.is_dir(), reason=f"the nano-drone recordings are not at {NANODRONE}")
@pytest.mark.parametrize(
    ("run", "plant"), [*((3, plant) for plant in PLANTS), *((run, "nothing") for run in (1, 2)), (1, "tilted attitude")]
)
def test_what_is_planted_in_a_real_flight_is_named(monkeypatch, plant, run):
    config = read_json(ROOT / "examples/nanodrone/config/NanoDroneConfig.json")
    options = read_json(ROOT / "examples/nanodrone/config/processing.json")
    planted(monkeypatch, plant, "onboard")
    asked = {"flight": "run", "quadrotor": "nano", "flight controller": "table", "capture": None,
             "onboard": str(NANODRONE / f"square_run{run}.csv")}  # fmt: skip
    frame, about = importing.import_flight(asked, config, options["data importing"])
    result = filter_flight(frame, about, read_airframe(config, "nano"), options["data filtering"])
    check(plant, about, result.metadata, "on-board attitude")


@pytest.mark.skipif(not NANOBENCH.is_dir(), reason=f"the NanoBench recordings are not at {NANOBENCH}")
@pytest.mark.parametrize("name", ["B3_figure8_fast_rep1", "B7_oval_medium_rep2", "B9_trefoil_medium_rep1"])
def test_noisy_sources_of_real_flights_do_not_contradict_each_other(tmp_path, name):
    (tmp_path / "log.csv").write_bytes(gzip.decompress((NANOBENCH / f"{name}.csv.gz").read_bytes()))
    axes = {"frame": "FLU", "world": "z-up"}
    force = {a: {"column": f"imu_acc_{a[1]}", "unit": "g"} for a in FORCE}
    rates = dict(zip(GYRO, ("imu_gyro_x", "imu_gyro_y", "imu_gyro_z")))
    sources = [
        {"name": "imu", **axes, "columns": rates | force},
        {"name": "vicon", **axes, "motion capture": True, "columns": {n: n for n in Q} | {n: f"p{n}" for n in PLACE}},
    ]
    asked = {"flight": name, "quadrotor": "nano", "flight controller": "table", "capture": None,
             "onboard": str(tmp_path / "log.csv")}  # fmt: skip
    frame, about = importing.import_flight(asked, {"table columns": {"time": "t", "sources": sources}}, {})
    assert about["contradictions"] == []
    assert about["verdict because"].startswith("unusable for identification: no rotor speeds")


@pytest.mark.parametrize(("angle", "gain"), [(5.0, 1.0), (-5.0, 2.0), (90.0, 1.0), (-85.0, 0.5)])
def test_an_axis_at_rest_that_is_turned_a_little_is_not_exchanged_with_a_lively_one(angle, gain):
    rng, c, s = np.random.default_rng(1), *(f(np.radians(angle)) for f in (np.cos, np.sin))
    needed = rng.standard_normal((4000, 3)) * [0.03, 0.3, 2.0]
    turned = gain * needed @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    measured = turned + 0.02 * rng.standard_normal(turned.shape)
    found = contradictions._exchanged(measured, needed, contradictions.LEAST_MOTION, ("ax", "ay", "az"))
    assert found == ({"ax": "az"} if abs(angle) > 45.0 else {})


def test_each_limit_names_its_two_sources():
    names = {"attitude": "on-board attitude", "position": "captured position"}
    zero = np.zeros(6)
    for check_one, calm in (
        (lambda v: plausibility.check_biases(np.array([0, 0, v, 0, 0, 0]), zero, names), plausibility.GYRO_BIAS),
        (lambda v: plausibility.check_biases(np.array([0, 0, 0, v, 0, 0]), zero, names),
         plausibility.ACCELEROMETER_BIAS),
        (lambda v: plausibility.check_residual(np.array([0, 0, v]), None, "captured position"),
         plausibility.ACCELEROMETER_BIAS),
        (lambda v: plausibility.check_angle(v, plausibility.MOUNTING_ANGLE, "angle", names["attitude"]),
         plausibility.MOUNTING_ANGLE),
        (lambda v: plausibility.check_innovations({"position": {"mean": v}}, names), plausibility.MAX_NIS),
        (lambda v: plausibility.check_length_ratio(v, names["position"]), plausibility.LENGTH_RATIO[1]),
    ):  # fmt: skip
        assert check_one(0.99 * calm) == []
        [found] = check_one(1.01 * calm)
        assert found.value == pytest.approx(1.01 * calm) and found.limit == pytest.approx(calm)
        assert all(source in found.text for source in found.between)
    # a bias that is hardly known contradicts nothing, nor does a tilt of an attitude that the accelerometer levelled
    assert plausibility.check_biases(np.array([0, 0, 0, 5.0, 0, 0]), np.full(6, 2.0), names) == []
    assert plausibility.check_residual(np.array([5.0, 0, 0]), None, "captured position") == []


def test_no_body_has_a_principal_moment_above_the_sum_of_the_others():
    assert plausibility.describe_impossible_inertia(np.diag([1.0, 1.0, 2.0])) is None
    assert "3" in plausibility.describe_impossible_inertia(np.diag([1.0, 1.0, 3.0]))


def test_flights_alike_in_what_they_lack_get_the_same_verdict():
    whole = {"w1", "w2", "w3", "w4", "p", "ax", "roll", "x", "u"}
    seen = {"position source": "capture", "velocity source": "capture position"}
    unseen = {"position source": "none", "velocity source": "none"}
    assert plausibility.find_missing_sources(whole, seen) == []
    assert plausibility.find_missing_sources(whole, {**unseen, "velocity source": "onboard"}) == []
    first, offer = plausibility.find_missing_sources(whole - {"x", "u"}, unseen)
    assert first == "unusable for identification: neither position nor velocity"
    assert offer == "its page still shows body rates, specific force, attitude, rotor speeds"
    assert plausibility.find_missing_sources(whole - {"w3"}, seen)[0].endswith("no rotor speeds of 3")


def test_an_unusable_flight_trains_no_model_unless_forced():
    tables = {key: pd.DataFrame({"valid": np.ones(5)}) for key in "ab"}
    made = {"a": {"unusable because": ["gyro and attitude contradict each other"]}, "b": {"unusable because": []}}
    found = unusable_flights(made, tables)
    assert list(found) == ["a"] and unusable_flights(made, tables, True) == {}
    [note] = left_out_notes(found)
    assert "flight a " in note and "gyro and attitude" in note and "use unusable flights" in note
    with pytest.raises(DataError, match="no training flight is usable: flight a: gyro.*'use unusable flights'"):
        unusable_flights({"a": made["a"]}, {"a": tables["a"]})
