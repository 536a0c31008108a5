"""What a raw file is, by its first bytes: formats that no reader here reads are named, with what to do.

The extension says nothing. Only the first bytes are looked at, and the names in a ZIP archive's first entries; nothing
of a file is unpacked or run. Sources: the formats' own specifications; of Crazyflie's micro-SD logs its event format.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from quasi.errors import ReadError

MARKER = b"H Product:Blackbox"  # the first header line of each blackbox log
HEAD_SIZE = 4096  # bytes in which a blackbox log begins: text that a terminal put before it is skipped
# values of 'Flight controller', and the extensions that the logbook may leave out
CONTROLLERS = {
    "betaflight": (".bbl", ".BBL", ".bfl", ".BFL", ".csv", ".CSV"),
    "indiflight": (".bbl", ".BBL", ".bfl", ".BFL", ".csv", ".CSV"),
    "table": (".csv", ".CSV", ".csv.gz", ".parquet", ".Parquet", ".mat", ".npz"),
    "px4": (".ulg", ".ULG"),
    "ardupilot": (".bin", ".BIN"),
    "rosbag": (".bag", ".mcap", ".db3"),
    "crazyflie": (".bin", ".BIN"),
}
SET = "set 'Flight controller' to {}"
TABLE = "use the flight controller 'table' with 'table columns' in the quadrotor configuration"
CONVERT = f"export its signals to one CSV or Parquet table and {TABLE}"


@dataclass(frozen=True)
class Format:
    """kind  a word for code; name  for messages; remedy  what to do, the end of a sentence."""

    kind: str
    name: str
    remedy: str


BLACKBOX = Format("blackbox", "a blackbox log", "set 'Flight controller' to betaflight or indiflight")
PARQUET = Format("parquet", "a Parquet table", TABLE)
MOTIVE = Format("motive", "a motion-capture export of Motive", "name it in 'Raw OptiTrack Name' of the logbook")
UNPACK = "unpack it and give the file in it"
ZIPPED = (
    (b".npy", Format("npz", "a NumPy archive (npz)", TABLE)),
    (b"xl/", Format("xlsx", "a spreadsheet (xlsx)", "save the sheet as CSV")),
    (b"", Format("zip", "a ZIP archive", UNPACK)),
)
# first bytes, format; the first that fits
STARTS = (
    (b"PAR1", PARQUET),
    (b"ULog\x01\x12\x35", Format("ulog", "a PX4 ULog", SET.format("px4"))),
    (b"#ROSBAG V", Format("rosbag", "a ROS 1 bag", SET.format("rosbag"))),
    (b"\x89MCAP0\r\n", Format("mcap", "an MCAP recording (ROS 2)", SET.format("rosbag"))),
    (b"SQLite format 3\0", Format("db3", "an SQLite database, such as a ROS 2 bag (db3)", SET.format("rosbag"))),
    (b"MATLAB 5.0 MAT-file", Format("mat5", "a MATLAB file (version 5)", TABLE)),
    (b"MATLAB 7.3 MAT-file", Format("mat73", "a MATLAB file (version 7.3)", f"save it with -v7 and {TABLE}")),
    (b"\x89HDF\r\n\x1a\n", Format("hdf5", "an HDF5 file", CONVERT)),
    (b"\x93NUMPY", Format("npy", "a NumPy array (npy)", CONVERT)),
    (b"ARROW1\0\0", Format("feather", "an Arrow file (Feather)", f"save it as Parquet and {TABLE}")),
    (b"\xa3\x95\x80", Format("dataflash", "an ArduPilot DataFlash log", SET.format("ardupilot"))),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", Format("xls", "an old spreadsheet (xls)", "save the sheet as CSV")),
    (b"\x1f\x8b", Format("gzip", "packed by gzip", UNPACK)),
    (b"BZh", Format("bzip2", "packed by bzip2", UNPACK)),
    (b"\xfd7zXZ\0", Format("xz", "packed by xz", UNPACK)),
    (b"7z\xbc\xaf\x27\x1c", Format("7z", "a 7-Zip archive", UNPACK)),
    (b"\x28\xb5\x2f\xfd", Format("zstd", "packed by zstd", UNPACK)),
)
CAPTURE_REMEDY = "name it in 'Raw OptiTrack Name' of the logbook"
VICON = Format("vicon", "a motion-capture export of Vicon", CAPTURE_REMEDY)
QUALISYS = Format("qualisys", "a motion-capture export of Qualisys", CAPTURE_REMEDY)
C3D = Format("c3d", "a C3D file of a motion capture", CAPTURE_REMEDY)
# kind of data, then its rate; the line of quantities stands below the names
_VICON = re.compile(
    rb'(\xef\xbb\xbf)?"?(Objects|Segments|Global \w+|Model Outputs|Trajectories)"?[,;\t]*\r?\n"?[0-9.]+'
)
PICKLE = Format("pickle", "a Python pickle, which may run code when it is opened and is never read", CONVERT)
CRAZYFLIE_FORMAT = Format("crazyflie", "a Crazyflie micro-SD log", SET.format("crazyflie"))


def recognise(data: bytes) -> Format | None:
    """The format of a file by its first bytes (n >= 4096 of them or all); None for text and what is not known."""
    data = bytes(data[:HEAD_SIZE])
    for start, found in STARTS:
        if data.startswith(start):
            return found
    if data.startswith(b"PK\x03\x04"):
        return next(found for name, found in ZIPPED if name in data)
    if MARKER in data:
        return BLACKBOX
    # protocol 2 to 5; from 4 on a frame follows, before that an opening bracket, a global or an empty container
    if data[:1] == b"\x80" and 2 <= (data + b"\0\0")[1] <= 5 and data[2:3] in (b"\x95", b"}", b"]", b")", b"(", b"c"):
        return PICKLE
    # 0xBC, version 1 or 2, number of event types, and the first type's id and printable name
    if data[:1] == b"\xbc" and int.from_bytes(data[1:3], "little") in (1, 2):
        name = data[7 : max(7, data.find(b"\0", 7))]
        if name and name.isascii() and name.decode().isprintable():
            return CRAZYFLIE_FORMAT
    # the number of the first parameter block, and 0x50 (the C3D file format, section "Header")
    if data[1:2] == b"\x50" and 2 <= data[0] <= 64 and len(data) > 512 and b"\0\0" in data[:512]:
        return C3D
    text = data.replace(b"\0", b"")  # UTF-16, too
    if re.match(rb'(\xef\xbb\xbf)?"?NO_OF_FRAMES[\t,;]', text):
        return QUALISYS
    if _VICON.match(text) and b"Sub Frame" in text:
        return VICON
    if b"Format Version" in text[:200] and (b"Capture Frame Rate" in text or b"Take Name" in text):
        return MOTIVE
    return None


def refuse_other_formats(path: str | Path, data: bytes, read: Collection[str], expected: str) -> None:
    """Raise ReadError where a file is known to be of a format that is not among `read` (kinds).

    expected  what the caller reads, for the message
    """
    found = recognise(data)
    if found is not None and found.kind not in read:
        raise ReadError(f"{path} is {found.name}, expected {expected}; {found.remedy}")
