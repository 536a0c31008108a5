"""Runs that are killed at random moments: the same command again finishes them, with the same bytes."""

import json
import subprocess
import sys
import time
from types import SimpleNamespace

import chaos
import pytest
from conftest import ask_starter


class Run:
    """A run in a session of its own as `subprocess.Popen` gives it, forked by the starter."""

    def __init__(self, command, cwd, env, stdout, stderr, start_new_session):
        assert command[:3] == [sys.executable, "-m", "snakemake"] and start_new_session
        self.pid = ask_starter(
            {
                "own session": True,
                "folder": str(cwd),
                "environment": env,
                "arguments": command[3:],
                "printed": stdout.name,
            }
        )
        self._code = None

    def poll(self):
        """Exit code, or None while the run goes on."""
        if self._code is None:
            self._code = ask_starter({"ended": self.pid})
        return self._code

    def wait(self, timeout=float("inf")):
        """Wait for the end; returns the exit code."""
        until = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > until:
                raise subprocess.TimeoutExpired("snakemake", timeout)
            time.sleep(0.02)
        return self._code


@pytest.mark.workflow
def test_five_kills_leave_no_trace(tmp_path, monkeypatch):
    # `python benchmarks/chaos.py` does 100 over all stages
    monkeypatch.chdir(tmp_path)
    used = {name: getattr(subprocess, name) for name in ("STDOUT", "TimeoutExpired")}
    monkeypatch.setattr(chaos, "subprocess", SimpleNamespace(Popen=Run, **used))
    arguments = ["--kills", "5", "--flights", "1", "--targets", "flight", "--folder", str(tmp_path / "chaos")]
    assert chaos.main(arguments) == 0
    found = json.loads((tmp_path / "results/benchmarks/chaos.json").read_text())
    assert found["kills"] == 5 and found["by SIGTERM"] == 2 and found["artifacts"] >= 4
