"""What a run prints: a line per job with its notes, every failure whole; what it does not know is not held back."""

import io
import logging

import pytest

from quasi.errors import ReadError
from quasi.running.job_log import LOG, RUN_VARIABLE, job, log_verdict
from quasi.running.terminal import FaultFilter, Terminal, format_command, list_up_to_date_pages


@pytest.fixture
def run(tmp_path, monkeypatch):
    """(terminal, its stream, say(event, text, **about): True where Snakemake's own message is printed)."""
    monkeypatch.setenv(RUN_VARIABLE, str(tmp_path / "run"))
    monkeypatch.chdir(tmp_path)
    stream = io.StringIO()
    terminal = Terminal(str(tmp_path / "run"), stream)

    def say(event, text="", **about):
        record = logging.makeLogRecord({"msg": text, **({"event": event} if event else {}), **about})
        return terminal.filter(record)

    return terminal, stream, say


def begin(say, number, flight, rule="importing"):
    log = f"logs/{rule}/Q/{flight}.log"
    wildcards = {"quadrotor": "Q", "flight": flight}
    assert not say("job_info", jobid=number, rule_name=rule, log=[log], wildcards=wildcards)
    return log


@pytest.mark.parametrize("error", [BrokenPipeError(), OSError(5, "Input/output error"), ValueError("closed file")])
def test_a_run_goes_on_where_nobody_reads_what_it_prints(run, monkeypatch, error):
    terminal, stream, say = run

    def write(text):
        raise error

    monkeypatch.setattr(stream, "write", write)
    assert not say("run_info", stats={"importing": 1, "total": 1})
    begin(say, 1, "a")
    assert not say("job_finished", job_id=1)
    assert terminal.done == 1


def test_a_job_is_a_line_and_a_note_that_flights_have_alike_is_told_once(run):
    terminal, stream, say = run
    assert not say("run_info", "Job stats: ...", stats={"importing": 2, "total": 2})
    for number, flight in enumerate(("a", "b"), 1):
        with job(begin(say, number, flight), f"import of {flight}"):
            LOG.warning("%s", f"logs/{flight}.bbl: vibration near {40 + number} Hz")
        assert not say("job_finished", job_id=number)
        assert not say("progress", done=number, total=2)
    lines = stream.getvalue().splitlines()
    assert lines[0] == "2 jobs: importing 2"
    assert lines[1].startswith("[1/2] import of a: 0.") and lines[1].endswith(" s, 1 note, logs/importing/Q/a.log")
    assert lines[2] == "    - logs/a.bbl: vibration near 41 Hz"
    assert lines[3].endswith("1 note (shown above), logs/importing/Q/b.log") and len(lines) == 4
    assert "`snakemake results/reports/Q/a.html`" in terminal.summary()


@pytest.mark.parametrize(
    ("asked", "command"),
    [
        ("-j2 models/m/standalone", "snakemake processing"),
        ("-s ../q/Snakefile -d lab -j2 models/m/standalone", "snakemake -s ../q/Snakefile -d lab processing"),
        ("--directory=lab -j2 -C data=/mnt/a b=1 -- all", "snakemake -d lab --config data=/mnt/a b=1 -- processing"),
        ("-j2 all --config data=/mnt", "snakemake --config data=/mnt -- processing"),
        ("--configfile own.yaml --cores 2 -d", "snakemake processing"),
    ],
)
def test_the_command_for_another_target_names_the_same_folder_and_data(asked, command):
    assert format_command(asked.split(), "processing") == command


def test_the_hint_at_the_end_of_a_run_can_be_run_as_it_stands(run):
    terminal, _, say = run
    terminal.asked = ["-d", "lab", "-j2", "--config", "data=/mnt", "--", "models/m/standalone"]
    with job(begin(say, 1, "a"), "import of a"):
        LOG.warning("%s", "vibration")
    say("job_finished", job_id=1)
    assert "`snakemake -d lab --config data=/mnt -- results/reports/Q/a.html`" in terminal.summary()
    assert terminal.summary().endswith("`snakemake -d lab --config data=/mnt -- processing`")


def test_many_notes_are_counted_and_those_not_told_come_with_a_later_job(run):
    _, stream, say = run
    for number, flight in enumerate(("a", "b"), 1):
        with job(begin(say, number, flight), f"import of {flight}"):
            for letter in "tuvwxyz":
                LOG.warning("%s", f"note {letter}")
        say("job_finished", job_id=number)
    text = stream.getvalue()
    assert "    - and 2 more in logs/importing/Q/a.log" in text
    assert "7 notes (5 shown above)" in text
    assert all(text.count(f"    - note {letter}\n") == 1 for letter in "tuvwxyz")


def test_many_notes_of_a_model_are_left_to_its_page_and_counted(run):
    _, stream, say = run
    with job(begin(say, 1, "Fz", "identification"), "identification of Fz"):
        for letter in "xyz":
            LOG.warning("%s", f"note {letter}")
    say("job_finished", job_id=1)
    assert stream.getvalue().endswith(" s, 3 notes, logs/identification/Q/Fz.log\n")


