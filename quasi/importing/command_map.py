"""Commanded rotor speeds where the log holds shares of the motor output range only.

The map from share to speed is the configured one, else one that is identified on the flight itself.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import ConfigError
from quasi.importing.command_fit import ROTOR_NUMBERS, identify_command_map, map_commands
from quasi.tables import IDENTIFIED_MAP
from quasi.terms.rotor_map import LOW_VOLTAGE


def add_commanded_speeds(
    frame: pd.DataFrame, given: Mapping[str, Any] | None, where: str, notes: list[str]
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """The flight with w1_CMD .. w4_CMD (rad/s), and where they are from.

    frame    columns command1 .. command4 (0..1); w1_CMD .. of the log are kept
    given    the quadrotor's "command map": speed = (V / reference voltage)^exponent x sum of coefficients x command^k
    Returns  the table and {"source": "logged", "configured map", IDENTIFIED_MAP or None}; with an identified map also
             its constants, their standard errors and the rms error of the speeds; without a source "why"
    Raises ConfigError when the configured map falls somewhere between command 0 and 1.
    """
    if any(f"w{i}_CMD" in frame for i in ROTOR_NUMBERS):
        return frame, {"source": "logged"}
    if given is None or any(f"command{i}" not in frame for i in ROTOR_NUMBERS):
        return _identified(frame, where, notes)
    polynomial = np.polynomial.Polynomial([float(c) for c in given["coefficients"]])
    if np.min(polynomial.deriv()(np.linspace(0.0, 1.0, 101))) < 0 or polynomial(1.0) <= 0:
        raise ConfigError(
            "quadrotor configuration: 'command map' falls where the command rises between 0 and 1, or gives no speed; "
            "its coefficients are those of 1, command, command^2, ... in rad/s"
        )
    factor: np.ndarray | float = 1.0
    exponent, reference = float(given.get("voltage exponent", 0.0)), given.get("reference voltage")
    if exponent and reference:
        volts = frame["battery_voltage"].to_numpy(float) if "battery_voltage" in frame else np.zeros(len(frame))
        known = volts > LOW_VOLTAGE * float(reference)  # one that is not measured is logged as 0
        if known.any():
            t = frame["t"].to_numpy(float)
            factor = (np.interp(t, t[known], volts[known]) / float(reference)) ** exponent
        else:
            notes.append(f"{where}: no battery voltage is logged; the command map is used as at its reference voltage")
    mapped = {f"w{i}_CMD": factor * polynomial(frame[f"command{i}"].to_numpy(float)) for i in ROTOR_NUMBERS}
    return frame.assign(**mapped), {"source": "configured map"}


def _identified(frame: pd.DataFrame, where: str, notes: list[str]) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Commanded speeds by the map that the flight itself shows, as `add_commanded_speeds` returns them."""
    found = identify_command_map(frame)
    if isinstance(found, str):
        if any(f"command{i}" in frame for i in ROTOR_NUMBERS):
            notes.append(
                f"{where}: w1_CMD to w4_CMD are not made: {found}; a 'command map' of the quadrotor gives them"
            )
        return frame, {"source": None, "why": found}
    rms = found["rms error"]["value"]
    notes.append(
        f"{where}: w1_CMD to w4_CMD come from a command map identified on this flight; the rms error of the rotor "
        f"speeds is {min(rms):.0f} to {max(rms):.0f} rad/s"
    )
    return frame.assign(**map_commands(frame, found)), {"source": IDENTIFIED_MAP, **found}
