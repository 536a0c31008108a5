"""What the extended model gains in simulations of the held-out flights, and what could be gained.

Every window is simulated with measured rotor speeds, plainly and with trim, the mean error of force and moment that the
flight itself showed in the seconds before the window (only what was known then), which each model has its own of; and
with commands, which act through the model's drive. A battery put back half a millimetre off turns a simulated
quadrotor over within a second, whatever else its model knows; with trim taken up, before and after alike, the rest of
the error shows.

The floor is the error of a model that knows all that the flights can teach: its own terms and all causes of the
catalogue together, fitted to the other flights, and with commands the drive's constants fitted to them as well, where
that is better. It keeps what is this flight's own (its trim, its gusts, the errors of its starts), which no model of
other flights can know. The best wrong cause and the polynomial are those of forces; with commands a wrong cause may be
one of the drive. What floor and polynomial change of force and moment moves the windows by the equations of motion
linearised about the measured path.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.error_reduction import after, before
from quasi.gap.levels.rollouts import commanded
from quasi.gap.levels.rollouts.covariates import channels_of, placed, where_of
from quasi.gap.levels.rollouts.linear_response import Course, course_of, responses
from quasi.gap.levels.rollouts.open_loop import (
    COLUMN,
    ERROR_UNITS,
    EVERY,
    MOVED_BY,
    WITH_COMMANDS,
    WITH_TRIM,
    WITHOUT_TRIM,
    commands_of,
    fell,
    flight_of,
    in_own_constants,
    joined,
    overlays,
    rms,
    simulated,
    squares,
    table_of,
    vectors,
)
from quasi.gap.statistics import blocks
from quasi.model.model import Model

TRIM_S, MARGIN, LEAST_S = 2.0, 0.1, 0.5  # s before a window; s that low-pass filters look ahead; s that must be valid
NO_ERROR = 1e-12  # squared error, SI units, that is none
SPEED_LINES = (WITHOUT_TRIM, WITH_TRIM)
YARDSTICKS = ("best_wrong_cause", "generic_polynomial")
Residual = Callable[[Evidence], np.ndarray]
Errors = dict[str, list[np.ndarray]]  # {line: (S, K, VECTOR_SIZE) of each flight}


class Track(NamedTuple):
    """A held-out flight: evidence, its windows, what unit constants of the wrench make of them (S, K, 12, 6), and
    which windows (S,) have commands all along."""

    evidence: Evidence
    course: Course
    constants: np.ndarray
    has_commands: np.ndarray


class Yardsticks(NamedTuple):
    """What a gain is compared with.

    floor         what everything together leaves of a flight's wrench
    wrong         {the best wrong cause of forces and moments: the model with it alone}, or nothing
    polynomial    what a polynomial of the same size leaves
    drive         the rotors' drive as estimated from the other flights, see `commanded.learned`
    wrong_drives  {cause of the drive: the model with it alone} that may be the best wrong cause where commands drive
    commanded_polynomial  the same where commands drive, when causes of the drive are named; None for the same
    quantities  by whose errors the best wrong cause is chosen where commands drive: those that the named causes move
    """

    floor: Residual | None = None
    wrong: Mapping[str, Model] = MappingProxyType({})
    polynomial: Residual | None = None
    drive: Mapping[str, Any] | None = None
    wrong_drives: Mapping[str, Model] = MappingProxyType({})
    commanded_polynomial: Residual | None = None
    quantities: Sequence[str] = (*ERROR_UNITS, *MOVED_BY.values())


def tracks_of(
    held: Sequence[Evidence], tables: Mapping[str, pd.DataFrame], horizons: Sequence[float],
    models: Sequence[Model] = (),
) -> list[Track]:  # fmt: skip
    """Held-out flights made ready; those without a valid window of the longest horizon are left out.

    models  by whose command maps the commands must be known
    """
    found = []
    for evidence in held:
        flight = flight_of(evidence.key, tables[evidence.key], evidence.mass, evidence.inertia)
        course = course_of(evidence, flight, sorted(horizons), EVERY)
        if len(course.starts):
            units = np.broadcast_to(np.eye(6), (len(evidence), 6, 6))
            known = [_known(course, commands_of(model, course.flight)) for model in models]
            driven = np.logical_and.reduce(known) if known else np.zeros(len(course.starts), bool)
            found.append(Track(evidence, course, responses(course, units), driven))
    return found


def _known(course: Course, commands: np.ndarray | None) -> np.ndarray:
    """Windows (S,) whose commands are known all along."""
    if commands is None:
        return np.zeros(len(course.starts), bool)
    lacking = np.concatenate([[0], np.cumsum(~np.isfinite(commands).all(axis=1))])
    return lacking[course.starts + course.lags[-1] + 1] == lacking[course.starts]


def lines_of(tracks: Sequence[Track]) -> tuple[str, ...]:
    """How windows can be driven."""
    return (*SPEED_LINES, WITH_COMMANDS) if any(track.has_commands.any() for track in tracks) else SPEED_LINES


def _of(track: Track, line: str) -> np.ndarray:
    """Windows (S,) of a line."""
    return track.has_commands if line == WITH_COMMANDS else np.ones(len(track.has_commands), bool)


def trim_of(track: Track, residual: np.ndarray) -> np.ndarray:
    """Mean residual wrench (S, 6) of the seconds before each window; 0 where too little of them is valid.

    residual  (n, 6) of the flight's evidence
    """
    t = track.evidence.t
    sums = np.vstack([np.zeros(6), np.cumsum(residual, axis=0)])
    starts = track.course.flight.t[track.course.starts]
    first, last = np.searchsorted(t, starts - MARGIN - TRIM_S), np.searchsorted(t, starts - MARGIN)
    count = (last - first)[:, None]
    enough = count * track.course.step > LEAST_S
    return np.where(enough, (sums[last] - sums[first]) / np.maximum(count, 1), 0.0)


def simulated_errors(
    tracks: Sequence[Track], model: Model, base: Model, lines: Sequence[str] = SPEED_LINES,
    drive: Mapping[str, Any] | None = None,
) -> Errors:  # fmt: skip
    """Errors of a model, an extension of `base` or itself; drive  as of `commanded.learned` instead of its own."""
    return {line: [_errors(track, model, base, line, drive) for track in tracks] for line in lines}


def _errors(track: Track, model: Model, base: Model, line: str, drive: Mapping[str, Any] | None) -> np.ndarray:
    course, offsets, commands, rotors = track.course, None, None, None
    if line == WITH_TRIM:
        shown = trim_of(track, after(model, base)(track.evidence))
        offsets = in_own_constants(shown, model, track.course.flight)
    if line == WITH_COMMANDS:
        commands = commands_of(model, course.flight)
        other = commanded.learned(drive, course.flight, model) if drive and commands is not None else None
        if other is not None and np.isfinite(other[0][np.isfinite(commands).all(axis=1)]).all():
            commands, rotors = other
    starts = course.starts[_of(track, line)]
    horizon = float(course.flight.t[course.lags[-1]] - course.flight.t[0])
    run = simulated(model, course.flight, starts, horizon, commands, offsets, rotors)
    return vectors(run, course.flight, starts, course.lags)


def moved_errors(tracks: Sequence[Track], errors: Errors, of: Residual, to: Residual) -> Errors:
    """Errors once the wrench changes so that it leaves the residual `to` instead of `of`, by the linear response."""
    result: Errors = {line: [] for line in errors}
    for k, track in enumerate(tracks):
        old, new = of(track.evidence), to(track.evidence)
        plain = responses(track.course, (old - new)[:, :, None])[..., 0]
        for line, found in errors.items():
            change = plain[_of(track, line)]
            if line == WITH_TRIM:
                difference = trim_of(track, new) - trim_of(track, old)
                change = plain + np.einsum("sjkc,sc->sjk", track.constants, difference)
            result[line].append(found[k] - change)
    return result


def end_table(
    tracks: Sequence[Track], errors: Sequence[np.ndarray], horizons: Sequence[float], line: str = WITHOUT_TRIM
) -> pd.DataFrame:
    """End errors of all flights, see `open_loop.table_of`."""
    rising = sorted(horizons)
    parts = [table_of(t.course.flight, t.course.starts[_of(t, line)], e, rising) for t, e in zip(tracks, errors)]
    return joined([part for part in parts if len(part)])


def lesser(one: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    """Of two tables of the same windows, each horizon's and quantity's errors from the one where they are smaller."""
    best = one.copy()
    for horizon in one["horizon"].unique():
        rows = (one["horizon"] == horizon).to_numpy()
        for quantity in (*ERROR_UNITS, *MOVED_BY.values()):
            here, there = (of.mean() for of in squares([one[rows], other[rows]], [quantity]))
            if there < here:
                best.loc[rows, quantity] = other.loc[rows, quantity].to_numpy()
    return best


def shares(
    first: pd.DataFrame, last: pd.DataFrame, floor: pd.DataFrame, quantities: Sequence[str],
    reached: pd.DataFrame | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Share of the removable squared error that is gone, by quantity and horizon, as by `blocks.shares`.

    Tables of the same windows; reached  errors that the floor cannot lie above, None takes the last ones.
    """
    rows = []
    for horizon, old in first.groupby("horizon"):
        others = [old, *(t[t["horizon"] == horizon] for t in (last, floor, last if reached is None else reached))]
        flight, start = old["flight"].to_numpy(), old["start"].to_numpy()
        removed = blocks.shares(flight, start, *squares(others, quantities))
        rows += [{"quantity": q, "horizon": float(horizon), **row} for q, row in zip(quantities, removed)]
    return sorted(rows, key=lambda row: quantities.index(row["quantity"]))


