"""Folders that a job made: what they held is remembered, so that a file removed from one makes it anew."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import Any

from quasi.errors import QuasiError
from quasi.tables import read_json, write_json

MEMORY = ".snakemake/quasi/folders"  # in the project folder; it may vanish at any time


def remember_contents(jobs: type, is_flagged: Callable[[Any, str], bool], announce: Callable[[str], None]) -> None:
    """Let a class of Snakemake (`Job`) take a folder for missing while files that it was made with are.

    is_flagged  Snakemake's own: whether a path is declared as a "directory"; announce  prints a sentence, once
    Snakemake asks whether a folder exists, and no more: a model's folder without its model would be up to date.
    """
    finish, list_missing = jobs.postprocess, jobs.missing_output  # type: ignore[attr-defined]

    @wraps(finish)
    async def postprocess(self: Any, *args: Any, error: bool = False, **options: Any) -> None:
        await finish(self, *args, error=error, **options)
        if not error:
            with suppress(OSError):  # what is not remembered is not asked for
                for folder in (f for f in self.output if is_flagged(f, "directory")):
                    remember(Path(str(folder)))

    @wraps(list_missing)
    async def missing_output(self: Any, requested: Any) -> Any:
        found = set()
        async for one in list_missing(self, requested):
            found.add(str(one))
            yield one
        for path in requested:
            one = self.output_by_path.get(str(path), path)
            if str(one) in found or not is_flagged(one, "directory"):
                continue
            if removed := find_removed(Path(str(one))):
                names = removed[0] if len(removed) == 1 else f"{len(removed)} files, such as {removed[0]},"
                announce(f"{one} lacks {names} that it was made with, so it is made anew")
                yield one

    jobs.postprocess, jobs.missing_output = postprocess, missing_output  # type: ignore[attr-defined]


def remember(folder: Path) -> None:
    """Keep the names of all files in a folder."""
    write_json(_place(folder), sorted(_list_files(folder)))


def find_removed(folder: Path) -> list[str]:
    """Names of files that a folder was made with and lacks; [] where that is not known."""
    with suppress(OSError, QuasiError, TypeError):
        if _place(folder).is_file():
            return sorted(set(read_json(_place(folder))) - set(_list_files(folder)))
    return []


def _list_files(folder: Path) -> Iterator[str]:
    return (str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def _place(folder: Path) -> Path:
    return Path(MEMORY) / f"{hashlib.sha256(str(folder).encode()).hexdigest()[:32]}.json"
