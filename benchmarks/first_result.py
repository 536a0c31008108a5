"""From `pip install` in a fresh environment to the printed scores of the example: where the time goes.

    python benchmarks/first_result.py [--no-install] [--record]

Copies the checkout without results and without compiled kernels, installs it in a fresh environment, and makes
models/example/standalone twice: first with an empty kernel cache, then in a second fresh project (warm). Printed for
both: seconds and processor time of the workflow, until the scores are printed, and of each rule. An idle machine of two
cores needs at least half of the processor time. Import: processor time of what the job server imports. Compile:
processor time of the first run beyond the second. Artifacts of both runs have to be equal. Written to
results/benchmarks/first_result.json.
"""

import argparse
import hashlib
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

from measured_table import record

from quasi.running.job_server import PRELOADED
from quasi.tables import write_json

ROOT = Path(__file__).resolve().parents[1]
TARGET = "models/example/standalone"
FOLDERS = ("rules", "scripts", "quasi", "quasi_synthesis", "config", "profiles", "data")
FILES = ("Snakefile", "pyproject.toml", "README.md", "LICENSE")


def measure(command: list[str], folder: Path, environment: dict[str, str]) -> tuple[float, float, str]:
    """Run a command; return its seconds, its processor time and its output."""
    used, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    seconds, now = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}")
    return seconds, now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime, done.stdout + done.stderr


def read_rules(project: Path) -> dict[str, dict[str, float]]:
    """Read {rule: jobs, s, processor s} of the rules that measure themselves."""
    found: dict[str, dict[str, float]] = defaultdict(lambda: {"jobs": 0, "s": 0.0, "processor s": 0.0})
    for path in sorted((project / "results/benchmarks").rglob("*.tsv")):
        head, row = (line.split("\t") for line in path.read_text().splitlines()[:2])
        about = dict(zip(head, row, strict=True))
        place = path.relative_to(project / "results/benchmarks").parts[0]
        rule = f"{place}, {path.stem}" if place == "standalone" else place
        found[rule]["jobs"] += 1
        found[rule]["s"] += float(about["s"])
        found[rule]["processor s"] += float(about["cpu_time"]) if about["cpu_time"] != "NA" else 0.0
    return dict(found)


def read_digests(project: Path) -> dict[str, str]:
    """Read {path: digest} of tables and documents; tables of durations do not count."""
    return {
        str(path.relative_to(project)): hashlib.sha256(path.read_bytes()).hexdigest()
        for place in ("results", "models")
        for path in sorted((project / place).rglob("*"))
        if path.suffix in (".parquet", ".json", ".txt", ".png") and path.is_file()
    }


def run_workflow(python: str, house: Path, project: Path) -> tuple[dict, dict[str, str]]:
    """Make the example in a fresh project folder; return its durations and the digests of its artifacts."""
    for name in ("config", "data"):
        shutil.copytree(house / name, project / name)
    environment = {k: v for k, v in os.environ.items() if k not in ("QUASI_RUN", "NUMBA_CACHE_DIR")}
    environment |= {"PYTHONPATH": str(house)}
    command = [python, "-m", "snakemake", "-s", str(house / "Snakefile"), "-d", str(project), "-j2", TARGET]
    load = os.getloadavg()[0]
    seconds, processor, output = measure(command, project, environment)
    jobs = re.findall(r"^\[ *\d+/\d+\] (.+?): ([\d.]+) s", output, flags=re.M)
    about = {
        "s": seconds, "processor s": processor, "load before": load, "rules": read_rules(project),
        "unmeasured jobs s": {name: float(s) for name, s in jobs if name.split()[0] in ("assembly", "report", "model")},
    }  # fmt: skip
    return about, read_digests(project)


def show(title: str, about: dict) -> None:
    """Print the durations of one run."""
    print(
        f"{title}: {about['s']:.0f} s, processor {about['processor s']:.0f} s; load before {about['load before']:.1f}"
    )
    within = sum(row["processor s"] for row in about["rules"].values())
    print(f"  Snakemake, imports, kernels, other rules: processor {about['processor s'] - within:.1f} s")
    for rule, row in sorted(about["rules"].items(), key=lambda item: -item[1]["processor s"]):
        print(f"  {rule:28} {row['jobs']:3.0f} jobs {row['s']:8.1f} s, processor {row['processor s']:6.1f} s")


def main() -> int:
    """Run the benchmark; 0 where both runs make the same."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-install", action="store_true", help="use this environment")
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    options = parser.parse_args()
    result: dict = {}
    with tempfile.TemporaryDirectory() as name:
        house, python = Path(name) / "house", sys.executable
        for part in FOLDERS:
            shutil.copytree(ROOT / part, house / part, ignore=shutil.ignore_patterns("__pycache__"))
        for part in FILES:
            shutil.copy(ROOT / part, house / part)
        if not options.no_install:
            python = f"{name}/venv/bin/python"
            create = measure([sys.executable, "-m", "venv", f"{name}/venv"], house, dict(os.environ))
            install = measure(
                [python, "-m", "pip", "install", "-q", "--no-compile", "-e", "."], house, dict(os.environ)
            )
            result["install"] = {"s": create[0] + install[0], "processor s": create[1] + install[1]}
            print(f"install: {result['install']['s']:.0f} s, processor {result['install']['processor s']:.0f} s")
        (Path(name) / "first").mkdir()
        (Path(name) / "second").mkdir()
        result["first"], first = run_workflow(python, house, Path(name) / "first")
        show("first run", result["first"])
        result["second"], second = run_workflow(python, house, Path(name) / "second")
        show("second run", result["second"])
        program = f"import importlib\nfor name in {PRELOADED!r}: importlib.import_module(name)"
        imports = measure([python, "-c", program], house, os.environ | {"PYTHONPATH": str(house)})
        result["import processor s"] = imports[1]
    result["compile processor s"] = result["first"]["processor s"] - result["second"]["processor s"]
    result["artifacts that differ"] = sorted(k for k in first.keys() | second.keys() if first.get(k) != second.get(k))
    print(f"imports of the job server: processor {result['import processor s']:.1f} s")
    print(f"compile: processor {result['compile processor s']:.0f} s")
    print(f"{len(first)} artifacts, {len(result['artifacts that differ'])} differ between both runs")
    write_json(ROOT / "results/benchmarks/first_result.json", result)
    if options.record:
        parts = [part for part in ("install", "first", "second") if part in result]
        figures = {f"{part} {key}": result[part][key] for part in parts for key in ("s", "processor s")}
        record("first_result", figures | {"compile processor s": result["compile processor s"]})
    return int(bool(result["artifacts that differ"]))


if __name__ == "__main__":
    sys.exit(main())
