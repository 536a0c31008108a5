"""Where the real blackbox logs lie, and the mark of tests that need them."""

import os
from pathlib import Path

import pytest

SHARED = Path(os.environ.get("QUASI_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data")) / "blackbox"
needs_real = pytest.mark.skipif(
    not SHARED.is_dir(),
    reason=f"real recordings are not at {SHARED}; set QUASI_SHARED_DATA to the folder that holds them",
)
