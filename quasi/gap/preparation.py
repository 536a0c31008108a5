"""What a gap asks of its flights: the case, the axes and causes that count, and why forces cannot be asked."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from quasi.gap.base_model import Worth, by_role, faked_axes, refit_loses, worth_after
from quasi.gap.catalogue import in_room
from quasi.gap.effect import Effect, room_of, vehicle_of
from quasi.gap.entries import deviations
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.level import Flown
from quasi.gap.flights.sessions import session_sentence
from quasi.gap.levels import rotor_order
from quasi.gap.levels.corrections import corrected_at_import
from quasi.gap.levels.forces.case import Case
from quasi.gap.levels.forces.estimated_speeds import with_estimated_speeds
from quasi.gap.levels.forces.held_out import made_of
from quasi.gap.levels.sensors_and_drive import rate_of, reject_immaterial
from quasi.gap.levels.trim_evidence import gather_trim
from quasi.model.extensions import configured_mass
from quasi.model.model import AXES, Model

SAME_MASS = 1e-3  # share, resolution of a scale
LOWER_LEVELS = ("sensors", "drive")
TERMS_KEPT = (
    "fitting the model's own terms anew to the corrected flights would make held-out flights worse; the model keeps "
    "its terms"
)


@dataclass(frozen=True)
class Prepared:
    """What a diagnosis works on.

    case       the model, the flights and what acts on them; base  what the base model is worth, axis by axis
    roles      {key: role}; evidence, groups  flights by key, and by role; sessions {key: session}
    levels     what sensors and drive found; lower  held-out flights before and after calibration; order  of the rotors
    asked_of   causes that forces and moments are asked for; unable  why they cannot be asked at all, "" where they can
    rate       false alarm rate of each of the searches; unheard  the same where no held-out flight judges
    lists      candidates, unexplained, cannot_be_asked and notes of the diagnosis, to which its stages add
    """

    case: Case
    base: Worth
    roles: Mapping[str, str]
    evidence: Mapping[str, Evidence]
    groups: Mapping[str, Sequence[Evidence]]
    sessions: Mapping[str, str]
    levels: Mapping[str, Any]
    lower: tuple[Sequence[Flown], Sequence[Flown]]
    order: Any
    asked_of: Mapping[str, Effect]
    unable: str
    rate: float
    unheard: float
    lists: dict[str, list[Any]]


def prepare(
    model: Model, calibration: Mapping[str, Any], evidence: Mapping[str, Evidence], flights: Mapping[str, pd.DataFrame],
    roles: Mapping[str, str], effects: Mapping[str, Effect], settings: Mapping[str, Any],
    lower: tuple[Sequence[Flown], Sequence[Flown]], lost: Sequence[str],
) -> Prepared:  # fmt: skip
    """Settle what is asked, and of which axes. Arguments as of `quasi.gap.diagnosis.diagnose`."""
    room = room_of(settings["room"])
    vehicle, effects = vehicle_of(model, room=room), in_room(effects, room)
    sessions = settings.get("sessions") or {}
    evidence = {k: replace(e, session=sessions.get(k, "")) for k, e in evidence.items()}
    own = made_of(model, [e for k, e in evidence.items() if roles[k] != "held out"])
    faked = faked_axes(calibration.get("causes", ()), effects) if own else ()
    loses = bool(faked) and refit_loses(model, by_role(evidence, roles), flights, vehicle, settings, faked)
    corrected = () if loses else faked
    base = worth_after(model, by_role(evidence, roles)["reference"], corrected).of_measured(evidence.values())
    positions = tuple(AXES.index(a) for a in base.excluded)
    trim = gather_trim(flights, roles, sessions, vehicle, {k: e.mass for k, e in evidence.items()})
    evidence = {k: replace(e, excluded=positions, session_scales=trim.scales) for k, e in evidence.items()}
    groups = by_role(evidence, roles)
    learning, held = [*groups["reference"], *groups["compared"]], groups["held out"]
    compared = [False] * len(groups["reference"]) + [True] * len(groups["compared"])
    levels, order = calibration["levels"], calibration.get("rotor order")
    effects, lacking = with_estimated_speeds(effects, model, [*learning, *held])
    if order:
        lower = ([rotor_order.reorder(f, order) for f in lower[0]], lower[1])
    rate, unheard = (rate_of(settings["false alarm rate"], sum(compared), n) for n in (len(held), 0))
    reject_immaterial(levels, *lower, settings["material share"], unheard / rate)
    drive, always = _of_the_model(levels["drive"]["effects"], effects)
    case = Case(model, effects, vehicle, learning, compared, held, flights, drive, corrected, settings, always, trim)
    unable = _unable(groups, roles, lost) or _unusable(base)
    silent = sorted(
        n for n, e in effects.items() if e.level == "forces" and e.channels and set(e.channels) <= set(base.excluded)
    )
    why = f"only {', '.join(base.excluded)} could show this, and they were not used"
    notes = [
        *lost,
        *([rotor_order.note_of(order)] if order else []),
        *(s for s in [session_sentence(sessions, roles)] if s),
        *_weighed(model, [*groups["compared"], *held]),
        *([TERMS_KEPT] if loses else []),
    ]
    lists: dict[str, list[Any]] = {
        "candidates": [],
        "unexplained": [],
        "cannot_be_asked": lacking + ([] if unable else [{"id": n, "why": why} for n in silent]),
        "notes": notes,
    }
    asked_of = {n: e for n, e in effects.items() if n not in silent}
    return Prepared(
        case, base, roles, evidence, groups, sessions, levels, lower, order, asked_of, unable, rate, unheard, lists
    )


def _of_the_model(
    found: Sequence[Mapping[str, Any]], effects: Mapping[str, Effect]
) -> tuple[list[tuple[Effect, dict[str, float]]], list[str]]:
    """Causes of the drive that belong in the model, with their deviations; and ids of those that were always there."""
    # what import corrects is no part of the model: it would be taken off a second time
    driving = [e for e in found if not corrected_at_import(e["id"], "drive")]
    kept = [e for e in driving if e["id"] in effects and effects[e["id"]].extension]
    drive = [(effects[e["id"]], deviations(effects[e["id"]], e["parameters"])) for e in kept]
    return drive, [e["id"] for e in driving if e["since"] == "always"]


def _weighed(model: Model, flights: Sequence[Evidence]) -> list[str]:
    """A sentence on flights that were logged with another mass than the model's, where there are any."""
    own = configured_mass(model)
    other = {e.key: e.mass for e in flights if own and np.isfinite(e.mass) and abs(e.mass / own - 1.0) > SAME_MASS}
    if not other:
        return []
    masses = " and ".join(f"{m:.4g} kg" for m in sorted(set(other.values())))
    return [
        f"logged with {masses}, where the model knows {own:.4g} kg: {', '.join(other)}; simulations of flights take "
        "the logged mass, and the extended model keeps its own, with what was found on top"
    ]


