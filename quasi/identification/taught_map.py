"""The map from commands to rotor speeds on flights that measure both, for flights of the same model that do not.

    W_i = S_i f(c_i, V) behind its delay and lag

Commands and speeds of filtered flights went through the same low-pass, which leaves the lag as it is. The speeds S_i
are linear and are eliminated; lag, delay, shape and voltage exponent are searched (output error).

Source: Golub & Pereyra, SIAM J. Numer. Anal. 10, 1973 (variable projection); Schwarz, Annals of Statistics 6, 1978.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from quasi.errors import DataError
from quasi.identification.actuators import COMPARED_RATE_HZ, STRETCH_WARM_UP
from quasi.identification.regression import ends_within, memory_windows
from quasi.terms.rotor_map import FORMS, SHARES, SPEEDS, STEADY_VOLTAGE, lagged, ranges_of, shape

SHORTEST_COMPARED = 5.0  # s of compared rows of all flights together: ten times the longest time constant


class _Taught(NamedTuple):
    """One flight: dt s, step s between compared rows, commands (N, 4) over the operating command, ratio (N, 1) of
    voltages or 1, speeds (M, 4) rad/s at the compared rows (M,)."""

    dt: float
    step: float
    commands: np.ndarray
    ratio: np.ndarray | float
    speeds: np.ndarray
    rows: np.ndarray


def teaching_flights(flights: Mapping[str, pd.DataFrame]) -> list[str]:
    """Keys of flights that hold the speeds and the commanded shares of all four rotors."""
    return [k for k, f in flights.items() if all(n in f for n in (*SPEEDS, *SHARES))]


def teach_map(
    flights: Mapping[str, pd.DataFrame], chosen: Mapping[str, np.ndarray], forms: Sequence[str], volts: bool = True
) -> dict[str, Any]:
    """The section "rotor speeds" of a model from flights that measure rotor speeds.

    flights  filtered; chosen {flight: (n,) bool} rows to use; forms  names of `rotor_map.FORMS`, compared by BIC
    volts    whether all flights that are to be estimated log the battery voltage: without it the map has none either,
             so that its error holds what the voltage does
    Raises DataError where the rows are too few.
    """
    commands = np.concatenate([f[list(SHARES)].to_numpy(float)[chosen[k]].ravel() for k, f in flights.items()])
    operating, reference = float(np.median(commands)) if len(commands) else 0.0, None
    if volts and all("battery_voltage" in f for f in flights.values()):
        logged = np.concatenate([f["battery_voltage"].to_numpy(float)[chosen[k]] for k, f in flights.items()])
        if len(logged) and np.std(logged) >= STEADY_VOLTAGE * np.median(logged) > 0.0:
            reference = float(np.median(logged))
    taught = {k: _prepare(f, chosen[k], operating, reference) for k, f in flights.items()}
    taught = {k: f for k, f in taught.items() if len(f.rows)}
    seconds = sum(len(f.rows) * f.step for f in taught.values())
    if seconds < SHORTEST_COMPARED or operating <= 0.0:
        raise DataError(
            f"flights {', '.join(flights)} hold {seconds:.1f} s of commands and rotor speeds that could teach the "
            f"others, {SHORTEST_COMPARED:g} s are needed; log rotor speeds for longer, or leave the others out"
        )
    found = {form: _fit(form, list(taught.values()), reference is not None) for form in forms}
    # a form that does not fit leaves residuals that remember: all forms have the rows of the one that fits best
    memory = min(found.values(), key=lambda fit: fit["squares"])["memory"]
    for fit in found.values():
        rows, count = fit["count"] / memory, len(fit["x"]) + 4
        fit["criterion"] = rows * np.log(fit["squares"]) + count * np.log(fit["count"])
    best = min(found, key=lambda form: found[form]["criterion"])
    return _as_plain(found, best, list(taught), operating, reference)


def _prepare(flight: pd.DataFrame, chosen: np.ndarray, operating: float, reference: float | None) -> _Taught:
    t = flight["t"].to_numpy(float)
    dt = float(np.median(np.diff(t)))
    ratio: np.ndarray | float = 1.0
    if reference is not None:
        ratio = flight["battery_voltage"].to_numpy(float)[:, None] / reference
    every = max(round(1.0 / (COMPARED_RATE_HZ * dt)), 1)
    rows = np.flatnonzero(chosen & (t - t[0] > STRETCH_WARM_UP))[::every]
    commands = np.maximum(flight[list(SHARES)].to_numpy(float), 0.0) / max(operating, 1e-9)
    return _Taught(dt, every * dt, commands, ratio, flight[list(SPEEDS)].to_numpy(float)[rows], rows)


def _fit(form: str, flights: Sequence[_Taught], with_voltage: bool) -> dict[str, Any]:
    about = FORMS[form]
    count = len(about.names)
    names = ("time constant", "delay", *about.names, *(("voltage exponent",) if with_voltage else ()))
    low, high = ranges_of(form, names)
    size = np.array([0.01, 0.005, *[0.2] * (len(low) - 2)])
    speeds = np.concatenate([f.speeds for f in flights])

    def relative(x: np.ndarray) -> np.ndarray:
        exponent = x[-1] if with_voltage else 0.0
        parts = [lagged(shape(form, f.commands, f.ratio, exponent, x[2 : 2 + count]), f.dt, x[0], x[1])[f.rows]
                 for f in flights]  # fmt: skip
        return np.concatenate(parts)

    def project(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        columns = relative(x)
        at = np.sum(columns * speeds, axis=0) / np.maximum(np.sum(columns**2, axis=0), 1e-12)
        return at, speeds - columns * at

    start = np.array([0.03, 0.005, *about.start, *[0.7] * with_voltage])
    x = least_squares(
        lambda x: project(x)[1].ravel(), start, bounds=(low, high), x_scale=size, diff_step=1e-3, max_nfev=40
    ).x
    at, residual = project(x)
    ends = [ends_within(x, k, step, low, high) for k, step in enumerate(1e-2 * size)]
    jacobian = np.stack([((project(up)[1] - project(down)[1]) / d).ravel() for up, down, d in ends], axis=1)
    # neighbouring residuals resemble each other: each counts for the share that is its own
    lengths = np.cumsum([len(f.rows) for f in flights])
    series = np.split(np.arange(lengths[-1]), lengths[:-1])
    memory = max(np.mean(memory_windows(residual.T, series)) / 5.0, 1.0)
    squares = float(np.mean(residual**2))
    covariance = squares * memory * np.linalg.pinv(jacobian.T @ jacobian)
    means = [np.mean(r, axis=0) for r in np.split(residual, lengths[:-1])]
    return {
        "names": names,
        "x": x,
        "speeds": at,
        "covariance": covariance,
        "memory": memory,
        "squares": squares,
        "count": residual.size,
        "within": float(np.sqrt(squares)) / float(np.mean(speeds)),
        # the speed of each of the four rotors is common to the flights
        "between": float(np.std(means, ddof=4)) / float(np.mean(speeds)) if len(flights) > 1 else None,
    }


def _as_plain(
    found: Mapping[str, Mapping[str, Any]], best: str, keys: list[str], operating: float, reference: float | None
) -> dict[str, Any]:
    fit = found[best]
    std = np.sqrt(np.diag(fit["covariance"]))
    units = {"time constant": "s", "delay": "s"}
    entries = {
        name: {"value": float(v), "std": float(s), "unit": units.get(name, "")}
        for name, v, s in zip(fit["names"], fit["x"], std)
    }
    between = fit["between"]
    return {
        "source": "commands",
        "input": "share",
        "form": best,
        "parameters": {name: entries[name] for name in FORMS[best].names},
        "operating command": operating,
        "reference voltage": reference,
        "voltage exponent": entries.get("voltage exponent"),
        "speeds": {"value": fit["speeds"].tolist(), "unit": "rad/s"},
        "time constant": entries["time constant"],
        "delay": entries["delay"],
        "estimated": list(fit["names"]),
        "covariance": fit["covariance"].tolist(),
        "relative error": {
            "map": fit["within"],
            "between flights": between,
            # another flight differs from the mean of these
            "total": float(np.hypot(fit["within"], (between or 0.0) * np.sqrt(1.0 + 1.0 / len(keys)))),
        },
        "scale": {"relative": False, "from": f"speeds measured in {', '.join(keys)}", "trimmed": False},
        "factors": None,
        "geometry": None,
        "flights": keys,
        "candidates": [{"form": n, "BIC": float(f["criterion"] - fit["criterion"])} for n, f in found.items()],
    }
