"""Columns of what a model is given: arrays of states and speeds, or tables of flights."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.airframe import Airframe
from quasi.errors import ShapeError

STATE = ("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z")
ROTORS = ("w1", "w2", "w3", "w4")
ACCELERATIONS = tuple(f"{w}_dot" for w in ROTORS)


def read_slowest_speeds(document: Mapping[str, Any], airframe: Airframe) -> list[float] | None:
    """Lowest speed of each rotor in the training flights, else the idle speed, rad/s; None where neither is known."""
    ranges = document.get("envelope") or {}
    lowest = [(ranges.get(w) or {}).get("min") if isinstance(ranges, Mapping) else None for w in ROTORS]
    if all(isinstance(v, int | float) and np.isfinite(v) for v in lowest):
        return [float(v) for v in lowest]
    factor = airframe.logged_to_rad_s or document.get("logged to rad/s")
    if airframe.idle_rpm and isinstance(factor, int | float) and np.isfinite(airframe.idle_rpm * factor):
        return [float(airframe.idle_rpm * factor)] * 4
    return None


def columns_from_state(
    state: np.ndarray, speeds: np.ndarray, accelerations: np.ndarray | None, extra: Mapping[str, np.ndarray] | None
) -> tuple[dict[str, np.ndarray], int]:
    """Columns and number of rows of what `predict` is given. Raises ShapeError."""
    state, speeds = np.atleast_2d(state), np.atleast_2d(speeds)
    if state.ndim != 2 or state.shape[1] not in (9, 12):
        raise ShapeError(f"state must be (N, 12) or (N, 9), roll pitch yaw u v w p q r [x y z], got {state.shape}")
    if speeds.shape != (len(state), 4):
        raise ShapeError(f"rotor_speeds must be ({len(state)}, 4) like the state's rows, got {speeds.shape}")
    columns = {name: state[:, k] for k, name in enumerate(STATE[: state.shape[1]])}
    columns |= {name: speeds[:, k] for k, name in enumerate(ROTORS)}
    if accelerations is not None:
        accelerations = np.atleast_2d(np.asarray(accelerations, float))
        if accelerations.shape != speeds.shape:
            raise ShapeError(f"rotor_accelerations must be {speeds.shape} like rotor_speeds, got {accelerations.shape}")
        columns |= {name: accelerations[:, k] for k, name in enumerate(ACCELERATIONS)}
    for name, values in (extra or {}).items():
        columns[name] = np.broadcast_to(np.asarray(values, float), (len(state),))
    return columns, len(state)


def columns_from_table(flight: pd.DataFrame | Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], int]:
    numeric = [name for name in flight if np.issubdtype(np.asarray(flight[name]).dtype, np.number)]
    columns = {str(name): np.asarray(flight[name], float) for name in numeric}
    return columns, len(next(iter(columns.values()))) if columns else 0
