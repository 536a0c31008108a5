"""What no cause explains: significant, material, and where it lives; never forced into a name.

After the named causes, smooth functions of the state are offered to each channel with the same test that causes have
to pass, and the residual's spectrum is searched for what repeats in time. What passes is not a cause; it says that the
model is wrong there, and along what.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import chi2

from quasi.gap import rhythm
from quasi.gap.catalogue import beyond_slope, columns_of
from quasi.gap.effect import Effect, Vehicle
from quasi.gap.evidence import Evidence
from quasi.gap.gain import fraction, wrench_score
from quasi.gap.mixed import Columns, Mixed, Offer, Test, marginal
from quasi.gap.places import EVERYWHERE, OWN, Basis, Choice, basis_of
from quasi.gap.study import BAND, BLOCK, LIGHT, ORDER, Study, base_columns, gather_study, refit
from quasi.gap.whereabouts import profile, whereabouts
from quasi.gap.whitening import thin, whiten
from quasi.standalone.model import AXES

MOST = 6
LEAST = 0.1  # of the squared error, below which nothing is left to be removed
BESIDE = 0.3  # of the power along its first axis that a peak has along another one where that is told too
AGAIN = 0.5  # of what other flights tell that a flight must show
VISITED = 0.3  # share of the function's usual size below which a held-out flight cannot judge it
Cause = tuple[Effect, Offer, Mapping[str, float]]


class Place(NamedTuple):
    """A smooth function offered to one channel of all flights ("always") or of the compared ones ("changed")."""

    channel: int
    choice: Choice
    since: str

    @property
    def name(self) -> str:
        """Unique."""
        return f"{AXES[self.channel]} along {self.choice.where} {self.choice.which}"


class Grounds(NamedTuple):
    """What the tests work on: cross-products of the model's terms, nuisances, causes and smooth functions.

    parts  per flight (K, 6, P, P): of each stretch and channel, whitened; the study's columns first, then the basis
    """

    study: Study
    basis: Basis
    parts: list[np.ndarray]
    thinned: list[np.ndarray]  # per flight (m, L): the basis in the band of the analysis


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
) -> tuple[list[dict[str, Any]], pd.DataFrame]:
    """What stays unexplained, as the diagnosis says it, and a table of it along its places.

    causes  accepted ones and those of ties: effect, offer, values to linearise at; left  flight -> (n, 6), the residual
    of the extended model; floor (6,) mean squares; rate  family-wise false alarm rate, half of it for places, half for
    frequencies; share  least material one
    """
    grounds = _grounds(flights, causes, vehicle)
    given = [offer for _, offer, _ in causes]
    found = _found(grounds, compared, given, 0.5 * rate)
    joint = _joint(grounds, compared, causes, found)
    found = [(p, t) for p, t in found if _comes_again(grounds, compared, given, joint, p)]
    joint = _joint(grounds, compared, causes, found)
    lines = rhythm.search(_signals(grounds, joint, flights), compared, 0.5 * rate)
    judge = _grounds(held, causes, vehicle, grounds)
    whole = wrench_score(held, left).mean()
    said: list[dict[str, Any]] = []

    def material(channel: int, gone: float, before: float) -> float | None:
        """The share of the removable squared error that is gone; nothing where that is too little."""
        before = max(before, gone)
        part = gone / max(before - min(floor[channel], before - gone), 1e-300)
        return float(part) if gone > LEAST * before and part >= share else None

    profiles: list[pd.DataFrame] = []

    def say(channel: int, where: str, part: float | None, size: float, **rest: Any) -> None:
        said.append({"channel": AXES[channel], "where": where, "share": part, "size": float(size),
                     "unit": "N" if channel < 3 else "N m", **rest})  # fmt: skip

    for place, test in found:
        k, where = place.channel, place.choice.where
        usual, here = _sizes(grounds, compared, place, test.value, held)
        if where in OWN:
            others = _joint(grounds, compared, causes, [(p, t) for p, t in found if p != place])
            without, beside = (wrench_score(held, lambda f, j=j: _residual(f, j, vehicle)).mean()
                               for j in (others, joint))  # fmt: skip
            part = material(k, max(float(without[k] - beside[k]), 0.0), float(without[k]))
        else:
            slope, _ = _slope(grounds, compared, judge.parts, joint, place)
            part = material(k, max(2.0 * slope - 1.0, 0.0) * here**2, float(whole[k]))
        unjudged = here < VISITED * usual and where not in OWN
        if place.since == "always" and not _beyond_doubt(grounds, compared, causes, found, joint, place, held, vehicle,
                                                         floor, share):  # fmt: skip
            continue
        if part is not None or unjudged:
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
            part = material(k, float(power[k]), float(whole[k]))
            if part is not None:
                say(k, "frequency", part, np.sqrt(power[k]), since=line.since, mostly=[[line.low, line.high]],
                    evidence={"p": line.p, "seen along": line.view})  # fmt: skip
    table = pd.concat(profiles, ignore_index=True) if profiles else pd.DataFrame({"channel": [], "where": []})
    return sorted(said, key=lambda u: -(u["share"] or 0.0)), table


def _beyond_doubt(
    grounds: Grounds, compared: Sequence[bool], causes: Sequence[Cause], found: Sequence[tuple[Place, Test]],
    joint: "Joint", place: Place, held: Sequence[Evidence], vehicle: Vehicle, floor: np.ndarray, share: float,
) -> bool:  # fmt: skip
    """Whether held-out flights gain the share for sure by what all flights have alike, as `worth` asks of causes."""
    others = _joint(grounds, compared, causes, [(p, t) for p, t in found if p != place])
    first, last = (wrench_score(held, lambda f, j=j: _residual(f, j, vehicle), True) for j in (others, joint))
    k = place.channel
    least = np.minimum(np.minimum(floor, last.mean()), (1.0 - LEAST) * first.mean())
    low = fraction(first, last, least)[AXES[k]]["low"]
    return low is not None and low > share


class Joint(NamedTuple):
    """Everything fitted together: what the terms change by (S,), causes with values, functions with values."""

    base: np.ndarray | None
    causes: list[tuple[Effect, Offer, Mapping[str, float], Mapping[str, float]]]  # values to linearise at, and fitted
    functions: list[tuple[Place, np.ndarray]]
    basis: Basis


def _curved(causes: Sequence[Cause]) -> dict[str, Mapping[str, float]]:
    return {e.id: v for e, _, v in causes if e.bends}


def _joint(
    grounds: Grounds, compared: Sequence[bool], causes: Sequence[Cause], found: Sequence[tuple[Place, Test]]
) -> Joint:
    """The model's own terms fitted anew beside causes and functions; as they were where all of these are changes."""
    study, fitted = grounds.study, []
    given = [offer for _, offer, _ in causes]
    for effect, offer, values in causes:
        own = {effect.fitted[k]: values[effect.fitted[k]] for k in offer.which if effect.fitted[k] in values}
        if not own:
            test = _mixed(grounds, compared, given, []).test(offer, [g for g in given if g != offer])
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


