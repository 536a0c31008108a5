"""One made flight, written in every log format by small writers of the tests' own or by the format's library."""

import gzip
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from rigid_body import move
from scipy.io import savemat

from quasi.attitude import to_euler

FLIP = np.array([1.0, -1.0, -1.0])  # FRD to FLU, NED to z-up
EPOCH = 1_700_000_000_000_000_000  # ns, the bags' clock
BOOT = 5_000_000  # us, the controllers' clocks


@dataclass
class Flight:
    """Truth in NED and FRD: inertial samples at `t`, estimates at every 2nd, rotors and commands at every 4th."""

    t: np.ndarray
    rates: np.ndarray
    force: np.ndarray
    q: np.ndarray
    p: np.ndarray
    v: np.ndarray
    rotors: np.ndarray  # rad/s
    commands: np.ndarray  # shares
    battery: np.ndarray  # V

    @property
    def slow(self):
        return slice(None, None, 2)

    @property
    def slowest(self):
        return slice(None, None, 4)


def made_flight(seconds=4.5, rate=250.0):
    m = move(seconds=seconds, rate=rate, rest=2.0, loops=False, seed=3, size=0.7)
    lift = np.linalg.norm(m.force, axis=1)
    spin = np.array([0.02, -0.01, 0.015, -0.02])
    rotors = 900 * np.sqrt(lift / 9.8)[:, None] * (1 + spin * np.sin(m.t[:, None] * np.array([2.1, 3.3, 2.7, 4.9])))
    return Flight(m.t, m.rates, m.force, m.q, m.p, m.v, rotors, rotors / 2000, 16.0 - 0.02 * m.t)


# tables: CSV, gzip, Parquet, MAT, npz

TABLE_COLUMNS = {
    "time": {"column": "t", "unit": "s"},
    "sources": [
        {"name": "imu", "time": {"column": "t"}, "columns": {n: f"imu_{n}" for n in ("p", "q", "r", "ax", "ay", "az")}},
        {"name": "state", "time": {"column": "t"},
         "columns": {n: n for n in ("qw", "qx", "qy", "qz", "x", "y", "z", "vx", "vy", "vz")}},
        {"name": "motors", "time": {"column": "t"},
         "columns": {f"w{i}": f"rotor_speed[{i - 1}]" for i in range(1, 5)}
         | {f"command{i}": f"out[{i - 1}]" for i in range(1, 5)} | {"battery_voltage": "volts"}},
    ],
}  # fmt: skip


def columns_of(flight):
    columns = {"t": flight.t}
    columns |= dict(zip(("imu_p", "imu_q", "imu_r"), flight.rates.T))
    columns |= dict(zip(("imu_ax", "imu_ay", "imu_az"), flight.force.T))
    columns |= dict(zip(("qw", "qx", "qy", "qz"), flight.q.T))
    columns |= dict(zip("xyz", flight.p.T)) | dict(zip(("vx", "vy", "vz"), flight.v.T))
    return columns


def write_csv(folder, flight):
    columns = columns_of(flight)
    columns |= {f"rotor_speed[{i}]": flight.rotors[:, i] for i in range(4)}
    columns |= {f"out[{i}]": flight.commands[:, i] for i in range(4)}
    path = folder / "flight.csv"
    pd.DataFrame(columns | {"volts": flight.battery}).to_csv(path, index=False)
    return path


def write_lists(folder, flight):
    """Rotors as a list in each cell."""
    table = pd.DataFrame(columns_of(flight) | {"volts": flight.battery})
    table["rotor_speed"] = [str(row.tolist()) for row in flight.rotors]
    table["out"] = [" ".join(map(str, row)) for row in flight.commands]
    table.to_csv(folder / "lists.csv", index=False)
    return folder / "lists.csv"


def write_gzip(folder, flight):
    path = folder / "flight.csv.gz"
    path.write_bytes(gzip.compress(write_csv(folder, flight).read_bytes()))
    return path


def write_parquet(folder, flight):
    pd.read_csv(write_csv(folder, flight)).to_parquet(folder / "flight.parquet")
    return folder / "flight.parquet"


def write_mat(folder, flight):
    savemat(folder / "flight.mat", columns_of(flight) | {
        "rotor_speed": flight.rotors.T, "out": flight.commands, "volts": flight.battery, "name": "made",
    })  # fmt: skip
    return folder / "flight.mat"


def write_npz(folder, flight):
    parts = {"rotor_speed": flight.rotors, "out": flight.commands, "volts": flight.battery}
    np.savez(folder / "flight.npz", pilot=np.array(["made"]), **columns_of(flight), **parts)
    return folder / "flight.npz"


# PX4 ULog

