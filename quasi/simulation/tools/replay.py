"""Roll-outs of a model from measured states, compiled: many windows, with measured rotor speeds or with commands.

Each window begins in a measured state and goes on by Runge-Kutta steps of the simulator's own physics (`dynamics`).
Rotor speeds are linear between their samples; commands are held from one sample to the next and act through delay,
saturation and lag; wind and further inputs of the model are the means of their samples at both ends of a step.
"""

import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY, from_euler, to_euler
from quasi.errors import DataError, ShapeError
from quasi.model.extensions import drive_of, said_of_rotors, wind_of
from quasi.model.model import Model
from quasi.simulation.vehicle.dynamics import RK4, advance, body_of, inputs_of, rest, scratch_of
from quasi.simulation.vehicle.layout import (
    CAP,
    EXTRAS,
    HELD,
    LOAD_MASS,
    OFFSET,
    ROTORS,
    SHARE,
    SLOPE,
    STATES,
    TARGET,
    WIND,
)
from quasi.simulation.vehicle.payload_and_inflow import put
from quasi.simulation.vehicle.variants import extended, parts_of, with_parts


class Rotors(NamedTuple):
    """How rotors follow commands: time constants up and down, s, one or four; delay s; lowest, highest speed rad/s."""

    up: np.ndarray | float
    down: np.ndarray | float
    delay: float = 0.0
    lowest: float = 0.0
    highest: float = math.inf


@njit(cache=True, error_model="numpy", nogil=True)
def run_windows(
    kernel,
    body,
    t,
    substeps,
    begin,
    speeds,
    commands,
    late,
    low,
    high,
    wind,
    extras,
    offsets,
    lying,
    starts,
    first,
    stop,
    out,
):
    """Windows first .. stop - 1: fills out (S, steps + 1, 17).

    t (N,) s; begin (S, 17 + own) states at the starts, the parts not yet at rest; speeds (N, 4) measured, or (0, 4)
    where commands (N, 4) drive the rotors, the latter `late` samples late, within low .. high; wind (N, 3) or (0, 3);
    extras (N, E); offsets (S, 6) or (0, 6) are subtracted from forces and moments; lying (S,) whether a load lies still
    """
    inputs, work, loads, last, slopes, middle = scratch_of(kernel, begin.shape[1] - STATES)
    held = np.zeros(HELD + inputs_of(kernel) - 20)
    x = np.empty(begin.shape[1])
    mine = body.copy()
    whole = math.floor(late + 1e-9)
    part = max(late - whole, 0.0)
    for i in range(4):
        held[SHARE + i], held[CAP + i] = 1.0, np.inf
    steps = out.shape[1] - 1
    for s in range(first, stop):
        for i in range(len(x)):
            x[i] = begin[s, i]
        for i in range(STATES):
            out[s, 0, i] = x[i]
        mine[LOAD_MASS] = 0.0 if lying[s] else body[LOAD_MASS]
        if len(offsets):
            for i in range(6):
                mine[OFFSET + i] = body[OFFSET + i] + offsets[s, i]
        for n in range(steps):
            k = starts[s] + n
            dt = t[k + 1] - t[k]
            if len(wind):
                for i in range(3):
                    held[WIND + i] = 0.5 * (wind[k, i] + wind[k + 1, i])
            for i in range(extras.shape[1]):
                held[EXTRAS + i] = 0.5 * (extras[k, i] + extras[k + 1, i])
            for i in range(4):
                if len(speeds):
                    x[ROTORS + i] = speeds[k, i]
                    held[SLOPE + i] = (speeds[k + 1, i] - speeds[k, i]) / dt
                else:
                    wanted = commands[max(k - whole, 0), i]
                    if part > 0.0:
                        wanted = (1.0 - part) * wanted + part * commands[max(k - whole - 1, 0), i]
                    held[TARGET + i] = min(max(wanted, low), high)
                    held[SLOPE + i] = np.nan
            if n == 0:
                rest(x, held, kernel, mine, inputs, work, loads)
            for _ in range(substeps):
                advance(RK4, dt / substeps, x, held, kernel, mine, inputs, work, loads, last, slopes, middle)
            for i in range(STATES):
                out[s, n + 1, i] = x[i]


