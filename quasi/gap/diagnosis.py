"""The whole diagnosis of a gap: what is wrong, why, what is left, and what the extended model gains; and its tables."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from quasi.gap import commanded, generic, halves, material, rollout_gain, unexplained
from quasi.gap.calibration import corrected_at_import
from quasi.gap.confirmation import CONFIRMED, REFUTED, Settled, settle
from quasi.gap.effect import Effect, Vehicle, room_of, vehicle_of
from quasi.gap.entries import (
    as_flown,
    candidates,
    deviations,
    gain_entry,
    lower_effect,
    needed,
    tie_entry,
    wrench_effect,
)
from quasi.gap.evidence import Evidence
from quasi.gap.extension import extend
from quasi.gap.gain import Squares, after, removed, wrench_squares
from quasi.gap.held_out import everything, made_of
from quasi.gap.level import Flown
from quasi.gap.lower import SEARCHES, rate_of
from quasi.gap.mixed import Offer
from quasi.gap.scores import scored
from quasi.gap.study import refit
from quasi.gap.wording import summary
from quasi.gap.worth import Cause
from quasi.gap.wrench import Found, examine
from quasi.gap.wrench_findings import gusts
from quasi.gap.wrench_tables import wrench_tables
from quasi.standalone.model import Model

SCHEMA = "quasi.gap/1"
FORCES = ("Fx", "Fy", "Fz")
HORIZON = 0.5  # s, at which a gain in roll-outs is told


@dataclass
class Diagnosis:
    """document "quasi.gap/1"; model  the extended model's document; tables  by name; found  all that level W found."""

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

    calibration  what levels K and A found, with "levels"; evidence, flights  by key, processed with that calibration,
    of the kind of force that the model predicts; roles {key: "compared", "held out", "reference"}
    settings     of the gap; lower  the held-out flights before and after calibration; name  of the gap
    lost         sentences on flights that could not be used
    references   "given", "training" where flights that made the model stand for reference flights, "none"
    """
    vehicle = vehicle_of(model, room=room_of(settings["room"]))
    ident = settings["extended model ID"]
    groups = {r: [e for k, e in evidence.items() if roles[k] == r] for r in ("reference", "compared", "held out")}
    learning = [*groups["reference"], *groups["compared"]]
    compared = [False] * len(groups["reference"]) + [True] * len(groups["compared"])
    held, share = groups["held out"], settings["material share"]
    rate = rate_of(settings["false alarm rate"], sum(compared), len(held))
    levels = calibration["levels"]
    material.judge(levels, *lower, share)
    said: dict[str, Any] = {"candidates": [], "unexplained": [], "cannot_be_asked": [], "notes": list(lost)}
    # what import corrects is no part of the model: it would be taken off a second time
    acting = [e for e in levels["A"]["effects"] if not corrected_at_import(e["id"], "A")]
    drive = [(effects[e["id"]], deviations(effects[e["id"]], e["parameters"]))
             for e in acting if e["id"] in effects and effects[e["id"]].extension]  # fmt: skip
    unable = _unable(groups, roles, lost)
    found, kept = None, []
    lives, restless = pd.DataFrame(), []
    settled = Settled([], [], {}, {}, None, [])
    if unable:
        asked = [n for n, e in effects.items() if e.level == "W"]
        said["cannot_be_asked"] += [{"id": n, "why": unable} for n in asked]
    else:
        unheard = rate_of(settings["false alarm rate"], sum(compared), 0)
        found = examine(learning, compared, held, model, effects, vehicle, rate, share, ident, f"gap {name}", unheard)
        sure = [c for c in found.causes if c.probability >= needed(c, found)]
        rare = [c for c in found.stand_ins if c.probability < needed(c, found)]
        unsure = {(c.effect.id, c.since) for c in rare}
        found.ties = [(since, t) for since, t in found.ties if (t.tests[0].offer.cause, since) not in unsure]
        settled = settle(found, sure, model, compared, effects, vehicle, held, flights)
        corrected = _corrected(model, calibration, learning)

        def made(causes: Sequence[Cause], again: bool) -> Model:
            return Model(_extended(model, causes, drive, found, compared, vehicle, ident, "trial", again), "trial")

        settled = _of_flights(settled, made, corrected, drive, held, flights, learning, model, vehicle, settings)
        if all(compared):
            settled = _borne_out(settled, share)

        def left_by(settled: Settled) -> unexplained.Left:
            residual = after(made(settled.causes, _anew(settled.causes) or corrected), model)
            return unexplained.search(
                learning, compared, held, _beside(found, settled, effects), residual, found.scores["noise_floor"],
                vehicle, settings["false alarm rate"] / SEARCHES, share,
            )  # fmt: skip

        settled, remains = _outdone(settled, found, left_by, compared, effects)
        kept = settled.causes
        said["notes"] += settled.notes
        said["candidates"] += candidates(found, settled, share)
        said["cannot_be_asked"] += [{"id": n, "why": why} for n, why in found.lacking.items()]
    again = _anew(kept) or _corrected(model, calibration, learning)
    document = _extended(model, kept, drive, found, compared, vehicle, ident, f"gap {name}", anew=again)
    extended = Model(document, f"model {ident}")
    students = [e for e, flag in zip(learning, compared) if flag]
    sizes = [sum(len(c.value) for c in kept), sum(len(v) for _, v in drive)]
    yardstick = generic.polynomial(students, sizes[0]) if kept else None
    wrong = _wrong_model(found, kept, model, compared, effects, vehicle) if kept else None
    floor = None
    if found is not None:
        at = found.study.values[compared.index(True)]
        floor = everything(found.study, effects, vehicle, compared, at)
    healthy = levels["A"]["found on"].get("healthy") or {}
    beside = rollout_gain.Beside(
        floor,
        {found.wrong: wrong} if wrong else {},
        yardstick,
        healthy.get("learned"),
        commanded.wrong_ones(healthy, [e.id for e, _ in drive], effects, model, vehicle) if kept or drive else {},
        generic.polynomial(students, sum(sizes)) if drive and students else None,
    )
    rolled = rollout_gain.score(model, extended, flights, held, settings["horizons"], beside)
    causes = [*((c.effect, c.value) for c in kept), *drive]
    own = halves.judge(held, flights, learning, model, extended, causes, vehicle, settings["horizons"])
    gap, scores, errors = scored(model, extended, found, kept, held, yardstick, floor, rolled, lower, document)
    flown = as_flown(vehicle, groups["compared"])
    effects_said = [wrench_effect(c, flown, settled) for c in kept]
    for effect in effects_said:
        effect["judged"] = not any((effect["id"], effect["since"]) == (c.effect.id, c.since) for c in found.unjudged)
    if found is not None:
        _gains(effects_said, kept, model, drive, found, compared, vehicle, settings["horizons"], rolled, again, held,
               errors)  # fmt: skip
        said["unexplained"], lives, *_ = remains
        if not any(u["channel"][0] == "F" for u in said["unexplained"]):
            restless = gusts(found.study, compared, [c.effect.id for c in kept])
    lower_effects = [lower_effect(e, level, gap) for level in ("K", "A") for e in levels[level]["effects"]]
    # forces and moments settle a tie of the levels below by naming one of it
    told = {e["id"] for e in effects_said}
    ties = [t for level in ("K", "A") for t in levels[level]["ties"] if not told & set(t["ids"])]
    ties += [tie_entry(since, tie, effects, flown) for since, tie in (found.ties if found else [])]
    for level in ("K", "A"):
        said["candidates"] += levels[level]["candidates"]
        said["cannot_be_asked"] += levels[level]["cannot_be_asked"]
        said["notes"] += levels[level]["notes"]
    result = {
        "schema": SCHEMA,
        "gap": gap,
        "model": settings["model"],
        "verdict": _verdict([*lower_effects, *effects_said], ties, said["unexplained"], unable),
        "summary": "",
        "effects": sorted([*lower_effects, *effects_said], key=lambda e: -float(e["evidence"].get("wald") or 0.0)),
        "ties": ties,
        "findings": [*(f for level in ("K", "A") for f in levels[level]["findings"]), *restless],
        **said,
        "extended_model": ident,
        "flights": dict(roles),
        "name": name,
        "unable": unable,
        "effects asked": settings.get("effects", "all"),
        "material share": share,
        "false alarm rate": settings["false alarm rate"],
        "horizons": list(settings["horizons"]),
        "rollouts": rolled["fell"],
        "halves": own,
        "fitted anew": found is not None and again,
        "scores": scores,
        "calibration": {k: calibration[k] for k in ("compared", "reference", "causes", "notes") if k in calibration},
    }
    _since_when(result, references)
    result["summary"] = summary(result, effects)
    tables = wrench_tables(evidence, roles, after(extended, model), vehicle)
    if len(lives):
        tables["W_unexplained"] = lives
    tables |= {k: t for k, t in rolled.items() if isinstance(t, pd.DataFrame)}
    return Diagnosis(result, document, tables, found)


def _since_when(result: dict[str, Any], references: str) -> None:
    """Without reference flights of the user's choice nothing is said to be new; whether flights that made the model
    show a cause as well stands beside it."""
    result["reference flights"] = references
    if references == "training":
        for part in ("effects", "ties", "candidates", "unexplained"):
            for entry in result[part]:
                if "since" in entry:
                    entry["in training flights"], entry["since"] = entry["since"] == "always", "always"


def _unable(groups: Mapping[str, Sequence[Evidence]], roles: Mapping[str, str], lost: Sequence[str]) -> str:
    """Why no force or moment can be told from another, or nothing. lost  sentences on flights that could not be used"""
    if len(groups["compared"]) < 2:
        count = len(groups["compared"])
        return (
            f"{count or 'no'} compared flight{'s' * (count != 1)} {'is' if count == 1 else 'are'} left to learn from, "
            "and a cause needs at least 2 beside those held out"
        )
    if not groups["held out"]:
        if "held out" in roles.values():
            keys = [k for k, role in roles.items() if role == "held out"]
            why = next(
                (said.split("; ")[0] for said in lost if any(f"flight {k} " in said for k in keys)), "see the notes"
            )
            return f"no held-out flight could be used ({why}); hold out another one, so that a gain is measured"
        return "no flight is held out, so that no gain can be measured; name one in 'rows of flights held out'"
    return ""


def _extended(
    model: Model, kept: Sequence[Cause], drive: Sequence[tuple[Effect, Mapping[str, float]]], found: Found | None,
    compared: Sequence[bool], vehicle: Vehicle, ident: str, where: str, anew: bool | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The extended model's document; the model's own terms are fitted anew beside causes that were always there.

    anew  whether they are in any case, or are not
    """
    changes = None
    if found is not None and (_anew(kept) if anew is None else anew):
        own = {(c.effect.id, c.since): {c.effect.fitted.index(n): v for n, v in c.value.items()} for c in kept}
        changes = refit(found.study, range(len(compared)), compared, own)
    document = extend(model, [*((c.effect, c.value) for c in kept), *drive], vehicle, ident, where, changes)
    document.pop("differential form", None)
    return document


