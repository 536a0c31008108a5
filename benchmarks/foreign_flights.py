"""What a lab's sensors make of a foreign simulator's motion, and the files that they write.

Motion is given on a uniform grid in the axes that RotorPy and MuJoCo share: world z up, body x forward, y left, z up.
The sensor errors follow data sheets of small vehicles: white IMU noise, vibration at the rotors' speeds, a second-order
low-pass at 120 Hz (the anti-aliasing filters of common IMUs), biases, eRPM as whole hundreds, and a capture with an own
clock, sub-millimetre noise and slightly misplaced markers. Nothing here uses quasi.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt
from scipy.spatial.transform import Rotation, Slerp

GRAVITY = 9.81  # m/s2, of RotorPy and of MuJoCo's default
FINE = 2000  # Hz, of the sensors
ERPM = 14 / 2 * 60 / (2 * np.pi) / 100  # eRPM/100 of 1 rad/s, 14 poles


@dataclass(frozen=True)
class Motion:
    """A flight's true motion on a uniform grid.

    t (n,) s; position (n, 3) m of the cg, world; attitude (n, 4) x y z w, body to world; rates (n, 3) rad/s and
    angular_acceleration (n, 3), body; force (n, 3) specific force at the cg, m/s2, body; speeds (n, 4) rad/s; commands
    (n, 4) 0 to 1
    """

    t: np.ndarray
    position: np.ndarray
    attitude: np.ndarray
    rates: np.ndarray
    angular_acceleration: np.ndarray
    force: np.ndarray
    speeds: np.ndarray
    commands: np.ndarray


@dataclass(frozen=True)
class Sensors:
    """What is true of the sensors in one flight; lengths in body axes x forward, y left, z up.

    The noise is that of one sample at 2 kHz. Biases and marker turn are drawn from the flight's seed on top.
    """

    gyro_scale: float = 1.0
    accelerometer_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m/s2
    capture_delay: float = 0.004  # s, exposure to stamp
    attitude_delay: float = 0.0  # s, of the capture's attitude behind its position
    imu: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m from the cg
    markers: tuple[float, float, float] = (0.0, 0.0, 0.03)  # m from the cg
    accelerometer_noise: float = 0.3  # m/s2
    gyro_noise: float = 0.01  # rad/s
    telemetry_noise: float = 0.002  # of the speed of a rotor
    vibration: float = 1.5  # m/s2 at hover, along each axis, of each rotor's line
    hover: float = 469.0  # rad/s
    rotors: tuple[int, int, int, int] = (0, 1, 2, 3)  # rotor, from 0, that each column of speeds and commands holds
    capture_noise: float = 2e-4  # m
    attitude_noise: float = 1e-3  # rad, of the capture
    logged: int = 500  # Hz, a divisor of FINE
    captured: int = 120  # Hz
    gaps: int = 0  # spans of 0.3 s that the capture lacks


LABS: dict[str, dict[str, Any]] = {
    # a loose frame, a log of half the rate, and markers at the edge of what cameras see
    "rough": {
        "accelerometer_noise": 3.0, "gyro_noise": 0.05, "vibration": 6.0, "capture_noise": 1e-3, "attitude_noise": 5e-3,
        "telemetry_noise": 0.01, "logged": 250, "captured": 100, "gaps": 4,
    },
    # a log by radio: vibration folds into the motion
    "slow": {"accelerometer_noise": 1.0, "vibration": 3.0, "logged": 100, "captured": 200, "telemetry_noise": 0.005},
}  # fmt: skip


@dataclass(frozen=True)
class Vehicle:
    """What a lab knows about its vehicle; SI units, hubs (4, 3) in body axes x forward, y left, z up.

    arrays  whether its flights are written as .npz with the capture inside, else as CSV and a Vicon export
    """

    name: str
    mass: float
    inertia: tuple[float, float, float]
    hubs: np.ndarray
    first_turns: str
    radius: float
    fastest: float  # rad/s
    places: dict[str, int]
    arrays: bool = False

    def document(self) -> dict[str, Any]:
        """The quadrotor's JSON."""
        x, y, z = self.inertia
        if self.arrays:
            hubs = self.hubs * [1.0, -1.0, -1.0]
            places = {"rotor positions": {str(i + 1): hub.tolist() for i, hub in enumerate(hubs)}}
        else:
            places = {"rotor hub height": str(self.hubs[0, 2])}
        return {
            "rotor config": self.places,
            "rotor1 rotation direction": self.first_turns,
            "rotor radius": str(self.radius),
            **places,
            "b": f"{np.hypot(*self.hubs[0, :2]):.6g}",
            "optitrack marker cg offset": {"x": "0", "y": "0", "z": "-0.03"},
            "idle RPM": f"{0.05 * self.fastest * ERPM:.0f}",
            "max RPM": f"{self.fastest * ERPM:.0f}",
            "moment of inertia": f"[{x}, 0, 0; 0, {y}, 0; 0, 0, {z}]",
            "mass": str(self.mass),
            "motor poles": 14,
            "flight controller": "table",
            "table columns": arrays_mapping() if self.arrays else csv_mapping(),
        }


