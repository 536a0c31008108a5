"""Runs that are killed at random moments: the same command again finishes them, with the same bytes."""

import chaos
import pytest


@pytest.mark.workflow
def test_five_kills_leave_no_trace(tmp_path, monkeypatch):
    # `python benchmarks/chaos.py` does 100 over all stages
    monkeypatch.chdir(tmp_path)
    arguments = ["--kills", "5", "--flights", "1", "--targets", "flight", "--folder", str(tmp_path / "chaos")]
    assert chaos.main(arguments) == 0
    found = chaos.json.loads((tmp_path / "results/benchmarks/chaos.json").read_text())
    assert found["kills"] == 5 and found["by SIGTERM"] == 2 and found["artifacts"] >= 4
