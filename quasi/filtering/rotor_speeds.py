"""Filtered flights without rotor speeds: what the filter keeps of their commands, and the speeds estimated from it.

The speeds come from the commands as logged and pass the low-pass of forces and moments last: a static map does not
commute with a filter.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.filtering import forces
from quasi.tables import read_made, read_table
from quasi.terms.rotor_map import COMMANDED, SHARES, SPEEDS, raw_commands, raw_volts, speeds_of, used_rows


def commands_to_keep(actuators: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Commands that rotor speeds can be estimated from; {} where all four speeds are measured, or commands lack.

    actuators  {column: (N,) finite} of the speeds and commands of a flight
    """
    if all(name in actuators for name in SPEEDS):
        return {}
    known = [names for names in (SHARES, COMMANDED) if all(name in actuators for name in names)]
    return {name: actuators[name] for names in known for name in names}


def lacks_speeds(table: pd.DataFrame) -> bool:
    """Whether a filtered flight lacks the speed of a rotor."""
    return not all(name in table for name in SPEEDS)


def add_estimated_speeds(
    table: pd.DataFrame, made: Mapping[str, Any], drive: Mapping[str, Any] | None, trimmed: bool = True
) -> pd.DataFrame:
    """A filtered flight with w1..w4 and w1_dot..w4_dot by a model's map; unchanged where it has them.

    made     how the flight was filtered; drive  section "rotor speeds" of a model
    trimmed  scale each rotor so that the mean force and moments of the flight are balanced (`balance`); False takes
             the map as it is for all flights
    Raises DataError for a flight without rotor speeds where drive is None, or the flight keeps no commands of its kind.
    """
    if not lacks_speeds(table):
        return table
    commands = raw_commands(table, drive["input"]) if drive is not None else None
    if commands is None:
        lacking = (
            "no map from commands to rotor speeds is identified" if drive is None else "the flight keeps no commands"
        )
        raise DataError(
            f"flight {made.get('flight')} holds no rotor speeds, and {lacking}; train the model on flights with "
            "commands, or leave the flight out"
        )
    t = table["t"].to_numpy(float)
    dt = float(np.median(np.diff(t)))
    speeds = speeds_of(drive, commands, raw_volts(table), dt)
    if trimmed and (drive.get("scale") or {}).get("trimmed"):
        speeds = speeds * trim_of(table, made, speeds, drive)
    cutoff, rate = float(made["filters"]["low-pass cutoff Hz"]), 1.0 / dt
    smooth, slope = forces.low_pass(speeds, cutoff, rate), forces.derivative(speeds, cutoff, rate)
    columns = {name: smooth[:, i] for i, name in enumerate(SPEEDS)}
    columns |= {f"{name}_dot": slope[:, i] for i, name in enumerate(SPEEDS)}
    return table.drop(columns=[c for c in columns if c in table]).assign(**columns)


def read_flight(path: str | Path, drive: Mapping[str, Any] | None, trimmed: bool = True) -> pd.DataFrame:
    """Read a filtered flight; arguments and result as `add_estimated_speeds`."""
    return add_estimated_speeds(read_table(path), read_made(path), drive, trimmed)


def trim_of(table: pd.DataFrame, made: Mapping[str, Any], speeds: np.ndarray, drive: Mapping[str, Any]) -> np.ndarray:
    """Factors (4,) on the speeds of one flight with which mean thrust and moments balance; ones without used rows.

    Uses that moments are zero on average over a flight, and its mean vertical force.
    """
    rows = used_rows(table)
    mean = np.mean(speeds[rows] ** 2, axis=0) if rows.any() else np.zeros(4)
    if not np.all(mean > 0.0):
        return np.ones(4)
    wanted = (
        np.asarray(drive["scale"]["shares"]) * -float(made["mass"]) * float(table["az"].to_numpy(float)[rows].mean())
    )
    wanted = wanted / drive["scale"]["thrust factor"]["value"]
    return np.sqrt(wanted / mean) if np.all(wanted > 0.0) else np.ones(4)
