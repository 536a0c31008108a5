"""Wind: its record, its time of day, its sign, and what becomes of it up to the variables of a model."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_recordings import written

from quasi.airframe import read_airframe
from quasi.attitude import from_euler, matrix
from quasi.errors import DataError, ReadError
from quasi.filtering.flight import filter_flight
from quasi.importing.flight import import_flight
from quasi.importing.readers.day_time import clock, read_day_time
from quasi.importing.series import Recording
from quasi.importing.wind import add_wind, read_lvm
from quasi.project.workflow import Folder
from quasi.tables import COLUMNS, read_json, write_text
from quasi.terms.variables import Variables
from quasi_synthesis.campaign import make_flight, read_campaign

ROOT = Path(__file__).parents[2]
HOURS = 3600.0


def lvm(
    start="14:11:03.5", seconds=60.0, speed=lambda t: 5.0 + 0.0 * t, rate=10.0, separator=",", extra=0, decimal="."
):
    """A LabVIEW measurement: the start time in line 11, data behind 22 lines (more with `extra`)."""
    head = ["LabVIEW Measurement", "Writer_Version,2", "Reader_Version,2", "Separator,Comma", "Decimal_Separator,."]
    head += ["Multi_Headings,No", "X_Columns,One", "Time_Pref,Absolute", "Operator,ojf", "Date,2024/03/01"]
    head += [f"Time,{start}", "***End_of_Header***", "", "Channels,1", "Samples,600", "Date,2024/03/01"]
    head += [f"Time,{start}", "Y_Unit_Label,m/s", "X_Dimension,Time", "X0,0.0E+0", "Delta_X,0.1"]
    head += ["Comment,none"] * extra + ["***End_of_Header***"]
    t = np.arange(int(seconds * rate)) / rate
    rows = [f"{a:.6f},{b:.6f}" for a, b in zip(t, speed(t))]
    lines = [line.replace(",", separator) for line in [*head, *rows]]
    if decimal != ".":
        lines = [line.replace(".", decimal) if line[:1].isdigit() else line for line in lines]
        lines[4] = f"Decimal_Separator{separator}{decimal}"
    return "\n".join(lines) + "\n"


def read(folder, text):
    (folder / "wind.lvm").write_text(text, encoding="utf-8")
    return read_lvm(folder / "wind.lvm")


@pytest.mark.parametrize(
    "style",
    [{}, {"separator": "\t"}, {"extra": 3}, {"separator": "\t", "decimal": ","}, {"separator": ";", "decimal": ","}],
)
def test_every_form_of_record_gives_start_times_and_speeds(tmp_path, style):
    record = read(tmp_path, lvm(speed=lambda t: 4.0 + np.sin(t), **style))
    series = record.series["wind"]
    assert record.metadata["start"] == [pytest.approx(14 * HOURS + 11 * 60 + 3.5)]
    assert series.t == pytest.approx(np.arange(600) / 10)
    assert series.values["speed"] == pytest.approx(4.0 + np.sin(series.t), abs=1e-6)


def test_a_record_as_published_scripts_take_it_is_read_by_line_numbers(tmp_path):
    lines = [f"header {i},x" for i in range(22)]
    lines[10] = "whatever,09:15:20"
    record = read(tmp_path, "\n".join(lines + ["0.0,3.0", "0.5,3.5", "1.0,4.0"]))
    assert record.metadata["start"][0] == 9 * HOURS + 15 * 60 + 20
    assert record.series["wind"].values["speed"].tolist() == [3.0, 3.5, 4.0]


def test_lines_of_text_steps_back_and_absurd_speeds_are_left_out_and_said(tmp_path):
    text = lvm(seconds=2.0) + "0.5,5.0\n2.5,9e9\n2.6,x\n3.0,6.0\n"
    record = read(tmp_path, text)
    assert record.series["wind"].t[-1] == 3.0
    assert len(record.series["wind"].t) == 21
    assert any("2 lines hold no time" in n for n in record.notes)
    assert any("1 samples step back" in n for n in record.notes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("LabVIEW Measurement\nTime,14:11:03\n***End_of_Header***\n", "fewer than two samples"),
        (lvm().replace("Time,14:11:03.5", "Time,noon"), "no start time of day"),
        ("\0\1\2" * 100, "fewer than two samples"),
        (lvm(start="27:00:00"), "no start time of day"),
    ],
)
def test_unusable_records_are_refused_in_a_sentence(tmp_path, text, words):
    with pytest.raises(ReadError, match=r"wind\.lvm") as error:
        read(tmp_path, text)
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("text", "hours"),
    [
        ("2024-03-01 02.11.08.500 PM", [14]),
        ("2024-03-01 02.11.08.500 AM", [2]),
        ("2024-03-01 02.11.08.500 下午", [14]),
        ("2024-03-01 下午 02:11:08.5", [14]),
        ("2024-03-01 02.11.08.500 上午", [2]),
        ("2024-03-01 12.11.08.500 上午", [0]),
        ("2024-03-01 12.11.08.500 PM", [12]),
        ("2024-03-01 02.11.08.500 오후", [14]),
        ("2024-03-01 02.11.08.500 μμ", [14]),
        ("2024-03-01 02.11.08.500 p.m.", [14]),
        ("2024-03-01 02.11.08.500 ÏÂÎç", [2, 14]),  # Chinese in another code page
        ("2024-03-01 14.11.08.500", [14]),
        ("2024-03-01 00.11.08.500 AM", [0]),
        ("2024-03-01 02.11.08.500", [2, 14]),
        ("01.03.2024 12:11:08,500", [12, 0]),
    ],
)
def test_half_of_the_day_is_read_in_any_language_or_left_open(text, hours):
    found = read_day_time(text)
    assert list(found.seconds) == [pytest.approx(h * HOURS + 11 * 60 + 8.5) for h in hours]
    assert [clock(s) for s in found.seconds] == [f"{h:02d}:11:08" for h in hours]


@pytest.mark.parametrize("text", ["", "none", "2024-03-01", "25.00.00", "12.61.00", "1.2.3"])
def test_what_is_no_time_of_day_is_none(text):
    assert read_day_time(text) is None


def moving(seconds=20.0):
    """A flight on a grid at changing attitude."""
    t = np.arange(int(seconds * 50)) / 50
    angles = np.stack([0.3 * np.sin(t), 0.2 * np.cos(t), 0.5 * t], axis=-1)
    columns = {"t": t} | dict(zip(("roll", "pitch", "yaw"), angles.T))
    return pd.DataFrame(columns | {"u": np.sin(t), "v": 0.0 * t, "w": 0.1 * t})


def taken(start):
    return Recording({}, {"capture start": start}, [])


def blown(folder, start="2024-03-01 02.11.08.500 下午", text=None, seconds=20.0, **wind):
    (folder / "wind.lvm").write_text(text or lvm(), encoding="utf-8")
    frame = moving(seconds)
    notes = []
    asked = {"file": str(folder / "wind.lvm"), "static": None, "time offset": 0.0} | wind
    result, about = add_wind(frame, asked, taken(start), frame["t"].to_numpy() + 1.0, "f", notes)
    return result, about, notes


def test_velocity_through_the_air_is_over_ground_minus_the_airs(tmp_path):
    frame, about, notes = blown(tmp_path, speed=None)
    assert frame["wind_north"].to_numpy() == pytest.approx(5.0)
    for i in (0, 137, 999):
        row = frame.iloc[i]
        turn = matrix(from_euler(row.roll, row.pitch, row.yaw))
        over_ground = turn @ [row.u, row.v, row.w]
        through = turn @ [row.u_air, row.v_air, row.w_air]
        assert through == pytest.approx(over_ground - [5.0, 0.0, 0.0])
    assert not notes
    assert about["source"] == "record"
    assert all(c in COLUMNS for c in frame)


@pytest.mark.parametrize(("towards", "north", "east"), [(0, 5, 0), (180, -5, 0), (90, 0, 5), (None, 5, 0)])
def test_the_tunnel_blows_along_x_unless_turned(tmp_path, towards, north, east):
    frame, _, _ = blown(tmp_path, towards=towards)
    assert frame["wind_north"].to_numpy() == pytest.approx(north)
    assert frame["wind_east"].to_numpy() == pytest.approx(east)


@pytest.mark.parametrize("offset", [0.0, 2.0, -3.0])
def test_times_of_day_and_offset_tie_the_record_to_the_flight(tmp_path, offset):
    frame, _, _ = blown(tmp_path, text=lvm(speed=lambda t: 1.0 + 0.1 * t), **{"time offset": offset})
    # row 0 is capture time 1 s: 14:11:09.5 by the capture's clock, 6 s after the record began
    expected = 1.0 + 0.1 * (6.0 - offset + frame["t"].to_numpy())
    assert frame["wind_north"].to_numpy() == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("start", ["2024-03-01 02.11.08.500 ÏÂÎç", "2024-03-01 02.11.08.500"])
def test_the_half_day_that_overlaps_is_chosen(tmp_path, start):
    frame, about, _ = blown(tmp_path, start)
    assert about["clock"]["capture start"]["value"] == pytest.approx(14 * HOURS + 11 * 60 + 8.5)
    assert "overlaps" in about["clock"]["half of the day"]
    assert np.isfinite(frame["u_air"]).all()


def test_midnight_between_the_two_computers_is_bridged(tmp_path):
    _, about, _ = blown(tmp_path, "2024-03-02 00.00.04.000", text=lvm(start="23:59:58"))
    assert about["clock"]["capture minus record"]["value"] == pytest.approx(6.0)


def test_two_halves_that_both_overlap_and_none_are_refused_with_advice(tmp_path):
    long = lvm(start="01:00:00", seconds=15 * HOURS, rate=0.1)
    with pytest.raises(DataError, match="may mean 02:11:08 or 14:11:08.*write AM or PM"):
        blown(tmp_path, "2024-03-01 02.11.08.500 ÏÂÎç", text=long)
    with pytest.raises(DataError, match=r"began at 02:11:08 .* covers 14:11:03 to 14:12:03; correct 'OptiTrack time"):
        blown(tmp_path, "2024-03-01 02.11.08.500 AM")
    with pytest.raises(DataError, match="start time is 'tomorrow'"):
        blown(tmp_path, "tomorrow")


def test_rows_beyond_the_record_are_unknown_or_static_and_said(tmp_path):
    frame, _, notes = blown(tmp_path, text=lvm(seconds=12.0))
    unknown = frame["t"].to_numpy() > 11.9 - 6.0 + 1e-6
    assert np.isnan(frame["u_air"].to_numpy()).tolist() == unknown.tolist()
    assert "does not cover" in notes[0]
    frame, _, notes = blown(tmp_path, text=lvm(seconds=12.0), static=4.0)
    assert frame["wind_north"].to_numpy() == pytest.approx(np.where(unknown, 4.0, 5.0))
    assert "static 4 m/s is used there" in notes[0]


def test_static_wind_stands_in_for_a_record_that_is_absent_damaged_or_cannot_be_tied(tmp_path):
    frame, about, notes = blown(tmp_path, file=None, static=3.0)
    assert about["source"] == "static"
    assert frame["wind_north"].to_numpy() == pytest.approx(3.0)
    assert not notes
    _, _, notes = blown(tmp_path, text="nothing", static=3.0)
    assert "static wind of 3 m/s is used" in notes[0]
    assert "fewer than two samples" in notes[0]
    with pytest.raises(DataError, match="fewer than two samples.*or give 'Static wind"):
        blown(tmp_path, text="nothing")
    write_text(tmp_path / "wind.lvm", lvm())
    with pytest.raises(DataError, match="only by the start time of a motion capture"):
        add_wind(moving(), {"file": str(tmp_path / "wind.lvm")}, None, None, "f", [])


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A made flight in a wind of 4 m/s towards north, its wind record, and what import and filter make of them."""
    folder = tmp_path_factory.mktemp("wind")
    campaign = read_campaign(
        {
            "seed": 8,
            "duration": 25.0,
            "nuisance": 0.0,
            "flights": [{"key": "blown-1", "effects": {"wind": {"north": 4.0}}}],
        }
    )
    flight = make_flight(campaign, campaign.flights[0])
    began = read_day_time(flight.capture.split("Capture Start Time,")[1].split(",")[0]).seconds[0]
    write_text(folder / "wind.lvm", lvm(start=clock(began - 20), speed=lambda t: 4.0 + 0.01 * np.sin(t)))
    asked = {
        **written(folder, "blown-1", flight),
        "wind": {"file": str(folder / "wind.lvm"), "static": None, "time offset": 0.0, "towards": 0.0},
    }
    quadrotor = read_json(ROOT / "data/MadeBeetleConfig.json")
    quadrotor["optitrack marker cg offset"] = dict(zip("xyz", flight.metadata["capture"]["offset"]))
    imported, about = import_flight(asked, quadrotor, {})
    airframe = read_airframe(quadrotor, "Made")
    return flight, imported, about, filter_flight(imported, about, airframe, {}), airframe