def replay(
    model: Model,
    t: np.ndarray,
    states: np.ndarray,
    rotor_speeds: np.ndarray,
    starts: np.ndarray,
    horizon: float,
    commands: np.ndarray | None = None,
    rotors: Rotors | None = None,
    wind: np.ndarray | None = None,
    extra: Mapping[str, np.ndarray] | None = None,
    offsets: np.ndarray | None = None,
    substeps: int = 1,
    threads: int | None = None,
    floor: float | None = None,
    mass: float | None = None,
) -> np.ndarray:
    """Roll-outs of a model with its extensions; returns (S, steps + 1, 17), the simulator's states.

    What the extensions say of recorded rotor speeds (late by, too high by) is taken off them, and off the commands what
    they are too high by. Parts with states of their own begin at rest: how a load swings when a window begins is not
    measured, so that it begins still along the apparent vertical of the model's forces, the air through the discs
    behind the present change of rotor speed.

    t             (N,) s, evenly spaced; states (N, 12) roll pitch yaw u v w (over ground) p q r x y z
    rotor_speeds  (N, 4) measured, rad/s; with `commands` those of the starts alone are used
    starts        (S,) rows; horizon s, rounded to whole samples, at least one
    commands      (N, 4) commanded speeds, rad/s, that drive the rotors instead; rotors: how, None takes the model's
    wind          (N, 3) velocity of the air, m/s, earth axes; None takes that of the model's extensions
    extra         {name: (N,)} further inputs of the model; the time "t" is known
    offsets       (S, 6) N, N m, added to the model's forces and moments in each window
    threads       that share the windows, None takes all cores
    floor         z of the floor, m: a load that lies on it when a window begins does nothing in it; None for no floor
    mass          kg that the vehicle has in this flight; None takes the model's
    A window that diverges holds inf or NaN from there on. Raises ShapeError or DataError.
    """
    model = extended(model)
    parts, recorded, blows = parts_of(model), said_of_rotors(model), wind_of(model)
    model = with_parts(model)
    if len(model.axes) < 6:
        lacking = [a for a in ("Fx", "Fy", "Fz", "Mx", "My", "Mz") if a not in model.axes]
        raise DataError(f"model {model.id} lacks {', '.join(lacking)}; a roll-out needs all six axes")
    if model.airframe.mass is None:
        raise DataError(f"model {model.id} knows no mass; fill in 'Mass' in the logbook and make it anew")
    t, states = np.ascontiguousarray(t, float), np.ascontiguousarray(states, float)
    starts = np.asarray(starts, np.int64)
    n, count = len(t), len(starts)
    steps = steps_of(t, horizon)
    dt = float((t[-1] - t[0]) / (n - 1))
    speeds = _rows(rotor_speeds, "rotor_speeds", (n, 4))
    if states.shape != (n, 12):
        raise ShapeError(f"states must be ({n}, 12) and rotor_speeds ({n}, 4), got {states.shape}, {speeds.shape}")
    if count and (starts.min() < 0 or starts.max() + steps >= n):
        raise DataError(
            f"a window of {horizon:g} s that starts at row {starts.max()} leaves the {n} rows; start earlier"
        )
    scale, aged = recorded.get("rotor speed scale", 1.0), recorded.get("telemetry delay", 0.0)
    speeds = _earlier(speeds, aged / dt) / scale
    begin = np.zeros((count, STATES + parts.states))
    begin[:, :4] = from_euler(*states[starts, :3].T)
    begin[:, 4:13], begin[:, ROTORS:STATES] = states[starts, 3:], speeds[starts]
    given = rotors or rotors_of(model)
    if parts.inflow_lag:
        substeps = max(substeps, math.ceil(dt / parts.inflow_lag))
    orders = np.zeros((0, 4)) if commands is None else _rows(commands, "commands", (n, 4)) / scale
    if wind is None and blows.any():
        wind = np.tile(blows, (n, 1))
    air = np.zeros((0, 3)) if wind is None else _rows(wind, "wind", (n, 3))
    names = model.inputs[20:]
    extra = {"t": t, **(extra or {})}
    missing = [name for name in names if name not in extra]
    if missing:
        raise DataError(f"model {model.id} needs '{missing[0]}' for a roll-out; give it in `extra`")
    extras = np.zeros((n, 0)) if not names else np.column_stack([np.asarray(extra[m], float) for m in names])
    added = np.zeros((0, 6)) if offsets is None else -_rows(offsets, "offsets", (count, 6))
    frame = model.airframe
    gravity = GRAVITY if model.with_gravity else 0.0
    body = body_of(frame.mass if mass is None else mass, frame.inertia, model.kernel, gravity, given.up, given.down)
    put(parts, frame.hubs, body)
    lying = np.zeros(count, bool) if floor is None else states[starts, 11] > floor - parts.load_length
    out = np.empty((count, steps + 1, STATES))
    measured = speeds if commands is None else np.zeros((0, 4))

    def work(part: tuple[int, int]) -> None:
        run_windows(
            model.kernel, body, t, substeps, begin, measured, orders, given.delay / dt, given.lowest, given.highest,
            air, extras, added, lying, starts, *part, out,
        )  # fmt: skip

    workers = max(min(threads or os.cpu_count() or 1, count), 1)
    size = max(-(-count // (4 * workers)), 1)
    parts = [(a, min(a + size, count)) for a in range(0, count, size)]
    if len(parts) < 2 or workers == 1:
        for part in parts:
            work(part)
        return out
    work(parts[0])  # alone, so that it is compiled once
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, parts[1:]))
    return out


