"""ROS 1 bags, ROS 2 bags (MCAP, SQLite) and MCAP recordings with ROS types, by rosbags.

Columns are `topic.field`, as in "/imu/data.angular_velocity.x" or "/motors.data[2]". Times are in s since the bag
began, `header.stamp` too. A topic's samples are timed by its stamps where they are set, else by when they were
recorded. Stamps of a host whose clock is off are moved by the median difference. Messages that are not asked for are
neither decoded nor kept, so that memory goes with the numbers that are read and not with the bag.

Axes by REP 103: body x forward, y left, z up; world z up. Messages of px4_msgs keep PX4's.
"""

import operator
import re
from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import ReadError, add_caution, quoted
from quasi.importing.readers.known_topics import MOTORS, Known
from quasi.importing.readers.reader import needs_extra
from quasi.importing.readers.signals import Signals, Topic
from quasi.importing.readers.topics import topics_reader

NANOSECOND = 1e-9  # s
LONGEST_SEQUENCE = 64  # entries of a list that become columns; images and point clouds are longer
OTHER_CLOCK = 0.5  # s between stamps and their recording, from which they count as another clock's (as in a table)
BYTES = {"uint8", "int8", "byte", "char", "octet"}  # elements of images and other blobs
NUMBER_TYPES = {"bool", "float32", "float64", "int16", "int32", "int64", "uint16", "uint32", "uint64", "int8", "uint8"}
TIME_TYPES = {"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"}
TYPE_NAME = r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)+"
FIRST_MESSAGES = 100  # of a topic, in which a list that begins empty (joints before the motors start) may fill

_CAPTURES = r"mocap|vrpn|vicon|optitrack|natnet|qualisys|qtm|motion_capture|ground_?truth"
_ESTIMATES = r"local_position|odom|estimat|ekf|fused|filtered"
_DEMANDS = r"set_?point|command|cmd|ref|goal|target|desired|plan|trajectory"
_MEASURED = rf"^(?!.*({_DEMANDS}))"  # no demand
_FLU = {"frame": "FLU", "world": "z-up", "by_kind": True}
_FRD = {"by_kind": True}
_XYZ = ("x", "y", "z")


def _vector(names: Collection[str], path: str, unit: str) -> dict[str, tuple[str, str]]:
    return {n: (f"{path}.{axis}", unit) for n, axis in zip(names, _XYZ)}


def _listed(names: Collection[str], path: str, unit: str) -> dict[str, tuple[str, str]]:
    return {n: (f"{path}[{i}]", unit) for i, n in enumerate(names)}


def _quaternion(path: str) -> dict[str, tuple[str, str]]:
    return {f"q{c}": (f"{path}.{c}", "1") for c in "wxyz"}


def _rotors(path: str, unit: str, quantity: str = "w{}") -> dict[str, tuple[str, str]]:
    return {quantity.format(i + 1): (path.format(i), unit) for i in range(MOTORS)}


def _poses(kind: str, place: str, turn: str) -> list[Known]:
    """Poses: from motion capture by the topic's name, from an estimator on board, else from motion capture."""
    pose = {**_vector("xyz", place, "m"), **_quaternion(turn)}
    return [
        Known("capture", kind, pose, names=rf"{_MEASURED}.*({_CAPTURES})", **_FLU),
        Known("capture", kind, pose, names=rf"{_MEASURED}(?!.*({_ESTIMATES}))", **_FLU),
        Known("position", kind, _vector("xyz", place, "m"), names=rf"{_MEASURED}.*({_ESTIMATES})", **_FLU),
        Known("attitude", kind, _quaternion(turn), names=rf"{_MEASURED}.*({_ESTIMATES})", **_FLU),
    ]


