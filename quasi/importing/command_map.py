"""Commanded rotor speeds from a configured map, where the log holds shares of the motor output range only."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import ConfigError

ROTORS = range(1, 5)


def add_commanded_speeds(
    frame: pd.DataFrame, given: Mapping[str, Any] | None, where: str, notes: list[str]
) -> tuple[pd.DataFrame, str | None]:
    """The flight with w1_CMD .. w4_CMD (rad/s), and their source: "logged", "configured map", or None.

    frame  columns command1 .. command4 (0..1); w1_CMD .. of the log are kept
    given  the quadrotor's "command map": speed = (V / reference voltage)^exponent x sum of coefficients x command^k
    Raises ConfigError when the map falls somewhere between command 0 and 1.
    """
    if any(f"w{i}_CMD" in frame for i in ROTORS):
        return frame, "logged"
    if given is None or any(f"command{i}" not in frame for i in ROTORS):
        return frame, None
    polynomial = np.polynomial.Polynomial([float(c) for c in given["coefficients"]])
    if np.min(polynomial.deriv()(np.linspace(0.0, 1.0, 101))) < 0 or polynomial(1.0) <= 0:
        raise ConfigError(
            "quadrotor configuration: 'command map' falls where the command rises between 0 and 1, or gives no speed; "
            "its coefficients are those of 1, command, command^2, ... in rad/s"
        )
    factor: np.ndarray | float = 1.0
    exponent, reference = float(given.get("voltage exponent", 0.0)), given.get("reference voltage")
    if exponent and reference:
        if "battery_voltage" in frame:
            factor = np.maximum(frame["battery_voltage"].to_numpy(float) / float(reference), 0.0) ** exponent
        else:
            notes.append(f"{where}: no battery voltage is logged; the command map is used as at its reference voltage")
    mapped = {f"w{i}_CMD": factor * polynomial(frame[f"command{i}"].to_numpy(float)) for i in ROTORS}
    return frame.assign(**mapped), "configured map"
