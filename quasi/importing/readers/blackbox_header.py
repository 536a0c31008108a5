"""The logs in a blackbox file and their headers: what each log's frames consist of."""

import math
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from quasi.errors import ReadError, quoted
from quasi.importing.readers.blackbox_kernel import ARGUMENT, ENCODING, GROUP, PREDICTOR, SIGNED
from quasi.project.recognition import MARKER

MOST_LOGS = 1000  # flash chips hold dozens
MOST_FIELDS = 255
MOST_ITERATIONS = 65536  # of one I interval
_LONGEST_LINE = 8192
_CONTROL = re.compile(rb"[\x00-\x08\x0b-\x1f\x7f]")  # bytes that no header line holds: frames, or damage
# header lines that predictors of main fields refer to, by the predictor's number in the format
REFERENCES = {4: "minthrottle", 9: "vbatref", 11: "motorOutput"}
FROM_MOTOR_0 = 5  # the predictor that refers to motor[0] of the same frame
_ENCODINGS = {0, 1, 3, 6, 7, 8, 9, 10}
# fields that one group can hold, and the fewest bytes it takes
_GROUPS = {6: 8, 7: 3, 8: 4, 10: 3}


class _Unreadable(Exception):
    """Why a log's header cannot be used, as the end of a sentence."""


@dataclass(frozen=True)
class Log:
    """One log of a file.

    number   1-based place in the file, as the numbers of blackbox_decode's output
    start, data, end  offsets of its header, of its first frame and of the byte behind it
    header   {name: text} of its header lines; names  {"I", "S", "G", "H": field names}
    layout   (5, 5, fields) and sizes (5,): see the kernel; skips  (I interval,) iterations not logged after each
    fault    why it cannot be decoded, or ""
    damage   header lines that are not readable
    absent   {main field: header line that its values are predicted from, and that the header lacks}
    notes    sentences about settings that could not be used
    """

    number: int
    start: int
    data: int
    end: int
    header: dict[str, str]
    names: dict[str, list[str]] = field(default_factory=dict)
    layout: np.ndarray | None = None
    sizes: np.ndarray | None = None
    skips: np.ndarray | None = None
    shortest: int = 1
    fault: str = ""
    damage: int = 0
    absent: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def find_logs(data: bytes, path: str) -> list[Log]:
    """Every log of a file, in order; a log whose header cannot be used says so in `fault`.

    Raises ReadError when the file holds no log at all, or more than can be.
    """
    starts = [match.start() for match in re.finditer(re.escape(MARKER), data)]
    if not starts:
        start = data[:16]
        raise ReadError(
            f"{path} holds no blackbox log: expected a line '{MARKER.decode()} ...', found {start!r} at its start; "
            "give the .bbl or .bfl file as the flight controller wrote it"
        )
    if len(starts) > MOST_LOGS:
        raise ReadError(f"{path} holds {len(starts)} log headers, expected at most {MOST_LOGS}; copy the file anew")
    ends = [*starts[1:], len(data)]
    return [_log(data, number, start, end) for number, (start, end) in enumerate(zip(starts, ends), start=1)]


def _log(data: bytes, number: int, start: int, end: int) -> Log:
    header, at, damage = _header_lines(data, start, end)
    end = _without_padding(data, at, end)
    about = {"number": number, "start": start, "data": at, "end": end, "header": header, "damage": damage}
    try:
        version = header.get("Data version", "")
        if version != "2":
            raise _Unreadable(f"its data version is {quoted(version)}, expected 2")
        names, layout, sizes = _layout(header)
        absent = _absent_references(header, names["I"], layout, sizes)
        if "time" in absent:
            raise _Unreadable(f"its time is predicted from the header line '{absent['time']}', which is absent")
        skips, notes = _skips(header)
        return Log(
            **about, names=names, layout=layout, sizes=sizes, skips=skips, shortest=_shortest(layout, sizes),
            absent=absent, notes=notes,
        )  # fmt: skip
    except _Unreadable as error:
        return Log(**about, fault=str(error))


def _header_lines(data: bytes, at: int, end: int) -> tuple[dict[str, str], int, int]:
    """Header lines "H name:value" from `at` on: ({name: value}, offset of the first frame, lines lost)."""
    header: dict[str, str] = {}
    damage = 0
    while at < end:
        stop = data.find(b"\n", at, min(end, at + _LONGEST_LINE))
        # a line that was cut runs into the frames behind it
        if data[at : at + 2] != b"H " or stop < 0 or _CONTROL.search(data, at, stop):
            # damage within the header: further lines within reach belong to it
            again = data.find(b"\nH ", at, min(end, at + 512))
            damage += data[at : at + 2] == b"H " or again >= 0
            if again < 0:
                break
            at = again + 1
            continue
        name, colon, value = data[at + 2 : stop].decode("latin-1").partition(":")
        if colon and name.isprintable():
            header.setdefault(name.strip(), value.strip())
        else:
            damage += 1
        at = stop + 1
    return header, at, damage


