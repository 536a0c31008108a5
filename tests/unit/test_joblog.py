"""What a job tells when it fails: one sentence, with the traceback in its log."""

import errno

import pytest

from quasi.command import main
from quasi.errors import ReadError
from quasi.joblog import RUN, job, told


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (ReadError("a.bbl is empty; copy it again"), "a.bbl is empty; copy it again"),
        (OSError(errno.ENOSPC, "No space left on device", "a.part"), "No space left on device (a.part); free space"),
        (MemoryError(), "ran out of memory; free some"),
        (KeyError("x"), "failed unexpectedly (KeyError: 'x'); the traceback is in"),
    ],
)
def test_every_failure_of_a_job_is_told_in_one_sentence(tmp_path, monkeypatch, fault, words):
    monkeypatch.setenv(RUN, str(tmp_path / "run"))
    with pytest.raises(SystemExit), job(tmp_path / "logs/a.log", "import of a"):
        raise fault
    (sentence,) = told(tmp_path / "run", "errors")
    assert words in sentence
    assert "\n" not in sentence
    assert (tmp_path / "logs/a.log").read_text()


def test_init_where_no_folder_can_be_is_a_sentence(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["init", str(tmp_path / "file" / "lab")]) == 1
    assert "[ERROR]" in capsys.readouterr().err
