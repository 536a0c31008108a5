"""Roll-outs of a model from measured states, compiled: many windows, with measured rotor speeds or with commands.

Each window begins in a measured state and is integrated by Runge-Kutta steps of the simulator's physics (`dynamics`).
Rotor speeds are linear between samples. Commands are constant between samples and act through delay, saturation and
lag. Wind and further inputs of the model are the means of their samples at both ends of a step.
"""

import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY, from_euler, to_euler
from quasi.errors import DataError, ShapeError
from quasi.model.extensions import actuators_of, read_rotor_constants, wind_of
from quasi.model.hover import check_flyable
from quasi.model.model import Model
from quasi.simulation.vehicle.dynamics import (
    RK4,
    count_inputs,
    integrate_step,
    make_body_constants,
    make_scratch,
    trim_extra_states,
)
from quasi.simulation.vehicle.layout import (
    EXTRA_INPUTS,
    GIVEN_ACCELERATION,
    LOAD_MASS,
    LOADS_OFFSET,
    ROOT_EFFECTIVENESS,
    ROTOR_SPEEDS,
    SPEED_CAP,
    STATE_SIZE,
    STEP_INPUTS_SIZE,
    TARGET_SPEED,
    WIND_VELOCITY,
)
from quasi.simulation.vehicle.payload_and_inflow import write_payload_and_inflow
from quasi.simulation.vehicle.variants import apply_extensions, drop_quasi_steady_terms, read_payload_and_inflow


class ActuatorDynamics(NamedTuple):
    """Actuator dynamics: time constants up and down, s, one or four; delay s; lowest and highest speed, rad/s."""

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
    """Integrate windows first .. stop - 1 and fill out (S, steps + 1, 17).

    t (N,) s; begin (S, 17 + own) states at the starts, payload and inflow not yet trimmed; speeds (N, 4) measured, or
    (0, 4) where commands (N, 4) drive the rotors, the latter `late` samples late, within low .. high; wind (N, 3) or
    (0, 3); extras (N, E); offsets (S, 6) or (0, 6) are subtracted from forces and moments; lying (S,) whether the
    payload lies on the floor
    """
    inputs, work, loads, last, derivatives, stage_state = make_scratch(kernel, begin.shape[1] - STATE_SIZE)
    step_inputs = np.zeros(STEP_INPUTS_SIZE + count_inputs(kernel) - 20)
    x = np.empty(begin.shape[1])
    mine = body.copy()
    whole = math.floor(late + 1e-9)
    part = max(late - whole, 0.0)
    for i in range(4):
        step_inputs[ROOT_EFFECTIVENESS + i], step_inputs[SPEED_CAP + i] = 1.0, np.inf
    steps = out.shape[1] - 1
    method = np.int64(RK4)  # as a literal it would be a type of its own, for which a step is compiled again
    for s in range(first, stop):
        for i in range(len(x)):
            x[i] = begin[s, i]
        for i in range(STATE_SIZE):
            out[s, 0, i] = x[i]
        mine[LOAD_MASS] = 0.0 if lying[s] else body[LOAD_MASS]
        if len(offsets):
            for i in range(6):
                mine[LOADS_OFFSET + i] = body[LOADS_OFFSET + i] + offsets[s, i]
        for n in range(steps):
            k = starts[s] + n
            dt = t[k + 1] - t[k]
            if len(wind):
                for i in range(3):
                    step_inputs[WIND_VELOCITY + i] = 0.5 * (wind[k, i] + wind[k + 1, i])
            for i in range(extras.shape[1]):
                step_inputs[EXTRA_INPUTS + i] = 0.5 * (extras[k, i] + extras[k + 1, i])
            for i in range(4):
                if len(speeds):
                    x[ROTOR_SPEEDS + i] = speeds[k, i]
                    step_inputs[GIVEN_ACCELERATION + i] = (speeds[k + 1, i] - speeds[k, i]) / dt
                else:
                    wanted = commands[max(k - whole, 0), i]
                    if part > 0.0:
                        wanted = (1.0 - part) * wanted + part * commands[max(k - whole - 1, 0), i]
                    step_inputs[TARGET_SPEED + i] = min(max(wanted, low), high)
                    step_inputs[GIVEN_ACCELERATION + i] = np.nan
            if n == 0:
                trim_extra_states(x, step_inputs, kernel, mine, inputs, work, loads)
            for _ in range(substeps):
                integrate_step(
                    method,
                    dt / substeps,
                    x,
                    step_inputs,
                    kernel,
                    mine,
                    inputs,
                    work,
                    loads,
                    last,
                    derivatives,
                    stage_state,
                )
            for i in range(STATE_SIZE):
                out[s, n + 1, i] = x[i]