def _comes_again(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Offer], joint: Joint, place: Place
) -> bool:
    """Whether what the other flights tell of a function is there in each compared flight that was left out in turn.

    One flight that went alone to a place cannot tell the place from what else was on in that flight.
    """
    others = [p for p, _ in joint.functions if p != place]
    slopes, weights = [], []
    for out in np.flatnonzero(compared):
        keep = [k for k in range(len(compared)) if k != out]
        fewer, flags = grounds._replace(parts=[grounds.parts[k] for k in keep]), [compared[k] for k in keep]
        value = _tested(fewer, flags, given, others, place).value
        told = joint._replace(functions=[(p, value if p == place else v) for p, v in joint.functions])
        slope, weight = _slope(fewer, flags, [grounds.parts[out]], told, place)
        slopes.append(slope)
        weights.append(weight)
    return float(np.average(slopes, weights=weights)) > AGAIN if sum(weights) > 0 else False


def _residual(flight: Evidence, joint: Joint, vehicle: Vehicle) -> np.ndarray:
    """What the joint fit leaves of a compared flight (n, 6)."""
    left = flight.residual
    if joint.base is not None:
        left = left - sum(b * column for b, (_, column) in zip(joint.base, base_columns(flight)))
    for effect, _, at, own in joint.causes:
        at = at if effect.bends and at else dict.fromkeys(effect.parameters, 0.0)
        columns = columns_of(effect, flight, vehicle, at)
        left = left - beyond_slope(effect, flight, vehicle, at) - sum(columns[n] * v for n, v in own.items())
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


