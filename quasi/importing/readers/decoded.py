"""Blackbox logs that were decoded to CSV before: by blackbox_decode, or exported from the Blackbox Viewer.

blackbox_decode writes one line of names with units in brackets, and between the samples lines of text (slow frames,
events, notices). The viewer writes the log's header as name-value lines first, and raw numbers. INDIflight's CSV has
the viewer's shape. The line of names shows where the samples begin, and what separates cells: both programs write
commas and decimal points, of which a spreadsheet may have made semicolons or tabs and decimal commas.
"""

import csv
import io
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from quasi.attitude import GRAVITY, from_euler
from quasi.errors import ReadError, add_caution, quoted
from quasi.importing.readers.blackbox import gaps_note, time_gaps
from quasi.importing.readers.blackbox_header import hex_float, plain_header, standard_name
from quasi.importing.readers.blackbox_units import DEG, WANTED, debug_mode, other_firmware_note, resolve
from quasi.importing.readers.external import external_series
from quasi.importing.readers.table_text import (
    SEPARATORS,
    decimal_points,
    from_header,
    refuse_rounded_stamps,
    through_a_spreadsheet,
)
from quasi.importing.series import Recording, Series
from quasi.importing.streams import unwrapped
from quasi.project.recognition import refuse_other_formats
from quasi.tables import read_table_text, read_unpacked

STANDARD_GRAVITY = 9.80665  # what blackbox_decode multiplies g with
_ATTITUDE = ("roll", "pitch", "heading", "heading[0]", "heading[1]", "heading[2]")
MOST_BACK = 0.2  # share of rows that may step back in time
_DECIMALS = ("s", "V", "A", "g", "m/s/s", "m/s2", "rad/s")  # units in which the decoders print decimals
_HEADER_LINES = 2000
# factor to SI by quantity and the unit in brackets
_UNITS = {
    ("gyro", "rad/s"): 1.0,
    ("gyro", "deg/s"): DEG,
    # one g on board is the place's own, here as everywhere GRAVITY
    ("accelerometer", "m/s/s"): GRAVITY / STANDARD_GRAVITY,
    ("accelerometer", "m/s2"): GRAVITY / STANDARD_GRAVITY,
    ("accelerometer", "g"): GRAVITY,
    ("battery voltage", "V"): 1.0,
    ("battery voltage", "mV"): 1e-3,
    ("battery current", "A"): 1.0,
    ("battery current", "mA"): 1e-3,
    ("rotor speed", "rpm"): 2.0 * math.pi / 60.0,
    ("rotor speed", "rad/s"): 1.0,
}
_QUANTITY_OF = {
    "gyroADC[0]": "gyro",
    "gyroADCafterRpm[0]": "gyro",
    "accSmooth[0]": "accelerometer",
    "accADCafterRpm[0]": "accelerometer",
    "vbatLatest": "battery voltage",
    "amperageLatest": "battery current",
    "eRPM[0]": "rotor speed",
}
_HEADER_NAMES = (
    "gyro_scale",
    "acc_1G",
    "motorOutput",
    "minthrottle",
    "maxthrottle",
    "motor_poles",
    "vbatcellvoltage",
    "features",
    "debug_mode",
    "blackbox_high_resolution",
    "Firmware revision",
)


