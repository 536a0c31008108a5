"""What reruns and why: only what is stale, and a validation flight never refits a model."""

import json
import os
import re

import numpy as np
import pandas as pd
import pytest

pytestmark = pytest.mark.workflow

JUDGED = {"standalone_scores": 1, "standalone_figures": 1, "standalone_report": 1, "standalone": 1}
AXES_AND_AFTER = {"identification": 6, "standalone_model": 1, **JUDGED}
TRAJECTORIES = {"standalone_trajectories": 1}


def test_run_makes_the_model_and_tells_where_with_its_scores(finished):
    project, text = finished
    folder = project.folder / "models/small/standalone"
    made = {p.relative_to(folder).as_posix() for p in folder.rglob("*.*")}
    assert made >= {"model.json", "scores.parquet", "diagnostics.json", "coverage.parquet", "comparison.parquet"}
    assert made >= {"report.html", "summary.txt", "summary.json", "summary.tex"}
    assert made >= {"figures/Fz.png", "figures/quartiles_My.png", "figures/coverage.png", "figures/closeup_small-3.png"}
    assert made >= {"trajectories/small-1.png", "trajectories/small-3.png"}
    tail = text[text.index("Elapsed time") :]
    assert "models/small/standalone" in tail
    for axis in ("Fx", "Fy", "Fz", "Mx", "My", "Mz"):
        assert axis in tail
    assert "validation" in tail
    assert "Verdict: " in tail
    assert "single samples between training samples" not in text  # a flight was held out and judges
    assert "single samples between training samples" in (folder / "report.html").read_text()


def test_run_is_a_line_per_job_with_what_was_noted(finished):
    project, text = finished
    lines = text.splitlines()
    jobs = next(int(m[1]) for line in lines if (m := re.match(r"(\d+) jobs: synthesis 3, ", line)))
    told = [line for line in lines if re.match(rf"\[ *\d+/{jobs}\] ", line)]
    assert len(told) == jobs
    assert sum(" import of small-" in line for line in told) == 3
    assert "the log holds no attitude; it was estimated from gyro and accelerometer" in text
    same = f"snakemake -s {project.house / 'Snakefile'} -d {project.folder}"
    assert f"`{same} results/reports/MadeBeetle/small-1.html`" in text
    assert not re.search(r"^ *(input|output|jobid|reason|wildcards|resources):|localrule|Finished jobid", text, re.M)
    notes = sum(line.startswith("    - ") for line in lines)
    assert len(lines) < jobs + notes + 25


def test_second_run_does_nothing_and_says_where_the_result_begins(finished):
    code, text = finished[0].snakemake("models/small/standalone")
    assert code == 0 and "Nothing to be done" in text
    assert text.rstrip().endswith("Up to date; start with models/small/standalone/report.html")


def test_files_removed_from_the_folder_of_a_result_are_made_anew_and_nothing_else(project):
    folder = project.folder / "models/small/standalone"
    held = {path: path.read_bytes() for path in (folder / "report.html", folder / "figures/coverage.png")}
    for path in held:
        path.unlink()
    code, text = project.snakemake("models/small/standalone")
    assert code == 0 and "1 job: standalone 1" in text
    assert "models/small/standalone lacks 2 files, such as figures/coverage.png, that it was made with" in text
    assert "were not present when the DAG was created" not in text
    assert {path: path.read_bytes() for path in held} == held


def test_a_clock_that_jumped_between_jobs_and_a_moved_folder_compute_nothing_anew(project):
    # `project` is a copy under another path; each result gets a time of its own within two hours before or after
    rng = np.random.default_rng(1)
    for path in sorted(project.folder.rglob("*")):
        if {"results", "models"} & set(path.relative_to(project.folder).parts):
            time = path.stat().st_mtime + rng.uniform(-7200, 7200)
            os.utime(path, (time, time))
    # folders have no checksum: the job that copies figures and trajectories to the result may run again
    assert set(project.would_run()) <= {"standalone"}


def test_what_no_result_depends_on_reruns_nothing(project):
    def change(rows):
        rows[0]["Comments"] = "a gust at 20 s"
        rows[3]["Mass"] = "500"  # of a flight that the model does not use
        rows.append({**rows[-1], "Flight ID": "99", "Flight key": "later", "Onboard Name": "later"})

    def add_idle_options(config):
        config["manoeuvre excitations"] = {"excitation threshold": 0.3, "show isolation results": False}
        config["logging file"]["allow mixed batteries"] = True

    project.edit_logbook(change)
    project.edit_json("config/models/small.json", add_idle_options)
    (project.folder / "data/small_file_log.csv").rename(project.folder / "data/renamed.csv")
    for path in ("config/processing.json", "config/models/small.json"):
        project.edit_json(path, lambda c: c["logging file"].update(filename="renamed"))
    assert project.would_run() == {}


def test_import_keeps_logbook_row_and_cells(finished):
    project = finished[0]
    about = json.loads((project.folder / "results/imported/MadeBeetle/small-1.json").read_text())["logbook"]
    assert (about["path"], about["row"]) == ("data/small_file_log.csv", 2)
    assert about["cells"]["Flight controller"]
    assert "Comments" in about["cells"]


def test_mass_of_a_training_flight_filters_that_flight_and_refits(project):
    project.edit_logbook(lambda rows: rows[0].update(Mass="500"))
    assert project.would_run() == {"filtering": 1, "identification_shared": 1, **TRAJECTORIES, **AXES_AND_AFTER}


