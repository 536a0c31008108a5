"""Rest before take-off, time on the ground, and the sensors' biases from the rest."""

from dataclasses import dataclass, field

import numpy as np

from quasi import attitude
from quasi.errors import add_caution
from quasi.filtering.measurements import coarseness
from quasi.sensor_limits import runs_of

REST_BLOCK = 0.1  # s
LEAST_REST = 1.0  # s, shorter rests are refused
LEAST_STILL_SAMPLES = 100
SHARE = 0.9  # of the rest is used: its end already holds the spool-up
STILL_GYRO, STILL_ACCEL = 0.15, 0.8  # rad/s, m/s2: block means at rest, biases included
STEADY_GYRO, STEADY_ACCEL = 0.03, 0.15  # rad/s, m/s2: how far block means of one rest may differ
LIFTED = 0.02  # m away from where it stood


@dataclass(frozen=True)
class Rest:
    """A stationary period: samples first..last (one past), and the means of gyro and accelerometer in it.

    gyro, gyro_std, accel, accel_std (3,): mean and standard error of the mean, from block means, so that coloured noise
    counts, and with what a log of coarse steps hides; noise (6,) standard deviation per sample of white noise that
    would scatter the block means as much.
    """

    first: int
    last: int
    gyro: np.ndarray
    gyro_std: np.ndarray
    accel: np.ndarray
    accel_std: np.ndarray
    noise: np.ndarray


@dataclass
class Phases:
    """take_off: first sample at which the rotors have taken off, or None; on_ground (N,) bool; rest or None."""

    take_off: int | None
    on_ground: np.ndarray
    rest: Rest | None
    notes: list[str] = field(default_factory=list)


def take_off_sample(speeds: np.ndarray, threshold: float, least: int) -> tuple[int | None, list[int]]:
    """First sample from which every working rotor has reached the threshold, and the rotors (from 1) that never do.

    speeds (N, 4) rad/s; least  samples for which a rotor must stay above the threshold to have reached it.
    """
    reached, never = [], []
    for rotor in range(speeds.shape[1]):
        runs = [a for a, b in runs_of(speeds[:, rotor] >= threshold).tolist() if b - a >= least or b == len(speeds)]
        if runs:
            reached.append(runs[0])
        else:
            never.append(rotor + 1)
    return (max(reached) if reached else None), never


def _blocks(values: np.ndarray, size: int) -> np.ndarray:
    count = len(values) // size
    return values[: count * size].reshape(count, size, -1).mean(axis=1)


def find_rest(
    gyro: np.ndarray, accel: np.ndarray, lost: np.ndarray, step: np.ndarray, last: int, dt: float
) -> Rest | None:
    """The longest stretch before sample `last` in which the IMU is quiet; None if shorter than LEAST_REST.

    gyro, accel (N, 3); lost (N,) bool; step (6,) steps of the log's numbers; dt s
    """
    size = max(2, round(REST_BLOCK / dt))
    if last < size * 3:
        return None
    w, a = _blocks(gyro[:last], size), _blocks(accel[:last], size)
    bad = _blocks(lost[:last, None].astype(float), size)[:, 0] > 0
    quiet = (
        (np.linalg.norm(w, axis=1) < STILL_GYRO)
        & (np.abs(np.linalg.norm(a, axis=1) - attitude.GRAVITY) < STILL_ACCEL)
        & ~bad
    )
    best = (0, 0)
    for start, end in runs_of(quiet).tolist():
        # a rest is a stretch whose block means agree with their own median; carrying the quadrotor about is none
        steady = (np.abs(w[start:end] - np.median(w[start:end], axis=0)) < STEADY_GYRO).all(axis=1)
        steady &= (np.abs(a[start:end] - np.median(a[start:end], axis=0)) < STEADY_ACCEL).all(axis=1)
        for i, j in runs_of(steady).tolist():
            if j - i > best[1] - best[0]:
                best = (start + i, start + j)
    first = best[0] * size
    length = int(SHARE * (best[1] - best[0]) * size)
    if length < LEAST_STILL_SAMPLES or length * dt < SHARE * LEAST_REST:
        return None
    part = slice(first, first + length)
    w, a = _blocks(gyro[part], size), _blocks(accel[part], size)
    scatter = np.concatenate([w.std(axis=0, ddof=1), a.std(axis=0, ddof=1)])
    coarse = coarseness(np.hstack([gyro, accel])[part], step)
    error = np.hypot(scatter / np.sqrt(len(w)), coarse)
    return Rest(
        first,
        first + length,
        gyro[part].mean(axis=0),
        error[:3],
        accel[part].mean(axis=0),
        error[3:],
        scatter * np.sqrt(size),
    )


