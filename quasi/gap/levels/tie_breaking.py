"""Ties of sensors and drive that forces and moments settle: correct either, and see what the model leaves of them.

Each member of a tie is a calibration of its own; the flights are imported and filtered with each, and the model's
residual is compared. Between two such hypotheses the ratio of their likelihoods decides: under the wrong one it
exceeds 1 / a with a probability of at most a, whatever else is true (Markov). What flights differ by anyway (seating
of IMU and markers, biases, telemetry) is integrated out with its usual spread, and the model's own terms are fitted
anew to all flights under each hypothesis. The mean over the flights is taken for one flight's evidence, for what a
session has in common would else be counted as often as it was flown; the flight that favours the winner most is not
needed for it, and none speaks against it as clearly as it takes to choose.

A turn that stands in all flights may stand in those that the model was identified from: its own terms may hold it, and
no residual shows what is turned. Such a tie stays. Timing is not for a model of rotor speeds to hold: late telemetry,
with which forces lead the logged speeds, is distinguished in all flights too. Late commands are not, for thrust that
lags behind the speeds hides late telemetry, and does so in every flight.

Late telemetry moves the logged speeds against all else, which is one column of the study. To process the flights anew
would move the grid of the samples, and smooth the noise by another amount: that alone had odds of e^7.
Source: Wald, Sequential tests of statistical hypotheses, Ann. Math. Stat. 16, 1945 (the bound).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from quasi import attitude
from quasi.attitude import GRAVITY
from quasi.errors import ConfigError, DataError
from quasi.gap.effect import vehicle_of
from quasi.gap.flights.evidence import RATE, REQUIRED
from quasi.gap.flights.gathering import gather
from quasi.gap.flights.level import Flown, Level
from quasi.gap.levels.corrections import document, for_flight
from quasi.gap.levels.drive.identify import CATALOGUE, LATE
from quasi.gap.levels.forces.design import Design, gather_design
from quasi.gap.levels.forces.nuisance import AGE
from quasi.gap.levels.sensors.identify import TURNED_PAIR
from quasi.gap.statistics.blocks import BLOCK
from quasi.gap.statistics.mixed import RIDGE, marginal
from quasi.gap.statistics.whitening import Whitener, block_grams
from quasi.model.model import Model

ROWS = 0.98  # share of the rows that must be comparable
Process = Callable[[Flown, Mapping[str, Any] | None], Flown]


def settle(
    levels: Sequence[Level], flights: Sequence[Flown], model: Model, alarm: float, process: Process
) -> list[str]:
    """Settle, in place, what ties of the levels can be settled: the winner becomes an effect, the other a candidate.

    flights  those that may choose and fit; alarm  probability of a wrong choice, shared among the ties
    process  imports and filters a flight anew with a calibration
    Returns the winners. What cannot be settled stays a tie, with the likelier first and a note that says why.
    """
    ties = [(level, tie) for level in levels for tie in level.ties if set(tie["ids"]) in (TURNED_PAIR, LATE)]
    winners: list[str] = []
    for level, tie in ties:
        names = " and ".join(tie["ids"])
        if set(tie["ids"]) == TURNED_PAIR and tie["since"] == "always":
            level.notes.append(
                f"{names} stay a tie: all flights have it, and the model's own terms may hold it as well; flights from "
                "before it would settle it"
            )
            continue
        try:
            if set(tie["ids"]) == LATE:
                left = compare_late(levels, tie, flights, model, process)
            else:
                left = compare(levels, tie, flights, model, process)
        except (ConfigError, DataError) as error:
            level.notes.append(f"{names} stay a tie: {error}")
            continue
        winner, each, odds = judged(left)
        needed = float(np.log(len(ties) / alarm))
        best, other = tie["ids"][winner], tie["ids"][1 - winner]
        if best == "command_delay" and tie["since"] == "always":
            level.notes.append(
                f"{names} stay a tie: all flights have it, and thrust that lags behind the rotor speeds would hide "
                "late telemetry; flights from before it would settle it"
            )
            continue
        tie["ids"] = [
            best,
            other,
        ]  # where it stays, the flights are corrected for the one that the model leaves less with
        agree = each.min() > -needed
        if odds < needed or not agree:
            level.notes.append(
                f"{names} stay a tie: of forces and moments the model leaves nearly as much with either corrected (the "
                f"odds for {best} are e^{odds:.1f}, expected e^{needed:.1f}{'' if agree else ', and flights disagree'})"
            )
            continue
        winners.append(best)
        level.ties.remove(tie)
        evidence = {"p": tie["p"], "wald": tie["wald"], "log odds by forces and moments": odds}
        level.effects.append(
            {"id": best, "since": tie["since"], "share of resamples": tie["share of resamples"],
             "channels": list(CATALOGUE[best].channels), "parameters": tie["parameters"][best],
             "evidence": evidence}
        )  # fmt: skip
        level.candidates.append(
            {"id": other, "since": tie["since"], "score": tie["wald"], "p": tie["p"],
             "why_not": f"with it corrected the model leaves more of forces and moments than with {best} corrected "
                        f"(odds e^-{odds:.1f})"}
        )  # fmt: skip
    return winners


def judged(left: np.ndarray) -> tuple[int, np.ndarray, float]:
    """The better of two hypotheses, its log odds by each flight (F,), and those of one flight that counts.

    left  (F, 2) whitened squared errors of the flights
    What counts is the mean over the flights, or over all but the one that favours the winner most, if that is less.
    """
    odds = 0.5 * (left[:, 1] - left[:, 0])
    winner = 0 if odds.mean() > 0 else 1
    odds = odds if winner == 0 else -odds
    rest = np.sort(odds)[:-1]
    return winner, odds, float(min(odds.mean(), rest.mean() if len(rest) else np.inf))


def compare(
    levels: Sequence[Level], tie: Mapping[str, Any], flights: Sequence[Flown], model: Model, process: Process
) -> np.ndarray:
    """Whitened squared errors (F, 2) that the model leaves of the compared flights, corrected for either cause.

    Of two whiteners, one from each hypothesis, that counts with which they differ least.
    Raises DataError when the flights cannot be compared.
    """
    kind = {}
    for cause in tie["ids"]:
        whole = document(levels, (cause, tie["since"]))
        wanted = [for_flight(whole, f.compared) for f in flights]
        kind[cause] = [f if c is None else process(f, c) for f, c in zip(flights, wanted)]
    studies = _studies([kind[c] for c in tie["ids"]], model)
    compared = np.array([f.compared for f in flights])
    rows = np.min([[len(part.rows) for part in s.thinned] for s in studies], axis=0)[:, None]
    both = [(rows * np.stack([_left(s, by.whitener, compared) for s in studies], axis=1))[compared] for by in studies]
    return min(both, key=lambda left: abs(float(np.mean(left[:, 1] - left[:, 0]))))


def compare_late(
    levels: Sequence[Level], tie: Mapping[str, Any], flights: Sequence[Flown], model: Model, process: Process
) -> np.ndarray:
    """As `compare`, of late telemetry and late commands: with the logged speeds taken as late as the tie says, and not.

    Raises DataError when the flights cannot be compared.
    """
    without = [replace(lv, ties=[t for t in lv.ties if t is not tie]) for lv in levels]
    whole = document(without)
    wanted = [for_flight(whole, f.compared) for f in flights]
    (study,) = _studies([[f if c is None else process(f, c) for f, c in zip(flights, wanted)]], model)
    compared = np.array([f.compared for f in flights])
    delay = tie["parameters"]["telemetry_delay"]["delay"]["value"]
    rows = np.array([len(part.rows) for part in study.thinned])[:, None]
    delays = {"telemetry_delay": delay, "command_delay": 0.0}
    sides = [_left(study, study.whitener, compared, delays[cause]) for cause in tie["ids"]]
    return (rows * np.stack(sides, axis=1))[compared]


def _studies(sides: Sequence[Sequence[Flown]], model: Model) -> list[Design]:
    """The study of each side, at the times that are valid in all."""
    masks = []
    for same in zip(*sides):
        times = [_times(f) for f in same]
        good = [_good(f) for f in same]
        # a corrected clock or telemetry moves the grid by a part of its interval
        both = [np.all([np.interp(t, u, g) > 0.99 for u, g in zip(times, good)], axis=0) for t in times]
        if min(m.sum() for m in both) < ROWS * max(g.sum() for g in good):
            raise DataError(f"flight {same[0].key} is valid at other times with either corrected")
        masks.append(both)
    studies = []
    for k, side in enumerate(sides):
        evidence = [
            gather(
                f.key,
                _forces(f, model).assign(valid=mask[k].astype(float)),
                f.filtered_metadata,
                f.airframe,
                model,
                RATE,
            )
            for f, mask in zip(side, masks)
        ]
        studies.append(gather_design(evidence, {}, vehicle_of(model)))
    return studies


def _forces(flown: Flown, model: Model) -> pd.DataFrame:
    """The filtered flight with forces of the kind that the model predicts."""
    frame = flown.filtered
    if model.with_gravity:
        return frame
    mass = float(flown.filtered_metadata.get("mass") or flown.airframe.mass)
    q = attitude.from_euler(*frame[["roll", "pitch", "yaw"]].to_numpy(float).T)
    net = frame[["Fx", "Fy", "Fz"]].to_numpy(float) + mass * attitude.rotate_inverse(q, np.array([0.0, 0.0, GRAVITY]))
    return frame.assign(Fx=net[:, 0], Fy=net[:, 1], Fz=net[:, 2])


def _times(flown: Flown) -> np.ndarray:
    """Times (n,) of a flight's rows since its first gyro sample, s."""
    start = (flown.metadata.get("start") or {}).get("value", 0.0)
    return flown.filtered["t"].to_numpy(float) + start