def csv_mapping() -> dict[str, Any]:
    """Of `write_csv`."""
    columns = {"pqr"[i]: {"column": f"gyro_{a}", "unit": "deg/s"} for i, a in enumerate("xyz")}
    columns |= {f"a{a}": {"column": f"acc_{a}", "unit": "g"} for a in "xyz"}
    columns |= {f"w{i}": {"column": f"erpm_{i}", "unit": "eRPM/100"} for i in range(1, 5)}
    columns |= {f"command{i}": {"column": f"motor_{i}", "unit": "%"} for i in range(1, 5)}
    return {"time": {"column": "time_us", "unit": "us"},
            "sources": [{"name": "log", "frame": "FLU", "columns": columns}]}  # fmt: skip


def arrays_mapping() -> dict[str, Any]:
    """Of `write_arrays`."""
    imu = {"pqr"[i]: {"column": f"gyro[{i}]", "unit": "rad/s"} for i in range(3)}
    imu |= {f"a{a}": {"column": f"acc[{i}]", "unit": "m/s2"} for i, a in enumerate("xyz")}
    esc = {f"w{i + 1}": {"column": f"rpm[{i}]", "unit": "rpm"} for i in range(4)}
    esc |= {f"command{i + 1}": {"column": f"throttle[{i}]"} for i in range(4)}
    poses = {a: {"column": f"mocap_p[{i}]", "unit": "m"} for i, a in enumerate("xyz")}
    poses |= {f"q{a}": f"mocap_q[{i}]" for i, a in enumerate("xyzw")}
    sources = [
        {"name": "imu", "time": {"column": "imu_t", "unit": "s"}, "columns": imu},
        {"name": "esc", "time": {"column": "esc_t", "unit": "s"}, "columns": esc},
        {"name": "mocap", "motion capture": True, "frame": "FLU", "world": "z-up",
         "time": {"column": "mocap_t", "unit": "s"}, "columns": poses},
    ]  # fmt: skip
    return {"time": {"column": "imu_t", "unit": "s"}, "sources": sources}


def at(t: np.ndarray, motion: Motion, values: np.ndarray) -> np.ndarray:
    """Values of the grid at other times, by cubic splines; constant beyond the ends."""
    return CubicSpline(motion.t, values)(np.clip(t, motion.t[0], motion.t[-1]))


class Board(NamedTuple):
    """What the flight controller holds: stamps (n,) s, gyro rad/s, specific force m/s2, eRPM/100, commands 0 to 1."""

    t: np.ndarray
    gyro: np.ndarray
    force: np.ndarray
    telemetry: np.ndarray
    commands: np.ndarray


class Capture(NamedTuple):
    """t (n,) s on the board's clock, marker position (n, 3) m, attitude (n, 4) x y z w."""

    t: np.ndarray
    position: np.ndarray
    attitude: np.ndarray


