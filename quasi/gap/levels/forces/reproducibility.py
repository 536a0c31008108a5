"""Which smooth functions hold: whole flights bear them out, they come again in flights left out, held-out ones gain."""

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from quasi.gap.effect import Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.error_reduction import wrench_score
from quasi.gap.levels.forces.joint_fit import Joint, joint_of, residual_of, slope_of
from quasi.gap.levels.forces.smooth_functions import Cause, Grounds, Place, level_of, tested
from quasi.gap.materiality import ASIDE
from quasi.gap.statistics.candidates import Candidate, Test
from quasi.gap.statistics.scores import surely

AGAIN = 0.5  # share of the estimate from other flights that a flight must show
ELSE = 2  # other functions of a place that are tried
BETWEEN = 0.002  # probability of nothing that whole flights as witnesses must leave as well, |t| = 3.3
GROWN = 4.0  # times its square without the others of its channel, that no function reaches with them


def witnessed(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Candidate], found: Sequence[tuple[Place, Test]]
) -> list[tuple[Place, Test]]:  # fmt: skip
    """Without changes that whole flights do not bear out: stretches of one flight may err alike, as in `naming`."""
    whole = grounds.whole()
    others = {p: [q for q, _ in found if q != p] for p, _ in found}
    return [
        (p, t) for p, t in found
        if p.since == "always" or tested(whole, compared, given, others[p], p).p_known_spread < BETWEEN
    ]  # fmt: skip


def coming_again(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Candidate], joint: Joint,
    found: Sequence[tuple[Place, Test]], rate: float,
) -> list[tuple[Place, Test]]:  # fmt: skip
    """The functions that come again in each flight; another function of the same place, significant too, where the most
    significant one does not: a bent one may follow a single flight."""
    level, kept = level_of(grounds, compared, rate), []
    for place, test in found:
        others = [p for p, _ in found if p != place]
        choices = [c for c in grounds.basis.choices if c.where == place.choice.where and c != place.choice]
        tests = [(p, tested(grounds, compared, given, others, p)) for p in (place._replace(choice=c) for c in choices)]
        near = sorted((pair for pair in tests if pair[1].p < level), key=lambda pair: pair[1].p)[:ELSE]
        for other, seen in [(place, test), *near]:
            functions = [(other, seen.value) if p == place else (p, v) for p, v in joint.functions]
            if _comes_again(grounds, compared, given, joint._replace(functions=functions), other):
                kept.append((other, seen))
                break
    return kept


def apart(
    grounds: Grounds,
    compared: Sequence[bool],
    given: Sequence[Candidate],
    found: Sequence[tuple[Place, Test]],
    rate: float,
) -> list[tuple[Place, Test]]:
    """Without functions that hold each other: where two places go together (volts fall with time, flights kept one
    heading), two functions, large and opposite, stand for the little that is left of both. The one that grows most
    with the others goes: it is there to take off what they have too much."""
    kept = list(found)

    def square(place: Place, test: Test) -> float:
        which, own = list(place.choice.which), [b for b, flag in zip(grounds.thinned, compared) if flag]
        return float(np.mean([np.mean((b[:, which] @ test.value) ** 2) for b in own]))

    def growth(place: Place, test: Test) -> float:
        others = [p for p, _ in kept if p.channel != place.channel]
        alone = tested(grounds, compared, given, others, place)
        return square(place, test) / max(square(place, alone), 1e-300)

    while True:
        grown = [(growth(p, t), p) for p, t in kept if sum(p.channel == q.channel for q, _ in kept) > 1]
        most, gone = max(grown, key=lambda pair: pair[0], default=(0.0, None))
        if most <= GROWN:
            return kept
        places = [p for p, _ in kept if p != gone]
        again = [(p, tested(grounds, compared, given, [q for q in places if q != p], p)) for p in places]
        kept = [(p, t) for p, t in again if t.p < level_of(grounds, compared, rate)]


def beyond_doubt(
    grounds: Grounds, compared: Sequence[bool], causes: Sequence[Cause], found: Sequence[tuple[Place, Test]],
    joint: Joint, place: Place, held: Sequence[Evidence], vehicle: Vehicle, floor: np.ndarray, share: float,
    small: float,
) -> bool:  # fmt: skip
    """Whether held-out flights gain the share for sure by what all flights have alike, as `worth` asks of causes."""
    others = joint_of(grounds, compared, causes, [(p, t) for p, t in found if p != place])
    first, last = (wrench_score(held, lambda f, j=j: residual_of(f, j, vehicle), True) for j in (others, joint))
    k = place.channel
    least = np.minimum(np.minimum(floor, last.mean()), (1.0 - small) * first.mean())
    low = surely(first, last, first.mean() - least)[k]
    return bool(low > (share if all(compared) else max(share, ASIDE)))


def _comes_again(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Candidate], joint: Joint, place: Place
) -> bool:
    """Whether a function as estimated from the other flights is there in each compared flight left out in turn.

    One flight that went alone to a place cannot separate the place from other peculiarities of that flight.
    """
    slopes, weights = _left_out(grounds, compared, given, joint, place)
    return float(np.average(slopes, weights=weights)) > AGAIN if weights.sum() > 0 else False


def surely_again(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Candidate], joint: Joint, place: Place
) -> bool:
    """Whether left-out flights show it so much alike that it is beyond doubt (95 %), each flight one witness."""
    slopes, weights = _left_out(grounds, compared, given, joint, place)
    witnesses = weights.sum() ** 2 / max(float(weights @ weights), 1e-300)
    if witnesses < 2.0:
        return False
    mean = float(np.average(slopes, weights=weights))
    scatter = np.sqrt(weights**2 @ (slopes - mean) ** 2) / weights.sum() * np.sqrt(witnesses / (witnesses - 1.0))
    return mean - float(stdtrit(witnesses - 1.0, 0.95)) * float(scatter) > AGAIN


def _left_out(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Candidate], joint: Joint, place: Place
) -> tuple[np.ndarray, np.ndarray]:
    """How much of a function, as estimated from the others, each compared flight shows, with weights, (F,) each."""
    others = [p for p, _ in joint.functions if p != place]
    found = []
    for out in np.flatnonzero(compared):
        keep = [k for k in range(len(compared)) if k != out]
        fewer, flags = grounds.of(keep), [compared[k] for k in keep]
        value = tested(fewer, flags, given, others, place).value
        assumed = joint._replace(functions=[(p, value if p == place else v) for p, v in joint.functions])
        found.append(slope_of(fewer, flags, [grounds.parts[out]], assumed, place))
    slopes, weights = np.array(found).T
    return slopes, weights
