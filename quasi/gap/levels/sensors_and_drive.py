"""Sensors, frames, clocks and the rotors' drive, settled before anything aerodynamic."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import norm

from quasi.gap.effect import Effect
from quasi.gap.flights.level import Flown, Level
from quasi.gap.levels import imu_or_markers, materiality, rotor_order
from quasi.gap.levels.corrections import document
from quasi.gap.levels.drive import identify as drive_level
from quasi.gap.levels.sensors import identify as sensor_level
from quasi.gap.levels.tie_breaking import Process, settle
from quasi.model.model import Model
from quasi.tables import COLUMNS

SEARCHES = 4  # that share the false alarm rate: sensors, drive and forces, and for what no cause explains
FAINTEST = 4.0  # |t| of what chance makes look like a cause
UNITS = {
    "p": "rad/s", "q": "rad/s", "r": "rad/s", "ax": "m/s2", "ay": "m/s2", "az": "m/s2", "Fx": "N", "Fy": "N",
    "Fz": "N", "Mx": "N m", "My": "N m", "Mz": "N m", "w1": "rad/s", "w2": "rad/s", "w3": "rad/s", "w4": "rad/s",
    "height": "m", "speed": "m/s", "volts": "V", "frequency": "Hz", "rotor": "rad/s", "heading": "rad", "time": "s",
    "position": "m", "velocity": "m/s", "attitude": "rad", "rate": "rad/s", "horizon": "s", "start": "s", "room": "m",
    "roll_rate": "rad/s", "pitch_rate": "rad/s", "yaw_rate": "rad/s",
}  # fmt: skip


def examine(
    flights: Sequence[Flown], model: Mapping[str, Any], settings: Mapping[str, Any], effects: Mapping[str, Effect],
    process: Process | None = None, held: int = 0,
) -> tuple[dict[str, Any], list[Level]]:  # fmt: skip
    """The calibration of a gap with what both levels found as plain data under "levels", and the levels themselves.

    flights  those that may choose and fit; model  document; settings  of the gap, with "sessions"
              {flight: session} where they are known; effects  that are asked, by id
    process  imports and filters a flight anew with a calibration; without it ties stay ties
    held     how many flights that are held out will judge the names
    """
    rate = rate_of(settings["false alarm rate"], sum(f.compared for f in flights), held)
    # which of the two points sits elsewhere is asked of what the comparison of sensors takes for the IMU's
    arm = [imu_or_markers.IMU] if imu_or_markers.MARKERS in effects and imu_or_markers.IMU not in effects else []
    options = {"false alarm rate": rate, "effects": [*effects, *arm], "sessions": settings.get("sessions") or {}}
    order = None
    if rotor_order.ID in effects:
        order = rotor_order.find_rotor_order(flights, Model(model, "the compared model"))
    if order is not None:
        process = process and rotor_order.corrected_process(process, order)
        right = (lambda f: process(f, None)) if process else (lambda f: rotor_order.reorder(f, order.document()))
        flights = [right(f) if f.compared else f for f in flights]
    levels = [sensor_level.examine(flights, options), drive_level.examine(flights, model, options)]
    if imu_or_markers.MARKERS in effects:
        imu_or_markers.settle(levels[0], flights, Model(model, "the compared model"), effects, rate)
    if process is not None:
        settle(levels, flights, Model(model, "the compared model"), options["false alarm rate"], process)
    for level in levels:
        level.found_on = materiality.found_on(level, flights)
    calibration = document(levels)
    if order is not None:
        calibration["rotor order"] = order.document()
        calibration["compared"] |= order.calibration()
        calibration["notes"].append(rotor_order.note_of(order.document()))
    return {**calibration, "levels": {level.level: plain(level) for level in levels}}, levels


def rate_of(rate: float, compared: int, held: int) -> float:
    """The false alarm rate of one search, so that all searches together name something by chance at `rate`.

    A name also has to gain on the held-out flights, where any have a say. What chance made of `compared` flights with
    |t| is theta = |t| s sqrt(1/compared) for a spread s of single flights; it gains on `held` others when these show
    more than theta/2, which has the probability of a normal deviate above |t|/2 sqrt(held/compared).
    """
    passes = float(norm.sf(0.5 * FAINTEST * np.sqrt(held / max(compared, 1)))) if held else 1.0
    return rate / SEARCHES / max(passes, 1.0 / SEARCHES)


def plain(level: Level) -> dict[str, Any]:
    """A level without its tables."""
    return {
        "effects": level.effects,
        "ties": level.ties,
        "findings": level.findings,
        "candidates": level.candidates,
        "cannot_be_asked": level.cannot_be_asked,
        "noise_floor": level.noise_floor,
        "notes": level.notes,
        "found on": level.found_on,
    }


def judged(flights: Sequence[Flown], model: Mapping[str, Any], effects: Sequence[str] = ()) -> dict[str, pd.DataFrame]:
    """{"sensors", "drive": table of "channels"} of flights without a search: rms "before" and "floor" of each."""
    options = {"false alarm rate": 0.01, "effects": list(effects)}
    found = {}
    for level in (sensor_level.examine(flights, options), drive_level.examine(flights, model, options)):
        if "channels" in level.tables:
            found[level.level] = level.tables["channels"]
    return found


def units_of(table: pd.DataFrame) -> dict[str, tuple[str, str]]:
    """Units of the columns of a residual table, by the quantity that a name begins with."""
    return {
        name: (UNITS.get(name, UNITS.get(re.split("[_ ]", name)[0], "")), "")
        for name in table.columns
        if name not in COLUMNS
    }
