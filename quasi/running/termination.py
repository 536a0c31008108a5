"""End of a run on SIGTERM.

The handler of Snakemake 9 takes a lock of its scheduler inside the signal handler. The signal can interrupt the main
thread while that thread holds the lock; then the run waits for itself forever. Here the handler writes one byte to a
pipe. A thread reads it, calls Snakemake's handler outside the main thread, and ends the processes of the running jobs.
docs/snakemake-sigterm.patch has the same for Snakemake itself.
"""

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import psutil

KILL_DELAY = 5.0  # s between SIGTERM and SIGKILL for a job that does not end; a job needs less to close its files
POLL_INTERVAL = 0.2  # s between two searches for processes of jobs; a job that was just starting is found by the next


class Termination:
    """Ends a run in a thread of its own.

    request_stop  called once in that thread; it must make the main thread end as soon as no job is running
    """

    def __init__(self, request_stop: Callable[[], Any]):
        self.request_stop = request_stop
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        threading.Thread(target=self._wait, name="termination", daemon=True).start()

    def handle(self, *_: Any) -> None:
        """Handle the signal: one system call, no lock."""
        with suppress(BlockingIOError):  # the pipe is full of earlier signals
            os.write(self._writer, b"\0")

    def _wait(self) -> None:
        os.read(self._reader, 1)
        threading.Thread(target=self.request_stop, name="stop request", daemon=True).start()
        began = time.monotonic()
        while True:  # until the process ends; daemon threads end with it
            end_children(force=time.monotonic() - began > KILL_DELAY)
            time.sleep(POLL_INTERVAL)


def end_children(force: bool = False) -> None:
    """Send SIGTERM to all descendants of this process, or SIGKILL."""
    for process in psutil.Process().children(recursive=True):
        try:
            process.kill() if force else process.terminate()
        except psutil.Error:
            continue  # it ended meanwhile


def replace_handler(scheduler: type) -> None:
    """Replace the handler of a scheduler class (`exit_gracefully`), which it installs when it is created."""
    original = scheduler.exit_gracefully  # type: ignore[attr-defined]
    # the scheduler reads the attribute once, for signal.signal
    scheduler.exit_gracefully = property(  # type: ignore[attr-defined]
        lambda self: Termination(lambda: original(self)).handle
    )
