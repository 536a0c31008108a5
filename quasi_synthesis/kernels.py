"""The kernels that make a flight, compiled ahead of the jobs (`quasi.running.job_server`)."""

import numpy as np

from quasi_synthesis import blackbox_writer as blackbox
from quasi_synthesis import campaign as campaign  # its jobs begin with this import
from quasi_synthesis import vehicle as made
from quasi_synthesis.controller import control_of
from quasi_synthesis.flight import LOGGED_SIGNALS, TRUTH, fly
from quasi_synthesis.nuisance import nominal

LOOP_STEPS, STEPS_EACH_ROW = 8, 4  # steps of the loop, and from one row of the log to the next


def compile_kernels() -> None:
    """Call every kernel with the argument types of a real flight; compiled ones are loaded from the cache."""
    setup = nominal(120.0, 1.0)
    rows = LOOP_STEPS // STEPS_EACH_ROW
    fly(
        LOOP_STEPS,
        STEPS_EACH_ROW,
        np.zeros((2, 16)),
        np.zeros((2, 7)),
        np.zeros((LOOP_STEPS, 9)),
        setup.vehicle.physics,
        setup.vehicle.drive,
        control_of(made.base_vehicle()),
        setup.inertial,
        setup.telemetry,
        np.empty((rows, len(TRUTH))),
        np.empty((rows, len(LOGGED_SIGNALS))),
    )
    values = np.zeros((rows, len(blackbox.FIELD_NAMES)), np.int64)
    blackbox.encode_log(values, [], {}, whole_every=STEPS_EACH_ROW, step=STEPS_EACH_ROW, reference=0)