_Q_LISTED = _listed(("qw", "qx", "qy", "qz"), "q", "1")
_ODOMETRY = "nav_msgs/msg/Odometry"
_ARRAYS = r"std_msgs/msg/Float(32|64)MultiArray"
_ROTOR_WORDS = r"motor|rotor|prop|esc|rpm|omega"
_BODY_SPEED = _vector(("vx", "vy", "vz"), "twist.twist.linear", "m/s")
KNOWN = (
    Known("body rates", "sensor_msgs/msg/Imu", _vector("pqr", "angular_velocity", "rad/s"), **_FLU),
    Known("body rates", "px4_msgs/msg/SensorCombined", _listed("pqr", "gyro_rad", "rad/s"), **_FRD),
    Known("body rates", "px4_msgs/msg/VehicleAngularVelocity", _listed("pqr", "xyz", "rad/s"), better=1.5, **_FRD),
    Known("body rates", _ODOMETRY, _vector("pqr", "twist.twist.angular", "rad/s"),
          names=rf"^(?!.*({_CAPTURES}))", **_FLU),
    Known("specific force", "sensor_msgs/msg/Imu", _vector(("ax", "ay", "az"), "linear_acceleration", "m/s2"), **_FLU),
    Known("specific force", "px4_msgs/msg/SensorCombined",
          _listed(("ax", "ay", "az"), "accelerometer_m_s2", "m/s2"), **_FRD),
    Known("attitude", _ODOMETRY, _quaternion("pose.pose.orientation"), names=rf"^(?!.*({_CAPTURES}))", **_FLU),
    Known("attitude", "sensor_msgs/msg/Imu", _quaternion("orientation"), **_FLU),
    Known("attitude", "px4_msgs/msg/VehicleAttitude", _Q_LISTED, **_FRD),
    Known("position", _ODOMETRY, _vector("xyz", "pose.pose.position", "m"), names=rf"^(?!.*({_CAPTURES}))", **_FLU),
    Known("position", "px4_msgs/msg/VehicleLocalPosition", {n: (n, "m") for n in "xyz"}, **_FRD),
    Known("velocity", _ODOMETRY, _BODY_SPEED, body=True, names=rf"^(?!.*({_CAPTURES}))", **_FLU),
    Known("velocity", "geometry_msgs/msg/TwistStamped", _vector(("vx", "vy", "vz"), "twist.linear", "m/s"),
          names=rf"{_MEASURED}(?!.*body)", **_FLU),
    Known("velocity", "px4_msgs/msg/VehicleLocalPosition", {n: (n, "m/s") for n in ("vx", "vy", "vz")}, **_FRD),
    *_poses("geometry_msgs/msg/PoseStamped", "pose.position", "pose.orientation"),
    *_poses("geometry_msgs/msg/PoseWithCovarianceStamped", "pose.pose.position", "pose.pose.orientation"),
    *_poses("geometry_msgs/msg/TransformStamped", "transform.translation", "transform.rotation"),
    Known("capture", _ODOMETRY, {**_vector("xyz", "pose.pose.position", "m"), **_quaternion("pose.pose.orientation")},
          names=_CAPTURES, **_FLU),
    Known("capture", "px4_msgs/msg/VehicleOdometry", {**_listed("xyz", "position", "m"), **_Q_LISTED},
          names="mocap|visual", **_FRD),
    Known("rotor speeds", "mavros_msgs/msg/ESCTelemetry", _rotors("esc_telemetry[{}].rpm", "rpm"), by_kind=True),
    Known("rotor speeds", "mavros_msgs/msg/ESCStatus", _rotors("esc_status[{}].rpm", "rpm"), by_kind=True),
    Known("rotor speeds", "px4_msgs/msg/EscStatus", _rotors("esc[{}].esc_rpm", "rpm"), by_kind=True),
    Known("rotor speeds", "mav_msgs/msg/Actuators", _rotors("angular_velocities[{}]", "rad/s"),
          names=_MEASURED, by_kind=True),
    Known("rotor speeds", "actuator_msgs/msg/Actuators", _rotors("velocity[{}]", "rad/s"),
          names=_MEASURED, by_kind=True),
    Known("rotor speeds", "sensor_msgs/msg/JointState", _rotors("velocity[{}]", "rad/s"),
          names=rf"{_MEASURED}.*({_ROTOR_WORDS})", by_kind=True),
    Known("rotor speeds", _ARRAYS, _rotors("data[{}]", "eRPM"), names=rf"{_MEASURED}.*erpm", by_kind=True),
    Known("rotor speeds", _ARRAYS, _rotors("data[{}]", "rpm"), names=rf"{_MEASURED}.*rpm", by_kind=True),
    Known("rotor speeds", _ARRAYS, _rotors("data[{}]", "rad/s"),
          names=rf"{_MEASURED}.*(({_ROTOR_WORDS}).*(speed|velocit)|omega)", by_kind=True),
    Known("commands", "px4_msgs/msg/ActuatorMotors", _rotors("control[{}]", "1", "command{}"), by_kind=True),
    Known("commands", r"mav_msgs/msg/Actuators", _rotors("normalized[{}]", "1", "command{}"), by_kind=True),
    Known("commands", r"actuator_msgs/msg/Actuators", _rotors("normalized[{}]", "1", "command{}"), by_kind=True),
    Known("commands", "mav_msgs/msg/Actuators", _rotors("angular_velocities[{}]", "rad/s", "w{}_CMD"),
          names=_DEMANDS, by_kind=True),
    Known("commands", "actuator_msgs/msg/Actuators", _rotors("velocity[{}]", "rad/s", "w{}_CMD"),
          names=_DEMANDS, by_kind=True),
    Known("commands", _ARRAYS, _rotors("data[{}]", "1", "command{}"),
          names=rf"({_ROTOR_WORDS}).*({_DEMANDS})|throttle", by_kind=True),
    Known("battery", "sensor_msgs/msg/BatteryState",
          {"battery_voltage": ("voltage", "V"), "battery_current": ("current", "A")}, by_kind=True),
    Known("battery", "px4_msgs/msg/BatteryStatus",
          {"battery_voltage": ("voltage_v", "V"), "battery_current": ("current_a", "A")}, by_kind=True),
)  # fmt: skip