def test_a_flight_in_wind_knows_its_velocity_through_the_air(flown):
    flight, imported, about, filtered, _ = flown
    truth = flight.truth
    t = truth["t"].to_numpy() - truth["t"].iloc[0] - about["start"]["value"]
    assert about["wind"]["speed"]["mean"] == pytest.approx(4.0, abs=0.02)
    for table, within in ((imported, 0.15), (filtered.with_gravity, 0.15)):
        # made flights are sheltered on the ground
        seen = table["t"].between(10, table["t"].iloc[-1] - 5).to_numpy()
        for axis in ("u", "v", "w", "u_air", "v_air", "w_air"):
            error = (np.interp(table["t"], t, truth[axis]) - table[axis])[seen]
            assert np.sqrt(np.mean(error**2)) < within, axis
    away = filtered.with_gravity["u"] - filtered.with_gravity["u_air"]
    assert away.abs().max() > 3.0


def test_variables_of_a_model_mean_velocity_through_the_air(flown):
    *_, filtered, airframe = flown
    table = filtered.with_gravity
    variables = Variables({c: table[c].to_numpy() for c in table}, airframe, None)
    assert variables["u"] == pytest.approx(table["u_air"].to_numpy())
    # and so the drag is explained by u, which over ground it is not
    valid = ((table["valid"] > 0.5) & (table["q"].abs() < 2)).to_numpy()
    drag = table["Fx"].to_numpy()[valid]

    def unexplained(velocity):
        design = np.column_stack([velocity[valid], np.ones(valid.sum())])
        return np.var(drag - design @ np.linalg.lstsq(design, drag, rcond=None)[0]) / np.var(drag)

    assert unexplained(variables["u"]) < 0.1
    assert unexplained(table["u"].to_numpy()) > 0.3


