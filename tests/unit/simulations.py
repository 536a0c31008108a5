"""Set-ups of simulations of the made model."""

import pandas as pd

from quasi.simulation.loop.setup import make_setup
from quasi.simulation.vehicle.dynamics import compute_loads, equations_of_motion


def setup_of(model, duration=2.0, step=0.004, **sections):
    simulation = {"time step": step, "duration": duration, **sections.pop("simulation", {})}
    return make_setup({"model": {"model ID": "made"}, "simulation": simulation, **sections}, model)


ROUGH = {
    "references": {"kind": "figure eight", "start": 0.2, "amplitude": 2.0},
    "wind": {"gusts": [0.5, 0.5, 0.2], "steady": [1, 0, 0]},
    "actuator": {"delay": 0.006},
    "battery": {"voltage": 16.0, "drain": 0.1, "sag": 0.5, "exponent": 0.5},
    "faults": {"inject failure": True, "time of failure": 0.6, "rotor effectiveness after failure": [1, 0.8, 1, 1]},
}


def assert_same(a, b):
    assert a.status == b.status and a.steps == b.steps and a.stopped == b.stopped
    pd.testing.assert_frame_equal(a.table, b.table, rtol=1e-12, atol=1e-12)


def state_derivative(x, step_inputs, kernel, body, inputs, work, loads, derivatives):
    compute_loads(x, step_inputs, kernel, body, inputs, work, loads)
    equations_of_motion(x, loads, step_inputs, body, derivatives, 0)
