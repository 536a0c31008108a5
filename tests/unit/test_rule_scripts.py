"""The script of a rule is looked up once per run, and a script that is absent still stops the run."""

import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from quasi.running.rule_scripts import check_each_once


class Processor:
    """Stands for Snakemake's: notes the rules whose scripts it looked up."""

    def __init__(self, absent=()):
        self.looked_up, self.absent = [], absent

    def process_job(self, job):
        self.looked_up.append(job.rule)
        if job.rule in self.absent:
            raise FileNotFoundError(job.rule)


check_each_once(Processor)


def jobs(*rules):
    return [SimpleNamespace(rule=rule) for rule in rules]


def test_each_rule_is_looked_up_once_per_run():
    first, second = Processor(), Processor()
    for job in jobs("importing", "filtering", "importing", "filtering"):
        first.process_job(job)
    second.process_job(*jobs("importing"))
    assert first.looked_up == ["importing", "filtering"] and second.looked_up == ["importing"]


def test_an_absent_script_stops_every_run():
    processor = Processor(absent=("importing",))
    for job in jobs("importing", "importing"):
        with pytest.raises(FileNotFoundError):
            processor.process_job(job)


def test_no_script_of_the_rules_depends_on_a_wildcard():
    rules = (Path(__file__).parents[2] / "rules").glob("*.smk")
    scripts = [s for path in rules for s in re.findall(r'script:\s+"([^"]+)"', path.read_text())]
    assert scripts and not any("{" in script for script in scripts)
