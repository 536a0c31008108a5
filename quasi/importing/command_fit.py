"""The map from commanded share to rotor speed, identified on one flight's own commands and rotor telemetry.

    dW/dt = (wanted(t - delay) - W) / tau,    wanted = (V / V_ref)^n (a0 + a1 c + a2 c^2)

tau, delay and n are common to the four rotors; a0, a1 and a2 belong to each rotor. For given tau, delay and n the
speeds are linear in the coefficients, so these are eliminated (variable projection) and three values are searched.

Source: Golub & Pereyra, SIAM J. Numer. Anal. 10, 1973 (variable projection); Newey & West, Econometrica 55, 1987
(covariance under autocorrelation).
"""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from quasi.terms.rotor_map import DELAY_RANGE, LOW_VOLTAGE, ROTOR_NUMBERS, STEADY_VOLTAGE, TAU_RANGE, lagged

FIT_RATE = 125.0  # Hz, commands and speeds are averaged to it, as the identification of actuators compares at
COMMAND_WARM_UP = 1.0  # s at the start that are not compared: the state of the lag is unknown there
SHORTEST_FIT = 5.0  # s of compared rows: ten times the longest time constant
MIN_SPEED_VARIATION = 0.02  # std over mean of a rotor's speed, as in the identification of actuators
MIN_EXPLAINED = 0.8  # share of the variance; below it a first-order lag does not describe the rotors
RESIDUAL_MEMORY = 0.3  # s over which residuals may be correlated, as in the drive's output-error fit
LAG_GRID = [(tau, delay) for tau in (0.01, 0.03, 0.1) for delay in (0.0, 0.02)]  # s, starting values


class _Samples(NamedTuple):
    """Averages at FIT_RATE: command and speed (m, 4), logarithm of the voltage ratio (m,), rows (m,) compared."""

    dt: float
    command: np.ndarray
    speed: np.ndarray
    ratio: np.ndarray
    rows: np.ndarray


def identify_command_map(frame: pd.DataFrame) -> dict[str, Any] | str:
    """The map of a flight, or a few words why there is none.

    frame    columns t (s, uniform), command1..4 (0..1), w1..w4 (rad/s); battery_voltage (V) and onboard_valid optional
    Returns  "coefficients" (4, 3) rad/s of 1, c, c^2; "voltage exponent", "time constant" (s), "delay" (s), each with
             "value" and "std"; "reference voltage" (V or None); "rms error" (4,) rad/s; "explained" (4,)
    """
    if not all(f"command{i}" in frame for i in ROTOR_NUMBERS):
        return "the log holds no commands of the four rotors"
    if not all(f"w{i}" in frame and np.isfinite(frame[f"w{i}"]).any() for i in ROTOR_NUMBERS):
        return "the log holds no speeds of the four rotors"
    samples, reference = _average(frame)
    if np.sum(samples.rows) * samples.dt < SHORTEST_FIT:
        return (
            f"{np.sum(samples.rows) * samples.dt:.1f} s hold commands and rotor speeds, {SHORTEST_FIT:g} s are needed"
        )
    speed = samples.speed[samples.rows]
    variation = np.std(speed, axis=0) / np.mean(speed, axis=0)
    if np.min(variation) < MIN_SPEED_VARIATION:
        return f"the speed of rotor {np.argmin(variation) + 1} varies by {100 * np.min(variation):.1f} % only"
    with_voltage = reference is not None
    low = [TAU_RANGE[0], DELAY_RANGE[0], -3.0][: 2 + with_voltage]
    high = [TAU_RANGE[1], DELAY_RANGE[1], 3.0][: 2 + with_voltage]

    def error(x: np.ndarray) -> np.ndarray:
        return _project(samples, x)[1].ravel()

    start = min(([*lag, *[0.0] * with_voltage] for lag in LAG_GRID), key=lambda x: np.sum(error(x) ** 2))
    scale = [0.01, 0.005, 0.3][: 2 + with_voltage]
    found = least_squares(error, start, bounds=(low, high), x_scale=scale, diff_step=1e-4).x
    if found[0] >= 0.99 * TAU_RANGE[1] or found[1] >= 0.99 * DELAY_RANGE[1]:
        return "the rotors do not follow their commands with a first-order lag"
    coefficients, residual = _project(samples, found)
    explained = 1.0 - np.var(residual, axis=0) / np.var(speed, axis=0)
    if np.min(explained) < MIN_EXPLAINED:
        return (
            f"commands explain {100 * np.min(explained):.0f} % of the speed of rotor {np.argmin(explained) + 1}, "
            f"at least {100 * MIN_EXPLAINED:.0f} % are needed"
        )
    flown = samples.command[samples.rows]
    for i in range(4):
        ends = np.array([flown[:, i].min(), flown[:, i].max()])
        if np.min(coefficients[i, 1] + 2 * coefficients[i, 2] * ends) < 0:
            return f"the speed of rotor {i + 1} would fall where its command rises"
    errors = _standard_errors(samples, found, coefficients, residual)
    if errors is None:
        return "commands vary too little to separate the constants of the map"

    def with_error(k: int, unit: str) -> dict[str, Any]:
        return {"value": float(found[k]), "std": float(errors[k]), "unit": unit}

    return {
        "coefficients": {
            "value": coefficients.tolist(), "std": errors[len(found) :].reshape(4, 3).tolist(), "unit": "rad/s"
        },
        "voltage exponent": with_error(2, "") if with_voltage else None,
        "reference voltage": reference,
        "time constant": with_error(0, "s"),
        "delay": with_error(1, "s"),
        "rms error": {"value": np.sqrt(np.mean(residual**2, axis=0)).tolist(), "unit": "rad/s"},
        "explained": explained.tolist(),
    }  # fmt: skip


