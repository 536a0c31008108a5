"""Any table (CSV or Parquet) as a recording, by the section "table columns" of the quadrotor configuration.

Each source of the table keeps its own samples: rows that only repeat a stamp are dropped, stamps that step back too,
and sources on different clocks are brought onto the clock of the gyro's source, first by the rows they share, then by
the motion that both saw.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from quasi.airframe import DEFAULT_POLES
from quasi.errors import ReadError, add_caution
from quasi.importing.clocks.table_clocks import correct_source_lags, rows_possibly_at_rest
from quasi.importing.contradictions import doubtful_units, doubtful_values
from quasi.importing.readers.arrays import read_arrays
from quasi.importing.readers.mapped_source import (
    LEAST_ROWS,
    MappedSource,
    missing_column,
    sampled_apart,
    times_of_column,
)
from quasi.importing.readers.reader import TEXT, Reader, Request
from quasi.importing.readers.signals import Signals
from quasi.importing.readers.table_mapping import EULER_ANGLES, QUATERNION, VECTOR_COLUMNS, TableMapping, read_mapping
from quasi.importing.readers.table_text import open_table
from quasi.importing.series import Recording, Series
from quasi.project.recognition import HEAD_SIZE, recognise
from quasi.tables import read_head

LONGEST_STEP = 0.12  # s between body rates, beyond any motion's; seconds in place of milliseconds exceed it up to 8 kHz
ARRAYS = ("mat5", "npz")  # kinds of files whose variables are columns


def read_table_log(path: str | Path, mapping: Mapping[str, Any], poles: int | None = None) -> Recording:
    """Read a table by a mapping (see `table_mapping`).

    path     CSV or Parquet file; mapping  the section "table columns"; poles  magnets of a motor, for electrical speeds
    Returns  Recording: "onboard" (the source of p q r), "onboard <name>" for further sources, "capture"; SI, earth NED,
             body FRD; t in s from the first sample of the main source, on its clock
    Raises   ConfigError for a wrong mapping, ReadError for a table that lacks a column or cannot be read
    """
    path = Path(path)
    notes: list[str] = []
    plan = read_mapping(mapping, poles or DEFAULT_POLES, "table columns")
    signals = open_signals(path, plan, notes)
    electrical = "eRPM" in str(mapping)
    return read_signals(path, signals, plan, poles, electrical, notes)


def open_signals(path: Path, plan: TableMapping, notes: list[str]) -> Signals:
    """The columns of a CSV, Parquet, MAT or npz file. Raises ReadError where it is none, or too short."""
    found = recognise(read_head(path, HEAD_SIZE))
    if found is not None and found.kind in ARRAYS:
        return read_arrays(path, notes)
    table = open_table(path, notes, plan.names, plan.clocks)
    if len(table) < LEAST_ROWS:
        raise ReadError(
            f"{path} holds {len(table)} rows; at least {LEAST_ROWS} are needed, record or export the flight again"
        )
    return Signals({"": table})


def read_signals(
    path: Path,
    signals: Signals,
    plan: TableMapping,
    poles: int | None,
    electrical: bool,
    notes: list[str],
    known: Sequence[str] = (),
    gyro_late: float = 0.0,
) -> Recording:
    """Bring the columns of a log to standard quantities, units and axes, and its sources to one clock.

    plan        which columns are which quantities
    poles       magnets of a motor, or None where the configuration does not say
    electrical  whether a rotor speed is an electrical one
    known       further columns of the log, for messages
    gyro_late   s by which filters on board delay the gyro, which import takes off later
    Returns and raises as `read_table_log`.
    """
    known = known or signals.columns
    sources = [one for source in plan.sources for one in sampled_apart(source, signals, known, path)]
    raw = [MappedSource(source, signals, known, path, notes) for source in sources]
    main = _main_source(raw, path)
    rows = _row_times(signals, plan, raw, path, notes)
    about: dict[str, Any] = {}
    at_rest = {group: rows_possibly_at_rest([r for r in raw if r.group == group]) for group in signals.frames}
    for r in raw:
        r.settle(rows.get(r.group), at_rest[r.group], path, notes)
    for r in raw:
        about[r.source.name] = r.clock_against(main, path, notes)
    zero, step = float(main.t[0]), float(np.median(np.diff(main.t)))
    if step > LONGEST_STEP:
        raise ReadError(
            f"{path}: source '{main.source.name}' has a sample every {step:.3g} s if its time is in the unit that "
            "'table columns' says, too few for body rates; correct the unit, or log faster"
        )
    for r in raw:
        r.t = r.t - zero
        r.drop_strays(path, notes)
    for r in raw:
        r.to_standard_axes()
        about[r.source.name]["spikes removed"] = r.remove_spikes(path, notes)
    correct_source_lags(raw, main, about, path, notes, gyro_late)
    for r in raw:
        r.world_to_body(raw, path)
    felt = next((r for r in raw if "ax" in r.values and not r.source.capture), None)
    force = np.zeros((0, 3)) if felt is None else felt.matrix(VECTOR_COLUMNS["force"])
    turning = main.matrix(VECTOR_COLUMNS["rates"]) if "p" in main.values else np.zeros((0, 3))
    notes += [f"{path}: {end} in 'table columns'" for end in doubtful_units(turning, force)]
    for end in doubtful_values({n: v for r in raw for n, v in r.values.items()}):
        add_caution(notes, f"{path}: {end} in 'table columns'")
    series: dict[str, Series] = {}
    for r in raw:
        key = "onboard" if r is main else "capture" if r.source.capture else f"onboard {r.source.name}"
        series[key] = Series(r.t, r.values)
        about[r.source.name] |= {"samples": len(r.t), "median interval": float(np.median(np.diff(r.t)))}
    metadata = {
        "file": str(path), "format": "table", "rows": sum(len(frame) for frame in signals.frames.values()),
        "sources": about, "mapped": True, "motor poles": _poles_used(raw, poles, electrical, path, notes),
    }  # fmt: skip
    return Recording(series, metadata, notes)


def _row_times(
    signals: Signals, plan: TableMapping, raw: list["MappedSource"], path: Path, notes: list[str]
) -> dict[str, np.ndarray]:
    """{group: (n,) s} of each row, by the log's clock or by the table's column of time."""
    if signals.clocks:
        return signals.clocks
    group = None if plan.clock is None else signals.group_of(plan.clock[0])
    if group is None:
        if any(r.source.clock is None for r in raw):
            raise missing_column(path, [plan.clock[0]], "time of the rows", signals.columns)
        return {}
    times = times_of_column(signals.frames[group], plan.clock, path, notes)
    # variables of a MAT or npz file with as many samples as the clock share it
    return {name: times for name, frame in signals.frames.items() if len(frame) == len(times)}


def _main_source(raw: "list[MappedSource]", path: Path) -> "MappedSource":
    """The source whose clock is the flight's: that of the gyro, else of the attitude, else the first on board.

    Raises ReadError where nothing turns.
    """
    logged = [r for r in raw if not r.source.capture]
    for names in (VECTOR_COLUMNS["rates"], QUATERNION, EULER_ANGLES):
        for r in logged:
            if any(n in r.values for n in names):
                return r
    if logged and any("qw" in r.values for r in raw):
        return logged[0]
    raise ReadError(f"{path} holds neither body rates nor an attitude in the columns that are mapped; log one of them")


def _poles_used(
    raw: list["MappedSource"], poles: int | None, electrical: bool, path: Path, notes: list[str]
) -> dict[str, Any]:
    """Magnets of a motor that converted electrical to mechanical speeds, and where the number comes from."""
    if poles is not None:
        return {"value": poles, "source": "configuration"}
    if not electrical or not any("w1" in r.values for r in raw):
        return {"value": None, "source": "not needed, the log holds mechanical speeds"}
    notes.append(
        f"{path}: electrical rotor speeds were converted with {DEFAULT_POLES} poles, the default; set 'motor poles'"
    )
    return {"value": DEFAULT_POLES, "source": "default"}


def _read(request: Request) -> Recording:
    mapping = request.quadrotor.get("table columns")
    if not isinstance(mapping, Mapping):
        raise ReadError(
            f"{request.path}: the flight controller is 'table', but the quadrotor configuration has no section "
            "'table columns'; add it, so that each column gets a meaning"
        )
    return read_table_log(request.path, mapping, request.poles)


READER = Reader("a table (CSV, Parquet, MAT or npz)", (TEXT, "gzip", "parquet", "motive", *ARRAYS), _read, ("table",))
