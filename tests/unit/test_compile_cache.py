"""Compiled kernels never outlive the sources that they were made from."""

import os
import subprocess
import sys
from pathlib import Path

import quasi
from quasi.running.compile_cache import use_cache_folder

ROOT = Path(__file__).parents[2]


def run(folder, code, **environment):
    environment = {**os.environ, "PYTHONPATH": str(folder), **environment}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_a_kernel_that_calls_a_changed_one_is_compiled_anew(tmp_path):
    package = tmp_path / "quasi"
    (package / "running").mkdir(parents=True)
    for name in ("__init__.py", "running/__init__.py", "running/compile_cache.py"):
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


def test_changed_constants_of_other_modules_reach_the_kernels_and_changed_texts_do_not(tmp_path):
    package = tmp_path / "quasi"
    (package / "room").mkdir(parents=True)
    (package / "running").mkdir()
    for name in ("__init__.py", "running/__init__.py", "running/compile_cache.py"):
        (package / name).write_text((ROOT / "quasi" / name).read_text())
    (package / "physics.py").write_text("GRAVITY = 10.0\n")
    (package / "room" / "__init__.py").write_text("")
    (package / "room" / "places.py").write_text("FIRST = 1.0\n")
    (package / "texts.py").write_text("def say():\n    return 1\n")
    (package / "outer.py").write_text(
        "from numba import njit\nfrom quasi.physics import GRAVITY\nfrom quasi.room import places as p\n"
        "from quasi.texts import say\n@njit(cache=True)\ndef g(x):\n    return GRAVITY * x + p.FIRST\n"
    )
    code = "import quasi; from quasi.outer import g; print(g(2.0), len(g.stats.cache_hits))"
    assert run(tmp_path, code) == ["21.0", "0"]
    (package / "texts.py").write_text("def say():\n    return 22\n")
    assert run(tmp_path, code) == ["21.0", "1"]
    (package / "physics.py").write_text("GRAVITY = 9.0\n")
    assert run(tmp_path, code) == ["19.0", "0"]
    (package / "room" / "places.py").write_text("FIRST = 2.0\n")
    assert run(tmp_path, code) == ["20.0", "0"]


def test_the_folder_is_set_before_any_kernel_and_handed_to_jobs():
    folder = use_cache_folder()
    assert folder is not None
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder)
    assert folder.is_dir()
    assert Path(quasi.__file__).parent in folder.parents or Path.home() in folder.parents
    import numba

    assert str(folder) == numba.config.CACHE_DIR
