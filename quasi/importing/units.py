"""Units that a table may be written in, and what they are in SI."""

import math

from quasi.errors import ConfigError, nearest

# unit: (what it measures, factor to SI)
UNITS: dict[str, tuple[str, float]] = {
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "ns": ("time", 1e-9),
    "min": ("time", 60.0),
    "rad": ("angle", 1.0),
    "deg": ("angle", math.pi / 180),
    "rad/s": ("angular speed", 1.0),
    "deg/s": ("angular speed", math.pi / 180),
    "rpm": ("angular speed", 2 * math.pi / 60),
    "rev/s": ("angular speed", 2 * math.pi),
    # electrical speeds: to be divided by the pole pairs
    "eRPM": ("electrical speed", 2 * math.pi / 60),
    "eRPM/100": ("electrical speed", 100 * 2 * math.pi / 60),
    "m/s2": ("acceleration", 1.0),
    "g": ("acceleration", 9.80665),
    "mg": ("acceleration", 9.80665e-3),
    "m": ("length", 1.0),
    "cm": ("length", 1e-2),
    "mm": ("length", 1e-3),
    "m/s": ("speed", 1.0),
    "cm/s": ("speed", 1e-2),
    "mm/s": ("speed", 1e-3),
    "km/h": ("speed", 1 / 3.6),
    "1": ("share", 1.0),
    "%": ("share", 1e-2),
    # commands as counts of 16 bits
    "1/65535": ("share", 1 / 65535),
    "V": ("voltage", 1.0),
    "mV": ("voltage", 1e-3),
    "A": ("current", 1.0),
    "mA": ("current", 1e-3),
}
_SI = {
    "s": "time", "rad": "angle", "rad/s": "angular speed", "m/s2": "acceleration", "m": "length", "m/s": "speed",
    "1": "share", "V": "voltage", "A": "current",
}  # fmt: skip


def to_si(unit: str, wanted: str, where: str, poles: int | None = None) -> float:
    """Factor from `unit` to the SI unit `wanted`; `poles` magnets of a motor turn electrical into mechanical speed.

    Raises ConfigError (beginning with `where`) for an unknown unit or one that measures something else.
    """
    if unit not in UNITS:
        raise ConfigError(f"{where}: unknown unit '{unit}'{nearest(unit, UNITS)}")
    measures, factor = UNITS[unit]
    if measures == "electrical speed" and wanted == "rad/s":
        if poles is None:
            raise ConfigError(f"{where}: unit '{unit}' needs 'motor poles' in the quadrotor configuration; add it")
        return factor / (poles / 2)
    if measures != _SI[wanted]:
        fitting = sorted(u for u, (m, _) in UNITS.items() if m == _SI[wanted])
        raise ConfigError(
            f"{where}: '{unit}' measures {measures}, expected one of {', '.join(fitting)}; correct the unit"
        )
    return factor
