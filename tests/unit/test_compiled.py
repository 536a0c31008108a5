"""Compiled kernels never outlive the sources that they were made from."""

import os
import subprocess
import sys
from pathlib import Path

import quasi
from quasi.compiled import own_cache

ROOT = Path(__file__).parents[2]


def run(folder, code, **environment):
    environment = {**os.environ, "PYTHONPATH": str(folder), **environment}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_a_kernel_that_calls_a_changed_one_is_compiled_anew(tmp_path):
    package = tmp_path / "quasi"
    package.mkdir()
    for name in ("__init__.py", "compiled.py"):
        (package / name).write_text((ROOT / "quasi" / name).read_text())
    (package / "inner.py").write_text("from numba import njit\n@njit(cache=True)\ndef f(x):\n    return 2.0 * x\n")
    (package / "outer.py").write_text(
        "from numba import njit\nfrom quasi.inner import f\n@njit(cache=True)\ndef g(x):\n    return f(x)\n"
    )
    code = "import quasi; from quasi.outer import g; print(g(2.0), len(g.stats.cache_hits))"
    assert run(tmp_path, code) == ["4.0", "0"]
    assert run(tmp_path, code) == ["4.0", "1"]
    (package / "inner.py").write_text("from numba import njit\n@njit(cache=True)\ndef f(x):\n    return 101.0 * x\n")
    assert run(tmp_path, code) == ["202.0", "0"]


def test_the_folder_is_set_before_any_kernel_and_handed_to_jobs():
    folder = own_cache()
    assert folder is not None
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder)
    assert folder.is_dir()
    assert Path(quasi.__file__).parent in folder.parents or Path.home() in folder.parents
    import numba

    assert str(folder) == numba.config.CACHE_DIR
