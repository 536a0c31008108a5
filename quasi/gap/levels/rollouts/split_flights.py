"""What a held-out flight has of its own, estimated on its first half and judged on its second.

A battery put back half a millimetre off trims a light quadrotor anew: no other flight shows that, and no model made
of other flights can know it. The flight's first half shows it: parameters of named causes that belong to a flight or a
session (their scope), and the constant force and moment that its usual differences from other flights amount to
(`nuisance`). All are estimated with what is known of them beforehand: a cause's parameters lie about what the other
flights say, within the size that is typical of it; nuisances within their known spreads. Then every model is judged on
the second half alone, on the same windows: as it was and extended, without and with the trim.

Least squares in plain residuals, not white ones: what a simulation needs is a small error. Residuals remember; they
count as so much less information. Source: Draper & Smith, Applied Regression Analysis, 3rd ed., 1998, chapter 17, for
the estimate with prior knowledge.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.gap.catalogue import columns_of
from quasi.gap.effect import Effect, Values, Vehicle
from quasi.gap.extension import extend, joined
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.instruments import shown
from quasi.gap.levels.forces.design import BAND, ORDER, ROW_MEMORY
from quasi.gap.levels.forces.error_reduction import after, wrench_score
from quasi.gap.levels.forces.nuisance import nuisances
from quasi.gap.levels.rollouts import open_loop
from quasi.gap.statistics.whitening import thin
from quasi.model.model import AXES, Model
from quasi.simulation.tools.rollout import count_steps

OWN_SCOPES = ("s", "f")
FILTER_REACH = 0.2  # s: the filter of a flight sees that far ahead, windows start so much later
LEAST_HALF = 5.0  # s of a half, from which a trim is estimated


class Own(NamedTuple):
    """What one flight has of its own. until (s) its first half ends; parameters, std {cause: {name: deviation}};
    trim, trim_std (6,) N and N m: constant wrench that the model lacks there."""

    until: float
    parameters: dict[str, dict[str, float]]
    std: dict[str, dict[str, float]]
    trim: np.ndarray
    trim_std: np.ndarray


def own(
    flight: Evidence, model: Model, base: Model, causes: Sequence[tuple[Effect, Values]], vehicle: Vehicle,
    level: np.ndarray,
) -> Own | None:  # fmt: skip
    """Estimate on a flight's first half; None where that has less than LEAST_HALF seconds.

    model   whose residual is explained: `base` itself, or its extension by `causes` (deviations from neutral)
    level   (6,) mean squared residual of the flights that were learned from; 0 of axes that do not count
    """
    causes, until = joined(causes), float(np.median(flight.t))
    scoped = [(e, n) for e, values in causes for n in values if _is_own(e, n, vehicle)]
    columns = [flight.measured - shown(model, base, flight)]
    spread = []
    for effect, name in scoped:
        at = dict.fromkeys(effect.parameters, 0.0) | dict(next(v for e, v in causes if e is effect))
        columns.append(columns_of(effect, flight, vehicle, at)[name])
        spread.append(_size(effect, name, vehicle))
    usual = nuisances(flight)
    columns += [column for _, column, _ in usual]
    spread = np.array([*spread, *(s for *_, s in usual)])
    part = thin(np.stack(columns, axis=2), flight.breaks, flight.t, BAND, 2 * ORDER)
    first = flight.t[part.rows] <= until
    step = float(np.median(np.diff(flight.t[part.rows]))) if len(part.rows) > 1 else 0.0
    if np.count_nonzero(first) * step < LEAST_HALF:
        return None
    seen = part.columns[first]
    weight = np.divide(1.0, ROW_MEMORY * level, out=np.zeros(len(level)), where=level > 0.0)
    gram = np.einsum("k,nki,nkj->ij", weight, seen, seen)
    scaled = gram[1:, 1:] * np.outer(spread, spread) + np.eye(len(spread))
    inverse = np.linalg.inv(scaled) * np.outer(spread, spread)
    value, std = inverse @ gram[1:, 0], np.sqrt(np.diag(inverse))
    parameters: dict[str, dict[str, float]] = {}
    errors: dict[str, dict[str, float]] = {}
    for (effect, name), v, s in zip(scoped, value, std):
        learned = next(values for e, values in causes if e is effect)[name]
        parameters.setdefault(effect.id, {})[name] = float(learned + v)
        errors.setdefault(effect.id, {})[name] = float(s)
    at = slice(len(scoped), None)
    mean = seen[:, :, 1:][:, :, at].mean(axis=0)
    trim_std = np.sqrt(np.einsum("ki,ij,kj->k", mean, inverse[at, at], mean))
    return Own(until, parameters, errors, mean @ value[at], trim_std)


def _is_own(effect: Effect, name: str, vehicle: Vehicle) -> bool:
    if (effect.terms is None and effect.columns is None) or not effect.typical(vehicle):
        return False
    return name in effect.fitted and effect.parameters[name].scope in OWN_SCOPES


def _size(effect: Effect, name: str, vehicle: Vehicle) -> float:
    """Typical deviation; of a parameter that only accompanies others, the largest of theirs."""
    sizes = effect.typical(vehicle)
    return sizes.get(name, max(sizes.values()))


def with_own(
    extended: Model, base: Model, causes: Sequence[tuple[Effect, Values]], found: Own, vehicle: Vehicle
) -> Model:
    """The extended model with a flight's own parameters; what was fitted anew with the causes stays as it was."""
    changes = []
    for axis in AXES:
        old = base.document["axes"].get(axis, {"terms": []})["terms"]
        new = extended.document["axes"].get(axis, {"terms": []})["terms"]
        changes += [b["coefficient"] - a["coefficient"] for a, b in zip(old, new)]
    pairs = [(e, {**values, **found.parameters.get(e.id, {})}) for e, values in joined(causes)]
    return Model(extend(base, pairs, vehicle, extended.id, "its own parameters", np.array(changes)), extended.id)


