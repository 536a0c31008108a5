"""`quasi decode`: any log or capture that is read, as one table in SI units, or as MCAP.

Every row of the table is a moment at which at least one source was sampled; a quantity without a sample then is empty.
Nothing is interpolated, smoothed or synchronised.
"""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from quasi.airframe import read_poles
from quasi.errors import ConfigError, ReadError
from quasi.importing.first_configuration import recognise_log
from quasi.importing.readers.reader import Request, needs_extra
from quasi.importing.readers.registry import is_capture, read_capture, read_log
from quasi.importing.readers.table_mapping import UNIT
from quasi.importing.series import Recording, Series
from quasi.tables import COLUMNS, write_bytes, write_table, write_text

DECODED_SUFFIXES = (".parquet", ".csv", ".mcap")
QUATERNION_UNITS = {
    name: ("1", "body to earth", f"attitude quaternion, {part}")
    for name, part in zip(("qw", "qx", "qy", "qz"), ("scalar", "x", "y", "z"))
}
TIME_DIGITS = 7  # decimals of a time stamp, s: what is sampled within 0.1 us is sampled at once
NANOSECONDS = 1e9  # ns in a second


def decode_file(
    log: Path,
    out: Path | None = None,
    quadrotor: Mapping[str, Any] | None = None,
    rigid_body: str | None = None,
    log_number: int | None = None,
    controller: str | None = None,
) -> str:
    """Write a log or capture as Parquet, CSV or MCAP; returns a summary.

    out        where to; by default the log's name with .parquet, here
    quadrotor  its configuration; a table without "table columns" is read by a guess
    Raises     ReadError, DataError or ConfigError
    """
    out = Path(f"{log.name.split('.')[0]}.parquet") if out is None else out
    if out.suffix.lower() not in DECODED_SUFFIXES:
        raise ConfigError(
            f"{out} has the extension '{out.suffix}', expected one of {', '.join(DECODED_SUFFIXES)}; correct it"
        )
    if out.exists() and out.resolve() == log.resolve():
        raise ConfigError(f"{out} is the log itself; name another file by -o")
    remarks: list[str] = []
    recording = _read(log, dict(quadrotor or {}), rigid_body, log_number, controller, remarks)
    if not any(len(series.t) for series in recording.series.values()):
        raise ReadError(f"{log} holds no samples; give another log")
    made = {"log": str(log), **recording.metadata}
    if out.suffix.lower() == ".mcap":
        write_bytes(out, _mcap(recording.series, log))
    else:
        table = joined(recording.series)
        units = {name: unit_of(name) for name in table.columns}
        if out.suffix.lower() == ".csv":
            named = table.rename(columns={n: f"{n} ({units[n][0]})" for n in table.columns})
            named.to_csv(text := io.StringIO(), index=False, float_format="%.10g")
            write_text(out, text.getvalue())
        else:
            write_table(out, table, units, made)
    return "\n".join([*_summary(recording, log, out), *(f"  note: {r}" for r in (*remarks, *recording.notes))])


def _read(
    log: Path, quadrotor: dict[str, Any], rigid_body: str | None, log_number: int | None, controller: str | None,
    remarks: list[str],
) -> Recording:  # fmt: skip
    if controller is None and is_capture(log):
        return read_capture(Request(log, rigid_body=rigid_body, remove_outliers=False))
    if controller is None:
        first = recognise_log(log) if "table columns" not in quadrotor else None
        controller = first.controller if first else str(quadrotor.get("flight controller") or "table")
        if first is not None and "table columns" in first.quadrotor:
            quadrotor = {**first.quadrotor, **quadrotor}
            remarks += first.remarks
    return read_log(Request(log, controller, quadrotor, read_poles(quadrotor, str(log)), log_number))


def joined(series: Mapping[str, Series]) -> pd.DataFrame:
    """All quantities over the moments at which any was sampled: column t, s, then one for each; NaN without a sample.

    Columns of a capture that share a name with on-board ones are called "capture_x" and so on, those of a further
    source on board "external_vx" for its source "onboard external".
    """
    frames = []
    seen: set[str] = set()
    for name, one in sorted(series.items(), key=lambda item: item[0] == "capture"):
        of = name.removeprefix("onboard ").replace(" ", "_")
        columns = {f"{of}_{n}" if n in seen else n: v for n, v in one.values.items()}
        seen |= set(columns)
        frames.append(pd.DataFrame({"t": np.round(one.t, TIME_DIGITS), **columns}))
    t = np.unique(np.concatenate([frame["t"].to_numpy() for frame in frames]))
    table = pd.DataFrame({"t": t})
    for frame in frames:
        rows = np.searchsorted(t, frame["t"].to_numpy())
        for name in frame.columns.drop("t"):
            values = np.full(len(t), np.nan) if name not in table else table[name].to_numpy().copy()
            values[rows] = frame[name].to_numpy()
            table[name] = values
    return table


def unit_of(name: str) -> tuple[str, str, str]:
    """(unit, frame, meaning) of a column of `joined`."""
    if name == "t":
        return ("s", "", "time on the log's clock")
    plain = name
    while "_" in plain and not any(plain in known for known in (COLUMNS, QUATERNION_UNITS, UNIT)):
        plain = plain.split("_", 1)[1]  # a source's name stands before it
    return COLUMNS.get(plain) or QUATERNION_UNITS.get(plain) or (UNIT.get(plain, ""), "", "as logged")


def _summary(recording: Recording, log: Path, out: Path) -> list[str]:
    lines = [f"{log}: {recording.metadata.get('format') or recording.metadata.get('reader') or 'log'} -> {out}"]
    for name, one in recording.series.items():
        span = float(one.t[-1] - one.t[0]) if len(one.t) else 0.0
        rate = f", {(len(one.t) - 1) / span:.4g} Hz" if span > 0 else ""
        held = ", ".join(f"{n} ({unit_of(n)[0]})" for n in one.values)
        lines.append(f"  {name}: {len(one.t)} samples over {span:.3f} s{rate}: {held}")
    return lines


def _mcap(series: Mapping[str, Series], log: Path) -> bytes:
    """Each series as a topic of JSON messages with a schema that holds the units."""
    with needs_extra("mcap", log, "to be written as MCAP"):
        from mcap.writer import Writer
    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start(profile="", library="quasi")
    first = min(float(one.t[0]) for one in series.values() if len(one.t))
    for name, one in series.items():
        if not one.values:  # stamps alone: a message would say nothing
            continue
        fields = {n: {"type": "number", "description": " ".join(filter(None, unit_of(n)[:2]))} for n in one.values}
        schema = writer.register_schema(
            name=f"quasi.{name}".replace(" ", "_"),
            encoding="jsonschema",
            data=json.dumps({"type": "object", "properties": fields}).encode(),
        )
        topic = "/" + name.replace(" (", "/").replace(")", "").replace(" ", "_").replace(",", "")
        channel = writer.register_channel(topic=topic, message_encoding="json", schema_id=schema)
        stacked = np.stack(list(one.values.values()), axis=1)
        for t, row in zip(one.t, stacked):
            stamp = round((float(t) - first) * NANOSECONDS)
            message = {n: float(v) for n, v in zip(one.values, row) if np.isfinite(v)}
            writer.add_message(
                channel_id=channel, log_time=stamp, publish_time=stamp, data=json.dumps(message).encode()
            )
    writer.finish()
    return buffer.getvalue()