def worth(rolled: Mapping[str, Any], old: Errors, channels: Sequence[str], horizons: Sequence[float]) -> list[dict]:
    """What a cause is worth in the velocity or rate along each of its channels, by line and horizon.

    rolled  of `score`; old  errors with the cause left out; channels  names of forces and moments
    Rows of `shares` with "line" and "moved", the mean square of what the cause moves over that of the old error.
    """
    rows = []
    quantities = [MOVED_BY[channel] for channel in channels]
    for line in SPEED_LINES:
        new = rolled["errors"]["after"][line]
        tables = [end_table(rolled["tracks"], old[line], horizons)]
        tables += [rolled["ends"][word][line] for word in ("after", "noise_floor")]
        for row in shares(*tables, quantities):
            at, place = sorted(horizons).index(row["horizon"]), COLUMN[channels[quantities.index(row["quantity"])]]
            first, last = (np.concatenate([e[:, at, place] for e in of]) for of in (old[line], new))
            moved = np.nanmean((first - last) ** 2) / max(np.nanmean(first**2), 1e-300)
            rows.append({**row, "line": line, "moved": float(moved)})
    return rows


def score(
    model: Model, extended: Model, flights: Mapping[str, pd.DataFrame], held: Sequence[Evidence],
    horizons: Sequence[float], yardsticks: Yardsticks,
) -> dict[str, Any]:  # fmt: skip
    """End errors with measured rotor speeds, plain and with trim, and with commands; overlays of windows.

    Returns "tracks"; "errors" {word: Errors}; "ends" {word: {line: table}}; "rms" {word: {line: {quantity: {horizon:
    value}}}}; "fell" {line: rows of `gains`}; "wrong" {line: cause}; and the tables "rollouts_errors",
    "rollouts_where",
    "rollouts_channels", "rollouts_gains" and "rollouts_overlays".
    """
    tracks = tracks_of(held, flights, horizons, (model, extended, *yardsticks.wrong.values()))
    lines, left = lines_of(tracks), after(extended, model)
    errors = {"before": simulated_errors(tracks, model, model, lines)}
    errors["after"] = simulated_errors(tracks, extended, model, lines)
    if yardsticks.floor is not None:
        errors["noise_floor"] = moved_errors(tracks, errors["after"], left, yardsticks.floor)
    for other in yardsticks.wrong.values():
        errors["best_wrong_cause"] = simulated_errors(tracks, other, model, lines)
    if yardsticks.polynomial is not None:
        errors["generic_polynomial"] = moved_errors(tracks, errors["before"], before, yardsticks.polynomial)
    ends = {word: {line: end_table(tracks, e, horizons, line) for line, e in of.items()}
            for word, of in errors.items() if tracks}  # fmt: skip
    whole: dict[str, Any] = {"tracks": tracks, "errors": errors, "ends": ends, "fell": {}, "rms": {}}
    whole["wrong"] = {line: name for name in yardsticks.wrong for line in lines}
    if WITH_COMMANDS in lines:
        _commanded(ends, whole["wrong"], tracks, model, extended, errors, horizons, yardsticks)
    for word, of in ends.items():
        whole["rms"][word] = {line: rms(table) for line, table in of.items()}
    for line, least in whole["rms"].get("noise_floor", {}).items():
        new = whole["rms"]["after"][line]
        whole["rms"]["noise_floor"][line] = {
            q: {h: min(v, new[q][h]) for h, v in by.items()} for q, by in least.items()
        }
    if ends:
        parts = [table.assign(driven=line, model=word) for word, of in ends.items() for line, table in of.items()]
        whole["fell"] = {line: gains(ends, line) for line in lines}
        whole["rollouts_errors"] = placed(pd.concat(parts, ignore_index=True), [track.evidence for track in tracks])
        whole["rollouts_where"] = where_of(whole["rollouts_errors"])
        whole["rollouts_channels"] = _channels(tracks, errors, horizons)
        whole["rollouts_gains"] = gains_table(whole["fell"])
        whole["rollouts_overlays"] = overlays({"before": model, "after": extended},
                                       [track.course.flight for track in tracks], max(horizons))  # fmt: skip
    return whole


