"""Decode Crazyflie micro-SD logs: event types, their records, and how the file ends.

Layout, little endian: byte 0xBC; uint16 version (1 or 2); uint16 number of event types; per type uint16 id, name (up to
a zero byte), uint16 number of variables, per variable a zero-terminated text `group.name(c)`, c a letter of Python's
`struct`. Records follow: uint16 id, time stamp (version 1: uint32 ms; version 2: uint64 us), the type's variables
without padding. The last 4 bytes are the CRC-32 (zlib) of everything before them.
"""

import re
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from quasi.errors import ReadError, quoted

MAGIC = 0xBC
STAMPS = {1: ("I", 1e-3), 2: ("Q", 1e-6)}  # version: letter of the time stamp, seconds per count
LETTERS = "bBhHiIqQefd"  # of `struct`: numbers without padding
VARIABLE = re.compile(r"([^()]+)\((.)\)")
CRC_BYTES = 4


@dataclass
class EventType:
    """One type of event: name; variables, their names in order; record, layout of time stamp and variables."""

    name: str
    variables: list[str]
    record: np.dtype
    chunks: list[bytes] = field(default_factory=list)

    def columns(self, seconds: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Time stamps (n,), s, and {variable: (n,)} of all records; seconds  per count of the stamp."""
        rows = np.frombuffer(b"".join(self.chunks), self.record)
        with np.errstate(invalid="ignore"):  # damaged bytes may be signalling NaN
            values = {name: rows[f"v{i}"].astype(float) for i, name in enumerate(self.variables)}
        return rows["stamp"].astype(float) * seconds, values


@dataclass(frozen=True)
class EventLog:
    """version, seconds per count of its stamps, event types by id, and how the file ended.

    checksum  "right", "wrong" or "missing"; ending  sentences on what could not be read, [] for a whole file
    """

    version: int
    seconds: float
    types: dict[int, EventType]
    checksum: str
    ending: list[str]


def decode_events(data: bytes, path: str | Path) -> EventLog:
    """Decode a whole file.

    data     its content; path  for messages
    Raises   ReadError where the header cannot be read or names no event
    """
    head = _Header(data, path)
    if head.take("B", "the first byte") != MAGIC:
        raise ReadError(f"{path} does not begin with 0xBC; it is no Crazyflie micro-SD log: give the file as logged")
    version = head.take("H", "the version")
    if version not in STAMPS:
        raise ReadError(
            f"{path} is a Crazyflie micro-SD log of version {version}, expected 1 or 2; convert it to a table"
        )
    letter, seconds = STAMPS[version]
    types: dict[int, EventType] = {}
    for _ in range(head.take("H", "the number of event types")):
        number, event = head.take_event_type(letter)
        if number in types:
            raise ReadError(f"{path}: two event types have the id {number}; the header is damaged, copy the file again")
        types[number] = event
    if not types:
        raise ReadError(f"{path} names no event type, so that it holds no data; configure the micro-SD logging")
    stored = struct.unpack("<I", data[-CRC_BYTES:])[0] if len(data) >= head.at + CRC_BYTES else None
    is_whole = stored is not None and zlib.crc32(data[:-CRC_BYTES]) == stored
    end = len(data) - CRC_BYTES if is_whole else len(data)
    at, unknown = _split_records(data, head.at, end, types)
    if is_whole and at == end:
        return EventLog(version, seconds, types, "right", [])
    return _with_ending(EventLog(version, seconds, types, "missing", []), data, at, end, unknown, is_whole, path)


def _split_records(data: bytes, at: int, end: int, types: dict[int, EventType]) -> tuple[int, int | None]:
    """Hand the records from byte `at` to their types; return the byte where it ended and an unknown id met there.

    The damage that an unknown id shows may begin within the record before it, which is left out.
    """
    last: EventType | None = None
    while at + 2 <= end:
        number = int.from_bytes(data[at : at + 2], "little")
        event = types.get(number)
        if event is None:
            if last is not None:
                last.chunks.pop()
            return at, number
        size = event.record.itemsize
        if at + 2 + size > end:
            break
        event.chunks.append(data[at + 2 : at + 2 + size])
        last, at = event, at + 2 + size
    return at, None


def _with_ending(
    log: EventLog, data: bytes, at: int, end: int, unknown: int | None, is_whole: bool, path: str | Path
) -> EventLog:
    """The log with what its end says: a record cut off, an unknown id, a wrong or a missing checksum."""
    left, ending, checksum = end - at, [], "right" if is_whole else "missing"
    if not is_whole and left == CRC_BYTES:
        # whole records, and four bytes that are no checksum of them
        return EventLog(
            log.version, log.seconds, log.types, "wrong",
            [f"{path}: the checksum is wrong, so that some bytes are not as they were logged; copy the file again"],
        )  # fmt: skip
    if unknown is not None:
        ending.append(
            f"{path}: the event id {unknown} at byte {at} is in no header line, so that the last {left} of {len(data)} "
            "bytes could not be read, and the record before them is left out; copy the file again"
        )
    elif left > 0 or not is_whole:
        ending.append(
            f"{path} ends {'within a record' if left else 'after a record'} and has no checksum: the card was removed "
            "or the power failed while logging; everything before is read"
        )
    return EventLog(log.version, log.seconds, log.types, checksum, ending)


class _Header:
    """The header's fields in order; at  the next byte."""

    def __init__(self, data: bytes, path: str | Path) -> None:
        self.data, self.path, self.at = data, path, 0

    def take(self, letter: str, what: str) -> int:
        """The next number; what  it is, for messages."""
        size = struct.calcsize(f"<{letter}")
        if self.at + size > len(self.data):
            raise ReadError(
                f"{self.path} ends within its header, at {what} (byte {self.at}); nothing was logged: copy it again"
            )
        (value,) = struct.unpack_from(f"<{letter}", self.data, self.at)
        self.at += size
        return value

    def take_text(self, what: str) -> str:
        """The next text up to a zero byte."""
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise ReadError(f"{self.path} ends within its header, at {what} (byte {self.at}); copy the file again")
        raw, self.at = self.data[self.at : end], end + 1
        text = raw.decode("ascii", "replace")
        if not text or "\ufffd" in text or not text.isprintable():
            raise ReadError(
                f"{self.path}: {what} at byte {end - len(raw)} is {quoted(text)}, expected a name; copy the file again"
            )
        return text

    def take_event_type(self, stamp: str) -> tuple[int, EventType]:
        """Id and layout of the next event type; stamp  letter of the time stamp."""
        number = self.take("H", "the id of an event type")
        name = self.take_text("the name of an event type")
        variables: list[str] = []
        fields = [("stamp", f"<{_numpy(stamp)}")]
        for i in range(self.take("H", f"the number of variables of {name}")):
            text = self.take_text(f"variable {i + 1} of {name}")
            parts = VARIABLE.fullmatch(text)
            if parts is None or parts[2] not in LETTERS:
                raise ReadError(
                    f"{self.path}: variable {i + 1} of {name} is {quoted(text)}, expected 'group.name(c)' with c of "
                    f"{' '.join(LETTERS)}; the header is damaged or of a later format"
                )
            if parts[1] in variables:
                raise ReadError(f"{self.path}: {name} names {parts[1]} twice; copy the file again")
            variables.append(parts[1])
            fields.append((f"v{i}", f"<{_numpy(parts[2])}"))
        return number, EventType(name, variables, np.dtype(fields))


def _numpy(letter: str) -> str:
    """A letter of `struct` as NumPy writes the same number."""
    return f"{dict(zip('bBhHiIqQefd', 'iuiuiuiufff'))[letter]}{struct.calcsize('<' + letter)}"