def test_rows_without_known_wind_are_not_used_for_identification(flown):
    _, imported, about, filtered, airframe = flown
    cut = imported.copy()
    cut.loc[cut["t"] > 15, ["wind_north", "wind_east", "wind_down", "u_air", "v_air", "w_air"]] = np.nan
    less = filter_flight(cut, about, airframe, {})
    assert any("wind is unknown" in n for n in less.metadata["notes"])
    assert not (less.with_gravity["valid"][cut["t"] > 15] > 0).any()
    before = cut["t"] < 15
    assert less.with_gravity["valid"][before].equals(filtered.with_gravity["valid"][before])
    assert np.isfinite(less.with_gravity["u_air"]).all()


def project(folder, **cells):
    """A folder with one flight; cells change its logbook row."""
    row = {
        "Flight ID": "1", "Rigid Body Name": "B", "Quadrotor": "Q", "Has OT data": "N", "Onboard Name": "f1",
        "OB Path": "raw", "Flight controller": "betaflight", "Mass": "400", "Drone Config File": "Q",
        "Drone Config Path": "data", "Has OJF data": "N", "OJF path": "raw", "OJF name": "", "Static wind (m/s)": "",
        "OptiTrack time offset (s)": "", "Wind towards (deg)": "",
    } | cells  # fmt: skip
    (folder / "data").mkdir()
    (folder / "raw").mkdir()
    (folder / "config").mkdir()
    (folder / "raw/f1.bbl").write_text("x")
    (folder / "raw/tunnel.lvm").write_text(lvm())
    (folder / "data/log.csv").write_text(",".join(row) + "\n" + ",".join(row.values()) + "\n")
    (folder / "data/Q.json").write_text((ROOT / "data/MadeBeetleConfig.json").read_text())
    config = read_json(ROOT / "config/processing.json")
    config["logging file"] = {"directory": "data", "filename": "log"}
    import json

    (folder / "config/processing.json").write_text(json.dumps(config))
    return Folder(folder).recordings.importing("Q", "f1")


