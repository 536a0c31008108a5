"""A calibration applied to a flight at import: what a comparison of sensors with capture, or with the motion, found.

The quadrotor's 'sensor calibration' is written alike, without the parts that have keys of their own.
A document (schema "quasi.calibration/1") states the truth about the sensors; nothing in it means nothing to correct:
    imu       gyro scale, accelerometer scale (3: measured / true), gyro bias, accelerometer bias (3: measured minus
              true), misalignment (3: rotation vector that carries the assumed sensor axes onto the true ones), lever
              arm (3: IMU minus cg, m)
    capture   misalignment (3: assumed marker axes onto the true ones), room tilt (2: roll and pitch that carry the
              assumed room axes onto the true ones), rotation delay (s that the rotation is late behind the position),
              marker offset (3: tracked point minus where it is configured, m, body axes)
    clock     rate (by which the on-board clock runs fast)
    telemetry age (s that rotor speeds are logged late)
    rotors    order of speeds, order of commands (4: number of the log's column that holds rotor 1, 2, 3, 4)
Measured = scale x (true axes' x true) + bias, so true = turned(misalignment) ((measured - bias) / scale).
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from quasi import attitude
from quasi.errors import ConfigError, nearest
from quasi.importing.lever_arm import felt_too_much
from quasi.importing.onboard_attitude import estimate_attitude
from quasi.importing.onboard_log import Onboard, Track
from quasi.importing.series import Series, interpolate_columns

SCHEMA = "quasi.calibration/1"
IN_ORDER = (1.0, 2.0, 3.0, 4.0)
# part: quantity: (numbers, value that corrects nothing)
CALIBRATED_CONSTANTS: dict[str, dict[str, tuple[int, float | tuple[float, ...]]]] = {
    "imu": {
        "gyro scale": (3, 1.0),
        "accelerometer scale": (3, 1.0),
        "gyro bias": (3, 0.0),
        "accelerometer bias": (3, 0.0),
        "misalignment": (3, 0.0),
        "lever arm": (3, 0.0),
    },
    "capture": {"misalignment": (3, 0.0), "room tilt": (2, 0.0), "rotation delay": (1, 0.0), "marker offset": (3, 0.0)},
    "clock": {"rate": (1, 0.0)},
    "telemetry": {"age": (1, 0.0)},
    "rotors": {"order of speeds": (4, IN_ORDER), "order of commands": (4, IN_ORDER)},
}
Vectors = dict[str, dict[str, np.ndarray]]


def check(document: Mapping[str, Any] | None) -> Vectors:
    """Every quantity of a calibration as an array (1, 2 or 3,), neutral where absent.

    Raises ConfigError for another schema, an unknown part or quantity, or numbers that cannot be.
    """
    document = document or {}
    if document.get("schema", SCHEMA) != SCHEMA:
        raise ConfigError(f"a calibration has schema {document['schema']!r}, expected '{SCHEMA}'")
    whole = {p: {n: np.full(size, value) for n, (size, value) in q.items()} for p, q in CALIBRATED_CONSTANTS.items()}
    for part, quantities in document.items():
        if part in ("schema", "notes", "from"):
            continue
        if part not in CALIBRATED_CONSTANTS:
            raise ConfigError(f"a calibration has no part '{part}'{nearest(part, CALIBRATED_CONSTANTS)}")
        for name, value in quantities.items():
            if name not in CALIBRATED_CONSTANTS[part]:
                raise ConfigError(
                    f"a calibration of the {part} has no '{name}'{nearest(name, CALIBRATED_CONSTANTS[part])}"
                )
            size, neutral = CALIBRATED_CONSTANTS[part][name]
            try:
                array = np.atleast_1d(np.array(value, float))
            except (TypeError, ValueError):
                array = np.zeros(0)
            if array.shape != (size,) or not np.isfinite(array).all() or (neutral == 1.0 and (array <= 0).any()):
                raise ConfigError(
                    f"calibration: '{name}' of the {part} is {value!r}, expected {size} finite number"
                    f"{'s' * (size > 1)}{', above zero' * (neutral == 1.0)}"
                )
            if neutral == IN_ORDER and sorted(array) != list(IN_ORDER):
                raise ConfigError(f"calibration: '{name}' of the {part} is {value!r}, expected each of 1, 2, 3, 4 once")
            whole[part][name] = array
    return whole


def is_identity(document: Mapping[str, Any] | None) -> bool:
    """True when a calibration corrects nothing."""
    whole = check(document)
    return all(
        np.array_equal(whole[p][n], np.full(size, value))
        for p, q in CALIBRATED_CONSTANTS.items()
        for n, (size, value) in q.items()
    )


def true_inertial(gyro: np.ndarray, force: np.ndarray, imu: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Gyro (n, 3) and specific force (m, 3) in true body axes, of measured ones; the lever arm stays."""
    turn = attitude.matrix(attitude.exponential(imu["misalignment"]))
    return (
        (gyro - imu["gyro bias"]) / imu["gyro scale"] @ turn.T,
        (force - imu["accelerometer bias"]) / imu["accelerometer scale"] @ turn.T,
    )