def _smoothed(values: np.ndarray, size: int) -> np.ndarray:
    """Moving mean over `size` samples, shape kept."""
    padded = np.pad(values, ((size // 2, size - 1 - size // 2), (0, 0)), mode="edge")
    total = np.cumsum(np.vstack([np.zeros(values.shape[1]), padded]), axis=0)
    return (total[size:] - total[:-size]) / size


def find_ground(
    gyro: np.ndarray, accel: np.ndarray, speeds: np.ndarray | None, position: np.ndarray | None, dt: float
) -> np.ndarray:
    """True (N,) where the quadrotor stands on the ground.

    On the ground the rotors give less than 40 % of the typical thrust while the IMU shows gravity and no rotation, for
    half a second at least. With a position (N, 3), NaN where unknown, the spool-up until it has left its place counts
    too; without it, until the rotors give 80 %.
    """
    n = len(gyro)
    if speeds is None:
        return np.zeros(n, bool)
    thrust = np.mean(speeds**2, axis=1)
    typical = np.median(thrust[thrust > 0.25 * np.quantile(thrust, 0.9)]) if thrust.max() > 0 else 0.0
    if typical <= 0:
        return np.zeros(n, bool)
    size = max(3, round(0.2 / dt))
    w, a = _smoothed(gyro, size), _smoothed(accel, size)
    still = np.linalg.norm(w, axis=1) < 2 * STILL_GYRO
    still &= np.abs(np.linalg.norm(a, axis=1) - attitude.GRAVITY) < 1.5
    ground = np.zeros(n, bool)
    for start, end in runs_of(still & (thrust < 0.4 * typical)).tolist():
        if (end - start) * dt < 0.5 and start > 0 and end < n:
            continue
        margin = round(0.2 / dt)  # touch-down shakes the IMU before it is quiet again
        first, last = max(0, start - (margin if start else 0)), end
        place = None
        if position is not None:
            known = position[start:end][np.isfinite(position[start:end]).all(axis=1)]
            place = np.median(known, axis=0) if len(known) else None
        if place is not None:
            near = np.linalg.norm(position - place, axis=1) < LIFTED
            while last < n and near[last]:
                last += 1
            while first > 0 and near[first - 1]:
                first -= 1
        else:
            while last < n and thrust[last] < 0.8 * typical:
                last += 1
        ground[first:last] = True
    return ground


def phases(
    gyro: np.ndarray,
    accel: np.ndarray,
    lost: np.ndarray,
    step: np.ndarray,
    speeds: np.ndarray | None,
    position: np.ndarray | None,
    idle: float | None,
    dt: float,
) -> Phases:
    """Take-off, ground and rest of a flight.

    gyro, accel (N, 3); lost (N,) bool; step (6,) steps of the log's numbers; speeds (N, rotors) rad/s or None;
    position (N, 3) m or None; idle rad/s or None.
    The take-off threshold is 1.5 times the idle speed, or 40 % of the flight's typical greatest speed.
    """
    notes: list[str] = []
    n = len(gyro)
    take_off: int | None = None
    if speeds is None:
        notes.append(
            "no rotor speeds: the rest before take-off is found from the IMU alone, and all rows count as in flight"
        )
        take_off = n
    else:
        top = float(np.quantile(speeds.mean(axis=1), 0.9))
        threshold = 0.4 * top
        if idle is not None and 1.5 * idle < 0.8 * top:
            threshold = 1.5 * idle
        elif idle is not None:
            add_caution(
                notes,
                f"the idle speed of the quadrotor configuration is {idle:.0f} rad/s where the rotors turn at "
                f"{top:.0f} rad/s "
                "in flight, so take-off is looked for at 40 % of the latter; check 'idle RPM' and 'motor poles'",
            )
        take_off, never = take_off_sample(speeds, threshold, max(2, round(0.02 / dt)))
        for rotor in never:
            add_caution(
                notes, f"rotor {rotor} never reaches the take-off speed of {threshold:.0f} rad/s; check its telemetry"
            )
    ground = find_ground(gyro, accel, speeds, position, dt)
    rest = find_rest(gyro, accel, lost, step, n if take_off is None else take_off, dt)
    if rest is None:
        notes.append(
            f"no rest of {LEAST_REST:g} s before take-off was found, so the biases cannot be estimated there; "
            "leave the quadrotor still for a few seconds before take-off"
        )
    elif not ground[rest.first : rest.last].all():
        ground[rest.first : rest.last] = True
    return Phases(take_off, ground, rest, notes)
