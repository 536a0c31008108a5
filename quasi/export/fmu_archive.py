"""From the files of an FMU to one .fmu, with a binary of this system where there is a compiler."""

import io
import platform
import sys
import zipfile
from pathlib import Path

from quasi.export.compiler import FLAGS, find_compiler, shared_library, write_files
from quasi.export.fmu_source import Fmu
from quasi.tables import read_bytes, write_bytes

_DATE = (2020, 1, 1, 0, 0, 0)  # of every member: the same model gives the same archive


def platform_folder() -> str | None:
    """The folder of FMI 2.0 for binaries of this system, such as "linux64"; None for one that FMI does not name."""
    bits = 64 if sys.maxsize > 2**32 else 32
    name = {"Linux": "linux", "Windows": "win", "Darwin": "darwin"}.get(platform.system())
    if name is None or platform.machine().lower() not in ("x86_64", "amd64", "i386", "i686"):
        return None
    return f"{name}{bits}"


def library_suffix() -> str:
    """Ending of a shared library on this system."""
    return {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")


def compile_fmu(fmu: Fmu, folder: str | Path) -> Path:
    """Compile an FMU's sources in a folder; returns the shared library. Raises DataError without a compiler."""
    write_files(folder, {n.removeprefix("sources/"): t for n, t in fmu.files.items() if n.startswith("sources/")})
    return shared_library(folder, fmu.units, f"{fmu.identifier}{library_suffix()}", flags=FLAGS)


def write_fmu(path: str | Path, fmu: Fmu, folder: str | Path) -> Path | None:
    """Write an FMU: description, sources, and a binary of this system where it can be made.

    folder  where to compile. Returns the binary in it; None where there is no compiler, or FMI names no such system.
    """
    members = {name: text.encode() for name, text in sorted(fmu.files.items())}
    system, library = platform_folder(), None
    if system is not None and find_compiler() is not None:
        library = compile_fmu(fmu, folder)
        members[f"binaries/{system}/{library.name}"] = bytes(read_bytes(library))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            about = zipfile.ZipInfo(name, _DATE)
            about.compress_type = zipfile.ZIP_DEFLATED
            about.external_attr = (0o755 if name.startswith("binaries") else 0o644) << 16
            archive.writestr(about, content)
    write_bytes(path, packed.getvalue())
    return library
