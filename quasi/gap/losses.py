"""What an extended model, or causes of the drive, make worse on held-out flights; and what surely goes of their errors.

A loss counts where its whole 95 % interval is a loss and it is material. Compared are forces and moments by axis, and
simulations by quantity and horizon.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.instruments import shown
from quasi.gap.levels.forces.error_reduction import Squares, after, before, wrench_squares
from quasi.gap.levels.forces.nuisance import nuisances
from quasi.gap.levels.rollouts import error_reduction
from quasi.gap.levels.rollouts.open_loop import MOVED_BY, WITH_COMMANDS, WITH_TRIM, WITHOUT_TRIM, fell, rms
from quasi.gap.materiality import Cause, seen_in
from quasi.gap.statistics import blocks
from quasi.model.model import AXES, Model

FORCES_LINE, DRIVE_LINE = "forces", "drive"  # the lines of losses of forces and moments, and of rotor speeds
OWN_LOSS = 0.05  # share by which an error must exceed that of the model without causes to be a cause's fault
OWN_TRIM = 3.0  # standard deviations of what healthy flights differ by, within which a constant error is a flight's own


class Loss(NamedTuple):
    """An error that the extended model enlarges: line ("forces", "drive" or that of a simulation), quantity, horizon
    (s, 0 but for simulations), root mean squares before and after, SI.

    of_trim  the flight's own trim explains it: it limits the verdict and rejects no cause
    one_axis  it is one axis of a vector that does not surely lose: it rejects only causes of that axis alone
    terms  the model's own without whose answer to the causes nothing is lost, and their axis; "" where there are none
    """

    line: str
    quantity: str
    horizon: float
    before: float
    after: float
    of_trim: bool = False
    one_axis: bool = False
    terms: str = ""

    @property
    def growth(self) -> float:
        """Share by which the root mean square grows."""
        return self.after / max(self.before, 1e-300) - 1.0

    def sentence(self) -> str:
        """The loss in words."""
        where = f"after {self.horizon:g} s of simulation" if self.horizon else "on the held-out flights"
        name = f"the speed of rotor {self.quantity[1:]}" if self.line == DRIVE_LINE else self.quantity
        text = f"the error of {name} {where} grows from {self.before:.3g} to {self.after:.3g}"
        return text + (f", by what the causes do to the model's own {self.terms}" if self.terms else "")


def reject_losing_causes(
    causes: Sequence[Cause], made: Callable[[Sequence[Cause]], Model], judge: Callable[[Model], list[Loss]],
    errors: Callable[[Model], np.ndarray] = lambda model: np.ones(len(AXES)),
) -> tuple[list[Cause], list[tuple[Cause, Loss]], list[Loss]]:  # fmt: skip
    """Causes that stand, those rejected with what they made worse, and the losses that no rejection ends.

    made  causes -> extended model; judge  extended model -> its losses; errors  extended model -> root mean squares of
    what it leaves of the held-out flights' forces and moments (6,), or (2, 6) with constant errors and without
    A cause that makes an axis of force or moment better by a larger factor than anything worse is none that is not
    there: its form errs, the loss limits the verdict, and the name stands.
    A loss that the model has without any cause (its own terms fitted anew) is no cause's fault, nor is one of trim,
    nor one of forces or of a simulation without trim beyond the axes of the causes: there another trim turns a gain of
    one axis into a loss of another. One cause after another is left out, each time the one without which the
    largest loss is smallest.
    """
    kept, rejected = list(causes), []
    found = judge(made(kept))
    if not found:
        return kept, rejected, found
    anyway = {loss[:3]: loss.after for loss in judge(made([]))}

    axes = {axis for cause in causes for axis in cause.effect.channels}
    moved = axes | {MOVED_BY[axis] for axis in axes if axis in MOVED_BY}

    def alone(quantity: str) -> bool:
        """Whether some cause acts on this axis of a vector and on no other axis of it."""
        kinds = [[axis if quantity in AXES else MOVED_BY[axis] for axis in c.effect.channels] for c in causes]
        first = quantity[0] if quantity in AXES else quantity.split()[0]
        return any([axis for axis in own if axis.startswith(first)] == [quantity] for own in kinds)

    def own(losses_: Sequence[Loss]) -> list[Loss]:
        return [
            loss
            for loss in losses_
            if not loss.of_trim
            and not (loss.one_axis and not alone(loss.quantity))
            and loss.after > (1.0 + OWN_LOSS) * anyway.get(loss[:3], 0.0)
            and (loss.line not in (WITHOUT_TRIM, FORCES_LINE) or loss.quantity in moved)
        ]

    while own(found) and kept:
        whole, factor = errors(made(kept)), 1.0 + own(found)[0].growth
        trials = [[c for c in kept if c is not cause] for cause in kept]
        trials = [t for t in trials if np.max(errors(made(t)) / np.maximum(whole, 1e-300)) < factor]
        if not trials:
            break
        outcomes = [judge(made(trial)) for trial in trials]
        worst = [max((loss.growth for loss in own(outcome)), default=0.0) for outcome in outcomes]
        best = int(np.argmin(worst))
        if worst[best] >= own(found)[0].growth:
            break
        [gone] = [c for c in kept if not any(c is other for other in trials[best])]
        rejected.append((gone, own(found)[0]))
        kept, found = trials[best], outcomes[best]
    return kept, rejected, found


def correcting_others(
    causes: Sequence[Cause], made: Callable[[Sequence[Cause]], Model], errors: Callable[[Model], np.ndarray],
    unjudged: Sequence[Cause] = (),
) -> list[Cause]:  # fmt: skip
    """Causes that leave the axes where they act no better than these are without any cause, the weakest first: they
    correct the form of another, which makes these axes worse. The strongest one is no such.

    made  causes -> extended model; errors  extended model -> root mean squares of what it leaves of the held-out
    flights' forces and moments (6,), or (2, 6) with constant errors and without, by which flights differ anyway: both
    count; unjudged  causes that held-out flights do not show: these leave their axes as they are
    """
    kept, first = sorted(causes, key=lambda c: -c.test.wald), np.maximum(errors(made([])), 1e-300)
    gone = []
    while len(kept) > 1:
        grown = np.log(np.maximum(errors(made(kept)), 1e-300) / first)
        shown = [c for c in kept[1:] if not any(c is other for other in unjudged)]
        poor = [c for c in shown if np.all(grown[..., seen_in(c.effect)].sum(axis=-1) >= 0.0)]
        if not poor:
            break
        gone.append(poor[-1])
        kept.remove(poor[-1])
    return gone


def drive_losses(gap: Mapping[str, Any]) -> list[Loss]:
    """Rotor speeds that the named causes of the drive make worse on held-out flights, the largest growth first.

    gap  errors "before" and "after" as in the diagnosis. One lag for all rotors is wrong for three where one is slow.
    """
    before, after = (gap[side].get(DRIVE_LINE) or {} for side in ("before", "after"))
    found = [Loss(DRIVE_LINE, w, 0.0, before[w]["0"], after[w]["0"]) for w in before if w in after]
    return sorted((loss for loss in found if loss.growth > OWN_LOSS), key=lambda loss: -loss.growth)


def losses(
    base: Model, extended: Model, held: Sequence[Evidence], flights: Mapping[str, pd.DataFrame],
    horizons: Sequence[float], share: float, commanded: bool = True,
) -> list[Loss]:  # fmt: skip
    """What an extended model makes worse on held-out flights, the largest growth first.

    share  material share of the squared error; a loss below it does not count
    commanded  whether simulations driven by commands count: they hold the errors of the rotors' drive, which no cause
               of forces and moments answers for
    A simulation without the flight's own trim may lose by chance where trim hides a gain, so it counts only where the
    same quantity does not gain with trim taken up. Where that quantity does not surely lose with trim, and the constant
    errors that the extension leaves are those of any healthy flight, the loss is one of trim. A cause moves several
    axes by one parameter, and a flight has errors of its own on each: the loss of one axis is marked where the error of
    the whole vector does not surely grow.
    """
    if not held:
        return []
    pairs = wrench_pairs((base, extended), base, held)
    found = _of_forces(pairs, share) if len(pairs[0][0].t) else []
    rows = simulated_rows((base, extended), base, held, flights, horizons, commanded)
    if rows:
        found += _of_simulations(rows, share, trim_is_usual(held, after(extended, base)))
    return sorted(found, key=lambda loss: -loss.growth)


MOST_BLAMED = 3  # own terms in the sentence of a loss: more point at no term, and each costs a prediction per term


def with_own_terms(
    found: Sequence[Loss], base: Model, extended: Model, held: Sequence[Evidence], share: float
) -> list[Loss]:  # fmt: skip
    """Losses with the terms of the model's own that make them, where these do.

    A wind moves all terms that hold a velocity. One that stands for something else answers to it with an error that no
    cause has: with such terms as they were, their axis of force or moment loses nothing. share  material share
    """
    axis_moved = {quantity: axis for axis, quantity in MOVED_BY.items()}
    axes = {loss: loss.quantity if loss.quantity in AXES else axis_moved.get(loss.quantity) for loss in found}
    terms = {axis: _own_terms(axis, base, extended, held, share) for axis in {*axes.values()} - {None}}
    return [loss._replace(terms=terms.get(axes[loss], "")) for loss in found]


def _own_terms(axis: str, base: Model, extended: Model, held: Sequence[Evidence], share: float) -> str:
    """The terms of an axis by whose change that axis loses, the one that makes most of it first; "" where others do."""
    k, names = AXES.index(axis), [term["name"] for term in base.document["axes"].get(axis, {}).get("terms", ())]
    old, new = _squares_of(axis, held, before), _squares_of(axis, held, after(extended, base))
    if not np.all(new > (1.0 + share) * old):
        return ""

    def left_with(still: Sequence[str]) -> np.ndarray:
        """Mean squares with some terms as they were."""
        pair = [_without_terms(model, axis, still) for model in (base, extended)]

        def as_it_was(flight: Evidence) -> np.ndarray:
            left = after(extended, base)(flight).copy()
            moves, others = (shown(m[1], m[0], flight) - shown(m[0], m[0], flight) for m in ((base, extended), pair))
            left[:, k] += (moves - others)[:, k]
            return left

        return _squares_of(axis, held, as_it_was)

    blamed: list[str] = []
    while len(blamed) < min(len(names), MOST_BLAMED):
        trials = {name: left_with([*blamed, name]) for name in names if name not in blamed}
        best = min(trials, key=lambda name: trials[name].sum())
        if not trials[best].sum() < new.sum():
            return ""
        blamed, new = [*blamed, best], trials[best]
        if np.all(new <= (1.0 + share) * old):
            return f"{' and '.join(blamed)} ({axis})"
    return ""


def _squares_of(axis: str, held: Sequence[Evidence], residual: Callable[[Evidence], np.ndarray]) -> np.ndarray:
    """Mean square (2,) of an axis, with constant errors and without."""
    squares = [wrench_squares(held, lambda f: f.heard(residual(f)), centred).mean() for centred in (False, True)]
    return np.array(squares)[:, AXES.index(axis)]


def _without_terms(model: Model, axis: str, names: Sequence[str]) -> Model:
    axes = model.document["axes"]
    terms = [{**term, "coefficient": 0.0} if term["name"] in names else term for term in axes[axis]["terms"]]
    return Model({**model.document, "axes": {**axes, axis: {**axes[axis], "terms": terms}}})


def wrench_pairs(models: Sequence[Model], base: Model, held: Sequence[Evidence]) -> list[tuple[Squares, ...]]:
    """Squared errors of forces and moments under some models, with constant errors and without; excluded axes 0."""
    left = [before if model is base else after(model, base) for model in models]
    heard = [lambda flight, of=of: flight.heard(of(flight)) for of in left]
    return [tuple(wrench_squares(held, residual, centred) for residual in heard) for centred in (False, True)]


def simulated_rows(
    models: Sequence[Model], base: Model, held: Sequence[Evidence], flights: Mapping[str, pd.DataFrame],
    horizons: Sequence[float], commanded: bool,
) -> dict[str, list[dict[str, Any]]]:  # fmt: skip
    """By how much the errors of simulations fall from the first model to the second, by line; none without tracks."""
    tracks = error_reduction.tracks_of(held, flights, horizons, models)
    if not tracks:
        return {}
    lines = [line for line in error_reduction.lines_of(tracks) if commanded or line != WITH_COMMANDS]
    errors = [error_reduction.simulated_errors(tracks, model, base, lines) for model in models]
    return {line: fell(*(error_reduction.end_table(tracks, e[line], horizons, line) for e in errors)) for line in lines}


def correction_matters(
    model: Model, first: tuple[Sequence[Evidence], Mapping[str, pd.DataFrame]],
    last: tuple[Sequence[Evidence], Mapping[str, pd.DataFrame]], horizons: Sequence[float], share: float,
) -> bool:  # fmt: skip
    """Whether a correction of sensors changes what the model leaves of forces, moments or simulations.

    first, last  held-out flights (evidence, filtered tables by key) before and after the correction; share  of a
    squared error, from which a change counts. A fault of sensors below that is a finding and explains no gap.
    """
    old, new = (wrench_squares(held, lambda f: f.heard(before(f))).mean() for held, _ in (first, last))
    if np.any(np.abs(new - old) >= share * np.maximum(old, 1e-300)):
        return True
    ends = []
    for held, tables in (first, last):
        tracks = error_reduction.tracks_of(held, tables, horizons)
        if not tracks:
            return False
        errors = error_reduction.simulated_errors(tracks, model, model, (WITHOUT_TRIM,))[WITHOUT_TRIM]
        ends.append(rms(error_reduction.end_table(tracks, errors, horizons)))
    pairs = [(ends[0][q][h], ends[1][q][h]) for q in ends[0] for h in ends[0][q]]
    return any(abs(b**2 - a**2) >= share * a**2 for a, b in pairs if a > 0.0)


def removed_shares(old: Squares, new: Squares) -> list[tuple[float, float, float]]:
    """The share of each axis's squared error that goes, and the ends of its 95 % interval."""
    drawn = blocks.drawn(old.flight, old.t, np.stack([old.values, new.values], axis=1))
    shares = (old.mean() - new.mean()) / np.maximum(old.mean(), 1e-300)
    share_of = (drawn.sums[:, 0] - drawn.sums[:, 1]) / np.maximum(drawn.sums[:, 0], 1e-300)
    return [(share, *blocks.interval(share, share_of[:, k], drawn.wider)) for k, share in enumerate(shares.tolist())]


