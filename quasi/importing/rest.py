"""Rest logs: what their sensors say, untouched by any resampling."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from quasi.attitude import to_euler
from quasi.errors import DataError
from quasi.importing.onboard_log import FORCE, QUATERNION, RATES, read_onboard
from quasi.importing.readers.reader import Request
from quasi.importing.readers.registry import is_capture, read_capture


@dataclass(frozen=True)
class Rest:
    """Samples of a rest on their own clock: t (n,) s; columns {quantity: (n,)}, SI, body FRD, NaN where missing;
    speeds (n, rotors) rad/s or None; step {quantity: step of the log's numbers}; notes of the reader."""

    t: np.ndarray
    columns: dict[str, np.ndarray]
    speeds: np.ndarray | None
    step: dict[str, float]
    notes: list[str]


def read_rest(
    path: str | Path, quadrotor: Mapping[str, Any], rigid_body: str | None = None, log_number: int | None = None
) -> Rest:
    """Read a rest log, or a motion-capture export of a rest (attitude alone) when it is one.

    quadrotor   its configuration; rigid_body  its name in the capture; log_number  of a file with several logs
    Raises      ReadError or DataError: a sentence that names the file and the remedy
    """
    path = Path(path)
    if is_capture(path):
        recording = read_capture(Request(path, rigid_body=rigid_body or ""))
        one = recording.series["capture"]
        if "qw" not in one.values:
            raise DataError(f"{path} holds no rotation of the rigid body; export it with rotations")
        return Rest(one.t, _angles(one.values), None, {}, recording.notes)
    recording = read_onboard(
        {
            "onboard": path,
            "flight controller": quadrotor.get("flight controller") or "betaflight",
            "log number": log_number,
        },
        quadrotor,
    )
    columns: dict[str, np.ndarray] = {}
    speeds = None
    onboard = [series for name, series in recording.series.items() if name.startswith("onboard")]
    t = next((series.t for series in onboard if all(n in series.values for n in RATES)), None)
    if t is None:
        raise DataError(f"{path} holds no body rates (gyro); log them")
    for series in onboard:
        for wanted in (RATES, FORCE, QUATERNION):
            if wanted[0] not in columns and all(n in series.values for n in wanted):
                columns |= {n: _at(t, series.t, series.values[n]) for n in wanted}
        rotors = [series.values[f"w{i}"] for i in range(1, 9) if f"w{i}" in series.values]
        if rotors:
            speeds = np.stack([_at(t, series.t, w) for w in rotors], axis=1)
    if "qw" in columns:
        columns |= _angles(columns)
    columns = {n: v for n, v in columns.items() if n not in QUATERNION}
    units = recording.metadata.get("units") or {}
    step = {
        n: abs(float((units.get(sensor) or {}).get("factor") or 0.0))
        for sensor, names in (("gyro", RATES), ("accelerometer", FORCE))
        for n in names
    }
    return Rest(t - t[0], columns, speeds, step, recording.notes)


def _at(t: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values at t (n,): the nearest sample, so that noise stays as it is; as they are on the same clock."""
    if times is t:
        return values
    after = np.clip(np.searchsorted(times, t), 1, len(times) - 1)
    return values[np.where(t - times[after - 1] < times[after] - t, after - 1, after)]


def _angles(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    quaternion = np.stack([values[n] for n in QUATERNION], axis=-1)
    fine = np.isfinite(quaternion).all(axis=1)
    angles = np.full((len(quaternion), 3), np.nan)
    angles[fine] = to_euler(quaternion[fine])
    return dict(zip(("roll", "pitch", "yaw"), angles.T))
