"""What raw files hold, known from reading them alone, and what that stops; `quasi check`."""

import json
import os
import shutil
from pathlib import Path

import pytest
from made_lab import IMU, PLACE, ROTORS, edit, lay_lab, log

from quasi.command import main
from quasi.errors import cautions
from quasi.importing import inspection
from quasi.importing.flight import import_flight
from quasi.importing.inspection import Inspector, inspect_flight, refusals, usable_for
from quasi.project.workflow import Folder

ROOT = Path(__file__).parents[2]


@pytest.fixture
def lab(tmp_path):
    return lay_lab(tmp_path)


def inspected(lab, monkeypatch, kind="models", name="my_model"):
    monkeypatch.chdir(lab)
    asked = Folder(".").inspection(kind, name)
    return asked, {key: inspect_flight(about["settings"]) for key, about in asked["flights"].items()}


def test_what_each_flight_holds_is_found_with_its_rates(lab, monkeypatch):
    _, found = inspected(lab, monkeypatch)
    a, b = found["Lab/a"], found["Lab/b"]
    assert [one["problem"] for one in found.values()] == [None] * 3
    assert a["onboard"]["rate"] == pytest.approx(100.0) and a["onboard"]["duration"] == pytest.approx(9.99)
    assert a["lacks"] == ["commands", "attitude", "velocity"]
    assert a["holds"]["position"] == {"rate": pytest.approx(100.0), "from": "onboard"}
    assert b["capture"]["rate"] == pytest.approx(120.0) and b["capture"]["rigid body"] == "Quad"
    assert b["holds"]["attitude"] == {"rate": pytest.approx(120.0, rel=0.05), "from": "capture"}
    assert b["lacks"] == ["commands", "battery", "velocity"]
    assert {usable_for(one) for one in found.values()} == {"models and gaps"}


