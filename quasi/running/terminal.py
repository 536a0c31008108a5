"""Output of a run: one line per finished job with its notes, instead of Snakemake's messages about each job."""

import argparse
import logging
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO

from quasi.errors import nearest
from quasi.running.job_log import read_outcome

MAX_FLIGHT_NOTES = 5  # new notes on a flight that are printed; others are counted, with their log
MAX_OTHER_NOTES = 2  # notes of any other job that are printed; more are only counted: they are on its page
# messages without information for a user; the log file of the run has them all
SILENT_MESSAGES = (
    "Select jobs to execute",
    "Execute ",
    "Using shell",
    "Building DAG",
    "Conda environments",
    "Singularity",
    "Warning: the following output files of rule",  # of a folder that lacks a file: a notice names it
)
SILENT_EVENTS = {"job_info", "job_started", "progress", "resources_info"}
FLIGHT_RULES = ("importing", "filtering")


class Terminal(logging.Filter):
    """Filters Snakemake's messages for the terminal and prints one line per job.

    run  folder with the outcomes of the run's jobs; stream  the terminal
    asked  arguments of the run, as in sys.argv[1:]
    Unknown messages pass: errors, or messages of later Snakemake versions.
    """

    def __init__(self, run: str, stream: TextIO, asked: Sequence[str] = ()):
        super().__init__()
        self.run, self.stream, self.asked = run, stream, asked
        self.jobs: dict[int, Mapping[str, Any]] = {}
        self.done, self.total = 0, 0
        self.known: set[str] = set()
        self.failed: set[int] = set()  # jobs whose sentence was printed
        self.errors: set[int] = set()  # all failed jobs, killed ones as well
        self.pending_errors: list[str] = []  # errors of failed commands until their job is known
        self.noted: list[str] = []  # pages of flights with notes
        self.pages: set[str] = set()
        self.idle = False  # nothing was due

    def filter(self, record: logging.LogRecord) -> bool:
        """True for a message that is printed as it is."""
        event = getattr(record, "event", None)
        if event is None:
            self.idle |= str(record.msg or "").startswith("Nothing to be done")
            return not str(record.msg or "").startswith(SILENT_MESSAGES)
        lines = getattr(self, f"_{event}", None)
        return bool(lines(record)) if lines else str(event) not in SILENT_EVENTS

    def _run_info(self, record: logging.LogRecord) -> None:
        counts = dict(getattr(record, "stats", {}))
        self.total = counts.pop("total", 0)
        listed = ", ".join(f"{rule} {count}" for rule, count in counts.items())
        self._write(f"{self.total} {'job' if self.total == 1 else 'jobs'}: {listed}")

    def _job_info(self, record: logging.LogRecord) -> None:
        self.jobs[record.jobid] = vars(record)

    def _job_finished(self, record: logging.LogRecord) -> None:
        self.done += 1
        count = f"[{self.done:{len(str(self.total))}}/{self.total or '?'}]"
        job = self.jobs.get(record.job_id, {})
        found = read_outcome(self.run, *job.get("log", [])[:1])
        if not found:  # it ran on another computer, or was only touched
            self._write(f"{count} {_name_job(job)}")
            return
        flight, key = job.get("rule_name") in FLIGHT_RULES, str(job.get("wildcards", {}).get("flight", ""))
        new = [n for n in found["notes"] if _mask_note(n, key) not in self.known]
        shown = new[:MAX_FLIGHT_NOTES] if flight else new if len(new) <= MAX_OTHER_NOTES else []
        self.known |= {_mask_note(n, key) for n in shown}
        line = f"{count} {found['name']}: {found['seconds']:.1f} s"
        if found["verdict"]:
            line += f", {found['verdict']}"
        if found["notes"]:
            alike = len(found["notes"]) - len(new)
            line += f", {_format_count(len(found['notes']), 'note')}"
            line += f" ({'shown above' if not new else f'{alike} shown above'})" if alike else ""
            line += f", {found['log']}"
        if found["page"]:
            line += f", {found['page']}"
            self.pages.add(found["page"])
        lines = [f"    - {note}" for note in shown]
        if shown and len(new) > len(shown):
            lines.append(f"    - and {len(new) - len(shown)} more in {found['log']}")
        self._write("\n".join([line, *lines]))
        if found["notes"] and flight:
            names = job["wildcards"]
            self.noted.append(f"results/reports/{names['quadrotor']}/{names['flight']}.html")

    def _job_error(self, record: logging.LogRecord) -> bool:
        """Print the sentence of a failed job once; pass the whole message where it has none."""
        self.errors.add(record.jobid)
        found = read_outcome(self.run, *record.log[:1])
        if not found or found["failed"] is None:
            self._release()
            return True
        self.pending_errors = self.pending_errors[1:]
        if record.jobid not in self.failed:
            self.failed.add(record.jobid)
            self._write(
                f"[FAILED] {found['name']} after {found['seconds']:.1f} s, {found['log']}\n    - {found['failed']}"
            )
        return False

    def _error(self, record: logging.LogRecord) -> bool:
        # the failed command adds nothing to the job's own sentence, which follows
        message = str(record.msg)
        if "CalledProcessError" in message:
            self.pending_errors.append(message)
            return False
        return not (self.failed and "At least one job did not complete successfully" in message)

    def _release(self) -> None:
        for message in self.pending_errors:
            self._write(message)
        self.pending_errors = []

    def summary(self) -> str:
        """Return what a run prints at its end: pages that collect notes on flights; counts where jobs are missing."""
        self._release()
        lines = []
        if pages := sorted(set(self.noted) - self.pages):
            lines.append(
                f"{_format_count(len(pages), 'flight')} with notes; each flight has a page that collects them: "
                f"`{format_command(self.asked, pages[0])}`, or all of config/processing.json: "
                f"`{format_command(self.asked, 'processing')}`"
            )
        if self.done < self.total:
            untried = self.total - self.done - len(self.errors)
            lines.append(f"{_format_count(self.done, 'job')} finished, {len(self.errors)} failed, {untried} not tried")
        return "\n".join(lines)

    def _write(self, text: str) -> None:
        # Where nobody reads any more (a closed window, `| head`), the run goes on. The exception would end in a
        # callback of Snakemake, which would then wait forever for the job that it was called for.
        with suppress(OSError, ValueError):
            self.stream.write(text + "\n")
            self.stream.flush()


