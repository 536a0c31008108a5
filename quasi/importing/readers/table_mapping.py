"""The section "table columns" of a quadrotor configuration: which column of a table is which quantity.

    {"time": {"column": "t", "unit": "s"},                       clock of the rows, for sources without their own
     "sources": [
       {"name": "state",                                          free name; one source holds p q r
        "time": {"column": "stamp", "unit": "s"},                 its own clock, if it has one
        "frame": "FLU" | "FRD", "world": "z-up" | "NED",          body and world axes (default FRD, NED)
        "motion capture": false,
        "columns": {"p": "gyro_x",                                the plain column name means: in SI
                    "vx": {"column": ["vx", "vel_x"], "unit": "cm/s", "frame": "world" | "body", "optional": true}}}]}

"z-up" is x forward, y left, z up. Of several names in "column" the first that the table has is taken.
linear_ax, linear_ay, linear_az are the acceleration over ground, gravity removed, in world axes. Of roll, pitch and yaw
some may be absent; body rates may be absent where an attitude is mapped, or a capture with one (see
`quasi.importing.reconstruction`).
"""

from dataclasses import dataclass
from typing import Any

from quasi.errors import ConfigError, nearest
from quasi.importing.command_units import RANGES
from quasi.importing.units import to_si
from quasi.project import configuration

VECTOR_COLUMNS = {
    "rates": ("p", "q", "r"),
    "force": ("ax", "ay", "az"),
    "velocity": ("vx", "vy", "vz"),
    "body velocity": ("u", "v", "w"),
    "position": ("x", "y", "z"),
    "linear acceleration": ("linear_ax", "linear_ay", "linear_az"),
    "setpoint": ("setpoint_p", "setpoint_q", "setpoint_r"),
}
QUATERNION = ("qw", "qx", "qy", "qz")
EULER_ANGLES = ("roll", "pitch", "yaw")
MAPPED_ROTORS = range(1, 9)
UNIT = {
    **dict.fromkeys(VECTOR_COLUMNS["rates"] + VECTOR_COLUMNS["setpoint"], "rad/s"),
    **dict.fromkeys(VECTOR_COLUMNS["force"] + VECTOR_COLUMNS["linear acceleration"], "m/s2"),
    **dict.fromkeys(VECTOR_COLUMNS["velocity"] + VECTOR_COLUMNS["body velocity"], "m/s"),
    **dict.fromkeys(VECTOR_COLUMNS["position"], "m"),
    **dict.fromkeys(QUATERNION, "1"),
    **dict.fromkeys(EULER_ANGLES, "rad"),
    **{f"w{i}": "rad/s" for i in MAPPED_ROTORS},
    **{f"w{i}_CMD": "rad/s" for i in MAPPED_ROTORS},
    **{f"command{i}": "1" for i in MAPPED_ROTORS},
    "throttle": "1",
    "battery_voltage": "V",
    "battery_current": "A",
}
_IN_BODY = {
    **dict.fromkeys(("rates", "force", "body velocity", "setpoint"), True),
    **dict.fromkeys(("velocity", "position", "linear acceleration"), False),
}
_MAY_TURN = ("force", "velocity")


@dataclass(frozen=True)
class Column:
    """aliases  names to look for, the first present wins; factor  to SI; body  axes of a vector; optional  may lack.

    unit  of a motor command (`command_units.RANGES`), None where the mapping names none; its factor is 1
    """

    aliases: tuple[str, ...]
    factor: float
    body: bool
    optional: bool
    unit: str | None = None


@dataclass(frozen=True)
class Source:
    """One group of columns that share a clock and axes; clock (column, factor to s) or None for the rows' clock."""

    name: str
    clock: tuple[str, float] | None
    flu: bool
    z_up: bool
    capture: bool
    columns: dict[str, Column]


@dataclass(frozen=True)
class TableMapping:
    """The whole section: clock of the rows (column, factor to s) or None, and the sources."""

    clock: tuple[str, float] | None
    sources: list[Source]

    @property
    def clocks(self) -> set[str]:
        """Columns of time."""
        return {c[0] for c in (self.clock, *(s.clock for s in self.sources)) if c is not None}

    @property
    def names(self) -> set[str]:
        """All columns that may be read."""
        return self.clocks | {a for s in self.sources for column in s.columns.values() for a in column.aliases}


def _clock(section: Any, where: str) -> tuple[str, float]:
    if isinstance(section, str):
        section = {"column": section}
    return section["column"], to_si(section.get("unit", "s"), "s", where)


