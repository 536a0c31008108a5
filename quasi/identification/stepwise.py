"""Stepwise regression on cross-products: no matrix of all candidates is ever held.

The pool is evaluated in chunks. A first pass gathers every column's mean, spread and cross-product with the target and
the fixed regressors. A further pass is made only when a column's cross-products with all others are asked for, and then
for the most promising columns together. Selection itself is a Cholesky factorisation with pivots: after each pick, the
squared length of what is left of every candidate and its product with what is left of the target are updated at once.

Source: Klein & Morelli, Aircraft System Identification, 2006, section 5.4; QuaSI user manual V1.0.a, section 6.2,
equations (3)-(12). The entry test is the partial F of equation (6); without a constant nothing is centred.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from quasi.errors import ConfigError, DataError
from quasi.expressions import Program, Tree

CHUNK = 4096  # rows at a time: a pool of a thousand columns then takes 32 MB
PREFETCH = 24  # columns whose cross-products are formed in one pass
TRIES = 8  # candidates that may fail the test of doubt before a step gives up
INDEPENDENT = 1e-9  # smallest share of a column that must be left after the selected ones


@dataclass(frozen=True)
class Options:
    """How to select. cap: most forward-backward steps; f_in, f_out: partial F to enter and to stay;
    stop: "PSE" (predicted square error), "R2" (gain below 0.5 %) or "F" (overall F no longer grows)."""

    cap: int = 10
    f_in: float = 4.0
    f_out: float = 4.0
    stop: str = "PSE"

    def __post_init__(self) -> None:
        if self.stop not in ("PSE", "R2", "F"):
            raise ConfigError(f"stop criterion is '{self.stop}', expected 'PSE', 'R2' or 'F'")


@dataclass(frozen=True)
class Selection:
    """chosen: columns of the pool beside the fixed ones, in order of entry; log: one entry per step, plain data;
    reason: why it stopped, a sentence; unusable: columns that cannot be used, {column: why}."""

    chosen: list[int]
    log: list[dict[str, Any]]
    reason: str
    unusable: dict[int, str]


class Pool:
    """Cross-products of columns given by expressions, formed in chunks of rows.

    trees   expressions of all columns; the first `fixed` of them are always in the model
    blocks  one {variable: (n_b,)} per flight; targets (n_b,) per flight
    centred whether means are taken out (a constant belongs to the model)
    """

    def __init__(
        self,
        trees: Sequence[Tree],
        fixed: int,
        blocks: Sequence[dict[str, np.ndarray]],
        targets: Sequence[np.ndarray],
        centred: bool,
    ) -> None:
        self._program = Program(trees)
        self._blocks, self._targets = blocks, targets
        self.size, self.fixed, self.centred = len(trees), fixed, centred
        self.rows = sum(len(z) for z in targets)
        self._cross: dict[int, np.ndarray] = {}
        self._banned: list[int] = []
        self._first_pass(Program(trees[:fixed]))

    def _chunks(self, program: Program) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        out = np.empty((program.size, CHUNK))
        for block, z in zip(self._blocks, self._targets):
            for start in range(0, len(z), CHUNK):
                rows = slice(start, min(start + CHUNK, len(z)))
                n = rows.stop - rows.start
                chunk = {name: block[name][rows] for name in program.names}
                yield program.run(chunk, n, out[:, :n] if n == CHUNK else np.empty((program.size, n))), z[rows]

    def _first_pass(self, program: Program) -> None:
        n = self.rows
        z_mean = sum(float(np.sum(z)) for z in self._targets) / n
        fixed_mean = np.zeros(self.fixed)
        with np.errstate(all="ignore"):
            for x, _ in self._chunks(program):
                fixed_mean += x.sum(axis=1) / n
        self.total = sum(float(np.sum((z - z_mean) ** 2)) for z in self._targets)
        shift = z_mean if self.centred else 0.0
        if not self.centred:
            fixed_mean[:] = 0.0
        mean, spread = np.zeros(self.size), np.zeros(self.size)
        products, sums = np.zeros((self.size, self.fixed + 1)), np.zeros(self.fixed + 1)
        self.target_square = 0.0
        done = 0
        with np.errstate(all="ignore"):
            for x, z in self._chunks(self._program):
                rows = x.shape[1]
                y = np.empty((self.fixed + 1, rows))
                np.subtract(x[: self.fixed], fixed_mean[:, None], out=y[:-1])
                y[-1] = z - shift
                products += x @ y.T
                sums += y.sum(axis=1)
                self.target_square += float(y[-1] @ y[-1])
                # means and spreads of chunks are combined without cancellation (Chan, Golub & LeVeque 1983)
                local = x.mean(axis=1)
                x -= local[:, None]
                spread += np.einsum("ij,ij->i", x, x) + (local - mean) ** 2 * (done * rows / (done + rows))
                mean += (local - mean) * (rows / (done + rows))
                done += rows
            self.mean = mean
            self.square = spread if self.centred else spread + n * mean**2
            # exactly constant columns leave rounding behind
            if self.centred:
                # what rounding of the subtracted means left
                products -= np.outer(mean, sums)
            self.constant = spread <= 1e-24 * n * mean**2
        self.target = products[:, -1]
        for k in range(self.fixed):
            self._cross[k] = products[:, k]

    def ban(self, columns: Sequence[int]) -> None:
        """Take columns out of the pool: nothing of them is ever left."""
        self._banned = list(columns)
        self.square[self._banned], self.target[self._banned] = 1.0, 0.0
        for products in self._cross.values():
            products[self._banned] = 0.0

    def cross(self, column: int, promising: np.ndarray | None = None) -> np.ndarray:
        """Cross-products (size,) of a column with all columns; `promising` (size,) ranks what else to form at once."""
        if column not in self._cross:
            wanted = [column]
            if promising is not None:
                order = np.argsort(-promising)[: PREFETCH + len(self._cross)]
                wanted += [int(k) for k in order if int(k) not in self._cross and k != column][: PREFETCH - 1]
            result, sums = np.zeros((self.size, len(wanted))), np.zeros(len(wanted))
            mean = self.mean[wanted][:, None] if self.centred else 0.0
            with np.errstate(all="ignore"):
                for x, _ in self._chunks(self._program):
                    y = x[wanted] - mean
                    result += x @ y.T
                    sums += y.sum(axis=1)
                if self.centred:
                    result -= np.outer(self.mean, sums)
            result[self._banned] = 0.0
            self._cross.update(zip(wanted, result.T))
        return self._cross[column]


class _State:
    """Model so far: columns, and what is left of every candidate and of the target after them."""

    def __init__(self, pool: Pool) -> None:
        self.pool = pool
        self.columns: list[int] = []
        self.left = pool.square.copy()  # squared length of what is left
        self.with_target = pool.target.copy()
        self.error = pool.target_square
        self.factor = np.zeros((0, pool.size))

    def gain(self) -> np.ndarray:
        """How much the squared error falls by adding each column (size,); 0 where nothing of it is left."""
        usable = self.left > INDEPENDENT * self.pool.square
        usable[self.columns] = False
        return np.where(usable, self.with_target**2 / np.where(usable, self.left, 1.0), 0.0)

    def add(self, column: int, promising: np.ndarray | None = None) -> None:
        pivot = np.sqrt(self.left[column])
        row = (self.pool.cross(column, promising) - self.factor[:, column] @ self.factor) / pivot
        step = self.with_target[column] / pivot
        self.left = self.left - row**2
        self.with_target = self.with_target - row * step
        self.error -= step**2
        self.factor = np.vstack([self.factor, row])
        self.columns.append(column)

    def without(self, column: int) -> "_State":
        state = _State(self.pool)
        for k in self.columns:
            if k != column:
                state.add(k)
        return state

    def partial_f(self) -> np.ndarray:
        """Partial F of each column in the model (p,), the statistic of equation (10)."""
        columns = self.columns
        scale = np.sqrt(self.pool.square[columns])
        gram = np.array([self.pool.cross(k)[columns] for k in columns]) / np.outer(scale, scale)
        inverse = np.linalg.inv(0.5 * (gram + gram.T))
        coefficients = inverse @ (self.pool.target[columns] / scale)
        return coefficients**2 / np.diag(inverse) / (self.error / self.freedom())

    def freedom(self) -> int:
        return self.pool.rows - len(self.columns) - self.pool.centred


def select(
    pool: Pool,
    options: Options,
    describe: Sequence[str],
    total: float | None = None,
    doubt: Callable[[list[int]], float] | None = None,
    level: float = 0.0,
) -> Selection:
    """Forward selection by partial correlation with backward elimination.

    pool      cross-products; its first `fixed` columns start the model and stay
    describe  name of every column, for log and messages
    total     sum of squares of the target about its mean, for R2 and PSE, if not that of the pool's target
    doubt     probability that the last of some columns is nothing beside the others, from a covariance that knows of
              the residuals' memory; a candidate must stay below `level` beside the plain entry test, else the next
              best is tried
    Raises DataError when a fixed regressor is not finite, constant or a combination of the others, or rows are too few.
    """
    total = pool.total if total is None else total
    n = pool.rows
    if n < pool.fixed + pool.centred + 2:
        raise DataError(
            f"{n} training rows are too few for {pool.fixed + pool.centred} fixed regressors; use more flights"
        )
    unusable = _unusable(pool)
    pool.ban(list(unusable))
    state = _State(pool)
    state.left[list(unusable)] = 0.0
    for k in range(pool.fixed):
        if k in unusable or state.left[k] <= INDEPENDENT * pool.square[k]:
            why = unusable.get(k, "is a combination of the other fixed regressors")
            raise DataError(f"the fixed regressor '{describe[k]}' {why}; remove or correct it")
        state.add(k)

    score = _Scores(n, total, pool.centred)
    log = [score.entry(state, 0, describe)]
    first = best = log[0]
    chosen = list(state.columns)
    for number in range(1, options.cap + 1):
        gain = state.gain()
        pick = _best(gain, state, doubt, level)
        if pick is None:
            best_left = describe[int(np.argmax(gain))]
            reason = f"no candidate, {best_left} first, stands out once the residuals' memory is counted"
            return Selection(chosen[pool.fixed :], log, reason, unusable)
        if pick < 0:
            return Selection(chosen[pool.fixed :], log, "no independent candidate is left", unusable)
        freedom = state.freedom() - 1
        left = state.error - gain[pick]
        entry = gain[pick] / (left / freedom) if left > 0 and freedom > 0 else np.inf
        rival = _rival(state, gain, pick, describe)
        if entry <= options.f_in:
            reason = f"the best candidate, {describe[pick]}, has a partial F of {entry:.3g}, not above {options.f_in:g}"
            return Selection(chosen[pool.fixed :], log, reason, unusable)
        correlation = float(np.sign(state.with_target[pick]) * np.sqrt(min(gain[pick] / state.error, 1.0)))
        state.add(pick, gain)
        removed = None
        f = state.partial_f()[pool.fixed :]
        weakest = int(np.argmin(f))
        if f[weakest] < options.f_out:
            removed = state.columns[pool.fixed + weakest]
            if removed == pick:
                reason = f"{describe[pick]} was added and removed again"
                return Selection(chosen[pool.fixed :], log, reason, unusable)
            state = state.without(removed)
        now = score.entry(state, number, describe, pick, removed)
        now |= {"partial F": float(entry), "partial correlation": correlation, "runner up": rival}
        stop = _worse(best, now, options.stop)
        if stop:
            return Selection(chosen[pool.fixed :], log, stop, unusable)
        log.append(now)
        best, chosen = now, list(state.columns)
        if now["PSE"] < 1e-3 * first["PSE"]:
            return Selection(chosen[pool.fixed :], log, "the PSE fell below a thousandth of its first value", unusable)
    return Selection(chosen[pool.fixed :], log, f"the regressor cap of {options.cap} steps is reached", unusable)


def _best(gain: np.ndarray, state: _State, doubt: Callable[[list[int]], float] | None, level: float) -> int | None:
    """Candidate with the largest gain that passes the test of doubt; -1 when none is left, None when none passes."""
    order = np.argsort(-gain)[: TRIES if doubt else 1]
    order = [int(k) for k in order if gain[k] > 0.0]
    if not order:
        return -1
    if doubt is None:
        return order[0]
    return next((k for k in order if doubt([*state.columns, k]) < level), None)


class _Scores:
    def __init__(self, rows: int, total: float, bias: bool) -> None:
        self.rows, self.total, self.bias = rows, total, bias

    def entry(
        self, state: _State, number: int, describe: Sequence[str], pick: int | None = None, removed: int | None = None
    ) -> dict[str, Any]:
        n, p = self.rows, len(state.columns) + self.bias
        r2 = 1.0 - state.error / self.total if self.total > 0 else float("nan")
        overall = (n - p) / (p - 1) * r2 / (1 - r2) if p > 1 and r2 < 1 else float("inf")
        return {
            "step": number,
            "selected": None if pick is None else describe[pick],
            "removed": None if removed is None else describe[removed],
            "PSE": float(state.error / n + self.total / n * p / n),
            "R2": float(r2),
            "F": float(overall),
        }


def _worse(before: dict[str, Any], now: dict[str, Any], criterion: str) -> str | None:
    if criterion == "PSE" and now["PSE"] >= before["PSE"]:
        return f"the next step, adding {now['selected']}, would not lower the PSE"
    if criterion == "R2" and now["R2"] <= 1.005 * before["R2"]:
        return f"the next step, adding {now['selected']}, would raise R2 by less than 0.5 %"
    if criterion == "F" and before["step"] > 0 and now["F"] <= before["F"]:
        return f"the next step, adding {now['selected']}, would not raise the overall F"
    return None


def _unusable(pool: Pool) -> dict[int, str]:
    reasons = {}
    for k in np.flatnonzero(~np.isfinite(pool.square) | ~np.isfinite(pool.target)):
        reasons[int(k)] = "is not finite in some rows (a division by zero, or a power without a real value)"
    if pool.centred:
        for k in np.flatnonzero(pool.constant):
            reasons.setdefault(int(k), "is constant over the training rows")
    for k in np.flatnonzero(pool.square == 0):
        reasons.setdefault(int(k), "is zero over the training rows")
    return reasons


def _rival(state: _State, gain: np.ndarray, pick: int, describe: Sequence[str]) -> dict[str, Any] | None:
    """The second best candidate and its share of the best one's gain: near 1, the two can hardly be told apart."""
    others = gain.copy()
    others[others >= gain[pick]] = 0.0  # the pick itself, and those that a test turned away
    second = int(np.argmax(others))
    if others[second] <= 0.0:
        return None
    return {"expression": describe[second], "share of gain": float(others[second] / gain[pick])}
