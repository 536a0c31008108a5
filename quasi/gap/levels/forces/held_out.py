"""What causes do for flights that had no part in finding them: extended models of them, and what these leave."""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from quasi.errors import ConfigError
from quasi.gap.catalogue import beyond_slope, columns_of, corrected, whole_of
from quasi.gap.effect import Effect, Vehicle
from quasi.gap.extension import extend
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.case import Case
from quasi.gap.levels.forces.design import Design, base_columns, moved, refit, refit_with
from quasi.gap.levels.forces.error_reduction import Likelihood, after, before, wrench_score
from quasi.gap.levels.forces.left_out import LeftOut
from quasi.gap.levels.forces.search import Sought, estimate
from quasi.gap.materiality import ASIDE, LACKING, Cause, Common, Deviations, Judged, seen_in
from quasi.gap.statistics.blocks import HOLDS
from quasi.gap.statistics.scores import Score, joined
from quasi.model.model import AXES, Model

EXCITED_SHARE = 0.1  # of its mean square in the compared flights, that a held-out one must show to be judged by
ACTING = 0.9  # of a cause's mean square: the blocks that hold it are those in which it acts
RIDGES = (1e-3, 1e-2, 1e-1)  # of fits of everything at once, on scaled columns


class HeldOut:
    """Held-out flights as judges of causes that other flights gave.

    sought  what these gave, from `flights` of which `compared` (F,) are no reference flights; asked  the causes, by id
    share   least share of the removable error of some axis; where  what asked, for provenance
    old, floor  errors before (a score), and (6,) what is left at best: every model that is tried may lower it, in
            place. In noise a fit of everything at once leaves more than a few causes do
    """

    def __init__(
        self, held: Sequence[Evidence], sought: Sought, asked: Mapping[str, Effect], flights: Sequence[Evidence],
        compared: np.ndarray, model: Model, vehicle: Vehicle, share: float, where: str,
    ) -> None:  # fmt: skip
        self.held, self.flights, self.compared, self.model, self.vehicle = held, flights, compared, model, vehicle
        self.study, self.share, self.where = sought.study, share, where
        self.old = wrench_score(held, before)
        self._likelihood = Likelihood(held, self.study.whitener)
        self._asked, self._values = asked, sought.values[True]
        self.floor = self._least(held, self.old)

    def _least(self, flights: Sequence[Evidence], old: Score, centred: bool = False) -> np.ndarray:
        return least_left(self.study, self._asked, self.vehicle, self.compared, self._values, flights, old, centred)

    @cached_property
    def centred(self) -> tuple[Score, np.ndarray]:
        """`old` and `floor` with each flight's mean taken off."""
        old = wrench_score(self.held, before, True)
        return old, self._least(self.held, old, True)

    def made(self, causes: Sequence[Cause], ident: str, fitted_anew: bool) -> dict[str, Any]:
        """The document of the model with some causes, its own terms fitted anew to the flights that learn or not."""
        changes = refit_with(self.study, self.compared, [(c, c.value) for c in causes]) if fitted_anew else None
        acting = [(c.effect, c.value) for c in causes]
        return extend(self.model, acting, self.vehicle, ident, self.where, changes)

    def score(self, causes: Sequence[Cause], fitted_anew: bool) -> Judged:
        """Errors of the held-out flights with some causes."""
        left = after(Model(self.made(causes, "trial", fitted_anew), "trial"), self.model)
        errors = wrench_score(self.held, left)
        np.minimum(self.floor, errors.mean(), out=self.floor)
        return Judged(errors, wrench_score(self.held, left, True), self._likelihood(left))

    def excited(self, cause: Cause) -> bool:
        """Whether the held-out flights show a cause at all."""
        there = [f for f, flag in zip(self.flights, self.compared) if flag]
        here, usual = (float(self._strength(cause, some).mean().sum()) for some in (self.held, there))
        return here > EXCITED_SHARE * usual

    def acting(self, cause: Cause) -> np.ndarray:
        """The fewest blocks (B,) bool of the held-out flights that hold ACTING of what a cause makes."""
        made = self._strength(cause, self.held)
        size = made.values.sum(axis=1) * made.weight
        order = np.argsort(-size)
        count = int(np.searchsorted(np.cumsum(size[order]), ACTING * size.sum())) + 1
        return np.isin(np.arange(len(size)), order[:count])

    def _strength(self, cause: Cause, flights: Sequence[Evidence]) -> Score:
        """Mean square of what a cause makes in flights, each channel over the held-out error before."""
        made = wrench_score(flights, lambda flight: whole_of(cause.effect, flight, self.vehicle, cause.value))
        return Score(made.values / np.maximum(self.old.mean(), 1e-300), made.weight)

    def common(self) -> Common:
        """What judges causes that all flights have alike: where no flight is healthy, each of them as well, by the
        values from the others."""
        if not self.compared.all():
            share = max(self.share, ASIDE)
            return Common(lambda of, again: self.score(of, again).centred, *self.centred, share)
        in_turn, every = LeftOut(self.study, self.compared), [*self.held, *self.flights]
        old = joined(self.centred[0], in_turn([], False))
        return Common(
            lambda of, again: joined(self.score(of, again).centred, in_turn(of, again)), old,
            self._least(every, old, True), LACKING * self.share, made_of(self.model, self.flights),
            self.share,
        )  # fmt: skip


