"""The bundled example on a one-node SLURM, with a job killed on the way.

It takes minutes, needs root and Debian's SLURM packages, and runs where QUASI_TEST_CLUSTER is set:

    QUASI_TEST_CLUSTER=1 python -m pytest -n 0 tests/cluster
"""

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

ROOT = Path(__file__).parents[2]
START = Path(__file__).with_name("start_slurm.sh")
LIMIT = 1500.0  # s for the whole run
# no accounting, and the only partition
LOCAL = [
    "--slurm-status-command", "squeue", "--slurm-init-seconds-before-status-checks", "2", "--slurm-no-account",
    "--default-resources", "slurm_partition=main", "mem_mb=2000", "runtime=30",
]  # fmt: skip

pytestmark = pytest.mark.skipif(
    "QUASI_TEST_CLUSTER" not in os.environ, reason="takes minutes and starts SLURM: set QUASI_TEST_CLUSTER to run it"
)


@pytest.fixture
def cluster(tmp_path):
    """Environment of a running cluster of one node; it is stopped at the end."""
    if importlib.util.find_spec("snakemake_executor_plugin_slurm") is None:
        pytest.skip("snakemake-executor-plugin-slurm is not installed: pip install 'quasi[slurm]'")
    folder = tmp_path / "slurm"
    started = subprocess.run([START, folder], capture_output=True, text=True)
    if started.returncode:
        pytest.skip(f"SLURM could not be started: {started.stderr.strip()}")
    yield os.environ | {"SLURM_CONF": str(folder / "slurm.conf")}
    subprocess.run([START, folder, "stop"], check=True)


@pytest.fixture
def lab(tmp_path):
    """A project folder with the bundled example, nothing made yet."""
    folder = tmp_path / "lab"
    for name in ("config", "data"):
        shutil.copytree(ROOT / name, folder / name)
    return folder


def start_run(lab, environment):
    command = [
        sys.executable, "-m", "snakemake", "-s", ROOT / "Snakefile", "-d", lab, "--profile", ROOT / "profiles/slurm",
        "--workflow-profile", ROOT / "profiles/default", *LOCAL, "--", "models/example/standalone",
    ]  # fmt: skip
    with (lab / "output.txt").open("w") as output:
        return subprocess.Popen(command, cwd=ROOT, env=environment, stdout=output, stderr=subprocess.STDOUT)


def kill_one_job(lab, script, deadline):
    """Kill (SIGKILL) the first process that works on a stage in this folder; its command line."""
    while time.monotonic() < deadline:
        for process in psutil.process_iter(["cmdline"]):
            words = process.info["cmdline"] or []
            if any(word.endswith(f".{script}") or f"/{script}" in word for word in words) and "-c" not in words:
                try:
                    if Path(process.cwd()) == lab:
                        os.kill(process.pid, signal.SIGKILL)
                        return words
                except (psutil.Error, OSError):
                    continue
        time.sleep(0.1)
    return []


def test_the_example_is_carried_to_its_model_although_a_job_is_killed(cluster, lab):
    deadline = time.monotonic() + LIMIT
    run = start_run(lab, cluster)
    try:
        killed = kill_one_job(lab, "filtering.py", deadline)
        code = run.wait(max(deadline - time.monotonic(), 1.0))
    finally:
        if run.poll() is None:
            run.kill()
    printed = (lab / "output.txt").read_text()
    assert killed, printed
    assert code == 0, printed
    model = json.loads((lab / "models/example/standalone/model.json").read_text())
    assert model["schema"].startswith("quasi.model/")
    assert "submitted with SLURM jobid" in printed
    # what jobs report reaches the terminal through the project folder
    assert "filtering of example-01" in printed
