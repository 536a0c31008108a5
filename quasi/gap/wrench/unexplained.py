"""What no cause explains: significant, material, and where it lives; never forced into a name.

After the named causes, smooth functions of the state are offered to each channel with the same test that causes have
to pass, and the residual's spectrum is searched for what repeats in time. What passes is not a cause; it says that the
model is wrong there, and along what.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from quasi.gap.catalogue import beyond_slope, columns_of, corrected
from quasi.gap.effect import Effect, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.places import EVERYWHERE, OWN, Basis
from quasi.gap.flights.whereabouts import profile, whereabouts
from quasi.gap.statistics.blocks import HOLDS
from quasi.gap.statistics.mixed import Offer, Test, marginal
from quasi.gap.statistics.whitening import whiten
from quasi.gap.wrench import rhythm
from quasi.gap.wrench.gain import surely, wrench_score
from quasi.gap.wrench.smooth import Cause, Grounds, Place, grounds_of, level_of, mixed_of, offer_of, select, tested
from quasi.gap.wrench.study import LIGHT, base_columns, refit
from quasi.gap.wrench.worth import ASIDE, SMALL
from quasi.standalone.model import AXES

LEAST = 0.05  # of the squared error, below which nothing is left to be removed, by what changed
BESIDE = 0.3  # of the power along its first axis that a peak has along another one where that is told too
AGAIN = 0.5  # of what other flights tell that a flight must show
ELSE = 2  # other functions of a place that are tried
VISITED = 0.3  # share of the function's usual size below which a held-out flight cannot judge it
BETWEEN = 0.002  # probability of nothing that whole flights as witnesses must leave as well, |t| = 3.3
GROWN = 4.0  # times its square without the others of its channel, that no function is beside them
UNHEARD = 0.3  # share of the squared error of the flights where it was found, that it must be then


class Left(NamedTuple):
    """What no cause explains: as the diagnosis says it, a table of it along its places, and what was told of it, with
    the grounds that it was found on."""

    said: list[dict[str, Any]]
    table: pd.DataFrame
    told: list[tuple[Place, Test]]
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
) -> Left:
    """What stays unexplained.

    causes  accepted ones and those of ties: effect, offer, values to linearise at; left  flight -> (n, 6), the residual
    of the extended model; floor (6,) mean squares; rate  family-wise false alarm rate, half of it for places, half for
    frequencies; share  least material one
    """
    # what healthy flights show as well is mostly the form of the model's own terms
    least = {"changed": LEAST, "always": LEAST if all(compared) else SMALL["always"]}
    grounds = grounds_of(flights, compared, causes, vehicle)
    given = [offer for _, offer, _ in causes]
    found = select(grounds, compared, given, 0.5 * rate)
    joint = _joint(grounds, compared, causes, found)
    found = _again(grounds, compared, given, joint, _witnessed(grounds, compared, given, found), 0.5 * rate)
    found = _apart(grounds, compared, given, found, 0.5 * rate)
    joint = _joint(grounds, compared, causes, found)
    # what healthy flights show as well and is not sure must not stand beside what changed; where none is healthy, what
    # no term of a model can depend on is no form of terms, and the flights that it was found on may be sure of it
    found = [
        (p, t) for p, t in found if p.since == "changed"
        or (all(compared) and p.choice.where not in OWN and _surely_again(grounds, compared, given, joint, p))
        or _beyond_doubt(grounds, compared, causes, found, joint, p, held, vehicle, floor, share, least["always"])
    ]  # fmt: skip
    joint = _joint(grounds, compared, causes, found)
    lines = rhythm.search(_signals(grounds, joint, flights), compared, 0.5 * rate)
    judge = grounds_of(held, [True] * len(held), causes, vehicle, grounds)
    whole = wrench_score(held, left).mean()
    # a flight's constant error, which flights differ by, must not outweigh what depends on a place
    centred = wrench_score(held, left, True).mean()
    found_in = wrench_score([f for f, flag in zip(flights, compared) if flag], left, True).mean()
    said: list[dict[str, Any]] = []
    parts: list[float] = []

    def material(channel: int, gone: float, before: float, since: str) -> float | None:
        """The share of the removable squared error that is gone; nothing where that is too little."""
        before = max(before, gone)
        part = gone / max(before - min(floor[channel], before - gone), 1e-300)
        return float(part) if gone > least[since] * before and part >= share else None

    profiles: list[pd.DataFrame] = []
    told: list[tuple[Place, Test]] = []

    def say(channel: int, where: str, part: float | None, size: float, **rest: Any) -> None:
        # where the best fit leaves as much, what goes by a function is all there is, and no share of anything
        shown = part if floor[channel] < HOLDS * whole[channel] else None
        said.append({"channel": AXES[channel], "where": where, "judged": part is not None, "share": shown,
                     "size": float(size), "unit": "N" if channel < 3 else "N m", **rest})  # fmt: skip
        parts.append(part or 0.0)

    for place, test in found:
        k, where = place.channel, place.choice.where
        usual, here = _sizes(grounds, compared, place, test.value, held)
        if where in OWN:
            others = _joint(grounds, compared, causes, [(p, t) for p, t in found if p != place])
            without, beside = (wrench_score(held, lambda f, j=j: _residual(f, j, vehicle), True).mean()
                               for j in (others, joint))  # fmt: skip
            part = material(k, max(float(without[k] - beside[k]), 0.0), float(without[k]), place.since)
        else:
            slope, _ = _slope(grounds, compared, judge.parts, joint, place)
            before = whole if where == EVERYWHERE else centred
            part = material(k, max(2.0 * slope - 1.0, 0.0) * here**2, float(before[k]), place.since)
        # what a model's own terms depend on may be their form, unless healthy flights do not show it
        unjudged = here < VISITED * usual and (where not in OWN or place.since == "changed")
        unjudged = unjudged and usual**2 > UNHEARD * float(found_in[k])
        if part is not None or unjudged:
            told += [(place, test)] if not unjudged else []
            if where != EVERYWHERE:
                shown = [f for f, flag in zip(flights, compared) if flag] + list(held)
                rest = joint._replace(functions=[(p, v) for p, v in joint.functions if p != place])
                left_of = [_residual(f, rest, vehicle)[:, k] for f in shown]
                table = profile(grounds.basis, place.choice, test.value, shown, left_of)
                profiles.append(table.assign(channel=AXES[k], where=where))
            say(k, where, None if unjudged else part, usual, since=place.since,
                mostly=whereabouts(grounds.basis, place.choice, test.value, flights, compared),
                evidence={"p": test.p, "wald": test.wald})  # fmt: skip
    signals = _signals(judge, joint, held)
    for line in lines:
        power = np.mean([rhythm.amplitudes(line, s) for s in signals], axis=0)
        for k in np.flatnonzero(power > BESIDE * power.max()):
            part = material(k, float(power[k]), float(whole[k]), line.since)
            if part is not None:
                say(k, "frequency", part, np.sqrt(power[k]), since=line.since, mostly=[[line.low, line.high]],
                    evidence={"p": line.p, "seen along": line.view})  # fmt: skip
    table = pd.concat(profiles, ignore_index=True) if profiles else pd.DataFrame({"channel": [], "where": []})
    order = np.argsort(-np.array(parts), kind="stable")
    return Left([said[k] for k in order], table, told, grounds)


def outdone(
    left: Left, compared: Sequence[bool], offers: Sequence[Offer], asked: Offer, channels: Sequence[str], p: float,
    level: float,
) -> str:  # fmt: skip
    """Why a cause gives way to what no cause explains, or nothing: beside what lives along a place, in a channel of its
    own and more significant than it is, it is nothing any more, as one cause gives way to another.

    A place that the model's own terms depend on may be the form of a cause that is not quite right, and does not count.
    left    found beside the cause; offers  of all causes that it was found beside; p of the cause, which passed level
    """
    stronger = [
        place for place, test in left.told
        if test.p < p and place.since == asked.since and AXES[place.channel] in channels
        and place.choice.where not in (*OWN, EVERYWHERE)
    ]  # fmt: skip
    for place in stronger:
        mixed = mixed_of(left.grounds, compared, offers, [place])
        pooled = [place.name] if place.since == "changed" else []
        beside = mixed.test(asked, [*(o for o in offers if o != asked), offer_of(place)], pooled)
        if beside.p >= level:
            return (
                f"beside what {AXES[place.channel]} lacks along the {place.choice.where}, which no cause explains, it "
                f"adds nothing (p = {beside.p:.2g})"
            )
    return ""


def _beyond_doubt(
    grounds: Grounds, compared: Sequence[bool], causes: Sequence[Cause], found: Sequence[tuple[Place, Test]],
    joint: "Joint", place: Place, held: Sequence[Evidence], vehicle: Vehicle, floor: np.ndarray, share: float,
    small: float,
) -> bool:  # fmt: skip
    """Whether held-out flights gain the share for sure by what all flights have alike, as `worth` asks of causes."""
    others = _joint(grounds, compared, causes, [(p, t) for p, t in found if p != place])
    first, last = (wrench_score(held, lambda f, j=j: _residual(f, j, vehicle), True) for j in (others, joint))
    k = place.channel
    least = np.minimum(np.minimum(floor, last.mean()), (1.0 - small) * first.mean())
    low = surely(first, last, first.mean() - least)[k]
    return bool(low > (share if all(compared) else max(share, ASIDE)))


class Joint(NamedTuple):
    """Everything fitted together: what the terms change by (S,), causes with values, functions with values."""

    base: np.ndarray | None
    causes: list[tuple[Effect, Offer, Mapping[str, float], Mapping[str, float]]]  # values to linearise at, and fitted
    functions: list[tuple[Place, np.ndarray]]
    basis: Basis


def _joint(
    grounds: Grounds, compared: Sequence[bool], causes: Sequence[Cause], found: Sequence[tuple[Place, Test]]
) -> Joint:
    """The model's own terms fitted anew beside causes and functions; as they were where all of these are changes."""
    study, fitted = grounds.study, []
    given = [offer for _, offer, _ in causes]
    for effect, offer, values in causes:
        own = {effect.fitted[k]: values[effect.fitted[k]] for k in offer.which if effect.fitted[k] in values}
        if not own:
            test = mixed_of(grounds, compared, given, []).test(offer, [g for g in given if g != offer])
            own = {effect.fitted[k]: float(v) for k, v in zip(offer.which, test.value)}
        fitted.append((effect, offer, values, own))
    functions = [(p, t.value) for p, t in found]
    base = None
    if any(o.since == "always" for o in given) or any(p.since == "always" for p, _ in functions):
        raw = []
        for part, basis, flag in zip(study.thinned, grounds.thinned, compared):
            columns = part.columns.copy()
            for place, value in functions:
                if flag or place.since == "always":
                    columns[:, place.channel, 0] -= basis[:, list(place.choice.which)] @ value
            raw.append(np.einsum("nki,nkj->kij", columns, columns))
        taken: dict[tuple[str, str], dict[int, float]] = {}
        for effect, offer, _, own in fitted:
            taken.setdefault((effect.id, offer.since), {}).update({effect.fitted.index(n): v for n, v in own.items()})
        base = refit(study._replace(raw=raw), range(len(raw)), compared, taken)
    return Joint(base, fitted, functions, grounds.basis)


