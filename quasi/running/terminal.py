"""What a run prints: a line per finished job with what was noted in it, in place of Snakemake's account of each job."""

import argparse
import logging
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

from quasi.errors import nearest
from quasi.running.job_log import outcome

MOST = 5  # new notes on a flight that are told; the others are counted, with the log that holds them
FEW = 2  # notes of any other job that are told; more are only counted: the page that they are made for holds them
# what says nothing to a user; all of it stands in the log file of the run
NOISE = ("Select jobs to execute", "Execute ", "Using shell", "Building DAG", "Conda environments", "Singularity")
UNTOLD = {"job_info", "job_started", "progress", "resources_info"}
OF_FLIGHTS = ("importing", "filtering")


class Terminal(logging.Filter):
    """Decides what of Snakemake's messages reaches the terminal, and tells jobs in its own words.

    run  folder in which the jobs of the run leave how they ended; stream  the terminal
    asked  arguments of the run, as in sys.argv[1:]
    What it does not know passes: an error, or a message of a Snakemake to come.
    """

    def __init__(self, run: str, stream: TextIO, asked: Sequence[str] = ()):
        super().__init__()
        self.run, self.stream, self.asked = run, stream, asked
        self.jobs: dict[int, Mapping[str, Any]] = {}
        self.done, self.total = 0, 0
        self.known: set[str] = set()
        self.failed: set[int] = set()
        self.held: list[str] = []  # what Snakemake says of a command that failed, until its job is known
        self.noted: list[str] = []  # pages of flights on which something was noted
        self.pages: set[str] = set()
        self.idle = False  # nothing was to be done

    def filter(self, record: logging.LogRecord) -> bool:
        """True for a message that is printed as it is."""
        event = getattr(record, "event", None)
        if event is None:
            self.idle |= str(record.msg or "").startswith("Nothing to be done")
            return not str(record.msg or "").startswith(NOISE)
        told = getattr(self, f"_{event}", None)
        return bool(told(record)) if told else str(event) not in UNTOLD

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
        found = outcome(self.run, *job.get("log", [])[:1])
        if not found:  # it ran elsewhere, or was only touched
            self._write(f"{count} {_plainly(job)}")
            return
        flight, key = job.get("rule_name") in OF_FLIGHTS, str(job.get("wildcards", {}).get("flight", ""))
        new = [n for n in found["notes"] if _masked(n, key) not in self.known]
        shown = new[:MOST] if flight else new if len(new) <= FEW else []
        self.known |= {_masked(n, key) for n in shown}
        line = f"{count} {found['name']}: {found['seconds']:.1f} s"
        if found["verdict"]:
            line += f", {found['verdict']}"
        if found["notes"]:
            alike = len(found["notes"]) - len(new)
            line += f", {_counted(len(found['notes']), 'note')}"
            line += f" ({'told above' if not new else f'{alike} told above'})" if alike else ""
            line += f", {found['log']}"
        if found["page"]:
            line += f", {found['page']}"
            self.pages.add(found["page"])
        told = [f"    - {note}" for note in shown]
        if shown and len(new) > len(shown):
            told.append(f"    - and {len(new) - len(shown)} more in {found['log']}")
        self._write("\n".join([line, *told]))
        if found["notes"] and flight:
            names = job["wildcards"]
            self.noted.append(f"results/reports/{names['quadrotor']}/{names['flight']}.html")

    def _job_error(self, record: logging.LogRecord) -> bool:
        """Told once in its own sentence; whole, where the job ended without one."""
        found = outcome(self.run, *record.log[:1])
        if not found or found["failed"] is None:
            self._release()
            return True
        self.held = self.held[1:]
        if record.jobid not in self.failed:
            self.failed.add(record.jobid)
            self._write(
                f"[FAILED] {found['name']} after {found['seconds']:.1f} s, {found['log']}\n    - {found['failed']}"
            )
        return False

    def _error(self, record: logging.LogRecord) -> bool:
        # which command of which rule ended with 1 says nothing beside the job's own sentence, which comes after it
        said = str(record.msg)
        if "CalledProcessError" in said:
            self.held.append(said)
            return False
        return not (self.failed and "At least one job did not complete successfully" in said)

    def _release(self) -> None:
        for said in self.held:
            self._write(said)
        self.held = []

    def summary(self) -> str:
        """At the end of the run: where the notes on flights are put together, or nothing."""
        self._release()
        pages = sorted(set(self.noted) - self.pages)
        if not pages:
            return ""
        return (
            f"Notes on {_counted(len(pages), 'flight')} came up; each flight has a page that gathers them: "
            f"`{again(self.asked, pages[0])}`, or all of config/processing.json: `{again(self.asked, 'processing')}`"
        )

    def _write(self, text: str) -> None:
        self.stream.write(text + "\n")
        self.stream.flush()


class FaultFilter(logging.Filter):
    """Replaces Snakemake's messages on a run that cannot start by sentences that are printed at its end.

    faults  these sentences, to which it adds; targets  returns what can be made; lock  explains a locked folder
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
        missing = re.search(r"^No rule to produce (.+?) \(if you use input functions", text, flags=re.M)
        if missing:
            self.faults.append(
                f"no rule makes '{missing[1]}'{nearest(missing[1], self.targets())}; correct the target: README.md "
                "says under 'What is where' what can be made, and names hold letters, digits and . _ + - only"
            )
            return False
        # where in the rules a fault of the configuration was met does not help to correct it
        return not any(fault in text for fault in self.faults)


def standing(targets: Sequence[str], folder: str | Path) -> str:
    """Where results that are up to date begin, of the targets in the project folder that have a page; or nothing."""
    pages = [f"{t.rstrip('/')}/report.html" for t in targets if (Path(folder) / t / "report.html").is_file()]
    return f"Up to date; begin with {', '.join(pages)}" if pages else ""


def again(asked: Sequence[str], target: str = "") -> str:
    """The command that makes a target of the same project, or what it begins with. asked  arguments of Snakemake

    >>> again(["-d", "my lab", "-j2", "--config", "data=/mnt", "--", "models/m/standalone"], "processing")
    "snakemake -d 'my lab' --config data=/mnt -- processing"
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("-s", "--snakefile")
    parser.add_argument("-d", "--directory")
    parser.add_argument("--configfile", "--configfiles", nargs="+")
    parser.add_argument("-C", "--config", nargs="+", action="extend")
    try:
        kept, _ = parser.parse_known_args(asked)
    except argparse.ArgumentError:  # what Snakemake took it for is not known here
        kept = argparse.Namespace(snakefile=None, directory=None, configfile=None, config=None)
    words = ["snakemake"]
    for option, value in (("-s", kept.snakefile), ("-d", kept.directory)):
        words += [option, value] if value else []
    for option, values in (("--configfile", kept.configfile), ("--config", kept.config)):
        # a setting goes on to the next option: what holds no = is a target that followed it
        values = [v for v in values or [] if option != "--config" or "=" in v]
        words += [option, *values] if values else []
    if not target:
        return shlex.join(words)
    return shlex.join([*words, *(["--"] if kept.configfile or kept.config else []), target])


def _plainly(job: Mapping[str, Any]) -> str:
    wildcards = ", ".join(str(v) for v in job.get("wildcards", {}).values())
    return f"{job.get('rule_name', 'a job')} {wildcards}".strip()


def _masked(note: str, key: str) -> str:
    """A note without its flight's name and without numbers: what flights have alike is told once."""
    if key:
        note = re.sub(rf"(?<!\w){re.escape(key)}(?!\w)", "*", note)
    return re.sub(r"-?\d+(\.\d+)?", "#", note)


def _counted(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"
