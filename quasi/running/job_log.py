"""Log file, messages and failure of one job, and the reports that a run prints at its end."""

import hashlib
import json
import logging
import os
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import tqdm

from quasi.errors import QuasiError

RUN_VARIABLE = "QUASI_RUN"  # environment variable: folder of the reports that the jobs of one run leave for its end
LOG = logging.getLogger("quasi")
PROGRESS_INTERVAL = 5.0  # s between two lines of progress in a job's log
T = TypeVar("T")


class _NoteHandler(logging.Handler):
    """Collects the warnings of a job, its notes, and separately the warning with a verdict."""

    def __init__(self):
        super().__init__(logging.WARNING)
        self.notes: list[str] = []
        self.verdict: str | None = None

    def emit(self, record: logging.LogRecord) -> None:
        if getattr(record, "verdict", False):
            self.verdict = record.getMessage()
        elif record.levelno == logging.WARNING:
            self.notes.append(record.getMessage())


@contextmanager
def job(log: str | Path, name: str = "", page: str | None = None) -> Iterator[logging.Logger]:
    """Run a job with its log file; an error that a user can correct ends it with one sentence and no traceback.

    log  the job's log file; name  subject of the job, for messages; page  for the user that the job makes.
    """
    path, notes = Path(log), _NoteHandler()
    path.parent.mkdir(parents=True, exist_ok=True)
    handler = logging.FileHandler(path, mode="w", encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s", "%H:%M:%S"))
    LOG.setLevel(logging.INFO)
    LOG.handlers = [handler, notes]
    logging.captureWarnings(True)
    logging.getLogger("py.warnings").handlers = [handler]
    started = time.perf_counter()

    def ended(failed: str | None = None) -> None:
        about = {"name": name or path.stem, "log": str(log), "page": page, "failed": failed}
        about |= {"verdict": notes.verdict, "notes": notes.notes, "seconds": time.perf_counter() - started}
        _write_outcome(about)

    def fail(sentence: str) -> None:
        ended(sentence)
        print_at_end(sentence, "errors")
        raise SystemExit(1)

    try:
        yield LOG
        LOG.info("done in %.1f s", time.perf_counter() - started)
        ended()
    except QuasiError as error:
        LOG.error("%s", error)
        fail(str(error))
    except SystemExit as error:  # otherwise an incomplete job would count as done
        LOG.error("%s", traceback.format_exc())
        fail(f"{name or path.stem} was ended from within (SystemExit: {error}); the traceback is in {path}")
    except MemoryError:
        LOG.error("%s", traceback.format_exc())
        fail(f"{name or path.stem} ran out of memory; free some, or run fewer jobs at once (-j1)")
    except OSError as error:
        LOG.error("%s", traceback.format_exc())
        fail(
            f"{name or path.stem}: {error.strerror or error} ({error.filename or 'no file named'}); free space on the "
            f"disk or correct the permissions, and run again; the traceback is in {path}"
        )
    except Exception as error:
        LOG.error("%s", traceback.format_exc())
        fail(f"{name or path.stem} failed unexpectedly ({type(error).__name__}: {error}); the traceback is in {path}")
    finally:
        LOG.handlers = []
        handler.close()


def log_verdict(word: str, because: str) -> None:
    """Log a verdict; unlike other notes, the run prints it in the line of the job."""
    LOG.warning("%s (%s)", word, because, extra={"verdict": True})


def _outcome_file(folder: str | Path, log: str) -> Path:
    return Path(folder) / "outcomes" / f"{hashlib.sha256(str(log).encode()).hexdigest()[:32]}.json"


def _write_outcome(about: dict[str, Any]) -> None:
    """Write the outcome of a job for the line that the run prints; nothing outside a run."""
    folder = os.environ.get(RUN_VARIABLE)
    if not folder:
        return
    place = _outcome_file(folder, about["log"])
    with suppress(OSError):  # the results are complete; only the report is lost
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(json.dumps(about), encoding="utf-8")


def read_outcome(folder: str | Path, log: str = "") -> dict[str, Any] | None:
    """Read the outcome of the job with this log file; None where it was killed, on a full disk, or has not ended.

    Keys: "name", "log", "page", "seconds", "verdict", "notes", and "failed", its sentence or None.
    """
    with suppress(OSError, ValueError):
        return json.loads(_outcome_file(folder, log).read_text(encoding="utf-8"))
    return None


def hand_over(files: Iterable[str], folder: str | Path, rename: Callable[[Path], str] = lambda path: path.name) -> Path:
    """Copy files and folders of results into the folder that is handed over, under the names that `rename` gives."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for path in map(Path, files):
        if path.is_dir():
            shutil.copytree(path, target / rename(path), dirs_exist_ok=True)
        else:
            shutil.copy(path, target / rename(path))
    return target


def hand_over_with_summary(files: Iterable[str], folder: str | Path) -> None:
    """Hand over files and folders of which one is summary.txt; print the summary and what was made."""
    files = list(files)
    summary = (hand_over(files, folder) / "summary.txt").read_text(encoding="utf-8").rstrip()
    print_at_end(f"{summary}\nMade {folder}: {', '.join(sorted(Path(p).name for p in files))}")


def print_at_end(text: str, kind: str = "made") -> None:
    """Report text at the end of the run ("made" or "errors"); print it at once outside a run."""
    folder = os.environ.get(RUN_VARIABLE)
    if not folder:
        print(text, file=sys.stderr if kind == "errors" else sys.stdout)
        return
    place = Path(folder) / kind
    place.mkdir(parents=True, exist_ok=True)
    (place / f"{time.time_ns()}-{os.getpid()}.txt").write_text(text.rstrip("\n") + "\n", encoding="utf-8")


def read_reports(folder: str | Path, kind: str) -> list[str]:
    """Read the reports of the jobs of a run, in order, each text once."""
    texts = [p.read_text(encoding="utf-8").rstrip("\n") for p in sorted((Path(folder) / kind).glob("*.txt"))]
    return list(dict.fromkeys(texts))


def show_progress(things: Iterable[T], what: str, **options: Any) -> Iterable[T]:
    """Iterate over things and show the progress: in a job a log line every PROGRESS_INTERVAL seconds, else a bar on a
    terminal.

    what  name of the work, for bar and log; options  of tqdm
    """
    if LOG.handlers:
        return _log_progress(things, what)
    return tqdm.tqdm(things, desc=what, disable=not sys.stderr.isatty(), leave=False, **options)


def _log_progress(things: Iterable[T], what: str) -> Iterator[T]:
    whole = len(things) if isinstance(things, Sized) else None
    started = reported_at = time.perf_counter()
    for done, thing in enumerate(things):
        now = time.perf_counter()
        if now - reported_at >= PROGRESS_INTERVAL:
            reported_at = now
            of = f" of {whole} ({100 * done // whole} %)" if whole else ""
            LOG.info("%s: %d%s in %.0f s, %.0f a second", what, done, of, now - started, done / (now - started))
        yield thing