def _of_flights(
    settled: Settled, made: Callable[[Sequence[Cause], bool], Model], corrected: bool, drive: Sequence,
    held: Sequence[Evidence], flights: Mapping[str, pd.DataFrame], learning: Sequence[Evidence], model: Model,
    vehicle: Vehicle, settings: Mapping[str, Any],
) -> Settled:  # fmt: skip
    """Causes that every flight has its own value of must lower the error of a held-out flight's second half, with the
    value that its first half tells; others lose their name."""
    horizon = min(settings["horizons"], key=lambda h: abs(h - HORIZON))
    for cause in settled.causes:
        if not any(cause.effect.parameters[n].scope == "f" for n in cause.value):
            continue
        again = _anew(settled.causes) or corrected
        rest = [c for c in settled.causes if c is not cause]
        sides = [(made(of, again), [*((c.effect, c.value) for c in of), *drive]) for of in (rest, settled.causes)]
        quantity = "velocity" if set(FORCES) & set(cause.effect.channels) else "rate"
        gone = halves.gain(held, flights, learning, model, sides, vehicle, quantity, horizon)
        if gone is None or gone > 0.0:
            continue
        why = (
            f"with the value that a held-out flight's first half tells, the simulated {quantity} of its second half "
            f"has {-100 * gone:.0f} % more squared error after {horizon:g} s than without it"
        )
        told = settled.confirmations[cause.effect.id, cause.since]._replace(outcome=REFUTED, why=why)
        settled = settled._replace(causes=rest, dropped=[*settled.dropped, (cause, told)])
    return settled