def _slope(
    grounds: Grounds, compared: Sequence[bool], judge: Sequence[np.ndarray], joint: Joint, place: Place
) -> tuple[float, float]:
    """How much of a function the flights of `judge` show, 1 for all of it, and the information (1/variance) on that.

    Whitened least squares with the model's own terms free, fitted to all flights. Whitened, because a controller trims
    slow forces away: in plain residuals a term that merely carries the trim would take the place of what pushes.
    judge  cross-products, as Grounds.parts, of compared flights that had no part in fitting the function
    """
    layout, size = grounds.study.columns, len(grounds.study.names)
    width = grounds.parts[0].shape[-1] - size
    end = size + 6 * width
    inner, right = np.zeros((len(layout.shared) + 1,) * 2), np.zeros(len(layout.shared) + 1)
    flags = [*compared, *(True for _ in judge)]
    for number, (part, flag) in enumerate(zip([*grounds.parts, *judge], flags)):
        summed = part.sum(axis=0)
        # the functions of each channel have columns of their own
        gram = np.zeros((end, end))
        gram[:size, :size] = summed[:, :size, :size].sum(axis=0)
        for k in range(6):
            own = slice(size + k * width, size + (k + 1) * width)
            gram[own, :size], gram[:size, own] = summed[k, size:, :size], summed[k, :size, size:]
            gram[own, own] = summed[k, size:, size:]
        gram = marginal(gram, layout.nuisance, layout.spread)
        target, function = np.zeros(end), np.zeros(end)
        target[0] = 1.0
        for effect, offer, _, values in joint.causes:
            if flag or offer.since == "always":
                for name, v in values.items():
                    target[layout.causes[effect.id][effect.fitted.index(name)]] -= v
        for other, value in joint.functions:
            at = [size + other.channel * width + k for k in other.choice.which]
            if number >= len(grounds.parts) and other == place:
                function[at] = value
            elif flag or other.since == "always":
                target[at] -= value
        turn = np.column_stack([np.eye(end)[:, layout.shared], function])
        inner += turn.T @ gram @ turn
        right += turn.T @ gram @ target
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    inverse = np.linalg.inv(inner / np.outer(scale, scale) + LIGHT * np.eye(len(scale)))
    return float(inverse[-1] @ (right / scale) / scale[-1]), float(scale[-1] ** 2 / inverse[-1, -1])


