"""Whether what sensors and drive found matters: the share of the removable error that it removes on held-out flights.

What flights differ by anyway is taken off, before and after alike, but for the named causes' own columns: how much
those differ from flight to flight counts against them. The floor is what remains when everything that the level knows
is fitted to the flight itself. A cause is worth what leaving it out costs. It cannot be judged where the floor holds
nine tenths of the error of the channels that it acts on, and where held-out flights hardly excite it, though those that
it was found on do; then it keeps its name. A calibration stays as it is: it was fixed before the held-out flights were
looked at.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quasi.errors import DataError
from quasi.gap.flights.level import Flown, Level
from quasi.gap.levels.corrections import corrected_at_import
from quasi.gap.levels.drive import identify as drive_level
from quasi.gap.levels.drive.fit import NAMES, Belief, DriveFit, commanded, fit_drive
from quasi.gap.levels.sensors import identify as sensor_level
from quasi.gap.levels.sensors.columns import CHANNELS, Weak, corrected_already, weak_form
from quasi.gap.levels.sensors.products import blocks_of, least_squares, whitener_of
from quasi.model.columns import ROTORS

DROWNED = 0.1  # a channel whose floor holds all but this share of its error tells no share


class Side(NamedTuple):
    """Errors of one flight: before (n, C), at its floor (n, C); columns (n, C, P) of what causes move."""

    before: np.ndarray
    floor: np.ndarray
    columns: np.ndarray


class Worth(NamedTuple):
    """Per channel (C,), as shares of the removable error: what a cause removes, and what it could remove at most.

    NaN where the floor holds nearly all of the error.
    """

    removed: np.ndarray
    most: np.ndarray


def worth(sides: Sequence[Side], sizes: Mapping[str, np.ndarray]) -> dict[str, Worth]:
    """What each cause removes that all others leave. sizes {cause: (P,) values of the columns}."""
    rows = sum(len(s.before) for s in sides)

    def mean(parts: Sequence[np.ndarray]) -> np.ndarray:
        return sum((p**2).sum(axis=0) for p in parts) / rows

    before = mean([s.before for s in sides])
    above = before - mean([s.floor for s in sides])
    moves = {c: [s.columns @ v for s in sides] for c, v in sizes.items()}
    after = [s.before - sum(m[k] for m in moves.values()) for k, s in enumerate(sides)]
    left = mean(after)
    found = {}
    for cause, own in moves.items():
        # a cause that is not there leaves nothing to remove, but would do harm of its own size
        most = mean(own)
        removable = np.maximum(above, most)
        removable = np.where(removable > DROWNED * before, removable, np.nan)
        found[cause] = Worth((mean([a + m for a, m in zip(after, own)]) - left) / removable, most / removable)
    return found


def judge(
    levels: Mapping[str, Mapping[str, list[Any]]], first: Sequence[Flown], last: Sequence[Flown], share: float
) -> None:
    """Reject effects and ties of sensors and drive that remove too little error on held-out flights, in place.

    levels  {"sensors", "drive": lists "effects", "ties", "candidates", "notes", and "found on"}, see
            `sensors_and_drive.plain`
    first, last  held-out flights before and after the calibration; share  least share of some channel's removable error
    What is judged carries "removed": {channel: share}.
    """
    for name, level in levels.items():
        entries = [*level["effects"], *level["ties"]]
        if not entries:
            continue
        about = level["found on"]
        try:
            shown = (
                kinematic_worth(entries, last) if name == "sensors" else drive_worth(entries, first, about["healthy"])
            )
        except DataError as error:
            level["notes"].append(f"whether {', '.join(map(_called, entries))} matter was not asked: {error}")
            continue
        for entry in entries:
            key = _cause(entry)
            if key not in shown:
                continue
            acts = [k for k, c in enumerate(about["channels"]) if name == "drive" or _acts(key, c)]
            removed, most = shown[key].removed[acts], shown[key].most[acts]
            entry["removed"] = {about["channels"][k]: float(v) for k, v in zip(acts, removed) if np.isfinite(v)}
            if not np.isfinite(removed).any():
                level["notes"].append(
                    f"whether {_called(entry)} matters cannot be told on held-out flights: noise hides what it does"
                )
                continue
            if np.nanmax(removed) >= share:
                continue
            if np.nanmax(most) < share <= about["worth"].get(key, 0.0):
                level["notes"].append(
                    f"held-out flights hardly excite {_called(entry)}; what it removes of their error cannot be told"
                )
                continue
            level["effects" if "id" in entry else "ties"].remove(entry)
            why = (
                f"there, but it removes {100 * max(np.nanmax(removed), 0.0):.0f} % of the removable error on "
                f"held-out flights, expected {100 * share:.0f} %"
            )
            level["candidates"] += [
                {"id": i, "since": entry["since"], "score": _wald(entry), "p": None, "why_not": why}
                for i in ([entry["id"]] if "id" in entry else entry["ids"])
            ]
            stays = "; the flights stay corrected for it" if corrected_at_import(key, name) else ""
            level["notes"].append(f"{_called(entry)} is {why}{stays}")


def found_on(level: Level, flights: Sequence[Flown]) -> dict[str, Any]:
    """What causes are worth where they were found: {"channels", "healthy", "worth": {cause: largest share}}.

    flights  as they were before any calibration; the compared ones count
    """
    entries, compared = [*level.effects, *level.ties], [f for f in flights if f.compared]
    found: dict[str, Worth] = {}
    if entries and level.level == "sensors":
        found = kinematic_worth(entries, compared, corrected=False)
    elif entries:
        found = drive_worth(entries, compared, level.healthy)
    return {
        "channels": list(CHANNELS if level.level == "sensors" else ROTORS),
        "healthy": level.healthy,
        "worth": {c: float(np.nanmax(w.removed)) for c, w in found.items() if np.isfinite(w.removed).any()},
    }


def kinematic_worth(
    entries: Sequence[Mapping[str, Any]], flights: Sequence[Flown], corrected: bool = True
) -> dict[str, Worth]:
    """What causes of sensors remove, or would remove where import cannot correct them.

    flights  with capture, processed with the calibration or (not corrected) without

    Raises DataError when no flight can be compared with its capture.
    """
    sides: list[Side] = []
    sizes: dict[str, np.ndarray] = {}
    said = None
    for flown in flights:
        try:
            weak = weak_form(flown)
            own = {c for e in entries for c in (e["ids"] if "ids" in e else [e["id"]])}
            columns = weak.columns @ _without_nuisances(weak, own)
        except DataError as error:
            said = error
            continue
        place = {n: k for k, n in enumerate(weak.names)}
        sizes = {_cause(e): _in_columns(e, place) for e in entries}
        told = corrected_already(flown, weak.names)
        told[0] = 1.0
        if corrected:  # what import took off is added again; it takes off none but what it can correct
            told = told + sum(v for c, v in sizes.items() if corrected_at_import(c, "sensors"))
        floor = weak.columns[:, :, 0] - weak.columns[:, :, 1:] @ least_squares(weak.columns)
        sides.append(Side(columns @ told, floor, columns))
    if not sides:
        raise said or DataError("no flight is held out")
    return worth(sides, sizes)


def _without_nuisances(weak: Weak, own: set[str]) -> np.ndarray:
    """(P, P): columns times this have the flight's usual nuisances taken off, all but those of the `own` causes."""
    own = own | ({"imu_lever_arm"} if "marker_offset" in own else set())
    of = [n.split(".")[0] for n in weak.names]
    spread = {
        k: sensor_level.SPREAD[c] for k, c in enumerate(of) if k > 0 and c in sensor_level.SPREAD and c not in own
    }
    return _taken_off(blocks_of(weak, whitener_of(weak)).sum(axis=0), spread)


