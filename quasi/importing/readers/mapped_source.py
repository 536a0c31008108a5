"""One source of a log: its columns become standard quantities, units and axes on a clock of their own."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from quasi.attitude import HALF_TURN, from_euler, interpolate, multiply, rotate_inverse
from quasi.errors import ReadError, nearest, quoted
from quasi.importing.checks.rotor_speeds import clean_rotor_speeds
from quasi.importing.clocks.table_clocks import in_long_runs, uncrowded
from quasi.importing.command_units import scale_commands
from quasi.importing.readers.signals import Signals
from quasi.importing.readers.table_mapping import EULER_ANGLES, MAPPED_ROTORS, QUATERNION, VECTOR_COLUMNS, Source
from quasi.importing.streams import unwrapped

LONGEST_HOLD = 10  # rows; a row clock's values that stay the same for longer are believed (rest, coarse quantisation)
ABSURD = 1e30  # beyond any unit and any clock
LEAST_ROWS = 20  # samples of a source, below which neither a clock nor a motion can be judged
STRAY = 1.0  # s; a few samples beyond a gap longer than this at either end are left out


def numbers_of_column(column: pd.Series | pd.DataFrame, path: Path, name: str, notes: list[str]) -> np.ndarray:
    if isinstance(column, pd.DataFrame):
        raise ReadError(f"{path}: {column.shape[1]} columns are named '{name}'; rename all but the one that is meant")
    if not pd.api.types.is_numeric_dtype(column):
        try:
            if column.dtype.kind in "mM":
                raise TypeError
            numbers = pd.to_numeric(column, errors="coerce")
        except (TypeError, ValueError):
            raise ReadError(
                f"{path}: column '{name}' holds {column.dtype} such as {quoted(column.iloc[0])}, expected numbers; "
                "export it as numbers"
            ) from None
        strange = numbers.isna() & column.notna()
        if strange.all():
            raise ReadError(
                f"{path}: column '{name}' holds text ({quoted(column.iloc[0])}), expected numbers; map another one"
            )
        if strange.any():
            row = int(np.argmax(strange.to_numpy())) + 2
            notes.append(
                f"{path}: column '{name}' holds text in {int(strange.sum())} rows (first in row {row}); left out"
            )
        column = numbers
    with np.errstate(invalid="ignore"):  # damaged floats may be signalling NaN
        values = column.to_numpy(float)
    absurd = np.abs(values) >= ABSURD
    if absurd.any():
        notes.append(
            f"{path}: column '{name}' holds {np.count_nonzero(absurd)} numbers beyond {ABSURD:g} (first in row "
            f"{int(np.argmax(absurd)) + 2}); left out"
        )
    return np.where(np.isfinite(values) & ~absurd, values, np.nan)


def times_of_column(table: pd.DataFrame, clock: tuple[str, float], path: Path, notes: list[str]) -> np.ndarray:
    """A column of time, s, by its name and factor; a counter of 32 bits that starts again is carried on."""
    name, factor = clock
    values, turns = unwrapped(numbers_of_column(table[name], path, name, notes))
    if turns:
        notes.append(
            f"{path}: column '{name}' starts again from 0 {turns} times as a counter of 32 bits does; it was carried on"
        )
    return values * factor


def missing_column(path: Path, aliases: list[str] | tuple[str, ...], meant: str, known: Sequence[str]) -> ReadError:
    names = " or ".join(f"'{a}'" for a in aliases)
    columns = [quoted(name, 120)[1:-1] for name in known]
    return ReadError(
        f"{path} has no column {names} ({meant}){nearest(aliases[0], columns)}; correct 'table columns' in the "
        "quadrotor configuration"
    )


def _group_of(source: Source, signals: Signals, known: Sequence[str], path: Path) -> str:
    """The group that holds a source's columns; those of two groups have clocks of their own and are two sources."""
    found: dict[str, str] = {}
    for column in source.columns.values():
        for name in column.aliases:
            if (group := signals.group_of(name)) is not None:
                found.setdefault(group, name)
                break
    if not found:
        quantity, column = next(iter(source.columns.items()))
        raise missing_column(path, column.aliases, f"{quantity} of source '{source.name}'", known)
    if len(found) > 1:
        (one, first), (other, second) = list(found.items())[:2]
        raise ReadError(
            f"{path}: source '{source.name}' maps '{first}' and '{second}', which were sampled apart "
            f"({len(signals.frames[one])} and {len(signals.frames[other])} samples); map them as two sources"
        )
    return next(iter(found))


MEASURED_TOGETHER = {
    **VECTOR_COLUMNS, "attitude": QUATERNION, "angles": EULER_ANGLES,
    "rotor speeds": tuple(f"w{i}" for i in MAPPED_ROTORS), "commands": tuple(f"command{i}" for i in MAPPED_ROTORS),
}  # fmt: skip


