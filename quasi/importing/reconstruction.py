"""Sensors that a log lacks, from what it holds: specific force, body rates, roll and pitch, with bandwidth and error.

    specific force   R^T (dv/dt - g), of a logged acceleration (its slow part of the velocity, where both are logged),
                     else of the velocity, else of the position
    roll and pitch   body z lies along the thrust: f / |f| = -z_body, f the specific force in earth axes; yaw turns
                     about it. Drag and other forces across the thrust tilt the result by their share of the weight.
    body rates       of the attitude's own change
    of a capture     see `quasi.importing.captured_sensors`: where the log's own signals do not serve

What is made here holds no information that its source does not: it carries no bias of its own, no frequency above the
bandwidth, and it cannot check its source.
Source: Mellinger & Kumar, Minimum snap trajectory generation and control for quadrotors, ICRA 2011 (flatness); errors
as in `quasi.importing.derivatives`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from quasi.attitude import GRAVITY, body_rates, continuous, from_euler, interpolate, rotate_inverse, to_euler
from quasi.errors import DataError, add_caution
from quasi.importing.captured_sensors import QUATERNION, Captured, force_and_rates
from quasi.importing.derivatives import NOISE, ONE_SIGMA, derivative_error, origin_of, typical_size
from quasi.importing.resampling import low_pass, velocity
from quasi.importing.series import Series, Track

EULER_ANGLES = ("roll", "pitch", "yaw")
# share of g below which the direction of the specific force is that of its errors: 0.5 m/s2 of error is 10 deg there
MIN_FORCE_SHARE = 0.3
CROSSOVER = 1.0  # Hz, below which the velocity gives the acceleration: on CrazyPAD an offset of 0.7 deg in roll goes
DIFFERENTIATED = ("the position", "the velocity")  # sources of an acceleration that nothing measured
MIN_TRUSTED = 0.9  # share of the log around which the velocity has no gap
MIN_SAMPLES = 20  # as of a sensor's own


@dataclass
class Completed:
    """gyro, force, attitude  Tracks, logged or made; made  {"gyro", "accelerometer", "attitude": how it was made}."""

    gyro: Track
    force: Track
    attitude: Track | None
    made: dict[str, dict[str, Any]] = field(default_factory=dict)


def complete_sensors(
    series: Mapping[str, Series],
    bandwidth: float,
    where: str,
    notes: list[str],
    damage: str = "",
    captured: Captured | None = None,
) -> Completed:
    """Gyro and accelerometer of a flight, and its attitude, made from its other signals where they are not logged.

    series     on-board series of a recording, on one clock; bandwidth  Hz of derivatives (-3 dB)
    captured   the motion capture, which is used where the log's own signals do not serve; None without one
    Returns    Completed; attitude is None where it is not logged and not needed
    Raises     DataError that names the quantities that are lacking and would serve
    """
    gyro, force = (_logged(series, n, what, where, damage) for n, what in (
        (("p", "q", "r"), "body rates (gyro)"), (("ax", "ay", "az"), "specific force (accelerometer)"),
    ))  # fmt: skip
    logged = Completed(gyro, force, _find(series, QUATERNION))
    if gyro is not None and force is not None:
        return logged
    try:
        found = _completed_by_log(logged, series, bandwidth, where)
    except DataError:
        if captured is None or not captured.complete:
            raise
        found = _completed_by_capture(logged, captured, bandwidth, where)
    for name, entry in found.made.items():
        add_caution(notes, f"{where}: {_sentence(name, entry)}")
    return found


def _completed_by_log(logged: Completed, series: Mapping[str, Series], bandwidth: float, where: str) -> Completed:
    """What is not logged made from the log's other signals. Raises DataError where they do not serve."""
    gyro, force, attitude = logged.gyro, logged.force, logged.attitude
    made: dict[str, dict[str, Any]] = {}
    acceleration, about = _acceleration(series, bandwidth)
    if gyro is not None and attitude is None and all(_find(series, (a,)) is None for a in EULER_ANGLES):
        raise DataError(
            f"{where}: the log holds no specific force (accelerometer), and no attitude by which one could be made of "
            "the motion; log the accelerometer, or add a motion capture with attitude"
        )
    if attitude is None:
        attitude, made["attitude"] = _attitude(series, acceleration, about, bandwidth, where)
    if force is None:
        if acceleration is None:
            raise DataError(
                f"{where}: the log holds no specific force (accelerometer), and no acceleration, velocity or position "
                "to make it from; log one of them, or add a motion capture with attitude"
            )
        turned = interpolate(attitude.values, attitude.t, acceleration.t)
        felt = acceleration.values - np.array([0.0, 0.0, GRAVITY])
        force = Track(acceleration.t, rotate_inverse(turned, felt))
        if "attitude" not in made and about["from"] in DIFFERENTIATED and about["covers"] == NOISE:
            about = _with_lateral_error(about, force)
        made["accelerometer"] = about
    if gyro is None:
        gyro, made["gyro"] = _rates(attitude, bandwidth, made.get("attitude"))
    return Completed(gyro, force, attitude, made)


