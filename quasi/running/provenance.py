"""Digest of the code that a script uses: a stage reruns exactly when that code changes."""

import ast
import functools
import hashlib
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from quasi.errors import QuasiError
from quasi.running.compile_cache import PACKAGES
from quasi.tables import read_json, write_json

PARSED: dict[str, list] = {}  # {SHA-256 of a file: [digest of its syntax tree, its imports of the package]}
_NEW: set[str] = set()  # those of PARSED that were not read from the cache


def _parsed_cache() -> Path | None:
    """Locate the file that keeps PARSED between runs, in the folder of compiled kernels; None without such a folder.

    The text of a syntax tree depends on Python's version.
    """
    folder = os.environ.get("NUMBA_CACHE_DIR")
    return Path(folder, f"syntax-{sys.version_info[0]}.{sys.version_info[1]}.json") if folder else None


@functools.cache
def _read_parsed() -> None:
    """Add what earlier runs parsed. A lost or damaged cache costs the time to parse every file again."""
    path = _parsed_cache()
    with suppress(QuasiError, OSError):
        kept = read_json(path) if path and path.is_file() else {}
        if isinstance(kept, Mapping):
            PARSED.update({key: entry for key, entry in kept.items() if isinstance(entry, list) and len(entry) == 2})


def save_parsed() -> None:
    """Keep what this process parsed for the next run; without write permission, the next run parses again."""
    path = _parsed_cache()
    if _NEW and path:
        with suppress(QuasiError, OSError):
            write_json(path, PARSED)
            _NEW.clear()


@functools.cache
def _parse_file(path: str) -> tuple[str, tuple[str, ...]]:
    """Compute the digest of a file's syntax tree without comments, docstrings and layout, and list its imports."""
    _read_parsed()
    content = Path(path).read_bytes()
    key = hashlib.sha256(content).hexdigest()
    if key not in PARSED:
        PARSED[key] = _parse(content, Path(path))
        _NEW.add(key)
    digest, inside = PARSED[key]
    return digest, tuple(inside)


def _parse(content: bytes, path: Path) -> list:
    tree = ast.parse(content, filename=str(path))
    modules: list[str] = []
    for node in list(ast.walk(tree)):
        if isinstance(node, ast.Import):
            modules += [a.name for a in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            modules += [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
        elif isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body
            if body and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
                node.body = body[1:]
    inside = [m for m in modules if m.split(".")[0] in PACKAGES]
    return [hashlib.sha256(ast.dump(tree).encode()).hexdigest(), inside]


@functools.cache
def _find_file(module: str, root: str) -> str | None:
    base = os.path.join(root, *module.split("."))
    for candidate in (f"{base}.py", os.path.join(base, "__init__.py")):
        if os.path.isfile(candidate):
            return candidate
    return None


@functools.cache
def _list_imported_files(path: str, root: str) -> tuple[str, ...]:
    """List the files of the package that a file imports directly."""
    found: dict[str, None] = {}
    for module in _parse_file(path)[1]:
        parts = module.split(".")
        # importing a.b.c also runs a and a.b
        for depth in range(1, len(parts) + 1):
            file = _find_file(".".join(parts[:depth]), root)
            if file is not None:
                found[file] = None
    return tuple(found)


def _list_reached(script: str, root: str) -> list[str]:
    # texts, not paths: some hundred files for each of many scripts, and the hash of a path takes long
    found: dict[str, None] = {}
    waiting = [script]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found[path] = None
            waiting += _list_imported_files(path, root)
    return list(found)


def list_reached_files(script: str | Path, root: str | Path) -> list[Path]:
    """List the files of the package that a script imports directly or indirectly (absolute imports), itself first."""
    return [Path(path) for path in _list_reached(str(Path(script)), str(Path(root)))]


@functools.cache
def compute_code_digest(script: str | Path, root: str | Path) -> str:
    """Compute the digest of a script and of every module it uses; comments and docstrings do not count."""
    script, root = str(Path(script)), str(Path(root))
    parts = sorted(f"{path.removeprefix(root + os.sep)}:{_parse_file(path)[0]}" for path in _list_reached(script, root))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
