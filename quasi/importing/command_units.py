"""Units of motor commands in a table: recognised where the mapping names none, stated, and brought to shares 0 to 1."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from quasi.errors import Caution, DataError, add_caution

# unit: (idle end, full end) of the motor output range
RANGES = {
    "1": (0.0, 1.0),
    "%": (0.0, 100.0),
    "1000..2000": (1000.0, 2000.0),  # us, RC pulse widths
    "1/65535": (0.0, 65535.0),  # PWM ratio of 16 bit
}
TOP, BOTTOM = 99.0, 1.0  # percentiles that stand for the ends: splines and spikes overshoot them
SLACK = 0.05  # of the range, by which a percentile may lie beyond it
FEW = 0.01  # share of samples beyond the range from which the unit is doubted


def recognise_unit(values: np.ndarray, where: str) -> str:
    """The key of RANGES that fits commands (n,) of all rotors. Raises DataError where none does."""
    known = values[np.isfinite(values)]
    top = float(np.percentile(known, TOP)) if len(known) else 0.0
    running = known[known > 0.02 * top]  # a stopped motor may be logged as 0 whatever the unit
    bottom = float(np.percentile(running, BOTTOM)) if len(running) else 0.0
    fitting = [
        unit
        for unit, (low, high) in RANGES.items()
        if low - SLACK * (high - low) <= bottom and low < top <= high + SLACK * (high - low)
    ]
    # the narrowest range that holds them; 1000 to 2000 also lies within 0 to 65535
    if top > 1.0 + SLACK and top <= 100.0 + 100.0 * SLACK:
        fitting = [u for u in fitting if u == "%"]
    elif 100.0 + 100.0 * SLACK < top <= 2000.0 + 1000.0 * SLACK:
        fitting = [u for u in fitting if u == "1000..2000"]
    if not fitting or top <= 0.0:
        raise DataError(
            f"{where}: the motor commands run from {bottom:.4g} to {top:.4g}, a range that is none of "
            f"{', '.join(f'{low:g} to {high:g}' for low, high in RANGES.values())}; give their 'unit' in 'table "
            f"columns' ({', '.join(RANGES)}), or scale them before"
        )
    return fitting[0]


def to_shares(values: np.ndarray, unit: str) -> np.ndarray:
    """Commands (n,) in a unit of RANGES as shares of the output range, NaN where unknown."""
    low, high = RANGES[unit]
    return (values - low) / (high - low)


def scale_commands(
    values: Mapping[str, np.ndarray], units: Mapping[str, str | None], path: Path, notes: list[str]
) -> dict[str, np.ndarray]:
    """Command columns of one source as shares within 0 to 1.

    values  {"command1": (n,), ...} as the table holds them; units  {name: unit in the mapping, None where absent}
    notes   receives the recognised unit, and how many samples were beyond the range and were set to its end
    """
    unnamed = [name for name in values if units[name] is None]
    recognised = None
    if unnamed:
        recognised = recognise_unit(np.concatenate([values[name] for name in unnamed]), str(path))
        if recognised != "1":
            low, high = RANGES[recognised]
            notes.append(
                f"{path}: the unit of the motor commands was recognised as {recognised}: {low:g} is idle, {high:g} full"
            )
    _report_unlikely_units(values, units, path, notes)
    found, beyond, total = {}, 0, 0
    for name, column in values.items():
        shares = to_shares(column, units[name] or recognised)
        known = np.isfinite(shares)
        stopped = known & (column == 0.0)  # written so whatever the unit
        beyond += int(np.count_nonzero(known & ~stopped & ((shares < 0.0) | (shares > 1.0))))
        total += int(np.count_nonzero(known))
        found[name] = np.clip(shares, 0.0, 1.0)
    if beyond:
        sentence = (
            f"{path}: {beyond} of {total} motor commands lay outside their range and were set to its end; look for "
            "interpolation or another unit"
        )
        notes.append(Caution(sentence) if beyond > FEW * total else sentence)
    return found


def _report_unlikely_units(
    values: Mapping[str, np.ndarray], units: Mapping[str, str | None], path: Path, notes: list[str]
) -> None:
    """A note where the commands lie in the range of the stated unit, and fill that of another one."""
    for unit in {unit for unit in units.values() if unit is not None}:
        together = np.concatenate([column for name, column in values.items() if units[name] == unit])
        try:
            likely = recognise_unit(together, str(path))
        except DataError:
            continue
        top = float(np.nanpercentile(together, TOP))
        if likely != unit and top <= RANGES[unit][1]:
            add_caution(
                notes,
                f"{path}: the motor commands reach {top:.4g}, {100 * float(to_shares(top, unit)):.2g} % of the range "
                f"of the stated unit {unit}, as if their unit were {likely}; correct 'unit' in 'table columns'",
            )
