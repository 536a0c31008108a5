"""The script of a rule is looked up once per run.

Before a run, Snakemake 9 checks for every job that the script of its rule can be read: it parses the address, searches
its cache and opens the file, three times a job. With a thousand flights that is a tenth of a dry run.
"""

from typing import Any


def check_each_once(processors: type) -> None:
    """Let a class of Snakemake (`ScriptProcessor`) check the script of each rule with the rule's first job.

    Only right for scripts whose path holds no wildcard, as those of `rules/`.
    """
    original = processors.process_job  # type: ignore[attr-defined]

    def process_job(self: Any, job: Any) -> None:
        checked = self.__dict__.setdefault("_checked_rules", set())
        if job.rule not in checked:
            original(self, job)  # raises where the script cannot be read
            checked.add(job.rule)

    processors.process_job = process_job  # type: ignore[attr-defined]