def test_validation_flight_never_refits(project):
    project.edit_logbook(lambda rows: rows[2].update(Mass="500"))
    assert project.would_run() == {"filtering": 1, **TRAJECTORIES, **JUDGED}


def test_regressor_cap_identifies_anew_and_nothing_before(project):
    def change(config):
        config["identification parameters"]["polynomial"]["regressor cap"] = 3

    project.edit_json("config/models/small.json", change)
    assert project.would_run() == AXES_AND_AFTER


def test_bias_switch_of_one_axis_refits_that_axis_alone(project):
    def change(config):
        config["identification parameters"]["add bias term fx"] = False

    project.edit_json("config/models/small.json", change)
    assert project.would_run() == {**AXES_AND_AFTER, "identification": 1}


def test_differential_form_assembles_the_model_anew_and_refits_nothing(project):
    def change(config):
        config["standalone"] = {"make moment DiffSys": True, "DiffSys u": ["U_p", "U_q"]}

    project.edit_json("config/models/small.json", change)
    assert project.would_run() == {"standalone_model": 1, **JUDGED}


def test_normalisation_refits_every_axis_and_nothing_before(project):
    project.edit_json("config/models/small.json", lambda c: c.update({"data normalization": {"normalize data": True}}))
    assert project.would_run() == AXES_AND_AFTER


def test_partition_draws_and_refits_and_processes_no_flight(project):
    project.edit_json("config/models/small.json", lambda c: c.update({"data partitioning": {"partition by": "blocks"}}))
    assert project.would_run() == {"identification_shared": 1, **AXES_AND_AFTER}


def test_stills_draw_the_trajectories_alone(project):
    project.edit_json("config/models/small.json", lambda c: c.update({"plotting": {"number of drone stills": 2}}))
    assert project.would_run() == {**TRAJECTORIES, "standalone": 1}


def test_isolation_trains_each_axis_on_its_own_rows_and_no_rows_left_is_a_sentence(project):
    def isolate(config):
        config["manoeuvre excitations"] = {"isolate to regions of excitation": True, "excitation threshold": 0.3}
        config["identification parameters"] |= {f"identify {a}": False for a in ("fx", "fy", "mx", "my")}

    project.edit_json("config/models/small.json", isolate)
    parts = "results/parts/standalone/small"
    code, text = project.snakemake("-j2", f"{parts}/report.html", f"{parts}/figures")
    assert code == 0, text
    folder = project.folder / parts
    assert (folder / "figures/isolation_Fz.png").is_file()
    rows = {axis: json.loads((folder / "model.json").read_text())["axes"][axis]["n"] for axis in ("Fz", "Mz")}
    partition = pd.read_parquet(project.folder / "results/identified/small/partition.parquet")
    training = partition[partition["role"] == 1]
    for axis, n in rows.items():
        assert n == training[f"excited_{axis}"].sum() < len(training)
    scores = pd.read_parquet(folder / "scores.parquet").query("flight == 'all' and role == 'training'")
    assert dict(zip(scores["axis"], scores["n"])) == rows

    def nothing_left(config):
        config["manoeuvre excitations"]["excitation threshold"] = 1.0
        config["manoeuvre excitations"]["spread"] = 0.0
        config["data partitioning"] = {"partition ratio": 0.03}

    project.edit_json("config/models/small.json", nothing_left)
    code, text = project.snakemake("-j1", "models/small/standalone")
    assert code != 0
    assert "no training rows are left after isolation to regions of excitation; lower" in text.rstrip().splitlines()[-1]


def test_importing_option_processes_the_models_flights_anew(project):
    project.edit_json("config/processing.json", lambda c: c["data importing"].update({"resampling rate": 200}))
    assert project.would_run()["importing"] == 3


def test_edited_module_reruns_the_stages_that_use_it_and_no_others(project):
    stages = {
        "quasi/filtering/forces.py": {"filtering": 3, "identification_shared": 1, **TRAJECTORIES, **AXES_AND_AFTER},
        "quasi/identification/isolation.py": {"identification_shared": 1, **AXES_AND_AFTER},
        "quasi/scoring/verdict.py": JUDGED,
        "quasi/pages/chart.py": {"standalone_report": 1, "standalone": 1},
        "quasi/pages/animation.py": {**TRAJECTORIES, "standalone": 1},
        "quasi/identification/stepwise.py": AXES_AND_AFTER,
    }
    project.copy_library()
    text = {module: (project.house / module).read_text() for module in stages}
    for module in stages:
        (project.house / module).write_text(text[module] + "\n# a comment more\n")
    assert project.would_run() == {}, "a comment is no change"
    for module, expected in stages.items():
        (project.house / module).write_text(text[module] + "\n\ndef added() -> int:\n    return 1\n")
        assert project.would_run() == expected, module
        (project.house / module).write_text(text[module])


def test_rows_that_mean_other_flights_now_are_told_before_the_run(project):
    shared = json.loads((project.folder / "results/identified/small/shared.json").read_text())
    assert shared["flights"]["selected"] == ["small-1", "small-2"]
    project.edit_json(
        "config/models/small.json", lambda c: c["logging file"].update({"rows of flights to use (all)": [2, 4, 5]})
    )
    code, text = project.snakemake("-n", "models/small/standalone")
    assert code == 0
    assert "now mean the training flights small-1, small-4; it was made from small-1, small-2" in text


def test_lost_file_of_the_model_is_made_anew_when_asked_for(project):
    (project.folder / "models/small/standalone/model.json").unlink()
    assert project.would_run("models/small/standalone/model.json") == {"standalone": 1}
