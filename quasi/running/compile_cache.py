"""Cache folders of compiled kernels, one for each state of the kernels' sources.

Numba reuses a compiled function until the file of that function changes. A kernel that calls a kernel of another file
would keep the old one after a change there. So each state of all kernel files has its own folder.
"""

import hashlib
import os
import re
import shutil
import sys
import time
from pathlib import Path

PACKAGES = ("quasi", "quasi_synthesis")  # those with kernels
_IMPORT = re.compile(rb"^from (quasi[\w.]*) import (\([^)]*\)|[^\n(]*)", re.M)
CACHE_LIFETIME = 2 * 86400.0  # s, age at which unused folders of other states are removed


def use_cache_folder() -> Path | None:
    """Set Numba's cache to the folder of this state; return it, or None where nothing can be written (no cache
    then).
    """
    package = Path(__file__).parents[1]
    name = f"kernels-{_compute_state(package.parent)}"
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
        _remove_old_caches(place, folder)
        return folder
    return None


def _compute_state(library: Path) -> str:
    """Compute the digest of every file with a kernel, or with constants that such a file imports."""
    contents = {path: path.read_bytes() for package in PACKAGES for path in sorted((library / package).rglob("*.py"))}
    kept = {path for path, content in contents.items() if b"njit" in content}
    for path in list(kept):
        for module, names in _IMPORT.findall(contents[path]):
            base = library.joinpath(*module.decode().split("."))
            for name in re.findall(r"(\w+)(?: as \w+)?", names.decode()):
                # a constant of a module, or a module of constants: both are compiled into the code
                kept.add(base.with_suffix(".py") if name.isupper() else base / f"{name}.py")
    digest = hashlib.sha256()
    for path in sorted(kept & set(contents)):
        digest.update(str(path.relative_to(library)).encode() + b"\0" + contents[path])
    return digest.hexdigest()[:16]


def _remove_old_caches(place: Path, own: Path) -> None:
    """Remove folders of other states that were not used recently."""
    for folder in place.glob("kernels-*"):
        try:
            if folder == own:
                os.utime(folder)
            elif time.time() - folder.stat().st_mtime > CACHE_LIFETIME:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:
            continue
