"""Half a folder that a failed job left with `--keep-incomplete` is made anew by the next run of Snakemake."""

import subprocess
import sys

WORKFLOW = """
from snakemake.jobs import Job
from quasi.running.failed_jobs import mark_incomplete

if config["marked"] == "yes":
    mark_incomplete(Job)

rule whole:
    input: "figures"
    output: "whole.txt"
    shell: "ls figures | wc -l > whole.txt"

rule figures:
    output: directory("figures")
    shell: "mkdir -p figures; test -e space; touch figures/one figures/two"
"""


def count_figures(folder, marked):
    """Number of figures that the second run finds, after a first one whose job fails before it draws."""
    (folder / "Snakefile").write_text(WORKFLOW)
    command = [sys.executable, "-m", "snakemake", "-j1", "--keep-incomplete", "--rerun-incomplete", "--config"]
    first = subprocess.run([*command, f"marked={marked}"], cwd=folder, capture_output=True)
    assert first.returncode
    assert (folder / "figures").is_dir() and not list((folder / "figures").iterdir())
    (folder / "space").touch()
    second = subprocess.run([*command, f"marked={marked}"], cwd=folder, capture_output=True, text=True)
    assert second.returncode == 0, second.stderr
    return int((folder / "whole.txt").read_text())


def test_what_a_failed_job_left_is_made_anew(tmp_path):
    assert count_figures(tmp_path, "yes") == 2


def test_snakemake_alone_takes_it_for_whole(tmp_path):
    # where this fails, Snakemake has mended it: the correction can go
    assert count_figures(tmp_path, "no") == 0