def _again(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Offer], joint: "Joint",
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
            told = joint._replace(functions=[(other, seen.value) if p == place else (p, v) for p, v in joint.functions])
            if _comes_again(grounds, compared, given, told, other):
                kept.append((other, seen))
                break
    return kept


def _apart(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Offer], found: Sequence[tuple[Place, Test]], rate: float
) -> list[tuple[Place, Test]]:
    """Without functions that hold each other: where two places go together (volts fall with time, flights kept one
    heading), two functions, large and opposite, stand for the little that is left of both. The one that grows most
    beside the others goes: it is there to take off what they have too much."""
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


def _witnessed(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Offer], found: Sequence[tuple[Place, Test]]
) -> list[tuple[Place, Test]]:  # fmt: skip
    """Without changes that whole flights do not bear out: stretches of one flight may err alike, as in `naming`."""
    whole = grounds.whole()
    others = {p: [q for q, _ in found if q != p] for p, _ in found}
    return [
        (p, t) for p, t in found
        if p.since == "always" or tested(whole, compared, given, others[p], p).p_known_spread < BETWEEN
    ]  # fmt: skip


def _comes_again(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Offer], joint: "Joint", place: Place
) -> bool:
    """Whether what the other flights tell of a function is there in each compared flight that was left out in turn.

    One flight that went alone to a place cannot tell the place from what else was on in that flight.
    """
    slopes, weights = _left_out(grounds, compared, given, joint, place)
    return float(np.average(slopes, weights=weights)) > AGAIN if weights.sum() > 0 else False