def read_decoded(
    path: str | Path, poles: int | None = None, header: Mapping[str, str] | None = None, counts: float | None = None
) -> Recording:
    """Read a decoded blackbox CSV as the series "onboard".

    poles   number of motor magnets from the quadrotor configuration, or None
    header  {name: text} of the binary log's header where the CSV has none; takes priority over the CSV's own
    counts  raw accelerometer units per g from the quadrotor configuration, for a CSV that does not say

    Quantities as `read_blackbox`, and qw qx qy qz where the file holds roll, pitch and heading (blackbox_decode with
    --simulate-imu, the viewer's heading[0..2]). Time is the controller's own clock, s. Raises ReadError.
    """
    path = str(path)
    refuse_other_formats(path, read_unpacked(path), (), "a decoded blackbox log (CSV)")
    lines = from_header(read_table_text(path))[0].splitlines()
    at, separator, names, units = _names(lines, path)
    found = _header(lines[:at], separator)
    found.update(header or {})
    notes: list[str] = []
    columns, rows = _samples(lines[at + 1 :], separator, names, units, path, notes)
    t, keep = _time(columns.pop("time"), units.get("time", ""), path, notes)
    raw = {name: values[keep] for name, values in columns.items()}
    angles = {name: raw.pop(name) for name in _ATTITUDE if name in raw}
    if other := other_firmware_note(found):
        add_caution(notes, other)
    _use_debug(raw, found, notes)
    known = _known(raw, units, path, notes)
    if counts and "accelerometer" not in known and hex_float(found.get("acc_1G")) is None:
        known["accelerometer"] = GRAVITY / counts, "configuration"
    resolved = resolve(raw, found, poles, known)
    if angles and "divided by 10" in str(resolved.about["units"].get("gyro", {}).get("source")):
        notes.append("the decoder's attitude was left out: it was integrated from body rates ten times too large")
    else:
        _attitude(angles, resolved.values, resolved.about)
    gaps = time_gaps(t, [], np.zeros(0))
    if gaps:
        notes.append(gaps_note(gaps))
    metadata: dict[str, Any] = {
        "reader": "decoded blackbox",
        "path": path,
        "format": "viewer export" if at > 0 else "blackbox_decode",
        "firmware": {"revision": found.get("Firmware revision", "")},
        "header": plain_header(found),
        "fields": names,
        "frames": rows,
        "start": float(t[0]),
        "duration": float(t[-1] - t[0]),
        "rate": float(1.0 / np.median(np.diff(t))) if len(t) > 1 else None,
        "corrupt spans": [],
        "time gaps": gaps,
        **resolved.about,
    }
    series = {"onboard": Series(t, resolved.values)} | external_series(t, resolved.external, metadata, notes)
    return Recording(series, metadata, [*notes, *resolved.notes])


def _cells(line: str, separator: str) -> list[str]:
    try:
        rows = csv.reader([line.replace("\0", "")], delimiter=separator, skipinitialspace=True)
        return [cell.strip() for cell in next(rows, [])]
    except csv.Error:
        return []


def _names(lines: list[str], path: str) -> tuple[int, str, list[str], dict[str, str]]:
    """(line index, separator, column names without units, {name: unit}) of the line that names the columns."""
    for at, line in enumerate(lines[:_HEADER_LINES]):
        for separator in SEPARATORS if "time" in line else ():
            names, units = [], {}
            for cell in _cells(line, separator):
                parts = re.fullmatch(r"(.*?)\s*\(([^()]*)\)", cell)
                names.append(standard_name(parts.group(1) if parts else cell))
                if parts:
                    units[names[-1]] = parts.group(2)
            if "time" in names and (len(WANTED.intersection(names)) >= 3):
                return at, separator, names, units
    raise ReadError(
        f"{path} is no decoded blackbox log: expected a line of column names with 'time' and 'gyroADC[0]' within its "
        f"first {_HEADER_LINES} lines; give the CSV of blackbox_decode or of the Blackbox Viewer, or the .bbl file; "
        "another table needs a quadrotor's JSON with 'table columns' (docs/log-formats.md)"
    )


def _header(lines: list[str], separator: str) -> dict[str, str]:
    """The viewer's name-value lines, under the names of the binary log's header where its spelling differs."""
    plain = {re.sub(r"[^a-z0-9]", "", name.lower()): name for name in _HEADER_NAMES}
    header: dict[str, str] = {}
    for line in lines:
        name, *values = _cells(line, separator) or [""]
        # a number with a decimal comma is no list; one of fewer digits was rounded and is no scale
        values = [re.sub(r"^([0-9]),([0-9]{4,}[eE][+-]?[0-9]+)$", r"\1.\2", value) for value in values]
        if name and values:
            key = plain.get(re.sub(r"[^a-z0-9]", "", name.lower()), name)
            # a spreadsheet fills every line up to the longest
            header.setdefault(key, ",".join(values).rstrip(",").strip("[]"))
    return header


