"""Attitude from gyro and accelerometer alone: levelling, integration, slow correction by the direction of gravity.

A complementary filter on the rotation group with gyro bias, run forwards and then backwards over the recorded flight;
the mean of the two has no lag. Sustained accelerations tilt it (it believes the mean specific force to be vertical),
and its heading drifts with what is left of the gyro bias.

Source: Mahony, Hamel & Pflimlin, Nonlinear complementary filters on the special orthogonal group, IEEE TAC 53(5), 2008,
the "explicit complementary filter with bias correction", eq. (48).
"""

from typing import NamedTuple

import numba
import numpy as np

from quasi.attitude import (
    GRAVITY,
    conjugate,
    continuous,
    exponential,
    from_matrix,
    logarithm,
    multiply,
    normalise,
    rotate,
)
from quasi.errors import DataError

CORRECTION_TIME = 8.0  # s, over which the accelerometer corrects the gyro


class Attitude(NamedTuple):
    """quaternion (n, 4) body to earth, heading 0 at the start; gyro_bias (3,) rad/s; levelled "at rest" or
    "whole flight"; rest_seconds before take-off.
    """

    quaternion: np.ndarray
    gyro_bias: np.ndarray
    levelled: str
    rest_seconds: float


@numba.njit(cache=True)
def _filter(
    t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, start: np.ndarray, bias: np.ndarray, kp: float, ki: float
) -> np.ndarray:
    """Explicit complementary filter along t (either direction); returns quaternions (n, 4)."""
    n = len(t)
    out = np.empty((n, 4))
    q = start.copy()
    b = bias.copy()
    w = np.empty(3)
    for c in range(4):
        out[0, c] = q[c]
    for i in range(1, n):
        dt = t[i] - t[i - 1]
        ahead = 1.0 if dt > 0 else -1.0
        # gravity as the attitude has it, in body axes (specific force at rest points up: minus z of earth)
        gx = 2 * (q[1] * q[3] - q[0] * q[2])
        gy = 2 * (q[2] * q[3] + q[0] * q[1])
        gz = 1 - 2 * (q[1] * q[1] + q[2] * q[2])
        ax, ay, az = accel[i - 1, 0], accel[i - 1, 1], accel[i - 1, 2]
        size = np.sqrt(ax * ax + ay * ay + az * az)
        ex, ey, ez = 0.0, 0.0, 0.0
        if 0.3 * 9.81 < size < 3.0 * 9.81:
            mx, my, mz = -ax / size, -ay / size, -az / size
            ex, ey, ez = my * gz - mz * gy, mz * gx - mx * gz, mx * gy - my * gx
        b[0] -= ki * ex * dt  # dt carries the direction
        b[1] -= ki * ey * dt  # dt carries the direction
        b[2] -= ki * ez * dt  # dt carries the direction
        for c in range(3):
            w[c] = 0.5 * (gyro[i, c] + gyro[i - 1, c]) - b[c]
        # running backwards the correction must still pull towards gravity
        w[0] += ahead * kp * ex
        w[1] += ahead * kp * ey
        w[2] += ahead * kp * ez
        angle = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) * abs(dt)
        half = 0.5 * angle
        s = (np.sin(half) / angle if angle > 1e-12 else 0.5) * dt
        c0, c1, c2, c3 = np.cos(half), s * w[0], s * w[1], s * w[2]
        p0 = q[0] * c0 - q[1] * c1 - q[2] * c2 - q[3] * c3
        p1 = q[0] * c1 + q[1] * c0 + q[2] * c3 - q[3] * c2
        p2 = q[0] * c2 - q[1] * c3 + q[2] * c0 + q[3] * c1
        p3 = q[0] * c3 + q[1] * c2 - q[2] * c1 + q[3] * c0
        length = np.sqrt(p0 * p0 + p1 * p1 + p2 * p2 + p3 * p3)
        q[0], q[1], q[2], q[3] = p0 / length, p1 / length, p2 / length, p3 / length
        for c in range(4):
            out[i, c] = q[c]
    return out


