"""The whole diagnosis of a gap: what is wrong, why, what is left, and what the extended model gains; and its tables."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.gap.constant_loads import constant_force_ties, in_ties
from quasi.gap.effect import Effect, as_flown
from quasi.gap.entries import (
    candidates,
    gain_entry,
    lower_effect,
    of_late_telemetry,
    tie_entry,
    wrench_effect,
)
from quasi.gap.flights.covariates import EVERYWHERE, HEADING
from quasi.gap.flights.evidence import RATE, Evidence
from quasi.gap.flights.gathering import gather_all
from quasi.gap.flights.level import Flown, cause_of
from quasi.gap.levels import rotor_order
from quasi.gap.levels.corrections import corrected_at_import
from quasi.gap.levels.forces import polynomial_baseline
from quasi.gap.levels.forces.case import Case
from quasi.gap.levels.forces.effect_size import acting
from quasi.gap.levels.forces.error_reduction import Squares, after, removed, wrench_squares
from quasi.gap.levels.forces.estimated_speeds import add_battery
from quasi.gap.levels.forces.findings import gusts
from quasi.gap.levels.forces.held_out import best_wrong, everything, gain_axes
from quasi.gap.levels.forces.identify import Found, examine
from quasi.gap.levels.forces.tables import wrench_tables
from quasi.gap.levels.rollouts import commanded, error_reduction, split_flights
from quasi.gap.levels.rollouts.confirmation import Settled
from quasi.gap.levels.rollouts.open_loop import HORIZON, MOVED_BY
from quasi.gap.levels.trim_evidence import (
    contradicted_by_trim,
    is_unanswered,
    trim_entries,
    unnamed_change,
    why_rotor_is_enough,
)
from quasi.gap.losses import correction_matters, drive_losses, with_own_terms
from quasi.gap.materiality import Cause
from quasi.gap.preparation import LOWER_LEVELS, Prepared, prepare
from quasi.gap.probability import add_probabilities
from quasi.gap.report.wording import summary
from quasi.gap.scores import scored
from quasi.gap.selection import SUSPECT
from quasi.gap.verdict import judge_causes, refused_changes, with_errors_beyond_references
from quasi.model.model import AXES, Model

SCHEMA = "quasi.gap/3"


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
    given = prepare(model, calibration, evidence, flights, roles, effects, settings, lower, lost)
    forces = _ask_forces(given, name)
    extension = _extend(given, forces, name)
    named = _named(given, forces, extension)
    below, shifted = _of_levels_below(given, extension.gap)
    ties = _ties(given, forces, extension, [*below, *named], named)
    _add_levels_below(given)
    taken = [
        *(e["id"] for e in [*below, *named]),
        *(i for tie in ties if tie.get("explains", True) for i in tie["ids"]),
    ]
    by_trim, tied_by_trim = trim_entries(given.case.trim, taken, {c for e in named for c in e["channels"]})
    trimmed = unnamed_change(given.case.trim, [*taken, *(e["id"] for e in by_trim)], bool(named or ties))
    entries = {"effects": [*below, *by_trim, *named], "ties": [*ties, *tied_by_trim]}
    findings = [
        *trimmed,
        *(f for level in LOWER_LEVELS for f in given.levels[level]["findings"]),
        *shifted,
        *forces.restless,
    ]
    result = _document(given, forces, extension, entries, findings, bool(trimmed)) | {
        "flights": dict(roles),
        "name": name,
        "calibration": {k: calibration[k] for k in ("compared", "reference", "causes", "notes") if k in calibration},
    }
    _since_when(result, references)
    add_probabilities(result)
    result["summary"] = summary(result, given.case.effects)
    tables = wrench_tables(given.evidence, roles, extension.left)
    if len(forces.lives):
        tables["forces_unexplained"] = forces.lives
    tables |= {k: t for k, t in extension.rolled.items() if isinstance(t, pd.DataFrame)}
    return Diagnosis(result, extension.document, tables, forces.found)


class Forces(NamedTuple):
    """What the search in forces and moments gave.

    found, settled  what it found and what is kept of it, None and empty where it could not be asked; lives  table of
    what no cause explains along its places; restless  findings on gusts
    """

    found: Found | None
    settled: Settled
    lives: pd.DataFrame
    restless: list[dict[str, Any]]


class Extension(NamedTuple):
    """The extended model and what it gains.

    document   of the extended model; model  made of it; anew  axes whose own terms were fitted anew
    left       flight -> (n, 6), its residual; rolled  its roll-outs; halves  held-out flights split in two
    gap, scores, errors  see `quasi.gap.scores.scored`
    """

    document: dict[str, Any]
    model: Model
    anew: Collection[str]
    left: Callable[[Evidence], np.ndarray]
    rolled: Mapping[str, Any]
    halves: Any
    gap: dict[str, Any]
    scores: dict[str, Any]
    errors: tuple[Squares, Squares, np.ndarray] | None


def _ask_forces(given: Prepared, name: str) -> Forces:
    """Search forces and moments for causes, and settle what is found; the lists of the diagnosis are filled."""
    case, lists = given.case, given.lists
    if given.unable:
        asked = [n for n, e in case.effects.items() if e.level == "forces"]
        lists["cannot_be_asked"] += [{"id": n, "why": given.unable} for n in asked]
        return Forces(None, Settled([], [], {}, {}, []), pd.DataFrame(), [])
    share = case.settings["material share"]
    found = examine(
        case.learning, case.compared, case.held, case.model, given.asked_of, case.vehicle, given.rate, share,
        case.settings["extended model ID"], f"gap {name}", given.unheard,
        partial(contradicted_by_trim, case.trim, mass=case.vehicle.mass),
    )  # fmt: skip
    settled, (unexplained, lives, *_) = judge_causes(case, found)
    lists["notes"] += settled.notes
    lists["candidates"] += candidates(found, settled, share)
    lists["cannot_be_asked"] += [{"id": n, "why": why} for n, why in found.lacking.items()]
    restless = []
    if not any(u["channel"][0] == "F" for u in unexplained):
        restless = gusts(found.study, case.compared, [c.effect.id for c in settled.causes])
    lists["unexplained"] = with_errors_beyond_references(unexplained, restless, case, settled, found)
    if not (lists["unexplained"] or restless or settled.causes or found.ties):
        lists["unexplained"] += refused_changes(case, found)
    return Forces(found, settled, lives, restless)


def _extend(given: Prepared, forces: Forces, name: str) -> Extension:
    """Extend the model by the causes that are kept, and measure what that gains on held-out flights."""
    case, found, kept = given.case, forces.found, forces.settled.causes
    settings, study = case.settings, forces.found and forces.found.study
    anew = case.anew(kept)
    document = case.extended(kept, study, f"gap {name}", anew)
    extended = Model(document, f"model {settings['extended model ID']}")
    floor = None
    if found is not None:
        at = study.values[case.compared.index(True)]
        floor = everything(study, case.effects, case.vehicle, case.compared, at)
    yardsticks = _yardsticks(case, found, kept, given.levels, floor)
    horizons = settings["horizons"]
    rolled = error_reduction.score(case.model, extended, case.tables, case.held, horizons, yardsticks)
    causes = [*((c.effect, c.value) for c in kept), *case.drive]
    alike = given.groups["compared"] or case.learning  # what changed is no noise of the reference flights
    halves = split_flights.judge(
        case.held, case.tables, alike, case.model, extended, causes, case.vehicle, horizons
    )  # fmt: skip
    judged = scored(
        case.model, extended, found, kept, case.held, yardsticks, rolled, given.lower, given.levels["drive"]
    )  # fmt: skip
    left = case.left(extended, kept, study, anew, given.roles)
    return Extension(document, extended, anew, left, rolled, halves, *judged)


def _named(given: Prepared, forces: Forces, extension: Extension) -> list[dict[str, Any]]:
    """Entries of the causes of forces and moments that are kept, with what each is worth."""
    case, found, kept = given.case, forces.found, forces.settled.causes
    flown = as_flown(case.vehicle, given.groups["compared"])
    named = [wrench_effect(c, flown, forces.settled) for c in kept]
    if found is None:
        return named
    for effect in named:
        effect["judged"] = not any((effect["id"], effect["since"]) == (c.effect.id, c.since) for c in found.unjudged)
    _gains(case, named, kept, found, extension.rolled, extension.anew, extension.errors)
    for effect, cause in zip(named, kept):
        effect["acts"] = acting(cause, [*given.groups["compared"], *case.held], case.vehicle, effect["gain channel"])
    return named


def _of_levels_below(given: Prepared, gap: Mapping[str, Any]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Entries of causes of sensors, drive and rotor order; and findings that late telemetry makes of some."""
    below = [lower_effect(e, level, gap) for level in LOWER_LEVELS for e in given.levels[level]["effects"]]
    below, shifted = of_late_telemetry(below)
    corrected = [e for e in below if corrected_at_import(e["id"], e["level"])]
    pairs = [(tie, level) for level in LOWER_LEVELS for tie in given.levels[level]["ties"]]
    corrected += [tie for tie, level in pairs if corrected_at_import(cause_of(tie), level)]
    excluded = tuple(AXES.index(a) for a in given.base.excluded)
    if corrected and not _correction_matters(given.case.model, given.lower, given.case.settings, excluded):
        for entry in corrected:
            entry["explains"] = False
    return below + ([rotor_order.effect_of(given.order)] if given.order else []), shifted


