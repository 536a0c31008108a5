"""Smooth functions of places as offers next to the model's terms and named causes: cross-products, tests, selection."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from quasi.gap.effect import Effect, Vehicle
from quasi.gap.flights.covariates import Basis, Choice, basis_of
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.design import BAND, MOST_STRETCHES, ORDER, Design, gather_design, joined
from quasi.gap.statistics.blocks import BLOCK
from quasi.gap.statistics.candidates import Candidate, Columns, Test
from quasi.gap.statistics.mixed import RIDGE, MixedModel, marginal
from quasi.gap.statistics.whitening import channel_grams, thin
from quasi.model.model import AXES

MOST_FUNCTIONS = 6  # functions of what is unexplained
Cause = tuple[Effect, Candidate, Mapping[str, float]]


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

    parts    per flight (K, 6, P, P): of each stretch and channel, whitened; the study's columns first, then the basis
    columns  per flight (K, S, S): of the study's columns, the channels added up
    """

    study: Design
    basis: Basis
    parts: list[np.ndarray]
    columns: list[np.ndarray]
    thinned: list[np.ndarray]  # per flight (m, L): the basis in the band of the analysis
    sessions: Sequence[str]

    def of(self, use: Sequence[int]) -> "Grounds":
        """Of some flights, for tests."""
        return self._replace(
            parts=[self.parts[k] for k in use],
            columns=[self.columns[k] for k in use],
            sessions=[self.sessions[k] for k in use],
        )

    def whole(self) -> "Grounds":
        """Of flights that are one stretch each, for tests."""
        parts, columns = ([p.sum(axis=0, keepdims=True) for p in all_] for all_ in (self.parts, self.columns))
        return self._replace(parts=parts, columns=columns)


def curved(causes: Sequence[Cause], compared: bool) -> dict[str, dict[str, float]]:
    """{cause: values} to linearise a compared flight at, or a reference flight, which has none of what changed.

    Of a cause that was always there and has changed as well, both together.
    """
    found: dict[str, dict[str, float]] = {}
    for effect, offer, values in causes:
        if effect.is_nonlinear and (compared or offer.since == "always"):
            own = found.setdefault(effect.id, {})
            own |= {name: own.get(name, 0.0) + value for name, value in values.items()}
    return found


