"""Which of the causes that forces and moments name keep their names: what resamples, simulations, a flight's own second
half, held-out flights and what stays unexplained say of each."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from quasi.gap.effect import Effect
from quasi.gap.entries import needed
from quasi.gap.levels.forces import unexplained
from quasi.gap.levels.forces.case import Case
from quasi.gap.levels.forces.error_reduction import after, wrench_squares
from quasi.gap.levels.forces.identify import Found
from quasi.gap.levels.rollouts import split_flights
from quasi.gap.levels.rollouts.confirmation import CONFIRMED, REFUTED, Settled, settle
from quasi.gap.levels.rollouts.open_loop import HORIZON
from quasi.gap.levels.sensors_and_drive import SEARCHES
from quasi.gap.levels.trim_evidence import rejected_by_trim
from quasi.gap.materiality import Cause
from quasi.gap.statistics.mixed import Candidate
from quasi.gap.veto import losses, reject_losing_causes
from quasi.model.model import Model

FORCE_AXES = ("Fx", "Fy", "Fz")


def standing(case: Case, found: Found) -> tuple[Settled, unexplained.Left]:
    """The causes that stand, and what no cause explains. Ties that resamples do not bear out are taken from `found`."""
    sure = [c for c in found.causes if c.probability >= needed(c, found)]
    rare = [c for c in found.stand_ins if c.probability < needed(c, found)]
    unsure = {(c.effect.id, c.since) for c in rare}
    found.ties = [(since, t) for since, t in found.ties if (t.tests[0].offer.cause, since) not in unsure]
    settled = settle(found, sure, case.model, case.compared, case.effects, case.vehicle, case.held, case.tables)

    def made(causes: Sequence[Cause], anew: bool) -> Model:
        return Model(case.extended(causes, found.study, "trial", anew), "trial")

    settled = _of_flights(case, settled, made)
    if all(case.compared):
        settled = _borne_out(settled, case.settings["material share"])
    settled = _against_trim(case, settled)
    settled = _harmless(case, settled, made)

    def left_by(settled: Settled) -> unexplained.Left:
        residual = after(made(settled.causes, case.anew(settled.causes)), case.model)
        return unexplained.search(
            case.learning, case.compared, case.held, _given(found, settled, case.effects), residual,
            found.scores["noise_floor"], case.vehicle, case.settings["false alarm rate"] / SEARCHES,
            case.settings["material share"],
        )  # fmt: skip

    return _outdone(case, settled, found, left_by)


def _without(settled: Settled, cause: Cause, why: str, outcome: str = REFUTED) -> Settled:
    """The others; the cause is dropped, with the reason."""
    confirmation = settled.confirmations[cause.effect.id, cause.since]._replace(outcome=outcome, why=why)
    rest = [c for c in settled.causes if c is not cause]
    return settled._replace(causes=rest, dropped=[*settled.dropped, (cause, confirmation)])


def _of_flights(case: Case, settled: Settled, made: Callable[[Sequence[Cause], bool], Model]) -> Settled:
    """Causes that every flight has its own value of must lower the error of a held-out flight's second half, with the
    value estimated on its first half; others lose their name."""
    horizon = min(case.settings["horizons"], key=lambda h: abs(h - HORIZON))
    for cause in settled.causes:
        if not any(cause.effect.parameters[n].scope == "f" for n in cause.value):
            continue
        anew = case.anew(settled.causes)
        rest = [c for c in settled.causes if c is not cause]
        sides = [(made(of, anew), [*((c.effect, c.value) for c in of), *case.drive]) for of in (rest, settled.causes)]
        quantity = "velocity" if set(FORCE_AXES) & set(cause.effect.channels) else "rate"
        gone = split_flights.gain(
            case.held, case.tables, case.learning, case.model, sides, case.vehicle, quantity, horizon
        )
        if gone is None or gone > 0.0:
            continue
        why = (
            f"with the value from a held-out flight's first half, the simulated {quantity} of its second half "
            f"has {-100 * gone:.0f} % more squared error after {horizon:g} s than without it"
        )
        settled = _without(settled, cause, why)
    return settled


def _borne_out(settled: Settled, share: float) -> Settled:
    """Without what the model merely lacks of its own vehicle where the held-out flights do not gain the share by it and
    roll-outs do not confirm it either: only the flights that it was found on, left out in turn, speak for it then.
    """
    for cause in settled.causes:
        outcome = settled.confirmations[cause.effect.id, cause.since].outcome
        gains = [v["value"] for v in cause.gain.values() if v["value"] is not None]
        if cause.effect.absent_when_healthy or outcome == CONFIRMED or not gains or max(gains) >= share:
            continue
        why = (
            f"on the held-out flights it removes {100 * max(gains):.0f} % of the removable error at most, expected "
            f"{100 * share:.0f} %, and roll-outs do not confirm it"
        )
        settled = _without(settled, cause, why, outcome)
    return settled


def _against_trim(case: Case, settled: Settled) -> Settled:
    """Without changed causes that the trim in steady flight rejects, see `quasi.gap.levels.trim_evidence`."""
    changed = [c for c in settled.causes if c.since == "changed"]
    rejected = rejected_by_trim(case.trim, [(c.effect.id, c.value) for c in changed], case.vehicle.mass)
    for k, why in rejected.items():
        settled = _without(settled, changed[k], why)
    return settled


def _harmless(case: Case, settled: Settled, made: Callable[[Sequence[Cause], bool], Model]) -> Settled:
    """Without causes that make an axis or a simulation of the held-out flights worse, see `quasi.gap.veto`."""
    if not settled.causes:
        return settled
    kept, rejected, left = reject_losing_causes(
        settled.causes,
        lambda causes: made(causes, case.anew(causes)),
        lambda model: losses(
            case.model,
            model,
            case.held,
            case.tables,
            case.settings["horizons"],
            case.settings["material share"],
            commanded=False,
        ),
        lambda model: np.sqrt(wrench_squares(case.held, after(model, case.model), False).mean()),
    )
    for cause, loss in rejected:
        settled = _without(settled, cause, f"with it {loss.sentence()}")
    return settled._replace(losses=left)


def _given(
    found: Found, settled: Settled, effects: Mapping[str, Effect]
) -> list[tuple[Effect, Candidate, Mapping[str, float]]]:
    """Causes given in the search for the unexplained rest: all that are there and not refuted, and those of ties."""
    refuted = [c for c, confirmation in settled.dropped if confirmation.outcome == REFUTED]
    accepted = [
        (c.effect, c.test.offer, c.value)
        for c in [*found.causes, *found.immaterial]
        if not any(c is r for r in refuted)
    ]
    return accepted + [(effects[t.tests[0].offer.cause], t.tests[0].offer, {}) for _, t in found.ties]


def _outdone(
    case: Case, settled: Settled, found: Found, left_by: Callable[[Settled], unexplained.Left]
) -> tuple[Settled, unexplained.Left]:
    """Without the names that roll-outs do not confirm and that give way to what no cause explains; and what that is."""
    while True:
        doubtful = [c for c in settled.causes if settled.confirmations[c.effect.id, c.since].outcome != CONFIRMED]
        left, offers = left_by(settled), [o for _, o, _ in _given(found, settled, case.effects)]
        for cause in sorted(doubtful, key=lambda c: -c.test.p):
            why = unexplained.outdone(left, case.compared, offers, cause.test.offer, cause.effect.channels,
                                      cause.test.p, found.level[cause.since],
                                      0.5 * case.settings["false alarm rate"] / SEARCHES)  # fmt: skip
            if why:
                settled = _without(settled, cause, why)
                break
        else:
            return settled, left
