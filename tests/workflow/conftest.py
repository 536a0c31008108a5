"""A small project of made flights, run once by Snakemake for real; each test edits a copy of it.

The library runs from where it stands: Numba keeps compiled kernels by path, and a copy would compile all of them anew.
"""

import atexit
import csv
import fcntl
import functools
import io
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import hidden
import pytest

from quasi_synthesis.campaign import project_files, read_campaign

ROOT = Path(__file__).parents[2]
PACKAGES = ("quasi", "quasi_synthesis")
HOUSE = ("Snakefile", "rules", "scripts", *PACKAGES, "config/schemas", "config/polynomials", "profiles")
CAMPAIGN = {
    "quadrotor": "MadeBeetle",
    "seed": 7,
    "duration": 20,
    "log rate": 500,
    "flights": [{"key": f"small-{i}", "profile": "mixed"} for i in (1, 2, 3, 4)],
}
MODEL = {
    "logging file": {
        "directory": "data",
        "filename": "small_file_log",
        "rows of flights to use (all)": [2, 3, 4],
        "rows of flights for validation": [4],
    },
    "identification parameters": {
        "polynomial specification file": "polyCands_DiffSys_quadraticU_symmetric_SIMPLE_FM.json",
        # resamples are judged in tests/unit/test_fit.py and test_structure.py
        "polynomial": {"regressor cap": 2, "bootstrap": 10},
    },
}
SECONDS = 18.0  # of a healthy made flight, and of those that stand against them
PROCESSING = {
    "logging file": {"directory": "data", "filename": "small_file_log"},
    "data importing": {"resampling rate": 250},
}


@functools.cache
def starter():
    """The process that starts the runs of this test process; it ends with its standard input."""
    program = [sys.executable, str(Path(__file__).with_name("starter.py"))]
    process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    atexit.register(process.communicate)
    return process


def ask_starter(request):
    """Answer of the starter to a request, see there."""
    print(json.dumps(request), file=starter().stdin, flush=True)
    return json.loads(starter().stdout.readline())


@dataclass
class Project:
    """A project folder, and the library that runs it: this one, or a copy for a test that edits it."""

    base: Path
    house: Path = ROOT

    @property
    def folder(self) -> Path:
        return self.base / "project"

    def copy_library(self):
        """From now on a copy of the library runs the project."""
        for name in HOUSE:
            source, target = ROOT / name, self.base / "house" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("kernels-*"))
            else:
                shutil.copy(source, target)
        self.house = self.base / "house"

    def snakemake(self, *arguments):
        """Run Snakemake; returns (exit code, everything printed)."""
        environment = {**os.environ, "PYTHONPATH": str(self.house), "NO_COLOR": "1"}
        environment.pop("QUASI_RUN", None)
        arguments = ["-s", str(self.house / "Snakefile"), "-d", str(self.folder), *arguments]
        arguments[4:4] = ["--profile", str(self.house / "profiles/default")]
        printed = self.base / "printed.txt"
        request = {
            "folder": str(self.base),
            "environment": environment,
            "arguments": arguments,
            "printed": str(printed),
        }
        return ask_starter(request), printed.read_text()

    def would_run(self, target="models/small/standalone"):
        """{rule: number of jobs} of a dry run; {} when nothing is to be done."""
        code, text = self.snakemake("-n", target)
        assert code == 0, text
        if "Nothing to be done" in text:
            return {}
        table = re.search(r"^Job stats:\n(.*?)^total\s", text, flags=re.S | re.M)
        assert table, text
        counts = re.findall(r"^(\w+)\s+(\d+)\s*$", table[1], flags=re.M)
        return {rule: int(n) for rule, n in counts}

    def edit_json(self, path, change):
        document = json.loads((self.folder / path).read_text())
        change(document)
        (self.folder / path).write_text(json.dumps(document, indent=2))

    def edit_logbook(self, change):
        """change(rows): rows are dicts in order; the logbook is written anew."""
        path = self.folder / "data/small_file_log.csv"
        rows = list(csv.DictReader(io.StringIO(path.read_text())))
        change(rows)
        write_rows(path, rows)


def write_rows(path, rows):
    text = io.StringIO()
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, fieldnames=names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    path.write_text(text.getvalue())


def lay(base):
    """A folder with the small campaign, its model and its processing, nothing made yet."""
    project = Project(base)
    for name in ("config/models", "config/synthesis", "data"):
        (project.folder / name).mkdir(parents=True)
    (project.folder / "config/synthesis/small.json").write_text(json.dumps(CAMPAIGN))
    (project.folder / "config/models/small.json").write_text(json.dumps(MODEL))
    (project.folder / "config/processing.json").write_text(json.dumps(PROCESSING))
    for path, text in project_files(read_campaign(CAMPAIGN, "small")).items():
        (project.folder / path).write_text(text)
    return project


def shared_by_workers(tmp_path_factory, name, make):
    """A folder that the first test process makes and all others wait for and use."""
    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent  # of all workers of this session
    folder = base / f"shared-{name}"
    with (base / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "made").is_file():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            (folder / "made").touch()
    return folder


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """The small project with its model made; (project, what the run printed). Not to be edited."""

    def make(folder):
        code, text = lay(folder).snakemake("-j2", "models/small/standalone")
        assert code == 0, text
        (folder / "first.txt").write_text(text)

    folder = shared_by_workers(tmp_path_factory, "small", make)
    return Project(folder), (folder / "first.txt").read_text()


@pytest.fixture
def project(finished, tmp_path):
    """A copy of the finished project for one test to edit."""
    original = finished[0]
    # file times are part of what Snakemake compares: keep them
    shutil.copytree(original.folder, tmp_path / "copy/project", copy_function=shutil.copy2)
    return Project(tmp_path / "copy")


@pytest.fixture(scope="session")
def healthy(tmp_path_factory):
    """Folder of healthy made flights and of the model that they made; the files grow with the flights asked for.

    They are as short as made flights can be, and few: a third of the time of the study's.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hidden, "SECONDS", SECONDS)
        patch.setattr(hidden, "LEARNED", hidden.LEARNED[:6])

        def make(folder):
            hidden.healthy_model(folder / "healthy")

        yield shared_by_workers(tmp_path_factory, "healthy", make) / "healthy"
