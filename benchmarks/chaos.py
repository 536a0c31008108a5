"""Kills at random moments of all stages; the same command again has to finish with byte-equal artifacts.

    python benchmarks/chaos.py [--kills 100] [--seed 1]

Lays a small project (four made flights, a model, a gap), runs it once undisturbed, then again and again from nothing.
Each run is killed (SIGKILL to its whole process group; every third by SIGTERM) at a random moment of the undisturbed
time and started again with the same command until the asked number of kills is reached; every finished folder is
compared with the undisturbed one. Printed: kills, runs that needed a manual step, artifacts that differ, runs that did
not end within a minute of SIGTERM; written to results/benchmarks/chaos.json. 0 is returned where all three are 0.
"""

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from quasi.synthesis.campaign import project_files, read_campaign
from quasi.tables import write_json

ROOT = Path(__file__).resolve().parents[1]
TARGETS = ("models/small/standalone", "results/gaps/near")
ENDED = 60.0  # s after SIGTERM within which a run has to end
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


def lay(folder: Path) -> None:
    """A project folder with its configuration, nothing made yet."""
    for name, document in (
        ("config/models/small.json", MODEL), ("config/gaps/near.json", GAP), ("config/synthesis/small.json", CAMPAIGN),
        ("config/processing.json", {"logging file": LOGBOOK, "data importing": {"resampling rate": 250}}),
    ):  # fmt: skip
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(json.dumps(document))
    for name, text in project_files(read_campaign(CAMPAIGN, "small")).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def start(folder: Path) -> subprocess.Popen:
    """The command of every run, in a process group of its own."""
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(folder), "-j2"]
    command += ["--profile", str(ROOT / "profiles/default"), "--", *TARGETS]
    environment = {k: v for k, v in os.environ.items() if k != "QUASI_RUN"} | {"PYTHONPATH": str(ROOT)}
    with (folder / "output.txt").open("ab") as output:
        return subprocess.Popen(
            command, cwd=folder, env=environment, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
        )


def artifacts(folder: Path) -> dict[str, str]:
    """{path: digest} of everything that was made but logs and figures' pages with times of their own."""
    found = {}
    for place in ("results", "models", "data"):
        for path in sorted((folder / place).rglob("*")):
            if (
                path.is_file()
                and path.suffix in (".parquet", ".json", ".csv", ".bbl", ".txt")
                and "logs" not in path.parts
            ):
                found[str(path.relative_to(folder))] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def kill(process: subprocess.Popen, by: signal.Signals) -> bool:
    """End a run; whether it ended in time."""
    try:
        os.killpg(process.pid, by)
        process.wait(ENDED)
    except ProcessLookupError:
        process.wait()
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return False
    return True


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    kills, stuck, different, hung = 0, 0, set(), 0
    with tempfile.TemporaryDirectory() as name:
        whole = Path(name) / "undisturbed"
        lay(whole)
        began = time.perf_counter()
        if start(whole).wait():
            print((whole / "output.txt").read_text())
            return 1
        seconds, expected = time.perf_counter() - began, artifacts(whole)
        print(f"undisturbed: {seconds:.0f} s, {len(expected)} artifacts", flush=True)
        while kills < options.kills:
            folder = Path(name) / "killed"
            shutil.rmtree(folder, ignore_errors=True)
            lay(folder)
            while True:
                process = start(folder)
                try:
                    code = process.wait(rng.uniform(0.0, seconds if kills < options.kills else 1e6))
                except subprocess.TimeoutExpired:
                    kills += 1
                    hung += not kill(process, signal.SIGTERM if kills % 3 == 0 else signal.SIGKILL)
                    continue
                break
            stuck += code != 0
            if code:
                print((folder / "output.txt").read_text()[-2000:])
            made = artifacts(folder)
            different |= {k for k in expected.keys() | made.keys() if expected.get(k) != made.get(k)}
            print(f"{kills} kills, {stuck} stuck, {len(different)} differ, {hung} hung", flush=True)
    write_json(
        "results/benchmarks/chaos.json",
        {"kills": kills, "needed a manual step": stuck, "artifacts that differ": sorted(different), "hung": hung},
    )
    return int(bool(stuck or different or hung))


if __name__ == "__main__":
    sys.exit(main())
