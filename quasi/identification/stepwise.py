"""Stepwise regression on cross-products: which columns of a pool make the target.

Selection is a Cholesky factorisation with pivots: after each pick, the squared length of what is left of every
candidate and its product with what is left of the target are updated at once.

Two entry tests. "F" is the manual's: the partial F of a candidate must exceed a constant, and each step drops the
weakest term whose partial F lies below another. "significance" asks for a probability over the whole pool, the
residuals' memory counted (quasi.identification.evidence). One strong term that is still missing makes every other look
uncertain; a candidate may therefore enter on trial, and has to stand by itself at the end. Terms that do not stand are
dropped, terms that another candidate replaces with a smaller error are exchanged, until nothing changes. Of few flights
hardly anything is significant over a whole pool, though a term may halve the error of every flight; from there on terms
also stand that lower the error of flights left out, if the model does so as a whole.

Source: Klein & Morelli, Aircraft System Identification, 2006, section 5.4; QuaSI user manual V1.0.a, section 6.2,
equations (3)-(12); Miller, Subset Selection in Regression, 2002, section 3.6 (sequential replacement).
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from quasi.errors import ConfigError, DataError
from quasi.identification.evidence import INDEPENDENT, Totals, entering, probability, standing
from quasi.identification.products import Products

TRIALS = 6  # steps in a row that may be taken on trial
FINAL_ROUNDS = 4  # of exchanging, adding and dropping at the end
PROPOSALS = 3  # exchanges that are tried before none is found
RIVAL = 0.98  # share of the best candidate's gain from which another is a rival
RIVALS = 10  # most that are listed
SQUARES_ROUNDING = 1e-13  # share of a sum of squares that is no more than rounding
# share of the squared error of left-out flights that a term must take away to stand without significance
LEAST_SHARE_TAKEN = 0.1
WORSE = 0.1  # of what it takes away of all flights together, that it may add to one of them
NEAR_REMEMBERED = 30  # candidates of a step that are remembered as near


@dataclass(frozen=True)
class Options:
    """How to select. cap: most forward-backward steps; test: "F" or "significance"; level: probability of letting in
    anything of a pool that holds nothing; f_in, f_out: partial F to enter and to stay; pool: candidates that the level
    is shared by, the pool's own when None; stop: "PSE" (predicted square error), "R2" (gain below 0.5 %), "F" (overall
    F no longer grows) or "none"."""

    cap: int = 10
    test: str = "F"
    level: float = 0.05
    f_in: float = 4.0
    f_out: float = 4.0
    stop: str = "PSE"
    pool: int | None = None

    def __post_init__(self) -> None:
        if self.stop not in ("PSE", "R2", "F", "none"):
            raise ConfigError(f"stop criterion is '{self.stop}', expected 'PSE', 'R2' or 'F'")
        if self.test not in ("F", "significance"):
            raise ConfigError(f"entry test is '{self.test}', expected 'F' or 'significance'")


@dataclass(frozen=True)
class Selection:
    """chosen: columns of the pool besides the fixed ones, in order of entry; log: one entry per step, plain data;
    reason: why it stopped, a sentence; bandwidth: neighbouring cells that resemble each other, for `evidence`;
    seen: {column: largest share of the best gain that it reached at any step} of those that came near being chosen."""

    chosen: list[int]
    log: list[dict[str, Any]]
    reason: str
    bandwidth: int = 1
    seen: dict[int, float] = field(default_factory=dict)


class State:
    """Model so far: columns, and what is left of every candidate and of the target after them."""

    def __init__(self, totals: Totals) -> None:
        self.totals = totals
        self.columns: list[int] = []
        self.left = totals.square.copy()  # squared length of what is left
        self.scale = totals.square
        self.with_target = totals.target.copy()
        self.error = totals.target_square
        self.factor = np.zeros((0, totals.size))

    def gain(self) -> np.ndarray:
        """How much the squared error falls by adding each column (m,); 0 where nothing of it is left."""
        usable = self.left > INDEPENDENT * self.scale
        usable[self.columns] = False
        return np.where(usable, self.with_target**2 / np.where(usable, self.left, 1.0), 0.0)

    def add(self, column: int, promising: np.ndarray | None = None) -> None:
        """Take a column into the model."""
        pivot = np.sqrt(self.left[column])
        row = (self.totals.cross(column, promising) - self.factor[:, column] @ self.factor) / pivot
        step = self.with_target[column] / pivot
        self.left = self.left - row**2
        self.with_target = self.with_target - row * step
        # of a perfect fit rounding is left, of either sign
        self.error = max(self.error - step**2, SQUARES_ROUNDING * self.totals.target_square)
        factor = np.empty((len(self.factor) + 1, self.totals.size))
        factor[:-1], factor[-1] = self.factor, row
        self.factor = factor
        self.columns.append(column)

    def copy(self) -> "State":
        """The same model, to be gone on with apart."""
        state = copy(self)
        state.columns = list(self.columns)
        return state

    def without(self, out: int) -> "State":
        """The model without a column."""
        state = State(self.totals)
        state.scale = self.scale
        for k in self.columns:
            if k != out:
                state.add(k)
        return state

    def gains_in_place_of(self, columns: Sequence[int]) -> np.ndarray:
        """As `gain`, (q, m), of the models without one of some columns each; that of the column itself among them.

        What is left of a column after the others is orthogonal to them: taking it out gives its part back.
        """
        inverse = self.totals.inverse(self.columns)
        rows = [self.columns.index(k) for k in columns]
        apart = inverse[rows] / np.diag(inverse)[rows, None]
        square = 1.0 / np.diag(inverse)[rows, None]
        products = apart @ np.array([self.totals.cross(k) for k in self.columns])
        with_target = self.with_target + products * (apart @ self.totals.target[self.columns])[:, None] / square
        left = self.left + products**2 / square
        usable = left > INDEPENDENT * self.scale
        usable[:, self.columns] = False
        usable[np.arange(len(rows)), columns] = True
        return np.where(usable, with_target**2 / np.where(usable, left, 1.0), 0.0)

    def partial_f(self) -> np.ndarray:
        """Partial F of each column in the model (p,), the statistic of equation (10)."""
        inverse = self.totals.inverse(self.columns)
        coefficients = inverse @ self.totals.target[self.columns]
        return coefficients**2 / np.diag(inverse) / (self.error / self.freedom())

    def freedom(self) -> int:
        """Rows less terms."""
        return self.totals.rows - len(self.columns)


def start(totals: Totals, unusable: dict[int, str], describe: Sequence[str], constant: bool) -> State:
    """The model of the fixed columns.

    Raises DataError when one is not finite, constant or a combination of the others, or rows are too few.
    """
    n = totals.rows
    if n < totals.fixed + 2:
        raise DataError(f"{n} training rows are too few for {totals.fixed} fixed regressors; use more flights")
    state = State(totals)
    for k in range(totals.fixed):
        if k in unusable or state.left[k] <= INDEPENDENT * state.scale[k]:
            why = unusable.get(k, "is a combination of the other fixed regressors")
            raise DataError(f"the fixed regressor '{describe[k]}' {why}; remove or correct it")
        state.add(k)
        if constant and k == 0:
            # how far a mean lies from zero says nothing about how much of a column is left; where nothing but rounding
            # is, the column is constant
            state.scale = np.where(state.left > SQUARES_ROUNDING * state.scale, state.left, np.inf)
    return state


class _Search:
    def __init__(self, state: State, options: Options, describe, total, memory) -> None:
        self.state, self.options, self.describe, self.total = state, options, describe, total
        self.memory, self.fixed = memory, state.totals.fixed
        self.share = options.level / max(options.pool or state.totals.size - self.fixed, 1)
        self.near = np.zeros(state.totals.size)
        self.log = [self.entry(state, 0)]
        self.bandwidth = 1
        self.waiting: list[int] = []  # terms on trial
        self.carrying = False  # whether terms also stand that left-out flights gain by

    def remember(self, columns: np.ndarray, gain: np.ndarray) -> None:
        if len(columns):
            self.near[columns] = np.maximum(self.near[columns], gain[columns] / max(gain.max(), 1e-300))

    def entry(self, state: State, number: int, pick: int | None = None, removed: int | None = None) -> dict[str, Any]:
        n, p = state.totals.rows, len(state.columns)
        r2 = 1.0 - state.error / self.total if self.total > 0 else float("nan")
        overall = float((n - p) / (p - 1) * r2 / (1 - r2)) if p > 1 and r2 < 1 else None
        return {
            "step": number,
            "selected": None if pick is None else self.describe[pick],
            "removed": None if removed is None else self.describe[removed],
            "PSE": float(state.error / n + self.total / n * p / n),
            "R2": float(r2),
            "F": overall,
        }

    def judge_candidates(self) -> np.ndarray:
        if self.memory is not None:
            self.bandwidth = self.memory(self.state.columns)
        t, freedom = entering(self.state.totals, self.state.columns, self.bandwidth)
        self.t, self.freedom_of_t = t, freedom
        return probability(t, freedom)

    def forward(self) -> str:
        """Steps until a reason to stop, which is returned."""
        o = self.options
        for number in range(1, o.cap + 1):
            stop = self.step(number, trial=True)
            if stop:
                return stop
            if o.stop != "none" and self.log[-1]["PSE"] < 1e-3 * self.log[0]["PSE"]:
                return "the PSE fell below a thousandth of its first value"
        return f"the regressor cap of {o.cap} steps is reached"

    def best(self, gain: np.ndarray, trial: bool) -> tuple[int, dict[str, Any]] | str:
        """The candidate to take next and how sure it is, or why there is none.

        gain  (m,) squared error that each takes away; trial  whether one may enter that does not stand by itself yet
        """
        pick = int(np.argmax(gain))
        if gain[pick] <= 0.0:
            return "no independent candidate is left"
        if self.options.test != "significance":
            return pick, {}
        chance, carried = self.judge_candidates(), []
        passing = np.flatnonzero((gain > 0.0) & (chance < self.share))
        self.remember(passing[np.argsort(-gain[passing])[:NEAR_REMEMBERED]], gain)
        if len(passing):
            pick = int(passing[np.argmax(gain[passing])])
        elif self.carrying:
            taken, first = self.state.columns, np.argsort(-gain)[:PROPOSALS]
            self.state.totals.cross(int(first[0]), gain)  # one pass over the rows for what is asked for next
            carried = [int(k) for k in first if self.carries(taken, [*taken, int(k)])]
            pick = carried[0] if carried else pick
        sure = bool(len(passing) or carried)
        if not sure and (not trial or len(self.waiting) >= TRIALS):
            return f"no candidate, {self.describe[pick]} first, stands out once the residuals' memory is counted"
        self.waiting = [] if sure else [*self.waiting, pick]
        return pick, {
            "t": float(self.t[pick]),
            "degrees of freedom": float(self.freedom_of_t[pick]),
            "probability over the pool": float(min(chance[pick] * self.share**-1 * self.options.level, 1.0)),
            "on trial": not sure,
            "by left-out flights": bool(carried),
        }

    def step(self, number: int, trial: bool) -> str | None:
        """Take one candidate and drop one term that became weak; why not, where the search ends."""
        state, o, describe = self.state, self.options, self.describe
        gain = state.gain()
        self.remember(np.argsort(-gain)[:NEAR_REMEMBERED], gain)
        found = self.best(gain, trial)
        if isinstance(found, str):
            return found
        pick, more = found
        freedom = state.freedom() - 1
        left = max(state.error - gain[pick], SQUARES_ROUNDING * state.totals.target_square)
        partial = gain[pick] / left * max(freedom, 0)
        if partial <= o.f_in:
            return f"the best candidate, {describe[pick]}, has a partial F of {partial:.3g}, not above {o.f_in:g}"
        correlation = float(np.sign(state.with_target[pick]) * np.sqrt(min(gain[pick] / state.error, 1.0)))
        rivals = _rivals(gain, pick, describe)
        before = state.copy()
        state.add(pick, gain)
        removed = None
        f = state.partial_f()[self.fixed :]
        weakest = int(np.argmin(f))
        if f[weakest] < o.f_out:
            removed = state.columns[self.fixed + weakest]
            if removed == pick:
                self.state = before
                return f"{describe[pick]} was added and removed again"
            self.state = state.without(removed)
        now = self.entry(self.state, number, pick, removed)
        now |= {"partial F": float(partial), "partial correlation": correlation}
        now |= {"runner up": rivals[0] if rivals else None, **more}
        now |= {"rivals": [r for r in rivals if r["share of gain"] > RIVAL]}
        stop = _worse(self.log[-1], now, o.stop)
        if stop:
            self.state = before
            return stop
        self.log.append(now)
        return None

    def weakest(self, state: State) -> tuple[int, float, dict[str, float]]:
        """Of the terms that are not fixed the least sure: column, probability that it is nothing (0 where left-out
        flights gain by it, if that counts), t and its freedom."""
        t, freedom = standing(state.totals, state.columns, self.bandwidth)
        chance = probability(t, freedom)[self.fixed :]
        for k in np.flatnonzero(chance >= self.share) if self.carrying else []:
            if self.carries([c for c in state.columns if c != state.columns[self.fixed + k]], state.columns):
                chance[k] = 0.0
        place = int(np.argmax(chance))
        at = self.fixed + place
        return state.columns[at], float(chance[place]), {"t": float(t[at]), "degrees of freedom": float(freedom[at])}

    def carries(self, before: list[int], after: list[int]) -> bool:
        """Whether flights that had no part in the coefficients are predicted better by the columns `after` than by the
        columns `before`, and none of them much worse."""
        old, new = self.state.totals.left_out(before), self.state.totals.left_out(after)
        gone = float((old - new).sum()) if np.isfinite(new).all() else -np.inf
        return len(old) > 1 and gone >= LEAST_SHARE_TAKEN * old.sum() and float((new - old).max()) <= WORSE * gone

    def drop(self) -> bool:
        """Remove terms that do not stand by themselves, weakest first. True when something went."""
        went = False
        while len(self.state.columns) > self.fixed:
            if self.memory is not None:
                self.bandwidth = self.memory(self.state.columns)
            out, chance, note = self.weakest(self.state)
            if chance < self.share:
                return went
            self.state, went = self.state.without(out), True
            self.log.append(self.entry(self.state, self.log[-1]["step"] + 1, None, out) | note)
        return went

    def exchange(self, strict: bool) -> bool:
        """Replace one term by the candidate that does better in its place. True when one was.

        strict  all terms must stand by themselves afterwards
        """
        free = self.state.columns[self.fixed :]
        if not free:
            return False
        gains = self.state.gains_in_place_of(free)
        new = np.argmax(gains, axis=1)
        rows = np.arange(len(free))
        better = gains[rows, new] - gains[rows, free]
        for gain in gains:
            self.remember(np.argpartition(-gain, min(NEAR_REMEMBERED, len(gain) - 1))[:NEAR_REMEMBERED], gain)
        for row in np.argsort(-better)[: PROPOSALS if strict else 1]:
            if better[row] <= 1e-9 * self.state.error:
                return False
            state = self.state.without(free[row])
            state.add(int(new[row]), gains[row])
            if not strict or self.weakest(state)[1] < self.share:
                self.state = state
                self.log.append(self.entry(state, self.log[-1]["step"] + 1, int(new[row]), free[row]))
                return True
        return False

    def settle(self) -> str:
        """Drop, exchange and add until nothing changes. Returns what was done, in words."""
        before = len(self.log)
        self._settle()
        done = self.log[before:]
        added = sum(e["removed"] is None for e in done)
        dropped = sum(e["selected"] is None for e in done)
        counts = {"dropped": dropped, "added": added, "exchanged": len(done) - added - dropped}
        changes = ", ".join(f"{n} {what}" for what, n in counts.items() if n)
        return f"; terms afterwards: {changes}" if changes else ""

    def _settle(self) -> None:
        # terms on trial help once to find what belongs in their place
        for _ in range(2 * len(self.state.columns)):
            if not self.exchange(strict=False):
                break
        self.drop()
        self.rounds()
        sure, logged, self.carrying = self.state, len(self.log), True
        self.rounds()
        if not self.carries(sure.columns, self.state.columns):
            # each term may do well with the others, and all of them together badly where no flight went
            self.state, self.log = sure, self.log[:logged]

    def rounds(self) -> None:
        """Exchange, add and drop until nothing changes, FINAL_ROUNDS times at most."""
        for _ in range(FINAL_ROUNDS):
            changed = False
            for _ in range(2 * len(self.state.columns)):
                if not self.exchange(strict=True):
                    break
                changed = True
            while len(self.state.columns) - self.fixed < self.options.cap:
                if self.step(self.log[-1]["step"] + 1, trial=False):
                    break
                changed = True
            changed |= self.drop()
            if not changed:
                return


def select(
    products: Products,
    options: Options,
    describe: Sequence[str],
    total: float | None = None,
    weights: np.ndarray | None = None,
    memory: Callable[[list[int]], int] | None = None,
    unusable: dict[int, str] | None = None,
    constant: bool = True,
) -> Selection:
    """Forward selection by partial correlation with backward elimination.

    products  cross-products per cell; its first `fixed` columns start the model and stay
    describe  name of every column, for log and messages
    total     sum of squares of the target about its mean, for R2 and PSE, if not that of the products' target
    weights   how often each cell counts, once each when None
    memory    number of neighbouring cells over which the residuals of a model of some columns resemble each other
    unusable  {column: why}; constant  whether the first column is the number 1
    Raises DataError when a fixed regressor is not finite, constant or a combination of the others, or rows are too few.
    """
    totals = Totals(products, weights)
    state = start(totals, unusable or {}, describe, constant)
    search = _Search(state, options, describe, totals.spread if total is None else total, memory)
    reason = search.forward()
    if options.test == "significance":
        reason += search.settle()
    chosen = search.state.columns[products.fixed :]
    seen = {int(k): float(search.near[k]) for k in np.flatnonzero(search.near > 0.0)} | dict.fromkeys(chosen, 2.0)
    return Selection(chosen, search.log, reason, search.bandwidth, seen)


def _worse(before: dict[str, Any], now: dict[str, Any], criterion: str) -> str | None:
    if criterion == "PSE" and now["PSE"] >= before["PSE"]:
        return f"the next step, adding {now['selected']}, would not lower the PSE"
    if criterion == "R2" and now["R2"] <= 1.005 * before["R2"]:
        return f"the next step, adding {now['selected']}, would raise R2 by less than 0.5 %"
    if criterion == "F" and before["step"] > 0 and before["F"] is not None and now["F"] <= before["F"]:
        return f"the next step, adding {now['selected']}, would not raise the overall F"
    return None


def _rivals(gain: np.ndarray, pick: int, describe: Sequence[str]) -> list[dict[str, Any]]:
    """The next best candidates and their share of the pick's gain: near 1, they can hardly be distinguished from it."""
    # those with a larger gain were turned away by a test
    order = [int(k) for k in np.argsort(-gain) if k != pick and 0.0 < gain[k] <= gain[pick]]
    return [{"expression": describe[k], "share of gain": float(gain[k] / gain[pick])} for k in order[:RIVALS]]
