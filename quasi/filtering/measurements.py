"""What the filter may use of an imported flight, how much it trusts it, and where it starts."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from quasi import attitude
from quasi.errors import DataError, add_caution
from quasi.filtering.ekf import ATTITUDE_KIND, MEASUREMENT_KINDS, POSITION_KIND, STATES, VELOCITY_KIND
from quasi.sensor_limits import find_clipping, runs_of

GYRO, ACCEL = ("p", "q", "r"), ("ax", "ay", "az")

# Standard deviations per measurement when nothing better is known: rad, m, m/s. Motion capture: the scatter of a rigid
# body of 5 cm marker spacing. On-board estimates err slowly: taken rarely (ONBOARD_INTERVAL, s) and trusted little.
CAPTURE_STD = {"attitude": np.radians(0.2), "position": 0.001, "velocity": 0.02}
ONBOARD_STD = {"attitude": np.radians(1.5), "position": 0.02, "velocity": 0.05}
ONBOARD_INTERVAL = {"attitude": 0.1, "position": 0.05, "velocity": 0.05}
STILL_STD = 0.01  # m/s, of the velocity of a quadrotor that stands on the ground
# Sensor noise per sample at rest, when the quadrotor configuration holds none: rad/s, m/s2
REST_STD = {"p": 0.015, "q": 0.015, "r": 0.015, "ax": 0.05, "ay": 0.05, "az": 0.05}
# Vibration in flight on top of it, before the innovations are asked
FLIGHT_STD = {"p": 0.05, "q": 0.05, "r": 0.05, "ax": 1.0, "ay": 1.0, "az": 1.0}
LARGEST_READING = {"gyro": 150.0, "accelerometer": 1000.0}  # rad/s, m/s2: no sensor of a quadrotor measures more
FARTHEST_STATE, FASTEST_STATE = 1e4, 300.0  # m, m/s
STEP_ROUNDING = 1e-9  # of a value
FROZEN = 0.1  # s in flight for which no channel of a sensor changes
LOST_STD = np.array([3.0, 3.0, 3.0, 20.0, 20.0, 20.0])  # of an IMU sample that was filled in

WARNING = (
    "the quadrotor's file holds no noise statistics of its IMU: default values are used, and larger ones where the "
    "flight's rest shows more; `quasi noise` measures them"
)


@dataclass
class Imu:
    """Gyro and accelerometer (N, 3) as measured, finite; lost (N,) True where a sample was filled in."""

    gyro: np.ndarray
    accel: np.ndarray
    lost: np.ndarray
    notes: list[str] = field(default_factory=list)


@dataclass
class Measurements:
    """used (N, 3) int8 and std (3, 3) by kind; attitude (N, 4), position and velocity (N, 3); source by kind."""

    used: np.ndarray
    attitude: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    body: bool
    std: np.ndarray
    source: dict[str, str]
    notes: list[str] = field(default_factory=list)


def fill(values: np.ndarray) -> np.ndarray:
    """Missing values (NaN) of (N,), not all, by straight lines between their neighbours, held at the ends."""
    good = np.isfinite(values)
    if good.all():
        return np.array(values, float)
    at = np.arange(len(values))
    return np.interp(at, at[good], values[good])


def time_step(t: np.ndarray) -> float:
    """The step of a uniform grid, s. Raises DataError where the grid is not uniform."""
    if len(t) < 100 or not np.all(np.isfinite(t)):
        raise DataError(
            f"the imported flight has {len(t)} samples with finite time, expected at least 100; check the log"
        )
    step = np.diff(t)
    dt = (t[-1] - t[0]) / (len(t) - 1)
    worst = int(np.argmax(np.abs(step - dt)))
    if dt <= 0 or abs(step[worst] - dt) > 0.01 * dt:
        raise DataError(
            f"the imported flight's time grid is not uniform: the step at t = {t[worst]:.3f} s is {step[worst]:.6f} s, "
            f"expected {dt:.6f} s; import it anew"
        )
    return float(dt)


def resolution(metadata: Mapping[str, Any]) -> np.ndarray:
    """Steps (6,) of the log's numbers for gyro and accelerometer, rad/s and m/s2; 0 where the import named none."""
    units = ((metadata.get("sources") or {}).get("onboard") or {}).get("units") or {}
    steps = [abs(float((units.get(s) or {}).get("factor") or 0.0)) for s in ("gyro", "accelerometer")]
    return np.repeat(steps, 3)


