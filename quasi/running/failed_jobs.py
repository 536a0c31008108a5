"""Outputs of failed jobs that are kept: they stay marked as incomplete, so that the next run makes them anew."""

from contextlib import suppress
from functools import wraps
from typing import Any


def mark_incomplete(jobs: type) -> None:
    """Let a class of Snakemake (`Job`) mark what a failed job left with `--keep-incomplete`.

    Snakemake records a failed job like a finished one and then removes its outputs. With that option it keeps them, and
    the next run takes half a folder of figures for a whole one.
    """
    original = jobs.postprocess  # type: ignore[attr-defined]

    @wraps(original)
    async def postprocess(self: Any, *args: Any, error: bool = False, **options: Any) -> None:
        await original(self, *args, error=error, **options)
        if error and self.dag.workflow.execution_settings.keep_incomplete:
            with suppress(OSError):  # a full disk, of which the job's own sentence speaks
                self.dag.workflow.persistence.started(self)

    jobs.postprocess = postprocess  # type: ignore[attr-defined]