def replay(
    model: Model,
    t: np.ndarray,
    states: np.ndarray,
    rotor_speeds: np.ndarray,
    starts: np.ndarray,
    horizon: float,
    commands: np.ndarray | None = None,
    rotors: ActuatorDynamics | None = None,
    wind: np.ndarray | None = None,
    extra: Mapping[str, np.ndarray] | None = None,
    offsets: np.ndarray | None = None,
    substeps: int = 1,
    threads: int | None = None,
    floor: float | None = None,
    mass: float | None = None,
    inertia: np.ndarray | None = None,
) -> np.ndarray:
    """Roll out a model with its extensions; return (S, steps + 1, 17), the simulator's states.

    Recorded rotor speeds are corrected for the telemetry delay and the speed scale of the extensions, and commands for
    the speed scale. Payload and inflow begin trimmed, because their motion at the start of a window is not measured:
    the payload at rest along the apparent vertical, the inflow in equilibrium with the present change of rotor speed.

    t             (N,) s, evenly spaced; states (N, 12) roll pitch yaw u v w (over ground) p q r x y z
    rotor_speeds  (N, 4) measured, rad/s; with `commands` those of the starts alone are used
    starts        (S,) rows; horizon s, rounded to whole samples, at least one
    commands      (N, 4) commanded speeds, rad/s, that drive the rotors instead; rotors: their dynamics, None for the
    model's
    wind          (N, 3) velocity of the air, m/s, earth axes; None for that of the model's extensions
    extra         {name: (N,)} further inputs of the model; the time "t" is always known
    offsets       (S, 6) N, N m, added to the model's forces and moments in each window
    threads       that share the windows, None takes all cores
    floor         z of the floor, m: a payload on it at the start of a window has no effect; None for no floor
    mass          mass of the vehicle in this flight, kg; None for the model's; inertia (3, 3) kg m2, alike
    A window that diverges holds inf or NaN from there on. Raises ShapeError or DataError.
    """
    model = apply_extensions(model)
    parts, recorded, blows = read_payload_and_inflow(model), read_rotor_constants(model), wind_of(model)
    model = drop_quasi_steady_terms(model)
    check_flyable(model, "a roll-out")
    t, states = np.ascontiguousarray(t, float), np.ascontiguousarray(states, float)
    starts = np.asarray(starts, np.int64)
    n, count = len(t), len(starts)
    steps = count_steps(t, horizon)
    dt = float((t[-1] - t[0]) / (n - 1))
    speeds = _check_rows(rotor_speeds, "rotor_speeds", (n, 4))
    if states.shape != (n, 12):
        raise ShapeError(f"states must be ({n}, 12) and rotor_speeds ({n}, 4), got {states.shape}, {speeds.shape}")
    if count and (starts.min() < 0 or starts.max() + steps >= n):
        raise DataError(
            f"a window of {horizon:g} s that starts at row {starts.max()} leaves the {n} rows; start earlier"
        )
    scale, aged = recorded.get("rotor speed scale", 1.0), recorded.get("telemetry delay", 0.0)
    speeds = _shift_earlier(speeds, aged / dt) / scale
    begin = np.zeros((count, STATE_SIZE + parts.states))
    begin[:, :4] = from_euler(*states[starts, :3].T)
    begin[:, 4:13], begin[:, ROTOR_SPEEDS:STATE_SIZE] = states[starts, 3:], speeds[starts]
    given = rotors or read_actuator_dynamics(model)
    if parts.inflow_lag:
        substeps = max(substeps, math.ceil(dt / parts.inflow_lag))
    orders = np.zeros((0, 4)) if commands is None else _check_rows(commands, "commands", (n, 4)) / scale
    if wind is None and blows.any():
        wind = np.tile(blows, (n, 1))
    air = np.zeros((0, 3)) if wind is None else _check_rows(wind, "wind", (n, 3))
    names = model.inputs[20:]
    extra = {"t": t, **(extra or {})}
    missing = [name for name in names if name not in extra]
    if missing:
        raise DataError(f"model {model.id} needs '{missing[0]}' for a roll-out; give it in `extra`")
    extras = np.zeros((n, 0)) if not names else np.column_stack([np.asarray(extra[m], float) for m in names])
    added = np.zeros((0, 6)) if offsets is None else -_check_rows(offsets, "offsets", (count, 6))
    frame = model.airframe
    own = frame.mass if mass is None else mass, frame.inertia if inertia is None else inertia
    # net forces hold the weight of the model's own mass
    held = 0.0 if model.with_gravity else 1.0 if mass is None or frame.mass is None else frame.mass / mass
    gravity = GRAVITY * (1.0 - held)
    body = make_body_constants(*own, model.kernel, gravity, given.up, given.down)
    write_payload_and_inflow(parts, frame.hubs, body)
    lying = np.zeros(count, bool) if floor is None else states[starts, 11] > floor - parts.load_length
    out = np.empty((count, steps + 1, STATE_SIZE))
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
    work(parts[0])  # the first part runs alone, so that the kernel is compiled once
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, parts[1:]))
    return out


def to_euler_states(x: np.ndarray) -> np.ndarray:
    """Convert states (..., 17) to roll pitch yaw u v w p q r x y z (..., 12), angles in (-pi, pi]."""
    return np.concatenate([to_euler(x[..., :4]), x[..., 4:13]], axis=-1)


def read_actuator_dynamics(model: Model) -> ActuatorDynamics:
    """Read lag and delay of the rotors from a model, and their speed limits from the airframe."""
    return ActuatorDynamics(*actuators_of(model)[:5])


def count_steps(t: np.ndarray, horizon: float) -> int:
    """Count the samples in a horizon (s), at least one. Raises DataError for uneven sampling."""
    dt = np.diff(np.asarray(t, float))
    if not len(dt) or dt.min() <= 0 or dt.max() - dt.min() > 0.01 * dt.mean():
        raise DataError("a roll-out needs evenly spaced samples; resample the flight first")
    return max(round(horizon / float(dt.mean())), 1)


def _shift_earlier(values: np.ndarray, samples: float) -> np.ndarray:
    """Shift rows (N, 4) earlier by a number of samples: linear interpolation, constant beyond the ends."""
    if not samples:
        return values
    rows = np.arange(len(values), dtype=float)
    return np.column_stack([np.interp(rows + samples, rows, column) for column in values.T])


def _check_rows(values: np.ndarray, name: str, shape: tuple[int, int]) -> np.ndarray:
    array = np.ascontiguousarray(values, float)
    if array.shape != shape:
        raise ShapeError(f"{name} must be {shape}, got {array.shape}")
    return array