def grounds_of(
    flights: Sequence[Evidence], compared: Sequence[bool], causes: Sequence[Cause], vehicle: Vehicle,
    like: Grounds | None = None, judges: Sequence[Evidence] = (),
) -> Grounds:  # fmt: skip
    """Cross-products of the flights' blocks with the causes' columns and all smooth functions.

    causes  effect, offer, values to linearise at; like  those whose functions and noise are taken over: held-out
    flights choose neither; judges  those flights, which have to know the places of the functions
    """
    effects = {e.id: e for e, *_ in causes}
    values = [curved(causes, bool(flag)) for flag in compared]
    study = gather_design(flights, effects, vehicle, values, idle=like is not None)  # with the columns of `like`
    if like is not None:
        study = study._replace(whitener=like.study.whitener)
    basis = basis_of(flights, judges) if like is None else like.basis
    parts, sums, thinned = [], [], []
    size = len(study.names)
    for flight, part in zip(flights, study.thinned):
        functions = thin(basis.functions(flight)[:, None], flight.breaks, flight.t, BAND, 2 * ORDER).columns[:, 0]
        thinned.append(functions)
        columns = np.concatenate(
            [part.columns, np.broadcast_to(functions[:, None], (len(functions), 6, functions.shape[1]))], axis=2
        )
        blocks = channel_grams(columns, part.breaks, study.whitener, flight.t[part.rows], BLOCK)
        parts.append(joined(blocks, MOST_STRETCHES // len(flights)))
        sums.append(parts[-1][:, :, :size, :size].sum(axis=1))
    return Grounds(study, basis, parts, sums, thinned, [f.session for f in flights])


def mixed_of(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Candidate], places: Sequence[Place]
) -> MixedModel:
    """The mixed model with nothing but what is given and some smooth functions, a matter of small matrices."""
    layout, size = grounds.study.columns, len(grounds.study.names)
    names = dict.fromkeys(g.cause for g in given)
    own = (c for n in names for c in layout.causes[n])
    use = list(dict.fromkeys([0, *layout.shared, *layout.nuisance, *layout.session, *own]))
    place = {c: i for i, c in enumerate(use)}
    causes = {n: [place[c] for c in layout.causes[n]] for n in names}
    at = len(use)
    for p in places:
        causes[p.name] = list(range(at, at + len(p.choice.which)))
        at += len(p.choice.which)
    grams = []
    for part, columns in zip(grounds.parts, grounds.columns):
        gram = np.zeros((len(part), at, at))
        gram[:, : len(use), : len(use)] = columns[:, use][:, :, use]
        for p in places:
            own, source = causes[p.name], [size + k for k in p.choice.which]
            cross = part[:, p.channel][:, :, source][:, use]
            gram[:, : len(use), own[0] : own[-1] + 1] = cross
            gram[:, own[0] : own[-1] + 1, : len(use)] = cross.transpose(0, 2, 1)
            for q in places:
                if q.channel == p.channel:
                    other, source_columns = causes[q.name], [size + k for k in q.choice.which]
                    gram[:, own[0] : own[-1] + 1, other[0] : other[-1] + 1] = part[:, p.channel][:, source][
                        :, :, source_columns
                    ]
        grams.append(gram)
    shared, nuisance, session = ([place[c] for c in own] for own in (layout.shared, layout.nuisance, layout.session))
    columns = Columns(
        shared, nuisance, layout.spread, causes, session=tuple(session), session_spread=layout.session_spread
    )
    return MixedModel(grams, compared, columns, sessions=grounds.sessions)


def offer_of(place: Place) -> Candidate:
    """A smooth function with all its parts."""
    return Candidate(place.name, place.since, tuple(range(len(place.choice.which))))


def tested(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Candidate], others: Sequence[Place], place: Place
) -> Test:
    """The test of one function with causes and other functions given."""
    mixed = mixed_of(grounds, compared, given, [*others, place])
    # the functions of a place share one spread, which is known as many times better
    mixed.freedom *= len(place.choice.which)
    pooled = [place.name] if place.since == "changed" else []
    return mixed.test(offer_of(place), [*given, *(offer_of(o) for o in others)], pooled)


def stages_of(compared: Sequence[bool]) -> list[str]:
    """What can be asked of these flights, in order."""
    return ["always"] if all(compared) else ["changed", "always"]


def level_of(grounds: Grounds, compared: Sequence[bool], rate: float) -> float:
    """p that a function must pass, of a family-wise rate."""
    return rate / (len(stages_of(compared)) * 6 * len(grounds.basis.choices))


def select(
    grounds: Grounds, compared: Sequence[bool], given: Sequence[Candidate], rate: float
) -> list[tuple[Place, Test]]:
    """Forward selection with backward removal at a family-wise rate; first what changed, then what all have alike.

    What changed is not taken back for what all flights have alike: a model's own errors of form can follow anything.
    """
    choices = [(k, choice) for k in range(6) for choice in grounds.basis.choices]
    level, stages = level_of(grounds, compared, rate), stages_of(compared)
    settled: list[tuple[Place, Test]] = []
    sums = _sums(grounds, compared, given)
    for since in stages:
        found = [place for place, _ in settled]
        while len(found) < MOST_FUNCTIONS:
            taken = {(p.channel, p.choice.where) for p in found}
            offered = [Place(k, c, since) for k, c in choices if (k, c.where) not in taken]
            certain = _certain(sums, found, offered)
            open_ = sorted((p for p in offered if certain[p] < level), key=certain.get)
            tests = [(p, tested(grounds, compared, given, found, p)) for p in open_]
            best = min(tests, key=lambda pair: pair[1].p, default=None)
            if best is None or best[1].p >= level:
                break
            found.append(best[0])
        while True:
            new = [p for p in found if p.since == since]
            tests = [(p, tested(grounds, compared, given, [f for f in found if f != p], p)) for p in new]
            weak = max(tests, key=lambda pair: pair[1].p, default=None)
            if weak is None or weak[1].p < level:
                settled += tests
                break
            found.remove(weak[0])
    return settled


