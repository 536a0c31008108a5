"""Whether the compared model is worth a comparison: axes on which it explains nothing neither name nor judge causes."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.attitude import GRAVITY
from quasi.filtering.forces import half_length
from quasi.gap.effect import Effect, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.case import Case
from quasi.gap.levels.forces.design import gather_design, with_own_terms_anew
from quasi.gap.levels.forces.error_reduction import after, before, wrench_score
from quasi.gap.losses import losses
from quasi.gap.statistics.whitening import stretches
from quasi.importing.onboard_log import HELD_HEADING
from quasi.model.model import AXES, Model

NEAR_NOTHING = 0.1  # share of the variance: a model must explain it for an axis to count, unless errors remember less
OF_ACCELEROMETER = frozenset({"ax", "ay", "az"})  # channels of sensors
ROUNDING = 1e-9  # of the weight: a force that follows from an attitude made of it is no more than rounding
MEMORY_S = 1.0  # s: what errors of a model that come from flight, and not from instruments, repeat within


YAWING = "Mz"  # the axis of which a log without yaw shows nothing


class Worth(NamedTuple):
    """share {axis: explained share of the variance}; excluded  axes that do not count; wrong  what contradicts the
    model as a whole (rotors that act elsewhere than configured), "" for nothing; without_yaw  flights that log none, of
    which the yawing moment is unknown."""

    share: Mapping[str, float]
    excluded: tuple[str, ...]
    wrong: str
    without_yaw: tuple[str, ...] = ()

    def sentence(self) -> str:
        """The first sentence of a diagnosis, "" for a model that is worth a comparison."""
        if self.wrong:
            return f"The base model is unusable: {self.wrong}."
        poor = [a for a in self.excluded if not (self.without_yaw and a == YAWING)]
        shares = ", ".join(f"{a} {100 * self.share[a]:z.0f} %" for a in poor)
        sentences = [
            f"The base model explains next to nothing of {', '.join(poor)} (share of the variance: {shares}); "
            "these axes were not used."
        ] if poor else []  # fmt: skip
        if self.without_yaw:
            sentences.append(
                f"{YAWING} was not used: {', '.join(self.without_yaw)} log{'s' * (len(self.without_yaw) == 1)} no yaw."
            )
        return " ".join(sentences)

    def of_measured(self, flights: Iterable[Evidence]) -> "Worth":
        """The same without the yawing moment where some of the flights log no yaw: a held heading has no rate."""
        silent = tuple(f.key for f in flights if _held_heading(f) is not None)
        excluded = tuple(a for a in AXES if a in self.excluded or (silent and a == YAWING))
        return self._replace(excluded=excluded, without_yaw=silent)


def _held_heading(flight: Evidence) -> object:
    about = flight.metadata.get("imported") or {}
    return ((about.get("sources") or {}).get("onboard") or {}).get(HELD_HEADING)


def explained_share(flights: Sequence[Evidence]) -> np.ndarray:
    """Share (6,) of the variance of forces and moments within flights that their model explains."""
    left, whole = np.zeros(6), np.zeros(6)
    for flight in flights:
        left += len(flight) * flight.residual.var(axis=0)
        whole += len(flight) * flight.measured.var(axis=0)
    return 1.0 - left / np.maximum(whole, 1e-300)


def remembered_share(flights: Sequence[Evidence]) -> np.ndarray:
    """Share (6,) of the variance of what a model leaves that comes back within MEMORY_S; noise of instruments does not.

    The largest autocorrelation beyond what the low-pass of forces and moments mixes. 1 where that is unknown or more
    than a quarter of MEMORY_S, and on an axis that measures nothing.
    """
    cutoffs = [(f.metadata.get("filters") or {}).get("low-pass cutoff Hz") for f in flights]
    if not flights or None in cutoffs:
        return np.ones(6)
    rate = 1.0 / np.median(np.diff(flights[0].t))
    mixed, memory = 2 * half_length(min(cutoffs), rate) + 1, round(MEMORY_S * rate)
    if 4 * mixed > memory:
        return np.ones(6)
    products, variance = np.zeros((memory - mixed, 6)), np.zeros(6)
    for flight in flights:
        left = flight.residual - flight.residual.mean(axis=0)
        variance += np.sum(left**2, axis=0)
        for part in stretches(flight.breaks):
            x = left[part]
            for lag in range(mixed, memory):
                products[lag - mixed] += np.sum(x[lag:] * x[: max(len(x) - lag, 0)], axis=0)
    rows, weight = sum(map(len, flights)), flights[0].mass * GRAVITY
    measures = variance > rows * (ROUNDING * weight * np.repeat([1.0, flights[0].airframe.arm], 3)) ** 2
    return np.where(measures, np.max(np.abs(products), axis=0) / np.maximum(variance, 1e-300), 1.0)


def worth_of(model: Model, reference: Sequence[Evidence]) -> Worth:
    """How much the model explains of the rows that it was identified from and, where given, of reference flights.

    Compared flights do not judge it: there an effect such as wind may hide all that the model explains. A published
    model states no rows: what it explains of them is unknown (NaN), and it counts. So does an axis of which noise is
    all that is left: the estimates know that noise.
    """
    identified = {a: part for a, part in model.document["axes"].items() if part.get("n") != 0}
    known = {a: float(identified.get(a, {}).get("R2", np.nan)) for a in AXES}
    shares = dict(known)
    if reference:
        shown = explained_share(reference)
        shares = {a: float(np.nanmin([known[a], shown[k]])) for k, a in enumerate(AXES)}
    poor = [k for k, a in enumerate(AXES) if shares[a] < NEAR_NOTHING]
    remembered = remembered_share(reference) if poor else np.ones(6)
    excluded = tuple(AXES[k] for k in poor if remembered[k] >= NEAR_NOTHING)
    wrong = "; ".join(model.document.get("contradictions") or [])
    return Worth(shares, excluded, wrong)


def faked_axes(causes: Sequence[Mapping[str, Any]], effects: Mapping[str, Effect]) -> Collection[str]:
    """Axes of which corrections of all flights changed the measurements.

    causes  {"id", "since"} that flights were corrected for; effects  the catalogue. What the accelerometer shows alone
    moves forces, and no moment.
    """
    always = [effects.get(c["id"]) for c in causes if c["since"] == "always"]
    if not always:
        return ()
    return AXES[:3] if all(effect and set(effect.channels) <= OF_ACCELEROMETER for effect in always) else AXES


def by_role(evidence: Mapping[str, Evidence], roles: Mapping[str, str]) -> dict[str, list[Evidence]]:
    """Flights by what they are for."""
    return {r: [e for k, e in evidence.items() if roles[k] == r] for r in ("reference", "compared", "held out")}


def worth_after(model: Model, healthy: Sequence[Evidence], corrected: Collection[str]) -> Worth:
    """What the model explains of reference flights: on axes that were `corrected` by its own terms fitted anew.

    Its terms hold what the sensors faked: as they are they explain little of corrected flights.
    """
    return worth_of(model, with_own_terms_anew(healthy, corrected) if corrected else healthy)


def refit_loses(
    model: Model, groups: Mapping[str, Sequence[Evidence]], tables: Mapping[str, pd.DataFrame], vehicle: Vehicle,
    settings: Mapping[str, Any], faked: Collection[str],
) -> bool:  # fmt: skip
    """Whether the model's own terms of axes that were `faked`, fitted anew to corrected flights without any cause, do
    worse on held-out ones.

    As for causes (`losses.reject_losing_causes`), a smaller factor than an axis of force or moment gains does not
    count: what it moves in simulations are terms of other axes, which err.
    """
    learning = [*groups["reference"], *groups["compared"]]
    if not learning or not groups["held out"]:
        return False
    positions = tuple(AXES.index(a) for a in worth_after(model, groups["reference"], faked).excluded)
    learning, held = ([replace(e, excluded=positions) for e in flights] for flights in (learning, groups["held out"]))
    compared = [False] * len(groups["reference"]) + [True] * len(groups["compared"])
    case = Case(model, {}, vehicle, learning, compared, held, tables, [], faked, settings)
    fitted = Model(case.extended([], gather_design(learning, {}, vehicle), "trial", faked), "trial")
    found = losses(model, fitted, held, tables, settings["horizons"], settings["material share"], commanded=False)
    worst = max((1.0 + loss.growth for loss in found if not (loss.of_trim or loss.one_axis)), default=0.0)
    old, new = (
        np.sqrt([wrench_score(held, left, centred).mean() for centred in (False, True)])
        for left in (before, after(fitted, model))
    )
    return bool(worst > np.max(old / np.maximum(new, 1e-300)))