class FaultFilter(logging.Filter):
    """Replaces Snakemake's messages about a run that cannot start by sentences that are printed at its end.

    faults  list of these sentences, extended here; targets  returns what can be made; lock  explains a locked folder
    """

    def __init__(self, faults: list[str], targets: Callable[[], Iterable[str]], lock: Callable[[], str]):
        super().__init__()
        self.faults, self.targets, self.lock = faults, targets, lock

    def filter(self, record: logging.LogRecord) -> bool:
        """False for a message that a sentence replaces."""
        text = str(record.msg)
        if "Directory cannot be locked" in text:
            self.faults.append(self.lock())
            return False
        pattern = r"^No rule to produce (.+?) \(if you use input functions"
        if "No rule to produce" in text and (missing := re.search(pattern, text, flags=re.M)):
            self.faults.append(
                f"no rule makes '{missing[1]}'{nearest(missing[1], self.targets())}; correct the target: "
                "docs/running.md lists what can be made, and names hold letters, digits and . _ + - only"
            )
            return False
        # the place in the rules does not help to correct a fault of the configuration
        return not any(fault in text for fault in self.faults)


def list_up_to_date_pages(targets: Sequence[str], folder: str | Path) -> str:
    """List the pages of targets that are up to date in the project folder; or return nothing."""
    pages = [f"{t.rstrip('/')}/report.html" for t in targets if (Path(folder) / t / "report.html").is_file()]
    return f"Up to date; start with {', '.join(pages)}" if pages else ""


def format_command(asked: Sequence[str], target: str = "") -> str:
    """Format the command that makes a target of the same project, or its beginning. asked  arguments of Snakemake

    >>> format_command(["-d", "my lab", "-j2", "--config", "data=/mnt", "--", "models/m/standalone"], "processing")
    "snakemake -d 'my lab' --config data=/mnt -- processing"
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("-s", "--snakefile")
    parser.add_argument("-d", "--directory")
    parser.add_argument("--configfile", "--configfiles", nargs="+")
    parser.add_argument("-C", "--config", nargs="+", action="extend")
    try:
        kept, _ = parser.parse_known_args(asked)
    except argparse.ArgumentError:  # Snakemake understands more options than this parser
        kept = argparse.Namespace(snakefile=None, directory=None, configfile=None, config=None)
    words = ["snakemake"]
    for option, value in (("-s", kept.snakefile), ("-d", kept.directory)):
        words += [option, value] if value else []
    for option, values in (("--configfile", kept.configfile), ("--config", kept.config)):
        # a setting extends to the next option; an argument without = is a target after it
        values = [v for v in values or [] if option != "--config" or "=" in v]
        words += [option, *values] if values else []
    if not target:
        return shlex.join(words)
    return shlex.join([*words, *(["--"] if kept.configfile or kept.config else []), target])


def _name_job(job: Mapping[str, Any]) -> str:
    wildcards = ", ".join(str(v) for v in job.get("wildcards", {}).values())
    return f"{job.get('rule_name', 'a job')} {wildcards}".strip()


def _mask_note(note: str, key: str) -> str:
    """Mask the flight's name and all numbers in a note, so that equal notes of several flights are printed once."""
    if key:
        note = re.sub(rf"(?<!\w){re.escape(key)}(?!\w)", "*", note)
    return re.sub(r"-?\d+(\.\d+)?", "#", note)


def _format_count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"