def _completed_by_capture(logged: Completed, captured: Captured, bandwidth: float, where: str) -> Completed:
    """What is not logged made from a motion capture. Raises DataError where nothing ties it to the log."""
    made: dict[str, dict[str, Any]] = {}
    gyro, force = logged.gyro, logged.force
    if gyro is None and logged.attitude is not None:
        gyro, made["gyro"] = _rates(logged.attitude, bandwidth, None)
    seen = force_and_rates(captured, captured.times(gyro, where), bandwidth)
    if gyro is None:
        gyro, made["gyro"] = seen["gyro"]
    if force is None:
        force, made["accelerometer"] = seen["accelerometer"]
    return Completed(gyro, force, logged.attitude, made)


def _sentence(name: str, entry: Mapping[str, Any]) -> str:
    what = {"accelerometer": "specific force", "gyro": "body rates"}.get(name, "")
    if name == "attitude":
        what = " and ".join(entry["angles"])
    made = "they were made" if name == "gyro" or " and " in what else "it was made"
    factor, unit = {
        "accelerometer": (1.0, "m/s2"),
        "gyro": (np.degrees(1.0), "deg/s"),
        "attitude": (np.degrees(1.0), "deg"),
    }[name]
    return (
        f"the log holds no {what}; {made} from {entry['from']}, up to {entry['bandwidth']['value']:.3g} Hz, with "
        f"a standard error of {factor * entry['std']['value']:.2g} {unit} (by {entry['covers']})"
    )


def _find(series: Mapping[str, Series], names: Sequence[str]) -> Track | None:
    """The rows of the first on-board series with all of these that hold a number in each; None where there are few."""
    for name, one in series.items():
        if name.startswith("onboard") and all(n in one.values for n in names):
            values = one.matrix(names)
            fine = np.isfinite(values).all(axis=1) & np.isfinite(one.t)
            return Track(one.t[fine], values[fine]) if np.count_nonzero(fine) >= MIN_SAMPLES else None
    return None


def _logged(series: Mapping[str, Series], names: tuple[str, ...], what: str, where: str, damage: str) -> Track | None:
    """A sensor's readable samples, None where it is not logged. Raises DataError where too few are readable."""
    found = _find(series, names)
    if found is None and any(all(n in s.values for n in names) for k, s in series.items() if k.startswith("onboard")):
        raise DataError(
            f"{where}: the log lists {what}, but fewer than {MIN_SAMPLES} samples of it are readable{damage}, at least "
            f"{MIN_SAMPLES} are needed; copy the log from the controller again, or give another"
        )
    return found