_C = {"uint64_t": "Q", "float": "f", "int32_t": "i", "uint8_t": "B", "uint32_t": "I"}
ULOG_FORMATS = {
    "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
    "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt",
    "vehicle_attitude": "uint64_t timestamp;uint64_t timestamp_sample;float[4] q",
    "vehicle_local_position": "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;float vx;float vy;"
    "float vz;uint8_t xy_valid;uint8_t z_valid;uint8_t v_xy_valid;uint8_t v_z_valid",
    "actuator_motors": "uint64_t timestamp;float[12] control",
    "esc_report": "uint64_t timestamp;int32_t esc_rpm;uint8_t actuator_function;uint8_t[3] states",
    "esc_status": "uint64_t timestamp;esc_report[4] esc",
    "battery_status": "uint64_t timestamp;float voltage_v;float current_a",
}


class Ulog:
    """The ULog file format: header, definitions, data."""

    def __init__(self):
        self.parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", BOOT)]
        self.subscribed = {}

    def message(self, kind, body):
        self.parts.append(struct.pack("<HB", len(body), ord(kind)) + body)

    def define(self, names, parameters, formats=ULOG_FORMATS):
        self.message("B", bytes(40))
        for name in names:
            self.message("F", f"{name}:{formats[name]};".encode())
        for key, value in {"ver_sw_release": ("uint32_t", 0x010E00FF)}.items():
            declared = f"{value[0]} {key}".encode()
            self.message("I", bytes([len(declared)]) + declared + struct.pack("<I", value[1]))
        for key, value in parameters.items():
            declared = f"float {key}".encode()
            self.message("P", bytes([len(declared)]) + declared + struct.pack("<f", value))

    def subscribe(self, name, instance=0):
        number = len(self.subscribed)
        self.subscribed[name, instance] = number
        self.message("A", struct.pack("<BH", instance, number) + name.encode())

    def data(self, name, layout, *values, instance=0):
        if (name, instance) in self.subscribed:
            self.message("D", struct.pack("<H" + layout, self.subscribed[name, instance], *values))

    def dropout(self, milliseconds):
        self.message("O", struct.pack("<H", milliseconds))

    def bytes(self):
        return b"".join(self.parts)