def _surely_again(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Offer], joint: "Joint", place: Place
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
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Offer], joint: "Joint", place: Place
) -> tuple[np.ndarray, np.ndarray]:
    """How much of what the others tell of a function each compared flight shows, with weights, (F,) each."""
    others = [p for p, _ in joint.functions if p != place]
    found = []
    for out in np.flatnonzero(compared):
        keep = [k for k in range(len(compared)) if k != out]
        fewer, flags = grounds.of(keep), [compared[k] for k in keep]
        value = tested(fewer, flags, given, others, place).value
        told = joint._replace(functions=[(p, value if p == place else v) for p, v in joint.functions])
        found.append(_slope(fewer, flags, [grounds.parts[out]], told, place))
    slopes, weights = np.array(found).T
    return slopes, weights


def _residual(flight: Evidence, joint: Joint, vehicle: Vehicle) -> np.ndarray:
    """What the joint fit leaves of a compared flight (n, 6)."""
    left = flight.residual
    bent = {e.id: at for e, _, at, _ in joint.causes if e.bends}
    true = corrected(flight, {e.id: e for e, *_ in joint.causes}, bent)
    if joint.base is not None:
        left = left - sum(b * column for b, (_, column) in zip(joint.base, base_columns(true)))
    for effect, _, at, own in joint.causes:
        at = at if effect.bends and at else dict.fromkeys(effect.parameters, 0.0)
        seen = flight if effect.corrected else true
        columns = columns_of(effect, seen, vehicle, at)
        left = left - beyond_slope(effect, seen, vehicle, at) - sum(columns[n] * v for n, v in own.items())
    functions = joint.basis.functions(flight)
    for place, value in joint.functions:
        left = left - flight.only(AXES[place.channel], functions[:, list(place.choice.which)] @ value)
    return left