def _usual(fit: DriveFit, reference: Belief, own: set[str]) -> np.ndarray:
    """(11, 11), alike, of a drive's constants."""
    named = {n for c in own for n in drive_level.CAUSES.get(c, ())} | ({"delay"} if own & drive_level.LATE else set())
    scale = {"up": reference.values[0], "down": reference.values[1]}
    spread = {
        k: drive_level.SPREAD[n] * scale.get(n, 1.0)
        for k, n in enumerate(NAMES)
        if n in drive_level.SPREAD and n not in named
    }
    return _taken_off(np.linalg.inv(fit.covariance()), spread)


def _taken_off(information: np.ndarray, spread: Mapping[int, float]) -> np.ndarray:
    """(P, P) that takes off the best values of the columns in `spread`, held by these standard deviations."""
    place = list(spread)
    weight = np.diag([v**-2.0 for v in spread.values()])
    kept = np.eye(len(information))
    kept[place] -= np.linalg.solve(information[np.ix_(place, place)] + weight, information[place])
    return kept


def drive_worth(
    entries: Sequence[Mapping[str, Any]], flights: Sequence[Flown], healthy: Mapping[str, Any]
) -> dict[str, Worth]:
    """What causes of the drive remove. flights  before any calibration; healthy  {"values", "voltage"} compared with.

    Raises DataError when no flight has commands and rotor speeds enough.
    """
    reference = Belief(np.array(healthy["values"], float), healthy["voltage"])
    sides, said = [], None
    for flown in flights:
        try:
            fit = fit_drive(flown, commanded(flown), reference)
        except DataError as error:
            said = error
            continue
        usual = _usual(fit, reference, {c for e in entries for c in (e["ids"] if "ids" in e else [e["id"]])})
        slopes = fit.slopes @ usual
        apart = drive_level.whole(flown, fit) - reference.values
        sides.append(Side(fit.residual + slopes @ apart, fit.residual, slopes))
    if not sides:
        raise said or DataError("no flight is held out")
    return worth(sides, {_cause(e): _of_drive(e, reference.values) for e in entries})


