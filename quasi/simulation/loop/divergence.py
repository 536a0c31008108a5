"""Why a simulation ended before its time: which quantity diverged, when, and what to do about it, in one sentence."""

import numpy as np
import pandas as pd

from quasi.errors import ConfigError
from quasi.simulation.loop.closed_loop import FINE, LOG, NO_COMMAND, fly
from quasi.simulation.loop.setup import STATE_NAMES, Setup
from quasi.simulation.vehicle.dynamics import loads_at, scratch_of
from quasi.simulation.vehicle.layout import CAP, SHARE
from quasi.simulation.vehicle.undefined_loads import describe_undefined_loads

_UNITS = ("1",) * 4 + ("m/s",) * 3 + ("rad/s",) * 3 + ("m",) * 3 + ("rad/s",) * 4
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
    """Why a simulation ended before its time; None where it did not.

    status, steps  of the loop; table  of the result, what came before
    last, after    states (17 + own,) before and after the step that diverged, where they are known
    """
    if status == FINE:
        return None
    t = steps * setup.dt
    if status == NO_COMMAND:
        return (
            f"the controller gave a command that is no number at t = {t:.4g} s; the simulation ended there; use "
            "gentler 'gains', or another 'controller'"
        )
    found = None
    if last is not None and (after is None or not np.isfinite(after).all()):
        found = _describe_loads(setup, last, t)
    if found is None:
        found = _describe_state(setup, status, after), _remedy(setup, t, table)
    return f"diverged at t = {t:.4g} s: {found[0]}; {found[1]}; what came before is kept"


def _describe_state(setup: Setup, status: int, after: np.ndarray | None) -> str:
    name, limit = STATE_NAMES[status - 1], setup.machine.limits[status - 1]
    text = f"{_MEANINGS[name]} {name} left its limit of {limit:g} {_UNITS[status - 1]}"
    value = np.nan if after is None else after[status - 1]
    return f"{text} and became {value:.4g}" if np.isfinite(value) else text


def _describe_loads(setup: Setup, last: np.ndarray, t: float) -> tuple[str, str] | None:
    """The axis and the term of the model that are no number in this state, and the remedy; None where all are."""
    machine = setup.machine
    scratch, loads, held = scratch_of(machine.kernel, setup.own), np.zeros(6), setup.held()
    if t >= machine.fault[0]:
        held[SHARE : SHARE + 4], held[CAP : CAP + 4] = np.sqrt(machine.fault[1:5]), machine.fault[5:9]
    loads_at(last, held, machine.kernel, machine.body, scratch.inputs, scratch.work, loads)
    return describe_undefined_loads(setup.model, scratch.inputs, loads)


def _remedy(setup: Setup, t: float, table: pd.DataFrame | None) -> str:
    """What most likely helps, by what happened before: a fault, data exceeded, else the step and the gains."""
    fault = setup.machine.fault[0]
    if fault <= t:
        return (
            f"rotors failed at {fault:g} s and the controller could not hold the vehicle: end with 'duration' before, "
            "or use drone_INDI with 'learn rotor limits'"
        )
    left = None if table is None else _left_region(setup, table)
    if left is not None:
        return (
            f"the flight left the region of the model's data at {left[0]:.4g} s by {left[1]}, where its terms do not "
            "hold: use a gentler reference or start, or train on flights that cover it"
        )
    return "use a shorter 'time step' or gentler 'gains', and check the model's damping"


def _left_region(setup: Setup, table: pd.DataFrame) -> tuple[float, str] | None:
    """When the flight left the region of the training data for good, s, and by which variable, or None."""
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


def state_before(setup: Setup, steps: int) -> np.ndarray:
    """The state (17 + own,) before step number `steps`, by flying up to there again; the loop is deterministic."""
    live, log = setup.live(), np.empty((2, LOG + setup.own))
    fly(setup.machine, live, scratch_of(setup.machine.kernel, setup.own), 0, steps - 1, max(steps, 1), log, False)
    return live.x.copy()
