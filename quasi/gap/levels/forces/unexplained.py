"""What no cause explains: significant, material, and where it lives; never forced into a name.

After the named causes, smooth functions of the state are offered to each channel with the same test that causes have
to pass, and the residual's spectrum is searched for what repeats in time. What passes is not a cause; it says that the
model is wrong there, and along what.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.gap.effect import Vehicle
from quasi.gap.flights.covariates import EVERYWHERE, IN_TIME, OWN_COVARIATES, where_in_words
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.ranges import find_ranges, profile
from quasi.gap.levels.forces import spectral_peaks as rhythm
from quasi.gap.levels.forces.beyond_references import less_usual_differences
from quasi.gap.levels.forces.error_reduction import wrench_score
from quasi.gap.levels.forces.joint_fit import Joint, joint_of, residual_of, signals_of, slope_of
from quasi.gap.levels.forces.reproducibility import apart, beyond_doubt, coming_again, surely_again, witnessed
from quasi.gap.levels.forces.smooth_functions import (
    Cause,
    Grounds,
    Place,
    grounds_of,
    level_of,
    mixed_of,
    offer_of,
    select,
    tested,
)
from quasi.gap.materiality import LEAST_ABOVE_FLOOR
from quasi.gap.statistics.blocks import HOLDS
from quasi.gap.statistics.candidates import Candidate, Test
from quasi.model.model import AXES

LEAST_LEFT = 0.05  # of the squared error, below which nothing is left to be removed, by what changed
SECOND_AXIS = 0.3  # share of the power along its first axis, from which a peak is reported along another one
SHOWN_SHARE = 0.3  # share of the function's usual size below which a held-out flight cannot judge it
UNHEARD = 0.3  # share of the squared error of the flights where it was found, that it must be then


class Left(NamedTuple):
    """What no cause explains: entries of the diagnosis, a table of it along its places, the functions reported, and
    the grounds that they were found on."""

    entries: list[dict[str, Any]]
    table: pd.DataFrame
    reported: list[tuple[Place, Test]]
    grounds: Grounds


def search(
    flights: Sequence[Evidence],
    compared: Sequence[bool],
    held: Sequence[Evidence],
    causes: Sequence[Cause],
    left: Callable[[Evidence], np.ndarray],
    floor: np.ndarray,
    vehicle: Vehicle,
    rate: float,
    share: float,
    centred_floor: np.ndarray | None = None,
) -> Left:
    """What stays unexplained.

    causes  accepted ones and those of ties: effect, offer, values to linearise at; left  flight -> (n, 6), the residual
    of the extended model; floor (6,) mean squares, centred_floor about each flight's mean, None for the same; rate
    family-wise false alarm rate, half of it for places, half for frequencies; share  least material one
    """
    centred_floor = floor if centred_floor is None else centred_floor
    # what healthy flights show as well is mostly the form of the model's own terms
    least = {"changed": LEAST_LEFT, "always": LEAST_LEFT if all(compared) else LEAST_ABOVE_FLOOR["always"]}
    grounds = grounds_of(flights, compared, causes, vehicle, judges=held)

    def sure(found: Sequence[tuple[Place, Test]], joint: Joint, place: Place) -> bool:
        gain = (held, vehicle, centred_floor, share, least["always"])
        return beyond_doubt(grounds, compared, causes, found, joint, place, *gain)

    found = _held_up(grounds, compared, causes, 0.5 * rate, sure)
    joint = joint_of(grounds, compared, causes, found)
    lines = rhythm.search(signals_of(grounds, joint, flights), compared, 0.5 * rate)
    judge = grounds_of(held, [True] * len(held), causes, vehicle, grounds)
    whole = wrench_score(held, left).mean()
    # a flight's constant error, which flights differ by, must not outweigh what depends on a place
    centred = wrench_score(held, left, True).mean()
    found_in = wrench_score([f for f, flag in zip(flights, compared) if flag], left, True).mean()
    entries: list[dict[str, Any]] = []
    parts: list[float] = []

    def sides(where: str) -> tuple[np.ndarray, np.ndarray]:
        """Mean squares (6,) before and at best, with constant errors where these are what it is about."""
        return (whole, floor) if where in (EVERYWHERE, IN_TIME) else (centred, centred_floor)

    def left_by(fit: Joint, channel: int, where: str) -> float:
        """Mean square, as of `sides`, of what a fit of causes and functions leaves."""
        about_mean = where not in (EVERYWHERE, IN_TIME)
        return float(wrench_score(held, lambda f: residual_of(f, fit, vehicle), about_mean).mean()[channel])

    def material(channel: int, where: str, gone: float, before: float, since: str) -> float | None:
        """The share of the removable squared error that is gone; nothing where that is too little."""
        before = max(before, gone)
        part = gone / max(before - min(sides(where)[1][channel], before - gone), 1e-300)
        return float(part) if gone > least[since] * before and part >= share else None

    profiles: list[pd.DataFrame] = []
    reported: list[tuple[Place, Test]] = []

    def say(channel: int, where: str, part: float | None, size: float, **rest: Any) -> None:
        # where the best fit leaves as much, what goes by a function is all there is, and no share of anything
        before, best = sides(where)
        shown = part if best[channel] < HOLDS * before[channel] else None
        entries.append({"channel": AXES[channel], "where": where, "judged": part is not None, "share": shown,
                        "size": float(size), "unit": "N" if channel < 3 else "N m", **rest})  # fmt: skip
        parts.append(part or 0.0)

    for place, test in found:
        k, where = place.channel, place.choice.where
        usual, here = _sizes(grounds, compared, place, test.value, held)
        if where in OWN_COVARIATES:
            others = joint_of(grounds, compared, causes, [(p, t) for p, t in found if p != place])
            # what only balances a cause of a tie, which the extended model does not hold, is no error of that model
            before = min(left_by(others, k, where), float(centred[k]))
            gone = before - left_by(joint, k, where)
        else:
            slope, _ = slope_of(grounds, compared, judge.parts, joint, place)
            before, gone = float(sides(where)[0][k]), max(2.0 * slope - 1.0, 0.0) * here**2
            if gone > before:  # as above: more than there is
                gone = before - left_by(joint, k, where)
        shown = here >= SHOWN_SHARE * usual
        placed = shown and place.since == "changed" and where != EVERYWHERE
        if placed and _unusual(held, joint, place, vehicle) < 0.5 * gone:
            continue
        part = material(k, where, max(gone, 0.0), before, place.since)
        # what a model's own terms depend on may be their form, unless healthy flights do not show it
        unjudged = not shown and (where not in OWN_COVARIATES or place.since == "changed")
        unjudged = unjudged and usual**2 > UNHEARD * float(found_in[k])
        if part is not None or unjudged:
            reported += [(place, test)] if not unjudged else []
            if where != EVERYWHERE:
                profiled = [f for f, flag in zip(flights, compared) if flag] + list(held)
                rest = joint._replace(functions=[(p, v) for p, v in joint.functions if p != place])
                left_of = [residual_of(f, rest, vehicle)[:, k] for f in profiled]
                table = profile(grounds.basis, place.choice, test.value, profiled, left_of)
                profiles.append(table.assign(channel=AXES[k], where=where))
            say(k, where, None if unjudged else part, usual, since=place.since,
                mostly=find_ranges(grounds.basis, place.choice, test.value, flights, compared),
                evidence={"p": test.p, "wald": test.wald})  # fmt: skip
    signals = signals_of(judge, joint, held)
    for line in lines:
        power = np.mean([rhythm.amplitudes(line, s) for s in signals], axis=0)
        for k in np.flatnonzero(power > SECOND_AXIS * power.max()):
            part = material(k, IN_TIME, float(power[k]), float(whole[k]), line.since)
            if part is not None:
                say(k, IN_TIME, part, np.sqrt(power[k]), since=line.since, mostly=[[line.low, line.high]],
                    evidence={"p": line.p, "seen along": line.view})  # fmt: skip
    table = pd.concat(profiles, ignore_index=True) if profiles else pd.DataFrame({"channel": [], "where": []})
    order = np.argsort(-np.array(parts), kind="stable")
    return Left([entries[k] for k in order], table, reported, grounds)


def _held_up(
    grounds: Grounds, compared: Sequence[bool], causes: Sequence[Cause], rate: float,
    sure: Callable[[Sequence[tuple[Place, Test]], Joint, Place], bool],
) -> list[tuple[Place, Test]]:  # fmt: skip
    """The functions that are significant, come again and do not hold each other; of those that all flights have alike
    the ones that are `sure`."""
    given = [offer for _, offer, _ in causes]
    found = select(grounds, compared, given, rate)
    joint = joint_of(grounds, compared, causes, found)
    found = coming_again(grounds, compared, given, joint, witnessed(grounds, compared, given, found), rate)
    found = apart(grounds, compared, given, found, rate)
    joint = joint_of(grounds, compared, causes, found)
    # what healthy flights show as well and is not sure must not be added to what changed; where none is healthy, what
    # no term of a model can depend on is no form of terms, and the flights that it was found on may be sure of it
    return [
        (p, t) for p, t in found if p.since == "changed"
        or (all(compared) and p.choice.where not in OWN_COVARIATES and surely_again(grounds, compared, given, joint, p))
        or sure(found, joint, p)
    ]  # fmt: skip


def outdone(
    left: Left, compared: Sequence[bool], offers: Sequence[Candidate], asked: Candidate, channels: Sequence[str],
    p: float, level: float, rate: float,
) -> str:  # fmt: skip
    """Why a cause gives way to what no cause explains, or nothing.

    It gives way to a more significant function of a place, in one of its own channels, with which it is not significant
    any more; and to a function that takes most of it and adds more to it than it adds to the function: of the two the
    cause is the worse description. What takes little of it is there as well, the form of another cause, say. A place
    that the model's own terms depend on may be the form of a cause that is not quite right, and does not count.
    left    found with the cause given; offers  of all causes that were given; p of the cause, which passed level
    rate    family-wise false alarm rate of functions
    """
    found = {place for place, test in left.reported if test.p < p and place.choice.where != EVERYWHERE}
    grounds, others = left.grounds, [o for o in offers if o != asked]
    judged = [
        k for k, a in enumerate(AXES) if a in channels and any(k not in f.excluded for f in grounds.study.flights)
    ]
    for k, choice in itertools.product(judged, grounds.basis.choices):
        place = Place(k, choice, asked.since)
        if choice.where in OWN_COVARIATES:
            continue
        mixed = mixed_of(grounds, compared, offers, [place])
        pooled = [place.name] if place.since == "changed" else []
        cause = mixed.test(asked, [*others, offer_of(place)], pooled)
        function = tested(grounds, compared, offers, [], place)
        adds_more = function.p < min(level_of(grounds, compared, rate), cause.p)
        takes_most = adds_more and cause.wald < 0.5 * mixed.test(asked, others, pooled).wald
        if (place in found and cause.p >= level) or takes_most:
            return (
                f"{AXES[k]} differs {where_in_words(choice.where)} in a way that no cause explains "
                f"(p = {function.p:.2g} with the cause given); with that given the cause has p = {cause.p:.2g}"
            )
    return ""


def _unusual(held: Sequence[Evidence], joint: Joint, place: Place, vehicle: Vehicle) -> float:
    """Mean square that a function takes of what the usual differences between flights and sessions leave.

    Where these, a battery that is seated elsewhere say, explain most of it, the rest is an error of their form."""
    rest = joint._replace(functions=[(p, v) for p, v in joint.functions if p != place])
    without, with_it = (less_usual_differences(lambda f, j=j: residual_of(f, j, vehicle)) for j in (rest, joint))
    return float(np.mean([np.var(without(f)[:, place.channel]) - np.var(with_it(f)[:, place.channel]) for f in held]))


def _sizes(
    grounds: Grounds, compared: Sequence[bool], place: Place, value: np.ndarray, held: Sequence[Evidence]
) -> tuple[float, float]:
    """Root mean square of a function about its mean, on the compared flights and on the held-out ones."""
    which = list(place.choice.which)
    measure = (lambda v: np.mean(v**2)) if place.choice.where == EVERYWHERE else np.var
    usual = np.mean([measure(b[:, which] @ value) for b, flag in zip(grounds.thinned, compared) if flag])
    here = np.mean([measure(grounds.basis.functions(f, which) @ value) for f in held])
    return float(np.sqrt(usual)), float(np.sqrt(here))