class _Sums(NamedTuple):
    """Cross-products (Q, Q) of one channel over all flights as if these did not differ, columns scaled to 1: the
    target, `known` columns of terms and causes given, then the functions of all flights, and of the compared ones.
    """

    total: np.ndarray
    known: int
    width: int
    target: float  # size of the target


def _sums(grounds: Grounds, compared: Sequence[bool], given: Sequence[Candidate]) -> list[_Sums]:
    """Of each channel, with its nuisances integrated out."""
    layout, size = grounds.study.columns, len(grounds.study.names)
    width = grounds.parts[0].shape[-1] - size
    alike = [*layout.shared, *(layout.causes[g.cause][k] for g in given if g.since == "always" for k in g.which)]
    new = [layout.causes[g.cause][k] for g in given if g.since == "changed" for k in g.which]
    use = [0, *alike, *new, *(size + k for k in range(width))]
    known = len(alike) + len(new)
    totals = np.zeros((6, 1 + known + 2 * width, 1 + known + 2 * width))
    for part, flag in zip(grounds.parts, compared):
        summed = part.sum(axis=0)
        gram = np.zeros((size + width, size + width))
        gram[:size, :size] = summed[:, :size, :size].sum(axis=0)
        for channel, total in enumerate(totals):
            gram[size:, :] = summed[channel][size:, :]
            gram[:, size:] = summed[channel][:, size:]
            whole = marginal(gram, layout.nuisance, layout.spread)[np.ix_(use, use)]
            if not flag:
                off = slice(1 + len(alike), 1 + known)
                whole[off, :] = whole[:, off] = 0.0
            # the functions twice: of all flights, and of the compared ones alone
            own = slice(1 + known, None)
            again, corner = whole[:, own] * flag, whole[own, own] * flag
            total += np.block([[whole, again], [again.T, corner]])
    found = []
    for total in totals:
        scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
        found.append(_Sums(total / np.outer(scale, scale), known, width, float(scale[0])))
    return found


def _without(gram: np.ndarray, columns: Sequence[int]) -> np.ndarray:
    """Cross-products once some columns are fitted."""
    inner = gram[np.ix_(columns, columns)] + RIDGE * np.eye(len(columns))
    return gram - gram[:, columns] @ np.linalg.solve(inner, gram[columns])


def _explained(inner: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Squares (n,) of the target that columns explain: `inner` (n, k, k) their products, `right` (n, k, 1) with it."""
    return (right * np.linalg.solve(inner, right)).sum(axis=(1, 2))


def _certain(sums: Sequence[_Sums], found: Sequence[Place], offered: Sequence[Place]) -> dict[Place, float]:
    """Probability of nothing of each offer if flights did not differ: a lower bound, so that few need the full test."""
    result = {}
    for channel in dict.fromkeys(p.channel for p in offered):
        total, count, width, target = sums[channel]

        def columns(place: Place, count: int = count, width: int = width) -> list[int]:
            return [1 + count + k + (width if place.since == "changed" else 0) for k in place.choice.which]

        known = [*range(1, 1 + count), *(c for p in found if p.channel == channel for c in columns(p))]
        rest, sizes = _without(total, known), {}
        for place in (p for p in offered if p.channel == channel):
            own = [c for c in columns(place) if c not in known]
            if not own:
                result[place] = 1.0  # what is found holds all of it
                continue
            alike = [c - width for c in own if c - width not in known] if place.since == "changed" else []
            sizes.setdefault((len(alike), len(own)), []).append((place, [*alike, *own]))
        for (first, second), places in sizes.items():
            of = np.array([which for _, which in places])
            inner = rest[of[:, :, None], of[:, None, :]] + RIDGE * np.eye(first + second)
            right = rest[of, 0][:, :, None]
            gain = _explained(inner, right) - _explained(inner[:, :first, :first], right[:, :first])
            probability = chdtrc(second, np.maximum(gain, 0.0) * target**2)
            result |= {place: float(p) for (place, _), p in zip(places, probability)}
    return result
