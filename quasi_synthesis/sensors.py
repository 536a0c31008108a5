"""Sensors of the made vehicle: inertial unit, filters on board, rotor telemetry, motion capture.

The inertial part is compiled and runs inside the flight loop, because the controller flies on it.
Filters: two low-passes in a row on the gyro, one on the accelerometer. PT1 is a first-order lag, PT2 two of them with
a corner that makes the pair 3 dB down at the stated frequency, biquad a second-order Butterworth filter. Betaflight
has the biquad on the accelerometer before version 4.3 and the PT2 since.
Source of the biquad: Oppenheim & Schafer, Discrete-Time Signal Processing, 3rd ed., 2010, section 7.2 (bilinear
transform).
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi import attitude
from quasi_synthesis.vehicle import BASE_HOVER_SPEED, MARKER_OFFSET

NO_FILTER, PT1, PT2, BIQUAD = 0, 1, 2, 3
FILTER_KINDS = {"PT1": PT1, "PT2": PT2, "biquad": BIQUAD}
LOST, REPEATED_PACKET = 1, 2  # fates of a packet of rotor telemetry; 0 is none
PT2_CORNER = 1.0 / math.sqrt(math.sqrt(2.0) - 1.0)  # corner of each of two PT1 for a pair 3 dB down


class Inertial(NamedTuple):
    """Errors and filters of gyro and accelerometer; measured = scale x (axes' x true) + bias + noise.

    mode_...  one structural mode per body axis: the frame shakes the unit along and about that axis. Turbulent loads
    of the rotors excite it in proportion to their squared speed. A mode of zero size is absent.
    """

    position: np.ndarray = np.zeros(3)  # (3,) m from the true cg, body axes
    axes: np.ndarray = np.eye(3)  # (3, 3), columns: the true sensor axes in body axes
    gyro_bias: np.ndarray = np.zeros(3)  # (3,) rad/s
    gyro_scale: np.ndarray = np.ones(3)  # (3,)
    acc_bias: np.ndarray = np.zeros(3)  # (3,) m/s2
    acc_scale: np.ndarray = np.ones(3)  # (3,)
    gyro_noise: float = 0.0  # rad/s per sample of the loop
    acc_noise: float = 0.0  # m/s2 per sample of the loop
    gyro_vibration: float = 0.0  # rad/s of one rotor's line at hover speed
    acc_vibration: float = 0.0  # m/s2 of one rotor's line at hover speed
    hover_speed: float = BASE_HOVER_SPEED  # rad/s
    gyro_kind_1: int = PT1  # NO_FILTER, PT1, PT2 or BIQUAD
    gyro_cut_1: float = 250.0  # Hz
    gyro_kind_2: int = PT1
    gyro_cut_2: float = 500.0  # Hz
    acc_kind: int = PT2
    acc_cut: float = 100.0  # Hz
    gyro_delay: float = 0.0  # s, from a motion to the reading, before the filters
    acc_delay: float = 0.0  # s
    mode_frequency: np.ndarray = np.zeros(3)  # (3,) rad/s
    mode_damping: np.ndarray = np.zeros(3)  # (3,) of critical
    mode_acceleration: np.ndarray = np.zeros(3)  # (3,) m/s2, standard deviation at hover speed
    mode_rate: np.ndarray = np.zeros(3)  # (3,) rad/s, standard deviation at hover speed
    gyro_range: float = math.radians(2000.0)  # rad/s
    acc_range: float = 16.0 * attitude.GRAVITY  # m/s2


class Telemetry(NamedTuple):
    """Rotor speed as the speed controllers report it."""

    age: float  # s, of a report when it is logged
    interval: int  # loop steps between reports
    scale: float  # logged / true
    to_log: float  # eRPM/100 per rad/s
    faults: np.ndarray  # (reports, 4) 0, LOST (the log keeps the last) or REPEATED_PACKET


@njit(cache=True, error_model="numpy")
def read_inertial(rates, spin_up, force, speeds, phases, s: Inertial, raw):
    """A reading without noise: raw (6,) is filled with gyro (rad/s) and specific force (m/s2) along the unit's axes.

    rates, spin_up (angular acceleration), force (specific force at the cg), body axes; speeds (4,) rad/s, phases (4,)
    rad.
    """
    r = s.position  # no array is made here: with one, the references to all of `s` are counted in every step
    wx, wy, wz = rates[0], rates[1], rates[2]
    ax, ay, az = spin_up[0], spin_up[1], spin_up[2]
    dot = wx * r[0] + wy * r[1] + wz * r[2]
    square = wx * wx + wy * wy + wz * wz
    fx = force[0] + ay * r[2] - az * r[1] + wx * dot - square * r[0]
    fy = force[1] + az * r[0] - ax * r[2] + wy * dot - square * r[1]
    fz = force[2] + ax * r[1] - ay * r[0] + wz * dot - square * r[2]
    for k in range(3):
        gyro = s.axes[0, k] * wx + s.axes[1, k] * wy + s.axes[2, k] * wz
        acc = s.axes[0, k] * fx + s.axes[1, k] * fy + s.axes[2, k] * fz
        raw[k] = s.gyro_scale[k] * gyro + s.gyro_bias[k]
        raw[3 + k] = s.acc_scale[k] * acc + s.acc_bias[k]
    shake_p = shake_q = shake_r = shake_x = shake_y = shake_z = 0.0
    for i in range(4):
        level = (speeds[i] / s.hover_speed) ** 2
        one, two = math.cos(phases[i] + i), math.sin(2.0 * phases[i] + 2.0 * i)
        three, quarter = math.cos(3.0 * phases[i] + i), math.sin(phases[i] + i)
        shake_p += level * s.gyro_vibration * (one + 0.3 * two)
        shake_q += level * s.gyro_vibration * (quarter + 0.3 * three)
        shake_r += level * s.gyro_vibration * 0.4 * (one + 0.3 * two)
        shake_x += level * s.acc_vibration * (one + 0.5 * two)
        shake_y += level * s.acc_vibration * (quarter + 0.5 * three)
        shake_z += level * s.acc_vibration * (0.5 * one + 0.6 * three)
    raw[0] += shake_p
    raw[1] += shake_q
    raw[2] += shake_r
    raw[3] += shake_x
    raw[4] += shake_y
    raw[5] += shake_z


@njit(cache=True, error_model="numpy")
def shake_modes(speeds, noise, dt, s: Inertial, modes, raw):
    """Advance the structural modes by dt s and add their motion to a reading raw (6,).

    speeds (4,) rad/s; noise (3,) standard normal; modes (3, 2): deflection of unit variance and its rate.
    A deflection x'' + 2 zeta w x' + w2 x = n with white n of density 4 zeta w3 has unit variance, its rate w2.
    """
    level = 0.0
    for i in range(4):
        level += 0.25 * (speeds[i] / s.hover_speed) ** 2
    for k in range(3):
        w = s.mode_frequency[k]
        if w <= 0.0:
            continue
        pull = -2.0 * s.mode_damping[k] * w * modes[k, 1] - w * w * modes[k, 0]
        modes[k, 1] += dt * pull + level * math.sqrt(4.0 * s.mode_damping[k] * w**3 * dt) * noise[k]
        modes[k, 0] += dt * modes[k, 1]
        raw[k] += s.mode_rate[k] * modes[k, 1] / w
        raw[3 + k] += s.mode_acceleration[k] * modes[k, 0]


@njit(cache=True, error_model="numpy")
def delay_and_add_noise(readings, step, noise, dt, s: Inertial, raw):
    """The delayed reading with noise, within the sensors' ranges, in raw (6,).

    readings (n, 6) is a ring of the latest, readings[step % n] the newest; noise (6,) standard normal.
    """
    n = readings.shape[0]
    for k in range(6):
        steps = (s.gyro_delay if k < 3 else s.acc_delay) / dt
        whole = int(steps)
        part = steps - whole
        newer, older = readings[(step - whole) % n, k], readings[(step - whole - 1) % n, k]
        std, most = (s.gyro_noise, s.gyro_range) if k < 3 else (s.acc_noise, s.acc_range)
        value = (1.0 - part) * newer + part * older + std * noise[k]
        raw[k] = min(max(value, -most), most)


@njit(cache=True, error_model="numpy")
def filter_coefficients(kind, cut, dt):
    """Coefficients (5,) of a low-pass at steps of dt s: the gain of the lags first, or b0, b1, b2, a1, a2."""
    c = np.zeros(5)
    if kind == BIQUAD:
        tangent = math.tan(math.pi * cut * dt)
        scale = 1.0 / (1.0 + math.sqrt(2.0) * tangent + tangent * tangent)
        c[0] = c[2] = tangent * tangent * scale
        c[1] = 2.0 * c[0]
        c[3] = 2.0 * (tangent * tangent - 1.0) * scale
        c[4] = (1.0 - math.sqrt(2.0) * tangent + tangent * tangent) * scale
    elif kind != NO_FILTER:
        c[0] = low_pass_gain(cut * PT2_CORNER if kind == PT2 else cut, dt)
    return c


@njit(cache=True, error_model="numpy")
def start_filter(value, kind, c, memory):
    """Fill the memory (2,) of a low-pass that has had `value` for a long time."""
    memory[0] = memory[1] = value
    if kind == BIQUAD:
        memory[1] = (c[2] - c[4]) * value
        memory[0] = (c[1] - c[3]) * value + memory[1]


@njit(cache=True, error_model="numpy")
def filter_step(value, kind, c, memory):
    """Next output of a low-pass; memory (2,) is updated."""
    if kind == NO_FILTER:
        return value
    if kind == BIQUAD:  # transposed direct form II
        out = c[0] * value + memory[0]
        memory[0] = c[1] * value - c[3] * out + memory[1]
        memory[1] = c[2] * value - c[4] * out
        return out
    memory[0] += c[0] * (value - memory[0])
    if kind == PT1:
        return memory[0]
    memory[1] += c[0] * (memory[0] - memory[1])
    return memory[1]


@njit(cache=True, error_model="numpy")
def low_pass_gain(cut, dt):
    """Gain of a discrete PT1, y += gain (x - y), with corner `cut` Hz at steps of dt s; 0 Hz lets all through."""
    if cut <= 0.0:
        return 1.0
    return dt / (dt + 1.0 / (2.0 * math.pi * cut))


class Capture(NamedTuple):
    """One motion-capture take, in the earth frame, on its own clock; NaN where the body was not seen."""

    time: np.ndarray  # (N,) s
    frame: np.ndarray  # (N,)
    position: np.ndarray  # (N, 3) m, marker centroid, earth NED
    quaternion: np.ndarray  # (N, 4) body to earth, w x y z
    markers: np.ndarray  # (N, K, 3) m, earth NED
    error: np.ndarray  # (N,) m, mean marker error
    rate: float
    faults: dict[str, list[list[float]]]


class CaptureErrors(NamedTuple):
    """What a capture system adds to the truth; angles rad, times s."""

    rate: float = 120.0
    start: float = -3.0  # true time at which the take begins, s after the log's first frame
    skew: float = 0.0  # capture clock fast by this share
    position_noise: float = 0.0
    attitude_noise: float = 0.0
    latency: float = 0.0
    rotation_delay: float = 0.0
    body_turn: np.ndarray = np.zeros(3)  # (3,) assumed marker axes onto the true ones, body axes
    room_turn: np.ndarray = np.zeros(3)  # (3,) assumed room axes onto the true ones, earth axes
    offset: np.ndarray = MARKER_OFFSET  # (3,) marker centroid from the true cg, body axes
    drop_outs: int = 0
    swaps: int = 0


MARKERS = np.array([[0.055, 0.030, -0.004], [0.050, -0.045, 0.006], [-0.060, -0.020, -0.002], [-0.045, 0.035, 0.0]])
SEEN_MARKERS = MARKERS - MARKERS.mean(axis=0)  # m, about their centroid, body axes


def capture(
    t: np.ndarray, position: np.ndarray, quaternion: np.ndarray, errors: CaptureErrors, rng: np.random.Generator
) -> Capture:
    """A take of the flight whose true cg position (M, 3) and attitude (M, 4) are known at true times t (M,).

    Outside the flight's span the vehicle rests where it was first or last seen.
    """
    n = int((t[-1] + 2.0 - errors.start) * errors.rate)
    frame = np.arange(n)
    clock = frame / errors.rate
    true = errors.start + clock / (1.0 + errors.skew)
    at = true - errors.latency
    q = attitude.interpolate(quaternion, t, at)
    place = np.column_stack([np.interp(at, t, position[:, k]) for k in range(3)])
    place += attitude.rotate(q, errors.offset)
    seen = attitude.interpolate(quaternion, t, at - errors.rotation_delay)
    seen = attitude.multiply(seen, attitude.exponential(errors.body_turn))
    room = attitude.conjugate(attitude.exponential(errors.room_turn))
    place, seen = attitude.rotate(room, place), attitude.multiply(room, seen)
    noise = errors.attitude_noise * rng.standard_normal((n, 3))
    seen = attitude.multiply(seen, attitude.exponential(noise))
    place = place + errors.position_noise * rng.standard_normal((n, 3))
    markers = place[:, None, :] + np.stack([attitude.rotate(seen, m) for m in SEEN_MARKERS], axis=1)
    markers += 0.5 * errors.position_noise * rng.standard_normal(markers.shape)
    error = 1e-4 + 5e-5 * np.abs(rng.standard_normal(n)) * (errors.position_noise > 0)
    faults: dict[str, list[list[float]]] = {"drop-outs": [], "swaps": [], "sign flips": []}

    for _ in range(errors.swaps):  # two markers taken for each other: the body jumps for a few frames
        i, width = int(rng.integers(0, n - 40)), int(rng.integers(2, 9))
        axis = rng.standard_normal(3)
        turn = attitude.exponential(rng.uniform(0.35, 1.6) * axis / np.linalg.norm(axis))
        seen[i : i + width] = attitude.multiply(seen[i : i + width], turn)
        place[i : i + width] += rng.normal(0.0, 0.03, 3)
        error[i : i + width] += 0.012
        faults["swaps"].append([float(clock[i]), float(clock[i + width])])
    # trackers do not keep the quaternion's sign
    flips = np.sort(rng.integers(0, n, rng.poisson(4) if errors.swaps else 0))
    for i in flips:
        seen[i:] *= -1.0
        faults["sign flips"].append([float(clock[i])])
    for _ in range(errors.drop_outs):
        i = int(rng.integers(0, n - 60))
        width = int(rng.integers(1, 8)) if rng.random() < 0.7 else int(rng.integers(12, 50))
        place[i : i + width] = np.nan
        seen[i : i + width] = np.nan
        error[i : i + width] = np.nan
        for k in rng.permutation(len(SEEN_MARKERS))[: rng.integers(2, len(SEEN_MARKERS) + 1)]:
            markers[i : i + width, k] = np.nan
        faults["drop-outs"].append([float(clock[i]), float(clock[i + width])])
    return Capture(clock, frame, place, seen, markers, error, errors.rate, faults)
