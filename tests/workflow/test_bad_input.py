"""Faults of one flight stop that flight, faults of shared configuration stop the run; the last line is the remedy."""

import pytest
from conftest import Project

pytestmark = pytest.mark.workflow


def last_line(text):
    return text.rstrip().splitlines()[-1]


def parts(project):
    """Temporary files of unfinished writes."""
    return [p for p in project.folder.rglob("*.part") if ".snakemake" not in p.parts]


def test_missing_raw_file_fails_its_flight_and_the_others_go_on(project):
    def change(rows):
        rows.append({**rows[1], "Flight ID": "9", "Onboard Name": "lost", "Flight key": "lost"})

    project.edit_logbook(change)
    targets = [f"results/filtered/MadeBeetle/withGravity/{f}.parquet" for f in ("lost", "small-1")]
    (project.folder / targets[1]).unlink()
    code, text = project.snakemake("-j2", "--keep-going", *targets)
    assert code != 0
    assert "row 6, flight lost: raw file results/synthesis/small/onboard/lost" in last_line(text)
    assert "does not exist; correct" in last_line(text)
    assert (project.folder / targets[1]).is_file()
    assert not (project.folder / "results/imported/MadeBeetle/lost.parquet").exists()
    assert not parts(project)


def test_unknown_quadrotor_configuration_names_row_file_and_remedy(project):
    project.edit_logbook(lambda rows: rows[0].update({"Drone Config File": "MadeBeatleConfig"}))
    code, text = project.snakemake("-j1", "models/small/standalone")
    assert code != 0
    line = last_line(text)
    assert "row 2, flight small-1" in line
    assert "did you mean 'MadeBeetleConfig.json'" in line


def test_a_damaged_log_is_one_sentence(project):
    path = project.folder / "results/synthesis/small/onboard/small-1.bbl"
    path.write_bytes(path.read_bytes()[:700])  # cut in the header
    target = "results/imported/MadeBeetle/small-1.parquet"
    (project.folder / target).unlink()
    code, text = project.snakemake("-j1", "--allowed-rules", "importing", "--", target)
    assert code != 0
    assert "small-1.bbl" in last_line(text)
    assert "Traceback" not in last_line(text)
    assert not (project.folder / target).exists()
    assert not parts(project)


def test_fault_of_a_configuration_stops_the_run_with_its_sentence(project):
    """One of many: `tests/unit/test_workflow_models.py` has the others."""
    project.edit_json("config/processing.json", lambda c: c["data importing"].update({"resampling rte": 1}))
    code, text = project.snakemake("-j1", "models/small/standalone")
    assert code != 0
    assert "unknown key 'resampling rte' in 'data importing' (did you mean 'resampling rate'?" in last_line(text)


def test_clashing_flight_keys_and_missing_column_stop_the_run(project):
    project.edit_logbook(lambda rows: rows.append(dict(rows[0])))
    code, text = project.snakemake("-j1", "models/small/standalone")
    assert code != 0
    assert "rows 2 and 6 both mean flight 'small-1' of MadeBeetle" in last_line(text)
    path = project.folder / "data/small_file_log.csv"
    path.write_text(path.read_text().replace("Onboard Name", "Onbord Name"))
    code, text = project.snakemake("-j1", "models/small/standalone")
    assert code != 0
    assert "no column 'Onboard Name' (did you mean 'Onbord Name'" in last_line(text)


def test_unknown_variable_in_a_specification_names_it(project):
    def change(config):
        config["identification parameters"]["polynomial specification file"] = "mine"

    project.edit_json("config/models/small.json", change)
    folder = project.folder / "config/polynomials"
    folder.mkdir()
    axes = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
    import json

    mine = {a: {"candidates": [{"vars": ["u", "w_tott"], "degree": 2}], "fixed": ["w_tot"]} for a in axes}
    (folder / "mine.json").write_text(json.dumps(mine))
    code, text = project.snakemake("-j2", "models/small/standalone")
    assert code != 0
    assert "'w_tott'" in last_line(text)
    assert "did you mean 'w_tot'" in last_line(text)


def test_unknown_model_names_the_known(project):
    code, text = project.snakemake("-n", "models/smal/standalone")
    assert code != 0
    assert "config/models/smal.json does not exist (did you mean 'small'?" in last_line(text)


@pytest.mark.parametrize("mode", ["-n", "-j1"])
def test_a_target_that_no_rule_makes_names_the_nearest(project, mode):
    code, text = project.snakemake(mode, "models/small")
    assert code != 0
    assert "[ERROR] no rule makes 'models/small' (did you mean 'models/small/standalone'?" in last_line(text)


def test_a_slip_in_the_folders_name_is_told_with_the_folder(tmp_path):
    slip = Project(tmp_path)
    code, text = slip.snakemake("-n", "models/small/standalone")
    assert code != 0
    assert f"[ERROR] {slip.folder} is no project folder: it is empty, expected config/" in last_line(text)
