"""Find, read and check the tables that a simulation's settings name."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import ConfigError, DataError, nearest
from quasi.tables import read_numbers


def read_table(settings: Mapping[str, Any], section: str, directory: str | Path, name: str) -> pd.DataFrame | None:
    """Read the table that "file" in a section names; None without one."""
    file = settings[section].get("file")
    if not file:
        return None
    path = Path(directory) / file
    if not path.is_file():
        raise ConfigError(
            f"{name}: '{section}' / 'file' is '{file}', but {path} does not exist; correct 'file', or pass the folder "
            "as `directory`"
        )
    return read_numbers(path)


def check_wind_table(wind: Any, asked: Mapping[str, Any], name: str) -> np.ndarray:
    """Return rows (T, 4) of t (s) and wind velocity north, east, down (m/s). Raises DataError."""
    if wind is None:
        return np.zeros((0, 4))
    what = f"{name}: the wind's table {asked['file']}" if asked["file"] else f"{name}: the wind's table"
    columns = ("t", "wind_north", "wind_east", "wind_down")
    missing = [c for c in columns if c not in wind]
    if missing:
        raise DataError(f"{what} lacks the column '{missing[0]}'{nearest(missing[0], list(wind))}")
    table = np.column_stack([np.asarray(wind[c], float) for c in columns])
    for k, column in enumerate(columns):
        bad = np.flatnonzero(~np.isfinite(table[:, k]))
        if len(bad):
            raise DataError(f"{what} has no number in column '{column}', data row {bad[0] + 1}; fill it in")
    if not len(table):
        raise DataError(f"{what} has no rows; fill it in")
    back = np.flatnonzero(np.diff(table[:, 0]) <= 0.0)
    if len(back):
        raise DataError(f"{what} does not increase in time in data row {back[0] + 2}; correct its column 't'")
    return np.ascontiguousarray(table)
