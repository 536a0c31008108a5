"""Where compiled kernels are kept: apart for each state of the kernels' sources.

Numba keeps a compiled function until the file of that very function changes. A kernel that calls one of another file
would go on with the old one after a change there; so each state of all kernel files has a folder of its own.
"""

import hashlib
import os
import re
import shutil
import sys
import time
from pathlib import Path

_IMPORT = re.compile(rb"^from (quasi[\w.]*) import (\([^)]*\)|[^\n(]*)", re.M)
KEPT = 2 * 86400.0  # s, how long folders of other states stay


def own_cache() -> Path | None:
    """Point Numba at this state's folder; returns it, or None where nothing can be written (then nothing is kept)."""
    package = Path(__file__).parents[1]
    name = f"kernels-{_state(package)}"
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given and Path(given).name == name:
        return Path(given)  # a process started by this one
    places = [Path(given)] if given else [package / "__pycache__", Path.home() / ".cache" / "quasi"]
    for place in places:
        folder = place / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if not os.access(folder, os.W_OK):
            continue
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        if "numba" in sys.modules:  # it read the environment when it was imported
            sys.modules["numba"].config.CACHE_DIR = str(folder)
        _forget(place, folder)
        return folder
    return None


def _state(package: Path) -> str:
    """Digest of every file of the package that holds a kernel, or constants that such a file imports."""
    contents = {path: path.read_bytes() for path in sorted(package.rglob("*.py"))}
    kept = {path for path, content in contents.items() if b"njit" in content}
    for path in list(kept):
        for module, names in _IMPORT.findall(contents[path]):
            base = package.joinpath(*module.decode().split(".")[1:])
            for name in re.findall(r"(\w+)(?: as \w+)?", names.decode()):
                # a constant of a module, or a module of constants: both are frozen into the compiled code
                kept.add(base.with_suffix(".py") if name.isupper() else base / f"{name}.py")
    digest = hashlib.sha256()
    for path in sorted(kept & set(contents)):
        digest.update(str(path.relative_to(package)).encode() + b"\0" + contents[path])
    return digest.hexdigest()[:16]


def _forget(place: Path, own: Path) -> None:
    """Remove folders of other states that nobody used lately."""
    for folder in place.glob("kernels-*"):
        try:
            if folder == own:
                os.utime(folder)
            elif time.time() - folder.stat().st_mtime > KEPT:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:
            continue
