"""Confirmation by roll-out: does a named cause, put into the simulator, lower the open-loop error on held-out flights?

Windows of the held-out flights are simulated with all causes and with one left out. With that cause the simulation
moves by D; without it the measurement deviates by

    e = b D + S_nu nu + r,     nu, r as in `output_error`, their covariances from the learning flights

b is 1 where the cause acts as it was named, 0 where nothing of it is there, below 0 where its sign is wrong. The
squared error falls by (2 b - 1) D'D, so b = 1/2 divides gain from loss. How well b is known, given noise, nuisance and
how much the flights excite the cause, is known before looking: where the standard error is large a missing gain says
nothing.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.errors import ConfigError, DataError
from quasi.gap.effect import Effect, Vehicle
from quasi.gap.extension import extend
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.design import BAND, ORDER, in_stretches, refit_with
from quasi.gap.levels.forces.identify import Found
from quasi.gap.levels.forces.nuisance import nuisances
from quasi.gap.levels.rollouts import output_error
from quasi.gap.levels.rollouts.linear_response import Course
from quasi.gap.levels.rollouts.output_error import Values
from quasi.gap.materiality import Cause, seen_in
from quasi.gap.statistics.candidates import Candidate, Columns
from quasi.gap.statistics.mixed import MixedModel
from quasi.gap.statistics.whitening import thin
from quasi.model.model import AXES, Model

CONFIRMED, REFUTED, UNJUDGED = "confirmed", "not confirmed", "cannot be judged"
GAIN_T, LOSS_T = 1.64, 2.58  # one-sided 5 %: it gains; 0.5 %: it loses, or a gain would have been seen

TWICE = 2.0  # a cause that would have to act twice as strongly as it was named is another one


class Confirmation(NamedTuple):
    """outcome; amplitude b with its standard error; predicted  |t| that the cause would show if it acts as named; plain
    the amplitude with nothing of what flights differ by taken out.
    """

    outcome: str
    amplitude: float
    std: float
    predicted: float
    why: str = ""
    plain: float = -np.inf

    def document(self) -> dict[str, Any]:
        """As plain data."""
        seen = self.std < np.inf
        return {"outcome": self.outcome, "amplitude": {"value": self.amplitude, "std": self.std} if seen else None,
                "predicted t": self.predicted, "window": output_error.WINDOW, "why": self.why}  # fmt: skip


def outcome_of(amplitude: float, std: float) -> str:
    """What an amplitude with its standard error says."""
    visible = 0.5 / std > LOSS_T
    if (amplitude - 0.5) / std < -LOSS_T or (visible and amplitude <= 0.5) or (amplitude - TWICE) / std > LOSS_T:
        return REFUTED
    return CONFIRMED if (amplitude - 0.5) / std > GAIN_T else UNJUDGED


def confirm(
    held: Sequence[Evidence], tables: Mapping[str, pd.DataFrame], noise: np.ndarray, whole: Model,
    without: Sequence[Model],
) -> list[Confirmation]:  # fmt: skip
    """Judge each cause on held-out flights.

    held   evidence; tables {key: filtered flight}; noise  R of the learning flights, see `output_error.Fitted`
    whole  model with all causes; without  for each cause the model with all but that one
    Raises ConfigError for a model that cannot be simulated.
    """
    courses, other = [], []
    spread = np.zeros(0)
    for flight in held:
        own = nuisances(flight)
        spread = np.array([s for *_, s in own])
        part = thin(np.stack([c for _, c, _ in own], axis=2), flight.breaks, flight.t, BAND, 2 * ORDER)
        if len(part.rows):
            courses.append(output_error.windows_in(flight, tables[flight.key], part))
            other.append(output_error.sensitivities(courses[-1], part.columns))
    if not sum(len(c.starts) for c in courses):
        nothing = Confirmation(UNJUDGED, 0.0, np.inf, 0.0, "no held-out flight has a valid window")
        return [nothing] * len(without)
    best = [output_error.deviations(c, whole) for c in courses]
    return [_judged(courses, other, spread, noise, best, model) for model in without]


def _judged(
    courses: Sequence[Course], other: Sequence[np.ndarray], spread: np.ndarray, noise: np.ndarray,
    best: Sequence[np.ndarray], without: Model,
) -> Confirmation:  # fmt: skip
    grams, moved = [], 0.0
    for course, columns, last in zip(courses, other, best):
        error = output_error.deviations(course, without)
        stack = np.concatenate([error[:, :, None], columns, (error - last)[:, :, None]], axis=2)
        moved = max(moved, float(np.abs(np.nan_to_num(error - last)).max(initial=0.0)))
        blocks = output_error.blocks_of(stack, noise, output_error.blocks_in(course))
        if len(blocks):
            grams.append(in_stretches(blocks))
    if not grams or moved == 0.0:
        return Confirmation(UNJUDGED, 0.0, np.inf, 0.0, "it does not act on the held-out flights")
    size = len(spread)
    layout = Columns([], list(range(1, size + 1)), spread, {"cause": [size + 1]})
    offer = Candidate("cause", "always", (0,))
    test = MixedModel(grams, [True] * len(grams), layout).test(offer)
    plain = MixedModel(grams, [True] * len(grams), layout._replace(nuisance=[], spread=np.zeros(0))).test(offer)
    amplitude, std = float(test.value[0]), float(test.std[0])
    outcome = outcome_of(amplitude, std)
    return Confirmation(outcome, amplitude, std, 1.0 / std, _why(outcome, amplitude, std), float(plain.value[0]))


class Estimate(NamedTuple):
    """Parameters by output error: deviations from neutral, standard errors, whether they agree with the cause's own."""

    value: Values
    std: Values
    agrees: bool


