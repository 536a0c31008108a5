"""What a writer wrote is what a reader yields, sample by sample: one property for each reader of raw files.

Each property writes made numbers of a random length, reads them and compares every sample, the first and the last too.
A value that is lost, moved by one sample, exchanged or scaled raises AssertionError. Used by `fuzz_readers.py`.
"""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np
from crazyflie_writer import encode_log as encode_crazyflie
from log_formats import (
    RESOLUTION,
    TABLE_COLUMNS,
    Flight,
    made_flight,
    write_bag,
    write_csv,
    write_dataflash,
    write_gzip,
    write_mat,
    write_npz,
    write_parquet,
    write_ulog,
)
from scipy.spatial.transform import Rotation
from test_captures import qualisys_text, vicon_text

from quasi.importing.onboard_log import read_onboard
from quasi.importing.readers.blackbox import decode
from quasi.importing.readers.blackbox_header import find_logs
from quasi.importing.readers.crazyflie_events import decode_events
from quasi.importing.readers.decoded import read_decoded
from quasi.importing.readers.motive import read_motive
from quasi.importing.readers.qualisys import read_qualisys
from quasi.importing.readers.vicon import read_vicon
from quasi.importing.series import Recording
from quasi.importing.wind import read_lvm
from quasi_synthesis.blackbox_writer import FIELD_NAMES, SLOW_NAMES, encode_log, event, slow_frame
from quasi_synthesis.motive_writer import motive_csv
from quasi_synthesis.sensors import Capture

WIDEST = 16_000  # counts: differences of two values fill the 16 bits of the widest code of TAG8_4S16
RATE = 250.0  # Hz of the made flights
LARGEST_LAG = 1e-3  # s by which readers move sources after comparing motion; a lost sample is 4 ms or more


def same(found: np.ndarray, written: np.ndarray, limit: float, what: str) -> None:
    """Raise AssertionError where two arrays differ in length, in missing samples or by more than `limit`."""
    assert np.shape(found) == np.shape(written), f"{what}: {np.shape(found)} read, {np.shape(written)} written"
    with np.errstate(invalid="ignore"):
        apart = np.abs(np.asarray(found, float) - written)
    missing = np.isnan(found) != np.isnan(written)
    assert not missing.any(), f"{what}: sample {int(np.argmax(missing))} is missing on one side only"
    assert not (apart > limit).any(), f"{what}: sample {int(np.nanargmax(apart))} differs by {np.nanmax(apart):.3g}"


def blackbox(rng: np.random.Generator, folder: Path) -> None:
    """Every field of every frame, slow frames and events; wild steps need the widest codes, calm ones the narrow."""
    n = int(rng.integers(3, 400))
    size = 10.0 ** rng.uniform(0.0, 4.3, len(FIELD_NAMES))
    values = rng.normal(0.0, size, (n, len(FIELD_NAMES)))
    values = np.clip(np.cumsum(values, axis=0) if rng.random() < 0.5 else values, -WIDEST, WIDEST).astype(np.int64)
    unsigned = [k for k, name in enumerate(FIELD_NAMES) if name.startswith(("motor", "eRPM", "rssi", "rcCommand[3]"))]
    values[:, unsigned] = 158 + np.abs(values[:, unsigned])
    voltage = FIELD_NAMES.index("vbatLatest")
    values[:, voltage] = 1600 + values[:, voltage] % 90
    values[:, 0] = 128 * int(rng.integers(0, 50)) + 4 * np.arange(n)
    values[:, 1] = int(rng.integers(1, 2**31)) + 1000 * np.arange(n) + rng.integers(-3, 4, n)
    flags = rng.integers(0, 200, 3)
    places = np.sort(rng.integers(0, n + 1, 3))
    others = [(int(place), slow_frame(int(flag), k)) for k, (place, flag) in enumerate(zip(places, flags))]
    others += [(n, event("flight mode", 1, 0)), (n, event("disarm", 4)), (n, event("end"))]
    data, rows = encode_log(values, others)
    assert rows == n
    (log,) = find_logs(data, "made.bbl")
    frames = decode(data, log, None)
    same(frames.time, values[:, 1].astype(float), 0.0, "time")
    for k, name in enumerate(FIELD_NAMES):
        same(frames.values[name], values[:, k].astype(float), 0.0, name)
    assert frames.ended and not len(frames.spans), "a whole log reads as damaged"
    slow = np.array([[flag, k, 0, 1, 1] for k, flag in enumerate(flags)], float)[:, : len(SLOW_NAMES)]
    same(frames.slow[:, : len(SLOW_NAMES)], slow, 0.0, "slow frames")
    assert [code for code, *_ in frames.events.tolist()] == [30, 15, 255], "events"


