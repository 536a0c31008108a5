"""Time in a table of several sources: frozen rows, stamps that crowd, and the lag of one source against another.

A source without a declared clock has the rows' time only. Its messages may have been written tens of milliseconds later
or earlier than those of the gyro. The lag follows from the motion that both measured.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from quasi.attitude import body_rates, continuous
from quasi.importing.clocks.clock_fit import ClockFit, Pair, uniform
from quasi.importing.clocks.telemetry import (
    GRID,
    TELEMETRY_BAND,
    YAW_EXPLAINED,
    acceleration_lag,
    best_fit,
    rotor_age,
    rotor_lag,
)
from quasi.importing.readers.table_mapping import QUATERNION, VECTOR_COLUMNS, Source
from quasi.sensor_limits import runs_of

LONGEST_WAIT = 0.2  # s; messages that crowd after a longer wait are left where they are
IDLE_SHARE = (
    0.3  # of the rotor speed in flight, below which a rotor lifts less than a tenth: thrust goes with its square
)
STILL_RATE = 0.15  # rad/s, body rates of a quadrotor at rest, bias included (filtering.bias.STILL_GYRO)
LEAST_LAG_EXPLAINED = 0.5  # share of one signal's variance that the other explains, from which a lag is applied
LARGEST_LAG_STD = 0.01  # s, standard error of a lag up to which it is applied
# s of a record from which a lag is estimated: more would cost time in proportion, and 120 s of flight give it to 0.1 ms
LONGEST_RECORD = 120.0
LEAST_SAMPLES = 20  # of a source within them, as of a table
SIGMAS = 3.0  # standard errors from which a lag differs from zero
# s; roll and pitch show rotor speeds up to this much late, through the inflow (see telemetry)
ROTOR_LAG_BIAS = 0.01


class TableSource(Protocol):
    """What this module needs of a source: its mapping, its times t (n,) s, values {quantity: (n,)} in earth NED and
    body FRD, and its own stamps, None where they are not declared."""

    source: Source
    t: np.ndarray
    values: dict[str, np.ndarray]
    stamps: np.ndarray | None

    def matrix(self, names: Sequence[str]) -> np.ndarray:
        """Quantities side by side (n, len(names))."""


def uncrowded(t: np.ndarray) -> np.ndarray:
    """Stamps (n,), s, of messages that waited and arrived in a burst, moved back to where they can have been sampled.

    A message can be stamped late, not early; so of a crowd the last is right, and each before it was sampled at least
    0.8 of the usual interval earlier. A crowd of which a sample would have to be moved by more than LONGEST_WAIT is
    none: the source was faster there.
    """
    least = 0.8 * float(np.median(np.diff(t)))
    steps = least * np.arange(len(t))
    earlier = steps + np.minimum.accumulate((t - steps)[::-1])[::-1]
    moved = t - earlier
    crowd = np.concatenate([[0], np.cumsum((moved[1:] == 0.0) | (moved[:-1] == 0.0))])  # numbered, each with its last
    longest = np.zeros(crowd[-1] + 1)
    np.maximum.at(longest, crowd, moved)
    return np.where(longest[crowd] <= LONGEST_WAIT, earlier, t)


def rows_possibly_at_rest(raw: Sequence[TableSource]) -> np.ndarray:
    """True (n,) for rows in which the quadrotor may be at rest.

    No rotor turns; without rotor speeds the gyro is still; without a gyro no rotor is commanded to turn.

    At rest a log of coarse steps may repeat its values. In flight no sensor does: there the log was frozen.
    """
    sources = [r for r in raw if not r.source.capture]
    rotors = [v for r in sources for n, v in r.values.items() if n[0] == "w" and n[1:].isdigit()]
    if rotors:
        speed = np.nan_to_num(np.abs(np.stack(rotors))).max(axis=0)
        return speed <= IDLE_SHARE * np.quantile(speed, 0.9)
    rates = [r.values[n] for r in sources for n in VECTOR_COLUMNS["rates"] if n in r.values]
    if not rates:
        commands = [v for r in sources for n, v in r.values.items() if n.startswith("command")]
        return np.nan_to_num(np.stack(commands)).max(axis=0) <= 0.0 if commands else np.zeros(1, bool)
    return np.nan_to_num(np.abs(np.stack(rates))).max(axis=0) <= STILL_RATE


def in_long_runs(same: np.ndarray, longest: int) -> np.ndarray:
    """True inside runs of more than `longest` True in a row."""
    result = np.zeros(len(same), bool)
    for a, b in runs_of(same):
        result[a:b] = b - a > longest
    return result


def correct_source_lags(
    raw: Sequence[TableSource], main: TableSource, about: dict[str, dict[str, Any]], path: Path, notes: list[str],
    gyro_late: float = 0.0,
) -> None:  # fmt: skip
    """Estimate how late the main source is stamped against each other one, and move the other where that is certain.

    gyro_late  s by which filters on board delay a gyro of the main source: no lag of its stamps

    Sources with the same declared stamps came in the same messages and share one lag, the most precise of theirs.
    Sources without declared stamps have a lag each. `about` gets "lag of main stamps" by source name.
    """
    turning = main
    if gyro_late and "p" in main.values:
        turning = copy(main)
        turning.t = main.t - gyro_late
    late = [r for r in raw if r is not main and not r.source.capture and not _same_stamps(r, main)]
    while late:
        same = [r for r in late if r is late[0] or _same_stamps(r, late[0])]
        late = [r for r in late if r not in same]
        found = [(r, *_motion_lag(r, turning)) for r in same]
        found = [f for f in found if f[1] is not None]
        for r, clock, relation in found:
            about[r.source.name]["lag of main stamps"] = {
                "value": clock.lag, "std": clock.lag_std, "unit": "s", "from": relation,
                "explained variance": clock.explained, "applied": False,
            }  # fmt: skip
        found = [f for f in found if f[1].explained > LEAST_LAG_EXPLAINED and f[1].lag_std < LARGEST_LAG_STD]
        if not found:
            continue
        r, clock, relation = min(found, key=lambda f: f[1].lag_std)
        least = SIGMAS * clock.lag_std
        if relation == BY_ROTOR_SPEEDS:
            # whoever stamped the rows: what the inflow makes of them is no lag. Yaw gives a smaller one later
            least += ROTOR_LAG_BIAS
        if abs(clock.lag) <= least:
            continue
        about[r.source.name]["lag of main stamps"]["applied"] = True
        if relation == BY_ROTOR_SPEEDS:
            clock = _by_yaw(r, turning, clock)
            about[r.source.name]["lag of main stamps"] |= {"value": clock.lag, "std": clock.lag_std}
        for moved in same:
            moved.t = moved.t + clock.lag
        names = " and ".join(f"'{m.source.name}'" for m in same)
        notes.append(
            f"{path}: source {names} is stamped {1e3 * abs(clock.lag):.1f} +- {1e3 * clock.lag_std:.1f} ms "
            f"{'early' if clock.lag > 0 else 'late'} against '{main.source.name}' (from {relation}); moved"
        )


def _same_stamps(one: TableSource, other: TableSource) -> bool:
    """Whether two sources have declared stamps, and the same ones."""
    return (
        one.stamps is not None
        and other.stamps is not None
        and len(one.t) == len(other.t)
        and np.array_equal(one.t, other.t)
    )


BY_ROTOR_SPEEDS = "angular acceleration and rotor speeds"


def _liveliest(main: TableSource) -> tuple[float, float]:
    """The LONGEST_RECORD seconds of a source in which it moves most, as begin and end; all where it is shorter."""
    t = main.t
    if t[-1] - t[0] <= LONGEST_RECORD:
        return float(t[0]), float(t[-1])
    moving = next(
        (names for names in (VECTOR_COLUMNS["rates"], VECTOR_COLUMNS["velocity"]) if names[0] in main.values), None
    )
    if moving is None:
        return float(t[0]), float(t[0]) + LONGEST_RECORD
    energy = np.concatenate([[0.0], np.cumsum(np.nan_to_num(main.matrix(moving) ** 2).sum(axis=1))])
    after = np.searchsorted(t, t + LONGEST_RECORD, side="right")
    best = int(np.argmax(np.where(t + LONGEST_RECORD <= t[-1], energy[after] - energy[:-1], -1.0)))
    return float(t[best]), float(t[best]) + LONGEST_RECORD


def _within(r: TableSource, span: tuple[float, float]) -> TableSource:
    rows = (r.t >= span[0]) & (r.t <= span[1])
    if np.count_nonzero(rows) < LEAST_SAMPLES or rows.all():
        return r
    part = copy(r)
    part.t, part.values = r.t[rows], {n: v[rows] for n, v in r.values.items()}
    return part


def _motion_lag(r: TableSource, main: TableSource) -> tuple[ClockFit | None, str]:
    """Lag of the main source's stamps behind those of `r`, and the relation it follows from."""
    span = _liveliest(main)
    r, main = _within(r, span), _within(main, span)
    rotors = tuple(n for n in r.values if n[0] == "w" and n[1:].isdigit())
    if "p" not in main.values and "vx" not in main.values:
        return None, ""
    if all(n in r.values for n in QUATERNION) and "p" in main.values:
        return _attitude_lag(r, main), "body rates of attitude and gyro"
    for state, force, sign in ((main, r, 1.0), (r, main, -1.0)):
        if all(n in s.values and not s.source.columns[n].body for n, s in (("ax", force), ("vx", state))):
            clock = acceleration_lag(
                force.t, force.matrix(VECTOR_COLUMNS["force"]), state.t, state.matrix(VECTOR_COLUMNS["velocity"])
            )
            if clock is not None and sign < 0:
                clock = clock.inverted()
            return clock, "velocity derivative and acceleration"
    if len(rotors) >= 3 and "p" in main.values:
        return rotor_lag(r.t, r.matrix(rotors), main.t, main.matrix(VECTOR_COLUMNS["rates"])), BY_ROTOR_SPEEDS
    return None, ""


