"""Cross-products of all flights of a gap: the model's terms, nuisances, causes, and where a residual may live."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from quasi.errors import DataError, ExpressionError
from quasi.gap.catalogue import beyond_slope, columns_of, corrected, in_columns
from quasi.gap.causes.rotor_effectiveness import THRUST_DIFFERENCES, holds_thrust
from quasi.gap.effect import Effect, Vehicle, as_flown, vehicle_of
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.sessions import units
from quasi.gap.levels.forces.nuisance import SEATED, nuisances, session_nuisances
from quasi.gap.materiality import Cause
from quasi.gap.statistics.blocks import BLOCK
from quasi.gap.statistics.candidates import Columns
from quasi.gap.statistics.clustered import ClusteredMixedModel
from quasi.gap.statistics.mixed import MixedModel, marginal
from quasi.gap.statistics.whitening import Thinned, Whitener, autoregression, channel_grams, thin
from quasi.model.model import AXES
from quasi.terms.expressions import Program, parse
from quasi.terms.variables import Variables

BAND = 10.0  # Hz
ORDER = 6  # of the autoregression
STRETCH_BLOCKS = 2  # blocks, about a manoeuvre
MOST_STRETCHES = 160  # stretches of all flights together: the time of a test grows with their cube
BOUND = 3.0  # typical sizes: wide enough for any real vehicle, too narrow for what references without the cause return
LIGHT = 1e-6  # ridge of the per-flight fit whose residual gives the noise
Values = Mapping[str, Mapping[str, float]]  # {cause: {parameter: deviation}}


class Part(NamedTuple):
    """What a design holds of one flight, see `Design`."""

    thinned: Thinned
    blocks: np.ndarray
    channels: np.ndarray
    raw: np.ndarray


class Design(NamedTuple):
    """Everything the search works on.

    flights   evidence, in order; thinned  their columns (m, 6, P) in the band of the analysis
    columns   what is what in them; names  of all columns
    blocks    per flight (B, P, P) whitened cross-products of its blocks
    channels  per flight (K, 6, P, P) whitened cross-products of each stretch and channel, see `in_stretches`
    raw       per flight (6, P, P) plain cross-products per channel, for mean squared errors
    whitener  of the residuals; lacking {cause: why it cannot be asked}
    values    per flight, that causes are linearised at: a reference flight has none of what changed
    """

    flights: list[Evidence]
    thinned: list[Thinned]
    columns: Columns
    names: list[str]
    blocks: list[np.ndarray]
    channels: list[np.ndarray]
    raw: list[np.ndarray]
    whitener: Whitener
    lacking: dict[str, str]
    values: Sequence[Values]

    def part(self, flight: int) -> Part:
        """What it holds of one flight, by number."""
        return Part(self.thinned[flight], self.blocks[flight], self.channels[flight], self.raw[flight])

    def mixed(self, use: Sequence[int], compared: Sequence[bool], prior: np.ndarray | None = None) -> MixedModel:
        """The mixed model of some of the flights. prior  precision (shared, shared) of the model's own terms.

        A model errs with the manoeuvre, and manoeuvres change within a flight: a cause's apparent parameters deviate
        from stretch to stretch. What differs between whole flights has known spreads, the nuisances.
        """
        sessions = [self.flights[f].session for f in use]
        return MixedModel(
            [in_stretches(self.blocks[f], len(use)) for f in use], compared, self.columns, prior, sessions
        )

    def flown(self, compared: Sequence[bool]) -> Vehicle:
        """The vehicle as the compared flights were processed."""
        flights = [flight for flight, flag in zip(self.flights, compared) if flag]
        return as_flown(vehicle_of(self.flights[0].model), flights)

    def witnessed(self, use: Sequence[int], compared: Sequence[bool]) -> ClusteredMixedModel:
        """The mixed model of some of the flights that names causes."""
        sessions = [self.flights[f].session for f in use]
        members = units(sessions, compared)
        grams = [in_stretches(self.blocks[f], len(use)) for f in use]
        return ClusteredMixedModel(grams, compared, self.columns, members, sessions)


def in_stretches(blocks: np.ndarray, flights: int = 1) -> np.ndarray:
    """Cross-products (K, P, P) of stretches of STRETCH_BLOCKS blocks each, of more where there are many flights."""
    return joined(blocks, min(len(blocks) // STRETCH_BLOCKS, MOST_STRETCHES // flights))


def joined(blocks: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, ...) of consecutive blocks (B, ...), all equally many but for the last, which takes what is over."""
    count = max(min(count, len(blocks)), 1)
    length = len(blocks) // count
    ends = [0, *(length * (k + 1) for k in range(count - 1)), len(blocks)]
    return np.array([blocks[a:b].sum(axis=0) for a, b in pairwise(ends)])