def _good(flown: Flown) -> np.ndarray:
    """(n,) 1 where a row can be compared, 0 elsewhere."""
    frame = flown.filtered
    missing = [c for c in REQUIRED if c not in frame]
    if missing:
        raise DataError(f"flight {flown.key} has no column '{missing[0]}', which forces and moments need")
    fine = np.isfinite(frame[list(REQUIRED)].to_numpy(float)).all(axis=1)
    return (fine & (frame["valid"].to_numpy() > 0.5) if "valid" in frame else fine).astype(float)


def _left(study: Design, whitener: Whitener, compared: np.ndarray, delay: float = 0.0) -> np.ndarray:
    """Whitened squared error a row (F,) of each flight, nuisances integrated out, the model's terms fitted to all.

    Where there are reference flights, what resembles a nuisance and is in all flights alike is fitted to all as well:
    thrust that lags behind rotor speeds in every flight would speak for late commands, as it hides late telemetry.
    delay  s, by which the rotor speeds of the compared flights are logged late
    """
    grams = np.array([
        marginal(block_grams(part.columns, part.breaks, whitener, flight.t[part.rows], BLOCK).sum(axis=0),
                 study.columns.nuisance, study.columns.spread)
        for part, flight in zip(study.thinned, study.flights)
    ])  # fmt: skip
    base = [*study.columns.shared, *([] if compared.all() else study.columns.nuisance)]
    own = np.zeros((len(grams), grams.shape[1]))
    own[:, 0] = 1.0
    own[compared, study.names.index(AGE)] -= delay
    total = grams.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(total)[base], 1e-300))
    inner = total[np.ix_(base, base)] / np.outer(scale, scale) + RIDGE * np.eye(len(base))
    right = np.einsum("fij,fj->i", grams, own)[base]
    own[:, base] -= np.linalg.solve(inner, right / scale) / scale
    return np.einsum("fij,fi,fj->f", grams, own, own) / [len(part.rows) for part in study.thinned]
