"""What the filter is given: noise levels, measurements, first state and covariance."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi import attitude
from quasi.airframe import Airframe
from quasi.filtering import bias as biases
from quasi.filtering import ekf, measurements, noise
from quasi.sensor_limits import runs_of

DRIFTING = np.array([1e-3] * 3 + [1e-2] * 3)  # random walk of time-varying biases, per square root of a second
# Rounding to the log's steps errs alike for as long as a rate stays within one: as much white noise is greater by this
ROUNDED = 1.5
NO_BIAS_STD = 1e-4  # m/s2: moves no velocity within a flight, and keeps covariances positive
SENSORS = ("p", "q", "r", "ax", "ay", "az")


class Material(NamedTuple):
    """What the states of a flight are found from.

    frame, metadata  the imported flight; chosen  the options, complete; dt  s; notes  are added to
    folded  (N,) of `harmonics.near_zero`
    """

    frame: pd.DataFrame
    metadata: Mapping[str, Any]
    airframe: Airframe
    chosen: Mapping[str, Any]
    imu: measurements.Imu
    found: biases.Phases
    folded: np.ndarray
    dt: float
    notes: list[str]


class NoiseLevels(NamedTuple):
    """Noise of the IMU, (6,) but for `each`: at rest, the lowest that the innovations may find in flight, what is
    assumed in flight before they are asked; each (N, 6) sample by sample; bias_random_walk (6,); origin  where the
    rest's is from.
    """

    still: np.ndarray
    lowest: np.ndarray
    moving: np.ndarray
    each: np.ndarray
    bias_random_walk: np.ndarray
    origin: str


def noise_levels(flight: Material, still: np.ndarray, origin: str) -> NoiseLevels:
    """still, origin  of `measurements.sensor_noise`

    A log denser than the grid is averaged at its import: white noise, and rounding that vibration dithers, keep their
    density and leave sqrt(grid rate / log rate) of their standard deviation per sample.
    Source: Widrow & Kollar, Quantization Noise, 2008, chapters 5 and 19.
    """
    _, metadata, _, chosen, imu, found, _, dt, notes = flight
    step = measurements.resolution(metadata)
    if found.rest is not None:
        still = np.maximum(still, found.rest.noise)  # what the rest itself shows, coloured noise included
    each, both, hidden = np.tile(still, (len(imu.gyro), 1)), np.hstack([imu.gyro, imu.accel]), np.zeros(6, bool)
    for first, last in runs_of(found.on_ground):
        coarse = measurements.coarseness(both[first:last], step)
        # however long it lasts, the mean may be wrong by this much: as much white noise leaves the same doubt
        each[first:last] = np.maximum(each[first:last], coarse * np.sqrt(last - first))
        hidden |= coarse > 0
    if hidden.any():
        notes.append(
            f"the log's steps of {', '.join(s for s, h in zip(SENSORS, hidden) if h)} are coarser than their noise at "
            "rest, which therefore says little about their biases"
        )
    least = np.maximum(still, ROUNDED * step / np.sqrt(12.0))
    rough = np.array([measurements.FLIGHT_STD[s] for s in SENSORS])
    moving = np.maximum(least, rough) if chosen["re-estimate noise"] else least
    shaken = since_take_off(found.on_ground)
    each[shaken] = np.maximum(each[shaken], moving)
    each[imu.lost] = np.maximum(each[imu.lost], measurements.LOST_STD)
    walk = np.repeat([float(chosen["gyro bias random walk"]), float(chosen["accelerometer bias random walk"])], 3)
    if chosen["bias policy"] == "time varying":
        walk = np.maximum(walk, DRIFTING)
    log_rate = float(((metadata.get("streams") or {}).get("gyro") or {}).get("rate") or 1.0 / dt)
    lowest = least * np.sqrt(min(1.0, 1.0 / (dt * log_rate)))
    return NoiseLevels(still, lowest, moving, each, walk, origin)


def since_take_off(on_ground: np.ndarray) -> np.ndarray:
    """True (N,) from the first sample in flight on, where the noise is that of flight.

    After a landing, rotors that spin down, hands and a fall on the side shake the IMU. Noise at rest would take that
    for a turned capture and wrong biases, which the smoother carries back into the flight.
    """
    return np.logical_or.accumulate(~on_ground)


def make_inputs(flight: Material, measured: measurements.Measurements, levels: NoiseLevels) -> ekf.Inputs:
    """What the filter is given; where no heading is measured, with the one that explains most."""
    frame, _, _, chosen, imu, found, _, dt, _ = flight
    quaternion, state, covariance = measurements.start(
        frame, measured, imu, dt, bool(found.on_ground[0]), bool(chosen["estimate attitude alignment"])
    )
    per_second = measured.used.sum(axis=0) / (len(frame) * dt)
    inputs = ekf.Inputs(
        dt,
        imu.gyro,
        imu.accel,
        levels.each,
        levels.bias_random_walk,
        measured.used,
        measured.attitude,
        np.ascontiguousarray(np.nan_to_num(measured.position)),
        np.ascontiguousarray(np.nan_to_num(measured.velocity)),
        measured.body,
        measured.std,
        noise.GATE,
        np.maximum(3, per_second.astype(np.int64)),  # a second of rejections in a row
        quaternion,
        state,
        covariance,
    )
    return choose_heading(inputs) if measured.source["attitude"] == "none" else inputs


def without_accelerometer_bias(inputs: ekf.Inputs) -> ekf.Inputs:
    """Inputs by which the accelerometer's bias stays 0."""
    walk, covariance = inputs.bias_random_walk.copy(), inputs.covariance.copy()
    walk[3:] = 0.0
    covariance[12:15, 12:15] = np.eye(3) * NO_BIAS_STD**2
    return inputs._replace(bias_random_walk=walk, covariance=covariance)


def choose_heading(inputs: ekf.Inputs) -> ekf.Inputs:
    """Start from the heading, of eight tried, that explains the measurements best: none is measured."""
    best: tuple[float, np.ndarray] | None = None
    for yaw in np.arange(8) * np.pi / 4:
        turned = attitude.multiply(attitude.exponential(np.array([0.0, 0.0, yaw])), inputs.quaternion)
        value = ekf.cost(inputs._replace(quaternion=turned, gate=noise.LOOSE_GATE))
        if np.isfinite(value) and (best is None or value < best[0]):
            best = (value, turned)
    return inputs if best is None else inputs._replace(quaternion=best[1])