def _ties(
    given: Prepared, forces: Forces, extension: Extension, effects: Sequence[Mapping[str, Any]],
    named: Sequence[Mapping[str, Any]],
) -> list[dict[str, Any]]:  # fmt: skip
    """Ties of all levels, and those of constant forces, which then are not unexplained any more.

    effects  entries of all levels; named  those of forces and moments
    """
    case, found, lists = given.case, forces.found, given.lists
    # forces and moments settle a tie of the levels below by naming one of it
    named_ids = {e["id"] for e in named}
    ties = [t for level in LOWER_LEVELS for t in given.levels[level]["ties"] if not named_ids & set(t["ids"])]
    flown = as_flown(case.vehicle, given.groups["compared"])
    ties += [tie_entry(since, tie, case.effects, flown) for since, tie in (found.ties if found else [])]
    ties = add_battery(ties, case.effects)
    if found is None:
        return ties
    taken = [*(e["id"] for e in effects), *(i for tie in ties if tie.get("explains", True) for i in tie["ids"])]
    taken += ["rotor_effectiveness"] if why_rotor_is_enough(case.trim) else []
    ties += constant_force_ties(
        given.groups["compared"], given.groups["reference"], extension.left, taken, case.effects,
        min(found.level.values()), case.settings["material share"], _constants(lists["unexplained"]),
        _suspected(lists["candidates"]),
    )  # fmt: skip
    lists["unexplained"] = [u for u in lists["unexplained"] if not in_ties(u, ties)]
    return ties