Getter = Callable[[Any], float]


class Bag:
    """A bag as named signals."""

    def __init__(self, path: Path, notes: list[str]) -> None:
        self.path = path
        self.topics: dict[str, Topic] = {}
        self.getters: dict[str, dict[str, Getter]] = {}
        unknown: list[str] = []
        with self._open() as reader:
            self.start: int = reader.start_time
            seconds = (reader.end_time - reader.start_time) * NANOSECOND
            for name in sorted({c.topic for c in reader.connections}):
                own = [c for c in reader.connections if c.topic == name]
                samples = sum(c.msgcount for c in own)
                getters, decoded = {}, False
                for _, _, message in islice(self._decoded(reader, own), FIRST_MESSAGES if samples else 0):
                    decoded, empty = True, []
                    getters |= _getters(reader.typestore.fielddefs, own[0].msgtype, message, empty)
                    getters = {c: g for c, g in getters.items() if not c.startswith(_unmeasured(message))}
                    if not empty:
                        break
                if samples and not decoded:
                    unknown.append(f"{name} ({own[0].msgtype})")
                self.getters[name] = {f"{name}.{column}": getter for column, getter in getters.items()}
                self.topics[name] = Topic(own[0].msgtype, tuple(self.getters[name]), samples, seconds)
            version = "2" if reader.is2 else "1"
        if not self.topics:
            raise ReadError(f"{path} holds no topics; record the flight again")
        if unknown:
            notes.append(
                f"{path}: messages of {len(unknown)} topics cannot be decoded and were left out: "
                f"{', '.join(unknown[:6])}; record to MCAP, which stores the definitions of types"
            )
        self.facts: dict[str, Any] = {"format": f"ROS {version} bag", "duration": seconds, "undecoded topics": unknown}

    @contextmanager
    def _open(self) -> Iterator[Any]:
        """The open reader of the bag, or of the whole recording where it is one file of a ROS 2 bag."""
        with needs_extra("ros", self.path, "a ROS bag"):
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        if not self.path.exists():
            raise ReadError(f"{self.path} does not exist; correct the path in the logbook")
        folder = self.path.parent
        place = folder if self.path.suffix != ".bag" and (folder / "metadata.yaml").is_file() else self.path
        try:
            _refuse_unsafe_types(AnyReader([place]).readers, self.path)
            with AnyReader([place], default_typestore=get_typestore(Stores.LATEST)) as reader:
                yield reader
        except ReadError:
            raise
        except Exception as error:  # rosbags, its codecs and SQLite raise their own kinds for a damaged file
            reason = " ".join(str(error).split())[:160] or "damaged"
            raise ReadError(f"{self.path} is no readable bag ({reason}); {_remedy(self.path, reason)}") from None

    def _decoded(self, reader: Any, connections: list[Any]) -> Iterator[tuple[Any, int, Any]]:
        """(connection, time in ns, message) of those that can be decoded."""
        known = [c for c in connections if c.msgtype in reader.typestore.fielddefs]
        for connection, stamp, data in reader.messages(connections=known) if known else ():
            try:
                message = reader.deserialize(data, connection.msgtype)
            except Exception:
                continue
            yield connection, stamp, message

    def samples_of(self, columns: Collection[str], notes: list[str]) -> Signals:
        """See `LogFile`. Columns are packed arrays while the bag is read, once."""
        wanted = {
            name: {c: g for c, g in getters.items() if c in columns or c == f"{name}.header.stamp"}
            for name, getters in self.getters.items()
            if any(c in columns for c in getters)
        }
        packed = {name: {c: array("d") for c in getters} for name, getters in wanted.items()}
        times: dict[str, array] = {name: array("q") for name in wanted}
        with self._open() as reader:
            own = [c for c in reader.connections if c.topic in wanted]
            for connection, stamp, message in self._decoded(reader, own):
                name = connection.topic
                times[name].append(stamp)
                for column, getter in wanted[name].items():
                    packed[name][column].append(getter(message))
        frames, clocks = {}, {}
        for name, columns_of in packed.items():
            frame = pd.DataFrame(
                {c: np.frombuffer(values, float) if values else [] for c, values in columns_of.items()}
            )
            recorded = (np.array(times[name], np.int64) - self.start) * NANOSECOND
            stamp = f"{name}.header.stamp"
            if stamp in frame:
                frame[stamp] -= self.start * NANOSECOND
            lost = self.topics[name].samples - len(frame)
            if lost > 0:
                add_caution(notes, f"{self.path}: {lost} messages of '{name}' are damaged and were left out")
            clocks[name] = self._clock(name, frame.get(stamp), recorded, notes)
            frames[name] = frame
        return Signals(frames, clocks)

    def _clock(self, name: str, stamps: pd.Series | None, recorded: np.ndarray, notes: list[str]) -> np.ndarray:
        """Times of a topic's samples, s since the bag began: its stamps where they are set, else those of recording."""
        if stamps is None or len(recorded) < 2:
            return recorded
        late = recorded - stamps.to_numpy()
        if np.ptp(stamps) < 0.5 * np.ptp(recorded):
            return recorded  # never set, or set once
        offset = float(np.median(late))
        if abs(offset) <= OTHER_CLOCK:
            return stamps.to_numpy()
        notes.append(
            f"{self.path}: the stamps of '{name}' come from a clock that is {abs(offset):.3f} s "
            f"{'behind' if offset > 0 else 'ahead of'} the recorder's; they were moved by that"
        )
        return stamps.to_numpy() + offset


