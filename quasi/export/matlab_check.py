"""MATLAB functions run in GNU Octave, where it is installed, and compared with the model. No shell is started."""

import io
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from quasi.errors import DataError
from quasi.export.agreement import AGREEMENT_LIMIT, Check, compare, form_of, names_of_form, states_of, wrench_of
from quasi.export.matlab import write_mat
from quasi.export.matlab_terms import matlab_name
from quasi.model.model import Model
from quasi.tables import read_bytes, write_text

NO_OCTAVE = "GNU Octave was not found; install octave, or run check_model in MATLAB in this folder"
_PATIENCE = 300.0  # s
_RUN = """load('asked.mat');
addpath('{folder}');
[modelParams, droneParams] = model_init();
[F, M, d] = getFM(state, inputs, modelParams, droneParams, extra);
found = [F M];
form = zeros(size(state, 1), 0);
if exist('get_PQRDiffSys', 'file')
    [A, B] = get_PQRDiffSys(d);
    form = [reshape(permute(A, [2 1 3]), 9, []).' reshape(permute(B, [2 1 3]), size(B, 2)*3, []).'];
end
save('-v7', 'found.mat', 'found', 'form');
"""


def find_octave() -> str | None:
    """Path of the command of Octave: the environment's OCTAVE, else octave-cli or octave; None where there is none."""
    for name in (os.environ.get("OCTAVE", ""), "octave-cli", "octave"):
        if name and shutil.which(name):
            return shutil.which(name)
    return None


def run_octave(folder: str | Path, script: str, inputs: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Run statements in a folder, with asked.mat of `inputs` in it; returns what they saved in found.mat, or {}.

    Raises DataError without Octave, or with its first complaint.
    """
    octave = find_octave()
    if octave is None:
        raise DataError(NO_OCTAVE)
    folder = Path(folder)
    if inputs is not None:
        write_mat(folder / "asked.mat", dict(inputs))
    write_text(folder / "quasi_run_here.m", script)
    command = [octave, "--no-gui", "--no-init-file", "--no-site-file", "--quiet", "quasi_run_here.m"]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        raise DataError(
            f"{octave} did not finish within {_PATIENCE:.0f} s; end what else runs, and try again"
        ) from None
    if done.returncode:
        first_error = next((line for line in done.stderr.splitlines() if line.startswith("error:")), done.stderr[:200])
        raise DataError(f"Octave refuses the exported functions ({' '.join(first_error.split())}); please report this")
    made = folder / "found.mat"
    return loadmat(io.BytesIO(read_bytes(made)), squeeze_me=True, struct_as_record=False) if made.is_file() else {}


def check_matlab(model: Model, folder: str | Path, u: Iterable[str] | None) -> list[Check]:
    """Forces, moments, A and B of an exported folder, run in Octave, against the model, on 10,000 random states."""
    at = states_of(model)
    extra = {matlab_name(name): values[:, None] for name, values in at.extra.items()}
    extra |= {f"w{i + 1}_dot": at.accelerations[:, i : i + 1] for i in range(4)}
    script = _RUN.format(folder=str(Path(folder).resolve()).replace("'", "''"))
    with tempfile.TemporaryDirectory(prefix="quasi-octave-") as place:
        found = run_octave(place, script, {"state": at.state, "inputs": at.speeds, "extra": extra})
    checks = [compare("forces and moments", found["found"], wrench_of(model, at))]
    if u is not None:
        u = list(u)
        form = np.asarray(found["form"]).reshape(len(at.state), -1)
        checks.append(compare("differential form", form, form_of(model, at, u), names_of_form(u), AGREEMENT_LIMIT))
    return checks