def _by_yaw(r: TableSource, main: TableSource, clock: ClockFit) -> ClockFit:
    """A lag by roll and pitch without what the inflow makes of it, where yaw shows the rest."""
    span = _liveliest(main)
    r, main = _within(r, span), _within(main, span)
    rotors = [n for n in r.values if n[0] == "w" and n[1:].isdigit()]
    age = rotor_age(r.t + clock.lag, r.matrix(rotors), main.t, main.matrix(VECTOR_COLUMNS["rates"]))
    if age is None or age.explained <= YAW_EXPLAINED or SIGMAS * age.std >= ROTOR_LAG_BIAS:
        return clock
    return replace(clock, lag=clock.lag - age.value, lag_std=age.std)


def _attitude_lag(r: TableSource, main: TableSource) -> ClockFit | None:
    """Lag of the gyro's stamps behind those of an attitude of another source, from the body rates of both."""
    q = r.matrix(QUATERNION)
    fine = np.isfinite(q).all(axis=1)
    if np.count_nonzero(fine) < 8:
        return None
    t = r.t[fine]
    turned = uniform(t, body_rates(continuous(q[fine]), t), GRID, TELEMETRY_BAND)
    gyro = uniform(main.t, main.matrix(VECTOR_COLUMNS["rates"]), GRID, TELEMETRY_BAND)
    return None if turned is None or gyro is None else best_fit([Pair("body rates", gyro, turned)])
