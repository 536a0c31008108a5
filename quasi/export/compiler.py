"""The system's C compiler: shared libraries from made sources. Nothing passes through a shell."""

import os
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from quasi.errors import DataError
from quasi.tables import write_text

NO_COMPILER = "no C compiler was found; install gcc or clang, or name one in the environment variable CC"
# no joining of a product and a sum into one operation: results keep the last digits of predict
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
_PATIENCE = 300.0  # s


def find_compiler() -> list[str] | None:
    """The command of a C compiler: the environment's CC, else cc, gcc or clang; None where there is none."""
    for given in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        words = shlex.split(given)
        if words and shutil.which(words[0]):
            return words
    return None


def write_files(folder: str | Path, files: Mapping[str, str]) -> None:
    """Write texts under their names, each a plain file name, into a folder."""
    for name, text in files.items():
        write_text(Path(folder) / Path(name).name, text)


def shared_library(
    folder: str | Path, sources: Sequence[str], library: str, defines: Sequence[str] = (), flags: Sequence[str] = FLAGS
) -> Path:
    """Compile C files of a folder into a shared library in the same folder; returns its path.

    sources  file names; library  file name; defines  such as "QUASI_FLOAT32"
    Raises DataError without a compiler, or with the first complaint of one that fails.
    """
    command = find_compiler()
    if command is None:
        raise DataError(NO_COMPILER)
    folder = Path(folder)
    asked = [*command, *flags, *(f"-D{name}" for name in defines), *sources, "-o", library, "-lm"]
    try:
        done = subprocess.run(asked, cwd=folder, capture_output=True, text=True, timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        raise DataError(f"{command[0]} did not finish {', '.join(sources)} within {_PATIENCE:.0f} s") from None
    if done.returncode:
        first_error = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200])
        raise DataError(
            f"{command[0]} refuses {', '.join(sources)}: {' '.join(first_error.split())}; please report this"
        )
    return folder / library