def decoded(rng: np.random.Generator, folder: Path) -> None:
    """Gyro and rotor speeds of a decoded log."""
    n = int(rng.integers(30, 200))
    names = ["loopIteration", "time", *(f"{w}[{i}]" for w in ("gyroADC", "accSmooth") for i in range(3))]
    names += [f"{w}[{i}]" for w in ("motor", "eRPM(/100)") for i in range(4)]
    t = 1000 * np.arange(n)
    rates = rng.integers(-900, 900, (n, 3))
    speeds = rng.integers(900, 1400, (n, 4))
    table = np.column_stack([np.arange(n), t, rates, rng.integers(-90, 90, (n, 3)), speeds, speeds])
    head = '"Product","Blackbox"\n"gyroScale","1.7453292519943e-8"\n"motorOutput","158,2047"\n'
    path = folder / "decoded.csv"
    path.write_text(head + "\n".join(",".join(map(str, row)) for row in [names, *table.tolist()]))
    series = read_decoded(path, poles=14, counts=None).series["onboard"]
    same(series.t - series.t[0], 1e-6 * t, 1e-9, "time")
    # the viewer writes degrees per second; body axes are brought to FRD later
    same(np.abs(series.values["p"]), np.abs(np.radians(rates[:, 0])), 1e-9, "p")
    for i in range(4):
        same(series.values[f"w{i + 1}"], speeds[:, i] * 100.0 * 2.0 * np.pi / 60.0 / 7.0, 1e-6, f"w{i + 1}")


def crazyflie(rng: np.random.Generator, folder: Path) -> None:
    """Records of two types on one clock, every number as written."""
    n, version = int(rng.integers(3, 120)), int(rng.integers(1, 3))
    types = {7: ("imu", [f"gyro.{a}(f)" for a in "xyz"] + ["pm.vbatMV(H)"]), 9: ("uwb", ["idA(B)", "distance(f)"])}
    first = np.column_stack([rng.normal(0, 9, (n, 3)).astype(np.float32), rng.integers(0, 65536, n)])
    second = np.column_stack([rng.integers(0, 256, n), rng.normal(0, 9, n).astype(np.float32)])
    records = [(7, 0.01 * i, row) for i, row in enumerate(first)] + [
        (9, 0.01 * i + 0.003, r) for i, r in enumerate(second)
    ]
    log = decode_events(encode_crazyflie(types, sorted(records, key=lambda r: r[1]), version), folder / "log00")
    for number, written, shift in ((7, first, 0.0), (9, second, 0.003)):
        t, columns = log.types[number].columns(log.seconds)
        same(t, 0.01 * np.arange(n) + shift, 1.1e-3 if version == 1 else 1.1e-6, f"time of {types[number][0]}")
        for k, name in enumerate(types[number][1]):
            same(columns[name.partition("(")[0]], written[:, k], 0.0, name)
    assert log.checksum == "right" and not log.ending, "a whole log reads as damaged"


def take_of(rng: np.random.Generator) -> tuple:
    """(t, position m, quaternion, positions mm, rotations) of a smooth motion in a room with z up."""
    t = np.arange(int(rng.integers(40, 200))) / 100
    turn = np.column_stack([0.2 * np.sin(6 * t), 0.3 * np.cos(5 * t), rng.uniform(-2, 2) * t])
    place = np.column_stack([t, rng.uniform(-1, 1) * t**2, 1 - t])
    return t, place, None, 1000 * place, Rotation.from_rotvec(turn)


def capture(rng: np.random.Generator, folder: Path, text: Callable, read: Callable) -> None:
    """Position and attitude of a z-up room, by scipy's rotations: x north, y and z turn over."""
    take = take_of(rng)
    path = folder / "take.txt"
    path.write_bytes(text(take).encode())
    series = read(path, None, remove_outliers=False).series["capture"]
    same(series.t, take[0], 1e-9, "time")
    for name, axis, sign in zip("xyz", take[1].T, (1.0, -1.0, -1.0)):
        same(series.values[name], sign * axis, 2e-6, name)
    half = Rotation.from_rotvec([np.pi, 0, 0])
    found = Rotation.from_quat(np.column_stack([series.values[f"q{c}"] for c in "xyzw"]))
    apart = (found.inv() * half.inv() * take[4] * half).magnitude()
    assert apart.max() < 1e-4, f"attitude: sample {int(np.argmax(apart))} differs by {apart.max():.3g} rad"


def motive(rng: np.random.Generator, folder: Path) -> None:
    """Position and attitude of an export as the campaigns of made flights write it."""
    t, place, _, _, turn = take_of(rng)
    quaternion = turn.as_quat(scalar_first=True)
    path = folder / "take.csv"
    n = len(t)
    take = Capture(t, np.arange(n), place, quaternion, place[:, None] + np.eye(4, 3), np.full(n, 1e-4), 100.0, {})
    path.write_text(motive_csv(take, "B", "take", "2026-03-14 10.21.33.412 AM"))
    series = read_motive(path, None, remove_outliers=False).series["capture"]
    same(series.t, t, 1e-9, "time")
    for name, axis in zip("xyz", place.T):
        same(series.values[name], axis, 2e-6, name)
    found = Rotation.from_quat(np.column_stack([series.values[f"q{c}"] for c in "xyzw"]))
    assert (found.inv() * turn).magnitude().max() < 1e-5, "attitude"