def _signals(grounds: Grounds, joint: Joint, flights: Sequence[Evidence]) -> list[rhythm.Signal]:
    """What each flight's own fit of terms, nuisances and causes leaves, beside functions, for its spectrum."""
    study, columns = grounds.study, grounds.study.columns
    fit = [0, *columns.shared, *columns.nuisance, *(c for own in columns.causes.values() for c in own)]
    signals = []
    for flight, part, functions in zip(flights, study.thinned, grounds.thinned):
        parts = [part.columns[:, :, fit]]
        for place, value in joint.functions:
            own = np.zeros((len(functions), 6, 1))
            own[:, place.channel, 0] = functions[:, list(place.choice.which)] @ value
            parts.append(own)
        stack = np.concatenate(parts, axis=2)
        white = whiten(stack, part.breaks, study.whitener)[0].reshape(-1, stack.shape[2])
        scale = np.maximum(np.sqrt(np.einsum("ni,ni->i", white, white)), 1e-300)
        x = white[:, 1:] / scale[1:]
        weights = np.linalg.solve(x.T @ x + LIGHT * np.eye(x.shape[1]), x.T @ white[:, 0]) / scale[1:]
        values = stack[:, :, 0] - stack[:, :, 1:] @ weights
        terms = [t["coefficient"] for a in AXES for t in flight.model.document["axes"].get(a, {"terms": []})["terms"]]
        modelled = part.columns[:, :, columns.shared] * terms
        signals.append(rhythm.Signal(values, part.breaks, flight.t[part.rows], flight.quaternion[part.rows], modelled))
    return signals


def _sizes(
    grounds: Grounds, compared: Sequence[bool], place: Place, value: np.ndarray, held: Sequence[Evidence]
) -> tuple[float, float]:
    """Root mean square of a function about its mean, on the compared flights and on the held-out ones."""
    which = list(place.choice.which)
    measure = (lambda v: np.mean(v**2)) if place.choice.where == EVERYWHERE else np.var
    usual = np.mean([measure(b[:, which] @ value) for b, flag in zip(grounds.thinned, compared) if flag])
    here = np.mean([measure(grounds.basis.functions(f)[:, which] @ value) for f in held])
    return float(np.sqrt(usual)), float(np.sqrt(here))