def _of_forces(pairs: Sequence[tuple[Squares, Squares]], share: float) -> list[Loss]:
    """Axes that are surely worse with constant errors and without: constants are what flights differ by anyway."""
    worse = []
    for old, new in pairs:
        a, b = old.mean(), new.mean()
        ends = removed_shares(old, new)
        worse.append([high < 0.0 and b[k] > (1.0 + share) * a[k] for k, (*_, high) in enumerate(ends)])
    old, new = pairs[0]
    rms = np.sqrt([old.mean(), new.mean()])
    shrinks = np.repeat(np.diff((rms**2).reshape(2, 2, 3).sum(axis=2), axis=0)[0] < 0.0, 3)  # force, moment
    return [
        Loss(FORCES_LINE, axis, 0.0, float(rms[0, k]), float(rms[1, k]), one_axis=bool(shrinks[k]))
        for k, axis in enumerate(AXES)
        if worse[0][k] and worse[1][k]
    ]


def trim_is_usual(held: Sequence[Evidence], left: Callable[[Evidence], np.ndarray]) -> bool:
    """Whether the constant errors that an extended model leaves are those by which healthy flights differ.

    left  flight -> residual (n, 6). Each axis of each flight must stay within OWN_TRIM standard deviations of nuisances
    together, or be no more than one standard deviation larger than before. Excluded axes have no say.
    """
    for flight in held:
        usual = np.sqrt(sum((spread * column.mean(axis=0)) ** 2 for _, column, spread in nuisances(flight)))
        last, first = (np.abs(flight.heard(r).mean(axis=0)) for r in (left(flight), flight.residual))
        if np.any(last > np.maximum(OWN_TRIM * usual, first + usual)):
            return False
    return True