def map_commands(frame: pd.DataFrame, found: dict[str, Any]) -> dict[str, np.ndarray]:
    """w1_CMD .. w4_CMD (n,), rad/s, by an identified map; never below 0."""
    factor: np.ndarray | float = 1.0
    if found["voltage exponent"]:
        volts = np.maximum(frame["battery_voltage"].to_numpy(float) / found["reference voltage"], 0.0)
        factor = volts ** found["voltage exponent"]["value"]
    result = {}
    for i, (a0, a1, a2) in zip(ROTOR_NUMBERS, found["coefficients"]["value"]):
        c = frame[f"command{i}"].to_numpy(float)
        result[f"w{i}_CMD"] = np.maximum(factor * (a0 + a1 * c + a2 * c * c), 0.0)
    return result


def _average(frame: pd.DataFrame) -> tuple[_Samples, float | None]:
    """Averages of neighbouring rows, and the reference voltage (V) where the voltage varies."""
    t = frame["t"].to_numpy(float)
    dt = float(np.median(np.diff(t)))
    every = max(round(1.0 / (FIT_RATE * dt)), 1)

    def mean(columns: np.ndarray) -> np.ndarray:
        return columns[: len(t) // every * every].reshape(len(t) // every, every, -1).mean(axis=1)

    command = mean(frame[[f"command{i}" for i in ROTOR_NUMBERS]].to_numpy(float))
    speed = mean(frame[[f"w{i}" for i in ROTOR_NUMBERS]].to_numpy(float))
    rows = np.isfinite(command).all(axis=1) & np.isfinite(speed).all(axis=1)
    rows &= (command > 0.0).all(axis=1) & (speed > 0.0).all(axis=1)  # stopped rotors follow no map
    if "onboard_valid" in frame:
        rows &= mean(frame["onboard_valid"].to_numpy(float))[:, 0] > 0.5
    ratio, reference = np.zeros(len(command)), None
    if "battery_voltage" in frame:
        volts = mean(frame["battery_voltage"].to_numpy(float))[:, 0]
        known = np.isfinite(volts) & (volts > 0.0)
        median = float(np.median(volts[known & rows])) if (known & rows).any() else 0.0
        known &= volts > LOW_VOLTAGE * median
        if median > 0.0 and np.std(volts[known & rows]) >= STEADY_VOLTAGE * median:
            reference, rows = median, rows & known
            ratio = np.log(np.where(known, volts, median) / median)
    rows[: round(COMMAND_WARM_UP / (dt * every))] = False
    # rows after a gap or a stop wait until the lag has forgotten it
    broken = ~rows
    age = np.arange(len(rows)) - np.maximum.accumulate(np.where(broken, np.arange(len(rows)), -1))
    rows &= age * dt * every > 0.2
    return _Samples(dt * every, np.nan_to_num(command), speed, ratio, rows), reference


def _regressors(samples: _Samples, x: np.ndarray) -> np.ndarray:
    """1, c and c^2 (4, m, 3) with voltage, delay x[1] and lag x[0], at the compared rows."""
    factor = np.exp((x[2] if len(x) > 2 else 0.0) * samples.ratio)[:, None]
    wanted = np.concatenate([factor * samples.command**power for power in range(3)], axis=1)
    followed = lagged(wanted, samples.dt, x[0], x[1])[samples.rows]
    return followed.reshape(-1, 3, 4).transpose(2, 0, 1)


def _project(samples: _Samples, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (4, 3) that fit best for given lag, delay and exponent; residual (m, 4), rad/s."""
    columns, speed = _regressors(samples, x), samples.speed[samples.rows]
    coefficients = np.stack([np.linalg.lstsq(columns[i], speed[:, i], rcond=None)[0] for i in range(4)])
    return coefficients, speed - np.einsum("imk,ik->mi", columns, coefficients)


def _standard_errors(
    samples: _Samples, x: np.ndarray, coefficients: np.ndarray, residual: np.ndarray
) -> np.ndarray | None:
    """Standard errors (len(x) + 12,), robust to autocorrelation over RESIDUAL_MEMORY; None where not separable."""
    columns, free = _regressors(samples, x), len(x)
    jacobian = np.zeros((*residual.shape, free + 12))
    for k, step in enumerate((1e-4, 1e-4, 1e-3)[:free]):
        ends = [_regressors(samples, x + sign * step * (np.arange(free) == k)) for sign in (1, -1)]
        jacobian[:, :, k] = np.einsum("imk,ik->mi", ends[0] - ends[1], coefficients) / (2 * step)
    for i in range(4):
        jacobian[:, i, free + 3 * i : free + 3 * i + 3] = columns[i]
    flat = jacobian.reshape(-1, free + 12)
    scale = np.linalg.norm(flat, axis=0)
    if not np.all(scale > 0):
        return None
    normal = (flat / scale).T @ (flat / scale)
    if np.linalg.cond(normal) > 1e14:  # of scaled columns; close to the resolution of doubles
        return None
    bread = np.linalg.inv(normal)
    scores = np.einsum("mip,mi->mp", jacobian / scale, residual)
    meat, reach = scores.T @ scores, round(RESIDUAL_MEMORY / samples.dt)
    for lag in range(1, reach):
        cross = scores[lag:].T @ scores[:-lag]
        meat += (1.0 - lag / reach) * (cross + cross.T)
    return np.sqrt(np.diag(bread @ meat @ bread)) / scale