def _without_padding(data: bytes, start: int, end: int) -> int:
    """The end of a log without the erased flash (0xFF) or blank card space (0x00) behind it."""
    for blank, least in ((b"\xff", 16), (b"\x00", 64)):
        stripped = start + len(data[start:end].rstrip(blank))
        if end - stripped >= least:
            end = stripped
    return end


def _numbers(header: Mapping[str, str], key: str, count: int) -> list[int]:
    text = header.get(key)
    if text is None:
        raise _Unreadable(f"its header lacks '{key}'")
    try:
        values = [int(x) for x in text.split(",")]
    except ValueError:
        values = [-1]
    if not all(0 <= value < 1000 for value in values):
        raise _Unreadable(f"its header line '{key}' is not a list of small whole numbers")
    if len(values) != count:
        raise _Unreadable(f"its header line '{key}' has {len(values)} entries, expected {count}")
    return values


def _layout(header: Mapping[str, str]) -> tuple[dict[str, list[str]], np.ndarray, np.ndarray]:
    """Field names per kind, and the kernel's layout (5, 5, fields) and sizes (5,)."""
    names = {
        kind: [standard_name(name) for name in header[f"Field {kind} name"].split(",")]
        for kind in "ISGH"
        if header.get(f"Field {kind} name", "").strip()
    }
    if "I" not in names:
        raise _Unreadable("its header lacks 'Field I name'")
    if "time" not in names["I"]:
        raise _Unreadable("its frames hold no time")
    width = max(map(len, names.values()))
    if width > MOST_FIELDS:
        raise _Unreadable(f"its header names {width} fields, expected at most {MOST_FIELDS}")
    layout = np.zeros((5, 5, width), np.int64)
    sizes = np.zeros(5, np.int64)
    for k, kind in enumerate("IPSGH"):
        of = "I" if kind == "P" else kind
        if of not in names or (kind == "P" and "Field P encoding" not in header):
            continue
        count = len(names[of])
        encodings = _numbers(header, f"Field {kind} encoding", count)
        predictors = _numbers(header, f"Field {kind} predictor", count)
        signed = _numbers(header, f"Field {of} signed", count) if f"Field {of} signed" in header else [0] * count
        for i, (name, encoding, predictor) in enumerate(zip(names[of], encodings, predictors)):
            if encoding not in _ENCODINGS:
                raise _Unreadable(f"field '{name}' of its {kind} frames uses encoding {encoding}, which is not known")
            layout[k, ARGUMENT, i] = _argument(name, predictor, names[of], i, kind)
        layout[k, ENCODING, :count], layout[k, PREDICTOR, :count], layout[k, SIGNED, :count] = (
            encodings,
            predictors,
            signed,
        )
        i = 0
        while i < count:
            run = 1
            while run < _GROUPS.get(encodings[i], 1) and i + run < count and encodings[i + run] == encodings[i]:
                run += 1
            layout[k, GROUP, i] = run
            i += run
        sizes[k] = count
    return names, layout, sizes


def _argument(name: str, predictor: int, names: list[str], i: int, kind: str) -> int:
    """What the predictor of a field refers to: the place of motor[0]."""
    if not 0 <= predictor <= 11:
        raise _Unreadable(f"field '{name}' of its {kind} frames uses predictor {predictor}, which is not known")
    if predictor == 5:
        if "motor[0]" not in names[:i]:
            raise _Unreadable(f"field '{name}' is predicted from motor[0], which does not stand before it")
        return names.index("motor[0]")
    return 0


def _absent_references(
    header: Mapping[str, str], names: list[str], layout: np.ndarray, sizes: np.ndarray
) -> dict[str, str]:
    """{main field: header line} of the fields that are predicted from a number that the header lacks."""
    absent: dict[str, str] = {}
    for predictor, line in REFERENCES.items():
        number = hex_float(header.get(line, "").split(",")[0] or None)
        if number is None or abs(number) >= 2**31:
            used = (layout[:2, PREDICTOR, : len(names)] == predictor) & (sizes[:2, None] > 0)
            absent |= {names[i]: line for i in np.flatnonzero(used.any(axis=0))}
    if "motor[0]" in absent:
        used = (layout[:2, PREDICTOR, : len(names)] == FROM_MOTOR_0) & (sizes[:2, None] > 0)
        absent |= {names[i]: absent["motor[0]"] for i in np.flatnonzero(used.any(axis=0))}
    return absent


