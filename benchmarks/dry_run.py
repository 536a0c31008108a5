"""How long Snakemake needs to see what is to be done for a logbook of many flights.

    python benchmarks/dry_run.py [--rows 200]

Lays a project whose logbook has that many rows, all of them used by one model, and times a dry run of the model.
"""

import argparse
import csv
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from measured_table import record

ROOT = Path(__file__).parents[1]


def lay(folder: Path, rows: int) -> None:
    """A project with `rows` flights of the example's quadrotor."""
    for name in ("config/models", "data"):
        (folder / name).mkdir(parents=True)
    shutil.copy(ROOT / "data/MadeBeetleConfig.json", folder / "data")
    with (ROOT / "data/example_file_log.csv").open(newline="") as source:
        first = next(csv.DictReader(source))
    with (folder / "data/example_file_log.csv").open("w", newline="") as target:
        writer = csv.DictWriter(target, first)
        writer.writeheader()
        for i in range(rows):
            names = {"Onboard Name": f"flight-{i}", "Raw OptiTrack Name": f"flight-{i}", "OB Path": "data/raw"}
            writer.writerow({**first, **names, "Flight ID": str(i), "Raw OT Path": "data/raw"})
    raw = folder / "data/raw"
    raw.mkdir()
    for i in range(rows):
        (raw / f"flight-{i}.bbl").touch()
        (raw / f"flight-{i}.csv").touch()
    shutil.copy(ROOT / "config/processing.json", folder / "config")
    model = json.loads((ROOT / "config/models/example.json").read_text())
    model["logging file"] |= {
        "rows of flights to use (all)": [f"2-{rows + 1}"],
        "rows of flights for validation": [rows + 1],
    }
    (folder / "config/models/example.json").write_text(json.dumps(model))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=200)
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "project"
        lay(folder, options.rows)
        command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(folder), "-n", "-q"]
        times = []
        for _ in range(3):
            started = time.perf_counter()
            done = subprocess.run([*command, "all", "--", "models/example/standalone"], capture_output=True, text=True)
            times.append(time.perf_counter() - started)
            assert done.returncode == 0, done.stderr
    shown = ", ".join(f"{t:.1f}" for t in sorted(times))
    if options.record:
        record("dry_run", {"best s": min(times)})
    print(f"dry run of a model of {options.rows} logbook rows, three times: {shown} s")


if __name__ == "__main__":
    main()
