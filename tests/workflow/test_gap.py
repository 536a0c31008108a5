"""Gaps as targets: what they make, the extended model like any other, what reruns, and what is refused."""

import json

import pytest

pytestmark = pytest.mark.workflow
GAP = {
    "model": "small",
    "logging file": {
        "directory": "data",
        "filename": "small_file_log",
        "rows of flights to compare (all)": [2, 3, 4],
        "rows of flights held out": [4],
        "rows of reference flights": [5],
    },
    "horizons": [0.1, 0.5],
    "effects": ["ground_effect", "tether", "mass", "gyro_scale", "command_delay"],
}
NO_REFERENCE = {"rows of reference flights": []}  # row 5 would have to be made first
TARGET, EXTENDED = "results/gaps/near", "models/small-near/standalone"


def configure(project, name="near", **changes):
    places = {**GAP["logging file"], **changes.pop("rows", {})}
    (project.folder / "config/gaps").mkdir(exist_ok=True)
    (project.folder / f"config/gaps/{name}.json").write_text(json.dumps({**GAP, **changes, "logging file": places}))


def last_line(text):
    return text.rstrip().splitlines()[-1]


def test_a_gap_makes_diagnosis_report_and_a_model_and_a_second_run_does_nothing(project):
    configure(project)
    code, text = project.snakemake("-j2", TARGET, EXTENDED, "results/mcap/gaps/near")
    assert code == 0, text
    folder = project.folder / TARGET
    made = {p.relative_to(folder).as_posix() for p in folder.rglob("*.*")}
    assert made >= {"diagnosis.json", "report.html", "model.json", "calibration.json",
                    "tables/forces_residuals.parquet",
                    "tables/forces_where.parquet", "tables/rollouts_errors.parquet", "figures/where.png"}  # fmt: skip
    found = json.loads((folder / "diagnosis.json").read_text())
    assert found["schema"] == "quasi.gap/3" and found["model"] == "small" and found["extended_model"] == "small-near"
    assert found["verdict"] in ("agrees", "explained", "partly explained", "unexplained") and found["summary"]
    assert set(found["gap"]["before"]["rollouts"]["velocity"]) == {"0.1", "0.5"}
    assert set(found["gap"]["before"]["forces"]) == {"Fx", "Fy", "Fz", "Mx", "My", "Mz"}
    page = (folder / "report.html").read_text()
    assert found["verdict"] in page and "http://" not in page and "https://" not in page
    lives = page[page.index("Where the errors live") :]  # of sensors, drive, forces and moments, simulations
    for channel in ("northward acceleration", "speed of rotor 1", "vertical force", "velocity"):
        assert channel in lives
    model = json.loads((project.folder / EXTENDED / "model.json").read_text())
    assert model["id"] == "small-near" and model["provenance"]["extended from"] == "small"
    assert {e["id"] for e in model["extensions"]} == {
        e["id"] for e in found["effects"] if e["level"] in ("forces", "drive")
    }
    assert (project.folder / EXTENDED / "report.html").is_file()

    assert list((project.folder / "results/mcap/gaps/near").glob("*.mcap"))
    assert project.would_run(TARGET) == {} and project.would_run(EXTENDED) == {}
    # nothing that stands below a gap hears of it
    project.edit_json("config/gaps/near.json", lambda d: d.update({"horizons": [0.2]}))
    again = project.would_run(TARGET)
    assert again["gap_diagnosis"] == 1 and not {"importing", "filtering", "identification"} & set(again)


def test_a_held_out_flight_whose_recording_trained_the_model_is_refused(project):
    configure(project, rows={"rows of flights held out": [3], **NO_REFERENCE})
    code, text = project.snakemake("-j1", "results/calibrations/near.json")
    assert code != 0
    line = last_line(text)
    assert "held-out row 3 of data/small_file_log.csv has the recording of row 3 of data/small_file_log.csv" in line
    assert "hold out a flight that the model has never seen" in line
    assert "runs Python code" not in text


def test_a_copied_model_still_knows_the_recordings_that_trained_it(project):
    """Its rows are not known where it is put, its recordings are: by content, under whatever name they stand."""
    place = project.folder / "models/copied/standalone/model.json"
    place.parent.mkdir(parents=True)
    document = json.loads((project.folder / "models/small/standalone/model.json").read_text())
    assert set(document["recordings"]) == {"small-1", "small-2"}
    document["flights"]["training"] = ["elsewhere"]
    place.write_text(json.dumps(document))
    configure(project, model="copied", rows={"rows of flights held out": [3], **NO_REFERENCE})
    code, text = project.snakemake("-j1", "results/calibrations/near.json")
    assert code != 0
    words = "held-out row 3 of data/small_file_log.csv has the recording of flight small-2, which trained"
    assert words in last_line(text)
    configure(project, model="copied", rows={"rows of flights held out": [4], **NO_REFERENCE})
    code, text = project.snakemake("-j1", "results/calibrations/near.json")
    assert code == 0, text


def test_a_faulty_file_of_causes_ends_with_its_sentence(project):
    """Faults of the configuration itself are in `tests/unit/test_gap_configurations.py`."""
    (project.folder / "data/mine.py").write_text("EFFECT = 1 / 0\n")
    configure(project, rows=NO_REFERENCE, **{"effect files": ["data/mine.py"]})
    code, text = project.snakemake("-j1", "results/calibrations/near.json")
    assert code != 0
    assert "effect file data/mine.py: " in last_line(text)
    notice = (
        "[NOTICE] config/gaps/near.json runs Python code: effect files 'data/mine.py'; name only files that you trust"
    )
    # Snakemake's own lines on profiles come before any of a workflow
    assert any(line.startswith(notice) for line in text.splitlines()[:4])


def test_without_a_held_out_flight_forces_are_not_asked_and_the_rest_is(project):
    configure(project, rows={"rows of flights held out": [], **NO_REFERENCE})
    code, text = project.snakemake("-j2", TARGET)
    assert code == 0, text
    found = json.loads((project.folder / TARGET / "diagnosis.json").read_text())
    why = {c["id"]: c["why"] for c in found["cannot_be_asked"]}
    assert "no flight is held out" in why["ground_effect"] and "gyro_scale" not in why
    assert "forces and moments could not be asked" in found["summary"] and found["verdict"] == "not judged"
