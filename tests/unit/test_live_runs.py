"""A locked folder: who holds it, and when removing the lock is right."""

import os
import socket
import subprocess
import sys

import psutil
import pytest

from quasi.running import live_runs
from quasi.running.live_runs import (
    explain_lock,
    is_alive,
    other_runs,
    refuse_unlocking,
    register_run,
    remove_stale_lock,
    withdraw_card,
)
from quasi.tables import read_json, write_json


@pytest.fixture
def other(tmp_path):
    """Leaves the card of another process."""

    def leave(pid, started, host=None, at=1e9):
        host = host or socket.gethostname()
        card = {"pid": pid, "host": host, "process started": started, "at": at, "command": "snakemake -j2 models/x"}
        write_json(tmp_path / live_runs.CARDS_FOLDER / f"{host}-{pid}.json", card)

    return leave


@pytest.fixture
def process():
    running = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    yield running
    running.kill()
    running.wait()


def test_a_live_run_is_named_and_its_lock_never_given_up(tmp_path, other, process):
    other(process.pid, psutil.Process(process.pid).create_time())
    text = explain_lock(tmp_path, "snakemake -d lab")
    assert f"process {process.pid}" in text and socket.gethostname() in text and "`snakemake -j2 models/x`" in text
    assert "--unlock" not in text
    assert f"process {process.pid}" in refuse_unlocking(tmp_path)
    lock = tmp_path / live_runs.LOCKS_FOLDER / "0.input.lock"
    lock.parent.mkdir(parents=True)
    lock.touch()
    assert remove_stale_lock(tmp_path) is None and lock.exists()
    process.kill()
    process.wait()
    assert refuse_unlocking(tmp_path) is None
    assert f"process {process.pid}" in remove_stale_lock(tmp_path) and not lock.exists()
    assert remove_stale_lock(tmp_path) is None


def test_a_process_that_got_the_number_of_a_dead_run_is_another_one(tmp_path, other, process):
    other(process.pid, psutil.Process(process.pid).create_time() - 3600.0)
    assert is_alive(other_runs(tmp_path)[0]) is False


def test_a_run_on_another_computer_may_be_alive(tmp_path, other):
    other(1, 1e9, host="elsewhere")
    assert is_alive(other_runs(tmp_path)[0]) is None
    assert "on another computer" in explain_lock(tmp_path, "snakemake")
    assert "process 1 on elsewhere" in explain_lock(tmp_path, "snakemake")
    (tmp_path / live_runs.LOCKS_FOLDER).mkdir(parents=True)
    (tmp_path / live_runs.LOCKS_FOLDER / "0.input.lock").touch()
    assert remove_stale_lock(tmp_path) is None and list((tmp_path / live_runs.LOCKS_FOLDER).iterdir())


def test_a_lock_without_a_recorded_run_stays_and_the_command_that_removes_it_is_named(tmp_path):
    (tmp_path / live_runs.LOCKS_FOLDER).mkdir(parents=True)
    (tmp_path / live_runs.LOCKS_FOLDER / "0.input.lock").touch()
    assert remove_stale_lock(tmp_path) is None
    assert "`snakemake -d lab --unlock`" in explain_lock(tmp_path, "snakemake -d lab")


def test_a_run_leaves_its_card_and_takes_it_back_and_dead_ones_go_once_nothing_is_locked(tmp_path, other):
    other(2**22 + 1, 1.0)
    (tmp_path / live_runs.LOCKS_FOLDER).mkdir(parents=True)
    (tmp_path / live_runs.LOCKS_FOLDER / "0.input.lock").touch()
    card = register_run(tmp_path, "snakemake -j1")
    assert read_json(card)["pid"] == os.getpid() and is_alive(read_json(card))
    assert [run["pid"] for run in other_runs(tmp_path)] == [2**22 + 1]
    withdraw_card(card)
    (tmp_path / live_runs.LOCKS_FOLDER / "0.input.lock").unlink()
    card = register_run(tmp_path, "snakemake -j1")
    assert other_runs(tmp_path) == []
    withdraw_card(card)
    assert list((tmp_path / live_runs.CARDS_FOLDER).iterdir()) == []