class Settled(NamedTuple):
    """causes that stand, as they came; those dropped, with the reason; by (id, since): what roll-outs say of each;
    losses  of the held-out flights that stay with these causes, see `quasi.gap.verdict`."""

    causes: list[Cause]
    dropped: list[tuple[Cause, Confirmation]]
    confirmations: dict[tuple[str, str], Confirmation]
    estimates: dict[tuple[str, str], Estimate]
    notes: list[str]
    losses: Sequence[Any] = ()


def settle(
    found: Found,
    causes: Sequence[Cause],
    model: Model,
    compared: Sequence[bool],
    effects: Mapping[str, Effect],
    vehicle: Vehicle,
    held: Sequence[Evidence],
    tables: Mapping[str, pd.DataFrame],
) -> Settled:
    """Fit the causes of forces and moments by output error and drop those that roll-outs of the held-out flights
    refute.

    found, causes  of `wrench.examine` and those of its causes that are to be named; compared  flags of found.study's
    flights; tables {key: filtered flight} of these and of the held-out ones
    Parameters by output error are put into the simulator to confirm a cause, where they agree with its own; the cause
    keeps those of the forces and moments. Causes that cannot be simulated cannot be judged, and stand.
    """
    kept, dropped = list(causes), []
    if not kept:
        return Settled([], [], {}, {}, [])
    ranges = {n: e.limits(vehicle).ranges for n, e in effects.items()}
    try:
        windows = output_error.windows_of(found.study, tables)
        while kept:
            anew = any(c.since == "always" for c in kept)
            maker = Maker(model, found, kept, compared, vehicle, anew)
            fitted = output_error.fit(found.study, compared, kept, maker, windows, ranges)
            values = [v if used else c.value for c, v, used in zip(kept, fitted.values, fitted.used)]
            rest = [
                Maker(model, found, _but(kept, k), compared, vehicle, anew)(_but(values, k), True)
                for k in range(len(kept))
            ]
            whole = maker(values, True)
            results = confirm(held, tables, fitted.noise, whole, rest)
            count = {"always": len(compared), "changed": sum(compared)}
            results = [_honest(s, c, count[c.since] / len(held)) for c, s in zip(kept, results)]
            faint = {_key(c) for c in found.unjudged}
            results = [_lenient(s, c, whole, _key(c) in faint) for c, s in zip(kept, results)]
            results = [_in_part(s, c, found.study.flights) for c, s in zip(kept, results)]
            results = [_at_odds(s, used) for s, used in zip(results, fitted.used)]
            refuted = [k for k, s in enumerate(results) if s.outcome == REFUTED]
            if not refuted:
                if fitted.settled:
                    _widen(kept, fitted)
                estimates = {_key(c): Estimate(*e) for c, *e in zip(kept, fitted.values, fitted.std, fitted.used)}
                confirmations = {_key(c): s for c, s in zip(kept, results)}
                return Settled(kept, dropped, confirmations, estimates, fitted.notes)
            worst = min(refuted, key=lambda k: (results[k].amplitude - 0.5) / results[k].std)
            dropped.append((kept.pop(worst), results[worst]))
    except (ConfigError, DataError) as error:
        nothing = Confirmation(UNJUDGED, 0.0, np.inf, 0.0, str(error))
        note = f"the named causes could not be confirmed by roll-outs: {error}"
        results = [(c, _in_part(nothing, c, found.study.flights)) for c in kept]
        dropped += [(c, s) for c, s in results if s.outcome == REFUTED]
        confirmations = {_key(c): s for c, s in results if s.outcome != REFUTED}
        return Settled([c for c in kept if _key(c) in confirmations], dropped, confirmations, {}, [note])
    return Settled([], dropped, {}, {}, [])


def _widen(causes: Sequence[Cause], fitted: output_error.Fitted) -> None:
    """Widen the standard errors of causes that output error puts elsewhere until the two estimates agree.

    A cause's parameters are of one fit: where one is wrong, the others have made up for it.
    Source: Birge, The calculation of errors by the method of least squares, Physical Review 40, 1932.
    """
    for cause, value, std in zip(causes, fitted.values, fitted.std):
        if output_error.disagreeing(cause, value, std):
            far = output_error.apart(cause, value, std)
            cause.std = {n: s * max(far.get(n, 1.0), 1.0) for n, s in cause.std.items()}


