"""Compiled code on disk is renewed when a module that it calls changes, and only then."""

import subprocess
import sys
import textwrap

import pytest

from quasi import compiling

OUTER = """
from quasi.compiling import njit
from quasi.made_inner import inside

@njit(cache=True)
def outside(x):
    return inside(x) + 1.0
"""
INNER = """
from quasi.compiling import njit
from quasi.made_constant import FACTOR

@njit(cache=True)
def inside(x):
    return FACTOR * x
"""


@pytest.fixture
def package(tmp_path):
    """A package of the same name with the module under test and three made ones."""
    folder = tmp_path / "quasi"
    folder.mkdir()
    for name in ("__init__", "compiling", "errors", "tables"):
        source = compiling.PACKAGE / f"{name}.py"
        (folder / f"{name}.py").write_bytes(source.read_bytes())
    (folder / "made_outer.py").write_text(OUTER)
    (folder / "made_inner.py").write_text(INNER)
    (folder / "made_constant.py").write_text("FACTOR = 2.0\n")
    return folder


def run(package):
    """What a fresh process finds: the value, and how often the outer function was taken from disk."""
    code = textwrap.dedent("""
        from quasi.made_outer import outside
        value = outside(3.0)
        print(value, sum(outside.stats.cache_hits.values()))
    """)
    done = subprocess.run([sys.executable, "-c", code], cwd=package.parent, capture_output=True, text=True, check=True)
    value, hits = done.stdout.split()
    return float(value), int(hits)


def test_a_change_two_modules_away_is_seen_and_nothing_else_renews(package):
    assert run(package) == (7.0, 0)
    assert run(package) == (7.0, 1)
    (package / "made_constant.py").write_text("FACTOR = 5.0\n")
    assert run(package) == (16.0, 0)
    (package / "made_elsewhere.py").write_text("OTHER = 1\n")
    assert run(package) == (16.0, 1)


def test_the_stamp_reaches_what_a_module_imports_and_not_what_it_does_not():
    loop = compiling.PACKAGE / "simulation" / "loop.py"
    seen, waiting = set(), [loop]
    while waiting:
        here = waiting.pop()
        if here not in seen:
            seen.add(here)
            waiting.extend(compiling._content(here)[1])
    names = {p.relative_to(compiling.PACKAGE).as_posix() for p in seen}
    assert {"standalone/kernel.py", "simulation/controllers.py", "simulation/gains.py", "attitude.py"} <= names
    assert not {n for n in names if n.startswith(("synthesis", "filtering", "identification", "importing"))}
