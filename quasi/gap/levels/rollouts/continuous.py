"""Simulations of a model that follow a flight: back-to-back windows, each from the measured state."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from quasi.gap.levels.rollouts.open_loop import Flight, simulated
from quasi.model.columns import STATE
from quasi.model.model import Model
from quasi.simulation.tools.replay import count_steps


class Chase(NamedTuple):
    """states (N, 12) roll .. z of the simulation at the flight's times, NaN where no window lies; starts (S,) rows."""

    states: np.ndarray
    starts: np.ndarray


def chase(model: Model, flight: Flight, horizon: float) -> Chase:
    """Simulate windows of `horizon` s that follow one another over the valid rows of a flight."""
    steps = count_steps(flight.t, horizon)
    states = np.full((len(flight.t), 12), np.nan)
    faults = np.concatenate([[0], np.cumsum(~flight.valid)])
    starts, row = [], 0
    while row + steps < len(flight.t):
        if faults[row + steps + 1] == faults[row]:
            starts.append(row)
            row += steps
        else:
            row += 1
    if starts:
        run = simulated(model, flight, np.array(starts), horizon)
        for window, start in zip(run, starts):
            states[start : start + steps] = window[:steps]
    return Chase(states, np.array(starts, int))


def chased_table(flight: Flight, found: Chase) -> pd.DataFrame:
    """The simulation as a table with the flight's times, states and rotor speeds, which drove it."""
    columns = {"t": flight.t} | dict(zip(STATE, found.states.T))
    return pd.DataFrame(columns | {f"w{i + 1}": flight.speeds[:, i] for i in range(4)})