def true_pose(
    t: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray | None,
    arm: np.ndarray,
    capture: Mapping[str, np.ndarray],
) -> tuple[np.ndarray, np.ndarray | None]:
    """Position (n, 3) of the cg and attitude (n, 4) as they are, of captured ones; NaN stays.

    t (n,) s; arm (3,) m, the marker offset that was already taken off the position with the captured attitude
    """
    room = attitude.exponential(np.append(capture["room tilt"], 0.0))
    if quaternion is None:
        return attitude.rotate(room, position), None
    fine = np.isfinite(quaternion).all(axis=1)
    marker = position + attitude.rotate(np.where(fine[:, None], quaternion, np.nan), arm) if arm.any() else position
    turned = quaternion
    late = float(capture["rotation delay"][0])
    if late and fine.any():
        turned = attitude.interpolate(quaternion[fine], t[fine], t + late)
        turned[~fine] = np.nan
    turned = attitude.multiply(attitude.multiply(room, turned), attitude.exponential(-capture["misalignment"]))
    place = attitude.rotate(room, marker)
    return place - attitude.rotate(turned, arm) if arm.any() else place, turned


def calibrated_onboard(board: Onboard, document: Mapping[str, Any]) -> Onboard:
    """The on-board side of a flight with its IMU and its clock set right; an estimated attitude is estimated anew."""
    whole = check(document)
    slow = 1.0 / (1.0 + float(whole["clock"]["rate"][0]))
    age = float(whole["telemetry"]["age"][0])

    def timed(track: Track | None, late: float = 0.0) -> Track | None:
        return None if track is None else Track((track.t - late) * slow, track.values)

    rates, force = true_inertial(board.gyro.values, board.force.values, whole["imu"])
    gyro = Track(board.gyro.t * slow, rates)
    arm = whole["imu"]["lever arm"]
    if arm.any():
        even = np.arange(len(rates)) * float(np.median(np.diff(gyro.t)))
        felt = felt_too_much(even, rates, arm)
        force = force - interpolate_columns(board.force.t, board.gyro.t, felt)
    level = timed(board.attitude)
    if board.attitude_source == "estimated on board":
        at_gyro = interpolate_columns(board.gyro.t, board.force.t, force)
        level = Track(gyro.t, estimate_attitude(gyro.t, rates, at_gyro).quaternion)
    speeds, commands = (whole["rotors"][f"order of {kind}"].astype(int) for kind in ("speeds", "commands"))
    rotors = timed(board.rotors, age)
    if rotors is not None and rotors.values.shape[1] >= len(speeds):
        rotors = Track(rotors.t, np.hstack([rotors.values[:, speeds - 1], rotors.values[:, len(speeds) :]]))
    return replace(
        board,
        gyro=gyro,
        force=Track(board.force.t * slow, force),
        attitude=level,
        position=timed(board.position),
        velocity=timed(board.velocity),
        body_velocity=timed(board.body_velocity),
        others={
            _column_of_rotor(n, speeds, commands): timed(track, age if re.fullmatch(r"w[1-8]", n) else 0.0)
            for n, track in board.others.items()
        },
        rotors=rotors,
    )


def _column_of_rotor(name: str, speeds: np.ndarray, commands: np.ndarray) -> str:
    """Name of a logged column by the rotor that it is of; other columns keep theirs.

    speeds, commands  (4,) number of the column that holds rotor 1 to 4
    """
    found = re.fullmatch(r"(w|command)([1-4])(_CMD)?", name)
    if found is None:
        return name
    order = speeds if found[1] == "w" and not found[3] else commands
    return f"{found[1]}{list(order).index(int(found[2])) + 1}{found[3] or ''}"


def calibrated_capture(series: Series | None, arm: np.ndarray | None, document: Mapping[str, Any]) -> Series | None:
    """A capture whose markers, room and timing are set right. arm  marker offset as configured, m."""
    names, angles = ("x", "y", "z"), ("qw", "qx", "qy", "qz")
    if series is None or not all(n in series.values for n in names):
        return series
    position, quaternion = series.matrix(names), series.matrix(angles)
    arm = np.zeros(3) if arm is None else np.asarray(arm, float)
    place, turned = true_pose(series.t, position, quaternion, arm, check(document)["capture"])
    values = dict(series.values) | {n: place[:, i] for i, n in enumerate(names)}
    if turned is not None:
        values |= {n: turned[:, i] for i, n in enumerate(angles)}
    return Series(series.t, values)
