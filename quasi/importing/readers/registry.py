"""The list of readers. A raw file goes to the reader of what it holds, whatever its extension.

A further format is one file here with a `Reader`, its name in LOGS or CAPTURES, and its first bytes in
`quasi.project.recognition`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quasi.errors import ReadError
from quasi.importing.readers.betaflight import BLACKBOX_READER, DECODED_READER
from quasi.importing.readers.c3d import READER as C3D
from quasi.importing.readers.crazyflie import READER as CRAZYFLIE
from quasi.importing.readers.dataflash import READER as DATAFLASH
from quasi.importing.readers.motive import READER as MOTIVE
from quasi.importing.readers.px4 import READER as PX4
from quasi.importing.readers.qualisys import READER as QUALISYS
from quasi.importing.readers.reader import TEXT, Reader, Request
from quasi.importing.readers.rosbag import READER as ROSBAG
from quasi.importing.readers.table_reader import READER as TABLE
from quasi.importing.readers.vicon import READER as VICON
from quasi.importing.series import Recording
from quasi.project.recognition import CONTROLLERS, HEAD_SIZE, recognise
from quasi.tables import read_head

LOGS: tuple[Reader, ...] = (BLACKBOX_READER, DECODED_READER, TABLE, PX4, DATAFLASH, ROSBAG, CRAZYFLIE)
CAPTURES: tuple[Reader, ...] = (VICON, QUALISYS, C3D, MOTIVE)
READERS = LOGS + CAPTURES


def read_log(request: Request) -> Recording:
    """The recording of an on-board log, by its flight controller and by what it holds.

    Raises ReadError for a flight controller without a reader, or a file of another format than its readers read.
    """
    able = [reader for reader in READERS if request.controller in reader.controllers]
    if not able:
        raise ReadError(
            f"{request.path}: flight controller '{request.controller}' has no reader; use {' or '.join(CONTROLLERS)}"
        )
    return _reader_of(request, able).read(request)


def read_capture(request: Request) -> Recording:
    """The recording of a motion-capture export. Raises ReadError where no reader knows it."""
    return _reader_of(request, [reader for reader in READERS if not reader.controllers]).read(request)


def controller_of(path: Path, quadrotor: Mapping[str, Any]) -> str:
    """The flight controller that a log is of, by what it holds. Raises ReadError where no reader knows it."""
    found = recognise(read_head(path, HEAD_SIZE))
    kind = TEXT if found is None else found.kind
    if kind == TEXT and "table columns" in quadrotor:
        return "table"
    for reader in READERS:
        if kind in reader.kinds and reader.controllers:
            return reader.controllers[0]
    what = f"is {found.name}" if found else "is of no known format"
    raise ReadError(f"{path} {what}, which no reader of on-board logs reads; {found.remedy if found else 'give a log'}")


def is_capture(path: object) -> bool:
    """Whether a file is a motion-capture export by what it holds."""
    found = recognise(read_head(path, HEAD_SIZE))
    return found is not None and any(found.kind in r.kinds and not r.controllers for r in READERS)


def _reader_of(request: Request, able: list[Reader]) -> Reader:
    """The reader of a file among those able to read for a purpose."""
    found = recognise(read_head(request.path, HEAD_SIZE))
    kind = TEXT if found is None else found.kind
    for reader in able:
        if kind in reader.kinds:
            return reader
    expected = " or ".join(reader.name for reader in able)
    what = f"is {found.name}" if found else "is of no format that is known"
    remedy = found.remedy if found else "give the file as it was recorded"
    raise ReadError(f"{request.path} {what}, expected {expected}; {remedy}")
