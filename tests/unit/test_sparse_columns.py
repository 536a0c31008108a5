"""Logs of several rates in one table, sources in any order, fields that hold something else: the same answers."""

import copy
import dataclasses

import numpy as np
import pandas as pd
import pytest
from crazyflie_writer import encode_log
from log_formats import BOOT, DATAFLASH, DataFlash, dataflash_of, made_flight, write_bag
from test_table_reader import PLAN, flown, saved, stacked  # noqa: F401
from test_telemetry import flight

from quasi.errors import DataError, ReadError
from quasi.identification.taught_map import teach_map
from quasi.importing.checks.rotor_speeds import unreliable_spans
from quasi.importing.clocks.telemetry import rotor_age
from quasi.importing.decode import joined, unit_of
from quasi.importing.flight import _at_cg
from quasi.importing.readers.crazyflie import read_crazyflie
from quasi.importing.readers.dataflash import DataFlashFile
from quasi.importing.readers.guess_columns import guess_columns
from quasi.importing.readers.rosbag import Bag
from quasi.importing.readers.table_reader import read_table_log
from quasi.importing.rest import read_rest
from quasi.importing.series import Series

MOTORS = ["m1", "m2", "m3", "m4"]
W = ("w1", "w2", "w3", "w4")


def one_source():
    """The plan with the motors in the source of the gyro."""
    plan = copy.deepcopy(PLAN)
    motors = plan["sources"].pop()
    plan["sources"][0]["columns"] |= {n: c for n, c in motors["columns"].items() if n in W}
    return plan


def columns_of(log):
    return [c for topic in log.topics.values() for c in topic.columns]


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("every", [2, 5])
def test_speeds_in_some_rows_are_a_source_of_their_own_rate(tmp_path, flown, whole, every):  # noqa: F811
    truth, rotors, table = flown
    rows = np.arange(len(table)) % every == 0
    table.loc[~rows, MOTORS] = np.nan
    recording = read_table_log(saved(tmp_path, table), one_source() if whole else PLAN, 14)
    motors = recording.series["onboard state rotor speeds" if whole else "onboard motors"]
    assert motors.t == pytest.approx(truth.t[rows], abs=1e-9)
    assert stacked(motors, *W) == pytest.approx(rotors[rows], rel=1e-9)
    board = recording.series["onboard"]
    assert board.t == pytest.approx(truth.t, abs=1e-9) and "w1" not in board.values


def test_a_rotor_that_freezes_is_found_in_a_table_with_blank_rows(tmp_path, flown):  # noqa: F811
    truth, _, table = flown
    table["m2"] = np.where((truth.t > 3.0) & (truth.t < 7.0), table["m2"][300], table["m2"])
    dense = read_table_log(saved(tmp_path, table), one_source(), 14).series["onboard"]
    (right,) = unreliable_spans(dense.t, dense.values)
    table.loc[np.arange(len(table)) % 2 == 1, MOTORS] = np.nan
    sparse = read_table_log(saved(tmp_path, table), one_source(), 14).series["onboard state rotor speeds"]
    (found,) = unreliable_spans(sparse.t, sparse.values)
    assert found.reason == right.reason
    assert (found.begin, found.end) == pytest.approx((right.begin, right.end), abs=0.05)


@pytest.mark.parametrize("every", [2, 4, 5])
def test_the_age_of_speeds_is_that_without_blank_rows_between(every):
    t_rotor, speeds, t, rates = flight(0.003)
    rows = np.arange(len(t)) % every == 0
    plain = rotor_age(t_rotor[rows], speeds[rows], t, rates)
    blank = rotor_age(t_rotor, np.where(rows[:, None], speeds, np.nan), t, rates)
    assert blank == plain and blank.value == pytest.approx(0.003, abs=4 * blank.std)


def test_speeds_that_hardly_ever_change_show_no_age():
    t_rotor, speeds, t, rates = flight(0.003)
    assert rotor_age(t_rotor, 0.0 * speeds, t, rates) is None
    steps = np.repeat(speeds[::8000], 8000, axis=0)
    assert rotor_age(t_rotor, steps, t, rates) is None