def _add_levels_below(given: Prepared) -> None:
    """Add to the lists of the diagnosis what sensors and drive have to report."""
    of_forces = {n for n, e in given.case.effects.items() if e.level == "forces"}
    for level in LOWER_LEVELS:
        entries = given.levels[level]
        given.lists["candidates"] += entries["candidates"]
        given.lists["cannot_be_asked"] += [c for c in entries["cannot_be_asked"] if c["id"] not in of_forces]
        given.lists["notes"] += entries["notes"]


def _document(
    given: Prepared, forces: Forces, extension: Extension, entries: Mapping[str, Any], findings: Sequence[Any],
    trimmed: bool,
) -> dict[str, Any]:  # fmt: skip
    """The document of the diagnosis, without what a caller knows.

    entries  effects and ties; trimmed  whether the trim changed without a name
    """
    case, base, lists = given.case, given.base, given.lists
    settings, effects, ties = case.settings, entries["effects"], entries["ties"]
    lost_by = [
        *with_own_terms(forces.settled.losses, case.model, extension.model, case.held, settings["material share"]),
        *drive_losses(extension.gap),
    ]
    left = [*lists["unexplained"], *([trimmed] if trimmed else [])]
    likely = is_unanswered({"hover trim": case.trim.document, "effects": effects, "ties": ties})
    return {
        "schema": SCHEMA,
        "gap": extension.gap,
        "model": settings["model"],
        "verdict": verdict_of(effects, ties, left, given.unable, bool(base.excluded or lost_by), likely),
        "summary": "",
        "base model": {
            "explained": dict(base.share),
            "excluded": list(base.excluded),
            "wrong": base.wrong,
            "sentence": base.sentence(),
        },
        "sessions": {k: given.sessions.get(k, "") for k in given.roles},
        "hover trim": case.trim.document,
        "losses": [{**loss._asdict(), "text": loss.sentence()} for loss in lost_by],
        "effects": sorted(
            effects,
            # what is new first: it is what a pilot asks for
            key=lambda e: (e["id"] != rotor_order.ID, e["since"] == "always", -float(e["evidence"].get("wald") or 0.0)),
        ),
        "ties": ties,
        "findings": findings,
        **lists,
        "extended_model": settings["extended model ID"],
        "unable": given.unable,
        "effects asked": settings.get("effects", "all"),
        "material share": settings["material share"],
        "false alarm rate": settings["false alarm rate"],
        "horizons": list(settings["horizons"]),
        "rollouts": extension.rolled["fell"],
        "halves": extension.halves,
        "fitted anew": forces.found is not None and bool(extension.anew),
        "scores": extension.scores,
    }


def _since_when(result: dict[str, Any], references: str) -> None:
    """Without reference flights of the user's choice nothing is reported as new; an entry states whether flights
    that made the model show the cause as well."""
    result["reference flights"] = references
    if references == "training":
        for part in ("effects", "ties", "candidates", "unexplained"):
            for entry in result[part]:
                if "since" in entry:
                    entry["in training flights"], entry["since"] = entry["since"] == "always", "always"


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


def verdict_of(
    effects: Sequence[Mapping[str, Any]], ties: Sequence[Mapping[str, Any]], left: Sequence[Any], unable: str = "",
    limited: bool = False, likely: bool = False,
) -> str:  # fmt: skip
    """In a word.

    unable   why forces and moments could not be asked: then nothing found is no agreement
    limited  whether axes were left out or the extension makes something worse: then nothing is fully explained
    likely   whether the trim shows a change that is likelier than none and that nothing named answers: then nothing
             found is no agreement, and nothing is fully explained
    A sensor finding or tie that changes neither forces nor simulations ("explains" false) explains nothing.
    """
    explaining, ties = ([e for e in entries if e.get("explains", True)] for entries in (effects, ties))
    if explaining:
        return "partly explained" if ties or left or unable or limited or likely else "explained"
    if ties:
        return "partly explained"
    return "unexplained" if left else "not judged" if unable or likely else "agrees"
