"""The kernels that import a flight, compiled ahead of the jobs (`quasi.running.job_server`)."""

import numpy as np

from quasi.importing.artefacts import flyable
from quasi.importing.onboard_attitude import estimate_attitude
from quasi.importing.readers.blackbox import decode
from quasi.importing.readers.blackbox_header import MARKER, find_logs

IMPORTED_SAMPLES, STEP = 100, 0.01  # samples and s between two
# a log without frames
_LOG = (
    MARKER
    + b"""
H Data version:2
H I interval:1
H P interval:1/1
H Field I name:loopIteration,time
H Field I signed:0,0
H Field I predictor:0,0
H Field I encoding:1,1
H Field P predictor:6,2
H Field P encoding:9,0
"""
)


def compile_kernels() -> None:
    """Call every kernel with the argument types of a real flight; compiled ones are loaded from the cache."""
    decode(_LOG, find_logs(_LOG, "")[0])
    t, vectors = STEP * np.arange(IMPORTED_SAMPLES), np.zeros((IMPORTED_SAMPLES, 3))
    estimate_attitude(t, vectors, vectors - [0.0, 0.0, 9.8])
    swapped = vectors.copy()
    swapped[IMPORTED_SAMPLES // 2] = 100.0  # m, a jump that no vehicle flies
    flyable(t, swapped, np.tile([1.0, 0.0, 0.0, 0.0], (IMPORTED_SAMPLES, 1)))
