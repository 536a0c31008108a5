"""Tests run on two cores: whole files stay together, and so do the two that share what is made once for them."""

import os
from pathlib import Path

# before NumPy is imported: many small matrices, of which more threads would only wait, and use the other core for that
os.environ.setdefault("OMP_NUM_THREADS", "1")
# in compiling, Numba raises thousands of errors that nobody reads: colours of their texts take 5 % of the time
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")

import gc

import pytest

# compilers keep hundreds of thousands of objects, which a collection after every 700 new ones passes through again
gc.set_threshold(100_000, 20, 100)

OF_HEALTHY = {"test_hide_and_seek.py", "test_plan_lab.py"}  # share made flights
SIMULATOR = "test_controlled_flight.py"


def rank(path):
    """Long files first, so that only short ones are left for either core at the end; and as each kernel is compiled
    once: one core those of import and filter, the other meanwhile those of the simulator. Then both run the workflow,
    whose parallel jobs would compile all of them several times."""
    if path.name in OF_HEALTHY:
        return 0
    if path.name == SIMULATOR:
        return 1
    return 2 if path.parent.name == "workflow" else 3


def pytest_configure(config):
    config.addinivalue_line("filterwarnings", "ignore::numba.core.errors.NumbaPerformanceWarning")


class Backwards(pytest.Dir):
    """A folder whose files are collected from the last to the first."""

    def collect(self):
        return list(super().collect())[::-1]


def pytest_collect_directory(path, parent):
    """The second core collects backwards: each rewrites the assertions of one half of the files, and loads the
    bytecode of the other. In the same order, both would rewrite all of them."""
    if os.environ.get("PYTEST_XDIST_WORKER") == "gw1":
        return Backwards.from_parent(parent, path=path)
    return None


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: (rank(item.path), item.path))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Groups by file, not by marks: those of `--dist loadgroup` do not reach xdist 3.8 from pytest 9.2."""
    from xdist.scheduler import LoadScopeScheduling

    class Together(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            path = Path(nodeid.split("::", 1)[0])
            return "healthy flights" if path.name in OF_HEALTHY else path.stem

    return Together(config, log)
