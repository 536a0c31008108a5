"""The generic table reader: every unit, frame and clock against values known beforehand."""

import copy
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_motion import body
from recordings import SHARED
from scipy.spatial.transform import Rotation

from quasi.attitude import matrix, rotate
from quasi.errors import ConfigError, ReadError, cautions
from quasi.importing.readers.table_reader import read_table_log
from quasi.importing.readers.table_text import open_table
from quasi.importing.units import UNITS, to_si
from quasi.tables import read_json

ROOT = Path(__file__).parents[2]
NANODRONE = SHARED.parent / "nanodrone"
HALF = np.array([1.0, -1.0, -1.0])

PLAN = {
    "time": {"column": "t", "unit": "s"},
    "sources": [
        {
            "name": "state",
            "time": {"column": "stamp", "unit": "ms"},
            "frame": "FLU",
            "world": "z-up",
            "columns": {
                "p": {"column": "wx", "unit": "deg/s"},
                "q": {"column": "wy", "unit": "deg/s"},
                "r": {"column": "wz", "unit": "deg/s"},
                "ax": {"column": "fx", "unit": "g", "frame": "world"},
                "ay": {"column": "fy", "unit": "g", "frame": "world"},
                "az": {"column": "fz", "unit": "g", "frame": "world"},
                "qw": "qw",
                "qx": "qx",
                "qy": "qy",
                "qz": "qz",
                "x": {"column": ["north", "px"], "unit": "mm"},
                "y": {"column": ["east", "py"], "unit": "mm"},
                "z": {"column": ["down", "pz"], "unit": "mm"},
            },
        },
        {
            "name": "motors",
            "columns": {f"w{i}": {"column": f"m{i}", "unit": "eRPM/100"} for i in range(1, 5)}
            | {"battery_voltage": {"column": "vbat", "unit": "mV", "optional": True}},
        },
    ],
}


@pytest.fixture
def flown():
    """Truth in NED and FRD, and the table that holds it in FLU, z-up, deg/s, g, mm, eRPM/100."""
    truth = body(8.0, rate=100.0)
    turn = Rotation.from_quat(truth.quaternion, scalar_first=True)
    flip = Rotation.from_rotvec([np.pi, 0, 0])
    logged = (flip * turn * flip.inv()).as_quat(scalar_first=True)
    world = turn.apply(truth.force) * HALF
    rotors = 800 + 50 * np.stack([np.sin(truth.t * (k + 2)) for k in range(4)], axis=-1)
    columns = {"t": truth.t, "stamp": 1e3 * (truth.t + 5.0)}
    columns |= dict(zip(("wx", "wy", "wz"), np.degrees(truth.rates * HALF).T))
    columns |= dict(zip(("fx", "fy", "fz"), (world / 9.80665).T))
    columns |= dict(zip(("qw", "qx", "qy", "qz"), logged.T))
    columns |= dict(zip(("px", "py", "pz"), (1e3 * truth.position * HALF).T))
    columns |= dict(zip(("m1", "m2", "m3", "m4"), (rotors * 60 / (2 * np.pi) * 7 / 100).T))
    return truth, rotors, pd.DataFrame(columns)


def saved(folder, table, name="log.csv"):
    path = folder / name
    if name.endswith("parquet"):
        table.to_parquet(path)
    else:
        table.to_csv(path, index=False)
    return path


def stacked(series, *names):
    return np.stack([series.values[n] for n in names], axis=-1)


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
def test_units_and_axes_come_out_as_the_truth(tmp_path, flown, name):
    truth, rotors, table = flown
    recording = read_table_log(saved(tmp_path, table, name), PLAN, 14)
    board = recording.series["onboard"]
    assert board.t == pytest.approx(truth.t, abs=1e-9)
    assert stacked(board, "p", "q", "r") == pytest.approx(truth.rates, abs=1e-9)
    assert stacked(board, "ax", "ay", "az") == pytest.approx(truth.force, abs=1e-8)
    assert stacked(board, "x", "y", "z") == pytest.approx(truth.position, abs=1e-9)
    q = stacked(board, "qw", "qx", "qy", "qz")
    assert matrix(q) == pytest.approx(Rotation.from_quat(truth.quaternion, scalar_first=True).as_matrix(), abs=1e-9)
    motors = recording.series["onboard motors"]
    assert stacked(motors, "w1", "w2", "w3", "w4") == pytest.approx(rotors, rel=1e-9)
    assert any("battery_voltage" in n for n in recording.notes)


