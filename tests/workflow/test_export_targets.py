"""Exports as targets: what they make, what reruns, and what is said of a model that is not there."""

import json
import sys

import pytest
from conftest import ROOT, Project

sys.path.insert(0, str(ROOT / "tests" / "unit"))
import plain_plant
from made_model import document

from quasi.export.compiler import find_compiler
from quasi.export.matlab_check import find_octave
from quasi.export.targets import SIMULATOR_NAMES

pytestmark = [pytest.mark.workflow, pytest.mark.skipif(find_compiler() is None, reason="no C compiler")]
FILES = {
    "c": {"quasi_m.h", "quasi_m.c"},
    "fmu": {"quasi_m_forces_and_moments.fmu", "quasi_m_vehicle.fmu"},
    "python": {"quasi_m.py"},
}
MATLAB = {
    *(f"get_{axis}.m" for axis in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")),
    *("getFM.m", "getDroneInputs.m", "get_PQRDiffSys.m", "model_init.m", "main.m", "simulation"),
    *("droneParams.mat", "modelParams.mat", "Eul2Quat.m", "agreement.json"),
}
TARGETS = ("models/m/matlab", *(f"models/m/{kind}" for kind in FILES))


def test_exports_are_made_once_and_again_when_model_or_files_change(tmp_path):
    model = tmp_path / "project/models/m/standalone/model.json"
    model.parent.mkdir(parents=True)
    (tmp_path / "project/config").mkdir()
    model.write_text(json.dumps(document()))
    project = Project(tmp_path)
    code, printed = project.snakemake(*TARGETS)
    assert code == 0, printed
    for kind, files in FILES.items():
        folder = tmp_path / "project/models/m" / kind
        assert {p.name for p in folder.iterdir() if not p.name.startswith(".")} == {
            *files, "agreement.json", "agreement.txt"
        }  # fmt: skip
        assert json.loads((folder / "agreement.json").read_text())["agrees"] is True
        assert f"Made models/m/{kind}: " in printed
    matlab = tmp_path / "project/models/m/matlab"
    assert {p.name for p in matlab.iterdir()} >= MATLAB
    assert json.loads((matlab / "agreement.json").read_text())["agrees"] is (True if find_octave() else None)
    code, printed = project.snakemake(*TARGETS)
    assert code == 0 and "Nothing to be done" in printed
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "project").rename(tmp_path / "elsewhere/project")
    code, printed = Project(tmp_path / "elsewhere").snakemake(*TARGETS)
    assert code == 0 and "Nothing to be done" in printed, "a folder that moved"
    (tmp_path / "elsewhere/project").rename(tmp_path / "project")

    copy = Project(tmp_path)
    copy.copy_library()
    block = copy.house / "quasi/export/matlab_files/simulation/shorten.m"
    block.write_text(block.read_text() + "% changed\n")
    code, printed = copy.snakemake("-n", "models/m/matlab")
    reason = next(line for line in printed.splitlines() if "reason: " in line)
    assert code == 0 and "Updated input files: " in reason and "simulation/shorten.m" in reason

    made = tmp_path / "project/models/made/standalone/model.json"
    made.parent.mkdir(parents=True)
    made.write_text(json.dumps(plain_plant.made_model().document))
    simulators = [f"models/made/{name}" for name in SIMULATOR_NAMES]
    code, printed = project.snakemake(*simulators)
    assert code == 0, printed
    for target in simulators:
        folder = tmp_path / "project" / target
        assert json.loads((folder / "agreement.json").read_text())["agrees"] is True
        assert json.loads((folder / "constants.json").read_text())["schema"] == "quasi.constants/1"

    hostile = {**document(), "id": "../m"}
    model.write_text(json.dumps(hostile))
    code, printed = project.snakemake("models/m/c")
    assert code != 0 and "'id' is '../m'" in printed.strip().splitlines()[-1]

    code, printed = project.snakemake("models/n/python")
    last = printed.strip().splitlines()[-1]
    assert code != 0 and "neither config/models/n.json nor models/n/standalone/model.json exists" in last