def _channels(tracks: Sequence[Track], errors: Mapping[str, Errors], horizons: Sequence[float]) -> pd.DataFrame:
    """rollouts_channels of all flights and lines, before and after."""
    parts = []
    for line in errors["before"]:
        for k, track in enumerate(tracks):
            starts = track.course.starts[_of(track, line)]
            if len(starts):
                both = {word: errors[word][line][k] for word in ("before", "after")}
                parts.append(channels_of(track.course.flight, starts, horizons, both, line))
    return pd.concat(parts, ignore_index=True)


def _commanded(
    ends: dict[str, dict[str, pd.DataFrame]], named: dict[str, str], tracks: Sequence[Track], model: Model,
    extended: Model, errors: Mapping[str, Errors], horizons: Sequence[float], yardsticks: Yardsticks,
) -> None:  # fmt: skip
    """Put in what the drive adds where commands drive: a better floor, another wrong cause, a larger polynomial."""

    def table_for(found: Errors) -> pd.DataFrame:
        return end_table(tracks, found[WITH_COMMANDS], horizons, WITH_COMMANDS)

    if yardsticks.floor is not None and yardsticks.drive is not None:
        found = simulated_errors(tracks, extended, model, [WITH_COMMANDS], yardsticks.drive)
        table = table_for(moved_errors(tracks, found, after(extended, model), yardsticks.floor))
        ends["noise_floor"][WITH_COMMANDS] = lesser(ends["noise_floor"][WITH_COMMANDS], table)

    def ratio(table: pd.DataFrame) -> float:
        return _ratio(table, ends["before"][WITH_COMMANDS], yardsticks.quantities)

    for name, other in yardsticks.wrong_drives.items():
        table = table_for(simulated_errors(tracks, other, model, [WITH_COMMANDS]))
        best = ends.setdefault("best_wrong_cause", {}).get(WITH_COMMANDS)
        if best is None or ratio(table) < ratio(best):
            ends["best_wrong_cause"][WITH_COMMANDS], named[WITH_COMMANDS] = table, name
    if yardsticks.commanded_polynomial is not None:
        driven = {WITH_COMMANDS: errors["before"][WITH_COMMANDS]}
        found = moved_errors(tracks, driven, before, yardsticks.commanded_polynomial)
        ends.setdefault("generic_polynomial", {})[WITH_COMMANDS] = table_for(found)