def wind(rng: np.random.Generator, folder: Path) -> None:
    """Times and speeds of a LabVIEW record."""
    n = int(rng.integers(5, 200))
    speed = rng.normal(5, 0.5, n).round(6)
    head = "LabVIEW Measurement\nSeparator,Comma\nDecimal_Separator,.\nTime,14:11:03.5\n***End_of_Header***\n"
    path = folder / "wind.lvm"
    path.write_text(head + "\n".join(f"{0.1 * i:.6f},{v:.6f}" for i, v in enumerate(speed)))
    series = read_lvm(path).series["wind"]
    same(series.t, 0.1 * np.arange(n), 1e-9, "time")
    same(series.values["speed"], speed, 1e-9, "speed")


GROUPS = {
    "rates": (("p", "q", "r"), "rates"), "force": (("ax", "ay", "az"), "force"),
    "turn": (("qw", "qx", "qy", "qz"), "q"),
    "place": (("x", "y", "z"), "p"), "rotors": (("w1", "w2", "w3", "w4"), "rotors"),
    "share": (("command1", "command2", "command3", "command4"), "commands"),
}  # fmt: skip
LIMITS = {"px4": "ulog", "ardupilot": "dataflash"}
_MADE = made_flight(seconds=4.0, rate=RATE)


def flight_log(
    rng: np.random.Generator, folder: Path, write: Callable, controller: str, steps: Mapping[str, int] | None = None
) -> None:
    """A stretch of a made flight as one format writes it.

    steps  rows of the flight between samples that the format's writer leaves out, by group; 1 for all by default
    """
    first = int(rng.integers(0, 400))
    rows = slice(first, first + 4 * int(rng.integers(20, 140)) + 1)
    flight = Flight(*(getattr(_MADE, f.name)[rows] for f in fields(Flight)))
    flight.t = flight.t - flight.t[0]
    path = write(folder, flight)
    asked = {"onboard": path, "flight controller": controller, "log number": None}
    recording = read_onboard(asked, {"table columns": TABLE_COLUMNS} if controller == "table" else {})
    compare_flight(recording, flight, RESOLUTION.get(LIMITS.get(controller, ""), RESOLUTION["default"]), steps or {})


def compare_flight(recording: Recording, flight: Flight, limits: Mapping[str, float], steps: Mapping[str, int]) -> None:
    """Every sample of every quantity; the attitude's sign is free."""
    found = {n: (s.t, v) for s in recording.series.values() for n, v in s.values.items()}
    start = min(t[0] for t, _ in found.values())
    for group, (names, truth) in GROUPS.items():
        kept = slice(None, None, steps.get(group, 1))
        for column, name in enumerate(names):
            assert name in found, f"{name} was not read"
            t, values = found[name]
            same(t - t[0], flight.t[kept], 2e-6, f"time of {name}")
            assert abs(t[0] - start) < LARGEST_LAG, f"time of {name} begins {t[0] - start:.4g} s late"
            written = getattr(flight, truth)[kept, column]
            sign = np.where(flight.q[kept, 0] < 0, -1.0, 1.0) if group == "turn" else 1.0
            same(values, written * sign, limits[group], name)


SPARSE = {"turn": 2, "place": 2, "rotors": 4, "share": 4}
ROUND_TRIPS: dict[str, Callable[[np.random.Generator, Path], None]] = {
    "blackbox": blackbox,
    "decoded": decoded,
    "crazyflie": crazyflie,
    "motive": motive,
    "table": partial(flight_log, write=write_csv, controller="table"),
    "parquet": partial(flight_log, write=write_parquet, controller="table"),
    "lvm": wind,
    "px4": partial(flight_log, write=write_ulog, controller="px4", steps=SPARSE),
    "ardupilot": partial(flight_log, write=write_dataflash, controller="ardupilot", steps=SPARSE),
    "mcap": partial(flight_log, write=write_bag, controller="rosbag", steps=SPARSE),
    "ros1": partial(flight_log, write=partial(write_bag, version=1), controller="rosbag", steps=SPARSE),
    "mat": partial(flight_log, write=write_mat, controller="table"),
    "npz": partial(flight_log, write=write_npz, controller="table"),
    "gzip": partial(flight_log, write=write_gzip, controller="table"),
    "vicon": partial(capture, text=vicon_text, read=read_vicon),
    "qualisys": partial(capture, text=qualisys_text, read=read_qualisys),
}


def round_trip(name: str, rng: np.random.Generator) -> None:
    """One round trip of a reader. Raises AssertionError where a sample comes back changed."""
    with tempfile.TemporaryDirectory() as folder:
        ROUND_TRIPS[name](rng, Path(folder))
