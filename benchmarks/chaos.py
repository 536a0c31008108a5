"""Kills at random moments of all stages; the same command again has to finish with byte-equal artifacts.

    python benchmarks/chaos.py [--kills 100] [--seed 1] [--folder chaos] [--targets flight|all] [--record]

Lays a small project (four made flights; with `all` a model and a gap too) and runs it once undisturbed. Then it runs
the project from nothing again and again. Each run is killed at a random moment and started again with the same command:
even kills are SIGKILL to the whole process group, odd ones SIGTERM. Every second folder runs with --keep-incomplete.
A moment is a random number of finished jobs, 0 or 1, and then a random part of the start or of a job.

Checked after each kill: no artifact differs from the undisturbed one, so each file is whole or absent.
Checked after each finished folder: all artifacts are there and equal, and no manual step was needed.
The folder keeps the state, so that an interrupted benchmark goes on with the same command.
"""

import argparse
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from measured_table import record

from quasi.tables import write_json
from quasi_synthesis.campaign import project_files, read_campaign

ROOT = Path(__file__).resolve().parents[1]
TARGETS = {
    "flight": ("results/filtered/MadeBeetle/withGravity/small-1.parquet",),
    "all": ("processing", "models/small/standalone", "results/gaps/near"),
}
MAX_END = 60.0  # s after SIGTERM within which a run has to end; a job is ended after 5 s
MAX_WAIT = 3.0  # s, so that a kill comes within a job where the undisturbed run was slow because it compiled
MAX_JOBS = 1  # finished jobs before a kill, so that each folder takes many kills
# what a rerun makes with the same bytes; logs and Snakemake's benchmark tables hold times
COMPARED = (".parquet", ".json", ".csv", ".bbl", ".txt", ".tex", ".png", ".html")
CAMPAIGN = {
    "quadrotor": "MadeBeetle", "seed": 7, "duration": 20, "log rate": 500,
    "flights": [{"key": f"small-{i}", "profile": "mixed"} for i in (1, 2, 3, 4)],
}  # fmt: skip
LOGBOOK = {"directory": "data", "filename": "small_file_log"}
MODEL = {
    "logging file": {
        **LOGBOOK, "rows of flights to use (all)": [2, 3, 4], "rows of flights for validation": [4],
    },
    "identification parameters": {
        "polynomial specification file": "polyCands_DiffSys_quadraticU_symmetric_SIMPLE_FM.json",
        "polynomial": {"regressor cap": 2},
    },
}  # fmt: skip
GAP = {
    "model": "small",
    "logging file": {
        **LOGBOOK, "rows of flights to compare (all)": [2, 3, 4], "rows of flights held out": [4],
        "rows of reference flights": [5],
    },
    "horizons": [0.1, 0.5],
    "effects": ["ground_effect", "mass", "gyro_scale"],
}  # fmt: skip


def lay(folder: Path, flights: int = 4) -> None:
    """Lay a project folder with its configuration, nothing made yet."""
    shutil.rmtree(folder, ignore_errors=True)
    campaign = {**CAMPAIGN, "flights": CAMPAIGN["flights"][:flights]}
    processing = {"logging file": LOGBOOK, "data importing": {"resampling rate": 250}}
    documents = {"config/synthesis/small.json": campaign, "config/processing.json": processing}
    if flights == len(CAMPAIGN["flights"]):
        documents |= {"config/models/small.json": MODEL, "config/gaps/near.json": GAP}
    texts = {name: json.dumps(document) for name, document in documents.items()}
    for name, text in (texts | project_files(read_campaign(campaign, "small"))).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def start(folder: Path, targets: str, *options: str) -> subprocess.Popen:
    """Start the command of every run, in a process group of its own."""
    shutil.rmtree(folder / ".snakemake/scripts", ignore_errors=True)  # of killed jobs
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(folder), "-j2"]
    command += ["--profile", str(ROOT / "profiles/default"), *options, "--", *TARGETS[targets]]
    environment = {k: v for k, v in os.environ.items() if k != "QUASI_RUN"} | {"PYTHONPATH": str(ROOT)}
    with (folder / "output.txt").open("wb") as output:
        return subprocess.Popen(
            command, cwd=folder, env=environment, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
        )


def read_digests(folder: Path) -> dict[str, str]:
    """Read {path: digest} of everything that was made, but logs and tables of durations."""
    found = {}
    for place in ("results", "models"):
        for path in sorted((folder / place).rglob("*")):
            name = path.relative_to(folder)
            # a name with a dot in front is a file that is still being written; the index has the name of the folder
            if str(name) == "results/index.html":
                continue
            if path.suffix in COMPARED and not path.name.startswith(".") and path.is_file():
                found[str(name)] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def find_unlike(found: dict[str, str], expected: dict[str, str]) -> set[str]:
    """Find artifacts that differ from the expected ones; pictures and pages of a running job do not count."""
    whole = (".parquet", ".json", ".bbl", ".csv")
    return {k for k, digest in found.items() if k.endswith(whole) and digest != expected.get(k)}


def find_stages(folder: Path) -> list[str]:
    """Find the stages whose jobs run now, by their scripts; `no job` where none runs."""
    scripts = (folder / ".snakemake/scripts").glob("*.py")
    return sorted({path.name.split(".")[1] for path in scripts}) or ["no job"]


