"""The whole diagnosis of a gap: what is wrong, why, what is left, and what the extended model gains; and its tables."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.gap.base_model import Worth, by_role, faked_axes, refit_loses, worth_after
from quasi.gap.catalogue import in_room
from quasi.gap.constant_loads import constant_force_ties, in_ties
from quasi.gap.effect import Effect, as_flown, room_of, vehicle_of
from quasi.gap.entries import (
    candidates,
    deviations,
    gain_entry,
    lower_effect,
    of_late_telemetry,
    tie_entry,
    wrench_effect,
)
from quasi.gap.flights.covariates import EVERYWHERE, HEADING
from quasi.gap.flights.evidence import RATE, Evidence
from quasi.gap.flights.gathering import gather_all
from quasi.gap.flights.level import Flown
from quasi.gap.flights.sessions import session_sentence
from quasi.gap.levels import rotor_order
from quasi.gap.levels.corrections import corrected_at_import
from quasi.gap.levels.forces import polynomial_baseline
from quasi.gap.levels.forces.case import Case
from quasi.gap.levels.forces.effect_size import acting
from quasi.gap.levels.forces.error_reduction import Squares, after, removed, wrench_squares
from quasi.gap.levels.forces.estimated_speeds import add_battery, with_estimated_speeds
from quasi.gap.levels.forces.findings import gusts
from quasi.gap.levels.forces.held_out import best_wrong, everything, gain_axes, made_of
from quasi.gap.levels.forces.identify import Found, examine
from quasi.gap.levels.forces.tables import wrench_tables
from quasi.gap.levels.rollouts import commanded, error_reduction, split_flights
from quasi.gap.levels.rollouts.confirmation import Settled
from quasi.gap.levels.rollouts.open_loop import HORIZON, MOVED_BY
from quasi.gap.levels.sensors_and_drive import rate_of, reject_immaterial
from quasi.gap.levels.trim_evidence import (
    contradicted_by_trim,
    gather_trim,
    trim_entries,
    unnamed_change,
    why_rotor_is_enough,
)
from quasi.gap.losses import correction_matters, drive_losses, with_own_terms
from quasi.gap.materiality import Cause
from quasi.gap.probability import add_probabilities
from quasi.gap.report.wording import summary
from quasi.gap.scores import scored
from quasi.gap.selection import SUSPECT
from quasi.gap.verdict import judge_causes, refused_changes, with_errors_beyond_references
from quasi.model.extensions import configured_mass
from quasi.model.model import AXES, Model

SCHEMA = "quasi.gap/3"
SAME_MASS = 1e-3  # share, resolution of a scale


@dataclass
class Diagnosis:
    """document "quasi.gap/3"; model  the extended model's document; tables  by name; found  all that the search in
    forces found."""

    document: dict[str, Any]
    model: dict[str, Any]
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    found: Found | None = None


def diagnose(
    model: Model,
    calibration: Mapping[str, Any],
    evidence: Mapping[str, Evidence],
    flights: Mapping[str, pd.DataFrame],
    roles: Mapping[str, str],
    effects: Mapping[str, Effect],
    settings: Mapping[str, Any],
    lower: tuple[Sequence[Flown], Sequence[Flown]],
    name: str,
    lost: Sequence[str] = (),
    references: str = "given",
) -> Diagnosis:
    """Compare a model with flights.

    calibration  what sensors and drive found, with "levels"; evidence, flights  by key, processed with that
    calibration,
    of the kind of force that the model predicts; roles {key: "compared", "held out", "reference"}
    settings     of the gap; lower  the held-out flights before and after calibration; name  of the gap
    lost         sentences on flights that could not be used
    references   "given", "training" where flights that made the model stand for reference flights, "none"
    """
    room, share = room_of(settings["room"]), settings["material share"]
    vehicle, effects = vehicle_of(model, room=room), in_room(effects, room)
    sessions = settings.get("sessions") or {}
    evidence = {k: replace(e, session=sessions.get(k, "")) for k, e in evidence.items()}
    own = made_of(model, [e for k, e in evidence.items() if roles[k] != "held out"])
    faked = faked_axes(calibration.get("causes", ()), effects) if own else ()
    loses = bool(faked) and refit_loses(model, by_role(evidence, roles), flights, vehicle, settings, faked)
    corrected = () if loses else faked
    base = worth_after(model, by_role(evidence, roles)["reference"], corrected).of_measured(evidence.values())
    positions = tuple(AXES.index(a) for a in base.excluded)
    evidence = {k: replace(e, excluded=positions) for k, e in evidence.items()}
    groups = by_role(evidence, roles)
    learning, held = [*groups["reference"], *groups["compared"]], groups["held out"]
    compared = [False] * len(groups["reference"]) + [True] * len(groups["compared"])
    levels, order = calibration["levels"], calibration.get("rotor order")
    effects, without_speeds = with_estimated_speeds(effects, model, [*learning, *held])
    asked_of_forces = {n for n, e in effects.items() if e.level == "forces"}
    if order:
        lower = ([rotor_order.reorder(f, order) for f in lower[0]], lower[1])
    rate, unheard = (rate_of(settings["false alarm rate"], sum(compared), n) for n in (len(held), 0))
    reject_immaterial(levels, *lower, share, unheard / rate)
    lists: dict[str, Any] = {
        "candidates": [],
        "unexplained": [],
        "cannot_be_asked": without_speeds,
        "notes": [*lost, *([rotor_order.note_of(order)] if order else [])],
    }
    lists["notes"] += [s for s in [session_sentence(sessions, roles)] if s]
    lists["notes"] += _weighed(model, [*groups["compared"], *held])
    if loses:
        lists["notes"].append(
            "fitting the model's own terms anew to the corrected flights would make held-out flights worse; the "
            "model keeps its terms"
        )
    # what import corrects is no part of the model: it would be taken off a second time
    driving = [e for e in levels["drive"]["effects"] if not corrected_at_import(e["id"], "drive")]
    drive = [(effects[e["id"]], deviations(effects[e["id"]], e["parameters"]))
             for e in driving if e["id"] in effects and effects[e["id"]].extension]  # fmt: skip
    always = [e["id"] for e in driving if e["since"] == "always"]
    trim = gather_trim(flights, roles, sessions, vehicle, {k: e.mass for k, e in evidence.items()})
    case = Case(model, effects, vehicle, learning, compared, held, flights, drive, corrected, settings, always, trim)
    unable = _unable(groups, roles, lost) or _unusable(base)
    silent = {
        n for n, e in effects.items() if e.level == "forces" and e.channels and set(e.channels) <= set(base.excluded)
    }
    why = f"only {', '.join(base.excluded)} could show this, and they were not used"
    lists["cannot_be_asked"] += [{"id": n, "why": why} for n in sorted(silent)] if not unable else []
    asked_of = {n: e for n, e in effects.items() if n not in silent}
    found, kept = None, []
    lives, restless = pd.DataFrame(), []
    settled = Settled([], [], {}, {}, [])
    if unable:
        asked = [n for n, e in effects.items() if e.level == "forces"]
        lists["cannot_be_asked"] += [{"id": n, "why": unable} for n in asked]
    else:
        found = examine(
            learning, compared, held, model, asked_of, vehicle, rate, share, settings["extended model ID"],
            f"gap {name}", unheard, partial(contradicted_by_trim, trim, mass=vehicle.mass),
        )  # fmt: skip
        settled, remains = judge_causes(case, found)
        kept = settled.causes
        lists["notes"] += settled.notes
        lists["candidates"] += candidates(found, settled, share)
        lists["cannot_be_asked"] += [{"id": n, "why": why} for n, why in found.lacking.items()]
    again = case.anew(kept)
    document = case.extended(kept, found and found.study, f"gap {name}", again)
    extended = Model(document, f"model {settings['extended model ID']}")
    left_of = case.left(extended, kept, found and found.study, again, roles)
    floor = None
    if found is not None:
        at = found.study.values[compared.index(True)]
        floor = everything(found.study, effects, vehicle, compared, at)
    yardsticks = _yardsticks(case, found, kept, levels, floor)
    rolled = error_reduction.score(model, extended, flights, held, settings["horizons"], yardsticks)
    causes = [*((c.effect, c.value) for c in kept), *drive]
    alike = groups["compared"] or learning  # what changed is no noise of the reference flights
    own = split_flights.judge(held, flights, alike, model, extended, causes, vehicle, settings["horizons"])
    gap, scores, errors = scored(model, extended, found, kept, held, yardsticks, rolled, lower, document)
    flown = as_flown(vehicle, groups["compared"])
    named = [wrench_effect(c, flown, settled) for c in kept]
    for effect in named:
        effect["judged"] = not any((effect["id"], effect["since"]) == (c.effect.id, c.since) for c in found.unjudged)
    if found is not None:
        _gains(case, named, kept, found, rolled, again, errors)
        for effect, cause in zip(named, kept):
            effect["acts"] = acting(cause, [*groups["compared"], *held], vehicle, effect["gain channel"])
        lists["unexplained"], lives, *_ = remains
        if not any(u["channel"][0] == "F" for u in lists["unexplained"]):
            restless = gusts(found.study, compared, [c.effect.id for c in kept])
        lists["unexplained"] = with_errors_beyond_references(lists["unexplained"], restless, case, settled, found)
        if not (lists["unexplained"] or restless or kept or found.ties):
            lists["unexplained"] += refused_changes(case, found)
    lower_effects = [lower_effect(e, level, gap) for level in ("sensors", "drive") for e in levels[level]["effects"]]
    lower_effects, shifted = of_late_telemetry(lower_effects)
    corrected_ones = [e for e in lower_effects if corrected_at_import(e["id"], e["level"])]
    if corrected_ones and not _correction_matters(model, lower, settings, positions):
        for effect in corrected_ones:
            effect["explains"] = False
    lower_effects += [rotor_order.effect_of(order)] if order else []
    # forces and moments settle a tie of the levels below by naming one of it
    named_ids = {e["id"] for e in named}
    ties = [t for level in ("sensors", "drive") for t in levels[level]["ties"] if not named_ids & set(t["ids"])]
    ties += [tie_entry(since, tie, effects, flown) for since, tie in (found.ties if found else [])]
    ties = add_battery(ties, effects)
    if found is not None:
        taken = [*(e["id"] for e in [*lower_effects, *named]), *(i for tie in ties for i in tie["ids"])]
        taken += ["rotor_effectiveness"] if why_rotor_is_enough(trim) else []
        ties += constant_force_ties(
            groups["compared"], groups["reference"], left_of, taken, effects,
            min(found.level.values()), share, _constants(lists["unexplained"]), _suspected(lists["candidates"]),
        )  # fmt: skip
        lists["unexplained"] = [u for u in lists["unexplained"] if not in_ties(u, ties)]
    for level in ("sensors", "drive"):
        lists["candidates"] += levels[level]["candidates"]
        lists["cannot_be_asked"] += [c for c in levels[level]["cannot_be_asked"] if c["id"] not in asked_of_forces]
        lists["notes"] += levels[level]["notes"]
    taken = [*(e["id"] for e in [*lower_effects, *named]), *(i for tie in ties for i in tie["ids"])]
    acting_on = {channel for e in named for channel in e["channels"]}
    named_by_trim, tied_by_trim = trim_entries(trim, taken, acting_on)
    lower_effects += named_by_trim
    ties += tied_by_trim
    trimmed = unnamed_change(trim, [*taken, *(e["id"] for e in named_by_trim)])
    lost_by = [*with_own_terms(settled.losses, model, extended, held, share), *drive_losses(gap)]
    result = {
        "schema": SCHEMA,
        "gap": gap,
        "model": settings["model"],
        "verdict": verdict_of(
            [*lower_effects, *named], ties, [*lists["unexplained"], *trimmed], unable, bool(base.excluded or lost_by)
        ),
        "summary": "",
        "base model": {
            "explained": dict(base.share),
            "excluded": list(base.excluded),
            "wrong": base.wrong,
            "sentence": base.sentence(),
        },
        "sessions": {k: sessions.get(k, "") for k in roles},
        "hover trim": trim.document,
        "losses": [{**loss._asdict(), "text": loss.sentence()} for loss in lost_by],
        "effects": sorted(
            [*lower_effects, *named],
            # what is new first: it is what a pilot asks for
            key=lambda e: (e["id"] != rotor_order.ID, e["since"] == "always", -float(e["evidence"].get("wald") or 0.0)),
        ),
        "ties": ties,
        "findings": [
            *trimmed,
            *(f for level in ("sensors", "drive") for f in levels[level]["findings"]),
            *shifted,
            *restless,
        ],
        **lists,
        "extended_model": settings["extended model ID"],
        "flights": dict(roles),
        "name": name,
        "unable": unable,
        "effects asked": settings.get("effects", "all"),
        "material share": share,
        "false alarm rate": settings["false alarm rate"],
        "horizons": list(settings["horizons"]),
        "rollouts": rolled["fell"],
        "halves": own,
        "fitted anew": found is not None and bool(again),
        "scores": scores,
        "calibration": {k: calibration[k] for k in ("compared", "reference", "causes", "notes") if k in calibration},
    }
    _since_when(result, references)
    add_probabilities(result)
    result["summary"] = summary(result, effects)
    tables = wrench_tables(evidence, roles, left_of)
    if len(lives):
        tables["forces_unexplained"] = lives
    tables |= {k: t for k, t in rolled.items() if isinstance(t, pd.DataFrame)}
    return Diagnosis(result, document, tables, found)


def _since_when(result: dict[str, Any], references: str) -> None:
    """Without reference flights of the user's choice nothing is reported as new; an entry states whether flights
    that made the model show the cause as well."""
    result["reference flights"] = references
    if references == "training":
        for part in ("effects", "ties", "candidates", "unexplained"):
            for entry in result[part]:
                if "since" in entry:
                    entry["in training flights"], entry["since"] = entry["since"] == "always", "always"


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


def count_found(drive: Sequence[tuple[Effect, Mapping[str, float]]]) -> int:
    """How many parameters of causes of the drive were found: a voltage that a map holds at accompanies one."""
    parameters = [e.parameters[name] for e, values in drive for name in values]
    return sum(p.typical is not None or p.neutral is not None for p in parameters)


def _yardsticks(
    case: Case, found: Found | None, kept: Sequence[Cause], levels: Mapping[str, Any],
    floor: Callable[[Evidence], np.ndarray] | None,
) -> error_reduction.Yardsticks:  # fmt: skip
    """What the gain is compared with: the floor, the best wrong causes, polynomials of the same size."""
    students = [e for e, flag in zip(case.learning, case.compared) if flag]
    sizes = [sum(len(c.value) for c in kept), count_found(case.drive)]
    wrong: dict[str, Model] = {}
    axes = list(range(len(AXES)))
    if kept:
        old, least = found.scores["before"], found.scores["noise_floor"]
        tied = {t.offer.cause for _, tie in found.ties for t in tie.tests}
        wrong, axes = best_wrong(case, found.study, kept, tied, old, least), gain_axes(kept, old, least)
    healthy, drive = levels["drive"]["found on"].get("healthy") or {}, [e.id for e, _ in case.drive]
    return error_reduction.Yardsticks(
        floor,
        wrong,
        polynomial_baseline.polynomial(students, sizes[0], axes) if kept else None,
        healthy.get("learned"),
        commanded.wrong_ones(healthy, drive, case.effects, case.model, case.vehicle) if kept or drive else {},
        polynomial_baseline.polynomial(students, sum(sizes)) if drive and students else None,
        [MOVED_BY[AXES[k]] for k in (range(len(AXES)) if drive else axes)],
    )


def _gains(
    case: Case, named: Sequence[dict[str, Any]], kept: Sequence[Cause], found: Found, rolled: Mapping[str, Any],
    again: Collection[str], best: tuple[Squares, Squares, np.ndarray] | None,
) -> None:  # fmt: skip
    """Fill in what each cause is worth, left out alone: of forces and moments, and of roll-outs in the quantities where
    it acts.

    The one figure of roll-outs is that of the quantity and line where it moves the simulation most compared with the
    error, after HORIZON or the nearest that there is. best  squared errors with all causes, at the floor, its mean
    """
    if "noise_floor" not in rolled["ends"]:
        return
    for entry, cause in zip(named, kept):
        old, without = rolled["errors"]["before"], case.model
        if len(kept) > 1 or again:
            rest = [c for c in kept if c is not cause]
            without = Model(case.extended(rest, found.study, "gap", again), "rest")
            old = error_reduction.simulated_errors(rolled["tracks"], without, case.model)
        if best is not None:
            entry |= gain_entry(cause, removed(wrench_squares(case.held, after(without, case.model)), *best))
        rows = error_reduction.worth(rolled, old, cause.effect.channels, case.settings["horizons"])
        known = [row for row in rows if row["value"] is not None]
        main = min(known, key=lambda row: (abs(row["horizon"] - HORIZON), -row["moved"]), default=None)
        entry["gain"]["rollout"] = main and main["value"]
        entry["rollout channel"] = main and main["quantity"]
        entry["rollout gain"] = main


def _constants(unexplained: Sequence[Mapping[str, Any]]) -> list[str]:
    """Axes on which held-out flights show a constant error; one of the room goes by the heading along the body's."""
    return [u["channel"] for u in unexplained if u["judged"] and u["where"] in (EVERYWHERE, HEADING)]


