"""Tests run on two cores: whole files stay together, and so do all that share what is made once for them."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # many small matrices: more threads would only wait

import pytest

OF_HEALTHY = {"test_hide_and_seek.py", "test_plan_lab.py"}  # share made flights; the others of the workflow a project


def pytest_collection_modifyitems(items):
    # the two longest groups first, side by side: at the end only short files are left for either core
    items.sort(key=lambda item: item.path.parent.name != "workflow")
    for item in items:
        group = item.path.stem
        if item.path.parent.name == "workflow":
            group = "healthy flights" if item.path.name in OF_HEALTHY else "workflow"
        item.add_marker(pytest.mark.xdist_group(group))
