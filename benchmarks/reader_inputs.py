"""Sound files of every reader, and how they are damaged: the inputs of `fuzz_readers.py` and `planted_faults.py`."""

import contextlib
import io
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from crazyflie_writer import encode_log as encode_crazyflie
from log_formats import (
    TABLE_COLUMNS,
    Flight,
    made_flight,
    write_bag,
    write_dataflash,
    write_gzip,
    write_mat,
    write_npz,
    write_ulog,
)  # fmt: skip
from scipy.spatial.transform import Rotation
from test_captures import qualisys_text, vicon_text

from quasi.errors import QuasiError
from quasi.importing.clocks.filter_delays import RPM_NOTCHES, STAGES, header_delays
from quasi.importing.onboard_log import read_onboard, require_motion
from quasi.importing.readers.motive import read_motive
from quasi.importing.readers.qualisys import read_qualisys
from quasi.importing.readers.table_reader import read_table_log
from quasi.importing.readers.vicon import read_vicon
from quasi.importing.series import Recording
from quasi.importing.wind import read_lvm
from quasi_synthesis.blackbox_writer import FIELD_NAMES, encode_log, event, slow_frame


def blackbox_seeds(rng: np.random.Generator) -> list[bytes]:
    """Short logs: one, two in one file, headers without frames."""
    n = 120
    values = rng.integers(0, 40, (n, len(FIELD_NAMES)))
    values[:, FIELD_NAMES.index("loopIteration")] = 4 * np.arange(n)
    values[:, FIELD_NAMES.index("time")] = 1_000_000 + 1000 * np.arange(n)
    others = [(0, event("sync beep", 5)), (3, slow_frame(1, 0)), (60, event("flight mode", 1, 0))]
    log = encode_log(values, others)[0] + event("end")
    bare = log[: log.rfind(b"H ")]
    return [log, log + log[: len(log) // 2], (bare[: bare.rfind(b"\n") + 1]) * 5]


SETTINGS = [
    *(name for stage in (*STAGES, *RPM_NOTCHES) for name in stage if name),
    *("gyro_notch_hz", "gyro_notch_cutoff", "acc_lpf_hz", "dshot_bidir", "dyn_notch_count", "dyn_notch_q"),
    *("dyn_notch_min_hz", "dyn_notch_max_hz", "gyro_scale", "acc_1G", "motorOutput", "minthrottle", "maxthrottle"),
    *("vbatref", "vbatcellvoltage", "motor_poles", "debug_mode", "features", "blackbox_high_resolution"),
    *("I interval", "P interval", "Firmware revision", "looptime"),
]
NUMBERS = [
    "0",
    "-1",
    "1",
    "14",
    "45",
    "250",
    "500",
    "4000",
    "2147483647",
    "-99999999999",
    "9" * 18,
    "9" * 400,
    "9" * 5000,
    "1e308",
]
WORDS = [*NUMBERS, "", "nan", "0x3f800000", "0x", "1/32", "1/0", "INAV 5.1.0 (abc) F722", "Betaflight 4.2.8 (abc) F7"]


def changed_header(data: bytes, rng: np.random.Generator) -> bytes:
    """A blackbox log whose settings are what firmware and damage write: 0, absent, negative, huge, lists, text."""
    lines = data.split(b"\n")
    for _ in range(int(rng.integers(1, 6))):
        name = str(rng.choice(SETTINGS))
        value = ",".join(str(rng.choice(WORDS)) for _ in range(int(rng.choice([1, 1, 2, 3]))))
        places = [i for i, line in enumerate(lines) if line.startswith(f"H {name}:".encode())]
        if places and rng.random() < 0.3:
            del lines[places[0]]
        elif places:
            lines[places[0]] = f"H {name}:{value}".encode()
        else:
            lines.insert(2, f"H {name}:{value}".encode())
    return b"\n".join(lines)


def cut_header(data: bytes, rng: np.random.Generator) -> bytes:
    """A blackbox log whose header ends at any byte, and its frames follow at once."""
    last = data.rfind(b"\nH ")
    frames = data.find(b"\n", last + 1) + 1
    return data[: int(rng.integers(0, frames))] + data[frames:]


def changed_speeds(data: bytes, rng: np.random.Generator) -> bytes:
    """A decoded log whose rotor speeds spike, freeze, stop, drop out, are random or in another unit."""
    lines = data.split(b"\n")
    at = next((i for i, line in enumerate(lines) if b"eRPM" in line or b"omegaUnfiltered" in line), None)
    if at is None:
        return data
    columns = [i for i, cell in enumerate(lines[at].split(b",")) if b"eRPM" in cell or b"omegaUnfiltered" in cell]
    kind, place = int(rng.integers(0, 6)), int(rng.choice(columns))
    for i in range(at + 1, len(lines)):
        cells = lines[i].split(b",")
        if place >= len(cells):
            continue
        if kind == 0 and rng.random() < 0.1:
            cells[place] = b"65535"
        elif kind == 1:
            cells[place] = str(rng.integers(0, 65536)).encode()
        elif kind == 2:
            cells[place] = cells[place] + b"00"
        elif kind == 3 and rng.random() < 0.1:
            cells[place] = b"0"
        elif kind == 4:
            cells[place] = b"1384"
        elif kind == 5:
            cells[place] = b"0"
        lines[i] = b",".join(cells)
    return b"\n".join(lines)


def saved_anew(data: bytes) -> bytes:
    """As a spreadsheet of many countries saves it: semicolons and decimal commas."""
    return data.replace(b",", b";").replace(b".", b",")


def decoded_seeds(rng: np.random.Generator) -> list[bytes]:
    """Both programs' shapes, and the first through a spreadsheet."""
    names = (
        "loopIteration, time (us), vbatLatest (V), gyroADC[0] (deg/s), gyroADC[1] (deg/s), accSmooth[0] (g), motor[0]"
    )
    rows = [", ".join(map(str, [i, 1000 * i, 16.5, *rng.integers(-200, 200, 4)])) for i in range(40)]
    tool = "\n".join([names, *rows[:5], "S frame: ANGLE_MODE, 0, IDLE, 1, 1", *rows[5:]])
    head = '"Product","Blackbox"\n"gyroScale","1.745e-8"\n"motorOutput","158,2047"\n'
    viewer = (
        head
        + '"loopIteration","time","gyroADC[0]","accSmooth[0]","motor[0]","eRPM[0]"\n'
        + "\n".join(",".join(map(str, [i, 500 * i, *rng.integers(0, 900, 4)])) for i in range(40))
    )
    names = ["loopIteration", "time", *(f"{n}[{i}]" for n in ("gyroADC", "accSmooth") for i in range(3))]
    names += [f"{n}[{i}]" for n in ("motor", "eRPM(/100)") for i in range(4)] + ["rcCommand[3]"]
    flown = [[i, 2000 * i, *rng.integers(-90, 90, 6), *rng.integers(900, 1400, 8), 12500] for i in range(400)]
    speeds = head + "\n".join(",".join(map(str, row)) for row in [names, *flown])
    return [tool.encode(), viewer.encode(), saved_anew(tool.encode()), speeds.encode()]


def indiflight_rows(rng: np.random.Generator) -> bytes:
    """INDIflight's columns, with messages of a capture that repeat."""
    names = [
        "time",
        *(f"{n}[{i}]" for n in ("gyroADCafterRpm", "accADCafterRpm", "extPos", "extVel") for i in range(3)),
    ]
    names += [f"{n}[{i}]" for n in ("quat", "omegaUnfiltered", "motor") for i in range(4)]
    values = rng.integers(-900, 900, (40, len(names) - 1))
    values[:, 6:12] = values[(np.arange(40) // 4) * 4, 6:12]
    return "\n".join([",".join(names), *(",".join(map(str, [500 * i, *v])) for i, v in enumerate(values))]).encode()


def motive_seeds(rng: np.random.Generator) -> list[bytes]:
    """A quaternion and an angle export of two blocks, with drop-outs, and the last through a spreadsheet."""
    files = []
    for kind, axes in (("Quaternion", "XYZW"), ("XYZ", "XYZ")):
        quantities = ["Rotation"] * len(axes) + ["Position"] * 3 + ["Mean Marker Error"] + ["Position"] * 3
        types = ["Rigid Body"] * (len(axes) + 4) + ["Marker"] * 3
        head = (
            f"Format Version,1.23,Capture Frame Rate,120.000000,Export Frame Rate,120.000000,Capture Start Time,"
            f"2024-03-01 02.11.08.123 PM,Rotation Type,{kind},Length Units,Millimeters"
        )
        lines = [head, ""]
        lines += [",".join(["", "", *row]) for row in (types, ["B"] * len(types), ['"A1"'] * len(types), quantities)]
        lines.append(",".join(["Frame", "Time (Seconds)", *axes, *"XYZ", "", *"XYZ"]))
        for i in range(50):
            turn = [0.01 * i, 0.1, 0.0, 0.99][: len(axes)]
            cells = ["" if i in (20, 21) else f"{v:.6f}" for v in (*turn, *rng.normal(0, 2, 7))]
            lines.append(",".join([str(i), f"{i / 120:.3f}", *cells]))
        files.append("\n".join(lines).encode())
    return [*files, saved_anew(files[-1])]


TABLE: dict[str, Any] = {
    "time": {"column": "t", "unit": "s"},
    "sources": [
        {
            "name": "imu",
            "time": {"column": "stamp", "unit": "ms"},
            "frame": "FLU",
            "world": "z-up",
            "columns": {n: {"column": n, "unit": "deg/s"} for n in "pqr"}
            | {n: {"column": n, "unit": "g", "frame": "world"} for n in ("ax", "ay", "az")}
            | {n: n for n in ("qw", "qx", "qy", "qz")},
        },
        {"name": "motors", "columns": {f"w{i}": {"column": f"m{i}", "unit": "eRPM"} for i in range(1, 5)}},
        {"name": "room", "motion capture": True, "columns": {n: n for n in "xyz"}},
        {"name": "estimate", "time": {"column": "when"}, "columns": {n: n for n in ("vx", "vy", "vz")}},
    ],
}


def table_frame(rng: np.random.Generator) -> pd.DataFrame:
    """One table of four sources on three clocks."""
    n = 60
    t = 0.01 * np.arange(n)
    columns = {"t": t, "stamp": 1e3 * t + 5, "when": t + rng.normal(0, 1e-4, n)}
    columns |= {
        c: rng.normal(0, 1, n).round(4) for c in ("p", "q", "r", "ax", "ay", "az", "x", "y", "z", "vx", "vy", "vz")
    }
    columns |= {c: np.full(n, v) for c, v in (("qw", 0.98), ("qx", 0.1), ("qy", 0.1), ("qz", 0.1))}
    columns |= {f"m{i}": rng.normal(9000, 300, n).round() for i in range(1, 5)}
    return pd.DataFrame(columns)


def table_seeds(rng: np.random.Generator) -> list[bytes]:
    """Comma, semicolon, and decimal commas below a comment."""
    frame = table_frame(rng)
    files = [frame.to_csv(index=False, sep=separator).encode() for separator in ",;"]
    return [*files, b"# a comment\n\n" + saved_anew(files[0])]


def parquet_seeds(rng: np.random.Generator) -> list[bytes]:
    """Packed and plain."""
    files = []
    for compression in ("zstd", None):
        buffer = io.BytesIO()
        table_frame(rng).to_parquet(buffer, compression=compression)
        files.append(buffer.getvalue())
    return files


def changed_table(rng: np.random.Generator) -> bytes:
    """A sound Parquet file whose columns are not what the mapping expects: types, gaps, order, names, lengths."""
    frame = table_frame(rng)
    columns = {name: pa.array(frame[name].to_numpy()) for name in frame}
    names, arrays = list(columns), list(columns.values())
    for _ in range(int(rng.integers(1, 5))):
        k, at = int(rng.integers(0, len(names))), int(rng.integers(0, len(frame) + 1))
        values = frame[frame.columns[k % len(frame.columns)]].to_numpy(float, copy=True)[: len(arrays[0])]
        kind = int(rng.integers(0, 11))
        if kind == 0:
            arrays[k] = pa.array([str(v) for v in values])
        elif kind == 1:
            arrays[k] = pa.array(values, mask=np.arange(len(values)) >= at)
        elif kind == 2:
            arrays[k] = pa.array(values > 0)
        elif kind == 3:
            arrays[k] = pa.array(np.abs(values * 1e9).astype("datetime64[ns]"))
        elif kind == 4:
            changed = values.copy()
            changed[at:] = rng.choice([np.nan, np.inf, -np.inf, 1e308, -1e-308, 0.0])
            arrays[k] = pa.array(changed)
        elif kind == 5 and len(names) > 1:
            del names[k], arrays[k]
        elif kind == 6:
            names[k] = str(rng.choice(names)) + str(rng.choice(["2", "", " "]))
        elif kind == 7:
            frame = frame.iloc[:at]
            arrays = [a.slice(0, at) for a in arrays]
        elif kind == 8:
            arrays[k] = pa.array(rng.permutation(values))
        elif kind == 9:
            arrays[k] = pa.array([[float(v)] for v in values], pa.list_(pa.float64()))
        else:
            arrays[k] = pa.nulls(len(values))
    buffer = io.BytesIO()
    pq.write_table(pa.Table.from_arrays(arrays, names=names), buffer)
    return buffer.getvalue()


def lvm_seeds(rng: np.random.Generator) -> list[bytes]:
    """Commas with points, tabulators with commas."""
    head = ["LabVIEW Measurement", "Writer_Version,2", "Reader_Version,2", "Separator,Comma", "Decimal_Separator,."]
    head += ["Multi_Headings,No", "X_Columns,One", "Time_Pref,Absolute", "Operator,x", "Date,2024/03/01"]
    head += ["Time,14:11:03.5", "***End_of_Header***", "", "Channels,1", "Samples,60", "***End_of_Header***"]
    plain = "\n".join(head + [f"{0.1 * i:.6f},{v:.6f}" for i, v in enumerate(rng.normal(5, 0.1, 60))])
    other = plain.replace(",", "\t").replace(".", ",")
    return [plain.encode(), other.encode()]


def read_log(path: Path) -> Recording:
    """A flight controller's log as the import reads it: format by content, axes, checks, delays by its settings."""
    recording = read_onboard({"onboard": path, "flight controller": "betaflight", "log number": None}, {})
    for one in header_delays(recording.metadata["header"], not recording.metadata.get("header lines lost")).values():
        assert 0.0 <= one["value"] < 1.0 and 0.0 <= one["std"] < 1.0, "a delay that no filter has"
    assert all(note.isprintable() for note in recording.notes), "raw bytes in a note"
    return recording


def crazyflie_seeds(rng: np.random.Generator) -> list[bytes]:
    """Versions 1 and 2: an estimate without pitch or IMU, an IMU with events of another type between."""
    n = 80
    estimate = [f"stateEstimate.{v}(f)" for v in ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "roll", "yaw")]
    drive = [*(f"motor.m{i}(I)" for i in range(1, 5)), "pm.vbatMV(H)"]
    first = {65535: ("fixedFrequency", [*drive, *estimate])}
    rows = np.hstack([rng.integers(0, 65536, (n, 4)), rng.integers(3000, 4200, (n, 1)), rng.normal(0, 0.3, (n, 11))])
    inertial = [
        *(f"gyro.{a}(e)" for a in "xyz"),
        *(f"acc.{a}(d)" for a in "xyz"),
        *(f"motor.m{i}(H)" for i in range(1, 5)),
    ]
    second = {7: ("imu", inertial), 9: ("estTDOA", ["idA(B)", "distanceDiff(f)"])}
    others = [(7, 0.01 * i, [*rng.normal(0, 1, 6), *rng.integers(0, 65536, 4)]) for i in range(n)]
    events = [(9, 0.01 * i + 0.003, [i % 6, 0.1]) for i in range(0, n, 2)]
    return [
        encode_crazyflie(first, [(65535, 0.01 * i, row) for i, row in enumerate(rows)], 2),
        encode_crazyflie(second, sorted([*others, *events], key=lambda record: record[1]), 1),
    ]


def read_crazyflie_log(path: Path) -> Recording:
    """A micro-SD log as the import reads it, with the sensors that it lacks made from the others."""
    recording = read_onboard({"onboard": path, "flight controller": "crazyflie", "log number": None}, {})
    with contextlib.suppress(QuasiError):  # too little to make them of is for the import to say
        made = require_motion(recording, str(path), [])
        assert all(np.isfinite(s.values).all() for s in (made.gyro, made.force)), "a sensor made of nothing"
    return recording


def log_seeds(write: Callable[[Path, Flight], Path]) -> Callable[[np.random.Generator], list[bytes]]:
    """A second of a made flight in one format."""

    def seeds(rng: np.random.Generator) -> list[bytes]:
        with tempfile.TemporaryDirectory() as folder:
            return [write(Path(folder), made_flight(seconds=1.0)).read_bytes()]

    return seeds


def read_as(controller: str, suffix: str = "", quadrotor: dict | None = None) -> Callable[[Path], Recording]:
    """A reader of logs of a flight controller; suffix  an extension that its library needs."""

    def read(path: Path) -> Recording:
        named = path.with_suffix(suffix) if suffix else path
        if suffix:
            named.write_bytes(path.read_bytes())
        flight = {"onboard": named, "flight controller": controller, "log number": None}
        return read_onboard(flight, quadrotor or {})

    return read


def capture_seeds(text: Callable[..., str]) -> Callable[[np.random.Generator], list[bytes]]:
    """A second of a made motion in the room's axes."""

    def seeds(rng: np.random.Generator) -> list[bytes]:
        t = np.arange(100) / 100
        room = Rotation.from_rotvec(np.column_stack([0.2 * np.sin(6 * t), 0.3 * np.cos(5 * t), 2 * t]))
        return [text((t, None, None, 1000 * np.column_stack([t, t**2, 1 - t]), room)).encode()]

    return seeds


ARRAYS = {"table columns": TABLE_COLUMNS}
READERS: dict[str, tuple[Callable[[Path], Recording], Callable[[np.random.Generator], list[bytes]]]] = {
    "blackbox": (read_log, blackbox_seeds),
    "decoded": (read_log, lambda rng: [*decoded_seeds(rng), indiflight_rows(rng)]),
    "crazyflie": (read_crazyflie_log, crazyflie_seeds),
    "motive": (lambda path: read_motive(path, "B", np.array([0.01, 0.0, -0.02])), motive_seeds),
    "table": (lambda path: read_table_log(path, TABLE, 14), table_seeds),
    "parquet": (lambda path: read_table_log(path, TABLE, 14), parquet_seeds),
    "lvm": (read_lvm, lvm_seeds),
    "px4": (read_as("px4"), log_seeds(write_ulog)),
    "ardupilot": (read_as("ardupilot"), log_seeds(write_dataflash)),
    "mcap": (read_as("rosbag", ".mcap"), log_seeds(write_bag)),
    "ros1": (read_as("rosbag", ".bag"), log_seeds(partial(write_bag, version=1))),
    "mat": (read_as("table", "", ARRAYS), log_seeds(write_mat)),
    "npz": (read_as("table", "", ARRAYS), log_seeds(write_npz)),
    "gzip": (read_as("table", "", ARRAYS), log_seeds(write_gzip)),
    "vicon": (lambda path: read_vicon(path, None), capture_seeds(vicon_text)),
    "qualisys": (lambda path: read_qualisys(path, None), capture_seeds(qualisys_text)),
}


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes flipped, runs overwritten, removed, repeated or inserted, numbers swapped, the end cut off."""
    broken = bytearray(data)
    for _ in range(int(rng.integers(1, 10))):
        if not broken:
            break
        at = int(rng.integers(0, len(broken)))
        length = int(min(len(broken) - at, 1 << rng.integers(0, 8)))
        kind = int(rng.integers(0, 8))
        if kind == 0:
            broken[at] = int(rng.integers(0, 256))
        elif kind == 1:
            broken[at : at + length] = rng.bytes(length)
        elif kind == 2:
            del broken[at : at + length]
        elif kind == 3:
            broken[at:at] = broken[at : at + length]
        elif kind == 4:
            broken[at:at] = bytes([int(rng.choice([0, 255, 73, 80, 69, 72]))]) * length
        elif kind == 5 and rng.random() < 0.3:
            del broken[at:]
        elif kind == 6:
            # a number of the text becomes another, where the readers believe what is stated
            digits = [i for i in range(at, min(len(broken), at + 200)) if 48 <= broken[i] <= 57]
            if digits:
                words = [b"0", b"-1", b"99999999999999999999", b"1e308", b"nan", b"x", b"255"]
                broken[digits[0] : digits[0] + 1] = words[int(rng.integers(0, len(words)))]
        else:
            other = int(rng.integers(0, len(broken)))
            broken[at : at + length] = broken[other : other + length]
    return bytes(broken)


CUT_EVERY = 10  # inputs, of which one is cut off at any byte


def broken_input(name: str, originals: list[bytes], i: int, rng: np.random.Generator) -> bytes:
    """Input number i of a reader: of every second one the content is wrong, of the others bytes are damaged."""
    original = originals[i // 2 % len(originals)]
    if i % 2 == 0 and name == "parquet":
        return changed_table(rng)
    if i % 2 == 0 and name == "blackbox":
        return cut_header(original, rng) if i % 4 == 0 else changed_header(original, rng)
    if i % 2 == 0 and name == "decoded":
        return changed_speeds(original, rng)
    if i % CUT_EVERY == 1:  # cut off and otherwise whole: only then does a file end where a frame or record ends
        return original[: int(rng.integers(0, len(original) + 1))]
    return mutate(original, rng)