def rest_at_start(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray) -> int:
    """Number of samples from the start during which nothing turned or pushed: gyro and accelerometer steady, 1 g.

    t (n,) s; gyro (n, 3) rad/s; accel (n, 3) m/s2. Half-second windows are taken as long as they stay at rest.
    """
    width = int(np.searchsorted(t, t[0] + 0.5))
    if width < 5:
        return 0
    end, first = 0, np.median(accel[:width], axis=0)
    while end + width <= len(t):
        g, a = gyro[end : end + width], accel[end : end + width]
        middle = np.median(a, axis=0)
        # spreads by quantiles: the first samples of a log may come from filters that have not settled
        turning = np.max(_spread(g)) > 0.1 or np.max(np.abs(np.median(g, axis=0))) > 0.15
        pushed = np.max(_spread(a)) > 1.0 or abs(np.linalg.norm(middle) - GRAVITY) > 0.6
        if turning or pushed or np.linalg.norm(middle - first) > 0.5:
            break
        end += width
    return end


def _spread(values: np.ndarray) -> np.ndarray:
    low, high = np.quantile(values, [0.16, 0.84], axis=0)
    return 0.5 * (high - low)


def estimate_attitude(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray) -> Attitude:
    """Attitude history of a flight on board data alone.

    t       (n,) s, increasing; gyro (n, 3) rad/s and accel (n, 3) m/s2 (specific force), body FRD, finite
    Raises  DataError when fewer than half a second is there
    """
    if len(t) < 10 or t[-1] - t[0] < 0.5:
        raise DataError(
            f"{len(t)} samples over {t[-1] - t[0] if len(t) else 0:.2f} s are too few to estimate an attitude; "
            "half a second of gyro and accelerometer is needed"
        )
    gyro, accel = np.ascontiguousarray(gyro, float), np.ascontiguousarray(accel, float)
    still = rest_at_start(t, gyro, accel)
    rest_seconds = float(t[still - 1] - t[0]) if still else 0.0
    bias = gyro[:still].mean(axis=0) if still else np.zeros(3)
    if still:
        start = _level(-np.median(accel[:still], axis=0))
        levelled = "at rest"
    else:
        start = _level_over_flight(t, gyro, accel)
        levelled = "whole flight"
    kp = 1.0 / CORRECTION_TIME
    # critically damped; a bias measured at rest is better than one learnt in flight
    ki = 0.05 * kp**2 if still else 0.25 * kp**2
    forwards = _filter(t, gyro, accel, start, bias, kp, ki)
    reverse = (np.ascontiguousarray(values[::-1]) for values in (t, gyro, accel))
    backwards = _filter(*reverse, forwards[-1].copy(), bias, kp, ki)[::-1]
    # the backward run starts from the forward one's end; headings agree there, tilt errors are of opposite lag
    half = 0.5 * logarithm(multiply(conjugate(forwards), backwards))
    q = multiply(forwards, exponential(half))
    if still:
        q[:still] = forwards[:still]
    return Attitude(continuous(normalise(q)), bias, levelled, rest_seconds)


def _level(down: np.ndarray) -> np.ndarray:
    """Attitude of heading zero whose earth z axis lies along `down` (3,), given in body axes."""
    z = down / np.linalg.norm(down)
    x = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.95 else np.array([0.0, 1.0, 0.0])
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    return from_matrix(np.stack([x, np.cross(z, x), z]))


def _level_over_flight(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray) -> np.ndarray:
    """Level a flight that begins in the air.

    The mean specific force over some seconds, carried into the first body frame by the gyro, points up, because the
    velocity stays bounded; the gyro's drift over these seconds is small.
    """
    count = min(len(t), max(int(np.searchsorted(t, t[0] + 10.0)), 2))
    relative = _filter(t[:count], gyro[:count], accel[:count], np.array([1.0, 0, 0, 0]), np.zeros(3), 0.0, 0.0)
    carried = rotate(relative, accel[:count])
    span = t[count - 1] - t[0]
    mean = np.sum(0.5 * (carried[1:] + carried[:-1]) * np.diff(t[:count])[:, None], axis=0) / span
    if np.linalg.norm(mean) < 0.2 * GRAVITY:
        mean = accel[:count].mean(axis=0)
    return _level(-mean) if np.linalg.norm(mean) > 0 else np.array([1.0, 0, 0, 0])
