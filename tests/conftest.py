"""Tests run on two cores: whole files stay together, and so do all that share what is made once for them."""

import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # many small matrices: more threads would only wait

import pytest

OF_HEALTHY = {"test_hide_and_seek.py", "test_plan_lab.py"}  # share made flights; the others of the workflow a project


def pytest_collection_modifyitems(items):
    # the two longest groups first, side by side: at the end only short files are left for either core
    items.sort(key=lambda item: item.path.parent.name != "workflow")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Groups by file, not by marks: those of `--dist loadgroup` do not reach xdist 3.8 from pytest 9.2."""
    from xdist.scheduler import LoadScopeScheduling

    class Together(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            path = Path(nodeid.split("::", 1)[0])
            if path.parent.name != "workflow":
                return path.stem
            return "healthy flights" if path.name in OF_HEALTHY else "workflow"

    return Together(config, log)
