"""Wind of a tunnel: the recorded speed (LabVIEW .lvm) tied to the flight by the time of day, or one steady number.

The tunnel blows along the earth frame's x axis: a wind speed of V means air that moves towards +x with V over ground,
unless the logbook turns it (0 towards +x, 90 towards +y, 180 towards -x). Velocity through the air is velocity over
ground minus that of the air.

The wind record counts from a time of day, the capture from another, on another computer's clock that is `time offset`
ahead: capture start - time offset + capture time = record start + record time.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from quasi.attitude import from_euler, rotate_inverse
from quasi.errors import DataError, ReadError
from quasi.importing.readers.day_time import SECONDS_PER_DAY, DayTime, clock, read_day_time
from quasi.importing.resampling import covered, resample
from quasi.importing.series import Recording, Series
from quasi.project.recognition import refuse_other_formats
from quasi.tables import read_bytes, read_table_text

FASTEST = 100.0  # m/s, beyond any tunnel that a quadrotor flies in
LONGEST_GAP = 1.0  # s without a wind sample that is still bridged
LEAST_OVERLAP = 1.0  # s
USUAL_LINE = 11  # of the start time, where no line is called Time


def read_lvm(path: str | Path) -> Recording:
    """Read a LabVIEW measurement file of two columns, time and wind speed, as the series "wind".

    Returns  Recording: t in s from the start of the record, "speed" m/s; metadata "start" holds the seconds of the day
             that the header's start time can mean
    Raises   ReadError when it has no start time or no samples
    """
    path = Path(path)
    refuse_other_formats(path, read_bytes(path), (), "a LabVIEW record of the wind (.lvm, text)")
    lines = read_table_text(path).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    comma = any(re.match(r"decimal_separator[\t;, ]+,\s*$", line.lower()) for line in lines[:60])
    start = _start(lines[:60])
    notes: list[str] = []
    t, speed = _samples(lines, r"[\t;]" if comma else r"[\t;,]", comma, path, notes)
    if start is None:
        raise ReadError(
            f"{path} holds no start time of day: expected 'Time,HH:MM:SS' in its header (line {USUAL_LINE}); save the "
            "measurement with its header"
        )
    metadata = {
        "reader": "LabVIEW measurement",
        "path": str(path),
        # LabVIEW counts to 24 hours unless a word says otherwise
        "start": list(start.seconds if any(map(str.isalpha, start.text)) else start.seconds[:1]),
        "start as written": start.text,
        "samples": len(t),
        "duration": float(t[-1] - t[0]),
        "speed": {"mean": float(np.mean(speed)), "min": float(speed.min()), "max": float(speed.max()), "unit": "m/s"},
    }
    return Recording({"wind": Series(t, {"speed": speed})}, metadata, notes)


def _start(lines: list[str]) -> DayTime | None:
    """The second field of the line called Time, else of the usual line."""
    for line in lines:
        name, _, rest = re.sub(r"[\t;]", ",", line).partition(",")
        if name.strip().lower() == "time" and (found := read_day_time(rest)) is not None:
            return found
        if line.strip().startswith("***End_of_Header***"):
            break
    if len(lines) >= USUAL_LINE:
        return read_day_time(re.sub(r"[\t;]", ",", lines[USUAL_LINE - 1]).partition(",")[2])
    return None


def _samples(lines: list[str], separator: str, comma: bool, path: Path, notes: list[str]) -> tuple:
    """Times and speeds of the lines that begin with two numbers; what else stands between them is counted."""
    number = re.compile(r"\s*[-+.,]?\d")
    rows = [re.split(separator, line, maxsplit=2)[:2] for line in lines if number.match(line)]
    rows = [row for row in rows if len(row) == 2]
    table = pd.DataFrame(rows, columns=["t", "speed"], dtype=str)
    if comma:
        table = table.apply(lambda column: column.str.replace(",", ".", regex=False))
    values = table.apply(lambda column: pd.to_numeric(column, errors="coerce")).to_numpy(float).reshape(-1, 2)
    fine = np.isfinite(values).all(axis=1) & (np.abs(values[:, 1]) < FASTEST) & (np.abs(values[:, 0]) < 1e9)
    strange = int(np.count_nonzero(~fine))
    values = values[fine]
    ahead = np.append(True, values[1:, 0] > np.maximum.accumulate(values[:, 0])[:-1]) if len(values) else fine[:0]
    if np.count_nonzero(ahead) < 2:
        raise ReadError(
            f"{path} holds fewer than two samples of time and wind speed (m/s, two columns) in order; save it anew"
        )
    if strange:
        notes.append(f"{path}: {strange} lines hold no time and wind speed below {FASTEST:g} m/s; they were left out")
    if not ahead.all():
        notes.append(f"{path}: {np.count_nonzero(~ahead)} samples step back in time; they were left out")
    t, speed = values[ahead].T
    if np.median(np.abs(speed)) > 45.0:
        notes.append(f"{path}: the wind is typically {np.median(speed):.0f} m/s; check that the file holds m/s")
    return t, speed


def add_wind(
    frame: pd.DataFrame, wind: Mapping[str, Any], capture: Recording | None, tau: np.ndarray | None, where: str,
    notes: list[str],
) -> tuple[pd.DataFrame, dict[str, Any]]:  # fmt: skip
    """The flight with wind_north wind_east wind_down (m/s, velocity of the air) and u_air v_air w_air where u v w are.

    frame    an imported flight; wind  {"file", "file problem", "static" m/s, "time offset" s, "towards" deg}
    capture  the Motive file as read, for its start time, and tau (m,) the capture's time, s, of each row; or None
    Returns  the new frame, and what the wind was taken from. Rows that the wind record does not cover hold NaN, or the
             static wind where that is given
    Raises   ReadError, DataError when there is neither a usable record nor a static wind, or times do not match
    """
    static = wind.get("static")
    about: dict[str, Any] = {
        "towards": {"value": float(wind.get("towards") or 0.0), "unit": "deg", "from": "+x towards +y"},
        "static": {"value": static, "unit": "m/s"},
    }
    speed, problem = None, wind.get("file problem")
    if wind.get("file"):
        try:
            record = read_lvm(wind["file"])
        except ReadError as error:
            problem = str(error)
        else:
            about |= {"source": "record", "record": record.metadata}
            notes += record.notes
            if capture is None or tau is None:
                problem = (
                    f"{where}: the wind record can be tied to the flight only by the start time of a motion capture, "
                    "and there is none"
                )
            else:
                speed = _at(record, wind, capture, tau, about, where)
    if speed is None and static is None:
        raise DataError(f"{problem or where + ': no wind is given'}; or give 'Static wind (m/s)' in the logbook")
    if speed is None:
        about["source"] = "static"
        speed = np.full(len(frame), float(static))
        if problem:
            notes.append(f"{where}: the static wind of {static:g} m/s is used, for {problem}")
    elif not np.isfinite(speed).any():
        raise DataError(f"{where}: the wind record has no sample during the flight; correct 'OJF name' in the logbook")
    elif not np.isfinite(speed).all():
        unknown = ~np.isfinite(speed)
        share = f"{100 * unknown.mean():.1f} % of the flight"
        if static is None:
            notes.append(f"{where}: the wind record does not cover {share}; the wind is unknown there")
        else:
            notes.append(f"{where}: the wind record does not cover {share}; the static {static:g} m/s is used there")
            speed = np.where(unknown, float(static), speed)
    turn = math.radians(about["towards"]["value"])
    air = np.stack([speed * math.cos(turn), speed * math.sin(turn), 0.0 * speed], axis=-1)
    columns = dict(zip(("wind_north", "wind_east", "wind_down"), air.T))
    if {"u", "v", "w"} <= set(frame):
        turned = from_euler(*frame[["roll", "pitch", "yaw"]].to_numpy(float).T)
        through = frame[["u", "v", "w"]].to_numpy(float) - rotate_inverse(turned, air)
        columns |= dict(zip(("u_air", "v_air", "w_air"), through.T))
    known = speed[np.isfinite(speed)]
    about["speed"] = {"mean": float(known.mean()), "std": float(known.std()), "unit": "m/s"}
    return frame.assign(**columns), about


def _at(
    record: Recording, wind: Mapping[str, Any], capture: Recording, tau: np.ndarray, about: dict[str, Any], where: str
) -> np.ndarray:
    """Recorded wind speed (m,) at the capture's times tau (m,); NaN where the record has none."""
    series = record.series["wind"]
    written = str(capture.metadata.get("capture start", ""))
    began = read_day_time(written)
    if began is None:
        raise DataError(
            f"{where}: the capture's start time is {written!r}, expected a date and time of day; export it from Motive "
            "with header information, or leave 'OJF name' empty and give 'Static wind (m/s)'"
        )
    offset = float(wind.get("time offset") or 0.0)
    fits = []
    for first in began.seconds:
        for second in record.metadata["start"]:
            # the two times of day may stand on either side of midnight
            for day in (0.0, SECONDS_PER_DAY, -SECONDS_PER_DAY):
                shift = first - offset - second + day
                shared = min(tau[-1] + shift, series.t[-1]) - max(tau[0] + shift, series.t[0])
                if shared >= LEAST_OVERLAP:
                    fits.append((shift, first))
    lasts = float(series.t[-1])
    if not fits:
        began_at = " or ".join(clock(s - offset) for s in began.seconds)
        covers = " or ".join(f"{clock(s + series.t[0])} to {clock(s + lasts)}" for s in record.metadata["start"])
        raise DataError(
            f"{where}: the capture began at {began_at} by the wind record's clock, but the record covers {covers}; "
            "correct 'OptiTrack time offset (s)' or 'OJF name' in the logbook"
        )
    if len({round(shift) for shift, _ in fits}) > 1:
        meant = " or ".join(sorted({clock(first) for _, first in fits}))
        raise DataError(
            f"{where}: the capture's start '{began.text}' may mean {meant}, and the wind record covers both; "
            "write AM or PM behind 'Capture Start Time' in the export"
        )
    shift, first = fits[0]
    about["clock"] = {
        "capture start as written": began.text,
        "capture start": {"value": first, "unit": "s", "since": "midnight"},
        "half of the day": "as written" if len(began.seconds) == 1 else "the one that overlaps the wind record",
        "time offset": {"value": offset, "unit": "s"},
        "capture minus record": {"value": shift, "unit": "s"},
    }
    at = tau + shift
    values = resample(series.t, series.values["speed"][:, None], at, smooth=False).values[:, 0]
    usual = float(np.median(np.diff(series.t)))
    return np.where(covered(series.t, at, max(LONGEST_GAP, 3.1 * usual)), values, np.nan)
