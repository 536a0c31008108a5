"""Simulations as targets: what they make, what reruns, and what is said of a faulty configuration."""

import json
import sys

import pandas as pd
import pytest
from conftest import ROOT, Project

from quasi.tables import read_fields

sys.path.insert(0, str(ROOT / "tests" / "unit"))
from plain_plant import made_model

pytestmark = pytest.mark.workflow
TARGET = "results/simulations/turns"


@pytest.fixture
def project(tmp_path):
    """A folder with a model that was put there, a table of wind, and one simulation."""
    folder = tmp_path / "project"
    for part in ("config/simulations", "data", "models/made/standalone"):
        (folder / part).mkdir(parents=True)
    (folder / "models/made/standalone/model.json").write_text(json.dumps(made_model().document))
    (folder / "data/wind.csv").write_text("t, wind_north, wind_east, wind_down\n0, 1, 0, 0\n1, 2, 0, 0\n")
    settings = {
        "model": {"model ID": "made"},
        "simulation": {"duration": 2},
        "references": {"do circle track": True},
        "wind": {"file": "data/wind.csv"},
        "animation": {"show": True, "save": False},
    }
    (folder / "config/simulations/turns.json").write_text(json.dumps(settings))
    return Project(tmp_path)


def test_a_simulation_makes_its_table_summary_and_figures_and_reruns_what_changed(project):
    code, text = project.snakemake("-j1", TARGET, "results/mcap/simulations/turns.mcap")
    assert code == 0, text
    recording = project.folder / "results/mcap/simulations/turns.mcap"
    assert recording.read_bytes().startswith(b"\x89MCAP0\r\n")
    assert b'"/simulated/state/p"' in recording.with_suffix(".plotjuggler.xml").read_bytes()
    folder = project.folder / TARGET
    made = {p.relative_to(folder).as_posix() for p in folder.rglob("*.*")}
    assert made >= {"flight.parquet", "summary.json", "summary.txt", "figures/states.png", "figures/trajectory.png"}
    table = pd.read_parquet(folder / "flight.parquet")
    assert len(table) == 501 and table["wind_north"].iloc[-1] == 2.0
    fields = read_fields(folder / "flight.parquet")
    assert fields["x"]["unit"] == "m" and fields["p_measured"]["unit"] == "rad/s" and fields["x_ref"]["unit"] == "m"
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["schema"] == "quasi.simulation/1" and summary["ended"] is None
    assert "position error" in text and TARGET in text
    assert "'show' is accepted but not used" in text

    assert project.would_run(TARGET) == {}
    path = "config/simulations/turns.json"
    project.edit_json(path, lambda d: d["animation"].update({"speed": 2}))
    assert "simulation_flight" not in project.would_run(TARGET)
    project.edit_json(path, lambda d: d["noise"].update({"seed": 3}) if "noise" in d else d.update(noise={"seed": 3}))
    assert project.would_run(TARGET)["simulation_flight"] == 1


def test_a_faulty_configuration_ends_with_its_sentence(project):
    """One that only the job sees: `tests/unit/test_workflow.py` has the others."""
    project.edit_json("config/simulations/turns.json", lambda d: d.update(controller={"controller": "drone_INDY"}))
    code, text = project.snakemake("-j1", TARGET)
    assert code != 0
    assert "drone_INDY" in text.strip().splitlines()[-1]
    assert not (project.folder / TARGET).exists()


def test_an_unknown_simulation_names_the_nearest(project):
    code, text = project.snakemake("-n", "results/simulations/turn")
    assert code != 0 and "config/simulations/turn.json does not exist (did you mean 'turns'?)" in text