def coarseness(values: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Standard deviation (m,) by which the mean of each column (N, m), logged in steps (m,), may be wrong for these.

    Noise of half a step or more carries a mean across the steps (dither); with less, the mean sticks to them.
    Source: Widrow & Kollar, Quantization Noise, 2008, chapter 19.
    """
    # in pieces, so that a knock does not pass for noise
    spread = np.median([piece.std(axis=0) for piece in np.array_split(values, 10) if len(piece)], axis=0)
    return np.where(spread < 0.5 * step, step / np.sqrt(12.0), 0.0)


def read_imu(frame: pd.DataFrame, step: np.ndarray | None = None) -> Imu:
    """Gyro and accelerometer of an imported flight, filled where missing.

    step  (6,) of the log's numbers, see `resolution`; without it they are taken for smooth
    Raises DataError for a channel that is absent, constant, or missing for more than half of the flight.
    """
    t = frame["t"].to_numpy(float)
    lost = np.zeros(len(frame), bool)
    notes: list[str] = []
    columns: list[np.ndarray] = []
    known = frame["imu_clipped"].to_numpy(float) > 0.5 if "imu_clipped" in frame else np.zeros(len(frame), bool)
    if known.any():
        lost |= known
        notes.append(
            f"gyro or accelerometer sat at the end of its range in {int(known.sum())} samples, first at t = "
            f"{t[int(np.argmax(known))]:.3f} s; they are trusted little and marked invalid"
        )
    for name in (*GYRO, *ACCEL):
        sensor = "gyro" if name in GYRO else "accelerometer"
        if name not in frame:
            raise DataError(
                f"the imported flight has no column '{name}' ({sensor}), which the filter needs; check the log"
            )
        values = frame[name].to_numpy(float)
        bad = ~np.isfinite(values)
        absurd = ~bad & (np.abs(values) > LARGEST_READING[sensor])
        if absurd.any():
            first = int(np.argmax(absurd))
            add_caution(
                notes,
                f"{sensor} channel '{name}' is {values[first]:.4g} at t = {t[first]:.3f} s, more than any sensor "
                f"measures ({LARGEST_READING[sensor]:g}), and so in {int(absurd.sum())} samples; they count as "
                "missing: check its units",
            )
            bad |= absurd
        if bad.mean() > 0.5:
            raise DataError(
                f"{sensor} channel '{name}' is missing in {100 * bad.mean():.0f} % of the flight, at most half may be; "
                "check the log"
            )
        if np.ptp(values[~bad]) == 0.0:
            raise DataError(
                f"{sensor} channel '{name}' is constant ({values[~bad][0]:g}) all through the flight; "
                "a sensor that works has noise: check the log and its column mapping"
            )
        if bad.any():
            first = int(np.argmax(bad))
            notes.append(
                f"{sensor} channel '{name}' is missing in {int(bad.sum())} samples, first at t = {t[first]:.3f} s; "
                "they are bridged by straight lines and marked invalid"
            )
            lost |= bad
        values = fill(np.where(bad, np.nan, values))
        for end in find_clipping(values, sensor, 0.0 if step is None else float(step[len(columns)])):
            stuck = end.where & ~known
            lost |= stuck
            pieces = [(t[a], t[b - 1]) for a, b in runs_of(stuck)]
            if pieces:
                notes.append(
                    f"{sensor} channel '{name}' is saturated at {end.level:.4g} in {int(stuck.sum())} samples in "
                    f"{len(pieces)} spans, first from t = {pieces[0][0]:.3f} s to {pieces[0][1]:.3f} s; they are "
                    "trusted little and marked invalid"
                )
        columns.append(values)
    if "onboard_valid" in frame:
        out = ~(frame["onboard_valid"].to_numpy(float) > 0.5)
        if out.any():
            notes.append(
                f"the on-board log lost {100 * out.mean():.3g} % of the flight in {len(runs_of(out))} spans; "
                "they are bridged and marked invalid"
            )
            lost |= out
    both = np.ascontiguousarray(np.stack(columns, axis=1))
    return Imu(np.ascontiguousarray(both[:, :3]), np.ascontiguousarray(both[:, 3:]), lost, notes)


def frozen(imu: Imu, on_ground: np.ndarray, t: np.ndarray, dt: float) -> tuple[np.ndarray, list[str]]:
    """True (N,) where a sensor in flight repeats all its three values for FROZEN s or more, and notes about it.

    On the ground a log of coarse steps does so by nature.
    """
    found, notes = np.zeros(len(t), bool), []
    for sensor, values in (("gyro", imu.gyro), ("accelerometer", imu.accel)):
        # resampling leaves rounding where the log repeats itself
        close = np.abs(np.diff(values, axis=0)) <= STEP_ROUNDING * np.maximum(np.abs(values[1:]), 1.0)
        same = np.concatenate([[False], close.all(axis=1)])
        for a, b in runs_of(same & ~on_ground & ~imu.lost):
            if (b - a) * dt >= FROZEN:
                notes.append(
                    f"the {sensor} repeats its values from t = {t[a - 1]:.2f} s to {t[b - 1]:.2f} s; they are trusted "
                    "little and marked invalid"
                )
                found[a - 1 : b] = True
    return found, notes


def sensor_noise(statistics: Mapping[str, Mapping[str, float]], wanted: bool) -> tuple[np.ndarray, list[str], str]:
    """Standard deviation per sample at rest of p q r ax ay az (6,), notes, and where they come from.

    statistics  {axis: {"std": ...}} of the quadrotor configuration, at the log's rate; wanted  whether to use them
    """
    names = (*GYRO, *ACCEL)
    if not wanted:
        return np.array([REST_STD[n] for n in names]), [], "default"
    if not any(n in statistics for n in names):
        return np.array([REST_STD[n] for n in names]), [WARNING], "default"
    values, notes = [], []
    for name in names:
        std = float(statistics.get(name, {}).get("std", 0.0))
        if not std > 0.0:
            notes.append(
                f"the noise statistics of the quadrotor configuration give {std:g} for the standard deviation of "
                f"'{name}', which no sensor has; the default {REST_STD[name]:g} is used"
            )
            std = REST_STD[name]
        values.append(std)
    return np.array(values), notes, "quadrotor configuration"


def _columns(frame: pd.DataFrame, names: tuple[str, ...]) -> np.ndarray:
    if not all(n in frame for n in names):
        return np.full((len(frame), len(names)), np.nan)
    return np.ascontiguousarray(frame[list(names)].to_numpy(float))


def _thin(fresh: np.ndarray, every: int) -> np.ndarray:
    """Keep of the True entries only those at least `every` samples after the last kept one."""
    kept = np.zeros(len(fresh), bool)
    last = -every
    for k in np.flatnonzero(fresh):
        if k - last >= every:
            kept[k] = True
            last = k
    return kept


def collect(
    frame: pd.DataFrame,
    metadata: Mapping[str, Any],
    statistics: Mapping[str, Mapping[str, float]],
    on_ground: np.ndarray,
    dt: float,
) -> Measurements:
    """The measurements of an imported flight by kind, with starting noise levels.

    Attitude and position are used where they are fresh. Velocity is used when it is an on-board estimate of its own or
    when there is no position, never when it was derived from the same captured position. Without position and velocity
    the quadrotor is taken to stand still while on the ground.
    """
    n = len(frame)
    notes: list[str] = []
    euler = _columns(frame, ("roll", "pitch", "yaw"))
    uvw = _columns(frame, ("u", "v", "w"))
    values = {"attitude": euler, "position": _columns(frame, ("x", "y", "z")), "velocity": uvw}
    source, used = {}, np.zeros((n, 3), np.int8)
    std = np.ones((3, 3))
    for i, kind in enumerate(MEASUREMENT_KINDS):
        origin = str(metadata.get(f"{kind} source") or "none")
        column = f"{kind}_sample"
        fresh = frame[column].to_numpy(float) > 0.5 if column in frame else np.zeros(n, bool)
        with np.errstate(invalid="ignore"):
            finite = (np.abs(values[kind]) <= {"velocity": FASTEST_STATE}.get(kind, FARTHEST_STATE)).all(axis=1)
        if (fresh & ~finite).any():
            add_caution(
                notes,
                f"{int((fresh & ~finite).sum())} samples of {kind} are not finite or beyond all reason and are left "
                "out",
            )
        fresh &= finite
        capture = origin.startswith("capture")
        if fresh.any() and np.ptp(values[kind][fresh], axis=0).max() == 0.0 and fresh.sum() > 10:
            add_caution(notes, f"the measured {kind} is constant in the whole flight and is left out; check its source")
            fresh[:] = False
        if kind == "velocity" and used[:, POSITION_KIND].any() and capture:
            fresh[:] = False  # the same information as the position
        if not fresh.any():
            origin = "none"
        elif not capture:
            fresh = _thin(fresh, max(1, round(ONBOARD_INTERVAL[kind] / dt)))
        used[:, i] = fresh
        source[kind] = origin
        std[i] = (CAPTURE_STD if capture else ONBOARD_STD)[kind]
        if kind == "attitude" and not capture:
            jitter = [float(statistics.get(a, {}).get("std", 0.0)) for a in ("roll", "pitch", "yaw")]
            std[i] = np.maximum(std[i], jitter)

    quaternion = np.zeros((n, 4))
    quaternion[:, 0] = 1.0
    known = np.isfinite(euler).all(axis=1)
    quaternion[known] = attitude.from_euler(*euler[known].T)
    # u v w were turned into body axes with the imported attitude; turning them back makes them independent of it
    body = not known.all()
    velocity = uvw if body else attitude.rotate(quaternion, uvw)
    if source["attitude"] == "none":
        add_caution(
            notes,
            "no attitude source: attitude is estimated from gyro, accelerometer and the measured motion; "
            "its heading is only as good as the manoeuvres make it",
        )
    if source["position"] == "none" and source["velocity"] == "none":
        still = _thin(on_ground, max(1, round(0.1 / dt)))
        used[:, VELOCITY_KIND] = still
        velocity, body = np.zeros((n, 3)), False
        std[VELOCITY_KIND] = STILL_STD
        source["velocity"] = "standing still" if still.any() else "none"
        add_caution(
            notes,
            "no position and no velocity source: velocity is integrated from the accelerometer and drifts in flight",
        )
    elif source["position"] == "none":
        add_caution(notes, "no position source: position is integrated from velocity and drifts")
    return Measurements(
        used,
        np.ascontiguousarray(quaternion),
        values["position"],
        np.ascontiguousarray(velocity),
        body,
        std,
        source,
        notes,
    )


def levelled(accel: np.ndarray, yaw: float) -> np.ndarray:
    """Quaternion (4,) whose vertical agrees with a mean specific force (3,), at a given yaw."""
    roll = np.arctan2(-accel[1], -accel[2])
    pitch = np.arctan2(accel[0], np.hypot(accel[1], accel[2]))
    return attitude.from_euler(roll, pitch, yaw)


def start(frame: pd.DataFrame, measurements: Measurements, imu: Imu, dt: float, resting: bool, align: bool):
    """Nominal state and covariance at the first sample: quaternion (4,), state (15,), covariance (18, 18).

    resting  True where the quadrotor stands at the first sample; align  whether the attitude source may be turned
    against the body by a constant small angle, to be estimated.
    """
    soon = max(2, round(0.1 / dt))
    deviation = np.empty(STATES)
    early = np.flatnonzero(measurements.used[:soon, ATTITUDE_KIND])
    any_attitude = np.flatnonzero(measurements.used[:, ATTITUDE_KIND])
    mean = imu.accel[: max(2, round(0.2 / dt))].mean(axis=0)
    if len(early):
        quaternion = measurements.attitude[early[0]]
        deviation[:3] = np.maximum(2.0 * measurements.std[ATTITUDE_KIND], 0.03)
    else:
        yaw = 0.0
        if len(any_attitude):
            yaw = float(attitude.to_euler(measurements.attitude[any_attitude[0]])[2])
        quaternion = levelled(mean, yaw)
        deviation[:3] = [0.2, 0.2, 1.0] if not resting else [0.05, 0.05, 1.0]
    state = np.zeros(15)
    velocity = _columns(frame, ("u", "v", "w"))[0]
    if resting:
        deviation[3:6] = 0.05
    elif np.isfinite(velocity).all():
        state[:3] = attitude.rotate(quaternion, velocity)
        deviation[3:6] = 0.5
    else:
        deviation[3:6] = 3.0
    first = np.flatnonzero(measurements.used[:, POSITION_KIND])
    if len(first):
        state[3:6] = measurements.position[first[0]]
        deviation[6:9] = 0.05 if first[0] < soon else 5.0
    else:
        deviation[6:9] = 1e-3
    deviation[9:12] = 0.1
    deviation[12:15] = 0.5
    has = measurements.source["attitude"] != "none"
    capture = measurements.source["attitude"].startswith("capture")
    deviation[15:18] = (np.radians(0.5 if capture else 1.0) if align else 1e-6) if has else 1e-6
    return np.array(quaternion, float), state, np.diag(deviation**2)
