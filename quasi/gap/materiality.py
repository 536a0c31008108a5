"""Whether a cause matters: what it removes of the error of flights that had no part in finding it.

A cause matters where leaving it out costs a share of the removable error of some channel on held-out flights. Removable
is the error above the floor, the best fit of all that the level knows. A cause that held-out flights hardly excite
cannot be judged and keeps its name.

Forces and moments: causes may be nonlinear, so sets of causes are scored (`material`), and of sets that explain as
much the smallest is kept (`simplest`). Real airframes never match a fitted family exactly, and with enough samples
everything is significant. What flights have in common is judged harder than what changed: the model was fitted to such
flights, and what its terms leave there is mostly the form of the terms.

Sensors and drive: errors are linear in the causes, so what each removes follows from its columns (`gains_of`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from quasi.errors import DataError
from quasi.gap.effect import Effect
from quasi.gap.statistics.blocks import HOLDS
from quasi.gap.statistics.candidates import Test
from quasi.gap.statistics.scores import Score, fraction, surely, within
from quasi.model.model import AXES

MOST_WEIGHED = 5  # causes of which every selection is tried
# least share of a channel's error that counts as removable
LEAST_ABOVE_FLOOR = {"changed": 0.01, "spoken of": 0.1, "foreign": 0.1, "always": 0.25}
SIMPLER = 2.0  # times the material share that a simpler explanation may leave
ASIDE = 0.4  # share that what healthy flights show as well must gain beyond doubt
LACKING = 3.0  # times the material share that what a model lacks must gain beyond doubt, where no flight is healthy
LACKED = 6  # of what a model lacks of its own vehicle, the most significant that may be reported
FORM_SHARE = 0.3  # of the test statistic of the strongest foreign cause, below which another may be that one's form
Deviations = dict[str, float]


@dataclass
class Cause:
    """An accepted cause: deviations from neutral with standard errors, the test, rivals it beat, gain per axis.

    apart  how many times further apart the axes are than they should be, by which `std` is widened
    asked  share of the removable error that had to go beyond doubt, of what all flights have alike; None where it was
           not weighed, as a stronger foreign cause is present
    """

    effect: Effect
    since: str
    value: Deviations
    std: Deviations
    test: Test
    rivals: list[Any]
    gain: dict[str, dict[str, float | None]] = field(default_factory=dict)
    probability: float = 0.0
    apart: float = 1.0
    asked: float | None = None
    needed: float | None = None


class Judged(NamedTuple):
    """How flights look under a model: errors, the same with constant ones taken off, -2 log likelihood."""

    errors: Score
    centred: Score
    unlikely: float


class Common(NamedTuple):
    """What judges causes that all flights have alike.

    errors  with some causes taken into account, the model's own terms fitted anew or not: by blocks, constant errors
            left out, which fitting anew moves and flights differ by
    old, floor  errors (blocks, 6) before, at best (6,); share  of what is removable that must go beyond doubt
    fitted  whether some of these flights made the model, which then says nothing of how it does on others
    absent_when_healthy  the share for causes that no sound vehicle has, if it is another
    """

    errors: Callable[[Sequence[Cause], bool], Score]
    old: Score
    floor: np.ndarray
    share: float
    fitted: bool = False
    absent_when_healthy: float | None = None


def material(
    causes: Sequence[Cause],
    score: Callable[[Sequence[Cause], bool], Judged],
    excited: Callable[[Cause], bool],
    old: Score,
    floor: np.ndarray,
    share: float,
    common: Common,
    acting: Callable[[Cause], np.ndarray] | None = None,
) -> tuple[list[Cause], list[Cause], list[Cause]]:
    """Causes that matter, those that do not, and those of the first that these flights could not judge.

    score    of held-out flights with some causes taken into account, the model's own terms fitted anew or not
    excited  whether the held-out flights show a cause at all; old, floor  errors (blocks, 6) before, at best (6,)
    share    least share of the removable error of some axis that leaving a cause out must cost; common  what judges
             causes that all flights have alike; acting  cause -> the blocks (B,) bool in which it acts: a cause that
             acts in a few seconds only counts there
    """
    unjudged = [c for c in causes if c.since == "changed" and not excited(c)]
    kept = [c for c in causes if c.since == "changed"]
    while kept:
        whole, worth = score(kept, False), []
        for cause in kept:
            without = score([c for c in kept if c is not cause], False)
            cause.gain = fraction(without.errors, whole.errors, floor)
            first, last, own = without.errors.mean(), whole.errors.mean(), seen_in(cause.effect)
            # a constant error, which flights differ by, may have the other sign on the held-out ones
            gone = np.maximum(first - last, without.centred.mean() - whole.centred.mean())
            part = float((gone / _removable(old, floor, "changed"))[own].max())
            if acting is not None and (there := acting(cause)).any():
                local = within(without.errors, there).mean() - within(whole.errors, there).mean()
                part = max(part, float((local / _removable(within(old, there), floor, "changed"))[own].max()))
            # a form that is not quite right may make a flight less likely although it takes the error away
            fallen = np.log(np.maximum(last, 1e-300) / np.maximum(first, 1e-300))
            better = without.unlikely > whole.unlikely or fallen[own].sum() < 0.0
            worth.append(part if better else min(part, 0.0))
        poor = [w if c not in unjudged else np.inf for c, w in zip(kept, worth)]
        if min(poor) >= share:
            break
        kept.pop(int(np.argmin(poor)))
    shared = _common([c for c in causes if c.since == "always"], kept, score, floor, common)
    kept = sorted([*kept, *shared], key=lambda c: c.test.p)
    return kept, [c for c in causes if c not in kept], [c for c in unjudged if c in kept]


def simplest(
    causes: Sequence[Cause],
    estimated: Callable[[Sequence[Cause]], list[Cause] | None],
    score: Callable[[Sequence[Cause]], Judged],
    old: Score,
    floor: np.ndarray,
    share: float,
    unjudged: Sequence[Cause] = (),
    acting: Callable[[Cause], np.ndarray] | None = None,
) -> list[Cause]:
    """The fewest of the causes that leave less than SIMPLER times `share` of the removable error more than all do.

    Of as many, those that are clearest in the other flights. Two causes that correct each other are needed both as
    long as both are there.
    estimated  some causes -> the same with their parameters found without the others, None where these are impossible
    score      of held-out flights; unjudged  causes that these do not show, and so cannot call needless
    """
    if not 1 < len(causes) <= MOST_WEIGHED:
        return list(causes)
    removable, whole = _removable(old, floor, "spoken of"), score(causes).errors

    def lost(some: Sequence[Cause]) -> float:
        """Largest share of the removable error of an axis that some causes leave, also where those left out act."""
        errors, used = score(some).errors, {(c.effect.id, c.since) for c in some}
        shares = [(errors.mean() - whole.mean()) / removable]
        for cause in causes:
            if acting is not None and (cause.effect.id, cause.since) not in used and (there := acting(cause)).any():
                local = within(errors, there).mean() - within(whole, there).mean()
                shares.append((local / _removable(within(old, there), floor, "spoken of"))[seen_in(cause.effect)])
        return float(np.concatenate(shares).max())

    shown = [c for c in causes if c not in unjudged]
    for size in range(0 if unjudged else 1, len(shown)):
        some_of = ([*some, *unjudged] for some in combinations(shown, size))
        tried = [own for some in some_of if (own := estimated(some)) is not None]
        if not tried:
            continue
        losses = [lost(some) for some in tried]
        enough = [some for some, loss in zip(tried, losses) if loss < SIMPLER * share]
        if enough:
            # these flights only rule out; of what they leave, the others choose: where the faintest cause is clearest
            best = min(enough, key=lambda some: max((c.test.p for c in some), default=0.0))
            before = {c.effect.id: c for c in causes}
            for cause in best:
                cause.gain, cause.probability = before[cause.effect.id].gain, before[cause.effect.id].probability
            return best
    return list(causes)


def _common(
    causes: list[Cause], changed: list[Cause], score: Callable[[Sequence[Cause], bool], Judged], floor: np.ndarray,
    common: Common,
) -> list[Cause]:  # fmt: skip
    """Causes that all flights have alike: the model's own terms, fitted anew with them, must do better by a share of
    the removable error, beyond doubt, than its own terms fitted anew without them and, on flights that did not make it,
    than the model as it was; and so must each of them, unless the strongest foreign one needs it. The held-out flights
    must not become less likely. Axes outside a cause's channels have no say.
    """
    if not causes:
        return []
    offered, special = causes, None
    if common.absent_when_healthy is not None:
        special = max((c for c in causes if c.effect.absent_when_healthy), key=lambda c: c.test.wald, default=None)
    if special is not None:
        faint = FORM_SHARE * special.test.wald
        causes = [c for c in causes if c is special or not c.effect.absent_when_healthy or c.test.wald >= faint]
    elif common.absent_when_healthy is not None:
        causes = sorted(causes, key=lambda c: c.test.p)[:LACKED]

    def sort_of(cause: Cause) -> str:
        return "foreign" if special is not None and cause.effect.absent_when_healthy else "always"

    for cause in offered:
        share = common.absent_when_healthy if sort_of(cause) == "foreign" else common.share
        cause.asked = share if cause in causes else None
    removable = {flag: _removable(common.old, common.floor, flag) for flag in ("always", "foreign")}

    def better(first: Score, last: Score, sort: str, of: Sequence[Cause]) -> float:
        """The surest share of the removable error that goes on any axis of some causes, of the share that has to."""
        share = common.share if sort == "always" else common.absent_when_healthy
        axes = sorted({k for cause in of for k in seen_in(cause.effect)})
        return float(surely(first, last, removable[sort])[axes].max()) / share

    unlikely, known = score(changed, False).unlikely, dict[tuple[int, ...], Score]()

    def errors(of: Sequence[Cause]) -> Score:
        key = tuple(id(c) for c in of)
        if key not in known:
            known[key] = common.errors([*changed, *of], True)
        return known[key]

    def worth_of(cause: Cause, among: Sequence[Cause]) -> float:
        rest = [c for c in among if c is not cause]
        return better(errors(rest), errors(among), sort_of(cause), [cause])

    def supports(cause: Cause) -> bool:
        """Whether the strongest foreign one would not be sure any more if only the model's terms stood in for this."""
        rest = [c for c in causes if c is not cause]
        return cause is not special and worth_of(special, rest) < 1.0

    others = [errors([])] + ([] if common.fitted else [common.errors(changed, False)])
    while causes:
        judged, worth = score([*changed, *causes], True), [worth_of(c, causes) for c in causes]
        sort = "foreign" if special in causes else "always"
        all_better = min(better(other, errors(causes), sort, causes) for other in others) >= 1.0
        together = all_better and judged.unlikely < unlikely
        order = [causes[k] for k in np.argsort(worth)]
        poor = [c for c, w in zip(order, sorted(worth)) if w < 1.0]
        least = next((c for c in poor if special not in causes or not supports(c)), None)
        if together and least is None and special not in poor:
            for cause in causes:
                rest = [*changed, *(c for c in causes if c is not cause)]
                cause.gain = fraction(score(rest, True).errors, judged.errors, floor)
            return causes
        if order[0] is special:  # which stands in nobody's way then
            return _common([c for c in offered if c is not special], changed, score, floor, common)
        causes = [c for c in causes if c is not (least or order[0])]
    return []


