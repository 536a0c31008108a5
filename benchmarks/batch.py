"""A hundred flights filtered by the workflow with -j2: cores busy and memory of each job.

    python benchmarks/batch.py [--flights 100] [--seconds 90] [--jobs 2]

Lays a project of that many flights, copies of one made flight as imported, and has Snakemake filter them all. Printed:
cores busy (process time of everything that ran over the time it took), jobs at once, seconds and greatest memory of a
job; written to results/benchmarks/batch.json. Other work on the machine takes cores away, so its load is printed too.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pandas as pd
from dry_run import lay
from measured_table import record
from study import ROOT, fly

from quasi.tables import write_json, write_table

BUSY, LARGEST = 1.8, 1024.0  # cores of two, MiB
QUADROTOR = "MadeBeetle"


def imported(folder: Path, flights: int, seconds: float) -> None:
    """Results of the import of all flights: one made flight under every name."""
    _, frame, about, _ = fly("flight-0", profile="mixed", seed=7, duration=seconds)
    for i in range(flights):
        base = folder / f"results/imported/{QUADROTOR}/flight-{i}"
        document = about | {"flight": f"flight-{i}", "quadrotor": QUADROTOR}
        write_table(f"{base}.parquet", frame, made=document)
        write_json(f"{base}.json", document)


def cpu() -> float:
    """Process time of all children that have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> int:
    """Run the benchmark; 0 where the targets are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "project"
        lay(folder, options.flights)
        imported(folder, options.flights, options.seconds)
        wanted = [f"results/filtered/{QUADROTOR}/withGravity/flight-{i}.parquet" for i in range(options.flights)]
        command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(folder)]
        command += [f"-j{options.jobs}", "-q", "all", "--", *wanted]
        load, began, used = os.getloadavg()[0], time.perf_counter(), cpu()
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
        wall, used = time.perf_counter() - began, cpu() - used
        if done.returncode != 0:
            print(done.stdout[-2000:], done.stderr[-2000:], sep="\n")
            return 1
        rows = [pd.read_csv(path, sep="\t") for path in sorted(folder.glob("results/benchmarks/filtering/*/*.tsv"))]
    jobs = pd.concat(rows, ignore_index=True)
    result = {
        "flights": len(jobs),
        "wall s": wall,
        "cores busy": used / wall,
        "jobs at once": float(jobs["s"].sum() / wall),
        "seconds a job": float(jobs["s"].median()),
        "largest memory MiB": float(jobs["max_rss"].max()),
        "median memory MiB": float(jobs["max_rss"].median()),
        "load before": load,
    }
    print(f"{len(jobs)} flights of {options.seconds:g} s filtered with -j{options.jobs} in {wall:.0f} s")
    print(f"cores busy          {result['cores busy']:.2f} (at least {BUSY:g}); load of the machine before: {load:.2f}")
    print(f"jobs at once        {result['jobs at once']:.2f}; a job takes {result['seconds a job']:.1f} s")
    memory = f"{result['largest memory MiB']:.0f} MiB at most, {result['median memory MiB']:.0f} as a rule"
    print(f"memory of a job     {memory} (under {LARGEST:g})")
    write_json(ROOT / "results/benchmarks/batch.json", result)
    if options.record:
        record("batch", result)
    return 0 if result["cores busy"] >= BUSY and result["largest memory MiB"] < LARGEST else 1


if __name__ == "__main__":
    raise SystemExit(main())