def test_still_air_adds_nothing_to_the_settings_of_a_flight(tmp_path):
    settings = project(tmp_path)
    assert "wind" not in settings["flight"]
    assert settings["problem"] is None


@pytest.mark.parametrize("static", ["", "3"])
def test_a_wind_record_whose_flag_is_empty_calls_for_care(tmp_path, static):
    settings = project(tmp_path, **{"Has OJF data": "", "OJF name": "tunnel", "Static wind (m/s)": static})
    assert settings["problem"] is None and len(settings["flight"]["unread"]) == 1
    words = "row 2 names 'tunnel' in 'OJF name', which is not read because 'Has OJF data' is empty; write Y"
    assert words in settings["flight"]["unread"][0]


def test_the_logbook_row_hands_its_wind_on(tmp_path):
    settings = project(
        tmp_path,
        **{"Has OJF data": "Y", "OJF name": "tunnel", "OptiTrack time offset (s)": "-1.5", "Wind towards (deg)": "180"},
    )
    assert settings["problem"] is None
    assert settings["flight"]["wind"] == {
        "file": "raw/tunnel.lvm", "file problem": None, "static": None, "time offset": -1.5, "towards": 180.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("cells", "words"),
    [
        (
            {"Has OJF data": "Y", "OJF name": "tunel"},
            "raw file raw/tunel[.lvm|.LVM|.txt|.csv] does not exist; correct 'OJF name'",
        ),
        ({"Has OJF data": "Y"}, "neither 'OJF name' nor 'Static wind (m/s)' is given"),
        ({"Static wind (m/s)": "strong"}, "'Static wind (m/s)' is 'strong', expected a number"),
        ({"Static wind (m/s)": "inf"}, "'Static wind (m/s)' is 'inf', expected a number"),
    ],
)
def test_faults_of_the_wind_columns_are_sentences_of_that_flight(tmp_path, cells, words):
    assert words in project(tmp_path, **cells)["problem"]