def seen_in(effect: Effect) -> list[int]:
    """Axes in which a cause shows; all where it names none."""
    return [k for k, axis in enumerate(AXES) if axis in effect.channels] or list(range(len(AXES)))


def _removable(old: Score, floor: np.ndarray, since: str) -> np.ndarray:
    """Error (6,) above the floor; infinite where that is too small a part to speak of, but for single causes, and on
    excluded axes, which have no error."""
    gone, small = np.maximum(old.mean() - floor, 0.0), LEAST_ABOVE_FLOOR[since] * old.mean()
    least = np.where(small > 0.0, small if since in ("changed", "foreign") else np.inf, np.inf)
    return np.where(gone > small, gone, least)


class LinearErrors(NamedTuple):
    """Errors of one flight: before (n, C), at its floor (n, C); columns (n, C, P) of what causes move."""

    before: np.ndarray
    floor: np.ndarray
    columns: np.ndarray


class Gain(NamedTuple):
    """Per channel (C,), as shares of the removable error: what a cause removes, and what it could remove at most.

    NaN where the floor holds nearly all of the error. squares (C,)  what it removes of the mean squared error; whole
    (C,)  the same as a share of all of it
    """

    removed: np.ndarray
    most: np.ndarray
    squares: np.ndarray
    whole: np.ndarray


