"""What a job tells when it fails: one sentence, with the traceback in its log."""

import errno
import sys

import pytest

from quasi.command import main
from quasi.errors import ReadError
from quasi.running import job_log as joblog
from quasi.running.job_log import LOG, RUN_VARIABLE, job, read_reports, show_progress


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (ReadError("a.bbl is empty; copy it again"), "a.bbl is empty; copy it again"),
        (OSError(errno.ENOSPC, "No space left on device", "a.part"), "No space left on device (a.part); free space"),
        (MemoryError(), "ran out of memory; free some"),
        (SystemExit(0), "was ended from within (SystemExit: 0); the traceback is in"),
        (KeyError("x"), "failed unexpectedly (KeyError: 'x'); the traceback is in"),
    ],
)
def test_every_failure_of_a_job_is_told_in_one_sentence(tmp_path, monkeypatch, fault, words):
    monkeypatch.setenv(RUN_VARIABLE, str(tmp_path / "run"))
    with pytest.raises(SystemExit), job(tmp_path / "logs/a.log", "import of a"):
        raise fault
    (sentence,) = read_reports(tmp_path / "run", "errors")
    assert words in sentence
    assert "\n" not in sentence
    assert (tmp_path / "logs/a.log").read_text()


def test_init_where_no_folder_can_be_is_a_sentence(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["init", str(tmp_path / "file" / "lab")]) == 1
    assert "[ERROR]" in capsys.readouterr().err


def test_progress_of_a_job_goes_to_its_log_alone_in_plain_lines(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(joblog, "PROGRESS_INTERVAL", 0.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)  # a job's terminal is that of the whole run
    with job(tmp_path / "a.log", "filtering of a"):
        assert list(show_progress(range(4), "filtering samples")) == [0, 1, 2, 3]
        assert list(show_progress(iter("ab"), "reading")) == ["a", "b"]
    lines = (tmp_path / "a.log").read_text().splitlines()
    assert any("filtering samples: 3 of 4 (75 %) in" in line for line in lines)
    assert any("reading: 1 in" in line for line in lines)
    assert "\r" not in "".join(lines) and capsys.readouterr().err == ""


def test_a_quick_job_says_nothing_of_its_progress(tmp_path):
    with job(tmp_path / "a.log", "filtering of a"):
        list(show_progress(range(1000), "filtering samples"))
    assert "filtering samples" not in (tmp_path / "a.log").read_text()


def test_progress_on_a_terminal_is_a_bar_and_elsewhere_nothing(capsys, monkeypatch):
    assert LOG.handlers == []
    assert list(show_progress(range(3), "filtering samples")) == [0, 1, 2] and capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(show_progress(range(3), "filtering samples", mininterval=0.0)) == [0, 1, 2]
    assert "filtering samples" in capsys.readouterr().err