def made_of(model: Model, flights: Sequence[Evidence]) -> bool:
    """Whether the model was identified from some of the flights."""
    trained = set((model.document.get("flights") or {}).get("training") or ())
    return any(e.key in trained for e in flights)


def least_left(
    study: Design, asked: Mapping[str, Effect], vehicle: Vehicle, compared: np.ndarray,
    values: Mapping[str, Deviations], held: Sequence[Evidence], old: Score, centred: bool = False,
) -> np.ndarray:  # fmt: skip
    """Mean square (6,) that the model's terms and all causes together, fitted to the other flights, leave at best.

    old  before; centred  whether each flight's mean is taken off, there as well
    """
    least = old.mean()
    for ridge in RIDGES:
        left = wrench_score(held, everything(study, asked, vehicle, compared, values, ridge), centred)
        least = np.minimum(least, left.mean())
    return least


def everything(
    study: Design, asked: Mapping[str, Effect], vehicle: Vehicle, compared: Sequence[bool],
    values: Mapping[str, Deviations], ridge: float = RIDGES[0],
) -> Callable[[Evidence], np.ndarray]:  # fmt: skip
    """Fit the model's terms and all causes together; returns flight -> (n, 6), what they leave of its wrench.

    values  that the study's compared flights are linearised at; ridge  of the fit, on scaled columns
    """
    mixed = study.mixed(range(len(study.flights)), compared)
    use = [*study.columns.shared, *(c for cause in study.columns.causes.values() for c in cause)]
    # of the compared flights alone: what they have is what a held-out one has
    total = sum(g for g, c in zip(mixed.grams, compared) if c)
    scale = np.sqrt(np.maximum(np.diag(total)[use], 1e-300))
    inner = total[np.ix_(use, use)] / np.outer(scale, scale) + ridge * np.eye(len(use))
    coefficients = np.linalg.solve(inner, total[use, 0] / scale) / scale

    def residual(flight: Evidence) -> np.ndarray:
        bent, true = np.zeros((len(flight), len(AXES))), corrected(flight, asked, values)
        columns = [c for _, c in base_columns(true)]
        for cause in study.columns.causes:
            at = values.get(cause) or dict.fromkeys(asked[cause].parameters, 0.0)
            shown = flight if asked[cause].corrected else true
            slopes = columns_of(asked[cause], shown, vehicle, at)
            columns += slopes.values()
            bent += beyond_slope(asked[cause], shown, vehicle, at, slopes)
        return flight.residual - bent - np.einsum("k,knj->nj", coefficients, np.array(columns))

    return residual


def gain_axes(causes: Sequence[Cause], old: np.ndarray, floor: np.ndarray) -> list[int]:
    """Axes on which a gain is measured: those where causes act and something can be removed, else where they act.

    old, floor (6,) mean squares before and at best
    """
    own = sorted({k for cause in causes for k in seen_in(cause.effect)})
    return [k for k in own if floor[k] < HOLDS * old[k]] or own


def best_wrong(
    case: Case, study: Design, named: Sequence[Cause], tied: Collection[str], old: np.ndarray, floor: np.ndarray
) -> dict[str, Model]:  # fmt: skip
    """{id: the model with it alone} of the cause outside the named and tied ones that removes most where these act.

    study  of the flights that learn; old, floor (6,) mean squares of held-out flights before and at best
    What it removes is the mean share of the removable error over the axes of `gain_axes`: over all six, one that
    corrects what the named ones do not touch would count. Nothing where each of them makes these axes worse.
    """
    own, since, anew = gain_axes(named, old, floor), named[0].since, case.anew(named)
    right, flights = {c.effect.id for c in named}, range(len(case.learning))
    # a wrong cause is fitted to all that is there, not to what the bend of the right one leaves
    values = [{n: at for n, at in flight.items() if n not in right} for flight in study.values]
    study = moved(study, case.effects, case.vehicle, values)
    mixed, flown = study.witnessed(flights, case.compared), study.flown(case.compared)
    removable = np.maximum(np.maximum(old - floor, (1.0 - HOLDS) * old), 1e-300)
    best, most = {}, float(np.finfo(float).eps) ** 0.5  # a cause that does nothing on these axes makes no difference
    for name in mixed.columns.causes:
        if name in right or name in tied:
            continue
        effect = case.effects[name]
        test = mixed.best(name, since, (), mixed.pooled(since), effect.parts)
        found, sizes = dict(zip(test.offer.which, map(float, test.value))), estimate(test, effect, flown)[0]
        changes = refit(study, flights, case.compared, {(name, since): found}, anew) if anew else None
        wrong = [(effect, sizes)]
        try:
            model = Model(extend(case.model, wrong, case.vehicle, "wrong", "trial", changes), f"{name}, wrong")
        except ConfigError:
            continue  # what the model cannot carry is no model to be compared with
        gone = (old - wrench_score(case.held, after(model, case.model)).mean()) / removable
        if gone[own].mean() > most:
            best, most = {name: model}, float(gone[own].mean())
    return best