def _samples(
    lines: list[str], separator: str, names: list[str], units: dict[str, str], path: str, notes: list[str]
) -> tuple[dict, dict[str, int]]:
    """{name: (n,) float} of the columns of use, and how many lines were samples, text and damaged."""
    kept = [line for line in lines if line.lstrip(' "')[:1].isdigit()]
    text = sum(1 for line in lines if line.strip()) - len(kept)
    if not kept:
        raise ReadError(f"{path} names columns but holds no samples; decode the log again")
    spread = separator != ","
    if quoted := any('"' in line for line in kept):
        # a cell in quotes may hold the separator; by lines, for a quote that nothing closes would swallow the next ones
        kept = ["\t".join(cell.replace("\t", " ") for cell in _cells(line, separator)) for line in kept]
        separator = "\t"
    wanted = [i for i, name in enumerate(names) if (name in WANTED or name in _ATTITUDE or name == "time")]
    # a name that stands twice: the first counts
    wanted = [i for i in wanted if names.index(names[i]) == i]
    width = max(len(names), max(line.count(separator) for line in kept) + 1)
    if width > 10000:
        raise ReadError(f"{path} has a line of {width} cells, expected {len(names)}; decode the log again")
    as_written = spread or quoted
    # a first line of empty cells states the width, for lines may be shorter or longer than the names
    frame = pd.read_csv(
        io.StringIO("\n".join([separator * (width - 1), *kept])),
        sep=separator,
        header=None,
        names=range(width),
        usecols=wanted,
        dtype=str if as_written else {names.index("time"): str},
        skipinitialspace=True,
        quoting=csv.QUOTE_NONE,
        skip_blank_lines=False,
        low_memory=False,
    ).iloc[1:]
    frame.columns = [names[i] for i in wanted]
    if as_written:
        turned, marked = decimal_points(frame, path)
        fine = [name for name in frame if units.get(name) in _DECIMALS]
        if spread and fine and not marked.intersection(fine):
            raise ReadError(
                f"{path}: column '{fine[0]}' is in {units[fine[0]]} but has no decimals, nor has any other; a "
                "spreadsheet took their points for thousands separators: give the file as it was decoded"
            )
        spread = spread or bool(turned)
        if spread:
            add_caution(notes, through_a_spreadsheet(path, bool(turned), "as it was decoded"))
    refuse_rounded_stamps(frame["time"], "time", path, spread)
    columns, strange = {}, 0
    for name, column in frame.items():
        numbers = column if column.dtype.kind in "iuf" else pd.to_numeric(column, errors="coerce")
        values = numbers.to_numpy(float, copy=True)
        values[~(np.abs(values) < 1e15)] = np.nan
        strange += int((np.isnan(values) & column.notna().to_numpy()).sum())
        if name == "time" or not np.isnan(values).all():
            columns[name] = values
    if strange:
        notes.append(f"{strange} cells hold text or absurd numbers; they count as missing")
    return columns, {"samples": len(kept), "text lines": text}