ROW_MEMORY = 20.0  # samples that a residual remembers: information is counted that much lower


def refit_with(
    study: Design, compared: Sequence[bool], pairs: Sequence[tuple[Cause, Mapping[str, float]]],
    axes: Collection[str] = AXES,
) -> np.ndarray:  # fmt: skip
    """`refit` to all flights of a design, with causes and their deviations by name; of some axes alone."""
    flown, values = study.flown(compared), {}
    for cause, deviations in pairs:
        sizes = in_columns(cause.effect, deviations, flown)
        values[cause.effect.id, cause.since] = {cause.effect.fitted.index(n): x for n, x in sizes.items()}
    return refit(study, range(len(compared)), compared, values, axes)


def refit(
    study: Design, use: Sequence[int], compared: Sequence[bool], values: Mapping[tuple[str, str], Mapping[int, float]],
    axes: Collection[str] = AXES,
) -> np.ndarray:  # fmt: skip
    """Changes (S,) of the model's own coefficients once causes are taken out, by least squares in plain residuals.

    values  {(cause, since): {position of the parameter: deviation}}; axes  whose terms change
    Unwhitened, every axis by its own residual: what a simulation needs is a small error, not a white one. Flights'
    nuisances are integrated out. With a cause, the terms that had to stand in for it find their own values.
    """
    columns, size = study.columns, len(study.names)
    level = sum(np.einsum("kii->ki", study.raw[f])[:, 0] for f in use)
    weight = sum(len(study.thinned[f].rows) for f in use) / np.maximum(level, 1e-300) / ROW_MEMORY
    inner, right = np.zeros((len(columns.shared),) * 2), np.zeros(len(columns.shared))
    for f, flag in zip(use, compared):
        gram = marginal(np.einsum("k,kij->ij", weight, study.raw[f]), columns.nuisance, columns.spread)
        target = np.zeros(size)
        target[0] = 1.0
        for (cause, since), deviations in values.items():
            if flag or since == "always":
                for position, deviation in deviations.items():
                    target[columns.causes[cause][position]] -= deviation
        inner += gram[np.ix_(columns.shared, columns.shared)]
        right += gram[columns.shared] @ target
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    found = np.linalg.solve(inner / np.outer(scale, scale) + LIGHT * np.eye(len(scale)), right / scale) / scale
    return np.where([study.names[c].split(":")[0] in axes for c in columns.shared], found, 0.0)


def base_columns(evidence: Evidence) -> list[tuple[str, np.ndarray]]:
    """Columns (n, 6) of the model's own terms.

    Yaw moments that differences of thrust make next to rates are small and little known. By a weak rotor's trim, which
    is no thrust, they could take up what that rotor does: such differences count from their mean.
    """
    variables = Variables(evidence.columns, evidence.airframe, evidence.model.hover_speed)
    result = []
    for axis in AXES:
        for term in evidence.model.document["axes"].get(axis, {"terms": []})["terms"]:
            tree = parse(term["expression"])
            program, centred = Program([tree]), axis == "Mz" and holds_thrust(tree)
            known = {n: variables[n] for n in program.names}
            if centred:
                known |= {n: known[n] - known[n].mean() for n in THRUST_DIFFERENCES & known.keys()}
            values = program.run(known, len(evidence))[0]
            result.append((f"{axis}: {term['expression']}", evidence.only(axis, values)))
    return result


