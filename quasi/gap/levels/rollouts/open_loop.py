"""Roll-outs: open-loop simulations of models over held-out flights, and how far they end from what was measured."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from quasi.attitude import conjugate, from_euler, logarithm, multiply, rotate, rotate_inverse
from quasi.gap.levels.forces.error_reduction import states_of
from quasi.gap.statistics import blocks
from quasi.model.columns import ROTORS
from quasi.model.extensions import (
    are_estimated,
    changes_of_map,
    compute_flight_inertia,
    compute_flight_mass,
    correct_estimated_speeds,
    drive_of,
    shift_of,
    wind_of,
)
from quasi.model.model import Model
from quasi.simulation.tools.replay import ActuatorDynamics, count_steps, replay, to_euler_states
from quasi.simulation.tools.rollout import compute_errors
from quasi.terms.rotor_map import COMMANDED, SHARES

EVERY = 0.2  # s between the starts of two windows
HORIZON = 0.5  # s, of the reported error: beyond it small vehicles are half a turn off and errors say little
GAINED = "the error falls most"  # why one of the windows is shown
TYPICAL = "the error falls as in the median"
ERROR_UNITS = {"position": "m", "velocity": "m/s", "attitude": "rad", "rate": "rad/s"}
VECTOR_SIZE = 12  # of `vectors`
UVW = slice(3, 6)  # of states
MOVED_BY = {"Fx": "velocity x", "Fy": "velocity y", "Fz": "velocity z", "Mx": "rate x", "My": "rate y", "Mz": "rate z"}
COLUMN = dict(zip(MOVED_BY, (0, 1, 2, 6, 7, 8)))  # of `vectors`
VECTORS = {"position": slice(9, 12), "velocity": slice(0, 3), "attitude": slice(3, 6), "rate": slice(6, 9)}
WITHOUT_TRIM, WITH_TRIM, WITH_COMMANDS = (
    "rollouts",
    "rollouts with trim",
    "rollouts from commands",
)  # measured rotor speeds drive, with trim; commands drive


class Flight(NamedTuple):
    """A held-out flight: its table, and what roll-outs need of it; mass  kg that it was logged with, where known."""

    key: str
    table: pd.DataFrame
    t: np.ndarray
    states: np.ndarray
    speeds: np.ndarray
    valid: np.ndarray
    mass: float | None = None
    inertia: np.ndarray | None = None


def flight_of(key: str, table: pd.DataFrame, mass: float | None = None, inertia: np.ndarray | None = None) -> Flight:
    """A filtered flight made ready. mass  kg, inertia  (3, 3) kg m2: those that it was processed with"""
    return Flight(key, table, *states_of(table), mass, inertia)


def air_of(model: Model, flight: Flight) -> np.ndarray | None:
    """Velocity of the air (N, 3), m/s, earth axes: what the flight knows of it and the model's extensions; None for 0.

    What the flight knows is the difference of its velocities over ground and through the air, as forces are asked of.
    """
    wind = np.tile(wind_of(model), (len(flight.t), 1))
    names = [f"{c}_air" for c in "uvw"]
    if all(n in flight.table for n in names):
        known = flight.states[:, 3:6] - flight.table[names].to_numpy(float)
        wind = wind + rotate(from_euler(*flight.states[:, :3].T), np.nan_to_num(known))
    return wind if wind.any() else None


def commands_of(model: Model, flight: Flight) -> np.ndarray | None:
    """Commanded rotor speeds (N, 4), rad/s: logged, or by the model's command map; None where neither is there.

    The map is (V / reference voltage)^exponent times a polynomial of the command; an extension may replace the
    exponent, and give the reference where the map does not. Without a voltage, or a reference for it, the map holds as
    it is.
    """
    table = flight.table
    if all(c in table for c in COMMANDED):
        commands = table[list(COMMANDED)].to_numpy(float)
    else:
        held = drive_of(model.document).get("command map")
        if not held or not all(c in table for c in SHARES):
            return None
        shares = table[list(SHARES)].to_numpy(float)
        powers = held.get("powers", range(len(held["coefficients"])))
        commands = sum(c * shares**k for c, k in zip(held["coefficients"], powers))
        exponent, reference = (held.get("voltage exponent") or {}).get("value"), held.get("reference voltage")
        if exponent and reference and "battery_voltage" in table:
            ratio = table["battery_voltage"].to_numpy(float) / float(reference)
            commands = commands * np.where(ratio > 0, ratio, np.nan)[:, None] ** exponent
    known = np.isfinite(commands).all(axis=1)
    return commands if known[flight.valid].mean() > 0.5 else None


def windows(flight: Flight, horizon: float) -> np.ndarray:
    """Rows at which windows start: all of a window is valid."""
    steps = count_steps(flight.t, horizon)
    sums = np.concatenate([[0], np.cumsum(~flight.valid)])
    every = max(round(EVERY / float(np.median(np.diff(flight.t)))), 1)
    starts = np.arange(0, len(flight.t) - steps - 1, every)
    return starts[sums[starts + steps + 1] == sums[starts]]


def simulated(
    model: Model, flight: Flight, starts: np.ndarray, horizon: float, commands: np.ndarray | None = None,
    offsets: np.ndarray | None = None, rotors: ActuatorDynamics | None = None,
) -> np.ndarray:  # fmt: skip
    """States (S, steps + 1, 12) of a model from the measured ones at `starts`; offsets (S, 6) as of `replay`.

    commands  (N, 4) rad/s that drive the rotors; None takes the measured rotor speeds; rotors  how they follow them,
              None takes what the model knows
    """
    air, mass = air_of(model, flight), compute_flight_mass(model, flight.mass)
    inertia = None if flight.inertia is None else compute_flight_inertia(model, flight.inertia)
    extra = {n: np.nan_to_num(flight.table[n].to_numpy(float)) for n in model.inputs[20:] if n in flight.table}
    commands = None if commands is None else np.nan_to_num(commands)
    shift, states = shift_of(model), flight.states
    if shift.any():  # what is measured at the configured cg, at the true one
        states = states.copy()
        states[:, 3:6] += np.cross(states[:, 6:9], shift)
        states[:, 9:] += rotate(from_euler(*states[:, :3].T), shift)
    driven = (commands, rotors, air, extra or None, offsets)
    changed, speeds = changes_of_map(model), flight.speeds
    if changed.any and are_estimated(flight.table):
        corrected = correct_estimated_speeds({n: flight.table[n] for n in flight.table}, changed)
        speeds = np.nan_to_num(np.stack([corrected[n] for n in ROTORS], axis=1))
    run = to_euler_states(
        replay(model, flight.t, states, speeds, starts, horizon, *driven, floor=0.0, mass=mass, inertia=inertia)
    )
    if shift.any():
        run[..., 3:6] -= np.cross(run[..., 6:9], shift)
        run[..., 9:] -= rotate(from_euler(*np.moveaxis(run[..., :3], -1, 0)), shift)
    return run


def in_own_constants(trim: np.ndarray, model: Model, flight: Flight) -> np.ndarray:
    """A trim (S, 6) that instruments show with the configured mass and inertia, in those that a model has."""
    mass, found = compute_flight_mass(model, flight.mass), trim.copy()
    if mass and flight.mass is not None and np.isfinite(flight.mass):
        found[:, :3] *= mass / flight.mass
    if flight.inertia is not None:
        found[:, 3:] = found[:, 3:] @ np.linalg.solve(flight.inertia, compute_flight_inertia(model, flight.inertia))
    return found


def vectors(run: np.ndarray, flight: Flight, starts: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Measured minus simulated at `lags` rows after the starts (S, K, VECTOR_SIZE), along the measured body axes.

    run  (S, steps + 1, 12) of `simulated`
    Velocity in the earth frame, m/s; attitude as a rotation vector, rad; rates, rad/s; position, m. NaN once a window
    has diverged.
    """
    run, measured = run[:, lags], flight.states[np.asarray(starts, int)[:, None] + lags]
    q, wanted = (from_euler(*np.moveaxis(s[..., :3], -1, 0)) for s in (run, measured))
    with np.errstate(invalid="ignore", over="ignore"):
        velocity = measured[..., 3:6] - rotate_inverse(wanted, rotate(q, run[..., 3:6]))
        turn = logarithm(multiply(conjugate(q), wanted))
        position = rotate_inverse(wanted, measured[..., 9:] - run[..., 9:])
        found = np.concatenate([velocity, turn, measured[..., 6:9] - run[..., 6:9], position], axis=-1)
    return np.where(np.isfinite(found).all(axis=-1, keepdims=True), found, np.nan)