def _honest(result: Confirmation, cause: Cause, flights: float) -> Confirmation:
    """The amplitude with the standard error that repeats would show, and what that says.

    A cause found with |t| has an amplitude known to 1/|t|; held-out flights, `flights` times fewer than those that
    found it, differ among themselves as those did, which one flight's segments alone do not show.
    """
    if not result.std < np.inf:
        return result
    variance = 1.0 / max(cause.test.wald, 1e-300)
    std = float(np.sqrt(variance + max(result.std**2, flights * variance)))
    outcome = outcome_of(result.amplitude, std)
    return result._replace(std=std, outcome=outcome, why=_why(outcome, result.amplitude, std))


def _why(outcome: str, amplitude: float, std: float) -> str:
    if outcome != REFUTED:
        return ""
    return (
        f"roll-outs of the held-out flights do not confirm it: they show {amplitude:.2f} +- {std:.2f} of the "
        "motion that it makes in the simulator, expected 1"
    )


def _lenient(result: Confirmation, cause: Cause, whole: Model, faint: bool = False) -> Confirmation:
    """What held-out flights cannot refute: a value that each flight has of its own, a load whose swing is not known,
    what they hardly show (`faint`): noise of rotor speeds moves the simulation there as much as the cause does; and a
    motion that is there, but not once usual flight differences are taken out.
    """
    if result.outcome != REFUTED:
        return result
    if faint:
        return result._replace(outcome=UNJUDGED, why="held-out flights hardly show it")
    if 0.5 < result.plain < TWICE:
        # a cause large enough is taken for many times what flights differ by: 30 % of torque for that of an inertia
        why = f"{result.plain:.2f} of its motion is there, or {result.amplitude:.2f} without usual flight differences"
        return result._replace(outcome=UNJUDGED, why=why)
    states = [e.get("states") or {} for e in whole.document["extensions"] if e["id"] == cause.effect.id]
    if any("swinging load" in s for s in states):
        return result._replace(outcome=UNJUDGED, why="how the load swings when a window begins is not measured")
    if any(cause.effect.parameters[n].scope == "f" for n in cause.value):
        return result._replace(outcome=UNJUDGED, why="each flight has its own value of it")
    return result


def _in_part(result: Confirmation, cause: Cause, flights: Sequence[Evidence]) -> Confirmation:
    """A cause that acts on axes of which the base model explains nothing is known by its other axes alone, which more
    than one cause may fit (the vertical force of a swinging weight that of a rotor in the wake of another): roll-outs
    have to confirm it.
    """
    unseen = [AXES[k] for k in seen_in(cause.effect) if any(k in f.excluded for f in flights)]
    if result.outcome != UNJUDGED or not unseen:
        return result
    found = f"they show {result.amplitude:.2f} +- {result.std:.2f} of its motion, expected 1"
    why = (
        f"it acts on {', '.join(unseen)} as well, of which the base model explains next to nothing, and roll-outs of "
        f"the held-out flights do not confirm the rest: {found if result.std < np.inf else result.why}"
    )
    return result._replace(outcome=REFUTED, why=why)


def _at_odds(result: Confirmation, used: bool) -> Confirmation:
    """A cause whose value simulations of its own flights put elsewhere, or nowhere, rests on forces and moments alone:
    roll-outs of the held-out flights have to confirm it.

    used  whether the estimate by output error settled, is physical and agrees with that of forces and moments
    """
    if result.outcome != UNJUDGED or used or result.why or not result.std < np.inf:
        return result
    why = (
        "simulations of the flights that it was found on do not agree with its value from forces and moments, and "
        f"roll-outs of the held-out flights do not confirm it: they show {result.amplitude:.2f} +- {result.std:.2f} "
        "of its motion, expected 1"
    )
    return result._replace(outcome=REFUTED, why=why)


def _key(cause: Cause) -> tuple[str, str]:
    return cause.effect.id, cause.since


def _but(items: Sequence[Any], one: int) -> list[Any]:
    return [item for k, item in enumerate(items) if k != one]


class Maker:
    """Models with causes of given parameters.

    anew  whether the model's own terms are fitted anew with the causes: what all flights have in common they had to
    stand in for, and with and without such a cause alike
    """

    def __init__(
        self, model: Model, found: Found, causes: Sequence[Cause], compared: Sequence[bool], vehicle: Vehicle,
        anew: bool,
    ) -> None:  # fmt: skip
        self.model, self.found, self.causes = model, found, list(causes)
        self.compared, self.vehicle, self.anew = list(compared), vehicle, anew

    def __call__(self, values: Sequence[Values], changed: bool) -> Model:
        """changed  whether what changed acts as well as what was always there."""
        pairs = list(zip(self.causes, values))
        changes = refit_with(self.found.study, self.compared, pairs) if self.anew else None
        acting = [(c.effect, v) for c, v in pairs if changed or c.since == "always"]
        name = "+".join([self.model.id, *(c.id for c, _ in acting)])
        return Model(extend(self.model, acting, self.vehicle, name, "roll-outs", changes), f"model {name}")
