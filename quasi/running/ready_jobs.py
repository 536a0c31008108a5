"""How often Snakemake's scheduler selects from the ready jobs, and among how many.

Snakemake 9 selects whenever a job ends: it looks up the inputs of every job that is ready, and weighs them all. Each
selection also starts a timer for another one a second later, and that one starts the next: after a hundred jobs it
selects a hundred times a second. With a thousand flights its process then works longer than those of the flights. Here
one timer runs at a time, and a selection gets the jobs of highest priority: as many as can start, and some to choose
from. Its own `--scheduler-subsample` draws by chance, whatever the priorities. docs/snakemake-reevaluation.patch has
one timer for Snakemake itself.
"""

import heapq
import threading
from collections.abc import Iterable
from typing import Any

SPARE = 50  # jobs to choose from: those whose resources other jobs hold must not leave a core idle


def weigh_few(scheduler: type) -> None:
    """Replace the method of a scheduler class that selects from the ready jobs (`job_selector`)."""
    original = scheduler.job_selector  # type: ignore[attr-defined]

    def job_selector(self: Any, jobs: Iterable[Any]) -> Any:
        free = min(self.resources["_cores"], self.resources["_nodes"])
        return original(self, heapq.nlargest(free + SPARE, jobs, key=lambda job: job.priority))

    scheduler.job_selector = job_selector  # type: ignore[attr-defined]


def keep_one_timer(scheduler: type) -> None:
    """Replace the method of a scheduler class that starts a timer for a selection (`_schedule_reevalutation`)."""

    def schedule(self: Any, delay: float) -> None:
        waiting = self.__dict__.setdefault("_delays_waiting", set())
        if delay in waiting:
            return

        def fire() -> None:
            waiting.discard(delay)  # before the selection, which starts the next timer
            self._open_jobs.release()

        waiting.add(delay)
        timer = threading.Timer(delay, fire)
        timer.daemon = True  # a finished run does not wait for it
        timer.start()

    scheduler._schedule_reevalutation = schedule  # type: ignore[attr-defined]