def gain(
    held: Sequence[Evidence], tables: Mapping[str, pd.DataFrame], learning: Sequence[Evidence], base: Model,
    sides: Sequence[tuple[Model, Sequence[tuple[Effect, Values]]]], vehicle: Vehicle, quantity: str, horizon: float,
) -> float | None:  # fmt: skip
    """Share of the squared error of a quantity that the second of two extended models removes on second halves.

    sides  (extended model, its causes), each with the flights' own parameters of its causes, from the first halves
    None where no held-out flight has both halves. Other arguments as for `judge`.
    """
    sums = np.zeros(2)
    for evidence in held:
        flight = open_loop.flight_of(evidence.key, tables[evidence.key], evidence.mass, evidence.inertia)
        ends = []
        for model, causes in sides:
            level = wrench_score(learning, after(model, base)).mean()
            found = own(evidence, model, base, causes, vehicle, level)
            if found is None:
                break
            starts = _late(flight, found.until, horizon)
            if not len(starts):
                break
            fitted = with_own(model, base, causes, found, vehicle) if found.parameters else model
            lags = np.array([count_steps(flight.t, horizon)])
            errors = open_loop.vectors(open_loop.simulated(fitted, flight, starts, horizon), flight, starts, lags)
            ends.append(open_loop.table_of(flight, starts, errors, [horizon]))
        if ends:  # halves are those of the flight, under either model
            sums += [float(squared.sum()) for squared in open_loop.squares(ends, [quantity])]
    return 1.0 - float(sums[1] / sums[0]) if sums[0] > 0.0 else None


def _late(flight: open_loop.Flight, until: float, horizon: float) -> np.ndarray:
    """Rows at which windows of the second half start."""
    starts = open_loop.windows(flight, horizon)
    return starts[flight.t[starts] > until + FILTER_REACH]


def judge(
    held: Sequence[Evidence],
    tables: Mapping[str, pd.DataFrame],
    learning: Sequence[Evidence],
    base: Model,
    extended: Model,
    causes: Sequence[tuple[Effect, Values]],
    vehicle: Vehicle,
    horizons: Sequence[float],
) -> dict[str, Any]:
    """Roll-outs of the second halves of held-out flights with measured rotor speeds.

    tables  {key: filtered flight}; learning  flights whose residuals give the noise; causes  of the extension, all of
    them, with the values from the other flights
    Returns {"flights": {key: {"until", "windows", "parameters", "trim"}}, "errors": {who: {quantity: {horizon: rms}}},
    "fell": {who: rows of `open_loop.fell` against "before"}}; who is "before", "after", "after, own parameters" where a
    cause has any, "before, trimmed", "after, trimmed". Empty where no flight has enough of both
    halves, or none is left to learn from.
    """
    if not learning:
        return {}  # the noise is unknown
    old, new = (wrench_score(learning, after(m, base)).mean() for m in (base, extended))
    flights: dict[str, Any] = {}
    parts: dict[str, list[pd.DataFrame]] = {}
    for evidence in held:
        bare = own(evidence, base, base, (), vehicle, old)
        mine = own(evidence, extended, base, causes, vehicle, new)
        flight = open_loop.flight_of(evidence.key, tables[evidence.key], evidence.mass, evidence.inertia)
        if bare is None or mine is None:
            continue
        starts = _late(flight, bare.until, max(horizons))
        if not len(starts):
            continue
        fitted = with_own(extended, base, causes, mine, vehicle) if mine.parameters else extended
        contenders = {"before": (base, None), "after": (extended, None)}
        if mine.parameters:
            contenders["after, own parameters"] = fitted, None
        contenders |= {"before, trimmed": (base, bare.trim), "after, trimmed": (fitted, mine.trim)}
        lags = np.array([count_steps(flight.t, h) for h in horizons])
        for who, (model, trim) in contenders.items():
            wanted = None if trim is None else np.tile(trim, (len(starts), 1))
            offsets = None if wanted is None else open_loop.in_own_constants(wanted, model, flight)
            run = open_loop.simulated(model, flight, starts, max(horizons), None, offsets)
            errors = open_loop.vectors(run, flight, starts, lags)
            parts.setdefault(who, []).append(open_loop.table_of(flight, starts, errors, horizons))
        flights[evidence.key] = _document(bare, mine, len(starts))
    if not flights:
        return {}
    whole = {who: open_loop.joined(tables) for who, tables in parts.items()}
    return {
        "flights": flights,
        "errors": {who: open_loop.rms(table) for who, table in whole.items()},
        "fell": {who: open_loop.fell(whole["before"], table) for who, table in whole.items() if who != "before"},
    }


def _document(bare: Own, mine: Own, windows: int) -> dict[str, Any]:
    trim = {
        axis: {"before": float(bare.trim[k]), "after": float(mine.trim[k]), "std": float(bare.trim_std[k])}
        for k, axis in enumerate(AXES)
    }
    parameters = {
        cause: {n: {"value": v, "std": mine.std[cause][n]} for n, v in values.items()}
        for cause, values in mine.parameters.items()
    }
    return {"until": bare.until, "windows": windows, "parameters": parameters, "trim": trim}
