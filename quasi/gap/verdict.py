"""Which causes of forces and moments keep their names, judged by resamples, simulations, a flight's own second half,
held-out flights and what stays unexplained.

Held-out flights reject causes: an extended model must not be worse than its base on any axis or horizon. A cause that
was found on some flights and makes others worse is another cause, or none. The comparison is that of forces and moments
by axis, and of simulations by quantity and horizon; a loss counts where its whole 95 % interval is a loss and it is
material.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from quasi.gap.catalogue import whole_of
from quasi.gap.effect import Effect
from quasi.gap.entries import needed
from quasi.gap.flights.covariates import EVERYWHERE, where_in_words
from quasi.gap.levels.forces import unexplained
from quasi.gap.levels.forces.beyond_references import grown_by, left_beyond_references, less_usual_differences
from quasi.gap.levels.forces.case import Case
from quasi.gap.levels.forces.effect_size import drowned
from quasi.gap.levels.forces.error_reduction import after, wrench_score
from quasi.gap.levels.forces.findings import gusts
from quasi.gap.levels.forces.held_out import made_of
from quasi.gap.levels.forces.identify import Found
from quasi.gap.levels.forces.left_out import residual_of_others
from quasi.gap.levels.rollouts import split_flights
from quasi.gap.levels.rollouts.confirmation import CONFIRMED, REFUTED, Settled, settle
from quasi.gap.levels.rollouts.open_loop import HORIZON, MOVED_BY
from quasi.gap.levels.sensors_and_drive import SEARCHES
from quasi.gap.levels.trim_evidence import OF_TOTAL_THRUST, named_rotor, rejected_by_trim, why_rotor_is_enough
from quasi.gap.losses import (
    Loss,
    correcting_others,
    losses,
    only_loss,
    reject_losing_causes,
    removed_shares,
    simulated_rows,
    wrench_pairs,
)
from quasi.gap.materiality import Cause, seen_in
from quasi.gap.selection import FORM_ERROR
from quasi.gap.statistics.candidates import Candidate
from quasi.model.model import AXES, Model

DROWNED = "it makes so little of what no cause explains on its axes that it may be the error of that one's form"


def judge_causes(case: Case, found: Found) -> tuple[Settled, unexplained.Left]:
    """The causes that stand, and what no cause explains. Ties that resamples do not bear out are taken from `found`."""
    for cause in [*found.causes, *found.stand_ins]:
        cause.needed = needed(cause, found)
    sure = [c for c in found.causes if c.probability >= c.needed]
    rare = [c for c in found.stand_ins if c.probability < c.needed]
    unsure = {(c.effect.id, c.since) for c in rare}
    found.ties = [(since, t) for since, t in found.ties if (t.tests[0].offer.cause, since) not in unsure]
    _drop_needless_ties(case, found)
    sure = _significant_next_to_rotor(case, found, sure)
    _drop_ties_in_part(case, found, sure)
    settled = _settled(case, found, sure)

    def made(causes: Sequence[Cause], anew: Collection[str]) -> Model:
        return Model(case.extended(causes, found.study, "trial", anew), "trial")

    settled = _of_flights(case, settled, made)
    if all(case.compared):
        settled = _borne_out(settled, case.settings["material share"])
    settled = _against_trim(case, settled)
    settled = harmless = _harmless(case, settled, made, found.unjudged)
    settled = _of_use(case, settled, made, found.level)

    def left_by(settled: Settled) -> unexplained.Left:
        residual = after(made(settled.causes, case.anew(settled.causes)), case.model)
        return unexplained.search(
            case.learning, case.compared, case.held, _given(found, settled, case.effects), residual,
            found.scores["noise_floor"], case.vehicle, case.settings["false alarm rate"] / SEARCHES,
            case.settings["material share"], found.scores["centred floor"],
        )  # fmt: skip

    settled, left = _outdone(case, settled, found, left_by)
    ties = found.ties
    rest = _next_to_unknown(case, settled, found, left)
    rest = _fainter_than_unknown(case, rest, found, left)
    if rest is not settled or found.ties is not ties:
        rest, left = _outdone(case, rest, found, left_by)
    return _with_losses_left(case, rest, harmless, made), left


def _settled(case: Case, found: Found, causes: Sequence[Cause]) -> Settled:
    return settle(found, causes, case.model, case.compared, case.effects, case.vehicle, case.held, case.tables)


def _drop_ties_in_part(case: Case, found: Found, causes: Sequence[Cause]) -> None:
    """Take ties from `found` whose first cause acts on axes of which the base model explains nothing as well, where
    roll-outs do not confirm it: on the rest more causes than these may fit, as of a named one."""
    unseen = {k for flight in case.learning for k in flight.excluded}
    partial = [pair for pair in found.ties if unseen & set(seen_in(case.effects[pair[1].tests[0].offer.cause]))]
    firsts = {(tie.tests[0].offer.cause, since) for since, tie in partial}
    doubtful = [c for c in found.stand_ins if (c.effect.id, c.since) in firsts]
    if not doubtful:
        return
    for cause, confirmation in _settled(case, found, [*causes, *doubtful]).dropped:
        key = (cause.effect.id, cause.since)
        if key not in firsts:
            continue
        _drop_ties(found, cause, confirmation.why)


def _drop_ties(found: Found, first: Cause, why: str) -> None:
    """Take the ties whose first cause this is from `found`."""
    gone = [pair for pair in found.ties if (pair[1].tests[0].offer.cause, pair[0]) == (first.effect.id, first.since)]
    found.ties = [pair for pair in found.ties if not any(pair is other for other in gone)]
    found.stand_ins = [c for c in found.stand_ins if (c.effect.id, c.since) != (first.effect.id, first.since)]
    found.contradicted |= {t.offer.cause: (t, why) for _, tie in gone for t in tie.tests}


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
        quantity = "velocity" if set(AXES[:3]) & set(cause.effect.channels) else "rate"
        alike = [f for f, flag in zip(case.learning, case.compared) if flag]  # references have none of what changed
        gone = split_flights.gain(case.held, case.tables, alike, case.model, sides, case.vehicle, quantity, horizon)
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
    """Without changed causes that the trim in steady flight rejects, see `quasi.gap.levels.trim_evidence`, the worst
    first: what it contradicts only together with that one stands."""
    while True:
        changed = [c for c in settled.causes if c.since == "changed"]
        rejected = rejected_by_trim(case.trim, [(c.effect.id, c.value) for c in changed], case.vehicle.mass)
        if not rejected:
            return settled
        k, why = next(iter(rejected.items()))
        settled = _without(settled, changed[k], why)


def _drop_needless_ties(case: Case, found: Found) -> None:
    """Take ties with a cause of the total thrust from `found`, where the trim shows one rotor that is enough for it.

    What stands in such a tie explains the same error, which the rotor explains: it is as needless.
    """
    why = why_rotor_is_enough(case.trim)
    if not why or any(c.effect.id == "rotor_effectiveness" and c.since == "changed" for c in found.causes):
        return
    kept = []
    for since, tie in found.ties:
        if since == "changed" and any(t.offer.cause in OF_TOTAL_THRUST for t in tie.tests):
            found.contradicted |= {t.offer.cause: (t, why) for t in tie.tests}
            found.stand_ins = [c for c in found.stand_ins if c.test.offer[:2] != tie.tests[0].offer[:2]]
        else:
            kept.append((since, tie))
    found.ties = kept


def _significant_next_to_rotor(case: Case, found: Found, causes: Sequence[Cause]) -> list[Cause]:
    """The causes that are significant with the rotor given that the trim names, where forces and moments do not name
    it, the least significant one left out first; ties that are not are taken from `found`. What the rotor changes
    beyond the trim would look like another cause.
    """
    name = named_rotor(case.trim)
    named = any((c.effect.id, c.since) == ("rotor_effectiveness", "changed") for c in causes)
    if not name or named or "rotor_effectiveness" not in found.study.columns.causes:
        return list(causes)
    (rotor,) = case.trim.document["parameters"][name]
    given = Candidate("rotor_effectiveness", "changed", (case.effects["rotor_effectiveness"].fitted.index(rotor),))
    mixed = found.study.witnessed(range(len(case.learning)), case.compared)
    offers = [*(c.test.offer for c in causes), *(tie.tests[0].offer for _, tie in found.ties)]

    gone: dict[Candidate, str] = {}
    while asked := [o for o in offers if o.since == "changed" and o.cause != given.cause]:
        others = {o: [given, *(r for r in offers if r != o)] for o in asked}
        p, worst = max((mixed.test(o, rest, mixed.pooled("changed")).p, o) for o, rest in others.items())
        if p < found.level["changed"]:
            break
        gone[worst] = f"p = {p:.2g} with {name} given, which the trim shows"
        offers.remove(worst)
    for cause in causes:
        if cause.test.offer in gone:
            found.contradicted[cause.effect.id] = cause.test, gone[cause.test.offer]
    for _, tie in found.ties:
        if reason := gone.get(tie.tests[0].offer):
            found.contradicted |= {t.offer.cause: (t, reason) for t in tie.tests}
    found.stand_ins = [c for c in found.stand_ins if c.test.offer not in gone]
    found.ties = [(since, tie) for since, tie in found.ties if tie.tests[0].offer not in gone]
    return [c for c in causes if c.test.offer not in gone]


def _harmless(
    case: Case, settled: Settled, made: Callable[[Sequence[Cause], bool], Model], unjudged: Sequence[Cause]
) -> Settled:
    """Without causes that make an axis or a simulation of the held-out flights worse.

    unjudged  causes that these hardly show
    """
    if not settled.causes:
        return settled

    def model_of(causes: Sequence[Cause]) -> Model:
        return made(causes, case.anew(causes))

    def errors(model: Model) -> np.ndarray:
        left = after(model, case.model)
        return np.sqrt([wrench_score(case.held, left, centred).mean() for centred in (False, True)])

    for cause in correcting_others(settled.causes, model_of, errors, unjudged) if case.held else []:
        settled = _without(
            settled, cause, "its axes stay as wrong as without any cause: it corrects what another errs by"
        )
    _, rejected, left = reject_losing_causes(settled.causes, model_of, lambda model: _losses_of(case, model), errors)
    for cause, loss in rejected:
        settled = _without(settled, cause, f"with it {loss.sentence()}")
    return settled._replace(losses=left)


def _losses_of(case: Case, model: Model) -> list[Loss]:
    horizons, share = case.settings["horizons"], case.settings["material share"]
    return losses(case.model, model, case.held, case.tables, horizons, share, commanded=False)


def _with_losses_left(
    case: Case, settled: Settled, judged: Settled, made: Callable[[Sequence[Cause], bool], Model]
) -> Settled:
    """The losses of the causes that are left in the end. judged  those causes that the losses were judged with"""
    if len(settled.causes) == len(judged.causes):
        return settled
    causes = settled.causes
    return settled._replace(losses=_losses_of(case, made(causes, case.anew(causes))) if causes else [])


def _of_use(
    case: Case, settled: Settled, made: Callable[[Sequence[Cause], bool], Model], level: Mapping[str, float]
) -> Settled:
    """Without causes that surely improve nothing of the held-out flights and surely make a simulation worse, however
    little: they are something of the flights that they were found on. What roll-outs confirm stands, and so does what
    passed its level twice over: a cause that acts in a few seconds hardly shows in a flight's whole error."""
    for cause in settled.causes if case.held else []:
        confirmed = settled.confirmations[cause.effect.id, cause.since].outcome == CONFIRMED
        if confirmed or cause.test.p < level[cause.since] ** 2:
            continue
        anew = case.anew(settled.causes)
        models = [made([c for c in settled.causes if c is not cause], anew), made(settled.causes, anew)]
        channels = [axis for axis in AXES if axis in cause.effect.channels] or list(AXES)
        shares = [removed_shares(*pair) for pair in wrench_pairs(models, case.model, case.held) if len(pair[0].t)]
        ends = [of[AXES.index(axis)] for of in shares for axis in channels]
        rows = simulated_rows(models, case.model, case.held, case.tables, case.settings["horizons"], False)
        moved = {MOVED_BY[axis] for axis in channels}
        simulated = [row for of in rows.values() for row in of if row["quantity"] in moved]
        if loss := only_loss(ends, simulated):
            settled = _without(settled, cause, f"it surely improves nothing, and with it {loss.sentence()}")
    return settled


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
    # the slope at nothing of what bends would leave most of it unexplained
    sizes = {c.test.offer: c.value for c in found.stand_ins if c.effect.is_nonlinear}
    return accepted + [(effects[o.cause], o, sizes.get(o, {})) for o in (t.tests[0].offer for _, t in found.ties)]


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


