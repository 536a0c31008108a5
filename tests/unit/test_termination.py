"""A run that gets SIGTERM ends, whatever lock its main thread holds, and with it the processes of its jobs."""

import subprocess
import sys
import textwrap

from snakemake.scheduling.job_scheduler import JobScheduler

from quasi.running.termination import Termination, replace_handler

# a scheduler with the locks of Snakemake 9; the signal arrives while the main thread holds one
PROGRAM = """
    import os, signal, subprocess, sys, threading

    class Scheduler:
        def __init__(self):
            self._lock, self._open_jobs, self._user_kill = threading.Lock(), threading.Semaphore(0), None
            signal.signal(signal.SIGTERM, self.exit_gracefully)

        def exit_gracefully(self, *arguments):
            with self._lock:
                self._user_kill = "graceful"
            self._open_jobs.release()

    from quasi.running.termination import replace_handler
    replace_handler(Scheduler)
    scheduler = Scheduler()
    job = subprocess.Popen(["sleep", "600"])
    with scheduler._lock:
        os.kill(os.getpid(), signal.SIGTERM)
    scheduler._open_jobs.acquire()
    print(scheduler._user_kill, job.wait() == -signal.SIGTERM)
"""


def test_sigterm_while_the_main_thread_holds_the_lock():
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(PROGRAM)], capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["graceful", "True"], done.stderr


def test_snakemake_still_installs_the_handler_that_is_replaced(monkeypatch):
    assert "exit_gracefully" in JobScheduler.__init__.__code__.co_names
    monkeypatch.setattr(JobScheduler, "exit_gracefully", JobScheduler.exit_gracefully)
    replace_handler(JobScheduler)
    handler = object.__new__(JobScheduler).exit_gracefully
    assert isinstance(handler.__self__, Termination)