def read_mapping(section: Any, poles: int | None, where: str, log_has_clock: bool = False) -> TableMapping:
    """Check the section and resolve units.

    section  its content; poles  magnets of a motor, or None; where  begins every message
    log_has_clock  whether the log stamps its samples itself, so that sources need no column of time
    Raises   ConfigError naming source, quantity and key
    """
    section, _ = configuration.check(section, "quadrotor", where, "properties", "table columns")
    clock = _clock(section["time"], f"{where}, time") if "time" in section else None
    sources = [_source(item, poles, f"{where}, source {i + 1}") for i, item in enumerate(section["sources"])]
    names = [s.name for s in sources]
    if len(set(names)) < len(names):
        raise ConfigError(
            f"{where}: two sources are named '{next(n for n in names if names.count(n) > 1)}'; rename one"
        )
    for source in sources:
        if source.clock is None and clock is None and not log_has_clock:
            raise ConfigError(f"{where}, source '{source.name}': neither it nor the table has a 'time'; add one")
    seen: dict[tuple[str, bool], str] = {}
    for source in sources:
        for quantity in source.columns:
            other = seen.setdefault((quantity, source.capture), source.name)
            if other != source.name:
                raise ConfigError(f"{where}: sources '{other}' and '{source.name}' both map {quantity}; remove one")
    if sum(s.capture for s in sources) > 1:
        raise ConfigError(f"{where}: more than one source is motion capture; merge them into one")
    turning = any((name, False) in seen for name in ("p", "qw", *EULER_ANGLES))
    if not turning and not ({("qw", True), ("x", True)} <= set(seen) and len(sources) > 1):
        raise ConfigError(
            f"{where}: no source maps body rates (p, q, r) or an attitude (qw, qx, qy, qz or roll, pitch, yaw); map "
            "one of them, or rotor speeds or commands next to a motion capture of position and attitude: nothing else "
            "ties a capture in another file to the log"
        )
    return TableMapping(clock, sources)


def _source(section: Any, poles: int | None, where: str) -> Source:
    name = section["name"]
    where = f"{where} ('{name}')"
    flu, z_up = section.get("frame") == "FLU", section.get("world") == "z-up"
    capture = section.get("motion capture", False)
    columns: dict[str, Column] = {}
    for quantity, entry in section["columns"].items():
        if quantity not in UNIT:
            raise ConfigError(f"{where}: unknown quantity '{quantity}'{nearest(quantity, UNIT)}")
        columns[quantity] = _column(entry, quantity, poles, f"{where}, {quantity}")
    for members in (*VECTOR_COLUMNS.values(), QUATERNION):
        present = [m for m in members if m in columns]
        if present and len(present) < len(members):
            lacking = next(m for m in members if m not in columns)
            raise ConfigError(
                f"{where}: {present[0]} is mapped but {lacking} is not; map {', '.join(members)} together"
            )
        if present and len({columns[m].body for m in members}) > 1:
            raise ConfigError(f"{where}: {', '.join(members)} must all have the same 'frame'")
    angles = [m for m in EULER_ANGLES if m in columns]
    if 0 < len(angles) < len(EULER_ANGLES) and flu != z_up:
        axes = f"'frame' {'FLU' if flu else 'FRD'} and 'world' {'z-up' if z_up else 'NED'}"
        raise ConfigError(
            f"{where}: {' and '.join(angles)} alone cannot be turned from {axes}; "
            "map all of roll, pitch, yaw, or use FLU with z-up or FRD with NED"
        )
    return Source(
        name, _clock(section["time"], f"{where}, time") if "time" in section else None, flu, z_up, capture, columns
    )


def _column(entry: Any, quantity: str, poles: int | None, where: str) -> Column:
    if isinstance(entry, str | list):
        entry = {"column": entry}
    aliases = [entry["column"]] if isinstance(entry["column"], str) else entry["column"]
    if quantity.startswith("command"):
        unit = entry.get("unit")
        if unit is not None and unit not in RANGES:
            raise ConfigError(
                f"{where}: unknown unit '{unit}' of a motor command{nearest(str(unit), RANGES)}; one of "
                f"{', '.join(RANGES)}, or leave it out to have it recognised"
            )
        return Column(tuple(aliases), 1.0, True, entry.get("optional", False), unit)
    factor = to_si(
        str(entry.get("unit", UNIT[quantity])), UNIT[quantity], where, poles if quantity[1:2].isdigit() else None
    )
    vector = next((v for v, members in VECTOR_COLUMNS.items() if quantity in members), None)
    body = _IN_BODY.get(vector, True)
    if "frame" in entry:
        if vector is None:
            raise ConfigError(f"{where}: '{quantity}' is no vector and has no 'frame'; remove the key")
        chosen = entry["frame"] == "body"
        if chosen != body and vector not in _MAY_TURN:
            raise ConfigError(f"{where}: {quantity} is always in {'body' if body else 'world'} axes; remove 'frame'")
        body = chosen
    return Column(tuple(aliases), factor, body, entry.get("optional", False))