def _borne_out(settled: Settled, share: float) -> Settled:
    """Without what the model merely lacks of its own vehicle where the held-out flights do not gain the share by it and
    roll-outs do not confirm it either: only the flights that it was found on, left out in turn, speak for it then.
    """
    for cause in settled.causes:
        said, key = [v["value"] for v in cause.gain.values() if v["value"] is not None], (cause.effect.id, cause.since)
        told = settled.confirmations[key]
        if cause.effect.foreign or told.outcome == CONFIRMED or not said or max(said) >= share:
            continue
        told = told._replace(
            why=f"on the held-out flights it removes {100 * max(said):.0f} % of the removable error at most, expected "
            f"{100 * share:.0f} %, and roll-outs do not confirm it"
        )
        rest = [c for c in settled.causes if c is not cause]
        settled = settled._replace(causes=rest, dropped=[*settled.dropped, (cause, told)])
    return settled


def _beside(
    found: Found, settled: Settled, effects: Mapping[str, Effect]
) -> list[tuple[Effect, Offer, Mapping[str, float]]]:
    """Causes that what stays unexplained is asked beside: all that are there and not refuted, and those of ties."""
    refuted = [c for c, told in settled.dropped if told.outcome == REFUTED]
    accepted = [
        (c.effect, c.test.offer, c.value)
        for c in [*found.causes, *found.immaterial]
        if not any(c is r for r in refuted)
    ]
    return accepted + [(effects[t.tests[0].offer.cause], t.tests[0].offer, {}) for _, t in found.ties]