def twelve(x: np.ndarray) -> np.ndarray:
    """States (..., 17) as roll pitch yaw u v w p q r x y z (..., 12), angles in (-pi, pi]."""
    return np.concatenate([to_euler(x[..., :4]), x[..., 4:13]], axis=-1)


def rotors_of(model: Model) -> Rotors:
    """Lag and delay that a model knows of its rotors, and the airframe's limits of their speed."""
    known = drive_of(model.document)

    def value(*keys: str) -> Any:
        return next((known[k]["value"] for k in keys if (known.get(k) or {}).get("value") is not None), None)

    up, down = (value(f"time constants {way}", "time constants") for way in ("up", "down"))
    frame = model.airframe
    factor = frame.logged_to_rad_s or model.document.get("logged to rad/s")
    # the limits are in what is recorded, too
    factor = factor and factor / said_of_rotors(model).get("rotor speed scale", 1.0)
    low = frame.idle_rpm * factor if frame.idle_rpm is not None and factor else 0.0
    high = frame.max_rpm * factor if frame.max_rpm is not None and factor else math.inf
    late = value("delay")
    late = 0.0 if late is None else max(float(np.mean(late)), 0.0)
    lag = 1.0 / 35.0
    return Rotors(
        np.array(lag if up is None else up, float), np.array(lag if down is None else down, float), late, low, high
    )


def steps_of(t: np.ndarray, horizon: float) -> int:
    """Samples in a horizon (s), at least one. Raises DataError when time does not run evenly."""
    dt = np.diff(np.asarray(t, float))
    if not len(dt) or dt.min() <= 0 or dt.max() - dt.min() > 0.01 * dt.mean():
        raise DataError("a roll-out needs evenly spaced samples; resample the flight first")
    return max(round(horizon / float(dt.mean())), 1)


def _earlier(values: np.ndarray, samples: float) -> np.ndarray:
    """Rows (N, 4) as they were recorded so many samples later, linear between them, held beyond the ends."""
    if not samples:
        return values
    rows = np.arange(len(values), dtype=float)
    return np.column_stack([np.interp(rows + samples, rows, column) for column in values.T])


def _rows(values: np.ndarray, name: str, shape: tuple[int, int]) -> np.ndarray:
    array = np.ascontiguousarray(values, float)
    if array.shape != shape:
        raise ShapeError(f"{name} must be {shape}, got {array.shape}")
    return array