def test_a_doubtful_verdict_stands_in_every_flights_own_line(run):
    _, stream, say = run
    for number, flight in enumerate(("a", "b"), 1):
        with job(begin(say, number, flight), f"import of {flight}"):
            log_verdict("unusable", f"only {number}.0 s are common to all sources")
        say("job_finished", job_id=number)
    assert stream.getvalue().count("unusable (only ") == 2


def test_a_failure_is_told_at_once_in_its_own_sentence_and_once(run):
    terminal, stream, say = run
    log = begin(say, 1, "a")
    with pytest.raises(SystemExit), job(log, "import of a"):
        raise ReadError("a.bbl is empty; copy it again")
    assert not say("error", "RuleException:\nCalledProcessError in file ...")
    assert not say("job_error", jobid=1, log=[log]) and not say("job_error", jobid=1, log=[log])
    assert stream.getvalue().count("a.bbl is empty; copy it again") == 1
    assert stream.getvalue().startswith("[FAILED] import of a after 0.")
    assert terminal.summary() == "" and "RuleException" not in stream.getvalue()


def test_an_unfinished_batch_ends_with_its_counts(run):
    terminal, _, say = run
    say("run_info", stats={"importing": 9, "total": 9})
    for number, flight in enumerate("abcd", 1):
        log = begin(say, number, flight)
        if number < 4:
            with job(log, f"import of {flight}"):
                pass
            say("job_finished", job_id=number)
        else:  # it was killed
            say("job_error", jobid=number, log=[log])
    assert terminal.summary() == "3 jobs finished, 1 failed, 5 not tried"


def test_a_job_that_was_killed_keeps_snakemakes_whole_account(run):
    _, stream, say = run
    log = begin(say, 1, "a")
    say("error", "RuleException:\nCalledProcessError in file x, died with <Signals.SIGKILL: 9>")
    assert say("job_error", jobid=1, log=[log])
    assert "SIGKILL" in stream.getvalue()


def test_an_outcome_that_a_full_disk_cut_off_is_none(run, tmp_path):
    terminal, stream, say = run
    with job(begin(say, 1, "a"), "import of a"):
        pass
    (outcome,) = (tmp_path / "run/outcomes").glob("*.json")
    outcome.write_text(outcome.read_text()[:20])
    assert not say("job_finished", job_id=1)
    assert stream.getvalue() == "[1/?] importing Q, a\n"


def test_a_job_that_left_nothing_is_still_told(run):
    _, stream, say = run
    begin(say, 1, "a")
    say("job_finished", job_id=1)
    assert stream.getvalue() == "[1/?] importing Q, a\n"


@pytest.mark.parametrize(
    ("event", "text"),
    [(None, "Nothing to be done"), (None, "Error: lock"), ("error", "MissingRuleException: x"), ("to_come", "new")],
)
def test_what_is_not_known_passes(run, event, text):
    assert run[2](event, text)


@pytest.mark.parametrize("text", ["Select jobs to execute...", "Execute 2 jobs...", "Using shell: /bin/bash"])
def test_snakemakes_housekeeping_does_not(run, text):
    assert not run[2](None, text)


def test_where_nothing_was_to_be_done_the_page_that_stands_is_named(run, tmp_path):
    terminal, _, say = run
    assert not terminal.idle
    assert say(None, "Nothing to be done (all requested files are present and up to date).")
    assert terminal.idle
    page = tmp_path / "models/a/standalone/report.html"
    page.parent.mkdir(parents=True)
    page.touch()
    assert list_up_to_date_pages(["-j2", "models/a/standalone/", "models/b/standalone"], tmp_path) == (
        "Up to date; start with models/a/standalone/report.html"
    )
    assert list_up_to_date_pages(["-j2", "models/b/standalone"], tmp_path) == ""
    assert list_up_to_date_pages(["models/a/standalone"], tmp_path.parent) == ""


@pytest.fixture
def fault_filter():
    return FaultFilter([], lambda: ["models/small/standalone", "processing"], lambda: "locked by process 1")


def test_a_target_that_no_rule_makes_is_answered_with_the_nearest(fault_filter):
    said = (
        "MissingRuleException:\nNo rule to produce models/small (if you use input functions make sure that they ...)."
    )
    assert not fault_filter.filter(logging.makeLogRecord({"msg": said, "event": "error"}))
    assert fault_filter.faults[0].startswith("no rule makes 'models/small' (did you mean 'models/small/standalone'?);")
    assert fault_filter.filter(logging.makeLogRecord({"msg": "Building DAG of jobs..."}))
    assert len(fault_filter.faults) == 1


def test_a_locked_folder_is_explained_in_our_words_alone(fault_filter):
    said = "LockException:\nError: Directory cannot be locked. ... It can be removed with the --unlock argument."
    assert not fault_filter.filter(logging.makeLogRecord({"msg": said, "event": "error"}))
    assert fault_filter.faults == ["locked by process 1"]


def test_a_known_fault_of_the_configuration_is_not_printed_with_a_traceback_first(fault_filter):
    fault_filter.faults.append("config/a.json: unknown key 'b'")
    said = "InputFunctionException in rule a:\nWorkflowError:\n    config/a.json: unknown key 'b'\nTraceback:\n  File"
    assert not fault_filter.filter(logging.makeLogRecord({"msg": said, "event": "error"}))
    assert fault_filter.filter(logging.makeLogRecord({"msg": said.replace("'b'", "'c'"), "event": "error"}))