def _acceleration(series: Mapping[str, Series], bandwidth: float) -> tuple[Track | None, dict[str, Any]]:
    """Acceleration over ground (n, 3), m/s2, earth NED, and how it was made; None where nothing serves."""
    linear, speed = _find(series, ("linear_ax", "linear_ay", "linear_az")), _find(series, ("vx", "vy", "vz"))
    place = _find(series, ("x", "y", "z"))
    source, at, covers = DIFFERENTIATED[0], place, NOISE
    if linear is not None:
        source, at = "the logged acceleration", linear
    elif speed is not None:
        source, at = DIFFERENTIATED[1], speed
    if at is None:
        return None, {}
    rate = 1.0 / float(np.median(np.diff(at.t)))
    if linear is not None:
        values = low_pass(linear.values, rate, bandwidth)
        error = typical_size(linear.values - values) or derivative_error(linear, rate, bandwidth, 0)
        if speed is not None:
            slow = min(CROSSOVER, 0.5 * bandwidth)
            change, trusted = velocity(speed.t, speed.values, linear.t, slow)
            if trusted.mean() > MIN_TRUSTED:  # an accelerometer's bias is in the acceleration, not in the velocity
                source = f"the logged acceleration (below {slow:g} Hz the velocity)"
                values = values - low_pass(linear.values, rate, slow) + change
            # the other estimate of the same motion, with the noise of both
            other, trusted = velocity(speed.t, speed.values, linear.t, min(3.0 * slow, bandwidth))
            error = typical_size((other - low_pass(values, rate, 3.0 * slow))[trusted]) if trusted.any() else error
            covers = f"what acceleration and velocity differ by up to {min(3.0 * slow, bandwidth):g} Hz"
    elif speed is not None:
        values, _ = velocity(speed.t, speed.values, speed.t, bandwidth)
        error, covers = derivative_error(speed, rate, bandwidth, 1), NOISE
        if place is not None:
            error = float(np.hypot(error, _disagreement(speed, place, 0.5 * bandwidth)))
            covers = f"noise, and what velocity and position differ by up to {0.5 * bandwidth:g} Hz"
    else:
        first, _ = velocity(place.t, place.values, place.t, bandwidth)
        values, _ = velocity(place.t, first, place.t, bandwidth)
        error = derivative_error(place, rate, bandwidth, 2)
    return Track(at.t, values), origin_of(source, bandwidth, rate, error, "m/s2", covers)


def _with_lateral_error(about: Mapping[str, Any], force: Track) -> dict[str, Any]:
    """`about` with the force across the thrust in the standard error: rotors make none, so it is drag or error.

    An estimate of position or velocity errs smoothly, which no noise above the bandwidth shows. force (n, 3) body FRD
    """
    across = typical_size(force.values[:, :2]) / ONE_SIGMA
    error = float(np.hypot(about["std"]["value"], across))
    return {**about, "std": {**about["std"], "value": error}, "covers": "noise, and the force across the thrust"}


def _disagreement(speed: Track, place: Track, bandwidth: float) -> float:
    """What the accelerations of a velocity and of a position differ by, m/s2. An estimate of both errs smoothly, which
    no noise above the bandwidth shows."""
    change, trusted = velocity(speed.t, speed.values, speed.t, bandwidth)
    first, _ = velocity(place.t, place.values, place.t, bandwidth)
    other, known = velocity(place.t, first, speed.t, bandwidth)
    used = trusted & known
    return typical_size((change - other)[used]) / ONE_SIGMA if used.any() else 0.0


