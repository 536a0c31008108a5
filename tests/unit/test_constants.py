"""A constant's name stands for one value in the whole library."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
# what files of one kind all define: readers, targets of the export, artifacts with a schema, writers, causes
INTERFACES = {"READER", "KNOWN", "NAME", "TITLE", "NEEDS", "CARRIES", "SCHEMA", "WRITER", "EFFECT"}


def constants_of(path):
    """Pairs of name and value of the constants at the top level of a module."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        for target in targets if getattr(node, "value", None) is not None else []:
            pairs = [(target, node.value)]
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = list(zip(target.elts, node.value.elts))
            yield from ((n.id, ast.dump(v)) for n, v in pairs if isinstance(n, ast.Name) and n.id.strip("_").isupper())


def shared_names(paths):
    """Names that stand for more than one value: {name: files}."""
    values, files = defaultdict(set), defaultdict(list)
    for path in paths:
        for name, value in constants_of(path):
            values[name].add(value)
            files[name].append(str(path))
    return {name: files[name] for name in sorted(values) if len(values[name]) > 1 and name not in INTERFACES}


def test_a_name_stands_for_one_value():
    modules = sorted(p for package in ("quasi", "quasi_synthesis") for p in (ROOT / package).rglob("*.py"))
    assert not shared_names(modules), "rename the new constant, or import the one that exists"


def test_the_check_finds_a_second_value(tmp_path):
    (tmp_path / "a.py").write_text("LEAST, MOST = 1, 2\nLEAST_ROWS: int = 3\n")
    (tmp_path / "b.py").write_text("LEAST = 2\nLEAST_ROWS = 3\nNAME = 'b'\n")
    assert list(shared_names(sorted(tmp_path.glob("*.py")))) == ["LEAST"]
