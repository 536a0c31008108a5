"""Exports at work: the C file through a shared library, the Python file in a process of its own that has no quasi."""

import ctypes
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quasi.errors import DataError
from quasi.export.agreement import (
    AGREEMENT_LIMIT,
    COMPARED_STATES_ROWS,
    LIMIT_FLOAT32,
    Check,
    States,
    compare,
    form_of,
    names_of_form,
    states_of,
    wrench_of,
)
from quasi.export.compiler import shared_library, write_files
from quasi.export.contents import differential_inputs, has_region, name_in_source
from quasi.model.model import Model


class Found(NamedTuple):
    """What an export gives: wrench (N, 6), differential form (N, 9 + 3 K) or None, distance (N, 1) or None."""

    wrench: np.ndarray
    form: np.ndarray | None
    distance: np.ndarray | None


# read rows of float64 from standard input, write rows of float64 to standard output
_ASK = """
import sys
sys.modules["quasi"] = None
sys.path.insert(0, sys.argv[1])
import importlib, numpy as np
module = importlib.import_module(sys.argv[2])
table = np.frombuffer(sys.stdin.buffer.read()).reshape(int(sys.argv[3]), -1)
given = table[:, :12], table[:, 12:16], table[:, 16:20], dict(zip(module.EXTRA_INPUTS, table[:, 20:].T))
parts = [np.column_stack(module.predict(*given))]
if sys.argv[4] == "form":
    parts += [part.reshape(len(table), -1) for part in module.differential_form(*given)]
if sys.argv[5] == "distance":
    parts.append(module.distance(*given)[0][:, None])
sys.stdout.buffer.write(np.ascontiguousarray(np.column_stack(parts)).tobytes())
"""


def run_python(
    model: Model, name: str, text: str, at: States
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Wrench (N, 6), differential form (N, 9 + 3 K) or None, and distance (N, 1) or None of an exported Python file."""
    u, limited = differential_inputs(model), has_region(model)
    with tempfile.TemporaryDirectory(prefix="quasi-export-") as folder:
        write_files(folder, {name: text})
        asked = [sys.executable, "-c", _ASK, folder, Path(name).stem, str(len(at.state))]
        asked += ["form" if u else "-", "distance" if limited else "-"]
        done = subprocess.run(asked, input=np.ascontiguousarray(at.table).tobytes(), capture_output=True, cwd=folder)
    if done.returncode:
        last_line = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise DataError(
            f"the Python export of model {model.id} does not run ({' '.join(last_line)}); please report this"
        )
    return _split(np.frombuffer(done.stdout).reshape(len(at.state), -1), len(u), limited)


def _split(found: np.ndarray, inputs: int, limited: bool) -> Found:
    wide = 9 + 3 * inputs if inputs else 0
    form = found[:, 6 : 6 + wide] if inputs else None
    return Found(found[:, :6], form, found[:, 6 + wide :] if limited else None)


def run_c(model: Model, files: Mapping[str, str], at: States, float32: bool = False) -> Found:
    """What an exported C file gives, compiled here. Raises DataError without a compiler."""
    p, u, limited = name_in_source(model), differential_inputs(model), has_region(model)
    real = ctypes.c_float if float32 else ctypes.c_double
    with tempfile.TemporaryDirectory(prefix="quasi-export-") as folder:
        write_files(folder, files)
        # called a few times: optimised, it takes three times as long to compile and gives the same results
        flags = ("-std=c99", "-O0", "-ffp-contract=off", "-fPIC", "-shared")
        defines = ["QUASI_FLOAT32"] if float32 else []
        path = shared_library(folder, [f"{p}.c"], "model.so", defines, flags)
        library = ctypes.CDLL(str(path))
    table = np.ascontiguousarray(at.table, dtype=np.dtype(real))
    wide = 9 + 3 * len(u) if u else 0
    found = np.empty((len(table), 6 + wide + limited), np.dtype(real))
    size = found.itemsize
    forces = getattr(library, f"{p}_forces_and_moments")
    form = getattr(library, f"{p}_differential_form") if u else None
    distance = getattr(library, f"{p}_distance") if limited else None
    if distance is not None:
        distance.restype = real
    pointer = ctypes.c_void_p
    for k in range(len(table)):
        row, out = table[k].ctypes.data, found[k].ctypes.data
        given = [pointer(row + size * at) for at in (0, 12, 16, 20)]
        forces(*given, pointer(out), pointer(out + 3 * size))
        if form is not None:
            form(*given, pointer(out + 6 * size), pointer(out + 15 * size))
        if distance is not None:
            found[k, -1] = distance(*given, None)
    return _split(found.astype(float), len(u), limited)


def check_python(model: Model, name: str, text: str, rows: int = COMPARED_STATES_ROWS) -> list[Check]:
    """Compare an exported Python file with its model."""
    at = states_of(model, rows)
    return _checks(model, at, run_python(model, name, text, at), "Python")


def check_c(model: Model, files: Mapping[str, str], rows: int = COMPARED_STATES_ROWS) -> list[Check]:
    """Compare an exported C file with its model, as double and as float. Raises DataError without a compiler.

    A model whose terms float cannot hold is none the worse as double: that comparison is reported but not binding.
    """
    at = states_of(model, rows)
    double = _checks(model, at, run_c(model, files, at), "C, double")
    single = _checks(model, at, run_c(model, files, at, True), "C, float", LIMIT_FLOAT32)[0]
    return [*double, single._replace(binding=False)]


def _checks(model: Model, at: States, found: Found, export: str, limit: float = AGREEMENT_LIMIT) -> list[Check]:
    checks = [compare(f"{export}: forces and moments", found.wrench, wrench_of(model, at), limit=limit)]
    u = differential_inputs(model)
    if found.form is not None:
        names = names_of_form(u)
        checks.append(compare(f"{export}: differential form", found.form, form_of(model, at, u), names, limit))
    if found.distance is not None:
        reference = model.distance(at.state, at.speeds, at.accelerations, at.extra)[0][:, None]
        checks.append(compare(f"{export}: distance", found.distance, reference, ["distance"], limit))
    return checks