def test_the_order_of_sources_changes_no_column(tmp_path, flown):  # noqa: F811
    t = np.arange(5) * 0.1
    board, capture = ({"x": np.full(5, v)} for v in (1.0, -9.0))
    external = {"vx": np.full(5, 3.0)}
    series = {
        "onboard": Series(t, board | {"vx": np.full(5, 2.0)}), "onboard external": Series(t, external),
        "capture": Series(t + 0.05, capture),
    }  # fmt: skip
    first = joined(series)
    again = joined(dict(reversed(series.items())))
    assert first["capture_x"].dropna().unique().tolist() == [-9.0] == again["capture_x"].dropna().unique().tolist()
    assert first["x"].dropna().unique().tolist() == [1.0] == again["x"].dropna().unique().tolist()
    assert first["external_vx"].dropna().unique().tolist() == [3.0]
    assert unit_of("external_vx") == unit_of("capture_vx") == unit_of("vx") and unit_of("linear_ax")[0] == "m/s2"


def test_a_rest_log_whose_accelerometer_comes_first_keeps_it(tmp_path, flown):  # noqa: F811
    _, _, table = flown
    plan = copy.deepcopy(PLAN)
    force = {n: plan["sources"][0]["columns"].pop(n) | {"frame": "body"} for n in ("ax", "ay", "az")}
    plan["sources"].insert(0, {"name": "felt", "frame": "FLU", "world": "z-up", "columns": force})
    quadrotor = {"flight controller": "table", "table columns": plan, "motor poles": 14}
    found = read_rest(saved(tmp_path, table), quadrotor)
    assert {"p", "q", "r", "ax", "ay", "az"} <= set(found.columns)


def test_a_capture_without_attitude_for_a_while_has_no_position_at_the_cg():
    q = np.tile([1.0, 0.0, 0.0, 0.0], (10, 1))
    q[4:6] = np.nan
    moved = _at_cg(Series(np.arange(10.0), dict.fromkeys("xyz", np.zeros(10))), np.array([0.05, 0.0, 0.0]), q)
    assert np.isnan(moved.values["x"]).nonzero()[0].tolist() == [4, 5]
    assert np.nanmax(np.abs(moved.values["x"] + 0.05)) < 1e-12


def test_an_attitude_that_was_never_estimated_turns_nothing(tmp_path, flown):  # noqa: F811
    _, _, table = flown
    table[["qw", "qx", "qy", "qz"]] = 0.0
    with pytest.raises(ReadError, match="attitude that turns them has 0 usable samples"):
        read_table_log(saved(tmp_path, table), PLAN, 14)


def test_optional_commands_of_motors_that_never_ran_are_absent(tmp_path, flown):  # noqa: F811
    _, _, table = flown
    plan = copy.deepcopy(PLAN)
    commands = {f"command{i}": {"column": f"c{i}", "optional": True} for i in range(1, 5)}
    plan["sources"][1]["columns"] |= commands
    table = table.assign(**{f"c{i}": 0.0 for i in range(1, 5)})
    recording = read_table_log(saved(tmp_path, table), plan, 14)
    assert "command1" not in recording.series["onboard motors"].values
    assert any("has no battery_voltage, command1" in note for note in recording.notes)


@pytest.mark.parametrize(("names", "rotors"), [
    ([f"output[{i}]" for i in range(16)], [f"output[{i}]" for i in range(4)]),
    ([f"motor[{i}]" for i in range(4)], [f"motor[{i}]" for i in range(4)]),
    ([f"motor{i}" for i in range(1, 9)], [f"motor{i}" for i in range(1, 5)]),
])  # fmt: skip
def test_outputs_counted_from_zero_begin_with_zero(names, rotors):
    t = np.arange(400) / 100.0
    columns = {"time": t} | {f"gyro{a}": np.sin(t + k) for k, a in enumerate("XYZ")}
    columns |= {n: 0.4 + 0.1 * np.sin(t * (k + 1)) if k < 8 else np.full(len(t), -1.0) for k, n in enumerate(names)}
    mapped = guess_columns({"": pd.DataFrame(columns)}).mapping["sources"]
    commands = {q: c["column"] for s in mapped for q, c in s["columns"].items() if q.startswith("command")}
    assert [commands[f"command{i}"] for i in range(1, 5)] == rotors