def with_own_terms_anew(flights: Sequence[Evidence], axes: Collection[str] = AXES) -> list[Evidence]:
    """Flights with what their model's terms, those of some axes fitted to all of them without their means, would
    predict."""
    if not flights:
        return []
    columns = [np.stack([c for _, c in base_columns(e)], axis=-1) for e in flights]  # (n, 6, P)
    swings = [c - c.mean(axis=0) for c in columns]
    change = np.zeros((len(AXES), columns[0].shape[-1]))
    for k in (AXES.index(axis) for axis in axes):
        left = np.concatenate([e.residual[:, k] - e.residual[:, k].mean() for e in flights])
        own = np.concatenate([c[:, k] for c in swings])
        change[k] = np.linalg.lstsq(own, left, rcond=None)[0]
    return [replace(e, predicted=e.predicted + np.einsum("nkp,kp->nk", c, change)) for e, c in zip(flights, columns)]


def bounds_of(effect: Effect, vehicle: Vehicle) -> np.ndarray:
    """Standard deviation (m,) of what all flights may have of each fitted parameter: BOUND typical sizes.

    Infinite for parameters that only accompany others.
    """
    sizes = effect.typical(vehicle)
    return np.array([BOUND * sizes.get(name, np.inf) for name in effect.fitted])


def _one_for_all(effect: Effect) -> bool:
    """Whether all flights have the same value of a cause."""
    return all(effect.parameters[name].scope != "f" for name in effect.fitted)


def gather_design(
    flights: Sequence[Evidence],
    effects: Mapping[str, Effect],
    vehicle: Vehicle,
    values: Sequence[Values] | None = None,
    idle: bool = False,
) -> Design:
    """Build the cross-products of all flights.

    effects  causes to be asked; values  per flight, to linearise at where not neutral
    idle     whether causes stay that do nothing in these flights, to match the columns of others
    A cause whose columns a flight cannot give is left out, with the reason in `lacking`.
    """
    lacking: dict[str, str] = {}
    values = values or [{} for _ in flights]
    asked = {name: e for name, e in effects.items() if e.terms is not None or e.columns is not None}
    made: list[dict[str, dict[str, np.ndarray]]] = [{} for _ in flights]
    true = [corrected(flight, asked, own) for flight, own in zip(flights, values)]
    for name, effect in list(asked.items()):
        try:
            for columns, flight, own in zip(made, flights if effect.corrected else true, values):
                at = own.get(name) or dict.fromkeys(effect.parameters, 0.0)
                columns[name] = columns_of(effect, flight, vehicle, at)
            if not idle and not any(column.any() for columns in made for column in columns[name].values()):
                raise DataError(f"effect '{name}' adds no force or moment at all in these flights")
        except (DataError, ExpressionError) as error:
            nowhere = re.search("column '[xyz]'", str(error))
            lacking[name] = f"the place is not known in every flight ({error})" if nowhere else str(error)
            del asked[name]
    thinned, names, layout = [], [], None
    for flight, seen, columns, at in zip(flights, true, made, values):
        parts = [("residual", _straight(flight, asked, vehicle, at, columns))]
        shared = base_columns(seen)
        own, of_session = nuisances(seen), session_nuisances(seen)
        parts += shared + [(n, c) for n, c, _ in (*own, *of_session)]
        causes: dict[str, list[int]] = {}
        for name in asked:
            for parameter, column in columns.pop(name).items():
                causes.setdefault(name, []).append(len(parts))
                parts.append((f"{name}: {parameter}", column))
        thinned.append(_thinned(flight, [column for _, column in parts]))
        if not len(thinned[-1].rows):
            raise DataError(f"flight {flight.key} has no second of valid data without a gap; fly longer")
        names = [name for name, _ in parts]
        first = 1 + len(shared)
        # slopes at each flight's own values, with terms that hold them all, would make up any change; what every
        # flight has its own value of, no terms hold
        bent = tuple(
            n for n in causes if asked[n].is_nonlinear and asked[n].absorbed_by_model and _one_for_all(asked[n])
        )
        spread = np.array([s for *_, s in own])
        usual = {n: bounds_of(asked[n], vehicle) for n in causes}
        then = first + len(own)
        # how sensors are seated is a session's as well: its flights share it
        seated = [k for k, (n, *_) in enumerate(own) if n.startswith(SEATED)]
        session = (*range(then, then + len(of_session)), *(first + k for k in seated))
        layout = Columns(
            list(range(1, first)), list(range(first, then)), spread, causes, bent, bounds=usual,
            session=session, session_spread=(*(s for *_, s in of_session), *spread[seated]),
        )  # fmt: skip
    breaks = [part.breaks for part in thinned]
    whitener = autoregression([own_fit(part.columns, layout) for part in thinned], breaks, ORDER)
    parts = [_part(flight, part, whitener, len(flights)) for flight, part in zip(flights, thinned)]
    return Design(list(flights), **_listed(parts), columns=layout, names=names, whitener=whitener, lacking=lacking,
                  values=values)  # fmt: skip