def _attitude(
    series: Mapping[str, Series], acceleration: Track | None, about: Mapping[str, Any], bandwidth: float, where: str
) -> tuple[Track, dict[str, Any]]:
    """Attitude with the angles that are logged, and pitch and roll along the specific force where they are not.

    Raises DataError where yaw or the motion is missing.
    """
    logged = {name: found for name in EULER_ANGLES if (found := _find(series, (name,))) is not None}
    missing = [name for name in EULER_ANGLES if name not in logged]
    if "yaw" not in logged:
        raise DataError(
            f"{where}: the log holds no attitude: {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing; "
            "pitch and roll can be made from acceleration and yaw, yaw from nothing: log yaw or the whole attitude, or "
            "state 'held heading' (deg) in the quadrotor configuration if the vehicle held one"
        )
    if acceleration is None:
        raise DataError(
            f"{where}: the log holds no {' and no '.join(missing)}, and no acceleration, velocity or position to make "
            "it from; log the whole attitude"
        )
    t = acceleration.t
    angles = {n: np.interp(t, s.t, np.unwrap(s.values[:, 0])) for n, s in logged.items()}
    felt = acceleration.values - np.array([0.0, 0.0, GRAVITY])
    roll, pitch = thrust_angles(felt, angles["yaw"])
    weak = np.linalg.norm(felt, axis=1) < MIN_FORCE_SHARE * GRAVITY
    if weak.mean() > 0.5:
        raise DataError(f"{where}: the vehicle falls freely most of the time, so that pitch and roll are not known")
    found = {"roll": _bridged(t, roll, weak), "pitch": _bridged(t, pitch, weak), "yaw": angles["yaw"]}
    error = about["std"]["value"] / GRAVITY
    check = None
    known = [n for n in ("roll", "pitch") if n in logged]
    if known:
        off = np.concatenate([found[n] - low_pass(angles[n][:, None], _rate(t), bandwidth)[:, 0] for n in known])
        error = typical_size(off)
        turning = np.concatenate([np.gradient(part, t) for part in np.split(off, len(known))])
        check = {"against": f"logged {known[0]}", "mean": float(off.mean()), "rate": typical_size(turning)}
    quaternion = continuous(from_euler(*(angles.get(n, found[n]) for n in EULER_ANGLES)))
    covers = check["against"] if check else "the error of the acceleration"
    source = f"yaw and {about['from']}, with the thrust along body z"
    entry = origin_of(source, bandwidth, _rate(t), error, "rad", covers)
    return Track(t, quaternion), entry | {"angles": missing, "check": check}


def thrust_angles(force: np.ndarray, yaw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roll and pitch (n,), rad, 3-2-1, of a body whose -z axis lies along the specific force.

    force  (n, 3) specific force in earth NED axes; yaw (n,) rad
    """
    c, s = np.cos(yaw), np.sin(yaw)
    down = -force / np.maximum(np.linalg.norm(force, axis=1), 1e-12)[:, None]
    # z_body = R_z(yaw) (cos roll sin pitch, -sin roll, cos roll cos pitch)
    ahead, right = c * down[:, 0] + s * down[:, 1], -s * down[:, 0] + c * down[:, 1]
    return np.arcsin(np.clip(-right, -1.0, 1.0)), np.arctan2(ahead, down[:, 2])


def _rates(attitude: Track, bandwidth: float, about: Mapping[str, Any] | None) -> tuple[Track, dict[str, Any]]:
    """Body rates (n, 3), rad/s, of an attitude, and how they were made. about  how the attitude was, None for logged"""
    rate = _rate(attitude.t)
    rates = body_rates(continuous(attitude.values), attitude.t)
    smooth = low_pass(rates, rate, bandwidth)
    error = derivative_error(Track(attitude.t, np.unwrap(to_euler(attitude.values), axis=0)), rate, bandwidth, 1)
    if about is not None:  # an error of the angle that is white up to the bandwidth, where nothing checks its rate
        white = 2.0 * np.pi * bandwidth / np.sqrt(3.0) * about["std"]["value"]
        error = float(np.hypot(error, about["check"]["rate"] if about["check"] else white))
    covers = NOISE if about is None or not about["check"] else about["check"]["against"]
    return Track(attitude.t, smooth), origin_of("the attitude", bandwidth, rate, error, "rad/s", covers)


def _rate(t: np.ndarray) -> float:
    return 1.0 / float(np.median(np.diff(t)))


def _bridged(t: np.ndarray, values: np.ndarray, bad: np.ndarray) -> np.ndarray:
    return np.interp(t, t[~bad], values[~bad])