@pytest.mark.parametrize(
    ("first", "options", "encoding"),
    [
        ("", {"sep": ";", "decimal": ","}, "utf-8"),
        ("", {"sep": "\t", "decimal": ","}, "utf-16"),
        ("sep=;\n", {"sep": ";"}, "utf-8-sig"),
    ],
)
def test_what_spreadsheets_write_is_read_alike(tmp_path, flown, first, options, encoding):
    truth, _, table = flown
    table["t"] = np.round(table["t"], 2)
    text = first + table.to_csv(index=False, **options).replace("\n0,05", "\ntext", 1)
    (tmp_path / "log.csv").write_text(text, encoding=encoding)
    recording = read_table_log(tmp_path / "log.csv", PLAN, 14)
    board = recording.series["onboard"]
    assert stacked(board, "p", "q", "r") == pytest.approx(truth.rates, abs=1e-9)
    assert stacked(board, "x", "y", "z") == pytest.approx(truth.position, abs=1e-9)
    commas = options.get("decimal") == ","
    assert any("decimal commas (first 't')" in n for n in recording.notes) == commas
    assert any("column 't' holds text in 1 rows" in n for n in recording.notes) == commas


def test_at_rest_the_specific_force_points_up(tmp_path, flown):
    truth, _, table = flown
    table[["fx", "fy"]] = 0.0
    table["fz"] = 1.0  # a resting accelerometer, world axes, z up
    table[["wx", "wy", "wz"]] = 0.0
    series = read_table_log(saved(tmp_path, table), PLAN, 14).series["onboard"]
    force = stacked(series, "ax", "ay", "az")
    earth = rotate(stacked(series, "qw", "qx", "qy", "qz"), force)
    assert earth == pytest.approx(np.tile([0, 0, -9.80665], (len(earth), 1)), abs=1e-9)


def test_euler_angles_of_forward_left_up_change_the_sign_of_pitch_and_yaw(tmp_path, flown):
    truth, _, table = flown
    turn = Rotation.from_quat(table[["qw", "qx", "qy", "qz"]].to_numpy(), scalar_first=True)
    yaw, pitch, roll = turn.as_euler("ZYX").T
    table["R"], table["P"], table["Y"] = np.degrees(roll), np.degrees(pitch), np.degrees(yaw)
    plan = copy.deepcopy(PLAN)
    for n in ("qw", "qx", "qy", "qz"):
        del plan["sources"][0]["columns"][n]
    for n in "RPY":
        quantity = {"R": "roll", "P": "pitch", "Y": "yaw"}[n]
        plan["sources"][0]["columns"][quantity] = {"column": n, "unit": "deg"}
    board = read_table_log(saved(tmp_path, table), plan, 14).series["onboard"]
    want = Rotation.from_quat(truth.quaternion, scalar_first=True).as_matrix()
    assert matrix(stacked(board, "qw", "qx", "qy", "qz")) == pytest.approx(want, abs=1e-9)


def test_repeats_and_steps_back_are_dropped_counted_and_said(tmp_path, flown):
    _, _, table = flown
    table.loc[100:103, :] = table.loc[100].to_numpy()
    table.loc[300, "stamp"] -= 500.0
    recording = read_table_log(saved(tmp_path, table), PLAN, 14)
    about = recording.metadata["sources"]["state"]
    assert (about["repeated"], about["stepped back"]) == (3, 1)
    assert len(recording.series["onboard"].t) == len(table) - 4
    assert any("step back (first in row 302" in n for n in recording.notes)


def test_a_clock_of_another_epoch_is_brought_over_by_the_shared_rows(tmp_path, flown):
    truth, _, table = flown
    plan = copy.deepcopy(PLAN)
    plan["sources"][1]["time"] = {"column": "us", "unit": "us"}
    table["us"] = 1e6 * (truth.t + 1234.5)
    recording = read_table_log(saved(tmp_path, table), plan, 14)
    assert recording.series["onboard motors"].t == pytest.approx(truth.t, abs=1e-6)
    assert any("keeps another time" in n for n in recording.notes)


def test_a_clock_of_32_bits_that_starts_again_is_carried_on(tmp_path, flown):
    truth, _, table = flown
    plan = copy.deepcopy(PLAN)
    plan["sources"][0]["time"] = {"column": "us", "unit": "us"}
    table["us"] = (np.round(1e6 * truth.t).astype(int) - 3_000_000) % 2**32
    recording = read_table_log(saved(tmp_path, table), plan, 14)
    assert recording.series["onboard"].t == pytest.approx(truth.t, abs=1e-6)
    assert any("'us' starts again from 0 1 times" in n for n in recording.notes)


