"""A first "table columns" section for a table of unknown columns, by their names and by the size of their numbers.

A guess is written into a configuration for a person to check, never used behind their back. Names say which quantity a
column is; numbers say its unit and axes: specific force at rest or in hover is 1 g and points up, body rates beyond
35 rad/s are degrees, motor numbers up to 1 are shares and up to 65535 are those of a 16-bit duty.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.importing.command_units import recognise_unit
from quasi.importing.readers.table_text import numbers_of, split_lists

G = 9.80665  # m/s2
LARGEST_RATE = 35.0  # rad/s, full scale of the common gyros (2000 deg/s); the 99 % quantile of a flight lies below
LARGEST_ANGLE = 6.5  # rad; larger angles are in degrees
LARGEST_SPEED = 4000.0  # rad/s of a rotor, four times that of a 5-inch propeller in hover; larger numbers are rpm
DEMANDS = r"set_?point|(^|_)sp_|_sp$|target|ref|cmd|command|desired|goal|integral|cov|std|bias|err"
AXIS_NUMBERS = {
    "x": 0,
    "y": 1,
    "z": 2,
    "0": 0,
    "1": 1,
    "2": 2,
    "roll": 0,
    "pitch": 1,
    "yaw": 2,
    "p": 0,
    "q": 1,
    "r": 2,
    "w": 3,
}
TIME_PATTERN = r"t|time|timestamp|stamp|time_?(stamp)?_?(s|sec|ms|us|ns|min)?|t_?(s|ms|us|ns)|timeus|timestamp_?\w{0,2}"

_A = r"(?P<axis>[xyz]|[012])\]?"
_LAST = rf"_?\[?{_A}"
# quantities, patterns of their columns in order of preference; `axis` is what distinguishes their components
VECTOR_PATTERNS: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    (("p", "q", "r"), (rf".*(gyro|gyr|angular_?vel\w*|omega|body_?rates?).*?{_LAST}", rf"w{_LAST}",
                       r"(.*_)?(?P<axis>[pqr])",
                       r".*(rate|rates)_(?P<axis>roll|pitch|yaw)", r"(?P<axis>roll|pitch|yaw)_?rate")),
    (("ax", "ay", "az"), (rf".*(accel\w*|linear_acc\w*|imu_acc|acc|specific_force)_?{_LAST}", rf"(.*_)?a{_LAST}")),
    (("vx", "vy", "vz"), (rf"v(el)?{_LAST}", rf".*(velocity|linear_vel\w*)_?{_LAST}")),
    (("x", "y", "z"), (rf"p(os)?{_LAST}", r"(?P<axis>[xyz])", rf".*(position|pos)_?{_LAST}")),
)  # fmt: skip
QUATERNIONS = (
    r"q_?(?P<axis>[wxyz])",
    r".*(quat\w*|orientation|attitude|att)_q?(?P<axis>[wxyz])",
    r".*_q(?P<axis>[wxyz])",
)
ANGLE_PATTERNS = (
    r"(?P<axis>roll|pitch|yaw)(_?(deg|rad))?",
    r".*(attitude|att|euler|angle)_?\w*_(?P<axis>roll|pitch|yaw)(_?(deg|rad))?",
)
_ROTOR = r"(motor|rotor|m|w|esc|omega)"
_K = r"(?P<axis>[0-8])\]?"
SPEED_PATTERNS = (
    rf".*?{_ROTOR}_?\[?{_K}_?(erpm|rpm|speed|omega|vel\w*|rad_?s|krpm)",
    rf".*(erpm|rpm|omega|rotor_?speeds?|motor_?speeds?)_?m?\[?{_K}",
    rf"w_?{_K}",
)
SHARE_PATTERNS = (
    rf".*?(motor|m|pwm|esc|out\w*|thr\w*|u|command|cmd)_?m?\[?{_K}(_?(pwm|thrust|cmd|command|out|throttle|duty))?",
)
# sources of a guess: each may have been sampled at a rate of its own, and repeat in the rows between
PARTS = {
    "imu": re.compile(r"[pqr]|a[xyz]"),
    "state": re.compile(r"q[wxyz]|roll|pitch|yaw|v?[xyz]"),
    "motors": re.compile(r"w\d|command\d"),
    "battery": re.compile(r"battery_\w+"),
}
BATTERY = r".*(v_?bat\w*|bat\w*_?(volt\w*|v)|volt(s|age)?)"


@dataclass
class Guess:
    """mapping  a section "table columns", or None without body rates; remarks  sentences on what was assumed."""

    mapping: dict[str, Any] | None
    remarks: list[str] = field(default_factory=list)


def guess_columns(frames: Mapping[str, pd.DataFrame]) -> Guess:
    """A mapping for tables of samples {group: table}; the group with the body rates is looked into first."""
    guess = Guess(None)
    sources: list[dict[str, Any]] = []
    clocks: list[dict[str, str]] = []
    taken: set[str] = set()
    order = sorted(frames, key=lambda g: not _columns(frames[g], VECTOR_PATTERNS[0][1], 3))
    for group in order:
        table = _with_lists(frames[group])
        columns = _quantities(table, guess.remarks, taken)
        taken |= set(columns)
        clock = _clock(table)
        clocks += [clock] if clock else []
        axes = _axes(table, columns)
        for part, quantities in PARTS.items():
            own = {q: entry for q, entry in columns.items() if quantities.fullmatch(q)}
            if own:
                stamped = {"time": clock} if clock and len(order) > 1 else {}
                name = part if all(s["name"] != part for s in sources) else f"{part} of {group}"
                sources.append({"name": name, **axes, **stamped, "columns": own})
    if "p" not in taken:
        guess.remarks.append("no columns of body rates were recognised; write 'table columns' (docs/log-formats.md)")
        return guess
    guess.mapping = ({"time": clocks[0]} if clocks else {}) | {"sources": sources}
    guess.remarks.append("columns, units and axes were guessed from names and numbers: check 'table columns'")
    if not clocks:
        guess.remarks.append("no column of time was recognised; add \"time\" to 'table columns'")
    return guess


def _with_lists(table: pd.DataFrame) -> pd.DataFrame:
    """The table with columns "name[k]" for those whose cells are lists."""
    entries: list[str] = []
    for name in table.columns:
        cell = table[name].dropna().iloc[0] if table[name].notna().any() else None
        listed = isinstance(cell, np.ndarray | list) or (isinstance(cell, str) and len(numbers_of(cell)) > 1)
        if listed and 2 <= len(numbers_of(cell)) <= 16 and re.fullmatch(r"[\[\(\s\d.,;eE+-]*[\]\)]?", str(cell)):
            entries += [f"{name}[{k}]" for k in range(len(numbers_of(cell)))]
    return split_lists(table, entries)


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9\[\]]+", "_", name.lower()).strip("_")


def _columns(table: pd.DataFrame, patterns: tuple[str, ...], count: int) -> list[str] | None:
    """The columns of a vector in the order of its axes, from the first pattern that finds all `count` of them."""
    for pattern in patterns:
        stems: dict[str, dict[int, str]] = {}
        for name in map(str, table.columns):
            plain = _plain(name)
            found = re.fullmatch(pattern, plain)
            if found and not re.search(DEMANDS, plain) and _is_number(table[name]):
                axis = found["axis"]
                place = AXIS_NUMBERS[axis] if axis in AXIS_NUMBERS and count < 5 else int(axis)
                stem = plain[: found.start("axis")] + "*" + plain[found.end("axis") :]
                stems.setdefault(stem, {}).setdefault(place, name)
        for places in stems.values():
            first = min(places)
            wanted = [3, 0, 1, 2] if count == 4 else list(range(first, first + count))
            if all(p in places for p in wanted):
                return [places[p] for p in wanted]
    return None


def _rotor_columns(table: pd.DataFrame, patterns: tuple[str, ...], avoid: str) -> list[str] | None:
    """Columns of rotors 1 to 4, which may be counted from 0."""
    for pattern in patterns:
        stems: dict[str, dict[int, str]] = {}
        for name in map(str, table.columns):
            found = re.fullmatch(pattern, _plain(name))
            if found and not re.search(avoid, _plain(name)) and _is_number(table[name]):
                stem = _plain(name)[: found.start("axis")] + "*" + _plain(name)[found.end("axis") :]
                stems.setdefault(stem, {})[int(found["axis"])] = name
        for places in stems.values():
            first = min(places)
            if first in (0, 1) and all(first + k in places for k in range(4)):
                return [places[first + k] for k in range(4)]
    return None


def _is_number(column: Any) -> bool:
    return isinstance(column, pd.Series) and bool(pd.api.types.is_numeric_dtype(column)) and column.notna().any()


def _quantities(table: pd.DataFrame, remarks: list[str], taken: set[str]) -> dict[str, Any]:
    """{quantity: entry of the mapping} of what a table holds beyond what was taken."""
    columns: dict[str, Any] = {}

    def put(names: tuple[str, ...], found: list[str] | None, unit: str = "") -> None:
        if found and not taken & set(names):
            for quantity, name in zip(names, found):
                columns[quantity] = {"column": name} | ({"unit": unit} if unit else {})

    for names, patterns in VECTOR_PATTERNS:
        found = _columns(table, patterns, 3)
        if found and not set(found) & {c["column"] for c in columns.values()}:
            put(names, found, _unit(names, table[found].to_numpy(float)))
    turn = _columns(table, QUATERNIONS, 4)
    put(("qw", "qx", "qy", "qz"), turn)
    if turn is None and (angles := _columns(table, ANGLE_PATTERNS, 3)):
        put(("roll", "pitch", "yaw"), angles, _unit(("roll",), table[angles].to_numpy(float)))
    speeds = _rotor_columns(table, SPEED_PATTERNS, r"set_?point|target|ref|cmd|command|thrust|pwm")
    if speeds:
        put(tuple(f"w{i}" for i in range(1, 5)), speeds, _speed_unit(speeds, table[speeds].to_numpy(float)))
    outputs = _rotor_columns(table, SHARE_PATTERNS, r"set_?point|target|rpm|speed|temp|curr|volt")
    if outputs and outputs != speeds:
        try:
            put(tuple(f"command{i}" for i in range(1, 5)), outputs, recognise_unit(table[outputs].to_numpy(float), ""))
        except DataError:
            remarks.append(f"the range of the motor outputs {outputs[0]}, ... is of no known unit; they were left out")
    battery = next(
        (str(n) for n in table.columns if re.fullmatch(BATTERY, _plain(str(n))) and _is_number(table[n])), None
    )
    if battery and "battery_voltage" not in taken:
        columns["battery_voltage"] = {
            "column": battery,
            "unit": "mV" if float(table[battery].median()) > 1000 else "V",
            "optional": True,
        }
    return columns


def _unit(names: tuple[str, ...], values: np.ndarray) -> str:
    size = np.abs(values[np.isfinite(values)])
    if names[0] == "p":
        return "deg/s" if np.quantile(size, 0.99) > LARGEST_RATE else "rad/s"
    if names[0] == "ax":
        length = float(np.nanmedian(np.linalg.norm(values, axis=1)))
        return "g" if 0.5 < length < 2.0 else "mg" if 500 < length < 2000 else "m/s2"
    if names[0] == "roll":
        return "deg" if np.max(size) > LARGEST_ANGLE else "rad"
    scale = {"x": ("m", "mm"), "vx": ("m/s", "mm/s")}[names[0]]
    return scale[1] if np.quantile(size, 0.99) > 200 else scale[0]


def _speed_unit(names: list[str], values: np.ndarray) -> str:
    name = _plain(names[0])
    if "erpm" in name:
        return "eRPM" if np.nanmax(values) > 3000 else "eRPM/100"
    return "rpm" if "rpm" in name or np.nanmax(values) > LARGEST_SPEED else "rad/s"


def _axes(table: pd.DataFrame, columns: dict[str, Any]) -> dict[str, Any]:
    """Body and world axes from what points up: specific force in hover, and height."""
    source: dict[str, Any] = {"frame": "FRD", "world": "NED"}
    if "az" in columns:
        up = float(np.nanmedian(table[columns["az"]["column"]].to_numpy(float)))
        source["frame"] = "FLU" if up > 0 else "FRD"
    if "z" in columns:
        height = table[columns["z"]["column"]].to_numpy(float)
        first = height[np.isfinite(height)][0]
        source["world"] = "z-up" if np.nanmean(height) > first else "NED"
    elif source["frame"] == "FLU":
        source["world"] = "z-up"
    return source


def _clock(table: pd.DataFrame) -> dict[str, str] | None:
    """The first column of time, and its unit: its name's, else the one in which the table lasts between 1 s and 5 h."""
    for name in map(str, table.columns):
        plain = _plain(name)
        if not re.fullmatch(TIME_PATTERN, plain) or not _is_number(table[name]):
            continue
        stamps = table[name].dropna().to_numpy(float)
        ahead = np.diff(stamps)
        if len(stamps) < 2 or np.mean(ahead < 0) > 0.2 or not (ahead > 0).any():
            continue
        suffix = re.search(r"_?(ns|us|ms|s|sec|min)$", plain)
        unit = {"sec": "s"}.get(suffix[1], suffix[1]) if suffix and plain != "s" else None
        step = float(np.median(ahead[ahead > 0]))
        # an interval between samples lies between 0.1 ms and 0.3 s
        able = [u for u, scale in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)) if 1e-4 <= step * scale <= 0.3]
        if unit not in able and able:
            unit = able[0]
        return {"column": name, "unit": unit or "s"}
    return None
