"""Smooth functions of places fitted together with causes and the model's own terms: what they leave, and how
much of one of them flights show."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from quasi.gap.catalogue import beyond_slope, columns_of, corrected, in_columns
from quasi.gap.effect import Effect, Vehicle
from quasi.gap.flights.covariates import Basis
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces import spectral_peaks as rhythm
from quasi.gap.levels.forces.design import LIGHT, base_columns, refit
from quasi.gap.levels.forces.smooth_functions import Cause, Grounds, Place, curved, mixed_of
from quasi.gap.statistics.candidates import Candidate, Test
from quasi.gap.statistics.whitening import whiten
from quasi.model.model import AXES


class Joint(NamedTuple):
    """Everything fitted together: what the terms change by (S,), causes with values, functions with values."""

    base: np.ndarray | None
    causes: list[
        tuple[Effect, Candidate, Mapping[str, float], Mapping[str, float]]
    ]  # values to linearise at, and fitted
    functions: list[tuple[Place, np.ndarray]]
    basis: Basis


def joint_of(
    grounds: Grounds, compared: Sequence[bool], causes: Sequence[Cause], found: Sequence[tuple[Place, Test]]
) -> Joint:
    """The model's own terms fitted anew with causes and functions; as they were where all of these are changes."""
    study, fitted = grounds.study, []
    given = [offer for _, offer, _ in causes]
    for effect, offer, values in causes:
        own = {effect.fitted[k]: values[effect.fitted[k]] for k in offer.which if effect.fitted[k] in values}
        own = dict(in_columns(effect, own, study.flown(compared))) if own and effect.apparent else own
        if not own:
            test = mixed_of(grounds, compared, given, []).test(offer, [g for g in given if g != offer])
            own = {effect.fitted[k]: float(v) for k, v in zip(offer.which, test.value)}
        fitted.append((effect, offer, values, own))
    functions = [(p, t.value) for p, t in found]
    base = None
    if any(o.since == "always" for o in given) or any(p.since == "always" for p, _ in functions):
        raw = [
            _less(gram, part.columns, basis, [(p, v) for p, v in functions if flag or p.since == "always"])
            for gram, part, basis, flag in zip(study.raw, study.thinned, grounds.thinned, compared)
        ]
        taken: dict[tuple[str, str], dict[int, float]] = {}
        for effect, offer, _, own in fitted:
            taken.setdefault((effect.id, offer.since), {}).update({effect.fitted.index(n): v for n, v in own.items()})
        base = refit(study._replace(raw=raw), range(len(raw)), compared, taken)
    return Joint(base, fitted, functions, grounds.basis)


def _less(
    raw: np.ndarray, columns: np.ndarray, basis: np.ndarray, functions: Sequence[tuple[Place, np.ndarray]]
) -> np.ndarray:
    """Cross-products (6, P, P) of a flight's columns (n, 6, P) once functions are taken out of its residual."""
    made = np.zeros(columns.shape[:2])
    for place, value in functions:
        made[:, place.channel] += basis[:, list(place.choice.which)] @ value
    raw = raw.copy()
    for channel in np.flatnonzero(made.any(axis=0)):
        own = made[:, channel]
        cross = own @ columns[:, channel]
        raw[channel, 0] -= cross
        raw[channel, :, 0] -= cross
        raw[channel, 0, 0] += own @ own
    return raw


def slope_of(
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
        # of the model's own terms, the function and the target; nuisances integrated out as by `mixed.marginal`
        pair = np.column_stack([function, target])
        cross = np.column_stack([gram[:, layout.shared], gram @ pair])
        among = np.vstack([cross[layout.shared], pair.T @ cross])
        aside = cross[layout.nuisance]
        spread = np.diag(1.0 / np.asarray(layout.spread) ** 2)
        among -= aside.T @ np.linalg.solve(gram[np.ix_(layout.nuisance, layout.nuisance)] + spread, aside)
        inner += among[:-1, :-1]
        right += among[:-1, -1]
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    inverse = np.linalg.inv(inner / np.outer(scale, scale) + LIGHT * np.eye(len(scale)))
    return float(inverse[-1] @ (right / scale) / scale[-1]), float(scale[-1] ** 2 / inverse[-1, -1])


def residual_of(flight: Evidence, joint: Joint, vehicle: Vehicle) -> np.ndarray:
    """What the joint fit leaves of a compared flight (n, 6)."""
    left = flight.residual
    bent = curved([(e, o, at) for e, o, at, _ in joint.causes], True)
    true = corrected(flight, {e.id: e for e, *_ in joint.causes}, bent)
    if joint.base is not None:
        left = left - sum(b * column for b, (_, column) in zip(joint.base, base_columns(true)))
    effects = {e.id: e for e, *_ in joint.causes}
    seen = {name: flight if effect.corrected else true for name, effect in effects.items()}
    slopes = {n: columns_of(effect, seen[n], vehicle, bent.get(n, {})) for n, effect in effects.items()}
    left = left - sum(beyond_slope(effects[n], seen[n], vehicle, at, slopes[n]) for n, at in bent.items())
    for effect, _, _, own in joint.causes:
        left = left - sum(slopes[effect.id][n] * v for n, v in own.items())
    for place, value in joint.functions:
        left = left - flight.only(AXES[place.channel], joint.basis.functions(flight, place.choice.which) @ value)
    return left


def signals_of(grounds: Grounds, joint: Joint, flights: Sequence[Evidence]) -> list[rhythm.Signal]:
    """What each flight's own fit of terms, nuisances and causes leaves, without the functions, for its spectrum."""
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
