"""PX4 logs (ULog), by pyulog.

Axes are those of PX4: body FRD, local NED, quaternions w x y z from body to local. Sources: the ULog file format
and the uORB message reference of the PX4 guide. What changed over versions:
    sensor_combined       integration times in s (2016), later in us. A sample is the mean over its integration time
                          before the stamp, so that its clock is moved to the middle
    vehicle_angular_velocity  low-passed on board (IMU_GYRO_CUTOFF). sensor_combined is taken unless it is slower
    esc_status            one report for each ESC with its own stamp; actuator_function names the motor (101: motor 1)
    actuator_motors       from 0 to 1; before, actuator_outputs holds PWM between PWM_MIN and PWM_MAX
    visual and mocap odometry  x y z and q, later position[] and q[]
"""

import contextlib
import io
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import ReadError, add_caution
from quasi.importing.readers.known_topics import INSTANCE, MOTORS, PWM_RANGE, Known
from quasi.importing.readers.reader import needs_extra
from quasi.importing.readers.signals import Signals, Topic, seconds_of
from quasi.importing.readers.topics import low_pass_delays, topics_reader
from quasi.tables import read_bytes

MICRO = 1e-6  # s
INVALID_RELATIVE = 0x7FFFFFFF  # accelerometer_timestamp_relative of a sample without accelerometer (message reference)
FIRST_ACTUATOR_FUNCTION = 101  # actuator_function of motor 1 (message reference)
MOST_SHORT_READS = 1000  # of a whole or cut log there is one, at its end

Group = tuple[str, np.ndarray, dict[str, np.ndarray]]  # name, clock in s, {field: samples}
_VALID = {"xy_valid": ("x", "y"), "z_valid": ("z",), "v_xy_valid": ("vx", "vy"), "v_z_valid": ("vz",)}
_INDICES = ("[0]", "[1]", "[2]")
_Q_ARRAY = dict(zip(("qw", "qx", "qy", "qz"), (("q[0]", "1"), ("q[1]", "1"), ("q[2]", "1"), ("q[3]", "1"))))


def _vector(names: Collection[str], field: str, unit: str) -> dict[str, tuple[str, str]]:
    return {n: (f"{field}{place}", unit) for n, place in zip(names, _INDICES)}


def _odometry(topic: str) -> list[Known]:
    """A pose from outside, in the fields of both generations of the message."""
    return [
        Known("capture", topic, {**_vector("xyz", "position", "m"), **_Q_ARRAY}),
        Known("capture", topic, {n: (n, "m") for n in "xyz"} | _Q_ARRAY),
    ]


_XYZ_RATES = _vector("pqr", "xyz", "rad/s")
_LOCAL_SPEED = {"vx": ("vx", "m/s"), "vy": ("vy", "m/s"), "vz": ("vz", "m/s")}
KNOWN = (
    Known("body rates", f"sensor_combined{INSTANCE}", _vector("pqr", "gyro_rad", "rad/s")),
    Known("body rates", f"vehicle_angular_velocity{INSTANCE}", _XYZ_RATES, better=1.5),
    Known("specific force", f"sensor_combined/accelerometer{INSTANCE}",
          _vector(("ax", "ay", "az"), "accelerometer_m_s2", "m/s2")),
    Known("specific force", f"vehicle_acceleration{INSTANCE}", _vector(("ax", "ay", "az"), "xyz", "m/s2"), better=1.5),
    Known("attitude", f"vehicle_attitude{INSTANCE}", _Q_ARRAY),
    Known("position", f"vehicle_local_position{INSTANCE}", {n: (n, "m") for n in "xyz"}),
    Known("velocity", f"vehicle_local_position{INSTANCE}", _LOCAL_SPEED),
    Known("rotor speeds", r"esc_status(/\d+)?(:\d+)?",
          {f"w{i}": (f"motor{i}_rpm", "rpm") for i in range(1, MOTORS + 1)}),
    Known("commands", f"actuator_motors{INSTANCE}",
          {f"command{i + 1}": (f"control[{i}]", "1") for i in range(MOTORS)}),
    Known("commands", f"actuator_outputs{INSTANCE}",
          {f"command{i + 1}": (f"share[{i}]", "1") for i in range(MOTORS)}),
    Known("battery", f"battery_status{INSTANCE}",
          {"battery_voltage": ("voltage_v", "V"), "battery_current": ("current_a", "A")}),
    *_odometry(f"vehicle_mocap_odometry{INSTANCE}"),
    *_odometry(f"vehicle_visual_odometry{INSTANCE}"),
    Known("capture", f"att_pos_mocap{INSTANCE}", {n: (n, "m") for n in "xyz"} | _Q_ARRAY),
)  # fmt: skip
TOPICS = sorted({re.match(r"\w+", way.match)[0] for way in KNOWN})