@pytest.mark.parametrize(
    "cells", [{"Has OJF data": "Y", "OJF name": "tunel"}, {"Has OJF data": "N"}, {"Has OJF data": "Y"}]
)
def test_static_wind_needs_no_record(tmp_path, cells):
    settings = project(tmp_path, **cells, **{"Static wind (m/s)": "5.5"})
    assert settings["problem"] is None
    assert settings["flight"]["wind"]["static"] == 5.5


def test_a_moved_row_changes_nothing_where_a_static_wind_stands_in(tmp_path):
    before = project(tmp_path, **{"Has OJF data": "Y", "OJF name": "tunel", "Static wind (m/s)": "5.5"})
    assert before["flight"]["wind"]["file problem"].startswith("raw file raw/tunel[")
    log = tmp_path / "data/log.csv"
    header, row = log.read_text().splitlines()
    log.write_text(f"{header}\n{',' * header.count(',')}\n{row}\n")
    assert Folder(tmp_path).recordings.importing("Q", "f1") == before


def test_an_absent_wind_record_without_static_wind_names_row_and_flight(tmp_path):
    problem = project(tmp_path, **{"Has OJF data": "Y", "OJF name": "tunel"})["problem"]
    assert problem.partition("log.csv ")[2].startswith("row 2, flight f1: raw file raw/tunel[")
