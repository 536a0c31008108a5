"""Vehicles of a recording: poses and signals over time, from filtered flights, simulations and roll-outs."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from quasi.airframe import Airframe
from quasi.attitude import from_euler
from quasi.export.frames import swap_vector
from quasi.model.extensions import correct_flight
from quasi.model.model import Model
from quasi.tables import COLUMNS

MOST_RATE = 100.0  # Hz of messages per topic; viewers draw no more
MEASURED, PATH_BEFORE, PATH_AFTER = (0.1, 0.4, 0.9), (0.9, 0.4, 0.1), (0.1, 0.7, 0.2)  # red, green, blue
SIGNAL_GROUPS = {
    "state": ("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z"),
    "rotors": ("w1", "w2", "w3", "w4", "w1_CMD", "w2_CMD", "w3_CMD", "w4_CMD"),
    "loads": ("Fx", "Fy", "Fz", "Mx", "My", "Mz"),
    "sensors": ("ax", "ay", "az", "battery_voltage"),
}
EULER_ANGLES, PLACE = ("roll", "pitch", "yaw"), ("x", "y", "z")


class Vehicle(NamedTuple):
    """One vehicle.

    t (n,) s from 0; position (n, 3) m and quaternion (n, 4) w x y z of the body x forward, y left, z up, in the world x
    north, y west, z up; NaN where it is unknown
    signals  {topic: table of n rows}, in quasi's own axes; units {signal: unit}; color (red, green, blue), 0 to 1
    """

    name: str
    t: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    signals: dict[str, pd.DataFrame]
    units: dict[str, str]
    color: tuple[float, float, float]


class Event(NamedTuple):
    """Something that happened at t, s."""

    t: float
    text: str


def vehicle_of(name: str, table: pd.DataFrame, color: tuple[float, float, float] = MEASURED) -> Vehicle:
    """A vehicle of a table with t, roll .. yaw, x .. z (earth north, east, down) and what else SIGNAL_GROUPS holds."""
    thin = slice(None, None, step_of(table["t"].to_numpy(float)))
    part = table.iloc[thin].reset_index(drop=True)
    t = part["t"].to_numpy(float)
    angles = part[list(EULER_ANGLES)].to_numpy(float)
    place = part[list(PLACE)].to_numpy(float) if all(n in part for n in PLACE) else np.zeros((len(part), 3))
    groups = {topic: [n for n in names if n in part] for topic, names in SIGNAL_GROUPS.items()}
    signals = {topic: part[names] for topic, names in groups.items() if names}
    units = {n: COLUMNS[n][0] for s in signals.values() for n in s if n in COLUMNS}
    return Vehicle(name, t - t[0], swap_vector(place), _upright(from_euler(*angles.T)), signals, units, color)


def step_of(t: np.ndarray) -> int:
    """Every how many rows a message is written."""
    return max(round(1.0 / (float(np.median(np.diff(t))) * MOST_RATE)), 1) if len(t) > 1 else 1


def reference_of(table: pd.DataFrame) -> Vehicle | None:
    """The reference of a simulation as a vehicle that is upright where no attitude is asked; None without a place."""
    if not all(f"{n}_ref" in table for n in PLACE):
        return None
    wanted = pd.DataFrame({"t": table["t"], **{n: table[f"{n}_ref"] for n in PLACE}})
    for n in EULER_ANGLES:
        wanted[n] = table[f"{n}_ref"].fillna(0.0) if f"{n}_ref" in table else 0.0
    return vehicle_of("reference", wanted, PATH_BEFORE) if np.isfinite(wanted["x"]).any() else None


def with_residuals(vehicle: Vehicle, model: Model, flight: pd.DataFrame, mass: float | None = None) -> Vehicle:
    """The vehicle with the model's forces and moments on a measured flight ("loads") and measured less these.

    mass  kg that the flight was logged with, where known
    """
    read = correct_flight(model, flight, mass)
    predicted = model.predict_columns(read)
    thin = slice(None, None, step_of(flight["t"].to_numpy(float)))
    residual = (read[list(predicted)] - predicted).iloc[thin].reset_index(drop=True)
    signals = {**vehicle.signals, "loads": predicted.iloc[thin].reset_index(drop=True), "residuals": residual}
    units = {**vehicle.units, **{axis: COLUMNS[axis][0] for axis in predicted}}
    return vehicle._replace(signals=signals, units=units)


def phases_of(table: pd.DataFrame) -> list[Event]:
    """Where a filtered flight begins and ends to be in flight, and where its rows are not valid."""
    t = table["t"].to_numpy(float) - float(table["t"].iloc[0])
    events = []
    for column, begins, ends in (
        ("in_flight", "in flight", "no longer in flight"),
        ("valid", "rows are valid again", "rows are not valid from here"),
    ):
        if column not in table:
            continue
        state = table[column].to_numpy(float) > 0.5
        if column == "in_flight" and state[0]:
            events.append(Event(0.0, begins))
        for k in np.flatnonzero(state[1:] != state[:-1]) + 1:
            events.append(Event(float(t[k]), begins if state[k] else ends))
    return sorted(events)


def _upright(quaternion: np.ndarray) -> np.ndarray:
    """Attitude (n, 4) w x y z of axes that are turned by 180 degrees about x on both sides."""
    return quaternion * np.array([1.0, 1.0, -1.0, -1.0])


def rotor_places(airframe: Airframe | None) -> tuple[np.ndarray, float]:
    """Hubs (4, 3) m in the body x forward, y left, z up, and the rotors' radius; a plain cross where unknown."""
    if airframe is None:
        return 0.1 * np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]]), 0.06
    return swap_vector(airframe.hubs), float(airframe.radius)