def sampled_apart(source: Source, signals: Signals, known: Sequence[str], path: Path) -> list[Source]:
    """The source without what most of its rows leave blank, and one source for each of these groups of quantities.

    A table at the rate of the gyro holds slower telemetry in every second or fifth row. A capture stays whole.
    """
    if source.capture:
        return [source]
    table = signals.frames[_group_of(source, signals, known, path)]
    apart = []
    for label, members in MEASURED_TOGETHER.items():
        own = {m: source.columns[m] for m in members if m in source.columns}
        found = [next((a for a in column.aliases if a in table.columns), None) for column in own.values()]
        if not own or any(isinstance(table[name], pd.DataFrame) for name in found if name):
            continue
        held = [numbers_of_column(table[name], path, name, []) for name in found if name]
        if held and _is_interleaved(np.isfinite(held).any(axis=0)):
            apart.append(replace(source, name=f"{source.name} {label}", columns=own))
    taken = {m for one in apart for m in one.columns}
    rest = {m: column for m, column in source.columns.items() if m not in taken}
    if apart and not any(name in table.columns for column in rest.values() for name in column.aliases):
        # nothing remains under the source's name: the first group keeps it
        return [replace(source, columns=rest | apart[0].columns), *apart[1:]]
    return [replace(source, columns=rest), *apart]


def _is_interleaved(held: np.ndarray) -> bool:
    """Whether most of the rows that hold something (n,) bool have blank ones between them."""
    rows = np.flatnonzero(held)
    return len(rows) > LEAST_ROWS and bool(np.median(np.diff(rows)) > 1)