def _refuse_unsafe_types(readers: Iterable[Any], path: Path) -> None:
    """Raise ReadError where a type has a name that no message has.

    rosbags makes Python classes of these names, so that one which is no identifier could run code from the file.
    """
    for reader in readers:
        with reader:
            for connection in reader.connections:
                if not re.fullmatch(TYPE_NAME, connection.msgtype):
                    raise ReadError(
                        f"{path}: topic {quoted(connection.topic)} has the type {quoted(connection.msgtype)}, which is "
                        "no name of a message type; the bag is damaged or made to do harm and is not opened"
                    )


def _remedy(path: Path, reason: str) -> str:
    """What to do about a bag that cannot be opened."""
    if re.search(r"compress|zstd|lz4|bz2|codec", reason, re.IGNORECASE):
        return "decompress it first: `rosbag decompress`, or `ros2 bag convert` without compression"
    if path.suffix not in (".bag", ".mcap", ".db3") and "storage format" in reason:
        return "give it the extension .bag, .mcap or .db3"
    repair = {".bag": "`rosbag reindex`", ".mcap": "`mcap recover`"}.get(path.suffix, "`ros2 bag reindex`")
    return f"if the recording was cut off, {repair} may save what is in it; else copy it again"


def _unmeasured(message: Any) -> tuple[str, ...]:
    """Beginnings of columns that an Imu does not measure: -1 comes first in their covariance (definition of
    sensor_msgs/Imu)."""
    fields = ("orientation", "angular_velocity", "linear_acceleration")
    return tuple(f"{field}." for field in fields if list(getattr(message, f"{field}_covariance", ()))[:1] == [-1.0])


