"""The rules of the house: who may import whom, and who may open files."""

import ast
import functools
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
STAGES = {"importing", "filtering", "identification", "model", "scoring", "export", "simulation", "gap"}
SHARED = {"pages", "terms", "running"}  # rooms that every stage may use and that use no stage
ROOMS = STAGES | SHARED | {"project", "commands"}
SIDEWAYS = {
    "project": {"terms"},
    "commands": STAGES | {"project", "quasi_synthesis"},
    "pages": {"terms"},
    "importing": {"project"},
    "filtering": {"project"},
    "model": {"project"},
    "scoring": {"model"},
    "export": {"model"},
    "simulation": {"model", "project"},
    "gap": {"importing", "filtering", "identification", "model", "scoring", "simulation", "project"},
}
LOOSE = 8  # modules at the top level of the package
MODULES = sorted(p for package in ("quasi", "quasi_synthesis") for p in (ROOT / package).rglob("*.py"))


@functools.cache
def nodes(path):
    """All nodes of a file's syntax tree; many rules read the same files."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@functools.cache
def imports(path):
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide code from the digests"
            found |= {node.module} | {f"{node.module}.{a.name}" for a in node.names}
    return found


def room_of(module):
    parts = module.split(".")
    if parts[0] == "quasi_synthesis":
        return parts[0]
    return parts[1] if len(parts) > 1 and parts[0] == "quasi" and parts[1] in ROOMS else None


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_run_downwards(path):
    own = room_of(".".join(path.relative_to(ROOT).with_suffix("").parts))
    for module in imports(path):
        other = room_of(module)
        if other is None or other == own or (own and own not in SHARED and other in SHARED):
            continue
        if own is None:
            assert path.name in ("command.py", "__init__.py"), f"{path.name} must not import {module}"
        else:
            assert other in SIDEWAYS.get(own, set()), f"{own} must not import {module}"


# rooms of the gap and the files beside them, each on those before it
FLOORS = [
    {"statistics"},
    {"flights"},
    {"effect", "profile", "causes", "extension", "own_effect", "catalogue", "causes_page"},
    {"selection", "materiality"},
    {"levels.forces"},
    {"levels.sensors", "levels.drive", "levels.selected"},
    {"levels"},
    {"levels.rollouts"},
    {"entries", "probability", "scores"},
    {"report"},
    {"constant_loads"},
    {"losses", "base_model", "preparation", "verdict", "diagnosis"},
    {"planning"},
    {"comparing"},
]


def floor_of(module):
    parts = module.split(".")
    if len(parts) < 3 or parts[:2] != ["quasi", "gap"]:
        return None
    known = {room for floor in FLOORS for room in floor}
    room = next(r for r in (".".join(parts[2:4]), parts[2]) if r in known)
    return next(i for i, floor in enumerate(FLOORS) if room in floor)


@pytest.mark.parametrize(
    "path", [p for p in MODULES if ROOT / "quasi/gap" in p.parents and p.name != "__init__.py"], ids=lambda p: p.stem
)
def test_imports_run_downwards_within_the_gap(path):
    own = floor_of(".".join(path.relative_to(ROOT).with_suffix("").parts))
    for module in imports(path):
        other = floor_of(module)
        assert other is None or other <= own, f"{path} must not import {module}"


def test_synthesis_stands_alone():
    for path in (ROOT / "quasi_synthesis").glob("*.py"):
        own = {m for m in imports(path) if m.split(".")[0] == "quasi"}
        names = {m.split(".")[1] for m in own if "." in m}
        assert names <= {"attitude", "tables", "errors"}, f"{path.name} imports {names}"


OPENING = {
    *("open", "read_csv", "read_parquet", "to_parquet", "to_csv", "load", "save", "savez", "loadtxt", "savetxt"),
    *(
        "genfromtxt",
        "fromfile",
        "tofile",
        "memmap",
        "read_text",
        "read_bytes",
        "write_text",
        "write_bytes",
        "ParquetFile",
    ),
}


def name_of(function):
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def test_only_tables_opens_files():
    # provenance and compile_cache read source code and job_log the run's own scratch files: neither is an artifact
    exempt = {f"quasi/{n}.py" for n in ("tables", "running/provenance", "running/compile_cache", "running/job_log")}
    for path in MODULES:
        if str(path.relative_to(ROOT)) in exempt:
            continue
        ours = {m.rsplit(".", 1)[1] for m in imports(path) if m.startswith("quasi.tables.")}
        for node in nodes(path):
            if not isinstance(node, ast.Call) or name_of(node.func) not in OPENING - ours:
                continue
            first = node.args[0] if node.args else None
            first = first.value if isinstance(first, ast.NamedExpr) else first
            in_memory = isinstance(first, ast.Call) and name_of(first.func) in ("BytesIO", "StringIO")
            assert in_memory, f"{path}:{node.lineno} opens a file; only quasi.tables does"


def test_nothing_loaded_can_run_code():
    for path in [*MODULES, *(ROOT / "scripts").glob("*.py")]:
        for node in nodes(path):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("eval", "exec", "compile", "__import__"), path
        modules = imports(path)
        assert not modules & {"pickle", "dill", "marshal", "shelve", "joblib"}, path


def test_library_knows_nothing_of_snakemake():
    for path in MODULES:
        assert not any(m.split(".")[0] == "snakemake" for m in imports(path)), path


def test_every_rule_has_its_script_and_every_script_its_rule():
    text = "".join(p.read_text() for p in (ROOT / "rules").glob("*.smk"))
    used = set(re.findall(r'"\.\./scripts/(\w+\.py)"', text))
    assert used == {p.name for p in (ROOT / "scripts").glob("*.py")}
    rules = set(re.findall(r"^rule (\w+):", text, flags=re.M))
    assert rules == {n.removesuffix(".py") for n in used}


def test_no_file_is_longer_than_a_sitting():
    long = {str(p.relative_to(ROOT)): n for p in MODULES if (n := len(p.read_text().splitlines())) > 450}
    assert not long


def test_the_ground_floor_stays_small():
    assert len(list((ROOT / "quasi").glob("*.py"))) <= LOOSE