def standard_name(field_name: str) -> str:
    """The name of a field in released firmware: development builds of Betaflight 4.5 write eRPM(/100)[0]."""
    return re.sub(r"^eRPM\(/100\)", "eRPM", field_name)


def _shortest(layout: np.ndarray, sizes: np.ndarray) -> int:
    """The fewest bytes an I or P frame can take: its letter and a byte for each field or group that takes any."""
    groups = (layout[:2, GROUP] > 0) & (layout[:2, ENCODING] != 9)
    return int(min(1 + groups[k].sum() for k in range(2) if sizes[k] > 0))


def _skips(header: Mapping[str, str]) -> tuple[np.ndarray, tuple[str, ...]]:
    """How many iterations the firmware leaves out after each iteration of an I interval, and notes.

    Frames are written where (index + numerator - 1) % denominator < numerator, and at each I interval.
    'P interval' is 'numerator/denominator', or just the denominator. Intervals serve to count iterations and to find
    the next frame after damage; times do not need them, so that unusable ones stop nothing.
    """
    try:
        interval = int(header.get("I interval", "32"))
        first, slash, second = header.get("P interval", "1").partition("/")
        numerator, denominator = (int(first), int(second)) if slash else (1, int(first))
    except ValueError:
        interval = numerator = denominator = -1
    within = 0 <= numerator <= MOST_ITERATIONS and 0 <= denominator <= MOST_ITERATIONS
    if not (1 <= interval <= MOST_ITERATIONS and within):
        stated = f"{quoted(header.get('I interval', ''))} and {quoted(header.get('P interval', ''))}"
        return np.zeros(1, np.int64), (
            f"the header lines 'I interval' and 'P interval' are {stated}, expected whole numbers up to "
            f"{MOST_ITERATIONS}; iterations were not counted, times are not affected",
        )
    index = np.arange(interval)
    logged = index == 0
    if denominator > 0:
        logged |= (index + numerator - 1) % denominator < numerator
    # the next logged index after each, where the next interval always begins with one
    following = np.append(np.flatnonzero(logged), interval)
    return (following[np.searchsorted(following, index, side="right")] - index - 1).astype(np.int64), ()


def firmware(header: Mapping[str, str]) -> str:
    """Name of the firmware that wrote a log, "" where its revision has no name before its number: "Betaflight", "INAV".

    'Firmware type' does not serve: Betaflight and its forks all write Cleanflight there.
    """
    found = re.match(
        r"([A-Za-z][A-Za-z_-]{1,30})\s*/?\s*(?:\S+\s+)?[vV]?[0-9]{1,6}[.][0-9]",
        str(header.get("Firmware revision", "")),
    )
    return found.group(1) if found else ""


def is_other_firmware(header: Mapping[str, str]) -> bool:
    """Whether a log names a firmware that is neither Betaflight nor INDIflight, whose settings this reader knows."""
    return firmware(header).lower() not in ("", "betaflight", "cleanflight", "indiflight")


def version(header: Mapping[str, str]) -> tuple[int, ...] | None:
    """Version number of a Betaflight log, (4, 2, 11); None for other firmware."""
    found = re.match(
        r"Betaflight\s+(?:/\s*\S+\s+)?([0-9]{1,6})\.([0-9]{1,6})(?:\.([0-9]{1,6}))?",
        str(header.get("Firmware revision", "")),
    )
    return tuple(int(x or 0) for x in found.groups()) if found else None


def hex_float(text: str | None) -> float | None:
    """A header number: plain, or the bits of a 32-bit float as 0x3f800000 (= 1.0); None if neither or not finite."""
    try:
        if text is None:
            return None
        if text.lower().startswith("0x"):
            number = struct.unpack(">f", int(text, 16).to_bytes(4, "big"))[0]
        else:
            number = float(text)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def plain_header(header: Mapping[str, str]) -> dict[str, Any]:
    """The header as plain data: numbers and lists of numbers where the text is such, without the frame definitions."""

    def plain(text: str) -> Any:
        parts = text.split(",")
        if all(re.fullmatch(r"[ \t]*-?[0-9]{1,18}[ \t]*", part) for part in parts):
            values = [int(part) for part in parts]
            return values if len(values) > 1 else values[0]
        return text

    return {name: plain(text) for name, text in header.items() if not name.startswith("Field ")}
