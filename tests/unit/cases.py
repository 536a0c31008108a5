"""Small inputs that once failed: where they lie, and the mark of tests that need them."""

import gzip
import os
from pathlib import Path

import pytest

CASES = Path(os.environ.get("QUASI_SHARED_CASES", Path(__file__).parents[3] / "shared" / "cases"))
needs_cases = pytest.mark.skipif(
    not CASES.is_dir(), reason=f"small inputs are not at {CASES}; set QUASI_SHARED_CASES to the folder that holds them"
)


def case_file(name, folder):
    """Path of a case; a packed one is unpacked into `folder`."""
    source = CASES / name
    if source.suffix != ".gz":
        return source
    target = folder / source.stem
    target.write_bytes(gzip.decompress(source.read_bytes()))
    return target


def flight_of(path, controller="betaflight"):
    return {"flight": "f", "quadrotor": "Q", "flight controller": controller, "onboard": str(path)}
