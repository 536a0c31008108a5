"""Compiled functions whose cache knows the code they call in other modules.

Numba keeps compiled code on disk under a digest of the file that a function stands in. A function that calls one of
another module would go on with the old one when that module changes. `njit` of this module is numba's own, with a
digest over the file and every module of the package that it imports, however indirectly.
"""

import functools
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

from quasi.tables import read_bytes

PACKAGE = Path(__file__).parent
_IMPORT = re.compile(rb"^\s*(?:from (quasi[\w.]*) import ([^(\n]*)|import (quasi[\w.]*))", re.M)


def njit(*arguments: Any, **options: Any) -> Callable:
    """numba.njit; with `cache=True` its cache is also renewed when a module that the file imports changes."""
    made = numba.njit(*arguments, **options)
    if arguments and callable(arguments[0]):
        return _known_by_imports(made)
    return lambda function: _known_by_imports(made(function))


@functools.cache
def _content(path: Path) -> tuple[bytes, tuple[Path, ...]]:
    """Digest of a file and the package's files that it imports."""
    data = bytes(read_bytes(path))
    found: dict[Path, None] = {}
    for origin, names, plain in _IMPORT.findall(data):
        module = (origin or plain).decode()
        wanted = [module, *(f"{module}.{n.split(b' as ')[0].strip().decode()}" for n in names.split(b",") if n.strip())]
        for name in wanted:
            file = PACKAGE.joinpath(*name.split(".")[1:])
            for candidate in (file.with_suffix(".py"), file / "__init__.py"):
                if candidate.is_file() and file != PACKAGE:
                    found[candidate] = None
    return hashlib.sha256(data).digest(), tuple(found)


@functools.cache
def stamp(path: Path) -> bytes:
    """Digest of a file of the package and of every file of it that it imports, however indirectly."""
    waiting, seen = [path], {path: b""}
    while waiting:
        here = waiting.pop()
        seen[here], imports = _content(here)
        for other in imports:
            if other not in seen:
                seen[other] = b""
                waiting.append(other)
    parts = b"".join(str(p).encode() + seen[p] for p in sorted(seen))
    return hashlib.sha256(parts + numba.__version__.encode()).digest()


def _known_by_imports(function: Any) -> Any:
    # numba compares this digest with the one that it wrote beside the compiled code; without a cache there is none
    file = getattr(getattr(function, "_cache", None), "_cache_file", None)
    if file is not None:
        file._source_stamp = stamp(Path(function.py_func.__code__.co_filename))
    return function
