"""What the extended model gains in simulations of the held-out flights, beside what could be gained.

Every window is simulated twice: plainly, and with trim, the mean error of force and moment that the flight itself
showed in the seconds before the window (only what was known then), which each model has its own of. A battery put back
half a millimetre off turns a simulated quadrotor over within a second, whatever else its model knows; with trim taken
up, before and after alike, the rest of the error shows.

The floor is the error of a model that knows all that the flights can teach: its own terms and all causes of the
catalogue together, fitted to the other flights. It keeps what is this flight's own (its trim, its gusts, the errors of
its starts), which no model of other flights can know. The best wrong cause and the polynomial are those of level W.
What floor and polynomial change of force and moment moves the windows by the equations of motion linearised about the
measured path.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.gap.evidence import Evidence
from quasi.gap.gain import after, before
from quasi.gap.linear_response import Course, course_of, responses
from quasi.gap.rollouts import (
    CHANNELS,
    COLUMN,
    EVERY,
    TOLD,
    blocks_of,
    end_errors,
    fell,
    finite,
    flight_of,
    joined,
    overlays,
    rms,
    simulated,
    table_of,
    vectors,
)
from quasi.standalone.model import Model

PLAIN, TRIMMED = "R", "R with trim"
TRIM, MARGIN, LEAST = 2.0, 0.1, 0.5  # s before a window; s that low-pass filters look ahead; s that must be valid
HOLDS = 0.9  # share of the squared error: where the floor holds more, no share of the rest is told
DRAWS = 200
LINES = (PLAIN, TRIMMED)
Residual = Callable[[Evidence], np.ndarray]
Errors = dict[str, list[np.ndarray]]  # {line: (S, K, OUTPUTS) of each flight}


class Track(NamedTuple):
    """A held-out flight: evidence, its windows, and what unit constants of the wrench make of them (S, K, 12, 6)."""

    evidence: Evidence
    course: Course
    constants: np.ndarray


def tracks_of(held: Sequence[Evidence], tables: Mapping[str, pd.DataFrame], horizons: Sequence[float]) -> list[Track]:
    """Held-out flights made ready; those without a valid window of the longest horizon are left out."""
    found = []
    for evidence in held:
        course = course_of(evidence, flight_of(evidence.key, tables[evidence.key]), sorted(horizons), EVERY)
        if len(course.starts):
            units = np.broadcast_to(np.eye(6), (len(evidence), 6, 6))
            found.append(Track(evidence, course, responses(course, units)))
    return found


def trim_of(track: Track, residual: np.ndarray) -> np.ndarray:
    """Mean residual wrench (S, 6) of the seconds before each window; 0 where too little of them is valid.

    residual  (n, 6) of the flight's evidence
    """
    t = track.evidence.t
    sums = np.vstack([np.zeros(6), np.cumsum(residual, axis=0)])
    starts = track.course.flight.t[track.course.starts]
    first, last = np.searchsorted(t, starts - MARGIN - TRIM), np.searchsorted(t, starts - MARGIN)
    count = (last - first)[:, None]
    enough = count * track.course.step > LEAST
    return np.where(enough, (sums[last] - sums[first]) / np.maximum(count, 1), 0.0)


def simulated_errors(tracks: Sequence[Track], model: Model, base: Model) -> Errors:
    """Errors of a model, an extension of `base` or itself."""
    return {line: [_errors(track, model, base, line == TRIMMED) for track in tracks] for line in LINES}


def _errors(track: Track, model: Model, base: Model, trim: bool) -> np.ndarray:
    course, offsets = track.course, None
    if trim:
        offsets = trim_of(track, after(model, base)(track.evidence))
        # what instruments show with the configured constants, in the model's own
        if model.airframe.mass and base.airframe.mass:
            offsets[:, :3] *= model.airframe.mass / base.airframe.mass
        offsets[:, 3:] = offsets[:, 3:] @ np.linalg.solve(track.course.inertia, np.asarray(model.airframe.inertia)).T
    horizon = float(course.flight.t[course.lags[-1]] - course.flight.t[0])
    run = simulated(model, course.flight, course.starts, horizon, None, offsets)
    return vectors(run, course.flight, course.starts, course.lags)


def moved_errors(tracks: Sequence[Track], errors: Errors, of: Residual, to: Residual) -> Errors:
    """Errors once the wrench changes so that it leaves the residual `to` instead of `of`, by the linear response."""
    result: Errors = {line: [] for line in errors}
    for k, track in enumerate(tracks):
        old, new = of(track.evidence), to(track.evidence)
        plain = responses(track.course, (old - new)[:, :, None])[..., 0]
        for line, found in errors.items():
            change = plain
            if line == TRIMMED:
                difference = trim_of(track, new) - trim_of(track, old)
                change = plain + np.einsum("sjkc,sc->sjk", track.constants, difference)
            result[line].append(found[k] - change)
    return result


def end_table(tracks: Sequence[Track], errors: Sequence[np.ndarray], horizons: Sequence[float]) -> pd.DataFrame:
    """End errors of all flights, see `rollouts.table_of`."""
    rising = sorted(horizons)
    return joined([table_of(t.course.flight, t.course.starts, found, rising) for t, found in zip(tracks, errors)])


def shares(
    first: pd.DataFrame, last: pd.DataFrame, floor: pd.DataFrame, quantity: str, seed: int = 0
) -> list[dict[str, float | None]]:
    """Share of the removable squared error that is gone, by horizon, with its interval (95 %) over resampled blocks.

    "removable": share of the old squared error above the floor; "value" is None where that is less than a tenth
    """
    rng = np.random.default_rng(seed)
    rows = []
    for horizon, old in first.groupby("horizon"):
        number = blocks_of(old)
        sums = [
            np.bincount(number, weights=finite(t.loc[t["horizon"] == horizon, quantity]) ** 2)
            for t in (first, last, floor)
        ]
        was, now, least = (s.sum() for s in sums)
        least = min(least, now)
        row = {"quantity": quantity, "horizon": float(horizon), "removable": float(1.0 - least / max(was, 1e-300)),
               "value": None, "low": None, "high": None}  # fmt: skip
        if least < HOLDS * was:
            picks = rng.integers(0, len(sums[0]), (DRAWS, len(sums[0])))
            a, b, c = (part[picks].sum(axis=1) for part in sums)
            # of a few blocks what can be removed may be next to nothing
            some = np.maximum(a - np.minimum(c, b), 0.5 * row["removable"] * np.maximum(a, 1e-3 * was))
            draws = (a - b) / some
            low, high = np.quantile(draws, [0.025, 0.975])
            row |= {"value": float((was - now) / (was - least)), "low": float(low), "high": float(high)}
        rows.append(row)
    return rows


def worth(rolled: Mapping[str, Any], old: Errors, channels: Sequence[str], horizons: Sequence[float]) -> list[dict]:
    """What a cause is worth in the velocity or rate along each of its channels, by line and horizon.

    rolled  of `score`; old  errors with the cause left out; channels  names of forces and moments
    Rows of `shares` with "line" and "moved", the mean square of what the cause moves over that of the old error.
    """
    rows = []
    for line in LINES:
        new = rolled["errors"]["after"][line]
        tables = [end_table(rolled["tracks"], old[line], horizons)]
        tables += [rolled["ends"][word][line] for word in ("after", "noise_floor")]
        for channel in channels:
            place = COLUMN[channel]
            for j, row in enumerate(shares(*tables, CHANNELS[channel])):
                first, last = (np.concatenate([e[:, j, place] for e in of]) for of in (old[line], new))
                moved = np.nanmean((first - last) ** 2) / max(np.nanmean(first**2), 1e-300)
                rows.append({**row, "line": line, "moved": float(moved)})
    return rows


def score(
    model: Model, extended: Model, flights: Mapping[str, pd.DataFrame], held: Sequence[Evidence],
    horizons: Sequence[float], floor: Residual | None, wrong: Model | None,
    yardstick: Residual | None,
) -> dict[str, Any]:  # fmt: skip
    """End errors with measured rotor speeds, plain and with trim, and with commands; overlays of windows.

    floor  what everything together leaves of a flight's wrench; wrong  the model with the best wrong cause alone;
    yardstick  what the polynomial leaves
    Returns "tracks"; "errors" {word: Errors}; "ends" {word: {line: table}}; "rms" {word: {line: {quantity: {horizon:
    value}}}}; "fell" {line: rows}; "R_errors" and "R_overlays", tables.
    """
    tracks, parts = tracks_of(held, flights, horizons), []
    left = after(extended, model)
    errors = {"before": simulated_errors(tracks, model, model)}
    errors["after"] = simulated_errors(tracks, extended, model)
    if floor is not None:
        errors["noise_floor"] = moved_errors(tracks, errors["after"], left, floor)
    if wrong is not None:
        errors["best_wrong_cause"] = simulated_errors(tracks, wrong, model)
    if yardstick is not None:
        errors["generic_polynomial"] = moved_errors(tracks, errors["before"], before, yardstick)
    whole: dict[str, Any] = {"fell": {}, "rms": {}, "tracks": tracks, "errors": errors}
    whole["ends"] = {w: {k: end_table(tracks, e, horizons) for k, e in of.items()}
                     for w, of in errors.items() if tracks}  # fmt: skip
    ready = [flight_of(e.key, flights[e.key]) for e in held]
    for word, of in (("before", model), ("after", extended)):
        told = end_errors(of, ready, horizons, TOLD)
        if len(told):
            whole["ends"].setdefault(word, {})[TOLD] = told
    for word, of in whole["ends"].items():
        whole["rms"][word] = {line: rms(table) for line, table in of.items()}
        parts += [table.assign(driven=line, model=word) for line, table in of.items()]
    for line, least in whole["rms"].get("noise_floor", {}).items():
        new = whole["rms"]["after"][line]
        whole["rms"]["noise_floor"][line] = {
            q: {h: min(v, new[q][h]) for h, v in by.items()} for q, by in least.items()
        }
    for line, old in whole["ends"].get("before", {}).items():
        whole["fell"][line] = fell(old, whole["ends"]["after"][line])
    if parts:
        whole["R_errors"] = pd.concat(parts, ignore_index=True)
        whole["R_overlays"] = overlays({"before": model, "after": extended}, ready, max(horizons))
    return whole
