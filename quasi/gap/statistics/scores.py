"""Mean squared errors of flights by blocks of some seconds, and how surely one set of them is below another."""

from typing import NamedTuple

import numpy as np

from quasi.gap.statistics.blocks import HOLDS, LEVEL
from quasi.model.model import AXES

SCORE_DRAWS = 200  # of blocks, for the ends of an interval of LEVEL


class Score(NamedTuple):
    """Mean squared error in a block; blocks of all flights one after another. values (B, C), weight (B,) samples."""

    values: np.ndarray
    weight: np.ndarray

    def mean(self) -> np.ndarray:
        """(C,) over all blocks."""
        return self.weight @ self.values / self.weight.sum()


def joined(first: Score, last: Score) -> Score:
    """Blocks of both."""
    return Score(*(np.concatenate(parts) for parts in zip(first, last)))


def within(score: Score, blocks: np.ndarray) -> Score:
    """A score of some of its blocks (B,) bool."""
    return Score(score.values[blocks], score.weight[blocks])


def fraction(old: Score, new: Score, floor: np.ndarray | None = None) -> dict[str, dict[str, float | None]]:
    """Share of the removable squared error that is gone, per axis, with its interval over resampled blocks.

    floor (6,) mean squared noise; the share is None where the floor holds 90 % of the old error. The floor is not drawn
    with the errors, which makes the interval cautious: what decides whether a cause matters asks for it. A reported
    gain has the interval of `removed`.
    """
    rng = np.random.default_rng(0)
    noise = np.zeros(old.values.shape[1]) if floor is None else floor
    draws = []
    for _ in range(SCORE_DRAWS):
        pick = rng.integers(0, len(old.weight), len(old.weight))
        w = old.weight[pick]
        draws.append([w @ s.values[pick] / w.sum() for s in (old, new)])
    result = {}
    for k, axis in enumerate(AXES[: len(noise)]):
        first, last = old.mean()[k], new.mean()[k]
        if noise[k] >= HOLDS * first:
            result[axis] = {"value": None, "low": None, "high": None}
            continue
        shares = [(d[0][k] - d[1][k]) / max(d[0][k] - noise[k], 0.1 * d[0][k]) for d in draws]
        low, high = np.quantile(shares, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
        result[axis] = {"value": float((first - last) / (first - noise[k])), "low": float(low), "high": float(high)}
    return result


def surely(old: Score, new: Score, removable: np.ndarray) -> np.ndarray:
    """Lower ends (6,) of the intervals of the squared error that is gone, as shares of what is removable.

    removable (6,) mean square, held: blocks in which there is little to remove say little, whatever their share is
    """
    rng = np.random.default_rng(0)
    picks = rng.integers(0, len(old.weight), (SCORE_DRAWS, len(old.weight)))
    weight = old.weight[picks]
    gone = np.einsum("db,dbc->dc", weight, (old.values - new.values)[picks]) / weight.sum(axis=1)[:, None]
    return np.quantile(gone, 0.5 - 0.5 * LEVEL, axis=0) / removable
