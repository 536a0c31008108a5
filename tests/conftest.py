"""Tests run on two cores: whole files stay together, and so do all that share the workflow's made project."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # many small matrices: more threads would only wait

import pytest

OWN_PROJECT = {"test_hide_and_seek.py"}  # makes what it needs itself


def pytest_collection_modifyitems(items):
    # the two longest groups first, side by side: at the end only short files are left for either core
    items.sort(key=lambda item: item.path.parent.name != "workflow")
    for item in items:
        shared = item.path.parent.name == "workflow" and item.path.name not in OWN_PROJECT
        item.add_marker(pytest.mark.xdist_group("workflow" if shared else item.path.stem))