def gains_of(flights: Sequence[LinearErrors], sizes: Mapping[str, np.ndarray]) -> dict[str, Gain]:
    """What each cause removes that all others leave. sizes {cause: (P,) values of the columns}."""
    rows = sum(len(f.before) for f in flights)

    def mean(parts: Sequence[np.ndarray]) -> np.ndarray:
        return sum((p**2).sum(axis=0) for p in parts) / rows

    before = mean([f.before for f in flights])
    above = before - mean([f.floor for f in flights])
    moves = {c: [f.columns @ v for f in flights] for c, v in sizes.items()}
    after = [f.before - sum(m[k] for m in moves.values()) for k, f in enumerate(flights)]
    left = mean(after)
    found = {}
    for cause, own in moves.items():
        # a cause that is not there leaves nothing to remove, but would do harm of its own size
        most = mean(own)
        removable = np.maximum(above, most)
        removable = np.where(removable > (1.0 - HOLDS) * before, removable, np.nan)
        squares = mean([a + m for a, m in zip(after, own)]) - left
        found[cause] = Gain(squares / removable, most / removable, squares, squares / np.maximum(before, 1e-300))
    return found


def each_usable(flights: Sequence[Any], make: Callable[[Any], Any]) -> list[Any]:
    """What `make` gives for the flights that it can use. Raises its DataError where there is none."""
    found, failure = [], DataError("no flight is held out")
    for flight in flights:
        try:
            found.append(make(flight))
        except DataError as error:
            failure = error
    if not found:
        raise failure
    return found


def without_nuisances(information: np.ndarray, spread: Mapping[int, float]) -> np.ndarray:
    """(P, P) that takes off the best values of the columns in `spread`, held by these standard deviations."""
    columns = list(spread)
    weight = np.diag([v**-2.0 for v in spread.values()])
    kept = np.eye(len(information))
    kept[columns] -= np.linalg.solve(information[np.ix_(columns, columns)] + weight, information[columns])
    return kept
