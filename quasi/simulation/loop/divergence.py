"""Explain why a simulation ended early: which quantity diverged, when, and the remedy, in one sentence."""

import numpy as np
import pandas as pd

from quasi.errors import ConfigError
from quasi.simulation.loop.closed_loop import FULL_LOG_SIZE, STATUS_FINE, STATUS_NO_COMMAND, run_loop
from quasi.simulation.loop.setup import STATE_NAMES, Setup
from quasi.simulation.vehicle.dynamics import compute_loads, make_scratch
from quasi.simulation.vehicle.layout import ROOT_EFFECTIVENESS, SPEED_CAP
from quasi.simulation.vehicle.undefined_loads import describe_undefined_loads

_STATE_UNITS = ("1",) * 4 + ("m/s",) * 3 + ("rad/s",) * 3 + ("m",) * 3 + ("rad/s",) * 4
_MEANINGS = {
    **dict.fromkeys(("qw", "qx", "qy", "qz"), "attitude quaternion"),
    "u": "forward velocity", "v": "sideways velocity", "w": "downward velocity",
    "p": "roll rate", "q": "pitch rate", "r": "yaw rate",
    "x": "position north", "y": "position east", "z": "position down",
    **{f"w{i}": f"speed of rotor {i}" for i in range(1, 5)},
}  # fmt: skip


def explain_end(
    setup: Setup, status: int, steps: int, table: pd.DataFrame | None = None, last: np.ndarray | None = None,
    after: np.ndarray | None = None,
) -> str | None:  # fmt: skip
    """Explain why a simulation ended early; None where it did not.

    status, steps  of the loop; table  of the result, up to the end
    last, after    states (17 + extra states,) before and after the diverged step, where they are known
    """
    if status == STATUS_FINE:
        return None
    t = steps * setup.dt
    if status == STATUS_NO_COMMAND:
        return (
            f"the controller gave a command that is not a finite number at t = {t:.4g} s and the simulation ended; use "
            "gentler 'gains', or another 'controller'"
        )
    found = None
    if last is not None and (after is None or not np.isfinite(after).all()):
        found = _describe_loads(setup, last, t)
    if found is None:
        found = _describe_state(setup, status, after), _suggest_remedy(setup, t, table)
    return f"diverged at t = {t:.4g} s: {found[0]}; {found[1]}; earlier rows are kept"


def _describe_state(setup: Setup, status: int, after: np.ndarray | None) -> str:
    name, limit = STATE_NAMES[status - 1], setup.loop_parameters.limits[status - 1]
    text = f"{_MEANINGS[name]} {name} left its limit of {limit:g} {_STATE_UNITS[status - 1]}"
    value = np.nan if after is None else after[status - 1]
    return f"{text} and became {value:.4g}" if np.isfinite(value) else text


def _describe_loads(setup: Setup, last: np.ndarray, t: float) -> tuple[str, str] | None:
    """Describe the axis and term that are not finite in this state, and the remedy; None where all are finite."""
    loop_parameters = setup.loop_parameters
    scratch, loads, step_inputs = (
        make_scratch(loop_parameters.kernel, setup.extra_states),
        np.zeros(6),
        setup.make_first_step_inputs(),
    )
    if t >= loop_parameters.fault[0]:
        step_inputs[ROOT_EFFECTIVENESS : ROOT_EFFECTIVENESS + 4], step_inputs[SPEED_CAP : SPEED_CAP + 4] = (
            np.sqrt(loop_parameters.fault[1:5]),
            loop_parameters.fault[5:9],
        )
    compute_loads(last, step_inputs, loop_parameters.kernel, loop_parameters.body, scratch.inputs, scratch.work, loads)
    return describe_undefined_loads(setup.model, scratch.inputs, loads)


def _suggest_remedy(setup: Setup, t: float, table: pd.DataFrame | None) -> str:
    """Suggest a remedy by the likely cause: a fault, a state outside the data, else step and gains."""
    fault = setup.loop_parameters.fault[0]
    if fault <= t:
        return (
            f"rotors failed at {fault:g} s and the controller could not hold the vehicle: end with 'duration' before, "
            "or use drone_INDI with 'learn rotor limits'"
        )
    left = None if table is None else _find_exit(setup, table)
    if left is not None:
        return (
            f"the flight left the region of the model's data at {left[0]:.4g} s by {left[1]}, where its terms are not "
            "valid: use a gentler reference or start, or train on flights that cover it"
        )
    return "use a shorter 'time step' or gentler 'gains', and check the model's damping"


def _find_exit(setup: Setup, table: pd.DataFrame) -> tuple[float, str] | None:
    """Find when the flight finally left the region of the training data, s, and by which variable, or None."""
    rows = table[np.isfinite(table[list(STATE_NAMES)].to_numpy()).all(axis=1)]
    air = {n: rows[f"{n}_air"] for n in "uvw" if f"{n}_air" in rows}
    try:
        found = setup.model.distance_columns(rows.assign(**air))
    except ConfigError:
        return None  # a model without a region
    inside = np.flatnonzero(found["distance"].to_numpy() <= 0.0)
    first = int(inside[-1]) + 1 if len(inside) else 0
    if first >= len(rows):
        return None
    return float(rows["t"].iloc[first]), str(found["worst"].iloc[first])


def recompute_state_before(setup: Setup, steps: int) -> np.ndarray:
    """Recompute the state (17 + extra states,) before step number `steps`; the loop is deterministic."""
    loop_state, log = setup.make_loop_state(), np.empty((2, FULL_LOG_SIZE + setup.extra_states))
    run_loop(
        setup.loop_parameters,
        loop_state,
        make_scratch(setup.loop_parameters.kernel, setup.extra_states),
        0,
        steps - 1,
        max(steps, 1),
        log,
        False,
    )
    return loop_state.x.copy()