def _ratio(table: pd.DataFrame, old: pd.DataFrame, names: Sequence[str]) -> float:
    """Mean over horizons and quantities of the squared errors over the old ones."""
    parts = []
    for horizon, first in old.groupby("horizon"):
        new, was = (of.mean(axis=0) for of in squares([table[table["horizon"] == horizon], first], names))
        parts.append((new + NO_ERROR) / (was + NO_ERROR))
    return float(np.mean(parts))


def gains(ends: Mapping[str, Mapping[str, pd.DataFrame]], line: str) -> list[dict[str, Any]]:
    """Rows of `open_loop.fell` of a line with the noise floor and the shares of the removable error.

    Added are "removable"; "removed" {"value", "low", "high"} by the extension; "noise_floor", root mean square; and of
    each of YARDSTICKS "rms" with its "value", "low", "high". A share is None where the floor holds nine tenths.
    """
    names = [*ERROR_UNITS, *MOVED_BY.values()]
    tables = {word: of[line] for word, of in ends.items() if line in of}
    rows = sorted(fell(tables["before"], tables["after"]), key=lambda row: names.index(row["quantity"]))
    if "noise_floor" not in tables:
        return rows
    for word in ("after", *YARDSTICKS):
        if word not in tables:
            continue
        found = rms(tables[word])
        removed = shares(tables["before"], tables[word], tables["noise_floor"], names, tables["after"])
        for row, share in zip(rows, removed, strict=True):
            three = {k: share[k] for k in ("value", "low", "high")}
            if word == "after":
                row |= {"removable": share["removable"], "removed": three,
                        "noise_floor": row["before"] * float(np.sqrt(max(1.0 - share["removable"], 0.0)))}  # fmt: skip
            else:
                row[word] = {"rms": found[row["quantity"]][f"{row['horizon']:g}"], **three}
    return rows


def gains_table(rows: Mapping[str, Sequence[Mapping[str, Any]]]) -> pd.DataFrame:
    """Rows of `gains` by line as a table: driven, quantity, horizon (s), before, noise_floor (rms), removable, model,
    rms, removed, low, high; a row each for the extended model, the best wrong cause and the polynomial."""
    found = []
    for line, of in rows.items():
        for row in of:
            about = {"driven": line, **{k: row[k] for k in ("quantity", "horizon", "before")}}
            about |= {k: row.get(k, np.nan) for k in ("noise_floor", "removable")}
            models = {"after": {"rms": row["after"], **(row.get("removed") or {})}}
            models |= {word: row[word] for word in YARDSTICKS if word in row}
            for word, values in models.items():
                three = {n: values.get(k) for n, k in (("removed", "value"), ("low", "low"), ("high", "high"))}
                three = {n: np.nan if v is None else v for n, v in three.items()}
                found.append({**about, "model": word, "rms": values["rms"], **three})
    return pd.DataFrame(found)