def wait_for_moment(process: subprocess.Popen, folder: Path, rng: np.random.Generator, seconds: float) -> bool:
    """Wait for a random moment of a run. seconds  of a typical job; return False where the run ends before."""
    jobs = int(rng.integers(-1, MAX_JOBS + 1))
    while jobs >= 0 and process.poll() is None:
        output = (folder / "output.txt").read_text(errors="replace")
        if len(re.findall(r"^\[ *\d+/\d+\]", output, flags=re.M)) >= jobs and re.search(
            r"^\d+ jobs?: ", output, flags=re.M
        ):
            break
        time.sleep(0.05)
    try:
        process.wait(rng.uniform(0.0, min(seconds, MAX_WAIT)))
    except subprocess.TimeoutExpired:
        return True
    return False


def kill(process: subprocess.Popen, by: signal.Signals) -> float | None:
    """End a run; return the seconds until it ended, or None where it did not end in time."""
    began = time.perf_counter()
    try:
        os.killpg(process.pid, by)
        process.wait(MAX_END)
    except ProcessLookupError:
        process.wait()
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return None
    return time.perf_counter() - began


def run_undisturbed(place: Path, targets: str, flights: int) -> tuple[dict[str, str], float]:
    """Run the project once; return its artifacts and the seconds of a typical job."""
    folder, stored = place / "undisturbed", place / "undisturbed.json"
    if not stored.is_file():
        lay(folder, flights)
        began = time.perf_counter()
        if start(folder, targets).wait():
            raise SystemExit((folder / "output.txt").read_text())
        jobs = re.findall(r"^\[ *\d+/(\d+)\]", (folder / "output.txt").read_text(), flags=re.M)
        # two jobs run at once
        about = {"artifacts": read_digests(folder), "job s": 2 * (time.perf_counter() - began) / int(jobs[-1])}
        write_json(stored, about)
    about = json.loads(stored.read_text())
    return about["artifacts"], about["job s"]


def disturb(place: Path, options: argparse.Namespace, expected: dict[str, str], seconds: float) -> dict:
    """Kill runs until the number is reached; return what was found."""
    stored = place / "state.json"
    state = {
        "kills": 0, "by SIGTERM": 0, "runs": 0, "folders": 0, "needed a manual step": 0, "artifacts that differ": [],
        "half-written": [], "did not end": 0, "longest end s": 0.0, "stages": {}, "open": False,
    }  # fmt: skip
    folder = place / "killed"
    if stored.is_file():
        state = json.loads(stored.read_text())
    if not folder.is_dir():
        lay(folder, options.flights)
    while state["kills"] < options.kills or state["open"]:
        kept = ["--keep-incomplete"] if state["folders"] % 2 else []
        process, state["open"] = start(folder, options.targets, *kept), True
        state["runs"] += 1
        rng = np.random.default_rng([options.seed, state["runs"]])
        if state["kills"] < options.kills and wait_for_moment(process, folder, rng, seconds):
            stages = find_stages(folder)
            by = (signal.SIGKILL, signal.SIGTERM)[state["kills"] % 2]
            ended = kill(process, by)
            state["kills"] += 1
            state["by SIGTERM"] += by == signal.SIGTERM
            state["did not end"] += ended is None
            state["longest end s"] = max(state["longest end s"], ended or MAX_END)
            state["stages"] = dict(Counter(state["stages"]) + Counter(stages))
            found = find_unlike(read_digests(folder), expected)
            state["half-written"] = sorted(set(state["half-written"]) | found)
            print(f"{state['kills']:3} {by.name} in {', '.join(stages)}: ended in {ended or -1:.1f} s", flush=True)
        elif process.wait():
            state["needed a manual step"] += 1
            state["open"] = False
            print((folder / "output.txt").read_text()[-3000:], flush=True)
            shutil.copytree(folder, place / f"failed-{state['kills']}", dirs_exist_ok=True)
            lay(folder, options.flights)
        else:
            made = read_digests(folder)
            differ = {k for k in expected.keys() | made.keys() if expected.get(k) != made.get(k)}
            state["artifacts that differ"] = sorted(set(state["artifacts that differ"]) | differ)
            state["folders"] += 1
            state["open"] = False
            lost = len(differ - made.keys())
            print(
                f"folder {state['folders']} finished, {len(differ)} artifacts differ, {lost} of them lost", flush=True
            )
            lay(folder, options.flights)
        write_json(stored, state)
    return {k: v for k, v in state.items() if k != "open"}


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 where nothing was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--flights", type=int, default=4, help="fewer than 4 have no model")
    parser.add_argument("--targets", choices=TARGETS, default="all")
    parser.add_argument("--folder", help="where projects and state lie; kept, to go on after an interruption")
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(options.folder or scratch).resolve()
        place.mkdir(parents=True, exist_ok=True)
        expected, seconds = run_undisturbed(place, options.targets, options.flights)
        print(f"undisturbed: {len(expected)} artifacts, {seconds:.1f} s a job", flush=True)
        found = disturb(place, options, expected, seconds)
    found["artifacts"] = len(expected)
    print(json.dumps(found, indent=1))
    write_json("results/benchmarks/chaos.json", found)
    if options.record:
        record("chaos", {**found, "unlike": len({*found["artifacts that differ"], *found["half-written"]})})
    faults = ("needed a manual step", "artifacts that differ", "half-written", "did not end")
    return int(any(found[k] for k in faults))


if __name__ == "__main__":
    sys.exit(main())