class MappedSource:
    """One source on its way from the log's columns to a series; each step changes it."""

    def __init__(self, source: Source, signals: Signals, known: Sequence[str], path: Path, notes: list[str]) -> None:
        self.source = source
        self.values: dict[str, np.ndarray] = {}
        self.t = np.zeros(0)
        self.stamps: np.ndarray | None = None
        self.stamped_by_log = bool(signals.clocks)
        self.group = _group_of(source, signals, known, path)
        table = signals.frames[self.group]
        lacking = set()
        for quantity, column in source.columns.items():
            name = next((a for a in column.aliases if a in table.columns), None)
            if name is None and not column.optional:
                raise missing_column(path, column.aliases, f"{quantity} of source '{source.name}'", known)
            if name is None:
                lacking.add(quantity)
                continue
            self.values[quantity] = numbers_of_column(table[name], path, name, notes) * column.factor
        # of motors that never ran no unit can be recognised
        shares = [n for n in self.values if n.startswith("command") and source.columns[n].unit is None]
        silent = shares if not any(self.values[n][np.isfinite(self.values[n])].any() for n in shares) else ()
        for quantity, values in self.values.items():
            empty = not np.isfinite(values).any() or quantity in silent
            if empty and source.columns[quantity].optional:
                lacking.add(quantity)
        for members in (*VECTOR_COLUMNS.values(), QUATERNION):
            if lacking & set(members):
                lacking |= set(members) & set(source.columns)
        # known topics have room for eight motors: that a quadrotor has four is no news
        if missed := sorted(lacking - {f"command{i}" for i in range(5, 9)}):
            notes.append(f"{path}: source '{source.name}' has no {', '.join(missed)} (optional, absent or empty)")
        self.values = {k: v for k, v in self.values.items() if k not in lacking}
        for quantity, values in self.values.items():
            if not np.isfinite(values).any():
                raise ReadError(
                    f"{path}: the column mapped to {quantity} is empty; map another one or make it optional"
                )
        shares = {n: v for n, v in self.values.items() if n.startswith("command")}
        if shares:
            self.values |= scale_commands(shares, {n: source.columns[n].unit for n in shares}, path, notes)
        if source.clock is not None:
            if source.clock[0] not in table.columns:
                raise missing_column(path, [source.clock[0]], f"time of source '{source.name}'", known)
            self.stamps = times_of_column(table, source.clock, path, notes)
        self.report: dict[str, Any] = {
            "clock": source.clock[0] if source.clock else "log" if self.stamped_by_log else "rows",
            "motion capture": source.capture,
        }

    def matrix(self, names: Sequence[str]) -> np.ndarray:
        """Quantities side by side (n, len(names))."""
        return np.stack([self.values[n] for n in names], axis=-1)

    def settle(self, rows: np.ndarray | None, at_rest: np.ndarray, path: Path, notes: list[str]) -> None:
        """Keep the rows that bring a new sample: stamp larger than any before, values not merely held.

        at_rest  (n,) bool, rows in which unchanged values may be a quadrotor at rest (see `rows_possibly_at_rest`)
        """
        clock = self.stamps if self.stamps is not None else rows
        known = np.isfinite(clock)
        ahead = np.fmax.accumulate(np.where(known, clock, -np.inf))
        before = np.concatenate([[-np.inf], ahead[:-1]])
        new = known & (clock > before)
        if self.values and not self.source.capture:
            held_any = np.isfinite(list(self.values.values())).any(axis=0)
            new &= held_any | (not _is_interleaved(held_any))
        repeated = known & (clock == before)
        back = known & (clock < before)
        if np.count_nonzero(back) > 0.2 * len(clock):
            raise ReadError(
                f"{path}: the stamps of source '{self.source.name}' step back in "
                f"{np.count_nonzero(back)} of {len(clock)} rows; they are no clock, map another time column"
            )
        if back.any():
            row = int(np.argmax(back))
            notes.append(
                f"{path}: {np.count_nonzero(back)} stamps of source '{self.source.name}' step back "
                f"(first in row {row + 2}, by {before[row] - clock[row]:.4g} s); these rows were left out"
            )
        held = np.zeros(len(clock), bool)
        if self.values and ((self.stamps is None and not self.stamped_by_log) or self.source.capture):
            stack = np.stack(list(self.values.values()))
            same = np.concatenate([[False], np.all((stack[:, 1:] == stack[:, :-1]), axis=0)])
            held = same & new
            if not self.source.capture:
                held &= ~(in_long_runs(same, LONGEST_HOLD) & at_rest)
        if (self.stamps is not None or self.stamped_by_log) and np.count_nonzero(new) > LEAST_ROWS:
            clock = clock.copy()
            even = uncrowded(clock[new])
            moved = clock[new] - even
            clock[new] = even
            self.report["crowded stamps"] = {
                "moved": int(np.count_nonzero(moved > 1e-3)),
                "largest": float(moved.max()),
                "unit": "s",
            }
            if np.count_nonzero(moved > 1e-3) > 0.01 * len(moved):
                notes.append(
                    f"{path}: {np.count_nonzero(moved > 1e-3)} stamps of source '{self.source.name}' crowd behind a "
                    f"delay; they were spread over it, by {1e3 * moved.max():.0f} ms at most"
                )
        new &= ~held
        if np.count_nonzero(new) < LEAST_ROWS:
            raise ReadError(
                f"{path}: source '{self.source.name}' has {np.count_nonzero(new)} samples of its own; map another time"
            )
        lost = int(np.count_nonzero(repeated) + np.count_nonzero(held))
        if lost > 0.01 * len(clock):
            notes.append(
                f"{path}: {lost} of {len(clock)} rows only repeat an older sample of source "
                f"'{self.source.name}'; dropped"
            )
        self.fresh = np.flatnonzero(new)
        self.row_clock = rows
        self.all_stamps = clock
        self.t = clock[new]
        self.values = {k: v[new] for k, v in self.values.items()}
        spacing = np.diff(self.t)
        gaps = spacing > max(0.05, 5 * float(np.median(spacing)))
        self.report |= {
            "repeated": int(np.count_nonzero(repeated)),
            "held": int(np.count_nonzero(held)),
            "stepped back": int(back.sum()),
            "gaps": int(gaps.sum()), "longest gap": float(spacing.max()), "jitter": float(np.std(spacing[~gaps])),
        }  # fmt: skip

    def clock_against(self, main: "MappedSource", path: Path, notes: list[str]) -> dict[str, Any]:
        """Bring the stamps onto the main source's clock by the rows they share; report the disagreement.

        Where each source has rows of its own, the log's clock of both takes the place of shared rows.
        """
        if self is main or (self.stamps is None and main.stamps is None):
            return self.report
        if self.group == main.group:
            here = np.intersect1d(self.fresh, main.fresh)
            if len(here) < 10:
                here = self.fresh
            difference = self.all_stamps[here] - main.all_stamps[here]
        elif self.row_clock is None or main.row_clock is None:
            return self.report
        else:
            difference = (self.all_stamps - self.row_clock)[self.fresh] - np.nanmedian(main.all_stamps - main.row_clock)
        difference = difference[np.isfinite(difference)]
        middle = float(np.median(difference))
        low, high = np.quantile(difference, [0.05, 0.95])
        self.report["stamps minus main stamps"] = {
            "median": middle,
            "5 %": float(low),
            "95 %": float(high),
            "unit": "s",
        }
        if self.stamps is None or abs(middle) > 0.5:
            self.t = self.t - middle
            self.all_stamps = self.all_stamps - middle
            what = "rides on the rows' clock" if self.stamps is None else "keeps another time"
            notes.append(
                f"{path}: source '{self.source.name}' {what}; {middle:.3f} s were taken off (median over rows)"
            )
        elif max(abs(low), abs(high)) > 0.001:
            notes.append(
                f"{path}: stamps of source '{self.source.name}' differ from those of '{main.source.name}' in the same "
                f"row by {1e3 * low:+.1f} to {1e3 * high:+.1f} ms (5 to 95 %, median {1e3 * middle:+.1f} ms); "
                "each keeps its own"
            )
        return self.report

    def drop_strays(self, path: Path, notes: list[str]) -> None:
        """Leave out a handful of samples beyond a long gap at either end."""
        keep = slice(0, len(self.t))
        few = max(5, len(self.t) // 200)
        wide = np.flatnonzero(np.diff(self.t) > STRAY)
        if len(wide) and len(self.t) - 1 - wide[-1] <= few:
            keep = slice(0, int(wide[-1]) + 1)
        if len(wide) and wide[0] + 1 <= few and keep.stop > wide[0] + 1:
            keep = slice(int(wide[0]) + 1, keep.stop)
        lost = len(self.t) - (keep.stop - keep.start)
        if lost:
            notes.append(
                f"{path}: {lost} samples of source '{self.source.name}' beyond a gap of more than "
                f"{STRAY:g} s at its end were left out"
            )
            self.t = self.t[keep]
            self.values = {k: v[keep] for k, v in self.values.items()}

    def to_standard_axes(self) -> None:
        """Earth NED and body FRD; Euler angles become a quaternion, its length one."""
        body = HALF_TURN if self.source.flu else np.ones(3)
        world = HALF_TURN if self.source.z_up else np.ones(3)
        for members in VECTOR_COLUMNS.values():
            if members[0] in self.values:
                axes = body if self.source.columns[members[0]].body else world
                for name, sign in zip(members, axes):
                    self.values[name] = sign * self.values[name]
        if "qw" in self.values:
            q = self.matrix(QUATERNION)
            length = np.linalg.norm(q, axis=-1, keepdims=True)
            turned = length > 0.5
            q = np.where(turned, q / np.where(turned, length, 1.0), np.nan)
            if self.source.capture and turned.any():  # a frame of zeros was not seen
                for name in set(VECTOR_COLUMNS["position"]) & set(self.values):
                    self.values[name] = np.where(length[:, 0] == 0.0, np.nan, self.values[name])
        elif all(n in self.values for n in EULER_ANGLES):
            q = from_euler(*[self.values.pop(n) for n in EULER_ANGLES])
        else:
            # half a turn about x on either side: R_z(yaw) and R_y(pitch) change sign, R_x(roll) does not
            for name, axis in (("pitch", body[1]), ("yaw", body[2])):
                if name in self.values:
                    self.values[name] = axis * self.values[name]
            return
        for n in EULER_ANGLES:
            self.values.pop(n, None)
        half = np.array([0.0, 1.0, 0.0, 0.0])
        if self.source.z_up:
            q = multiply(half, q)
        if self.source.flu:
            q = multiply(q, -half)
        q = np.where(q[:, :1] < 0, -q, q)
        self.values |= {n: q[:, i] for i, n in enumerate(QUATERNION)}

    def remove_spikes(self, path: Path, notes: list[str]) -> dict[str, int]:
        """Rotor speeds that no rotor follows become NaN; returns how many per rotor."""
        cleaned, removed = clean_rotor_speeds(self.t, self.values, str(path), notes)
        self.values |= cleaned
        return removed

    def world_to_body(self, raw: list["MappedSource"], path: Path) -> None:
        """Turn world-axis specific force by the attitude at its own times, body-axis velocity into u v w."""
        if "vx" in self.values and self.source.columns["vx"].body:
            for old, new in zip(VECTOR_COLUMNS["velocity"], VECTOR_COLUMNS["body velocity"]):
                self.values[new] = self.values.pop(old)
        if "ax" in self.values and not self.source.columns["ax"].body:
            holder = (
                self
                if "qw" in self.values
                else next((r for r in raw if "qw" in r.values and not r.source.capture), None)
            )
            if holder is None:
                raise ReadError(
                    f"{path}: ax, ay, az are in world axes but no on-board attitude is mapped to turn them; map one"
                )
            q = holder.matrix(QUATERNION)
            fine = np.isfinite(q).all(axis=-1)
            if np.count_nonzero(fine) < LEAST_ROWS:
                raise ReadError(
                    f"{path}: ax, ay, az are in world axes, and the on-board attitude that turns them has "
                    f"{np.count_nonzero(fine)} usable samples; map an attitude that was estimated in this flight"
                )
            at = interpolate(q[fine], holder.t[fine], self.t)
            force = rotate_inverse(at, self.matrix(VECTOR_COLUMNS["force"]))
            self.values |= {n: force[:, i] for i, n in enumerate(VECTOR_COLUMNS["force"])}