FAULTS = {
    "no rotor speeds": (lambda lab: log(lab / "data/raw/a.csv", *IMU, *PLACE), "flight a holds no rotor speeds"),
    "rotor speeds all 0": (
        lambda lab: log(lab / "data/raw/a.csv", *IMU, *PLACE, **dict.fromkeys(ROTORS, 0.0)),
        "to estimate them from (the speeds of all rotors are 0",
    ),
    "wrong rigid body": (lambda lab: edit(lab, "Quad,433", "Qaud,433"), "no rigid body 'Qaud' (did you mean 'Quad'?)"),
    "wrong path": (lambda lab: edit(lab, "Lab,a,data/raw", "Lab,a,data/rwa"), "raw file data/rwa/a"),
    "mistyped controller": (lambda lab: edit(lab, "a,data/raw,table", "a,data/raw,tabel"), "controller' is 'tabel'"),
    "another controller": (lambda lab: edit(lab, "a,data/raw,table", "a,data/raw,betaflight"), "data/raw/a.csv"),
    "no gyro": (lambda lab: log(lab / "data/raw/a.csv", *IMU[3:], *PLACE, *ROTORS), "'p'"),
    "mass in kg": (lambda lab: edit(lab, "Quad,433", "Quad,0.433"), "'Mass' is 0.433 grams"),
    "mass of another": (lambda lab: edit(lab, "Quad,433", "Quad,90000"), "mass of 90 kg give radii of gyration"),
    "empty file": (lambda lab: (lab / "data/raw/c.csv").write_text(""), "data/raw/c.csv is empty"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_that_raw_files_show_is_named_and_check_ends_with_1(lab, monkeypatch, capsys, fault):
    change, words = FAULTS[fault]
    change(lab)
    asked, found = inspected(lab, monkeypatch)
    refused = refusals(asked, found)
    assert len(refused) == 1 and words in refused[0]
    assert main(["check", str(lab)]) == 1
    printed = capsys.readouterr().out
    assert printed.startswith("NOT READY: ")
    assert "model my_model" in printed.splitlines()[0]
    assert refused[0] in printed


def test_a_sound_folder_is_ready_and_an_untouched_gap_disturbs_nothing(lab, capsys):
    assert main(["check", str(lab)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "READY: 3 flights can be read; possible: processing, model my_model."
    head = lines[2]
    for line in lines[3:6]:
        assert line[head.index("usable for") :] == "models and gaps"
        assert line[head.index("rotor speeds") :].startswith("100 Hz")
    assert "gap my_gap" in lines[-1]


def test_a_row_without_a_log_is_named(lab, capsys):
    path = lab / "data/logbook.csv"
    path.write_text(path.read_text() + "Lab,,data/raw,table,my_quadrotor,data,N,,,,433\n")
    assert main(["check", str(lab)]) == 0
    assert "\n- data/logbook.csv: row 5 has no 'Onboard Name' and is left out; fill it in" in capsys.readouterr().out


@pytest.mark.parametrize(("flag", "read"), [("", True), ("N", False)])
def test_a_capture_whose_flag_is_empty_calls_for_care(lab, monkeypatch, capsys, flag, read):
    path = lab / "data/logbook.csv"
    path.write_text(path.read_text().replace("c,data/raw,table,my_quadrotor,data,N,,,",
                                             f"c,data/raw,table,my_quadrotor,data,{flag},c_ot,data/raw,"))  # fmt: skip
    sentence = "row 4 names 'c_ot' in 'Raw OptiTrack Name', which is not read because 'Has OT data' is empty; write Y"
    main(["check", str(lab)])
    assert (f"- c: data/logbook.csv {sentence}" in capsys.readouterr().out) is read
    monkeypatch.chdir(lab)
    settings = Folder(".").recordings.importing("Lab", "c")
    _, about = import_flight(settings["flight"], settings["quadrotor"], settings["options"])
    assert any(sentence in note for note in cautions(about["notes"])) is read


def test_position_or_velocity_is_needed_by_a_training_flight_only_where_none_has_it(lab, monkeypatch):
    log(lab / "data/raw/a.csv", *IMU, *ROTORS)
    asked, found = inspected(lab, monkeypatch)
    assert refusals(asked, found) == []
    assert usable_for(found["Lab/a"]) == "its page only: no position or velocity"
    edit(lab, "data,Y,b_ot", "data,N,b_ot")
    asked, found = inspected(lab, monkeypatch)
    assert [s for s in refusals(asked, found) if "a, b" in s and "position or velocity" in s]
    asked, found = inspected(lab, monkeypatch, "processing", "flights")
    assert refusals(asked, found) == []  # a page shows what there is


def test_several_faults_are_all_named(lab, capsys):
    edit(lab, "Quad,433", "Qaud,433")
    edit(lab, "Lab,c,data/raw", "Lab,c,data/rwa")
    assert main(["check", str(lab)]) == 1
    printed = capsys.readouterr().out
    assert "2 of 3 flights cannot be read" in printed.splitlines()[0]
    assert "'Qaud'" in printed and "data/rwa/c" in printed


def test_import_refuses_in_the_same_words(lab, monkeypatch):
    edit(lab, "Quad,433", "Qaud,433")
    _, found = inspected(lab, monkeypatch)
    settings = Folder(".").recordings.importing("Lab", "b")
    with pytest.raises(ValueError) as refused:
        import_flight(settings["flight"], settings["quadrotor"], settings["options"])
    assert str(refused.value) == found["Lab/b"]["problem"]


def test_a_flight_is_read_again_only_where_its_files_settings_or_the_code_changed(lab, monkeypatch):
    monkeypatch.chdir(lab)
    done = []
    read = inspection.inspect_flight
    monkeypatch.setattr(inspection, "inspect_flight", lambda s: done.append(s["flight"]["flight"]) or read(s))

    def look(version="1"):
        done.clear()
        for about in Folder(".").inspection("models", "my_model")["flights"].values():
            Inspector("memory", version).inspect(about["settings"])
        return list(done)

    assert look() == ["a", "b", "c"]
    assert look() == []
    log(lab / "other", *IMU, *PLACE, *ROTORS)
    os.utime(lab / "other", (1e9, 1e9))
    (lab / "other").replace(lab / "data/raw/c.csv")
    assert look() == ["c"]
    edit(lab, "Quad,433", "Qaud,433")
    assert look() == ["b"]
    assert look("2") == ["a", "b", "c"]


def test_flights_that_rules_are_still_to_make_are_no_fault(tmp_path, capsys):
    for name in ("config/processing.json", "config/synthesis/example.json", "data/example_file_log.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    shutil.copy(ROOT / "data/MadeBeetleConfig.json", tmp_path / "data")
    assert main(["check", str(tmp_path)]) == 0
    assert capsys.readouterr().out.count("to be made") == 8


def test_a_gap_whose_held_out_recording_trained_its_model_is_refused(lab, capsys):
    gap = json.loads((lab / "config/gaps/my_gap.json").read_text())
    rows = {"rows of flights to compare (all)": [2, 4], "rows of flights held out": [4]}
    gap["logging file"] |= rows
    (lab / "config/gaps/my_gap.json").write_text(json.dumps(gap))
    assert main(["check", str(lab)]) == 0
    capsys.readouterr()
    gap["logging file"] |= {"rows of flights to compare (all)": ["2-3"], "rows of flights held out": [3]}
    (lab / "config/gaps/my_gap.json").write_text(json.dumps(gap))
    assert main(["check", str(lab)]) == 1
    printed = capsys.readouterr().out
    assert printed.splitlines()[0].endswith("not possible: gap my_gap.")
    assert "held-out row 3 of data/logbook.csv has the recording of row 3 of data/logbook.csv" in printed


def test_a_gap_with_a_flight_without_rotor_speeds_is_refused_and_its_model_is_not(lab, capsys):
    log(lab / "data/raw/c.csv", *IMU, *PLACE)
    for path, rows in (
        (
            "config/models/my_model.json",
            {"rows of flights to use (all)": ["2-3"], "rows of flights for validation": []},
        ),
        ("config/gaps/my_gap.json", {"rows of flights to compare (all)": [4], "rows of flights held out": []}),
    ):
        document = json.loads((lab / path).read_text())
        document["logging file"] |= rows
        (lab / path).write_text(json.dumps(document))
    assert main(["check", str(lab)]) == 1
    printed = capsys.readouterr().out
    assert printed.splitlines()[0].endswith("not possible: gap my_gap.")
    assert "gap my_gap: flight c holds no rotor speeds" in printed


def test_one_dead_rotor_is_named_and_calls_for_care(lab, monkeypatch):
    log(lab / "data/raw/a.csv", *IMU, *PLACE, *ROTORS, w2=0.0)
    asked, found = inspected(lab, monkeypatch)
    assert refusals(asked, found) == []
    assert any("rotor 2" in remark for remark in found["Lab/a"]["remarks"])
    assert usable_for(found["Lab/a"]) == "models and gaps, with care"
    assert usable_for(found["Lab/c"]) == "models and gaps"