def _grounds(
    flights: Sequence[Evidence], causes: Sequence[Cause], vehicle: Vehicle, like: Grounds | None = None
) -> Grounds:
    """like  those whose functions and noise are taken over: held-out flights choose neither."""
    effects = {e.id: e for e, *_ in causes}
    study = gather_study(flights, effects, vehicle, _curved(causes))
    if like is not None:
        study = study._replace(whitener=like.study.whitener)
    basis = basis_of(flights) if like is None else like.basis
    parts, thinned = [], []
    for flight, part in zip(flights, study.thinned):
        functions = thin(basis.functions(flight)[:, None], flight.breaks, flight.t, BAND, 2 * ORDER).columns[:, 0]
        thinned.append(functions)
        columns = np.concatenate(
            [part.columns, np.broadcast_to(functions[:, None], (len(functions), 6, functions.shape[1]))], axis=2
        )
        white, rows = whiten(columns, part.breaks, study.whitener)
        number = ((flight.t[part.rows][rows] - flight.t[part.rows][rows[0]]) / BLOCK).astype(int)
        white = white.transpose(1, 0, 2)
        blocks = [w.transpose(0, 2, 1) @ w for w in (white[:, number == n] for n in np.unique(number))]
        parts.append(np.array(blocks))
    return Grounds(study, basis, parts, thinned)


def _mixed(grounds: Grounds, compared: Sequence[bool], given: Sequence[Offer], places: Sequence[Place]) -> Mixed:
    """The mixed model with nothing but what is given and some smooth functions, a matter of small matrices."""
    layout, size = grounds.study.columns, len(grounds.study.names)
    names = dict.fromkeys(g.cause for g in given)
    use = [0, *layout.shared, *layout.nuisance, *(c for n in names for c in layout.causes[n])]
    place = {c: i for i, c in enumerate(use)}
    causes = {n: [place[c] for c in layout.causes[n]] for n in names}
    at = len(use)
    for p in places:
        causes[p.name] = list(range(at, at + len(p.choice.which)))
        at += len(p.choice.which)
    grams = []
    for part in grounds.parts:
        gram = np.zeros((len(part), at, at))
        gram[:, : len(use), : len(use)] = part[:, :, use][:, :, :, use].sum(axis=1)
        for p in places:
            own, source = causes[p.name], [size + k for k in p.choice.which]
            cross = part[:, p.channel][:, use][:, :, source]
            gram[:, : len(use), own[0] : own[-1] + 1] = cross
            gram[:, own[0] : own[-1] + 1, : len(use)] = cross.transpose(0, 2, 1)
            for q in places:
                if q.channel == p.channel:
                    other, beside = causes[q.name], [size + k for k in q.choice.which]
                    gram[:, own[0] : own[-1] + 1, other[0] : other[-1] + 1] = part[:, p.channel][:, source][
                        :, :, beside
                    ]
        grams.append(gram)
    return Mixed(
        grams,
        compared,
        Columns([place[c] for c in layout.shared], [place[c] for c in layout.nuisance], layout.spread, causes),
    )


def _offer(place: Place) -> Offer:
    return Offer(place.name, place.since, tuple(range(len(place.choice.which))))


def _tested(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Offer], others: Sequence[Place], place: Place
) -> Test:
    mixed = _mixed(grounds, compared, given, [*others, place])
    # the functions of a place share one spread, which is known as many times better
    mixed.freedom *= len(place.choice.which)
    pooled = [place.name] if place.since == "changed" else []
    return mixed.test(_offer(place), [*given, *(_offer(o) for o in others)], pooled)