def _outdone(
    settled: Settled, found: Found, left_by: Callable[[Settled], unexplained.Left], compared: Sequence[bool],
    effects: Mapping[str, Effect],
) -> tuple[Settled, unexplained.Left]:  # fmt: skip
    """Without the names that roll-outs do not confirm and that give way to what no cause explains; and what that is."""
    while True:
        doubtful = [c for c in settled.causes if settled.confirmations[c.effect.id, c.since].outcome != CONFIRMED]
        left, offers = left_by(settled), [o for _, o, _ in _beside(found, settled, effects)]
        for cause in sorted(doubtful, key=lambda c: -c.test.p):
            level = found.level[cause.since]
            why = unexplained.outdone(left, compared, offers, cause.test.offer, cause.effect.channels, cause.test.p,
                                      level)  # fmt: skip
            if why:
                told = settled.confirmations[cause.effect.id, cause.since]._replace(outcome=REFUTED, why=why)
                rest = [c for c in settled.causes if c is not cause]
                settled = settled._replace(causes=rest, dropped=[*settled.dropped, (cause, told)])
                break
        else:
            return settled, left


def _anew(causes: Sequence[Cause]) -> bool:
    return any(c.since == "always" for c in causes)


def _corrected(model: Model, calibration: Mapping[str, Any], learning: Sequence[Evidence]) -> bool:
    """Whether flights that the model was identified from were corrected: its terms hold what their sensors faked."""
    always = any(c["since"] == "always" for c in calibration.get("causes", ()))
    return always and made_of(model, learning)


def _wrong_model(
    found: Found, kept: Sequence[Cause], model: Model, compared: Sequence[bool], effects: Mapping[str, Effect],
    vehicle: Vehicle,
) -> Model | None:  # fmt: skip
    """The model extended by the best wrong cause of level W alone."""
    if found.wrong is None:
        return None
    study, since, effect = found.study, kept[0].since, effects[found.wrong]
    mixed = study.mixed(range(len(compared)), compared)
    test = mixed.best(effect.id, since, (), mixed.pooled(since), effect.parts)
    values = {effect.fitted[k]: float(v) for k, v in zip(test.offer.which, test.value)}
    return Model(extend(model, [(effect, values)], vehicle, "wrong", "trial"), "the best wrong cause")


def _gains(
    said: Sequence[dict[str, Any]], kept: Sequence[Cause], model: Model, drive: Sequence, found: Found,
    compared: Sequence[bool], vehicle: Vehicle, horizons: Sequence[float], rolled: Mapping[str, Any], again: bool,
    held: Sequence[Evidence], best: tuple[Squares, Squares, np.ndarray] | None,
) -> None:  # fmt: skip
    """Fill in what each cause is worth, left out alone: of forces and moments, and of roll-outs in the quantities where
    it acts.

    The one figure of roll-outs is that of the quantity and line where it moves the simulation most, beside the error,
    after HORIZON or the nearest that there is. best  squared errors with all causes, at the floor, its mean
    """
    if "noise_floor" not in rolled["ends"]:
        return
    for entry, cause in zip(said, kept):
        old, without = rolled["errors"]["before"], model
        if len(kept) > 1 or again:
            rest = [c for c in kept if c is not cause]
            beside = _extended(model, rest, drive, found, compared, vehicle, "rest", "gap", anew=again)
            without = Model(beside, "rest")
            old = rollout_gain.simulated_errors(rolled["tracks"], without, model)
        if best is not None:
            entry |= gain_entry(cause, removed(wrench_squares(held, after(without, model)), *best))
        rows = rollout_gain.worth(rolled, old, cause.effect.channels, horizons)
        told = [row for row in rows if row["value"] is not None]
        main = min(told, key=lambda row: (abs(row["horizon"] - HORIZON), -row["moved"]), default=None)
        entry["gain"]["rollout"] = main and main["value"]
        entry["rollout channel"] = main and main["quantity"]
        entry["rollout gain"], entry["rollout gains"] = main, rows


def _verdict(effects: Sequence[Any], ties: Sequence[Any], left: Sequence[Any], unable: str = "") -> str:
    """In a word; unable  why forces and moments could not be asked: then nothing found is no agreement."""
    if effects:
        return "partly explained" if ties or left or unable else "explained"
    if ties:
        return "partly explained"
    return "unexplained" if left else "not judged" if unable else "agrees"
