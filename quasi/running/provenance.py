"""Digest of the code that a script uses: a stage reruns exactly when that code changes."""

import ast
import functools
import hashlib
from pathlib import Path

PACKAGE = "quasi"


@functools.cache
def _parse_file(path: Path) -> tuple[str, tuple[str, ...]]:
    """Compute the digest of a file's syntax tree without comments, docstrings and layout, and list its imports."""
    tree = ast.parse(path.read_bytes(), filename=str(path))
    modules: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules += [a.name for a in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            modules += [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
    inside = tuple(m for m in modules if m.split(".")[0] == PACKAGE)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body
            if body and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
                node.body = body[1:]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest(), inside


def _find_file(module: str, root: Path) -> Path | None:
    base = root.joinpath(*module.split("."))
    for candidate in (base.with_suffix(".py"), base / "__init__.py"):
        if candidate.is_file():
            return candidate
    return None


def list_reached_files(script: str | Path, root: str | Path) -> list[Path]:
    """List the files of the package that a script imports directly or indirectly (absolute imports), itself first."""
    root = Path(root)
    found: dict[Path, None] = {}
    waiting = [Path(script)]
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found[path] = None
        for module in _parse_file(path)[1]:
            parts = module.split(".")
            # importing a.b.c also runs a and a.b
            for depth in range(1, len(parts) + 1):
                file = _find_file(".".join(parts[:depth]), root)
                if file is not None:
                    waiting.append(file)
    return list(found)


@functools.cache
def compute_code_digest(script: str | Path, root: str | Path) -> str:
    """Compute the digest of a script and of every module it uses; comments and docstrings do not count."""
    root = Path(root)
    parts = sorted(f"{p.relative_to(root)}:{_parse_file(p)[0]}" for p in list_reached_files(script, root))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