def _suspected(entries: Sequence[Mapping[str, Any]]) -> set[str]:
    """Causes of a change that are nearly significant."""
    return {c["id"] for c in entries if c["since"] == "changed" and c["p"] is not None and c["p"] < SUSPECT}


def _correction_matters(
    model: Model, lower: tuple[Sequence[Flown], Sequence[Flown]], settings: Mapping[str, Any],
    excluded: tuple[int, ...] = (),
) -> bool:  # fmt: skip
    """Whether correcting the sensors changes forces or simulations of held-out flights; taken to, where none judges.

    excluded  positions of axes that do not count
    """
    sides = []
    for flights in lower:
        read = {f.key: (f.filtered, f.filtered_metadata, f.airframe) for f in flights}
        try:
            evidence, _ = gather_all(read, model, RATE)
        except DataError:
            return True
        sides.append(([replace(e, excluded=excluded) for e in evidence.values()], {f.key: f.filtered for f in flights}))
    if not all(evidence for evidence, _ in sides):
        return True
    return correction_matters(model, *sides, settings["horizons"], settings["material share"])


def _unusable(base: Worth) -> str:
    """Why the base model is no ground for a comparison of forces and moments, "" for one that is."""
    if base.wrong:
        return f"the base model is unusable: {base.wrong}"
    if len(base.excluded) == len(AXES):
        return "the base model explains next to nothing of any axis; identify one that does"
    return ""


def verdict_of(
    effects: Sequence[Mapping[str, Any]], ties: Sequence[Any], left: Sequence[Any], unable: str = "",
    limited: bool = False,
) -> str:  # fmt: skip
    """In a word.

    unable   why forces and moments could not be asked: then nothing found is no agreement
    limited  whether axes were left out or the extension makes something worse: then nothing is fully explained
    A sensor finding that changes neither forces nor simulations ("explains" false) explains nothing.
    """
    explaining = [e for e in effects if e.get("explains", True)]
    if explaining:
        return "partly explained" if ties or left or unable or limited else "explained"
    if ties:
        return "partly explained"
    return "unexplained" if left else "not judged" if unable else "agrees"