def _cause(entry: Mapping[str, Any]) -> str:
    """The cause of an effect; of a tie, the one that the flights were corrected for."""
    return entry["id"] if "id" in entry else entry["ids"][0]


def _acts(cause: str, channel: str) -> bool:
    """Whether a cause of sensors acts on body rates (p, q, r) or on the specific force (channels in earth axes)."""
    shows = drive_level.CATALOGUE[cause].channels
    return "clock" in shows or bool(set(shows) & set("pqr") if channel in "pqr" else set(shows) - set("pqr"))


def _called(entry: Mapping[str, Any]) -> str:
    return entry["id"] if "id" in entry else " or ".join(entry["ids"])


def _stated(entry: Mapping[str, Any]) -> dict[str, float]:
    parameters = entry["parameters"] if "id" in entry else entry["parameters"][_cause(entry)]
    return {n: p["value"] for n, p in parameters.items()}


def _wald(entry: Mapping[str, Any]) -> float | None:
    return entry["evidence"].get("wald") if "id" in entry else entry.get("wald")


def _in_columns(entry: Mapping[str, Any], place: Mapping[str, int]) -> np.ndarray:
    """Values (P,) of the kinematic columns; markers that sit elsewhere look like an IMU that sits the other way."""
    cause, stated, sign = _cause(entry), _stated(entry), 1.0
    if cause == "marker_offset":
        cause, sign = "imu_lever_arm", -1.0
    values = np.zeros(len(place))
    for label, value in zip(sensor_level.CAUSES[cause].parameters, sensor_level.size_of(cause, stated)):
        if f"{cause}.{label}" in place:
            values[place[f"{cause}.{label}"]] = sign * value
    return values


def _of_drive(entry: Mapping[str, Any], healthy: np.ndarray) -> np.ndarray:
    """Values (11,) of the drive's constants, as deviations from healthy ones."""
    cause, stated = _cause(entry), _stated(entry)
    size = np.zeros(len(NAMES))
    if cause == "motor_lag":
        size[:2] = [entry["evidence"][n] - healthy[k] for k, n in enumerate(("up", "down"))]
    elif cause == "battery_sag":
        size[6] = stated["exponent"] - healthy[6]
    else:
        size[2] = stated["delay"]
    return size
