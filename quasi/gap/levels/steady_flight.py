"""Rows of a flight in which the rotors balance weight and moments in the mean, and what they are asked for there."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.ndimage import minimum_filter1d, uniform_filter1d

from quasi.attitude import GRAVITY
from quasi.filtering.contact import CONTACT
from quasi.sensor_limits import runs_of
from quasi.terms.rotor_map import RAW, SHARES, SPEEDS

MAX_STEADY_SPEED = 1.0  # m/s: a small quadrotor's drag is then some percent of its weight; there and back it cancels
GROUND_RADII = 4.0  # rotor radii above the floor: thrust gains 0.4 % there (Cheeseman & Bennett, ARC R&M 3021, 1955)
MIN_HEIGHT = 0.1  # m above the lowest place, where the rotor's radius is not known
SETTLING, BEFORE_LANDING = 1.0, 0.5  # s after take-off and before touch-down: integrators of a controller wind up
CALM_RATE, CALM_FORCE = 0.5, 0.15  # rad/s and share of g, means over CALM_WINDOW: a tilt of 9 deg adds 1 % of thrust
CALM_WINDOW = 0.5  # s
CONTACT_MARGIN = 0.25  # s on either side of a contact
MIN_STEADY = 3.0  # s, over which a controller's own slow motions average out


class SteadyFlight(NamedTuple):
    """thrust (4,) mean of squared speed, or of squared command times voltage, any unit; volts, mean, NaN where unknown
    or where speeds are measured, whose thrust follows no map of it; seconds; contacts, how many with the floor or a
    wall were left out; source "speeds" or "commands"."""

    thrust: np.ndarray
    volts: float
    seconds: float
    contacts: int
    source: str


def asked_of_rotors(frame: pd.DataFrame) -> tuple[np.ndarray, str]:
    """What each rotor is asked for (n, 4), proportional to thrust, and its source.

    Speeds that were estimated from commands may be balanced flight by flight, so that the commands count then.
    Raises ValueError, with a reason for the page, where neither the speeds nor the commands of four rotors are there.
    """
    if all(w in frame for w in SPEEDS) and f"command1{RAW}" not in frame:
        return frame[list(SPEEDS)].to_numpy(float) ** 2, "speeds"
    if not all(c in frame for c in SHARES):
        raise ValueError("neither speeds nor commands of the four rotors are known")
    commands = np.maximum(frame[list(SHARES)].to_numpy(float), 0.0)
    if _knows_voltage(frame):
        commands = commands * frame["battery_voltage"].to_numpy(float)[:, None]
    return commands**2, "commands"


def _knows_voltage(frame: pd.DataFrame) -> bool:
    """Whether the battery's voltage was measured: without a sensor 0 V is logged."""
    return "battery_voltage" in frame and bool((frame["battery_voltage"].to_numpy(float) > 0.0).any())


def steady_flight(frame: pd.DataFrame, radius: float | None = None) -> SteadyFlight:
    """Means over the steady part of a filtered flight.

    frame   t (s, uniform), x y z, u v w, ax ay az (specific force), w1..w4 or command1..4; in_flight and
            battery_voltage where known
    radius  of a rotor, m, or None
    Raises  ValueError, with a reason for the page, where there is no steady part
    """
    asked, source = asked_of_rotors(frame)
    dt = float(np.median(np.diff(frame["t"].to_numpy(float))))
    flying = np.isfinite(asked).all(axis=1) & (asked > 0.0).all(axis=1)
    if "in_flight" in frame:
        flying &= frame["in_flight"].to_numpy(float) > 0.5
    if "z" in frame:
        height = np.nanmax(frame["z"].to_numpy(float)) - frame["z"].to_numpy(float)
        flying &= height > (GROUND_RADII * radius if radius else MIN_HEIGHT)
    rows = _without_ends(flying, dt)
    touched = _contacts(frame, asked, rows, dt)
    if {"u", "v", "w"} <= set(frame):
        rows &= np.linalg.norm(frame[["u", "v", "w"]].to_numpy(float), axis=1) < MAX_STEADY_SPEED
    rows &= ~touched & _calm(frame, dt)
    seconds = float(rows.sum() * dt)
    if seconds < MIN_STEADY:
        raise ValueError(f"{seconds:.1f} s of steady flight, {MIN_STEADY:g} s are needed")
    mapped = source == "commands" and _knows_voltage(frame)
    volts = float(np.mean(frame["battery_voltage"].to_numpy(float)[rows])) if mapped else np.nan
    return SteadyFlight(asked[rows].mean(axis=0), volts, seconds, len(runs_of(touched)), source)


def _without_ends(flying: np.ndarray, dt: float) -> np.ndarray:
    """True (n,) inside each span of flight, away from its take-off and its touch-down."""
    rows = np.zeros(len(flying), bool)
    for first, last in runs_of(flying):
        rows[first + round(SETTLING / dt) : max(first, last - round(BEFORE_LANDING / dt))] = True
    return rows


def _calm(frame: pd.DataFrame, dt: float) -> np.ndarray:
    """True (n,) where the vehicle neither turns nor accelerates beyond CALM_RATE and CALM_FORCE in the mean.

    Near rows without values that is unknown; they do not reach farther, as in a running sum they would.
    """
    calm, width = np.ones(len(frame), bool), max(1, round(CALM_WINDOW / dt))
    for names, offset, limit in (
        (("p", "q", "r"), 0.0, CALM_RATE),
        (("ax", "ay", "az"), GRAVITY, CALM_FORCE * GRAVITY),
    ):
        if set(names) <= set(frame):
            values = frame[list(names)].to_numpy(float) + np.array([0.0, 0.0, offset])
            known = np.isfinite(values).all(axis=1)
            mean = uniform_filter1d(np.where(known[:, None], values, 0.0), width, axis=0)
            calm &= (np.linalg.norm(mean, axis=1) < limit) & minimum_filter1d(known, width)
    return calm


def _contacts(frame: pd.DataFrame, asked: np.ndarray, rows: np.ndarray, dt: float) -> np.ndarray:
    """True (n,) around rows in which something other than the rotors pushes: a contact with the floor or a wall."""
    touched = np.zeros(len(frame), bool)
    if not {"ax", "ay", "az"} <= set(frame) or not rows.any():
        return touched
    lift = asked.sum(axis=1) / np.median(asked.sum(axis=1)[rows])
    felt = frame[["ax", "ay", "az"]].to_numpy(float) / GRAVITY
    beyond = np.linalg.norm(felt + np.stack([0 * lift, 0 * lift, lift], axis=1), axis=1)
    margin = round(CONTACT_MARGIN / dt)
    for first, last in runs_of((beyond > CONTACT) & rows):
        touched[max(0, first - margin) : last + margin] = True
    return touched & rows
