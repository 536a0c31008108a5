"""How long Snakemake needs to see what is to be done for a logbook of many flights, and how much of it is ours.

    python benchmarks/dry_run.py [--rows 200] [--repeats 3]

Lays a project whose logbook has that many rows, all of them used by one model, and times a dry run of the model. The
same graph as bare rules, without configuration, checks and digests, is what Snakemake itself needs: with a shell
command a rule, and with a script and a parameter a rule as ours have, whose sources Snakemake looks up for each job.
Processor times are compared, because they depend little on other work of the machine; ours may be 20 % above
Snakemake's own.
"""

import argparse
import csv
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from measured_table import record

ROOT = Path(__file__).parents[1]
MAX_SHARE = 0.2  # processor time of a dry run beyond that of bare rules, the target


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


BARE = """
FLIGHTS = [f"flight-{i}" for i in range(ROWS)]
rule standalone:
    input: "inspected.json", expand("{part}.json", part=["model", "scores", "figures", "trajectories", "report"])
    output: "standalone.json"
    shell: "x"
rule inspection:
    input: expand("data/raw/{f}.{k}", f=FLIGHTS, k=["bbl", "csv"])
    output: "inspected.json"
    shell: "x"
rule importing:
    input: "data/raw/{flight}.bbl", "data/raw/{flight}.csv"
    output: "imported/{flight}.parquet", "imported/{flight}.json"
    log: "logs/importing/{flight}.log"
    shell: "x"
rule filtering:
    input: "imported/{flight}.parquet", "imported/{flight}.json"
    output: expand("{k}/{{flight}}.{e}", k=["with", "no"], e=["parquet", "json"]), "c/{flight}.parquet"
    log: "logs/filtering/{flight}.log"
    shell: "x"
rule shared:
    input: expand("with/{f}.parquet", f=FLIGHTS[:-1])
    output: "shared.json", "partition.parquet"
    shell: "x"
rule identification:
    input: expand("with/{f}.parquet", f=FLIGHTS[:-1]), "shared.json", "partition.parquet"
    output: "axis-{axis}.json"
    shell: "x"
rule model:
    input: expand("axis-{axis}.json", axis=range(6)), expand("with/{f}.parquet", f=FLIGHTS[:-1])
    output: "model.json"
    shell: "x"
rule scores:
    input: "model.json", "partition.parquet", expand("with/{f}.parquet", f=FLIGHTS)
    output: "scores.json"
    shell: "x"
rule figures:
    input: "model.json", "partition.parquet", expand("with/{f}.parquet", f=FLIGHTS)
    output: "figures.json"
    shell: "x"
rule trajectories:
    input: expand("with/{f}.parquet", f=FLIGHTS)
    output: "trajectories.json"
    shell: "x"
rule report:
    input: "model.json", "scores.json"
    output: "report.json"
    shell: "x"
"""


def measure(snakefile: Path, folder: Path, target: str, repeats: int) -> tuple[float, float]:
    """Measure a dry run: least seconds and least processor time."""
    command = [
        sys.executable,
        "-m",
        "snakemake",
        "-s",
        str(snakefile),
        "-d",
        str(folder),
        "-n",
        "-q",
        "all",
        "--",
        target,
    ]
    seconds, processor = [], []
    for _ in range(repeats):
        before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
        seconds.append(time.perf_counter() - started)
        now = resource.getrusage(resource.RUSAGE_CHILDREN)
        processor.append(now.ru_utime + now.ru_stime - before.ru_utime - before.ru_stime)
        if done.returncode:
            raise SystemExit(done.stdout + done.stderr)
    return min(seconds), min(processor)


def main() -> int:
    """Run the benchmark; 0 where the target is met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "project"
        lay(folder, options.rows)
        bare = Path(name) / "Snakefile"
        bare.write_text(f"ROWS = {options.rows}\n{BARE}")
        ours = measure(ROOT / "Snakefile", folder, "models/example/standalone", options.repeats)
        own = measure(bare, folder, "standalone.json", options.repeats)
        scripted = Path(name) / "Scripted"
        (Path(name) / "x.py").touch()
        scripted.write_text(bare.read_text().replace('shell: "x"', 'params: number=1\n    script: "x.py"'))
        with_scripts = measure(scripted, folder, "standalone.json", options.repeats)
    share = ours[1] / own[1] - 1
    print(f"dry run of a model of {options.rows} logbook rows: {ours[0]:.1f} s, processor {ours[1]:.1f} s")
    for title, (seconds, processor) in (("shell commands", own), ("scripts", with_scripts)):
        more = 100 * (ours[1] / processor - 1)
        print(f"the same as bare rules, {title}: {seconds:.1f} s, processor {processor:.1f} s; ours {more:+.0f} %")
    if options.record:
        record("dry_run", {"best s": ours[0]})
    return int(share > MAX_SHARE)


if __name__ == "__main__":
    sys.exit(main())