def _next_to_unknown(case: Case, settled: Settled, found: Found, left: unexplained.Left) -> Settled:
    """Without changes that roll-outs do not confirm and that make next to nothing of what no cause explains on their
    axes: of an error of unknown form, a part may look like anything."""
    doubtful = [c for c in settled.causes if c.since == "changed"]
    doubtful = [c for c in doubtful if settled.confirmations[c.effect.id, c.since].outcome != CONFIRMED]
    if not doubtful:
        return settled
    unknown = np.zeros(len(AXES))
    for entry in _unknown(case, settled, found, left):
        if entry["since"] == "changed":
            k = AXES.index(entry["channel"])
            unknown[k] = max(unknown[k], entry["size"] ** 2)
    for cause in doubtful:
        if drowned(*_power(cause, case), unknown):
            settled = _without(settled, cause, DROWNED)
    return settled


def _fainter_than_unknown(case: Case, settled: Settled, found: Found, left: unexplained.Left) -> Settled:
    """Without names and ties where the axis that shows them most, or any axis where theirs disagree, holds something
    clearer that no cause explains. What acts on forces or on moments alone, and no roll-out confirms, gives way to such
    errors on all axes of these. The functions that describe an unknown error have not its form: what they leave of it
    may look like anything."""
    unknown = _unknown(case, settled, found, left)
    tied = {tie.tests[0].offer: tie for _, tie in found.ties}

    def why(cause: Cause) -> str:
        (own, usual), tie = _power(cause, case), tied.get(cause.test.offer)
        chance, apart = (cause.test.p, cause.apart) if tie is None else (tie.tests[0].p, tie.apart)
        seen, axes = seen_in(cause.effect), [int(np.argmax(own / np.maximum(usual, 1e-300)))]
        axes = seen if apart > 1.0 else axes
        confirmed = tie is not None or settled.confirmations[cause.effect.id, cause.since].outcome == CONFIRMED
        if not confirmed and len({k // 3 for k in seen}) == 1:
            axes = [k for k in range(len(AXES)) if k // 3 == seen[0] // 3]
        for entry in unknown:
            channel, where, p = entry["channel"], entry["where"], entry["evidence"]["p"]
            axis = AXES.index(channel)
            # next to a cause that is far larger it may be the error of that one's form, however clear both are
            if entry["size"] ** 2 < FORM_ERROR * own[axis]:
                continue
            if axis in axes and entry["since"] == cause.since and p < chance:
                place = where_in_words(where)
                return f"{channel} differs {place} in a way that no cause explains, and more clearly (p = {p:.2g})"
        return ""

    for stand_in in [c for c in found.stand_ins if why(c)]:
        _drop_ties(found, stand_in, why(stand_in))
    for cause in settled.causes:
        settled = _without(settled, cause, why(cause)) if why(cause) else settled
    return settled


def _unknown(case: Case, settled: Settled, found: Found, left: unexplained.Left) -> Sequence[Mapping[str, Any]]:
    """Entries of "unexplained": what a place or time orders, else what is left beyond the reference flights, where no
    restless air makes it, which is a finding of its own."""
    if any(entry["since"] == "changed" for entry in left.entries):
        return left.entries
    restless = gusts(found.study, case.compared, [c.effect.id for c in settled.causes])
    return with_errors_beyond_references(left.entries, restless, case, settled, found)


def _power(cause: Cause, case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Mean squares (6,) about each flight's mean, of what a cause makes in the compared flights and of their errors;
    excluded axes have neither, for nothing unknown is sought there."""
    flights = [f for f, flag in zip(case.learning, case.compared) if flag]
    made = [f.heard(whole_of(cause.effect, f, case.vehicle, cause.value)) for f in flights]
    errors = [f.heard(f.residual) for f in flights]
    return tuple(np.mean([np.var(v, axis=0) for v in of], axis=0) for of in (made, errors))


def with_errors_beyond_references(
    entries: Sequence[Mapping[str, Any]], restless: Sequence[Any], case: Case, settled: Settled, found: Found
) -> list[Mapping[str, Any]]:
    """Entries of "unexplained", and what the compared flights leave on other axes beyond the reference flights, where
    no entry is a change: what all flights show is no reason to overlook one. restless  findings of gusts"""
    if restless or any(entry["since"] == "changed" for entry in entries):
        return list(entries)
    seen = {entry["channel"] for entry in entries}
    return [*entries, *(e for e in errors_beyond_references(case, settled, found) if e["channel"] not in seen)]


def errors_beyond_references(case: Case, settled: Settled, found: Found) -> list[dict[str, Any]]:
    """Entries of "unexplained": what compared flights leave beyond the reference flights, with causes and ties."""
    firsts = {(tie.tests[0].offer.cause, since) for since, tie in found.ties}
    kept = [*settled.causes, *(c for c in found.stand_ins if (c.effect.id, c.since) in firsts)]
    references = [f for f, flag in zip(case.learning, case.compared) if not flag]
    others = [f for f, flag in zip(case.learning, case.compared) if flag] + list(case.held)
    # ties are taken into account: what they explain is no secret
    stood_for = Model(case.extended(kept, found.study, "ties", case.anew(settled.causes)), "ties")
    # what made the model is judged as the other flights are: by what it had no part in
    own = made_of(case.model, references)
    usual = residual_of_others(found.study, references) if own else after(case.model, case.model)
    rate = 0.5 * case.settings["false alarm rate"] / SEARCHES
    left = less_usual_differences(after(stood_for, case.model))
    return left_beyond_references(references, others, less_usual_differences(usual), left, rate)


def refused_changes(case: Case, found: Found) -> list[dict[str, Any]]:
    """Entries of "unexplained": significant changes that the trim or the axes refuse, where nothing takes their place.
    They are not what they look like, but something changed. A rotor that the trim alone names takes their place."""
    entries = []
    for name, (test, why) in () if named_rotor(case.trim) else found.refused.items():
        if test.offer.since != "changed" or test.p >= found.level["changed"] or name not in case.effects:
            continue
        effect = case.effects[name]
        values = {effect.fitted[k]: float(v) for k, v in zip(test.offer.which, test.value)}
        flights, usual = (
            [f for f, flag in zip(case.learning, case.compared) if flag is side] for side in (True, False)
        )
        made = np.mean([np.mean(whole_of(effect, f, case.vehicle, values) ** 2, axis=0) for f in flights], axis=0)
        own = np.mean([np.mean(f.residual**2, axis=0) for f in flights], axis=0)
        axes = [k for k in seen_in(effect) if not any(k in f.excluded for f in case.learning)]
        if axes:
            # it may have been refused for an axis that shows no change: the axis whose errors grew most is reported
            sides = grown_by(flights, usual) * (made > 0.0) if usual else made / np.maximum(own, 1e-300)
            k = max(axes, key=lambda k: sides[k])
            entries.append({
                "channel": AXES[k], "where": EVERYWHERE, "judged": False, "share": None, "since": "changed",
                "size": float(np.sqrt(own[k])), "unit": "N" if k < 3 else "N m", "mostly": [],
                "evidence": {"p": test.p, "looks like": name, "why not": why},
            })  # fmt: skip
    return entries
