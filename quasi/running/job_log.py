"""Log file, messages and failure of one job, and what a whole run tells at its end."""

import hashlib
import json
import logging
import os
import sys
import time
import traceback
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import tqdm

from quasi.errors import QuasiError

RUN = "QUASI_RUN"  # environment variable: folder in which the jobs of one run leave what it tells at its end
LOG = logging.getLogger("quasi")
EVERY = 5.0  # s between two lines of progress in a job's log
T = TypeVar("T")


class _Notes(logging.Handler):
    """Keeps the warnings that a job writes into its log, its notes, and apart from them the one with a verdict."""

    def __init__(self):
        super().__init__(logging.WARNING)
        self.told: list[str] = []
        self.verdict: str | None = None

    def emit(self, record: logging.LogRecord) -> None:
        if getattr(record, "verdict", False):
            self.verdict = record.getMessage()
        elif record.levelno == logging.WARNING:
            self.told.append(record.getMessage())


@contextmanager
def job(log: str | Path, name: str = "", page: str | None = None) -> Iterator[logging.Logger]:
    """Run a job with its log file; an error a user can mend ends it with one sentence instead of a traceback.

    log  the job's log file; name  what the job works on, for messages; page  that it makes, to be opened by a user.
    """
    path, notes = Path(log), _Notes()
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
        about |= {"verdict": notes.verdict, "notes": notes.told, "seconds": time.perf_counter() - started}
        _leave(about)

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
    except SystemExit as error:  # or a job that was left half-way would count as done
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


def judge(word: str, because: str) -> None:
    """Note a verdict that a user must hear of: unlike other notes it stands in the job's own line of the run."""
    LOG.warning("%s (%s)", word, because, extra={"verdict": True})


def _outcome_file(folder: str | Path, log: str) -> Path:
    return Path(folder) / "outcomes" / f"{hashlib.sha256(str(log).encode()).hexdigest()[:32]}.json"


def _leave(about: dict[str, Any]) -> None:
    """Leave how a job ended, for the line that the run prints of it; nothing outside a run."""
    folder = os.environ.get(RUN)
    if not folder:
        return
    place = _outcome_file(folder, about["log"])
    with suppress(OSError):  # what was made is whole; it is only told less of
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(json.dumps(about), encoding="utf-8")


def outcome(folder: str | Path, log: str = "") -> dict[str, Any] | None:
    """How the job of a run with this log file ended: "name", "log", "page", "seconds", "verdict", "notes", and
    "failed", its sentence or None. None where it left nothing: it was killed, or has not ended."""
    place = _outcome_file(folder, log)
    return json.loads(place.read_text(encoding="utf-8")) if place.is_file() else None


def print_at_end(text: str, kind: str = "made") -> None:
    """Leave text for the end of the run ("made" or "errors"); prints it at once outside a run."""
    folder = os.environ.get(RUN)
    if not folder:
        print(text, file=sys.stderr if kind == "errors" else sys.stdout)
        return
    place = Path(folder) / kind
    place.mkdir(parents=True, exist_ok=True)
    (place / f"{time.time_ns()}-{os.getpid()}.txt").write_text(text.rstrip("\n") + "\n", encoding="utf-8")


def texts_at_end(folder: str | Path, kind: str) -> list[str]:
    """What the jobs of a run left for its end, in order, each text once."""
    texts = [p.read_text(encoding="utf-8").rstrip("\n") for p in sorted((Path(folder) / kind).glob("*.txt"))]
    return list(dict.fromkeys(texts))


def progress(things: Iterable[T], what: str, **options: Any) -> Iterable[T]:
    """The same things, one by one, with their progress: in a job a line in its log every EVERY seconds, else a bar on
    a terminal, and silence where there is none.

    what  is being done, for bar and log; options  of tqdm
    """
    if LOG.handlers:
        return _lines(things, what)
    return tqdm.tqdm(things, desc=what, disable=not sys.stderr.isatty(), leave=False, **options)


def _lines(things: Iterable[T], what: str) -> Iterator[T]:
    whole = len(things) if isinstance(things, Sized) else None
    started = told_at = time.perf_counter()
    for done, thing in enumerate(things):
        now = time.perf_counter()
        if now - told_at >= EVERY:
            told_at = now
            of = f" of {whole} ({100 * done // whole} %)" if whole else ""
            LOG.info("%s: %d%s in %.0f s, %.0f a second", what, done, of, now - started, done / (now - started))
        yield thing
