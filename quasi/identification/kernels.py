"""The kernel of the rotors' lag, compiled ahead of the jobs (`quasi.running.job_server`)."""

import numpy as np

from quasi.identification import shared as shared  # its jobs begin with this import
from quasi.identification.lag_fit import NO_SLOPES, follow


def compile_kernels() -> None:
    """Call the kernel with the argument types of a real flight; a compiled one is loaded from the cache."""
    speed = np.ones(3)
    follow(speed, speed, np.zeros(3, bool), 1.0, 0.01, 0.05, 0.05, np.empty(3), NO_SLOPES, NO_SLOPES)