def ulog_of(flight, parameters=None, names=ULOG_FORMATS, formats=None):
    """The flight as a ULog with the topics in `names`; formats  {topic: fields} of further ones, with no messages."""
    log, step = Ulog(), int(1e6 * (flight.t[1] - flight.t[0]))
    every = {**ULOG_FORMATS, **(formats or {})}
    log.define(every, {"CA_ROTOR_COUNT": 4, **(parameters or {})}, every)
    for name in [*names, *(formats or {})]:
        if name != "esc_report":
            log.subscribe(name)
    for k, t in enumerate(np.round(1e6 * flight.t).astype(int) + BOOT):
        t = int(t)
        # stamped at the end of the integration whose middle is t
        log.data("sensor_combined", "Q3fIi3fI", t + step // 2, *flight.rates[k], step, 0, *flight.force[k], step)
        if k % 2 == 0:
            log.data("vehicle_attitude", "QQ4f", t + 900, t, *flight.q[k])
            log.data("vehicle_local_position", "QQ6f4B", t + 900, t, *flight.p[k], *flight.v[k], 1, 1, 1, 1)
        if k % 4 == 0:
            log.data("actuator_motors", "Q12f", t, *flight.commands[k], *[float("nan")] * 8)
            rpm = np.round(flight.rotors[k] * 30 / np.pi).astype(int)
            # the third ESC turns motor 4, backwards; the fourth motor 3
            order = [0, 1, 3, 2]
            reports = [x for m in order for x in (t, int(rpm[m]) * (-1 if m == 3 else 1), 101 + m, 0, 0, 0)]
            log.data("esc_status", "Q" + 4 * "QiB3B", t, *reports)
            log.data("battery_status", "Qff", t, flight.battery[k], -1.0)
    return log


def write_ulog(folder, flight):
    (folder / "flight.ulg").write_bytes(ulog_of(flight).bytes())
    return folder / "flight.ulg"


# ArduPilot DataFlash

DATAFLASH = {  # name: (type, format, fields)
    "FMTU": (130, "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
    "PARM": (131, "QNff", "TimeUS,Name,Value,Default"),
    "IMU": (132, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ATT": (133, "Qfff", "TimeUS,Roll,Pitch,Yaw"),
    "XKF1": (134, "QBffffff", "TimeUS,C,PN,PE,PD,VN,VE,VD"),
    "ESC": (135, "QBf", "TimeUS,Instance,RPM"),
    "RCOU": (136, "QHHHH", "TimeUS,C1,C2,C3,C4"),
    "BAT": (137, "Qfc", "TimeUS,Volt,Curr"),
}
_SIZES = {"Q": "Q", "B": "B", "N": "16s", "f": "f", "c": "h", "H": "H"}


class DataFlash:
    def __init__(self, types=DATAFLASH):
        self.types = types
        self.parts = [self.declare("FMT", 128, "BBnNZ", "Type,Length,Name,Format,Columns", 89)]
        for name, (number, characters, fields) in types.items():
            layout = "<" + "".join(_SIZES[c] for c in characters)
            self.parts.append(self.declare(name, number, characters, fields, 3 + struct.calcsize(layout)))

    @staticmethod
    def declare(name, number, characters, fields, length):
        text = struct.pack("<4s16s64s", name.encode(), characters.encode(), fields.encode())
        return b"\xa3\x95" + bytes([128, number, length]) + text

    def write(self, name, *values):
        number, characters, _ = self.types[name]
        layout = "<" + "".join(_SIZES[c] for c in characters)
        self.parts.append(b"\xa3\x95" + bytes([number]) + struct.pack(layout, *values))

    def bytes(self):
        return b"".join(self.parts)


def dataflash_of(flight, imus=1):
    log = DataFlash()
    for name, units in (("IMU", b"s#EEEooo"), ("XKF1", b"s#mmmnnn"), ("ESC", b"s#q")):
        log.write("FMTU", BOOT, DATAFLASH[name][0], units, b"F-000000")
    # outputs 1 to 4 drive motors 1, 2, 4, 3; filters are off
    settings = {f"SERVO{c}_FUNCTION": 32 + m for c, m in zip((1, 2, 3, 4), (1, 2, 4, 3))}
    settings |= {"MOT_PWM_MIN": 1100, "MOT_PWM_MAX": 1900, "INS_GYRO_FILTER": 0, "INS_ACCEL_FILTER": 0}
    for name, value in settings.items():
        log.write("PARM", BOOT, name.encode(), value, value)
    roll, pitch, yaw = np.degrees(to_euler(flight.q)).T
    order = [0, 1, 3, 2]
    for k, t in enumerate(np.round(1e6 * flight.t).astype(int) + BOOT):
        t = int(t)
        for i in range(imus):
            log.write("IMU", t, i, *(flight.rates[k] + 0.01 * i), *(flight.force[k] + 0.01 * i))
        if k % 2 == 0:
            log.write("ATT", t, roll[k], pitch[k], yaw[k])
            log.write("XKF1", t, 0, *flight.p[k], *flight.v[k])
        if k % 4 == 0:
            for c, m in enumerate(order):
                log.write("ESC", t, c, flight.rotors[k, m] * 30 / np.pi)
            log.write("RCOU", t, *[round(1100 + 800 * flight.commands[k, m]) for m in order])
            log.write("BAT", t, flight.battery[k], 1234)
    return log


def write_dataflash(folder, flight):
    (folder / "flight.bin").write_bytes(dataflash_of(flight).bytes())
    return folder / "flight.bin"


# ROS bags, by rosbags' own writers

ACTUATORS = "std_msgs/Header header\nfloat64[] angles\nfloat64[] angular_velocities\nfloat64[] normalized\n"


def write_bag(folder, flight, version=2, storage="mcap", drop=(), rename=None, ahead=None, extra=None):
    """A bag of Imu, Odometry, Actuators, BatteryState; stamps of topics in `ahead` run by so many s ahead.

    drop  topics that are left out; rename  {topic: its name}; extra(typestore, writer)  returns more messages
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(ACTUATORS, "mav_msgs/msg/Actuators"))
    kinds = store.types
    path = folder / ("flight.bag" if version == 1 else f"bag_{storage}")
    if version == 1:
        writer = Writer1(path)
    else:
        writer = Writer2(path, version=8, storage_plugin=StoragePlugin[{"mcap": "MCAP", "db3": "SQLITE3"}[storage]])
    counter = iter(range(10**9))

    def header(topic, k):
        stamp = EPOCH + round(1e9 * (flight.t[k] + (ahead or {}).get(topic, 0.0)))
        time = kinds["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        first = {"seq": next(counter)} if version == 1 else {}
        return kinds["std_msgs/msg/Header"](**first, stamp=time, frame_id="body")

    def vector(values, kind="Vector3"):
        return kinds[f"geometry_msgs/msg/{kind}"](**dict(zip("xyz", map(float, values))))

    def quaternion(q):
        return kinds["geometry_msgs/msg/Quaternion"](**dict(zip("wxyz", map(float, q))))

    from quasi.attitude import rotate_inverse

    nine, many = np.zeros(9), np.zeros(36)
    # half a turn about x on either side: FRD to NED becomes FLU to z-up
    flu = flight.q * np.array([1.0, 1.0, -1.0, -1.0])
    moving = rotate_inverse(flight.q, flight.v)
    topics = {"/imu": "sensor_msgs/msg/Imu", "/odom": "nav_msgs/msg/Odometry",
              "/motor_speed": "mav_msgs/msg/Actuators", "/battery": "sensor_msgs/msg/BatteryState"}  # fmt: skip
    names = {t: (rename or {}).get(t, t) for t in topics}
    with writer:
        open_topics = {
            t: writer.add_connection(names[t], kind, typestore=store) for t, kind in topics.items() if t not in drop
        }

        def put(topic, k, message):
            if topic in open_topics:
                pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
                data = pack(message, topics[topic])
                writer.write(open_topics[topic], EPOCH + round(1e9 * flight.t[k]), data)

        more = list(extra(store, writer)) if extra else []
        for k in range(len(flight.t)):
            put("/imu", k, kinds["sensor_msgs/msg/Imu"](
                header=header("/imu", k), orientation=quaternion((1, 0, 0, 0)), orientation_covariance=nine - 1.0,
                angular_velocity=vector(FLIP * flight.rates[k]), angular_velocity_covariance=nine,
                linear_acceleration=vector(FLIP * flight.force[k]), linear_acceleration_covariance=nine))  # fmt: skip
            if k % 2 == 0:
                pose = kinds["geometry_msgs/msg/Pose"](
                    position=vector(FLIP * flight.p[k], "Point"), orientation=quaternion(flu[k]))  # fmt: skip
                twist = kinds["geometry_msgs/msg/Twist"](
                    linear=vector(FLIP * moving[k]), angular=vector(FLIP * flight.rates[k]))  # fmt: skip
                put("/odom", k, kinds["nav_msgs/msg/Odometry"](
                    header=header("/odom", k), child_frame_id="body",
                    pose=kinds["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=many),
                    twist=kinds["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=many)))  # fmt: skip
            if k % 4 == 0:
                put("/motor_speed", k, kinds["mav_msgs/msg/Actuators"](
                    header=header("/motor_speed", k), angles=np.zeros(0), angular_velocities=flight.rotors[k],
                    normalized=flight.commands[k]))  # fmt: skip
                put("/battery", k, battery(kinds, header("/battery", k), flight.battery[k]))
            for connection, at, data in [m for m in more if m[1] == k]:
                writer.write(connection, EPOCH + round(1e9 * flight.t[at]), data)
    return path if version == 1 else next(Path(path).glob(f"*.{storage}"))


def battery(kinds, header, volts):
    cells = np.zeros(0, np.float32)
    unknown = dict.fromkeys(("current", "charge", "capacity", "design_capacity", "percentage"), float("nan"))
    return kinds["sensor_msgs/msg/BatteryState"](
        header=header, voltage=float(volts), **unknown, temperature=20.0, cell_temperature=cells,
        power_supply_status=0, power_supply_health=0,
        power_supply_technology=0, present=True, cell_voltage=cells, location="", serial_number="")  # fmt: skip


WRITERS = {
    "csv": ("table", write_csv),
    "lists": ("table", write_lists),
    "csv.gz": ("table", write_gzip),
    "parquet": ("table", write_parquet),
    "mat": ("table", write_mat),
    "npz": ("table", write_npz),
    "ulog": ("px4", write_ulog),
    "dataflash": ("ardupilot", write_dataflash),
    "ros1": ("rosbag", lambda folder, flight: write_bag(folder, flight, 1)),
    "ros2 mcap": ("rosbag", lambda folder, flight: write_bag(folder, flight, 2, "mcap")),
    "ros2 db3": ("rosbag", lambda folder, flight: write_bag(folder, flight, 2, "db3")),
}
NEEDS = {"ulog": "pyulog", "ros1": "rosbags", "ros2 mcap": "rosbags", "ros2 db3": "rosbags"}
# resolution of each format: float32 of ULog and DataFlash, whole rpm of PX4, PWM of ArduPilot in us
_FINE = {"rates": 1e-9, "force": 1e-8, "place": 1e-9, "turn": 1e-9, "rotors": 1e-6, "share": 1e-9}
_FLOAT = {"rates": 3e-6, "force": 1e-5, "place": 1e-5, "turn": 1e-5, "rotors": 1e-3, "share": 1e-6}
RESOLUTION = {"default": _FINE, "ulog": {**_FLOAT, "rotors": 0.06}, "dataflash": {**_FLOAT, "share": 7e-4}}
