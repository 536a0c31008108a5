"""Frames and quaternions; the one place that fixes them.

Earth: x north/forward, y east/right, z down. Body: x forward, y right, z down (FRD).
Quaternions: Hamilton, order w x y z, unit length, they rotate body vectors to earth: v_E = q v_B q*.
Euler angles: 3-2-1 (yaw, pitch, roll), rad. Arrays carry the components on the last axis; leading axes are free.

Source: Stevens, Lewis & Johnson, Aircraft Control and Simulation, 3rd ed., 2016, section 1.8.
"""

import numpy as np

GRAVITY = 9.81  # m/s^2
# cosine of the pitch below which roll and yaw are one angle: roll and yaw lose 1e-16 / POLE rad to rounding
POLE = 1e-8
AIR_DENSITY = 1.225  # kg/m^3, sea level, ISA
HALF_TURN = np.array([1.0, -1.0, -1.0])  # of a vector about x: FLU to FRD, z up to down, and back


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Hamilton product a b. Shapes (..., 4), broadcast; returns (..., 4)."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(q: np.ndarray) -> np.ndarray:
    """Conjugate, which inverts a unit quaternion. Shape (..., 4)."""
    return np.asarray(q, float) * np.array([1.0, -1.0, -1.0, -1.0])


def normalise(q: np.ndarray) -> np.ndarray:
    """Scale to unit length. Shape (..., 4)."""
    q = np.asarray(q, float)
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Turn body vectors (..., 3) into the earth frame by q (..., 4); broadcast; returns (..., 3)."""
    q, v = np.asarray(q, float), np.asarray(v, float)
    w, r = q[..., :1], q[..., 1:]
    t = 2.0 * np.cross(r, v)
    return v + w * t + np.cross(r, t)


def rotate_inverse(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Turn earth vectors (..., 3) into the body frame by q (..., 4); broadcast; returns (..., 3)."""
    return rotate(conjugate(q), v)


def matrix(q: np.ndarray) -> np.ndarray:
    """Rotation matrix body to earth. Shape (..., 4) to (..., 3, 3)."""
    w, x, y, z = np.moveaxis(np.asarray(q, float), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def from_matrix(m: np.ndarray) -> np.ndarray:
    """Quaternions (4,) or (n, 4) of rotation matrices (3, 3) or (n, 3, 3) body to earth, the nearest rotation of each.

    Raises ValueError for a reflection, a singular matrix or NaN.
    """
    from scipy.spatial.transform import Rotation  # takes longer to import than all else that starts a run

    return Rotation.from_matrix(m).as_quat(scalar_first=True)


def from_euler(roll: np.ndarray, pitch: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Quaternion of Euler angles (rad, 3-2-1), each (...); returns (..., 4)."""
    cr, sr = np.cos(np.multiply(roll, 0.5)), np.sin(np.multiply(roll, 0.5))
    cp, sp = np.cos(np.multiply(pitch, 0.5)), np.sin(np.multiply(pitch, 0.5))
    cy, sy = np.cos(np.multiply(yaw, 0.5)), np.sin(np.multiply(yaw, 0.5))
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def to_euler(q: np.ndarray) -> np.ndarray:
    """Euler angles roll, pitch, yaw (..., 3), rad, 3-2-1, roll and yaw in (-pi, pi], of quaternions (..., 4).

    With the nose straight up or down only roll - yaw or roll + yaw is defined: roll is 0 there and yaw holds all of it,
    so that `from_euler` gives the attitude back.
    """
    w, x, y, z = np.moveaxis(np.asarray(q, float), -1, 0)
    north, east = 1 - 2 * (y * y + z * z), 2 * (w * z + x * y)  # of the nose
    level = np.hypot(north, east)  # cosine of the pitch
    pole = level < POLE
    pitch = np.arctan2(2 * (w * y - z * x), level)
    roll = np.where(pole, 0.0, np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
    yaw = np.where(pole, np.arctan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z)), np.arctan2(east, north))
    return np.stack([roll, pitch, yaw], axis=-1)


def to_jpl(q: np.ndarray) -> np.ndarray:
    """JPL quaternions x y z w (..., 4) of Hamilton ones w x y z.

    The numbers are the same, their order and meaning differ: a JPL quaternion carries earth vectors into body axes, and
    JPL products are written the other way round. Source: Trawny & Roumeliotis, Indirect Kalman filter for 3D attitude
    estimation, 2005.
    """
    return np.roll(np.asarray(q, float), -1, axis=-1)


def from_jpl(q: np.ndarray) -> np.ndarray:
    """Hamilton quaternions w x y z (..., 4) of JPL ones x y z w; inverse of `to_jpl`."""
    return np.roll(np.asarray(q, float), 1, axis=-1)


def exponential(rotation_vector: np.ndarray) -> np.ndarray:
    """Quaternion of a rotation vector (..., 3), rad; returns (..., 4)."""
    v = np.asarray(rotation_vector, float)
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    half = 0.5 * angle
    # sin(a/2)/a written with sinc so that zero rotation needs no special case
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * v], axis=-1)


def logarithm(q: np.ndarray) -> np.ndarray:
    """Rotation vector (..., 3), rad, of the shorter way round, of quaternions (..., 4)."""
    q = np.asarray(q, float)
    q = np.where(q[..., :1] < 0, -q, q)
    s = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(s, q[..., :1])
    factor = np.where(s > 1e-12, angle / np.where(s > 1e-12, s, 1.0), 2.0)
    return factor * q[..., 1:]


def continuous(q: np.ndarray) -> np.ndarray:
    """Choose the sign of each quaternion (N, 4) so that neighbours lie on the same half of the sphere."""
    q = np.array(q, float)
    if len(q) < 2:
        return q
    flips = np.sign(np.sum(q[1:] * q[:-1], axis=-1))
    flips[flips == 0] = 1.0
    q[1:] *= np.cumprod(flips)[:, None]
    return q


def body_rates(q: np.ndarray, t: np.ndarray) -> np.ndarray:
    """True body rates p, q, r (N, 3), rad/s, of an attitude history (N, 4) at times t (N,), s, by central differences.

    The rotation from one sample to the next, in body axes, over the time between them; exact for a constant rate.
    """
    q, t = np.asarray(q, float), np.asarray(t, float)
    step = logarithm(multiply(conjugate(q[:-1]), q[1:])) / np.diff(t)[:, None]
    rates = np.empty((len(q), 3))
    rates[0], rates[-1] = step[0], step[-1]
    dt = np.diff(t)
    left, right = dt[:-1, None], dt[1:, None]
    rates[1:-1] = (step[:-1] * right + step[1:] * left) / (left + right)
    return rates


def interpolate(q: np.ndarray, t: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Spherical interpolation of attitudes (N, 4) at times t (N,) to times `at` (M,), held beyond the ends."""
    q, t, at = continuous(q), np.asarray(t, float), np.asarray(at, float)
    if len(q) == 1:
        return np.repeat(q, len(at), axis=0)
    i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    share = np.clip((at - t[i]) / (t[i + 1] - t[i]), 0.0, 1.0)
    step = logarithm(multiply(conjugate(q[i]), q[i + 1]))
    return continuous(multiply(q[i], exponential(step * share[:, None])))