def test_late_stamps_of_one_source_are_found_from_the_motion(tmp_path):
    truth = body(15.0, rate=200.0, seed=4)
    # four rotors that make the roll and pitch acceleration, logged with stamps 25 ms early
    push = np.gradient(truth.rates, truth.t, axis=0)
    squares = 640000 + 4000 * np.stack(
        [s * push[:, 0] + f * push[:, 1] for s, f in ((1, 1), (1, -1), (-1, 1), (-1, -1))], 1
    )
    table = pd.DataFrame({"stamp": truth.t, "early": truth.t - 0.025})
    for names, values in ((("p", "q", "r"), truth.rates), (("ax", "ay", "az"), truth.force)):
        for n, v in zip(names, values.T):
            table[n] = v
    for i in range(4):
        table[f"w{i + 1}"] = np.sqrt(squares[:, i])
    plan = {
        "sources": [
            {"name": "imu", "time": "stamp", "columns": {n: n for n in ("p", "q", "r", "ax", "ay", "az")}},
            {"name": "motors", "time": "early", "columns": {f"w{i}": f"w{i}" for i in range(1, 5)}},
        ]
    }
    recording = read_table_log(saved(tmp_path, table), plan)
    found = recording.metadata["sources"]["motors"]["lag of main stamps"]
    assert found["value"] == pytest.approx(0.025, abs=5e-4)
    assert found["applied"]
    assert recording.series["onboard motors"].t == pytest.approx(truth.t, abs=5e-4)


def test_spikes_in_rotor_speeds_are_removed_and_counted(tmp_path, flown):
    _, rotors, table = flown
    table.loc[[77, 400], "m2"] += 1300.0
    recording = read_table_log(saved(tmp_path, table), PLAN, 14)
    assert recording.metadata["sources"]["motors"]["spikes removed"] == {"w2": 2}
    w2 = recording.series["onboard motors"].values["w2"]
    assert np.flatnonzero(np.isnan(w2)).tolist() == [77, 400]


def test_speeds_with_the_sign_of_their_direction_lose_it(tmp_path, flown):
    _, rotors, table = flown
    table[["m2", "m3"]] *= -1.0
    recording = read_table_log(saved(tmp_path, table), PLAN, 14)
    assert stacked(recording.series["onboard motors"], "w1", "w2", "w3", "w4") == pytest.approx(rotors, rel=1e-9)
    assert any("speeds of w2, w3 are negative" in n for n in recording.notes)


def test_long_rest_does_not_decide_on_the_sign_of_speeds(tmp_path, flown):
    """Most of the log at rest: told as -1 where speeds are positive, as 0 where they are negative."""
    _, rotors, table = flown
    rest = slice(0, int(0.6 * len(table)))
    table[["m2", "m3"]] *= -1.0
    table.loc[rest, ["m1", "m4"]], table.loc[rest, ["m2", "m3"]] = -1.0, 0.0
    recording = read_table_log(saved(tmp_path, table), PLAN, 14)
    flying = stacked(recording.series["onboard motors"], "w1", "w2", "w3", "w4")[int(0.6 * len(table)) + 1 :]
    assert flying == pytest.approx(rotors[int(0.6 * len(table)) + 1 :], rel=1e-9)


def test_commas_that_may_stand_between_thousands_are_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t;w1\n0;999\n1;1,200\n2;1,201\n")
    with pytest.raises(ReadError, match=r"column 'w1' \(such as 1,200\) may be decimal .* thousands separators"):
        open_table(path, [])
    path.write_text("t;w1\n0;0,999\n1;1,200\n2;1,201\n")
    assert pd.to_numeric(open_table(path, [])["w1"]).tolist() == [0.999, 1.2, 1.201]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t;w1\n0;999\n1;1.200\n2;1.201\n", r"points of column 'w1' \(such as 1.200\) may be decimal points or stand"),
        ("t;w1\n0,05;1.200\n0,1;1.201\n", r"'w1' \(such as 1.200\) .* for decimals of column 't' have a comma"),
        ("t;w1\n0,05;12.5\n0,1;12.5\n", r"'t' has decimal commas \(such as 0,05\) and column 'w1' decimal points"),
        ("t;w1\n0,05;1.200,5\n0,1;1.201,5\n", r"column 'w1' holds 1.200,5, whose thousands are separated"),
        ('t,w1\n0.05,"1,200"\n0.1,"1,201"\n', r"commas of column 'w1' \(such as 1,200\) may be decimal commas or"),
        ("t,m;w1,m;x\n0;1;2\n", r"holds as many commas as semicolons, expected one of them between columns; rename"),
        ("t w1\n0 1\n1 2\n", r"blanks separate its columns \('t w1'\), expected commas, semicolons or tabs; export it"),
        ("0.5,1\n1,2\n", r"its first line holds numbers \('0.5,1'\), expected the names of its columns; write them"),
        ("t;w1\n1,23E+09;1\n1,23E+09;2\n1,24E+09;3\n", r"'t' have lost their digits in 3 of 3 rows \(such as 1.23E"),
        ("t,w1\n1.23E+09,1\n1.23E+09,2\n1.24E+09,3\n", r"'t' have lost their digits in 3 of 3 rows \(such as 1.23E"),
    ],
)
def test_ambiguous_marks_and_shortened_clocks_are_refused(tmp_path, text, words):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(ReadError, match=words) as error:
        open_table(path, [], clocks=["t"])
    assert str(path) in str(error.value) and "\n" not in str(error.value) and ";" in str(error.value)


