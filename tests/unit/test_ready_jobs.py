"""The scheduler weighs a few of the ready jobs, those of highest priority among them."""

import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from snakemake.scheduling.job_scheduler import JobScheduler

from quasi.running.ready_jobs import SPARE, keep_one_timer, weigh_few

ROOT = Path(__file__).resolve().parents[2]


class Scheduler:
    """A scheduler that selects all jobs that it is given."""

    def __init__(self, cores: int, nodes: int):
        self.resources = {"_cores": cores, "_nodes": nodes}

    def job_selector(self, jobs):
        return list(jobs)


weigh_few(Scheduler)


def test_snakemake_still_selects_by_the_method_that_is_replaced():
    assert "job_selector" in JobScheduler.schedule.__code__.co_names


def test_a_run_replaces_the_methods(tmp_path):
    program = """import sys
from snakemake.cli import main
from snakemake.dag import ScriptProcessor
from snakemake.scheduling.job_scheduler import JobScheduler
try:
    main(sys.argv[1:])
except SystemExit:
    pass
print(JobScheduler.job_selector.__module__, JobScheduler._schedule_reevalutation.__module__)
print(ScriptProcessor.process_job.__module__)
"""
    asked = ["-s", str(ROOT / "Snakefile"), "-d", str(tmp_path), "--dry-run", "models/none/standalone"]
    done = subprocess.run([sys.executable, "-c", program, *asked], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-3:] == ["quasi.running.ready_jobs"] * 2 + ["quasi.running.rule_scripts"]


@pytest.mark.parametrize(("cores", "nodes"), [(2, sys.maxsize), (sys.maxsize, 300), (0, sys.maxsize)])
def test_as_many_jobs_as_can_start_are_weighed_and_the_first_are_never_left_out(cores, nodes):
    jobs = [SimpleNamespace(priority=i % 7) for i in range(1000)]
    chosen = Scheduler(cores, nodes).job_selector(jobs)
    assert len(chosen) == min(cores, nodes) + SPARE
    left = [job for job in jobs if job not in chosen]
    assert min(job.priority for job in chosen) >= max(job.priority for job in left)


def test_few_jobs_are_all_weighed():
    few = [SimpleNamespace(priority=0), SimpleNamespace(priority=100)]
    assert sorted(job.priority for job in Scheduler(2, sys.maxsize).job_selector(few)) == [0, 100]


class Clock:
    """Snakemake's semaphore: counts how often a selection was asked for."""

    def __init__(self):
        self.released = 0

    def release(self):
        self.released += 1


class Timed:
    def __init__(self):
        self._open_jobs = Clock()


keep_one_timer(Timed)


def test_snakemake_still_starts_its_timers_by_the_method_that_is_replaced():
    assert "_schedule_reevalutation" in JobScheduler.schedule.__code__.co_names


def test_many_ended_jobs_ask_for_one_selection_and_each_selection_for_the_next():
    timed = Timed()
    for _ in range(100):
        timed._schedule_reevalutation(0.02)
    timed._schedule_reevalutation(0.03)  # for another reason
    wait_until(lambda: timed._open_jobs.released == 2)
    timed._schedule_reevalutation(0.02)
    wait_until(lambda: timed._open_jobs.released == 3)
    time.sleep(0.1)
    assert timed._open_jobs.released == 3


def wait_until(holds):
    end = time.monotonic() + 10
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.005)
