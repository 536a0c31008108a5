"""What raw files show stops a model before a flight is imported; with --keep-going the sound flights go on."""

import os
import signal
import subprocess
import sys
import time

import pytest
from conftest import ROOT, Project

sys.path.insert(0, str(ROOT / "tests/unit"))
from made_lab import edit, lay_lab

pytestmark = pytest.mark.workflow


@pytest.fixture
def lab(tmp_path):
    project = Project(tmp_path)
    project.folder.mkdir()
    lay_lab(project.folder)
    return project


def test_a_fault_of_raw_files_stops_the_model_before_any_flight_is_imported(lab):
    edit(lab.folder, "Quad,433", "Qaud,433")
    edit(lab.folder, "Lab,c,data/raw", "Lab,c,data/rwa")
    code, text = lab.snakemake("-j2", "models/my_model/standalone")
    assert code != 0
    assert "no rigid body 'Qaud' (did you mean 'Quad'?)" in text
    assert "row 4, flight c: raw file data/rwa/c" in text
    assert text.rstrip().splitlines()[-1].startswith("[ERROR] data/")
    assert "import of " not in text and "filter of " not in text
    assert not (lab.folder / "results/imported").exists()


def test_a_fault_of_one_flight_leaves_the_others_when_going_on(lab):
    edit(lab.folder, "Quad,433", "Qaud,433")
    code, text = lab.snakemake("-j2", "--keep-going", "--until", "importing", "--", "processing")
    assert code != 0
    assert "no rigid body 'Qaud'" in text
    made = {p.stem for p in (lab.folder / "results/imported/Lab").glob("*.parquet")}
    assert made == {"a", "c"}


def test_a_fault_of_the_configuration_is_one_sentence_in_a_dry_run_too(lab):
    path = lab.folder / "config/models/my_model.json"
    path.write_text(path.read_text().replace('"partition ratio"', '"partition ratoi"'))
    for mode in ("-n", "-j1"):
        code, text = lab.snakemake(mode, "models/my_model/standalone")
        assert code != 0
        assert text.count("'partition ratoi'") == 1 and "Traceback" not in text and "Exception" not in text
        assert text.rstrip().splitlines()[-1].startswith("[ERROR] config/models/my_model.json: unknown key")


def test_a_second_run_names_the_first_and_removes_its_lock_only_when_that_is_dead(lab):
    command = [sys.executable, "-m", "snakemake", "-s", str(lab.house / "Snakefile"), "-d", str(lab.folder), "-j1"]
    first = subprocess.Popen(
        [*command, "--profile", str(lab.house / "profiles/default"), "models/my_model/standalone"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        locks, until = lab.folder / ".snakemake/locks", time.monotonic() + 60.0
        # a lock is two files, each made empty and then filled: a process stopped in between holds no lock yet
        while not (locks.is_dir() and sum(p.stat().st_size > 0 for p in locks.iterdir()) == 2):
            assert first.poll() is None and time.monotonic() < until
            time.sleep(0.05)
        first.send_signal(signal.SIGSTOP)  # it stays alive and keeps its lock
        code, text = lab.snakemake("-j1", "models/my_model/standalone")
        assert code != 0
        assert f"process {first.pid} " in text.rstrip().splitlines()[-1]
        assert "--unlock" not in text
        code, text = lab.snakemake("--unlock")
        assert code != 0 and f"process {first.pid} " in text and any(locks.iterdir())
    finally:
        os.killpg(first.pid, signal.SIGKILL)
        first.wait()
    code, text = lab.snakemake("-j1", "results/imported/Lab/a.parquet")
    assert code == 0, text
    assert f"process {first.pid} " in text
    assert not list(lab.folder.glob(".snakemake/locks/*"))
