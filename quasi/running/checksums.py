"""SHA-256 of a user's files, stored so that only a changed file is read again.

A file counts as unchanged while its size and its two time stamps (content and directory entry) match the record. An
older file that replaces another keeps its time of content but gets a new time of entry. So `mv`, `cp -p`, `rsync -a`
and `unzip` are detected even where size and time of content agree.
"""

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from quasi.errors import QuasiError
from quasi.tables import read_json, sha256_of, write_json


def read_identity(path: str | Path) -> list[int] | None:
    """Read [size in bytes, time of content, time of directory entry, both in ns] of a file; None where it is absent."""
    try:
        at = os.stat(path)
    except (OSError, ValueError):
        return None
    return [at.st_size, at.st_mtime_ns, at.st_ctime_ns]


class Checksums:
    """Checksums of files, stored in a JSON file. memory  its path; a lost or damaged file is rebuilt."""

    def __init__(self, memory: str | Path):
        self.memory = Path(memory)
        self._known: dict[str, list] = {}
        self._changed = False
        with suppress(QuasiError, OSError):
            found = read_json(self.memory) if self.memory.is_file() else {}
            self._known = found if isinstance(found, dict) else {}

    def compute(self, path: str | Path) -> str | None:
        """Compute the SHA-256 of a file in hexadecimal; None where it is absent, empty or unreadable."""
        name = str(path)
        identity = read_identity(name)
        if identity is None:
            return None
        known = self._known.get(name)
        if isinstance(known, list) and known[:3] == identity and len(known) == 4:
            return known[3]
        digest = None
        with suppress(QuasiError, OSError):
            digest = sha256_of(name)
        self._known[name] = [*identity, digest]
        self._changed = True
        return digest

    def compute_all(self, paths: Iterable[str | Path]) -> dict[str, str | None]:
        """Compute {path: SHA-256 or None} of several files."""
        return {str(path): self.compute(path) for path in paths}

    def save(self) -> None:
        """Store new checksums; without write permission, the next run reads the files again."""
        if self._changed:
            with suppress(QuasiError, OSError):
                write_json(self.memory, self._known)
                self._changed = False


def read_once(files: type) -> None:
    """Let a class of Snakemake (`_IOFile`) read an unchanged file once per run.

    For each output of each job Snakemake reads all inputs anew: 100 MB of flights for each of the seven of the scores.
    """
    original = files.checksum  # type: ignore[attr-defined]
    known: dict[tuple, str | None] = {}

    async def checksum(self: Any, *limit: Any, **options: Any) -> Any:
        identity = None if options or self.is_storage else read_identity(self.file)
        if identity is None:
            return await original(self, *limit, **options)
        key = (str(self.file), *identity, *limit)
        if key not in known:
            known[key] = await original(self, *limit)
        return known[key]

    files.checksum = checksum  # type: ignore[attr-defined]
