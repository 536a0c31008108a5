"""A thousand flights from raw logs to filtered tables, -j2: processor time of a flight, cores busy, memory over time.

    python benchmarks/batch.py [--flights 1000] [--jobs 2] [--record]

Makes the eight 90 s flights of the example as raw logs, lays a project whose logbook has that many rows (hard links to
the eight logs under names of their own), and has Snakemake import and filter them all. Printed: processor time of
everything that ran over the number of flights, cores busy (processor time over the time it took), the memory of all
processes in the first and in the last quarter of the run (shared pages counted once), and the greatest memory of a job.
Other work on the machine takes cores away, so its load is printed too. Written to results/benchmarks/batch.json.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
from dry_run import lay
from first_result import ROOT, measure
from measured_table import record

from quasi.tables import write_json

MEBIBYTE = 2**20
COST, BUSY, LARGEST, GROWTH = 2.5, 1.8, 1024.0, 1.1  # core s a flight, cores of two, MiB of a job, last over first
PERIOD = 5.0  # s between two readings of the memory
QUADROTOR = "MadeBeetle"


def workflow(folder: Path, jobs: int, targets: list[str]) -> list[str]:
    """Command that makes the targets in a project folder."""
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(folder)]
    return [*command, f"-j{jobs}", "-q", "all", "--", *targets]


def make_raw(folder: Path, jobs: int) -> list[tuple[Path, Path]]:
    """Raw logs of the example's flights: (flight controller's, motion capture's)."""
    for name in ("config", "data"):
        (folder / name).symlink_to(ROOT / name)
    places = [f"results/synthesis/example/onboard/example-{i:02d}.bbl" for i in range(1, 9)]
    measure(workflow(folder, jobs, places), folder, dict(os.environ))
    return [
        (folder / place, folder / place.replace("onboard", "optitrack").replace(".bbl", ".csv")) for place in places
    ]


def measure_memory(process: psutil.Process) -> float:
    """Memory of a process and all below it, MiB; pages that several share count once."""
    total = 0
    for one in (process, *process.children(recursive=True)):
        try:
            total += one.memory_full_info().pss
        except psutil.Error:  # ended meanwhile
            continue
    return total / MEBIBYTE


class MemoryOverTime(threading.Thread):
    """Readings of the memory of a process and all below it until it ends: attribute `mebibytes`."""

    def __init__(self, process: subprocess.Popen):
        super().__init__(daemon=True)
        self.process, self.mebibytes = process, []

    def run(self) -> None:
        """Read every PERIOD seconds."""
        while self.process.poll() is None:
            try:
                self.mebibytes.append(measure_memory(psutil.Process(self.process.pid)))
            except psutil.NoSuchProcess:
                return
            time.sleep(PERIOD)


def run_batch(folder: Path, jobs: int, targets: list[str]) -> dict[str, float]:
    """Make the targets; return durations in s and memory in MiB."""
    load, began = os.getloadavg()[0], time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with (folder / "output.txt").open("w") as output:
        process = subprocess.Popen(workflow(folder, jobs, targets), cwd=folder, stdout=output, stderr=output)
        memory = MemoryOverTime(process)
        memory.start()
        code = process.wait()
    wall, now = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    memory.join()
    if code:
        raise SystemExit((folder / "output.txt").read_text()[-4000:])
    quarter = max(len(memory.mebibytes) // 4, 1)
    processor = now.ru_utime + now.ru_stime - before.ru_utime - before.ru_stime
    return {
        "wall s": wall,
        "processor s": processor,
        "cores busy": processor / wall,
        "first quarter MiB": float(np.median(memory.mebibytes[:quarter])),
        "last quarter MiB": float(np.median(memory.mebibytes[-quarter:])),
        "load before": load,
    }


def main() -> int:
    """Run the benchmark; 0 where the targets are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        source, folder = Path(name) / "source", Path(name) / "project"
        source.mkdir()
        logs = make_raw(source, options.jobs)
        lay(folder, options.flights)
        for i in range(options.flights):
            for log in logs[i % len(logs)]:
                place = folder / f"data/raw/flight-{i}{log.suffix}"
                place.unlink()
                place.hardlink_to(log)
        tables = [f"results/filtered/{QUADROTOR}/withGravity/flight-{i}.parquet" for i in range(options.flights)]
        result = run_batch(folder, options.jobs, tables)
        missing = [table for table in tables if not (folder / table).is_file()]
        if missing:
            raise SystemExit(f"{len(missing)} tables were not made, the first is {missing[0]}")
        paths = sorted(folder.glob("results/benchmarks/*/**/*.tsv"))
        rows = pd.concat([pd.read_csv(path, sep="\t").assign(rule=path.parts[-3]) for path in paths])
    result |= {"flights": options.flights, "core s a flight": result["processor s"] / options.flights}
    result["largest memory MiB"] = float(rows["max_rss"].max())
    growth = result["last quarter MiB"] / result["first quarter MiB"]
    print(
        f"{options.flights} flights of 90 s from raw logs to filtered with -j{options.jobs}: {result['wall s']:.0f} s"
    )
    print(f"processor time of a flight  {result['core s a flight']:.2f} s (at most {COST:g})")
    print(
        f"cores busy                  {result['cores busy']:.2f} (at least {BUSY:g}); load {result['load before']:.2f}"
    )
    memory = f"{result['first quarter MiB']:.0f} MiB in the first quarter, {result['last quarter MiB']:.0f} in the last"
    print(f"memory of all processes     {memory} (at most {GROWTH:g} times)")
    print(f"memory of a job             {result['largest memory MiB']:.0f} MiB at most (under {LARGEST:g})")
    for rule, jobs in rows.groupby("rule"):
        print(
            f"  {rule:12} {jobs['s'].median():.2f} s a job, processor {pd.to_numeric(jobs['cpu_time']).median():.2f} s"
        )
    write_json(ROOT / "results/benchmarks/batch.json", result)
    if options.record:
        record("batch", result)
    met = result["core s a flight"] <= COST and result["cores busy"] >= BUSY and growth <= GROWTH
    return 0 if met and result["largest memory MiB"] < LARGEST else 1


if __name__ == "__main__":
    raise SystemExit(main())