def table_of(flight: Flight, starts: np.ndarray, compute_errors: np.ndarray, horizons: Sequence[float]) -> pd.DataFrame:
    """Errors (S, K, VECTOR_SIZE) after each of the horizons as rows: flight, start (s), horizon (s), and `sizes`."""
    about = {"flight": flight.key, "start": flight.t[starts]}
    return joined(
        [pd.DataFrame({**about, "horizon": float(h), **sizes(compute_errors[:, k])}) for k, h in enumerate(horizons)]
    )


def joined(rows: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Tables of errors under one another."""
    columns = ["flight", "start", "horizon", *ERROR_UNITS, *MOVED_BY.values()]
    return pd.concat(rows, ignore_index=True) if rows else pd.DataFrame(columns=columns)


def sizes(compute_errors: np.ndarray) -> dict[str, np.ndarray]:
    """{quantity: (S,)} of errors (S, VECTOR_SIZE): the norms of ERROR_UNITS, absolute values of MOVED_BY."""
    norms = {q: np.linalg.norm(compute_errors[:, place], axis=1) for q, place in VECTORS.items()}
    return norms | dict(zip(MOVED_BY.values(), np.abs(compute_errors[:, list(COLUMN.values())]).T))


def rms(table: pd.DataFrame) -> dict[str, dict[str, float]]:
    """{quantity: {horizon: root mean square}} of end errors; diverged windows count with the largest finite error."""
    result: dict[str, dict[str, float]] = {}
    for horizon, part in table.groupby("horizon"):
        for quantity in (*ERROR_UNITS, *MOVED_BY.values()):
            result.setdefault(quantity, {})[f"{horizon:g}"] = float(np.sqrt(np.mean(finite(part[quantity]) ** 2)))
    return result


def squares(tables: Sequence[pd.DataFrame], quantities: Sequence[str]) -> list[np.ndarray]:
    """Squared end errors (windows, len(quantities)) of one horizon under each model, see `finite`."""
    return [np.stack([finite(one[q], *(t[q] for t in tables)) ** 2 for q in quantities], axis=1) for one in tables]


def fell(old: pd.DataFrame, new: pd.DataFrame, seed: int = 0) -> list[dict[str, object]]:
    """By how much each error fell: horizon, quantity, share of the root mean square with its interval (95 %).

    Windows are drawn anew in blocks of the flights, the same ones before and after, see `blocks`.
    """
    names = (*ERROR_UNITS, *MOVED_BY.values())
    rows = []
    for horizon, first in old.groupby("horizon"):
        both = np.stack(squares([first, new[new["horizon"] == horizon]], names), axis=1)
        found = blocks.drawn(first["flight"].to_numpy(), first["start"].to_numpy(), both, seed)
        mean, draws = np.sqrt(both.mean(axis=0)), np.sqrt(found.sums)
        gone, drawn = (-np.diff(p, axis=-2)[..., 0, :] / np.maximum(p[..., 0, :], 1e-150) for p in (mean, draws))
        for k, quantity in enumerate(names):
            low, high = blocks.interval(float(gone[k]), drawn[:, k], found.wider)
            rows.append(
                {"horizon": float(horizon), "quantity": quantity, "low": low, "high": high,
                 "value": float(gone[k]), "before": float(mean[0, k]), "after": float(mean[1, k])}
            )  # fmt: skip
    return rows


def overlays(models: Mapping[str, Model], flights: Sequence[Flight], horizon: float) -> pd.DataFrame:
    """A few windows state by state: window, flight, why, t, each state as <state>_measured and <state>_<model's word>.

    Taken are the window whose velocity error fell most from the first model to the last, one where it fell as much as
    in the median, and the one whose error was the greatest under the first model. In the median windows count by what
    the last model changes in them next to the median error, at most once: slow ones show nothing of what acts at speed.
    """
    found = []
    for number, flight in enumerate(flights):
        starts = windows(flight, horizon)
        if len(starts):
            runs = [
                simulated(m, flight, starts, horizon) for m in (next(iter(models.values())), [*models.values()][-1])
            ]
            ends = [compute_errors(run, flight.states, starts)["velocity"][:, -1] for run in runs]
            ends = [finite(end, *ends) for end in ends]
            with np.errstate(all="ignore"):  # of what diverges
                changes = finite(np.linalg.norm((runs[1] - runs[0])[:, -1, UVW], axis=1))
            found += [(old - new, old, number, s, change) for old, new, s, change in zip(*ends, starts, changes)]
    if not found:
        return pd.DataFrame({"window": [], "flight": [], "t": []})
    by_gain = sorted(found, reverse=True)
    usual = float(np.median([old for _, old, *_ in found]))
    shares = np.cumsum([change / np.hypot(change, max(usual, 1e-12)) for *_, change in by_gain])
    chosen = {
        GAINED: by_gain[0],
        TYPICAL: by_gain[int(np.searchsorted(shares, 0.5 * shares[-1]))],
        "the error was greatest": max(found, key=lambda f: f[1]),
    }
    parts = []
    for window, (why, (_, _, number, start, _)) in enumerate(chosen.items()):
        flight = flights[number]
        rows = slice(start, start + count_steps(flight.t, horizon) + 1)
        table = {"window": window, "flight": flight.key, "why": why, "t": flight.t[rows]}
        runs = {"measured": flight.states[rows]}
        runs |= {word: simulated(m, flight, np.array([start]), horizon)[0] for word, m in models.items()}
        for k, name in enumerate(("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z")):
            table |= {f"{name}_{word}": run[:, k] for word, run in runs.items()}
        parts.append(pd.DataFrame(table))
    return pd.concat(parts, ignore_index=True)


def finite(values: np.ndarray | pd.Series, *others: np.ndarray | pd.Series) -> np.ndarray:
    """Errors, those of diverged windows replaced by the largest finite one of these and of the others.

    others  errors of the same windows under other models: what diverges under one alone is no smaller there. Where
    nothing is finite all are infinite, and 0 with others: then no model is better.
    """
    every = np.concatenate([np.ravel(np.asarray(v, float)) for v in (values, *others)])
    largest = every[np.isfinite(every)].max(initial=0.0)
    if not others and len(every) and not np.isfinite(every).any():
        largest = np.inf
    return np.where(np.isfinite(values), values, largest)