def _unable(groups: Mapping[str, Sequence[Evidence]], roles: Mapping[str, str], lost: Sequence[str]) -> str:
    """Why causes of forces and moments cannot be distinguished, or nothing. lost  sentences on unusable flights"""

    def why(role: str) -> str:
        keys = [k for k, r in roles.items() if r == role]
        return next((s.split("; ")[0] for s in lost if any(f"flight {k} " in s for k in keys)), "")

    if len(groups["compared"]) < 2:
        count, because = len(groups["compared"]), why("compared")
        return (
            f"{count or 'no'} compared flight{'s' * (count != 1)} {'is' if count == 1 else 'are'} left to learn from"
            f"{f' ({because})' * bool(because)}, and a cause needs at least 2 in addition to those held out"
        )
    if not groups["held out"]:
        if "held out" in roles.values():
            because = why("held out") or "see the notes"
            return f"no held-out flight could be used ({because}); hold out another one, so that a gain is measured"
        return "no flight is held out, so that no gain can be measured; name one in 'rows of flights held out'"
    return ""


def _unusable(base: Worth) -> str:
    """Why the base model is no ground for a comparison of forces and moments, "" for one that is."""
    if base.wrong:
        return f"the base model is unusable: {base.wrong}"
    if len(base.excluded) == len(AXES):
        return "the base model explains next to nothing of any axis; identify one that does"
    return ""