def _found(grounds: Grounds, compared: Sequence[bool], given: Sequence[Offer], rate: float) -> list[tuple[Place, Test]]:
    """Forward selection with backward removal at a family-wise rate; first what changed, then what all have alike."""
    stages = ["always"] if all(compared) else ["changed", "always"]
    choices = [(k, choice) for k in range(6) for choice in grounds.basis.choices]
    level = rate / max(len(stages) * len(choices), 1)
    found: list[Place] = []
    for since in stages:
        while len(found) < MOST:
            taken = {(p.channel, p.choice.where) for p in found}
            offered = [Place(k, c, since) for k, c in choices if (k, c.where) not in taken]
            certain = _certain(grounds, compared, given, found, offered)
            open_ = sorted((p for p in offered if certain[p] < level), key=certain.get)
            tests = [(p, _tested(grounds, compared, given, found, p)) for p in open_]
            best = min(tests, key=lambda pair: pair[1].p, default=None)
            if best is None or best[1].p >= level:
                break
            found.append(best[0])
    while True:
        tests = [(p, _tested(grounds, compared, given, [f for f in found if f != p], p)) for p in found]
        weak = max(tests, key=lambda pair: pair[1].p, default=None)
        if weak is None or weak[1].p < level:
            return tests
        found.remove(weak[0])


def _certain(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Offer], found: Sequence[Place], offered: Sequence[Place]
) -> dict[Place, float]:
    """Probability of nothing of each offer if flights did not differ: a lower bound, so that few need the full test."""
    layout, size = grounds.study.columns, len(grounds.study.names)
    base = [*layout.shared]
    alike = [*base, *(layout.causes[g.cause][k] for g in given if g.since == "always" for k in g.which)]
    new = [layout.causes[g.cause][k] for g in given if g.since == "changed" for k in g.which]
    result = {}
    for channel in dict.fromkeys(p.channel for p in offered):
        beside = [p for p in found if p.channel == channel]
        width = grounds.parts[0].shape[-1] - size
        for since in dict.fromkeys(p.since for p in offered):
            total = 0.0
            for part, flag in zip(grounds.parts, compared):
                summed = part.sum(axis=0)
                gram = np.zeros((size + width, size + width))
                gram[:size, :size] = summed[:, :size, :size].sum(axis=0)
                gram[size:, :] = summed[channel][size:, :]
                gram[:, size:] = summed[channel][:, size:]
                gram = marginal(gram, layout.nuisance, layout.spread)
                use = [0, *alike, *new, *(size + k for k in range(width))]
                whole = gram[np.ix_(use, use)]
                if not flag:
                    off = slice(1 + len(alike), 1 + len(alike) + len(new))
                    whole[off, :] = whole[:, off] = 0.0
                # the functions twice: of all flights, and of the compared ones alone
                own = slice(1 + len(alike) + len(new), None)
                again = whole[:, own] * flag
                corner = whole[own, own] * flag
                total = total + np.block([[whole, again], [again.T, corner]])
            scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
            total = total / np.outer(scale, scale)
            start = 1 + len(alike) + len(new)
            known = list(range(1, start))
            for p in beside:
                shift = width if p.since == "changed" else 0
                known += [start + k + shift for k in p.choice.which]
            for p in offered:
                if p.channel != channel or p.since != since:
                    continue
                shift = width if since == "changed" else 0
                pooled = [start + k for k in p.choice.which] if since == "changed" else []
                fixed = list(dict.fromkeys([*known, *pooled]))
                own = [c for c in (start + k + shift for k in p.choice.which) if c not in fixed]
                inner = total[np.ix_(fixed, fixed)] + 1e-9 * np.eye(len(fixed))
                use = [0, *own]
                rest = total[np.ix_(use, use)] - total[np.ix_(use, fixed)] @ np.linalg.solve(
                    inner, total[np.ix_(fixed, use)]
                )
                gain = rest[0, 1:] @ np.linalg.solve(rest[1:, 1:] + 1e-9 * np.eye(len(own)), rest[1:, 0])
                result[p] = float(chi2.sf(gain * scale[0] ** 2, len(own)))
    return result