def test_an_array_that_pandas_wrote_has_counted_names(tmp_path):
    (tmp_path / "log.csv").write_text("0,1\n0.0,5\n0.1,6\n")
    assert list(open_table(tmp_path / "log.csv", [])) == ["0", "1"]


def test_marks_of_columns_that_nobody_maps_disturb_nothing(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t;w1;note\n0,05;5;1.200\n0,1;6,5;1.201\n")
    assert open_table(path, [], ["t", "w1"])["w1"].tolist() == [5.0, 6.5]
    with pytest.raises(ReadError, match="'note'"):
        open_table(path, [])


@pytest.mark.parametrize("above", ["# our lab\n", "\n\n", "% a, b\n#\n\n  \n", ";;;\n", "sep=,\n# our lab, run 3\n"])
def test_comments_and_empty_lines_above_the_header_are_skipped(tmp_path, flown, above):
    truth, _, table = flown
    path = tmp_path / "log.csv"
    path.write_text(above + table.to_csv(index=False))
    recording = read_table_log(path, PLAN, 14)
    assert stacked(recording.series["onboard"], "p", "q", "r") == pytest.approx(truth.rates, abs=1e-9)
    lines = above.count("\n")
    assert sum(f"{lines} lines above the header were skipped" in n for n in recording.notes) == 1


@pytest.mark.parametrize("first", ["# t", "%time"])
def test_a_comment_right_above_the_numbers_names_the_columns(tmp_path, first):
    path, notes = tmp_path / "log.csv", []
    path.write_text(f"# our lab\n{first},p\n0.1,2\n0.2,3\n")
    table = open_table(path, notes)
    assert list(table) == [first, "p"] and table["p"].tolist() == [2, 3]
    assert "1 lines above" in notes[0]


@pytest.mark.parametrize(
    ("quantity", "column", "factor", "said"),
    [
        ("w1", "m1", 60 / (2 * np.pi) * 7, "w1 reaches .* rad/s at most; check its unit"),
        ("command1", "share", 1500.0, "motor commands lay outside their range"),
        ("battery_voltage", "volt", 16000.0, "battery_voltage reaches 1.6e\\+04, where a battery has 100 V at most"),
    ],
)
def test_values_that_no_vehicle_has_are_in_doubt(tmp_path, flown, quantity, column, factor, said):
    _, _, table = flown
    plan = copy.deepcopy(PLAN)
    plan["sources"][1]["columns"][quantity] = {"column": column, "unit": "1"} if quantity == "command1" else column
    table = table.assign(share=1.0, volt=1.0)
    table[column] *= factor
    told = cautions(read_table_log(saved(tmp_path, table), plan, 14).notes)
    assert len(told) == 1 and re.search(said, told[0])
    table[column] = 1.0
    assert not cautions(read_table_log(saved(tmp_path, table), plan, 14).notes)


def test_held_capture_values_are_no_samples(tmp_path, flown):
    truth, _, table = flown
    plan = copy.deepcopy(PLAN)
    capture = {"name": "room", "motion capture": True, "columns": {"x": "cx", "y": "cy", "z": "cz"}}
    plan["sources"].append(capture)
    held = truth.position[(np.arange(len(truth.t)) // 3) * 3]
    for n, v in zip(("cx", "cy", "cz"), held.T):
        table[n] = v
    recording = read_table_log(saved(tmp_path, table), plan, 14)
    assert recording.series["capture"].t == pytest.approx(truth.t[::3], abs=1e-9)


def edited(change):
    plan = copy.deepcopy(PLAN)
    change(plan)
    return plan


WRONG = {
    "unknown unit 'deg/sec' (did you mean 'deg/s'": lambda p: p["sources"][0]["columns"]["p"].update(unit="deg/sec"),
    "measures length, expected one of": lambda p: p["sources"][0]["columns"]["p"].update(unit="mm"),
    "unknown quantity 'battery_volts' (did you mean 'battery_voltage'": lambda p: p["sources"][1]["columns"].update(
        battery_volts="vbat"
    ),
    "expected one of 'FRD', 'FLU'": lambda p: p["sources"][0].update(frame="flu"),
    "expected one of 'NED', 'z-up'": lambda p: p["sources"][0].update(world="ENU"),
    "unknown key 'colums' in 'sources' / entry 1 (did you mean 'columns'": lambda p: p["sources"][0].update(colums={}),
    "qz is not": lambda p: p["sources"][0]["columns"].pop("qz"),
    "always in world axes": lambda p: p["sources"][0]["columns"]["x"].update(frame="body"),
    "neither it nor the table has a 'time'": lambda p: p.pop("time"),
    "no source maps body rates": lambda p: [
        p["sources"][0]["columns"].pop(n) for n in ("p", "q", "r", "qw", "qx", "qy", "qz")
    ],
}


@pytest.mark.parametrize("message", WRONG)
def test_a_wrong_mapping_is_refused_in_a_sentence(tmp_path, flown, message):
    path = saved(tmp_path, flown[2])
    with pytest.raises(ConfigError) as caught:
        read_table_log(path, edited(WRONG[message]), 14)
    assert message in str(caught.value)


def test_a_missing_column_names_file_quantity_and_the_near_one(tmp_path, flown):
    path = saved(tmp_path, flown[2].rename(columns={"wy": "w_y"}))
    with pytest.raises(ReadError, match=r"log\.csv has no column 'wy' \(q of source 'state'\) .did you mean 'w_y'"):
        read_table_log(path, PLAN, 14)


def test_a_column_of_text_is_refused_and_single_cells_are_noted(tmp_path, flown):
    table = flown[2].astype({"wx": object})
    table.loc[5, "wx"] = "n/a!"
    recording = read_table_log(saved(tmp_path, table), PLAN, 14)
    assert any("'wx' holds text in 1 rows (first in row 7)" in n for n in recording.notes)
    table["wx"] = "text"
    with pytest.raises(ReadError, match="holds text"):
        read_table_log(saved(tmp_path, table), PLAN, 14)


@pytest.mark.parametrize("content", [b"a,b\n", b"\x00\x01\x02\x03" * 50, b"PAR1junk", b"t;stamp\n1;2\n"])
def test_what_is_no_table_is_refused(tmp_path, content):
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    with pytest.raises(ReadError, match=r"log\.csv"):
        read_table_log(path, PLAN, 14)


def test_electrical_speed_needs_the_pole_pairs():
    # 14 magnets, 7 pairs: 100 eRPM x 7 = 700 electrical turns a minute are 100 mechanical ones
    assert 7 * to_si("eRPM/100", "rad/s", "w1", 14) == pytest.approx(100 * 2 * np.pi / 60)
    assert UNITS["deg"][1] == pytest.approx(np.pi / 180)


@pytest.mark.skipif(
    not NANODRONE.is_dir(), reason=f"the nano-drone recordings are not at {NANODRONE}; set QUASI_SHARED_DATA"
)
@pytest.mark.parametrize("run", [1, 2, 3])
def test_real_nano_drone_flights_are_read_by_mapping_alone(run):
    plan = read_json(ROOT / "examples/nanodrone/config/NanoDroneConfig.json")["table columns"]
    recording = read_table_log(NANODRONE / f"square_run{run}.csv", plan, 12)
    raw = pd.read_csv(NANODRONE / f"square_run{run}.csv")
    board, force, motors = (recording.series[n] for n in ("onboard", "onboard accelerometer", "onboard motors"))
    assert len(board.t) <= raw["ros_timestamp"].nunique()
    assert len(board.t) >= raw["ros_timestamp"].nunique() - 3
    high = np.interp(force.t, board.t, -board.values["z"]) > 0.4
    # thrust acts along body z, drag is small: 0.7 m/s2 beside the raw row-wise turning of run 2
    assert np.std(stacked(force, "ax", "ay")[high]) < 0.45
    assert np.median(force.values["az"][high]) == pytest.approx(-9.9, abs=0.5)
    assert 1500 < np.nanmedian(motors.values["w1"][np.nan_to_num(motors.values["w1"]) > 1000]) < 2000
    about = recording.metadata["sources"]
    lags = {1: ("motors", 0.033), 2: ("accelerometer", 0.022)}
    if run in lags:
        source, lag = lags[run]
        assert about[source]["lag of main stamps"]["value"] == pytest.approx(lag, abs=0.003)
        assert about[source]["lag of main stamps"]["applied"]
