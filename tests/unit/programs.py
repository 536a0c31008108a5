"""The programs of scripts/, which are no package: each is loaded by its name."""

import importlib.util
from pathlib import Path


def script(name):
    """The module scripts/<name>.py."""
    found = importlib.util.spec_from_file_location(name, Path(__file__).parents[2] / f"scripts/{name}.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module
