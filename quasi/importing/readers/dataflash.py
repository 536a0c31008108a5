"""ArduPilot DataFlash logs (.bin), which describe themselves.

A message is 0xA3 0x95, its type, and fields packed without padding. FMT messages (type 128) give a type's length, name,
format characters and field names; FMTU gives units, among which '#' marks the field that numbers instances. Messages
of several instances become topics "IMU:0", "IMU:1". What cannot be a message is passed over to the next one and
counted. Source: the public log message documentation of ArduPilot (ardupilot.org/copter/docs/logmessages.html, and
"Adding a new log message" of the developer's guide).
"""

import re
import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import ReadError, add_caution
from quasi.importing.readers.known_topics import INSTANCE, MOTORS, PWM_RANGE, Known
from quasi.importing.readers.signals import Signals, Topic, seconds_of
from quasi.importing.readers.topics import low_pass_delays, topics_reader
from quasi.tables import read_bytes

MESSAGE_HEAD = b"\xa3\x95"
FMT = 128  # type of the messages that describe types
FMT_LENGTH = 89  # bytes: header 3, type 1, length 1, name 4, format 16, field names 64
# format character: numpy type, factor
NUMBER_FORMATS = {
    "b": ("i1", 1.0), "B": ("u1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0), "i": ("<i4", 1.0), "I": ("<u4", 1.0),
    "q": ("<i8", 1.0), "Q": ("<u8", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0), "g": ("<f2", 1.0), "M": ("u1", 1.0),
    "c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01), "L": ("<i4", 1e-7),
}  # fmt: skip
TEXTS = {"n": "S4", "N": "S16", "Z": "S64", "a": "V64"}
INSTANCES = ("I", "C", "Instance", "Inst", "Id")  # fields that number instances, in logs without FMTU
FIRST_SERVO_FUNCTION = 33  # SERVOn_FUNCTION of motor 1 (parameter reference)
LONGEST_LOG = 86400.0  # s from the middle of a log, beyond which a stamp is damaged

_GYRO_FIELDS = {"p": ("GyrX", "rad/s"), "q": ("GyrY", "rad/s"), "r": ("GyrZ", "rad/s")}
_FORCE = {"ax": ("AccX", "m/s2"), "ay": ("AccY", "m/s2"), "az": ("AccZ", "m/s2")}
_ANGLES = {"roll": ("Roll", "deg"), "pitch": ("Pitch", "deg"), "yaw": ("Yaw", "deg")}
_PLACE = {"x": ("PN", "m"), "y": ("PE", "m"), "z": ("PD", "m")}
_EKF_SPEED = {"vx": ("VN", "m/s"), "vy": ("VE", "m/s"), "vz": ("VD", "m/s")}
_FILTERS = ("XKF1", "NKF1", "EKF1")
KNOWN = (
    Known("body rates", f"IMU{INSTANCE}", _GYRO_FIELDS),
    Known("body rates", r"IMU[23]", _GYRO_FIELDS),
    Known("body rates", f"GYR{INSTANCE}", _GYRO_FIELDS, better=1.5),
    Known("specific force", f"IMU{INSTANCE}", _FORCE),
    Known("specific force", r"IMU[23]", _FORCE),
    Known("specific force", f"ACC{INSTANCE}", _FORCE, better=1.5),
    Known("attitude", f"ATT{INSTANCE}", _ANGLES),
    *(Known("position", f"{name}{INSTANCE}", _PLACE) for name in _FILTERS),
    *(Known("velocity", f"{name}{INSTANCE}", _EKF_SPEED) for name in _FILTERS),
    Known("rotor speeds", f"ESC{INSTANCE}", {f"w{i}": (f"motor{i}_rpm", "rpm") for i in range(1, MOTORS + 1)}),
    Known("commands", "RCOU", {f"command{i}": (f"motor{i}_share", "1") for i in range(1, MOTORS + 1)}),
    Known("battery", f"BATT?{INSTANCE}", {"battery_voltage": ("Volt", "V"), "battery_current": ("Curr", "A")}),
    Known("battery", "CURR", {"battery_voltage": ("Volt", "V"), "battery_current": ("Curr", "A")}),
)  # fmt: skip


@dataclass
class _Type:
    """One type of message. at  offsets of its messages in the file."""

    name: str
    length: int
    characters: str
    fields: list[str]
    units: str = ""
    at: list[int] = field(default_factory=list)

    @property
    def layout(self) -> np.dtype | None:
        """Layout of a message behind its header; None where it does not add up."""
        if len(self.characters) != len(self.fields) or not set(self.characters) <= {*NUMBER_FORMATS, *TEXTS}:
            return None
        if not all(re.fullmatch(r"\w+", name) for name in self.fields):
            return None
        kinds = [NUMBER_FORMATS[c][0] if c in NUMBER_FORMATS else TEXTS[c] for c in self.characters]
        layout = np.dtype(list(zip(self.fields, kinds))) if len(set(self.fields)) == len(self.fields) else None
        return layout if layout is not None and layout.itemsize + 3 == self.length else None


def _text(row: np.void, field: str) -> str:
    """A field of text; empty where the message has none, or holds a number there."""
    value = row[field] if field in row.dtype.names else b""
    return value.decode("latin-1") if isinstance(value, bytes) else ""


def _number(row: np.void, field: str) -> float:
    """A field of one number; NaN where the message has none, or holds text there."""
    value = row[field] if field in row.dtype.names else np.nan
    return float(value) if np.isscalar(value) and not isinstance(value, bytes) else np.nan


class DataFlashFile:
    """A DataFlash log as named signals."""

    def __init__(self, path: Path, notes: list[str]) -> None:
        self.path, self.data = path, read_bytes(path)
        self.types, lost = _scan(self.data)
        if not any(kind.at for kind in self.types.values()):
            raise ReadError(f"{path} holds no message of a DataFlash log; copy it from the flight controller again")
        if lost:
            add_caution(notes, f"{path}: {lost} bytes of the log are no messages and were left out; copy the log again")
        self._read_units()
        self.parameters = self._read_parameters()
        self.frames: dict[str, pd.DataFrame] = {}
        self.clocks: dict[str, np.ndarray] = {}
        self._listed: dict[str, Topic] | None = None
        self.facts: dict[str, Any] = {
            "format": "DataFlash",
            "firmware": {"revision": self._firmware()},
            "lost bytes": lost,
            "parameters": {k: v for k, v in self.parameters.items() if re.match(_ARDUPILOT_FACTS, k)},
        }

    def _messages(self, name: str) -> np.ndarray | None:
        """The messages (n,) of a type as a structured array."""
        kind = next((k for k in self.types.values() if k.name == name and k.at), None)
        layout = kind.layout if kind else None
        if kind is None or layout is None:
            return None
        raw = np.frombuffer(self.data, np.uint8)
        places = np.asarray(kind.at)[:, None] + 3 + np.arange(layout.itemsize)
        return np.ascontiguousarray(raw[places]).view(layout)[:, 0]

    def _read_units(self) -> None:
        messages = self._messages("FMTU")
        for row in messages if messages is not None else ():
            number = _number(row, "FmtType")
            kind = self.types.get(int(number)) if np.isfinite(number) else None
            if kind is not None:
                kind.units = _text(row, "UnitIds")

    def _read_parameters(self) -> dict[str, float]:
        messages = self._messages("PARM")
        return {} if messages is None else {_text(row, "Name"): _number(row, "Value") for row in messages}

    def _firmware(self) -> str:
        messages = self._messages("MSG")
        texts = [] if messages is None else [_text(row, "Message") for row in messages[:40]]
        return next((text for text in texts if re.match(r"Ardu|AP[A-Z]", text)), "ArduPilot")

    def _motors(self) -> dict[int, int]:
        """{output channel from 1: motor}, by SERVOn_FUNCTION; channels count as motors where the log has none."""
        found = {}
        for channel in range(1, 17):
            function = self.parameters.get(f"SERVO{channel}_FUNCTION")
            if function is not None and FIRST_SERVO_FUNCTION <= function < FIRST_SERVO_FUNCTION + MOTORS:
                found[channel] = int(function) - FIRST_SERVO_FUNCTION + 1
        return found or {channel: channel for channel in range(1, MOTORS + 1)}

    def _decode(self, name: str) -> None:
        """Frames and clocks, s, of the messages of a type."""
        kind = next(k for k in self.types.values() if k.name == name and k.at)
        messages = self._messages(name)
        if messages is None or not {"TimeUS", "TimeMS"} & set(kind.fields):
            return
        clock, scale = ("TimeUS", 1e-6) if "TimeUS" in kind.fields else ("TimeMS", 1e-3)
        t = messages[clock].astype(float) * scale
        with np.errstate(invalid="ignore"):  # damaged floats may be signalling NaN
            numbers = {
                f: messages[f].astype(float) * NUMBER_FORMATS[c][1]
                for f, c in zip(kind.fields, kind.characters)
                if c in NUMBER_FORMATS and f != clock
            }
        key = kind.fields[kind.units.index("#")] if "#" in kind.units[: len(kind.fields)] else None
        if key is None and not kind.units:
            key = next((f for f in INSTANCES if f in numbers), None)
        groups = {name: np.ones(len(t), bool)}
        if key is not None and key in numbers:
            found = np.unique(numbers[key][np.isfinite(numbers[key])])
            groups = {f"{name}:{int(i)}": numbers[key] == i for i in found}
        for group, rows in groups.items():
            columns = {f: values[rows] for f, values in numbers.items()} | self._derived(name, group, numbers, rows)
            at = t[rows]
            sound = np.abs(at - np.median(at)) < LONGEST_LOG
            self.frames[group] = pd.DataFrame({f"{group}.{f}": values[sound] for f, values in columns.items()})
            self.clocks[group] = at[sound]

    def _derived(
        self, name: str, group: str, numbers: Mapping[str, np.ndarray], rows: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Rotor speeds and outputs by motor number."""
        motors = self._motors()
        if name == "ESC" and "RPM" in numbers:
            motor = motors.get(int(group.partition(":")[2] or 0) + 1)
            return {f"motor{motor}_rpm": numbers["RPM"][rows]} if motor else {}
        if name == "RCOU":
            low = self.parameters.get("MOT_PWM_MIN") or PWM_RANGE[0]
            high = self.parameters.get("MOT_PWM_MAX") or PWM_RANGE[1]
            return {
                f"motor{motor}_share": np.clip((numbers[f"C{channel}"][rows] - low) / (high - low), 0.0, 1.0)
                for channel, motor in motors.items()
                if f"C{channel}" in numbers and numbers[f"C{channel}"].any() and high > low
            }
        return {}

    @property
    def topics(self) -> Mapping[str, Topic]:
        """Known topics by instance, and the other types of messages."""
        if self._listed is None:
            names = {kind.name for kind in self.types.values() if kind.at}
            for name in sorted(names):
                if any(re.fullmatch(way.match, topic) for way in KNOWN for topic in (name, f"{name}:0")):
                    self._decode(name)
            self._listed = {
                kind.name: Topic("", tuple(f"{kind.name}.{f}" for f in kind.fields), len(kind.at))
                for kind in self.types.values()
                if kind.at
            }
        split = {group.partition(":")[0] for group in self.frames if ":" in group}
        return {name: topic for name, topic in self._listed.items() if name not in split} | {
            name: Topic("", tuple(map(str, frame.columns)), len(frame), seconds_of(self.clocks[name]))
            for name, frame in self.frames.items()
        }

    def samples_of(self, columns: Collection[str], notes: list[str]) -> Signals:
        """See `LogFile`."""
        for name in {re.split("[:.]", column)[0] for column in columns}:
            if not any(re.split(":", group)[0] == name for group in self.frames) and any(
                kind.name == name and kind.at for kind in self.types.values()
            ):
                self._decode(name)
        return Signals(self.frames, self.clocks).only(columns)


_ARDUPILOT_FACTS = (
    r"MOT_PWM_M|MOT_SPIN_|MOT_THST_EXPO|FRAME_(CLASS|TYPE)$|SERVO\d+_FUNCTION|INS_GYRO_FILTER|INS_ACCEL_FILTER"
)


def _scan(data: bytes) -> tuple[dict[int, _Type], int]:
    """{type: _Type with the offsets of its messages}, and how many bytes belong to none."""
    types: dict[int, _Type] = {}
    lengths = [0] * 256
    lengths[FMT] = FMT_LENGTH
    places: list[list[int]] = [[] for _ in range(256)]
    at, end, lost = 0, len(data), 0
    while at + 3 <= end:
        length = lengths[data[at + 2]] if data[at] == 0xA3 and data[at + 1] == 0x95 else 0
        if not length or at + length > end:
            following = data.find(MESSAGE_HEAD, at + 1)
            # a file is cut off within its last message, and padded with zeros or ones
            stop = end if following < 0 else following
            lost += stop - at if data[at:stop].strip(b"\0\xff") else 0
            if following < 0:
                break
            at = following
            continue
        kind = data[at + 2]
        if kind == FMT:
            declared = _declaration(data, at)
            if declared is not None:
                number, about = declared
                types[number] = about
                about.at = places[number]
                lengths[number] = about.length
        places[kind].append(at)
        at += length
    return types, lost


def _declaration(data: bytes, at: int) -> tuple[int, _Type] | None:
    """The type that a FMT message declares; None where it is damaged."""
    number, length, name, characters, fields = struct.unpack_from("<BB4s16s64s", data, at + 3)
    text = [part.rstrip(b"\0").decode("latin-1") for part in (name, characters, fields)]
    if length < 3 or not re.fullmatch(r"\w{1,4}", text[0]):
        return None
    return number, _Type(text[0], length, text[1], text[2].split(","))


def _delays(log: DataFlashFile, mapping: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """How late IMU messages are filtered on board; GYR and ACC messages come before the filters."""
    notch = any(log.parameters.get(key, 0) for key in ("INS_HNTCH_ENABLE", "INS_HNTC2_ENABLE", "INS_NOTCH_ENABLE"))
    return low_pass_delays(mapping, log.parameters, {
        "gyro": (r"IMU[23]?(:\d+)?\.Gyr", "INS_GYRO_FILTER", notch),
        "accelerometer": (r"IMU[23]?(:\d+)?\.Acc", "INS_ACCEL_FILTER", False),
    })  # fmt: skip


READER = topics_reader("an ArduPilot DataFlash log (.bin)", ("dataflash",), DataFlashFile, KNOWN, "ardupilot", _delays)
