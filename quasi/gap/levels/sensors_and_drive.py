"""Sensors, frames, clocks and the rotors' drive, settled before anything aerodynamic."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import norm

from quasi.errors import DataError
from quasi.gap.effect import Effect
from quasi.gap.flights.level import Flown, Level, cause_of
from quasi.gap.levels import imu_or_markers, rotor_order
from quasi.gap.levels.corrections import corrected_at_import, document
from quasi.gap.levels.drive import held_out as drive_held_out
from quasi.gap.levels.drive import identify as drive_level
from quasi.gap.levels.sensors import held_out as sensor_held_out
from quasi.gap.levels.sensors import identify as sensor_level
from quasi.gap.levels.sensors.columns import SENSED_CHANNELS
from quasi.gap.levels.tie_breaking import Process, settle
from quasi.model.columns import ROTORS
from quasi.model.model import Model
from quasi.tables import COLUMNS

SEARCHES = 4  # that share the false alarm rate: sensors, drive and forces, and for what no cause explains
FAINTEST = 4.0  # |t| of what chance makes look like a cause
CHANNEL_UNITS = {
    "p": "rad/s", "q": "rad/s", "r": "rad/s", "ax": "m/s2", "ay": "m/s2", "az": "m/s2", "Fx": "N", "Fy": "N",
    "Fz": "N", "Mx": "N m", "My": "N m", "Mz": "N m", "w1": "rad/s", "w2": "rad/s", "w3": "rad/s", "w4": "rad/s",
    "height": "m", "speed": "m/s", "volts": "V", "frequency": "Hz", "rotor": "rad/s", "heading": "rad", "time": "s",
    "position": "m", "velocity": "m/s", "attitude": "rad", "rate": "rad/s", "horizon": "s", "start": "s", "room": "m",
    "roll_rate": "rad/s", "pitch_rate": "rad/s", "yaw_rate": "rad/s",
    "forward_speed": "m/s", "sideways_speed": "m/s", "downward_speed": "m/s",
}  # fmt: skip


def examine(
    flights: Sequence[Flown], model: Mapping[str, Any], settings: Mapping[str, Any], effects: Mapping[str, Effect],
    process: Process | None = None, held: int = 0,
) -> tuple[dict[str, Any], list[Level]]:  # fmt: skip
    """The calibration of a gap with what both levels found as plain data under "levels", and the levels themselves.

    flights  those that may choose and fit; model  document; settings  of the gap, with "sessions"
              {flight: session} where they are known; effects  that are asked, by id
    process  imports and filters a flight anew with a calibration; without it ties stay ties
    held     how many flights that are held out will judge the names
    """
    rate = rate_of(settings["false alarm rate"], sum(f.compared for f in flights), held)
    # which of the two points sits elsewhere is asked of what the comparison of sensors takes for the IMU's
    arm = [imu_or_markers.IMU] if imu_or_markers.OFFSET in effects and imu_or_markers.IMU not in effects else []
    options = {"false alarm rate": rate, "effects": [*effects, *arm], "sessions": settings.get("sessions") or {}}
    order = None
    if rotor_order.ID in effects:
        order = rotor_order.find_rotor_order(flights, Model(model, "the compared model"))
    if order is not None:
        process = process and rotor_order.corrected_process(process, order)
        right = (lambda f: process(f, None)) if process else (lambda f: rotor_order.reorder(f, order.document()))
        flights = [right(f) if f.compared else f for f in flights]
    levels = [sensor_level.examine(flights, options), drive_level.examine(flights, model, options)]
    if imu_or_markers.OFFSET in effects:
        imu_or_markers.settle(levels[0], flights, Model(model, "the compared model"), effects, rate)
    if process is not None:
        settle(levels, flights, Model(model, "the compared model"), options["false alarm rate"], process)
    for level in levels:
        level.found_on = found_on(level, flights)
    calibration = document(levels)
    if order is not None:
        calibration["rotor order"] = order.document()
        calibration["compared"] |= order.calibration()
        calibration["notes"].append(rotor_order.note_of(order.document()))
    return {**calibration, "levels": {level.level: plain(level) for level in levels}}, levels


def rate_of(rate: float, compared: int, held: int) -> float:
    """The false alarm rate of one search, so that all searches together name something by chance at `rate`.

    A name also has to gain on the held-out flights, where any have a say. What chance made of `compared` flights with
    |t| is theta = |t| s sqrt(1/compared) for a spread s of single flights; it gains on `held` others when these show
    more than theta/2, which has the probability of a normal deviate above |t|/2 sqrt(held/compared).
    """
    passes = float(norm.sf(0.5 * FAINTEST * np.sqrt(held / max(compared, 1)))) if held else 1.0
    return rate / SEARCHES / max(passes, 1.0 / SEARCHES)


def found_on(level: Level, flights: Sequence[Flown]) -> dict[str, Any]:
    """What causes remove where they were found: {"channels", "healthy", "significance", "worth": {cause: largest
    share}}.

    flights  as they were before any calibration; the compared ones count
    """
    entries, compared = [*level.effects, *level.ties], [f for f in flights if f.compared]
    found = {}
    if entries and level.level == "sensors":
        found = sensor_held_out.gains(entries, compared, corrected=False)
    elif entries:
        found = drive_held_out.gains(entries, compared, level.healthy)
    return {
        "channels": list(SENSED_CHANNELS if level.level == "sensors" else ROTORS),
        "healthy": level.healthy,
        "significance": level.significance,
        "worth": {c: float(np.nanmax(g.removed)) for c, g in found.items() if np.isfinite(g.removed).any()},
    }


def reject_immaterial(
    levels: Mapping[str, Mapping[str, list[Any]]], first: Sequence[Flown], last: Sequence[Flown], share: float,
    stricter: float = 1.0,
) -> None:  # fmt: skip
    """Reject effects and ties of sensors and drive that remove too little error on held-out flights, or on the compared
    ones that they were found on, in place.

    levels  {"sensors", "drive": lists "effects", "ties", "candidates", "notes", and "found on"}, see `plain`
    first, last  held-out flights before and after the calibration; share  least share of some channel's removable error
    stricter  factor on the p-values that were asked, for what held-out flights cannot judge
    What is judged carries "removed": {channel: share}, and under "removed most of" the channel that loses the largest
    share of its whole error by it. The share counts where the error of all channels of the same
    unit falls: a value that makes rates worse is not confirmed by one axis of them.
    """
    for name, level in levels.items():
        entries = [*level["effects"], *level["ties"]]
        if not entries:
            continue
        about = level["found on"]
        try:
            found = (
                sensor_held_out.gains(entries, last) if name == "sensors"
                else drive_held_out.gains(entries, first, about["healthy"])
            )  # fmt: skip
        except DataError as error:
            level["notes"].append(f"whether {', '.join(map(_words, entries))} matter was not asked: {error}")
            continue
        for entry in entries:
            cause = cause_of(entry)
            if cause not in found:
                continue
            acts = [k for k, c in enumerate(about["channels"]) if name == "drive" or _acts(cause, c)]
            removed, most = found[cause].removed[acts], found[cause].most[acts]
            entry["removed"] = {about["channels"][k]: float(v) for k, v in zip(acts, removed) if np.isfinite(v)}
            if entry["removed"]:
                whole = np.where(np.isfinite(removed), found[cause].whole[acts], -np.inf)
                entry["removed most of"] = about["channels"][acts[int(np.argmax(whole))]]
            units = np.array([_unit_of(about["channels"][k]) for k in acts])
            grows = [found[cause].squares[acts][units == u].sum() < 0.0 for u in units]
            confirmed = np.where(grows, np.minimum(removed, 0.0), removed)
            hidden = not np.isfinite(removed).any()
            if hidden or (np.nanmax(confirmed) < share and np.nanmax(most) < share <= about["worth"].get(cause, 0.0)):
                entry["judged"] = False
                p = entry["evidence"].get("p") if "id" in entry else entry.get("p")
                least = stricter * about["significance"].get(entry["since"], np.inf)
                if p is not None and p >= least:
                    why = f"hardly shown by held-out flights, and p = {p:.2g} of the others is not below {least:.2g}"
                    _reject(level, entry, name, why)
                elif hidden and cause not in about["worth"]:
                    # a p-value alone: jolts of a rotor that its commands answer look like a lag of it
                    _reject(level, entry, name, "so small that noise hides it in the flights that it was found on, too")
                elif hidden:
                    level["notes"].append(
                        f"whether {_words(entry)} matters is unknown on held-out flights: noise hides what it does"
                    )
                else:
                    level["notes"].append(
                        f"held-out flights hardly excite {_words(entry)}; what it removes of their error is unknown"
                    )
            elif np.nanmax(confirmed) < share:
                _reject(level, entry, name, _too_little(np.nanmax(confirmed), share, "held-out flights"))
            elif (worth := about["worth"].get(cause, np.inf)) < share:
                # what held-out flights seem to gain by it is an error of their own session that happens to look alike
                _reject(level, entry, name, _too_little(worth, share, "the flights that it was found on"))


def _too_little(removed: float, share: float, where: str) -> str:
    removed = 100.0 * max(removed, 0.0)
    return f"there, but it removes {removed:.0f} % of the removable error on {where}, expected {100 * share:.0f} %"


def _reject(level: Mapping[str, list[Any]], entry: Mapping[str, Any], name: str, why: str) -> None:
    """Move an effect or a tie to the causes that were asked and are not named, with the reason."""
    level["effects" if "id" in entry else "ties"].remove(entry)
    wald = entry["evidence"].get("wald") if "id" in entry else entry.get("wald")
    level["candidates"] += [
        {"id": i, "since": entry["since"], "score": wald, "p": None, "why_not": why}
        for i in ([entry["id"]] if "id" in entry else entry["ids"])
    ]
    stays = "; the flights stay corrected for it" if corrected_at_import(cause_of(entry), name) else ""
    level["notes"].append(f"{_words(entry)} is {why}{stays}")


def _acts(cause: str, channel: str) -> bool:
    """Whether a cause of sensors acts on body rates (p, q, r) or on the specific force (channels in earth axes)."""
    shows = drive_level.CATALOGUE[cause].channels
    return "clock" in shows or bool(set(shows) & set("pqr") if channel in "pqr" else set(shows) - set("pqr"))


def _unit_of(channel: str) -> str:
    """What channels have in common whose squares can be added: rates, specific forces or rotor speeds."""
    return "rates" if channel in "pqr" else "speeds" if channel in ROTORS else "forces"


def _words(entry: Mapping[str, Any]) -> str:
    return entry["id"] if "id" in entry else " or ".join(entry["ids"])


def plain(level: Level) -> dict[str, Any]:
    """A level without its tables."""
    return {
        "effects": level.effects,
        "ties": level.ties,
        "findings": level.findings,
        "candidates": level.candidates,
        "cannot_be_asked": level.cannot_be_asked,
        "noise_floor": level.noise_floor,
        "notes": level.notes,
        "found on": level.found_on,
    }


def sensors_judged(flights: Sequence[Flown]) -> pd.DataFrame | None:
    """Table of "channels" of flights without a search of sensors: rms "before" and "floor" of each, if there are."""
    return sensor_level.examine(flights, {"false alarm rate": 0.01, "effects": []}).tables.get("channels")


def drive_errors(level: Mapping[str, Any], flights: Sequence[Flown]) -> dict[str, dict[str, float]]:
    """Errors of rotor speeds as `drive.held_out.rms_errors` states them, {} where nothing could be compared.

    level  of the drive, see `plain`; flights  held-out ones before any calibration
    """
    healthy = level["found on"].get("healthy")
    if not healthy:
        return {}
    corrected = [tie for tie in level["ties"] if corrected_at_import(cause_of(tie), "drive")]
    try:
        return drive_held_out.rms_errors([*level["effects"], *corrected], flights, healthy)
    except DataError:
        return {}


def units_of(table: pd.DataFrame) -> dict[str, tuple[str, str]]:
    """Units of the columns of a residual table, by the quantity that a name begins with."""
    return {
        name: (CHANNEL_UNITS.get(name, CHANNEL_UNITS.get(re.split("[_ ]", name)[0], "")), "")
        for name in table.columns
        if name not in COLUMNS
    }