def _time(values: np.ndarray, unit: str, path: str, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Time in s, strictly increasing, and which rows it belongs to."""
    factors = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "": 1e-6}
    if unit not in factors:
        raise ReadError(f"{path}: column 'time' has the unit {quoted(unit)}, expected s, ms or us")
    values, turns = unwrapped(values)
    if turns:
        notes.append(f"column 'time' starts again from 0 {turns} times as a counter of 32 bits does; it was carried on")
    good = np.isfinite(values) & (np.abs(values) < 1e15)
    highest = np.append(-np.inf, np.maximum.accumulate(np.where(good, values, -np.inf))[:-1])
    repeated = good & (values == highest)
    good &= values > highest
    if not good.any():
        raise ReadError(f"{path} holds no row with a time; decode the log again")
    if repeated.any():
        notes.append(f"{int(repeated.sum())} rows repeat the time of the row before; they were dropped")
    back = ~good & ~repeated
    if np.count_nonzero(back) > MOST_BACK * good.size:
        first = int(np.flatnonzero(back)[0])
        raise ReadError(
            f"{path}: {100 * np.mean(back):.0f} % of the rows have no time or step back in time, the first is "
            f"sample {first + 1}; its clock starts again, or one time is damaged: split or correct the file"
        )
    if back.any():
        notes.append(f"{int(back.sum())} rows have no time or step back in time; they were dropped")
    t = values[good]
    factor = factors[unit]
    if not unit and len(t) > 1 and np.median(np.diff(t)) < 1.0:
        notes.append("column 'time' carries no unit and steps by less than 1; it is taken as s, not us")
        factor = 1.0
    return t * factor, good


def _known(raw: dict, units: dict[str, str], path: str, notes: list[str]) -> dict[str, tuple[float, str]]:
    """Factors of the columns that carry their unit in brackets."""
    known = {}
    for name, quantity in _QUANTITY_OF.items():
        unit = units.get(name, "raw")
        if name not in raw or unit == "raw":
            continue
        if (quantity, unit) not in _UNITS:
            expected = ", ".join(f"({u})" for q, u in _UNITS if q == quantity)
            raise ReadError(f"{path}: column '{name}' has the unit {quoted(f'({unit})')}, expected {expected} or none")
        known[quantity] = (_UNITS[quantity, unit], f"column unit {unit}")
    voltage = raw.get("vbatLatest")
    if voltage is not None and units.get("vbatLatest") == "V":
        # blackbox_decode before July 2025 printed hundredths of a volt as tenths: one decimal, ten times too much
        tenths = voltage[np.isfinite(voltage)] * 10
        if len(tenths) and np.median(tenths) > 300 and np.allclose(tenths, np.round(tenths), atol=1e-6):
            known["battery voltage"] = (0.1, "column unit V, ten times too large as older blackbox_decode prints it")
            notes.append("the battery voltage was divided by 10 (older blackbox_decode prints it ten times too large)")
    return known


def _use_debug(raw: dict, header: dict[str, str], notes: list[str]) -> None:
    """Keep the debug columns only where they hold rotor speeds: by the header, else by how they follow the motors."""
    mode = debug_mode(header)
    debug = [raw.get(f"debug[{i}]") for i in range(4)]
    motor = [raw.get(f"motor[{i}]") for i in range(4)]
    if "eRPM[0]" not in raw and mode is None and all(x is not None for x in [*debug, *motor]):
        every = max(1, len(debug[0]) // 5000)
        speeds, commands = np.concatenate([x[::every] for x in debug]), np.concatenate([x[::every] for x in motor])
        good = np.isfinite(speeds) & np.isfinite(commands)
        speeds, commands = speeds[good], commands[good]
        if len(speeds) > 10 and np.min(speeds) >= 0 and np.ptp(speeds) > 0 and np.ptp(commands) > 0:
            follow = float(np.corrcoef(speeds, commands)[0, 1])
            if np.median(speeds) > 20 and follow > 0.4:
                # 45 is DSHOT_RPM_TELEMETRY for firmware without a stated version
                header["debug_mode"] = "45"
                add_caution(
                    notes,
                    "warning: the CSV does not say what its debug columns hold; they follow the motor commands "
                    f"(correlation {follow:.2f}) and are taken as eRPM/100",
                )
    mode = debug_mode(header)
    if mode is None or mode["name"] != "DSHOT_RPM_TELEMETRY":
        for i in range(4):
            raw.pop(f"debug[{i}]", None)


def _attitude(angles: dict[str, np.ndarray], values: dict[str, np.ndarray], about: dict[str, Any]) -> None:
    """Quaternion of the decoder's own attitude estimate: roll as decoded, pitch negated, yaw the heading as decoded."""
    if "qw" in values:
        return
    for names, factor in ((("roll", "pitch", "heading"), DEG), (("heading[0]", "heading[1]", "heading[2]"), 1.0)):
        if all(name in angles for name in names):
            roll, pitch, yaw = (angles[name] * factor for name in names)
            q = from_euler(roll, -pitch, yaw)
            values.update(zip(("qw", "qx", "qy", "qz"), q.T.copy()))
            about["attitude"] = "estimated by the decoder: " + ", ".join(names)
            return
