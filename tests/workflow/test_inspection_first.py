"""What raw files show stops a model before a flight is imported; with --keep-going the sound flights go on."""

import sys

import pytest
from conftest import HOUSE, ROOT, Project

sys.path.insert(0, str(ROOT / "tests/unit"))
from made_lab import edit, lay_lab

pytestmark = pytest.mark.workflow


@pytest.fixture
def lab(tmp_path):
    project = Project(tmp_path)
    for name in HOUSE:
        (project.house / name).parent.mkdir(parents=True, exist_ok=True)
        (project.house / name).symlink_to(ROOT / name)
    project.folder.mkdir()
    lay_lab(project.folder)
    return project


def test_a_fault_of_raw_files_stops_the_model_before_any_flight_is_imported(lab):
    edit(lab.folder, "Quad,433", "Qaud,433")
    edit(lab.folder, "Lab,c,data/raw", "Lab,c,data/rwa")
    code, text = lab.snakemake("-j2", "models/my_model/standalone")
    assert code != 0
    assert "no rigid body 'Qaud' (did you mean 'Quad'?)" in text
    assert "row 4, flight c: raw file data/rwa/c" in text
    assert text.rstrip().splitlines()[-1].startswith("[ERROR] data/")
    assert "import of " not in text and "filter of " not in text
    assert not (lab.folder / "results/imported").exists()


def test_a_fault_of_one_flight_leaves_the_others_when_going_on(lab):
    edit(lab.folder, "Quad,433", "Qaud,433")
    code, text = lab.snakemake("-j2", "--keep-going", "--until", "importing", "--", "processing")
    assert code != 0
    assert "no rigid body 'Qaud'" in text
    made = {p.stem for p in (lab.folder / "results/imported/Lab").glob("*.parquet")}
    assert made == {"a", "c"}