class _Bounded(io.BytesIO):
    """A file in memory that ends: pyulog steps back from the end of a damaged one again and again."""

    short = 0

    def read(self, size: int | None = -1) -> bytes:
        found = super().read(size)
        if size is not None and 0 <= len(found) < size:
            self.short += 1
            if self.short > MOST_SHORT_READS:
                raise ValueError("damaged up to its end")
        return found


class UlogFile:
    """A ULog as named signals; a second instance of a topic is called "topic:1"."""

    def __init__(self, path: Path, notes: list[str]) -> None:
        self.path = path
        log = self._parse(TOPICS)
        self.parameters = {k: v for k, v in log.initial_parameters.items() if isinstance(v, int | float)}
        self.formats = {name: [f[2] for f in about.fields] for name, about in log.message_formats.items()}
        lost = sum(d.duration for d in log.dropouts) * 1e-3
        if lost:
            longest = max(d.duration for d in log.dropouts) * 1e-3
            notes.append(
                f"{path}: the logger dropped {lost:.2f} s in {len(log.dropouts)} drop-outs, the longest of "
                f"{longest:.2f} s; use a faster card, or log fewer topics"
            )
        if log.file_corruption:
            add_caution(notes, f"{path}: parts of the log are damaged and were left out; copy it from the card again")
        self.frames: dict[str, pd.DataFrame] = {}
        self.clocks: dict[str, np.ndarray] = {}
        self._take(log)
        release = log.msg_info_dict.get("ver_sw_release")
        number = release if isinstance(release, int) else 0
        version = f"{number >> 24 & 255}.{number >> 16 & 255}.{number >> 8 & 255}" if number else ""
        self.facts: dict[str, Any] = {
            "format": "ULog",
            "firmware": {"revision": f"PX4 {version}".strip(), "hash": str(log.msg_info_dict.get("ver_sw", ""))},
            "drop-outs": {"count": len(log.dropouts), "lost": lost, "unit": "s"},
            "parameters": {k: v for k, v in self.parameters.items() if re.match(_PX4_FACTS, k)},
        }

    def _parse(self, topics: Collection[str] | None) -> Any:
        with needs_extra("px4", self.path, "a PX4 ULog"):
            from pyulog import ULog
        data, silenced = read_bytes(self.path), io.StringIO()
        try:
            with contextlib.redirect_stdout(silenced):
                log = ULog(_Bounded(data), None if topics is None else list(topics))
        except Exception as error:  # pyulog raises whatever a damaged header makes of its parser
            raise ReadError(
                f"{self.path} is no readable ULog ({' '.join(str(error).split())[:120] or 'damaged'}); copy "
                "it from the flight controller again"
            ) from None
        if not log.data_list and topics is None:
            raise ReadError(f"{self.path} holds no messages; it was cut off before the first, give another log")
        return log

    def _take(self, log: Any) -> None:
        """Frames and clocks, s, of what was parsed."""
        for data in log.data_list:
            if "timestamp" not in data.data:
                continue  # its format is damaged
            suffix = f":{data.multi_id}" if data.multi_id else ""
            for group, stamps, columns in _groups(data.name, data.data, self.parameters):
                name = f"{group}{suffix}"
                self.frames[name] = pd.DataFrame({f"{name}.{field}": values for field, values in columns.items()})
                self.clocks[name] = stamps

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics with samples, and those of which the log declares the format alone."""
        found = {
            name: Topic("", tuple(map(str, frame.columns)), len(frame), seconds_of(self.clocks[name]))
            for name, frame in self.frames.items()
        }
        absent = {name: Topic("", tuple(f"{name}.{f}" for f in fields), 0) for name, fields in self.formats.items()}
        return {n: t for n, t in absent.items() if n not in found} | found

    def samples_of(self, columns: Collection[str], notes: list[str]) -> Signals:
        """See `LogFile`. Topics that are not known are parsed on demand."""
        names = {column.partition(".")[0] for column in columns}
        further = {re.split("[:/]", name)[0] for name in names - set(self.frames)} & set(self.formats)
        if further:
            self._take(self._parse(further))
        return Signals(self.frames, self.clocks).only(columns)


_PX4_FACTS = (
    r"CA_ROTOR|CA_AIRFRAME|THR_MDL_FAC|PWM_M(IN|AX)$|PWM_MAIN_M|IMU_GYRO_|IMU_ACCEL_CUTOFF|SYS_AUTOSTART|MAV_TYPE"
)


def _groups(name: str, data: Mapping[str, np.ndarray], parameters: Mapping[str, Any]) -> list[Group]:
    """[(group, clock in s, {field: samples})] of one topic."""
    stamp = data["timestamp"].astype(float) * MICRO
    if name == "sensor_combined":
        return _sensor_combined(data, stamp)
    if name == "esc_status":
        return _escs(data, stamp, parameters)
    fields: dict[str, np.ndarray] = dict(data)
    if name == "actuator_outputs":
        fields |= _shares(data, parameters)
    if name == "battery_status":
        # -1 or 0 where it is not measured (message reference)
        fields |= {f: np.where(data[f] > 0, data[f], np.nan) for f in ("voltage_v", "current_a") if f in data}
    if name == "vehicle_local_position":
        for valid, members in _VALID.items():
            if valid in data:
                fields |= {m: np.where(data[valid] == 1, data[m], np.nan) for m in members if m in data}
    sampled = data.get("timestamp_sample")
    # commands take effect when they are published; measurements hold for when they were sampled
    if sampled is not None and not name.startswith("actuator") and np.all(sampled > 0):
        stamp = sampled.astype(float) * MICRO
    return [(name, stamp, fields)]


def _sensor_combined(data: Mapping[str, np.ndarray], stamp: np.ndarray) -> list[Group]:
    """Gyro and accelerometer apart, each at the middle of its integration time."""
    parts = []
    for sensor, group in (("gyro", "sensor_combined"), ("accelerometer", "sensor_combined/accelerometer")):
        at, keep = stamp.copy(), np.ones(len(stamp), bool)
        relative = data.get(f"{sensor}_timestamp_relative")
        if relative is not None:
            keep = relative != INVALID_RELATIVE
            at += np.where(keep, relative, 0) * MICRO
        over = data.get(f"{sensor}_integral_dt")
        if over is not None:
            at -= 0.5 * (over if np.issubdtype(over.dtype, np.floating) else over * MICRO)
        fields = {f: values[keep] for f, values in data.items() if f.startswith(sensor)}
        parts.append((group, at[keep], fields))
    return parts


def _escs(data: Mapping[str, np.ndarray], stamp: np.ndarray, parameters: Mapping[str, Any]) -> list[Group]:
    """Speed of each motor: one group where all ESCs were stamped alike, else one for each ESC."""
    escs = [k for k in range(MOTORS) if f"esc[{k}].esc_rpm" in data]
    functions = {k: int(f[-1]) for k in escs if len(f := data.get(f"esc[{k}].actuator_function", ()))}
    named = any(function >= FIRST_ACTUATOR_FUNCTION for function in functions.values())
    count = int(parameters.get("CA_ROTOR_COUNT") or MOTORS)
    found: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for k in escs:
        motor = functions[k] - FIRST_ACTUATOR_FUNCTION + 1 if named else k + 1
        own = data.get(f"esc[{k}].timestamp")
        if not 1 <= motor <= min(count, MOTORS) or (own is not None and not own.any()):
            continue
        # negative where the rotor is reversed: the axes of thrust and torque follow from the geometry
        speed = np.abs(data[f"esc[{k}].esc_rpm"].astype(float))
        found[motor] = (stamp if own is None else own.astype(float) * MICRO, speed)
    times = [t for t, _ in found.values()]
    if times and all(np.array_equal(t, times[0]) for t in times):
        return [("esc_status", times[0], {f"motor{m}_rpm": speed for m, (_, speed) in sorted(found.items())})]
    return [(f"esc_status/{m}", t, {f"motor{m}_rpm": speed}) for m, (t, speed) in sorted(found.items())]


def _shares(data: Mapping[str, np.ndarray], parameters: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Motor outputs as shares of their range: {"share[k]"} for the outputs of motors; 0 while disarmed."""
    shares: dict[str, np.ndarray] = {}
    for k in range(16):
        output = data.get(f"output[{k}]")
        function = int(parameters.get(f"PWM_MAIN_FUNC{k + 1}", FIRST_ACTUATOR_FUNCTION + k))
        if (
            output is None
            or not FIRST_ACTUATOR_FUNCTION <= function < FIRST_ACTUATOR_FUNCTION + MOTORS
            or not np.nanmax(output, initial=0.0) > 0
        ):
            continue
        if np.nanmax(output) <= 1.0:
            share = output.astype(float)
        else:
            low = float(parameters.get(f"PWM_MAIN_MIN{k + 1}", parameters.get("PWM_MIN", PWM_RANGE[0])))
            high = float(parameters.get(f"PWM_MAIN_MAX{k + 1}", parameters.get("PWM_MAX", PWM_RANGE[1])))
            if not low < high or np.nanmax(output) > 1.2 * high:
                continue
            share = np.clip((output - low) / (high - low), 0.0, 1.0)
        shares[f"share[{function - FIRST_ACTUATOR_FUNCTION}]"] = share
    return shares


def _delays(log: UlogFile, mapping: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """How late the IMU is filtered on board; sensor_combined comes before the filters."""
    notch = bool(log.parameters.get("IMU_GYRO_DNF_EN", 0))
    return low_pass_delays(mapping, log.parameters, {
        "gyro": (r"vehicle_angular_velocity(:\d+)?\.", "IMU_GYRO_CUTOFF", notch),
        "accelerometer": (r"vehicle_acceleration(:\d+)?\.", "IMU_ACCEL_CUTOFF", False),
    })  # fmt: skip


READER = topics_reader("a PX4 ULog", ("ulog",), UlogFile, KNOWN, "px4", _delays)
