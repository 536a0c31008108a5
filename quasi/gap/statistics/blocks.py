"""How sure a share of squared error is: overlapping blocks of the flights, drawn anew, alike for all that is compared.

Errors of a flight remember for seconds, so whole blocks are drawn, and the same ones of every model: what none of them
knows (gusts, noise) is in all of them alike and says nothing about their difference. A floor that is held fixed while
the errors above it are drawn puts just that noise into the removable error, and makes the interval ten times as wide.
Blocks begin at every second and close around the end of their flight, so that all rows count alike. A few blocks vary
less than flights do, and their quantiles lie too close: the interval is wider about its value as Student's t with as
many blocks asks for.
Sources: Kuensch, Annals of Statistics 17, 1989 (moving blocks); Politis & Romano, A circular block-resampling
procedure, 1992; Hesterberg, The American Statistician 69, 2015 (quantiles of small samples).
"""

from typing import NamedTuple

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

CELL = 1.0  # s between the begins of blocks
BLOCK = 5.0  # s of a block, longer than the memory of gusts
BLOCK_DRAWS = 400
LEVEL = 0.95
HOLDS = 0.9  # share of the squared error: where the floor holds more, no share is reported
LEAST_REMOVABLE = 0.25  # of the removable error: a draw that has less of it counts as having that much


class Drawn(NamedTuple):
    """Sums over resampled flights (BLOCK_DRAWS, ...), and how much wider than theirs an interval is."""

    sums: np.ndarray
    wider: float


def drawn(flight: np.ndarray, t: np.ndarray, values: np.ndarray, seed: int = 0) -> Drawn:
    """Sums of values (n, ...) over resampled flights. flight (n,) which one a row belongs to; t (n,) s, its time."""
    flat = values.reshape(len(values), -1)
    codes = np.unique(flight, return_inverse=True)[1]
    blocks = []
    for code in range(codes.max(initial=-1) + 1):
        rows = codes == code
        cell = np.unique(((t[rows] - t[rows].min()) / CELL).astype(int), return_inverse=True)[1]
        sums = np.stack([np.bincount(cell, weights=column) for column in flat[rows].T], axis=1)
        long = min(round(BLOCK / CELL), len(sums))
        around = np.concatenate([np.zeros((1, flat.shape[1])), np.cumsum(np.vstack([sums, sums[: long - 1]]), axis=0)])
        # a flight shorter than a block is one
        blocks.append((around[long:] - around[:-long]) * (BLOCK / CELL) / long)
    whole = np.vstack(blocks)
    count = max(round(len(whole) * CELL / BLOCK), 2)
    picks = np.random.default_rng(seed).integers(0, len(whole), (BLOCK_DRAWS, count))
    high = 0.5 + 0.5 * LEVEL
    wider = student.ppf(high, count - 1) / norm.ppf(high) * np.sqrt(count / (count - 1))
    return Drawn(whole[picks].sum(axis=1).reshape(BLOCK_DRAWS, *values.shape[1:]), float(wider))


def interval(value: float, draws: np.ndarray, wider: float, most: float = 1.0) -> tuple[float, float]:
    """Its ends at LEVEL; the upper one is not above `most`."""
    low, high = value + wider * (np.quantile(draws, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL]) - value)
    return min(float(low), value), min(max(float(high), value), most)


def shares(
    flight: np.ndarray, t: np.ndarray, old: np.ndarray, new: np.ndarray, floor: np.ndarray,
    reached: np.ndarray | None = None, seed: int = 0,
) -> list[dict[str, float | None]]:  # fmt: skip
    """Share of the removable squared error that is gone, per column, with its interval.

    flight (n,), t (n,) as for `drawn`; old, new, floor  (n, Q) squared errors of the same rows; reached (n, Q) those of
    a model that the floor cannot lie above, None takes the new ones
    "removable": share of the old squared error above the floor; "value" is None where that is less than a tenth
    """
    best = new if reached is None else reached
    found = drawn(flight, t, np.stack([old, new, floor, best], axis=1), seed)
    rows = []
    for k in range(old.shape[1]):
        was, now, *low = (part[:, k].sum() for part in (old, new, floor, best))
        least = min(low)
        row = {"removable": float(1.0 - least / max(was, 1e-300)), "value": None, "low": None, "high": None}
        if least < HOLDS * was:
            a, b, c, d = found.sums[:, :, k].T
            removable = np.maximum(a - np.minimum(c, d), LEAST_REMOVABLE * row["removable"] * np.maximum(a, 1e-3 * was))
            value = float((was - now) / (was - least))
            row["value"] = value
            row["low"], row["high"] = interval(value, (a - b) / removable, found.wider, max(value, 1.0))
        rows.append(row)
    return rows
