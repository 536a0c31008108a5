"""Crazyflie micro-SD logs as recordings: variables of the firmware under their standard names become quantities.

A section "table columns" of the quadrotor configuration, where it is given, maps variables by their names instead.
Units and axes of the standard names are the firmware's: body x forward, y left, z up; world z up; angles in degrees;
accelerations in g; pitch with the opposite sign (legacy axes of the Crazyflie 2 family).
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from quasi.airframe import DEFAULT_POLES
from quasi.errors import Caution, ReadError
from quasi.importing.readers.crazyflie_events import EventLog, EventType, decode_events
from quasi.importing.readers.reader import Reader, Request
from quasi.importing.readers.signals import Signals
from quasi.importing.readers.table_mapping import QUATERNION, VECTOR_COLUMNS, read_mapping
from quasi.importing.readers.table_reader import read_signals
from quasi.importing.series import Recording
from quasi.tables import read_bytes

TIME_COLUMN = "time stamp"
ESTIMATE = "stateEstimate"
# quantity: names of which the first that the log holds is taken, each with its unit
STANDARD: dict[str, tuple[tuple[str, str], ...]] = {
    **{n: ((f"gyro.{a}", "deg/s"),) for n, a in zip("pqr", "xyz")},
    **{f"a{a}": ((f"acc.{a}", "g"),) for a in "xyz"},
    **{f"q{a}": ((f"{ESTIMATE}.q{a}", "1"),) for a in "wxyz"},
    **{a: ((f"{ESTIMATE}.{a}", "m"),) for a in "xyz"},
    **{f"v{a}": ((f"{ESTIMATE}.v{a}", "m/s"),) for a in "xyz"},
    **{f"linear_a{a}": ((f"{ESTIMATE}.a{a}", "g"),) for a in "xyz"},
    **{n: ((f"{ESTIMATE}.{n}", "deg"), (f"stabilizer.{n}", "deg")) for n in ("roll", "pitch", "yaw")},
    # the duty that the motor gets, after the battery's compensation; the demand before it where that is not logged
    **{f"command{i}": ((f"pwm.m{i}_pwm", "1/65535"), (f"motor.m{i}", "1/65535")) for i in range(1, 5)},
    "throttle": (("stabilizer.thrust", "1/65535"),),
    "battery_voltage": (("pm.vbatMV", "mV"), ("pm.vbat", "V")),
}
REVERSED_PITCH = (f"{ESTIMATE}.pitch", "stabilizer.pitch")
MIN_RECORDS = 20  # as of a table's rows


def read_crazyflie(path: str | Path, mapping: Mapping[str, Any] | None = None, poles: int | None = None) -> Recording:
    """Read a micro-SD log of the event format, versions 1 and 2.

    mapping  section "table columns" of the configuration, which replaces the standard names; stamps are those of the
             records, whatever its time column; variables of event types other than the one with the most records are
             named `event/group.name`
    Returns  Recording as `table_reader.read_table_log` makes it; metadata: version, checksum, event types
    Raises   ReadError for a file that is no such log or holds too little; ConfigError for a wrong mapping
    """
    path, notes = Path(path), []
    log = decode_events(read_bytes(path), path)
    main = max(log.types.values(), key=lambda event: len(event.chunks))
    if len(main.chunks) < MIN_RECORDS:
        names = ", ".join(f"{len(event.chunks)} of {event.name}" for event in log.types.values())
        raise ReadError(
            f"{path} holds {names} records, expected {MIN_RECORDS} or more of one event type; "
            f"{'; '.join(log.ending) or 'record the flight again'}"
        )
    signals = _signals(log, main)
    if mapping is None:
        mapping = standard_mapping(signals.columns)
        if not mapping["sources"][0]["columns"]:
            raise ReadError(
                f"{path} holds no variable with a standard name (such as stateEstimate.x, gyro.x, motor.m1), but "
                f"{', '.join(main.variables[:8])}; map its variables in 'table columns' of the quadrotor configuration"
            )
    plan = read_mapping(mapping, poles or DEFAULT_POLES, "table columns")
    recording = read_signals(path, signals, plan, poles, "eRPM" in str(mapping), notes)
    recording.metadata.update(
        {
            "reader": "crazyflie micro-SD",
            "version": log.version,
            "checksum": log.checksum,
            "ended": log.checksum != "missing",
            "event types": {event.name: {"records": len(event.chunks)} for event in log.types.values()},
            "variables not mapped": [name for name in signals.columns if f"'{name}'" not in str(mapping)],
            "reversed": [name for name in signals.columns if name.rsplit("/", 1)[-1] in REVERSED_PITCH],
        }
    )
    return Recording(recording.series, recording.metadata, [*map(Caution, log.ending), *recording.notes])


def standard_mapping(names: Collection[str]) -> dict[str, Any]:
    """The section "table columns" for the variables that a log holds.

    Vectors of which a component is missing are left out, angles are mapped one by one.
    """
    columns: dict[str, Any] = {}
    for quantity, candidates in STANDARD.items():
        found = next(((name, unit) for name, unit in candidates if name in names), None)
        if found is not None:
            columns[quantity] = {"column": found[0], "unit": found[1]}
    for group in (*VECTOR_COLUMNS.values(), QUATERNION):
        if not all(name in columns for name in group):
            for name in group:
                columns.pop(name, None)
    source = {"name": "log", "frame": "FLU", "world": "z-up", "columns": columns}
    return {"time": {"column": TIME_COLUMN, "unit": "s"}, "sources": [source]}


def _signals(log: EventLog, main: EventType) -> Signals:
    """Variables of the main type under their names, of others behind the type's name; all stamps are of one clock."""
    frames, clocks = {}, {}
    for event in log.types.values():
        if not event.chunks or not event.variables:
            continue
        clocks[event.name], values = event.columns(log.seconds)
        before = "" if event is main else f"{event.name}/"
        frames[event.name] = pd.DataFrame(
            {f"{before}{name}": -v if name in REVERSED_PITCH else v for name, v in values.items()}
        )
    return Signals(frames, clocks)


def _read(request: Request) -> Recording:
    return read_crazyflie(request.path, request.quadrotor.get("table columns"), request.poles)


READER = Reader("a Crazyflie micro-SD log", ("crazyflie",), _read, ("crazyflie",))
