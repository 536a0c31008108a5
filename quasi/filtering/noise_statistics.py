"""Noise of sensors at rest: mean and standard deviation of every quantity, pooled over rest logs.

A rest log is one of a quadrotor that stands still, best armed with its rotors idling: their vibration is part of what
the filter has to live with.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from quasi import attitude
from quasi.errors import DataError
from quasi.filtering.bias import REST_BLOCK, STEADY_ACCEL, STEADY_GYRO, STILL_ACCEL, STILL_GYRO
from quasi.sensor_limits import runs_of

RATES, FORCE, EULER_ANGLES = ("p", "q", "r"), ("ax", "ay", "az"), ("roll", "pitch", "yaw")
CUT = 0.1  # of a log is left out at either end: switching, hands
LEAST_SECONDS, LEAST_REST_SAMPLES = 2.0, 200
STEADY_ANGLE = np.radians(1.0)  # rad, how far block means of an attitude at rest may differ
TURNING = 0.3  # of the greatest rotor speed: rotors turn
UNEVEN = 3.0  # ratio of noise levels within a log that is worth a word


@dataclass(frozen=True)
class RestLog:
    """One rest log: t (n,) s; columns {quantity: (n,)}, SI, body FRD, NaN where missing, of RATES, FORCE and, if there
    is one, EULER_ANGLES; speeds (n, rotors) rad/s or None; step {quantity: step of the log's numbers, 0 if unknown}."""

    name: str
    t: np.ndarray
    columns: Mapping[str, np.ndarray]
    speeds: np.ndarray | None = None
    step: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Statistics:
    """values {quantity: {"mean", "std"}}; seconds {log: used}; samples {quantity: used}; notes."""

    values: dict[str, dict[str, float]]
    seconds: dict[str, float]
    samples: dict[str, int]
    notes: list[str]


def noise_statistics(logs: Sequence[RestLog], cut: float = CUT) -> Statistics:
    """Mean and standard deviation per sample of each quantity, pooled over logs whose own means are taken off.

    cut  share of each log left out at either end. Where rotors turn in part of a log, only that part counts. No
    standard deviation is smaller than what rounding to the log's steps alone would make (step / sqrt(12)).
    Raises DataError for a log that moves, is too short, or holds a quantity that does not change at all.
    """
    if not 0.0 <= cut < 0.45:
        raise DataError(f"the share cut from either end is {cut:g}, expected 0 to 0.45")
    notes: list[str] = []
    seconds: dict[str, float] = {}
    sums: dict[str, np.ndarray] = {}  # samples, degrees of freedom, sum of squares, sum of values
    finest: dict[str, float] = {}
    for log in logs:
        part = _still_part(log, cut, notes)
        seconds[log.name] = float(log.t[part][-1] - log.t[part][0])
        for name, column in log.columns.items():
            values = np.asarray(column, float)[part]
            fine = np.isfinite(values)
            if not fine.any() and name in EULER_ANGLES:
                continue
            if fine.mean() < 0.5:
                raise DataError(f"{log.name}: '{name}' is missing in more than half of the log; log it again")
            if not fine.all():
                notes.append(f"{log.name}: '{name}' is missing in {int((~fine).sum())} samples, which are left out")
            values = np.unwrap(values[fine]) if name in EULER_ANGLES else values[fine]
            _refuse_motion(log, name, log.t[part][fine], values)
            step = max(float(log.step.get(name, 0.0)), _seen_step(values))
            if np.ptp(values) == 0.0 and step == 0.0:
                raise DataError(
                    f"{log.name}: '{name}' is {values[0]:g} all through the log; a sensor that works has noise: check "
                    "the log and its column mapping"
                )
            centred = values - values.mean()
            _say_uneven(log, name, centred, notes)
            finest[name] = max(finest.get(name, 0.0), step)
            entry = np.array([len(values), len(values) - 1, centred @ centred, values.sum()])
            sums[name] = sums.get(name, 0.0) + entry
    missing = [n for n in (*RATES, *FORCE) if n not in sums]
    if missing:
        raise DataError(f"the rest logs hold no '{missing[0]}'; log gyro and accelerometer")
    values = {}
    for name in (*FORCE, *RATES, *EULER_ANGLES):
        if name not in sums:
            continue
        count, freedom, squares, total = sums[name]
        std, floor = float(np.sqrt(squares / freedom)), finest[name] / np.sqrt(12.0)
        if std < floor:
            notes.append(
                f"the noise of '{name}' ({std:.3g}) is finer than the log's own steps of {finest[name]:.3g}; what "
                f"rounding makes ({floor:.3g}) stands instead"
            )
        values[name] = {"mean": float(total / count), "std": max(std, floor)}
    return Statistics(values, seconds, {name: int(entry[0]) for name, entry in sums.items()}, notes)


def _still_part(log: RestLog, cut: float, notes: list[str]) -> slice:
    """The part of a log to use: where the rotors turn, if they do, without its ends."""
    first, last = 0, len(log.t)
    if log.speeds is not None and len(log.t):
        mean = np.nan_to_num(np.asarray(log.speeds, float)).mean(axis=1)
        turning = runs_of(mean > TURNING * mean.max()).tolist()
        if turning and turning != [[0, last]]:
            first, last = max(turning, key=lambda span: span[1] - span[0])
            notes.append(
                f"{log.name}: the rotors turn from t = {log.t[first]:.2f} s to {log.t[last - 1]:.2f} s only; this part "
                "is used"
            )
    length = last - first
    first, last = first + int(cut * length), last - int(cut * length)
    if last - first < LEAST_REST_SAMPLES or log.t[last - 1] - log.t[first] < LEAST_SECONDS:
        span = float(log.t[last - 1] - log.t[first]) if last > first else 0.0
        raise DataError(
            f"{log.name}: {span:.1f} s and {max(last - first, 0)} samples are left after cutting {100 * cut:g} % from "
            f"either end, at least {LEAST_SECONDS:g} s and {LEAST_REST_SAMPLES} are needed; log a longer rest"
        )
    return slice(first, last)


def _blocks(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of blocks of REST_BLOCK s, and the times at which these begin."""
    size = max(2, round(REST_BLOCK / float(np.median(np.diff(t)))))
    count = len(values) // size
    return t[: count * size : size], values[: count * size].reshape(count, size).mean(axis=1)


def _refuse_motion(log: RestLog, name: str, t: np.ndarray, values: np.ndarray) -> None:
    limit, unit = {
        **dict.fromkeys(RATES, (STEADY_GYRO, "rad/s")),
        **dict.fromkeys(FORCE, (STEADY_ACCEL, "m/s2")),
        **dict.fromkeys(EULER_ANGLES, (STEADY_ANGLE, "rad")),
    }[name]
    at, means = _blocks(t, values)
    away = np.abs(means - np.median(means))
    # noise alone scatters the means of blocks too; motion is what it does not explain
    size = max(2, len(values) // max(len(means), 1))
    white = float(np.median(np.abs(np.diff(values)))) / 0.6745 / np.sqrt(2.0 * size)
    allowed = max(limit, 8.0 * white)
    worst = int(np.argmax(away))
    if away[worst] > allowed:
        raise DataError(
            f"{log.name} moves: '{name}' is {away[worst]:.3g} {unit} from its median at t = {at[worst]:.2f} s, at most "
            f"{allowed:.2g} is a rest; log a quadrotor that stands still, or cut more from the ends"
        )
    if name in RATES and abs(np.median(means)) > STILL_GYRO:
        raise DataError(
            f"{log.name} turns: the mean of '{name}' is {np.median(means):.3g} rad/s, at most {STILL_GYRO:g} is rest; "
            "log a quadrotor that stands still"
        )
    if name == "az" and all(n in log.columns for n in FORCE):
        means = [np.nanmean(log.columns[n]) for n in FORCE]
        size = float(np.linalg.norm(means))
        if abs(size - attitude.GRAVITY) > STILL_ACCEL:
            raise DataError(
                f"{log.name}: the accelerometer shows {size:.2f} m/s2 where a rest shows {attitude.GRAVITY:.2f}; check "
                "its scale, and that the quadrotor stands still"
            )


def _seen_step(values: np.ndarray) -> float:
    """Step of numbers (n,) that show by their few distinct values that they were rounded; else 0."""
    distinct = np.unique(values)
    return float(np.diff(distinct).min()) if 1 < len(distinct) < len(values) / 10 else 0.0


def _say_uneven(log: RestLog, name: str, centred: np.ndarray, notes: list[str]) -> None:
    levels = np.array([np.std(piece) for piece in np.array_split(centred, 10)])
    if levels.min() > 0 and levels.max() > UNEVEN * levels.min():
        notes.append(
            f"{log.name}: the noise of '{name}' changes within the log by a factor of {levels.max() / levels.min():.1f}"
        )


def section(statistics: Statistics) -> dict[str, Any]:
    """The section "(estimated) imu sensor noise statistics" of the quadrotor configuration."""
    return {name: {k: float(f"{v:.6g}") for k, v in entry.items()} for name, entry in statistics.values.items()}