def _getters(
    definitions: Mapping[str, Any], kind: str, message: Any, empty: list[str], depth: int = 0
) -> dict[str, Getter]:
    """{field: function of the message} for every number in it; lists are as long as here, `empty` gains empty ones."""
    found: dict[str, Getter] = {}
    for name, (node, detail) in definitions[kind][1]:
        value, get = getattr(message, name, None), operator.attrgetter(name)
        if node.name == "BASE" and detail[0] in NUMBER_TYPES:
            found[name] = _chain(get, float)
        elif node.name == "NAME" and detail in TIME_TYPES:
            found[name] = _seconds_of(get)
        elif node.name == "NAME" and depth < 6:
            inner = _getters(definitions, detail, value, empty, depth + 1)
            found |= {f"{name}.{column}": _chain(get, getter) for column, getter in inner.items()}
        elif node.name in ("ARRAY", "SEQUENCE") and value is not None and len(value) <= LONGEST_SEQUENCE:
            (element, about), _ = detail
            empty += [] if len(value) else [name]
            for i in range(len(value)):
                entry = _entry(get, i)
                if element.name == "BASE" and about[0] in NUMBER_TYPES - BYTES:
                    found[f"{name}[{i}]"] = _chain(entry, float)
                elif element.name == "NAME" and depth < 6:
                    inner = _getters(definitions, about, value[i], empty, depth + 1)
                    found |= {f"{name}[{i}].{column}": _chain(entry, getter) for column, getter in inner.items()}
    return found


def _entry(get: Callable[[Any], Any], index: int) -> Callable[[Any], Any]:
    """Entry of a list; None where a later message's list is shorter."""

    def entry(message: Any) -> Any:
        values = get(message)
        return values[index] if index < len(values) else None

    return entry


def _chain(get: Callable[[Any], Any], then: Getter) -> Getter:
    def chained(message: Any) -> float:
        inner = get(message)
        return np.nan if inner is None else then(inner)

    return chained


def _seconds_of(get: Callable[[Any], Any]) -> Getter:
    def seconds(message: Any) -> float:
        stamp = get(message)
        return stamp.sec + NANOSECOND * stamp.nanosec

    return seconds


READER = topics_reader("a ROS bag or MCAP recording", ("rosbag", "mcap", "db3"), Bag, KNOWN, "rosbag")