def test_fields_of_another_kind_do_not_end_a_dataflash_log(tmp_path):
    made = made_flight()
    plain = dataflash_of(made)
    path = tmp_path / "odd.bin"
    # an unused type of the same name, units and names that are numbers, a message without text
    number, characters, _ = DATAFLASH["IMU"]
    odd = [DataFlash.declare("IMU", 200, characters, "TimeUS,I,a,b,c,d,e,f", 36)]
    types = {"FMTU": (201, "QBf", "TimeUS,FmtType,UnitIds"), "PARM": (202, "Qff", "TimeUS,Name,Value"),
             "MSG": (203, "Qf", "TimeUS,Text")}  # fmt: skip
    extra = DataFlash(types)
    for name, values in (("FMTU", (BOOT, number, 1.0)), ("PARM", (BOOT, 2.0, 3.0)), ("MSG", (BOOT, 4.0))):
        extra.write(name, *values)
    begin, rest = plain.parts[0], plain.parts[1:]
    path.write_bytes(b"".join([begin, *odd, *rest]))
    whole = DataFlashFile(path, [])
    assert any(name.startswith("IMU") and name.endswith("GyrX") for name in columns_of(whole))
    for part in ("FMTU", "PARM", "MSG"):
        only = DataFlash({part: types[part]})
        only.write(part, *{"FMTU": (BOOT, number, 1.0), "PARM": (BOOT, 2.0, 3.0), "MSG": (BOOT, 4.0)}[part])
        kept = [p for p in rest if not p.startswith(b"\xa3\x95\x80" + bytes([DATAFLASH.get(part, (0,))[0]]))]
        path.write_bytes(b"".join([begin, *only.parts[1:], *kept]))
        assert DataFlashFile(path, []).facts["format"] == "DataFlash"


@pytest.mark.parametrize("rate", [50.0, 180.0, 500.0])
def test_seconds_that_teach_the_map_are_those_flown(rate):
    t = np.arange(0.0, 4.5, 1 / rate)
    frame = {"t": t} | {f"command{i}": 0.5 + 0.1 * np.sin(t * i) for i in range(1, 5)}
    frame |= {f"w{i}": 1000.0 * frame[f"command{i}"] for i in range(1, 5)}
    with pytest.raises(DataError, match=r"hold 4\.[0-5] s of commands"):
        teach_map({"one": pd.DataFrame(frame)}, {"one": np.ones(len(t), bool)}, ["linear"])


def test_a_list_that_begins_empty_fills_later(tmp_path):
    pytest.importorskip("rosbags")
    made = made_flight()
    late = [w if k > 40 else np.zeros(0) for k, w in enumerate(made.rotors)]
    path = write_bag(tmp_path, dataclasses.replace(made, rotors=late))
    listed = columns_of(Bag(path, []))
    assert [f"/motor_speed.angular_velocities[{i}]" in listed for i in range(5)] == [True] * 4 + [False]


def test_the_pitch_of_every_event_type_is_turned(tmp_path):
    """Attitude and gyro in one event type, or in one each: the same angles."""
    gyro, angles = ([f"gyro.{a}(f)" for a in "xyz"], [f"stateEstimate.{a}(f)" for a in ("roll", "pitch", "yaw")])
    turned = {"roll": 0.1, "pitch": 0.3, "yaw": -0.2}
    found = []
    for apart in (False, True):
        kinds = {1: ("main", gyro if apart else gyro + angles)} | ({2: ("slow", angles)} if apart else {})
        values = [np.degrees(v) for v in turned.values()]
        rows = [(1, 0.01 * i, [1e-3 * i, 2.0, 3.0] + ([] if apart else values)) for i in range(60)]
        rows += [(2, 0.02 * i + 1e-4, values) for i in range(30) if apart]
        path = tmp_path / f"log0{int(apart)}"
        path.write_bytes(encode_log(kinds, sorted(rows, key=lambda e: e[1])))
        before = "slow/" if apart else ""
        columns = {a: {"column": f"{before}stateEstimate.{a}", "unit": "deg"} for a in turned}
        rates = {n: {"column": f"gyro.{a}", "unit": "deg/s"} for n, a in zip("pqr", "xyz")}
        frames = {"frame": "FLU", "world": "z-up"}
        sources = [{"name": "gyro", "columns": rates, **frames}, {"name": "state", "columns": columns, **frames}]
        recording = read_crazyflie(path, {"time": {"column": "time stamp"}, "sources": sources})
        assert recording.metadata["reversed"] == [f"{before}stateEstimate.pitch"]
        series = recording.series["onboard state"]
        found.append([float(series.values[n][0]) for n in ("qw", "qx", "qy", "qz")])
    assert found[0] == pytest.approx(found[1], abs=1e-6) and abs(found[0][2]) > 0.1