def measure(motion: Motion, sensors: Sensors, rng: np.random.Generator) -> Board:
    """IMU and telemetry of a flight."""
    t = np.arange(0.0, motion.t[-1], 1 / FINE)
    rates, swing, force = (at(t, motion, v) for v in (motion.rates, motion.angular_acceleration, motion.force))
    arm = np.array(sensors.imu)
    force = force + np.cross(swing, arm) + np.cross(rates, np.cross(rates, arm))
    speeds = at(t, motion, motion.speeds)
    angle = np.cumsum(speeds, axis=0) / FINE + rng.uniform(0, 2 * np.pi, 4)
    size = sensors.vibration * (speeds / sensors.hover) ** 2
    for axis in range(3):
        force[:, axis] += np.sum(size * np.sin(angle + rng.uniform(0, 2 * np.pi, 4)), axis=1)
        rates[:, axis] += 0.02 * np.sum(size * np.sin(angle + rng.uniform(0, 2 * np.pi, 4)), axis=1)
    force += rng.normal(0.0, sensors.accelerometer_noise, force.shape)
    force += np.array(sensors.accelerometer_bias) + rng.normal(0.0, 0.05, 3)
    rates = sensors.gyro_scale * rates + rng.normal(0.0, sensors.gyro_noise, rates.shape) + rng.normal(0.0, 0.01, 3)
    low_pass = butter(2, 120.0, fs=FINE, output="sos")
    start = slice(FINE // 10, None, FINE // sensors.logged)  # the filters have started
    gyro, acc, stamps = sosfilt(low_pass, rates, axis=0)[start], sosfilt(low_pass, force, axis=0)[start], t[start]
    jitter = 1 + rng.normal(0, sensors.telemetry_noise, (len(stamps), 4))
    telemetry = np.round(at(stamps - 0.002, motion, motion.speeds) * ERPM * jitter)
    rows = np.clip(np.searchsorted(motion.t, stamps, "right") - 1, 0, len(motion.t) - 1)
    columns = list(sensors.rotors)
    return Board(stamps, gyro, acc, telemetry[:, columns], motion.commands[rows][:, columns])


def film(motion: Motion, sensors: Sensors, rng: np.random.Generator) -> Capture:
    """Motion capture of a flight; it starts 0.7 to 1.5 s after the log."""
    seen = np.arange(rng.uniform(0.7, 1.5), motion.t[-1] - 0.1, 1 / sensors.captured)
    where = at(seen - sensors.capture_delay, motion, motion.position)
    turns = Slerp(motion.t, Rotation.from_quat(motion.attitude))
    where = where + turns(seen - sensors.capture_delay).apply(np.array(sensors.markers))
    where = where + rng.normal(0.0, sensors.capture_noise, where.shape)
    turn = Rotation.from_rotvec(rng.normal(0.0, np.radians(0.1), 3))
    noise = Rotation.from_rotvec(rng.normal(0.0, sensors.attitude_noise, (len(seen), 3)))
    shown = turns(seen - sensors.capture_delay - sensors.attitude_delay) * turn * noise
    attitude = shown.as_quat()
    for start in rng.uniform(0.2, 0.8, sensors.gaps) * seen[-1]:
        gone = (seen > start) & (seen < start + 0.3)
        where[gone], attitude[gone] = np.nan, np.nan
    return Capture(seen, where, attitude)


def write_csv(path: Path, board: Board) -> None:
    """The on-board log as CSV: microseconds, deg/s, g, eRPM/100 and percent; x forward, y left, z up."""
    table = {"time_us": np.round(1e6 * board.t).astype(int)}
    table |= {f"gyro_{a}": np.round(np.degrees(board.gyro[:, i]), 3) for i, a in enumerate("xyz")}
    table |= {f"acc_{a}": np.round(board.force[:, i] / 9.80665, 5) for i, a in enumerate("xyz")}
    table |= {f"erpm_{i + 1}": board.telemetry[:, i] for i in range(4)}
    table |= {f"motor_{i + 1}": np.round(100 * board.commands[:, i], 3) for i in range(4)}
    pd.DataFrame(table).to_csv(path, index=False)


def write_vicon(path: Path, capture: Capture) -> None:
    """The capture as Vicon Tracker exports it, on its own clock: z up, mm, quaternions."""
    rows = np.column_stack([capture.attitude, 1000.0 * capture.position])
    rate = round((len(capture.t) - 1) / (capture.t[-1] - capture.t[0]))
    lines = ["Objects", str(rate), ",,Quad:Quad,,,,,,", "Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ", ",,,,,,mm,mm,mm"]
    lines += [
        ",".join([str(k + 1), "0", *("" if np.isnan(v) else f"{v:.7g}" for v in row)]) for k, row in enumerate(rows)
    ]
    path.write_text("\r\n".join([*lines, ""]))


def write_arrays(path: Path, board: Board, capture: Capture) -> None:
    """All in one .npz on one clock, as a lab's script saves it: SI units, FRD axes of the board, capture with z up."""
    half_turn = np.array([1.0, -1.0, -1.0])
    np.savez(
        path, imu_t=board.t, gyro=board.gyro * half_turn, acc=board.force * half_turn, esc_t=board.t[::2],
        rpm=board.telemetry[::2] * 100 / 7, throttle=board.commands[::2], mocap_t=capture.t,
        mocap_p=capture.position, mocap_q=capture.attitude,
    )  # fmt: skip
