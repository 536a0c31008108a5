"""The MATLAB export as a target: what it makes and what reruns it."""

import json
import sys

import pytest
from conftest import ROOT, Project

sys.path.insert(0, str(ROOT / "tests" / "unit"))
from made_model import document

from quasi.export.matlab_check import find_octave

pytestmark = pytest.mark.workflow
TARGET = "models/m/matlab"


def test_the_folder_is_made_once_and_again_when_its_files_change(tmp_path):
    model = tmp_path / "project/models/m/standalone/model.json"
    model.parent.mkdir(parents=True)
    (tmp_path / "project/config").mkdir()
    model.write_text(json.dumps(document()))
    project = Project(tmp_path)
    project.copy_library()
    code, printed = project.snakemake(TARGET)
    assert code == 0, printed
    folder = tmp_path / "project" / TARGET
    made = {p.name for p in folder.iterdir()}
    axes = {f"get_{axis}.m" for axis in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")}
    assert axes | {"getFM.m", "getDroneInputs.m", "get_PQRDiffSys.m", "model_init.m", "main.m", "simulation",
                   "droneParams.mat", "modelParams.mat", "Eul2Quat.m", "agreement.json"} <= made  # fmt: skip
    agrees = json.loads((folder / "agreement.json").read_text())["agrees"]
    assert agrees is (True if find_octave() else None)
    code, printed = project.snakemake(TARGET)
    assert code == 0 and "Nothing to be done" in printed

    block = project.house / "quasi/export/matlab_files/simulation/shorten.m"
    block.write_text(block.read_text() + "% changed\n")
    code, printed = project.snakemake(TARGET)
    assert code == 0, printed
    assert (folder / "simulation/shorten.m").read_text().endswith("% changed\n")