def _of_simulations(
    rows: Mapping[str, Sequence[Mapping[str, Any]]], share: float, usual_trim: bool = False
) -> list[Loss]:
    trimmed = {(r["quantity"], r["horizon"]): r for r in rows.get(WITH_TRIM, ())}
    found = []
    for line, of in rows.items():
        vectors = {(r["quantity"], r["horizon"]): r for r in of}
        for row in of:
            # the share is of squared errors, the rows are of root mean squares
            if not (row["high"] < 0.0 and row["after"] ** 2 > (1.0 + share) * row["before"] ** 2):
                continue
            other = trimmed.get((row["quantity"], row["horizon"]))
            if line == WITHOUT_TRIM and other is not None and other["value"] > 0.0:
                continue
            of_trim = usual_trim and line == WITHOUT_TRIM and other is not None and other["high"] >= 0.0
            vector = vectors.get((row["quantity"].split()[0], row["horizon"]))
            one_axis = vector is not None and vector is not row and vector["high"] >= 0.0
            found.append(Loss(line, row["quantity"], row["horizon"], row["before"], row["after"], of_trim, one_axis))
    return found


def only_loss(shares: Sequence[tuple[float, float, float]], simulated: Sequence[Mapping[str, Any]]) -> Loss | None:
    """The largest sure loss of simulations where nothing surely gains, nor the forces and moments together as far as
    they are known; None where something does, or nothing loses.

    shares  what goes of forces and moments, with the ends of its interval; simulated  rows of `fell`. A simulation
    alone may lose by the held-out flight's own trim.
    """
    if any(low > 0.0 for _, low, _ in shares) or any(row["low"] > 0.0 for row in simulated):
        return None
    worse = [row for row in simulated if row["high"] < 0.0]
    if sum(share for share, *_ in shares) > 0.0 or not worse:
        return None
    most = min(worse, key=lambda row: row["value"])
    return Loss(WITHOUT_TRIM, most["quantity"], most["horizon"], most["before"], most["after"])