def moved(study: Design, effects: Mapping[str, Effect], vehicle: Vehicle, values: Sequence[Values]) -> Design:
    """The study with its curved causes linearised at other values, per flight; nothing else is computed anew, unless
    the flights' instruments are taken to have erred.
    """
    met = {n for own in (*values, *study.values) for n in own}
    again = any(effects[n].corrected for n in met if n in effects)
    changed = [n for n in study.columns.causes if again or n in met]
    parts = []
    for k, (flight, old, own) in enumerate(zip(study.flights, study.thinned, values)):
        if own == study.values[k] and not any(any(at.values()) for at in own.values()):
            parts.append(study.part(k))  # as most reference flights: nothing is there
            continue
        true = corrected(flight, effects, own)
        slopes = {
            name: columns_of(
                effects[name], flight if effects[name].corrected else true, vehicle,
                own.get(name) or dict.fromkeys(effects[name].parameters, 0.0),
            )
            for name in changed
        }  # fmt: skip
        place, columns = [0], [_straight(flight, effects, vehicle, own, slopes)]
        if again:  # terms of some flights read with the error would, with causes read without, make up any change
            nuisance = study.columns.nuisance
            place += [*study.columns.shared, *nuisance, *(c for c in study.columns.session if c not in nuisance)]
            columns += [c for _, c in base_columns(true)] + [c for _, c, _ in nuisances(true)]
            columns += [c for _, c, _ in session_nuisances(true)]
        for name in changed:
            place += study.columns.causes[name]
            columns += slopes[name].values()
        whole = old.columns.copy()
        whole[:, :, place] = _thinned(flight, columns).columns
        parts.append(_part(flight, old._replace(columns=whole), study.whitener, len(study.flights)))
    return study._replace(values=values, **_listed(parts))


def _straight(
    flight: Evidence, effects: Mapping[str, Effect], vehicle: Vehicle, values: Values,
    slopes: Mapping[str, Mapping[str, np.ndarray]],
) -> np.ndarray:  # fmt: skip
    """Residual (n, 6) less what curved causes at their values are more than their slopes."""
    true, left = corrected(flight, effects, values), flight.residual
    for name, at in values.items():
        if name in slopes:
            shown = flight if effects[name].corrected else true
            left = left - beyond_slope(effects[name], shown, vehicle, at, slopes[name])
    return left


def _thinned(flight: Evidence, columns: Sequence[np.ndarray]) -> Thinned:
    stacked = np.stack(columns, axis=2)
    stacked[:, list(flight.excluded)] = 0.0
    return thin(stacked, flight.breaks, flight.t, BAND, 2 * ORDER)


def _part(flight: Evidence, thinned: Thinned, whitener: Whitener, count: int) -> Part:
    """What a design of `count` flights holds of one of them."""
    grams = channel_grams(thinned.columns, thinned.breaks, whitener, flight.t[thinned.rows], BLOCK)
    raw = np.einsum("nki,nkj->kij", thinned.columns, thinned.columns, optimize=True)
    return Part(thinned, grams.sum(axis=1), in_stretches(grams, count), raw)


def _listed(parts: Sequence[Part]) -> dict[str, list[Any]]:
    return {name: [getattr(part, name) for part in parts] for name in Part._fields}


def own_fit(stack: np.ndarray, layout: Columns) -> np.ndarray:
    """What each flight's own fit of base and nuisances leaves (n, 6)."""
    columns = [*layout.shared, *layout.nuisance]
    left = np.empty(stack.shape[:2])
    for k in range(stack.shape[1]):
        x, y = stack[:, k, columns], stack[:, k, 0]
        scale = np.sqrt(np.einsum("ni,ni->i", x, x))
        x = x[:, scale > 0] / scale[scale > 0]
        left[:, k] = y - x @ np.linalg.solve(x.T @ x + LIGHT * np.eye(x.shape[1]), x.T @ y)
    return left
