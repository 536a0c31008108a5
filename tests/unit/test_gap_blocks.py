"""Intervals of shares: they hold the truth as often as they say where errors remember, and are no wider."""

import numpy as np
import pytest
from scipy.signal import lfilter

from quasi.gap.levels.forces.error_reduction import Squares, removed
from quasi.gap.statistics import blocks
from quasi.gap.statistics.scores import Score, fraction

STEP = 0.2  # s between windows


def remembering(rng, n, seconds):
    """(n,) of unit variance that forgets within `seconds`: autoregression of first order."""
    keep = np.exp(-STEP / seconds)
    start = rng.standard_normal()
    return lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(n), zi=[keep * start])[0]


def squared(rng, seconds, left):
    """Squared errors (n,) before, after and at the floor: gusts that no model knows, an effect that comes and goes."""
    n = round(seconds / STEP)
    gusts = remembering(rng, n, 0.7) * np.exp(0.3 * remembering(rng, n, 4.0))
    effect = remembering(rng, n, 1.5) * np.exp(0.5 * remembering(rng, n, 4.0))
    return [(gusts + share * effect) ** 2 for share in (1.0, left, 0.15)]


def truth(left):
    """Share of the removable error that is gone."""
    a, b, c = (part.mean() for part in squared(np.random.default_rng(99), 60_000.0, left))
    return (a - b) / (a - c)


@pytest.mark.parametrize("left", [0.3, 0.7])
@pytest.mark.parametrize("seconds", [30.0, 90.0])
def test_an_interval_of_one_flight_holds_the_truth_nineteen_times_in_twenty(seconds, left):
    rng, share, held, wide, cautious = np.random.default_rng(3), truth(left), [], [], []
    for seed in range(200):
        parts = squared(rng, seconds, left)
        t = np.arange(len(parts[0])) * STEP
        row = blocks.shares(np.zeros(len(t)), t, *(p[:, None] for p in parts), seed=seed)[0]
        if row["value"] is None:
            continue
        held.append(row["low"] <= share <= row["high"])
        wide.append(row["high"] - row["low"])
        # the floor held fixed, as what decides whether a cause matters does
        if seed < 30:
            old, new = (Score(p.reshape(-1, 25).mean(axis=1)[:, None], np.ones(len(p) // 25)) for p in parts[:2])
            row = fraction(old, new, np.array([parts[2].mean()]))["Fx"]
            cautious += [row["high"] - row["low"]] if row["value"] is not None else []
    assert len(held) > 170 and len(cautious) > 20
    assert 0.88 <= np.mean(held) <= 0.99
    assert np.median(wide) < 0.5 * np.median(cautious)


def test_blocks_keep_to_their_flight_and_all_rows_count_alike():
    flight = np.repeat([0, 1], [40, 20])
    t = np.concatenate([np.arange(40), np.arange(20)]) * 0.5
    found = blocks.drawn(flight, t, np.where(flight == 0, 1.0, 3.0)[:, None])
    # two rows a second, 5 s a block: a block of the first flight sums to 10, one of the second to 30
    assert found.sums.shape == (blocks.BLOCK_DRAWS, 1)
    assert set(np.unique(found.sums)) <= {10.0 * (6 - k) + 30.0 * k for k in range(7)}
    assert found.sums.mean() == pytest.approx(40 * 1.0 + 20 * 3.0, rel=0.05)
    # six blocks: t of five degrees of freedom, and a variance that is a sixth too small
    assert found.wider == pytest.approx(2.5706 / 1.95996 * np.sqrt(6 / 5), rel=1e-4)


def test_a_flight_shorter_than_a_block_still_has_an_interval():
    t = np.arange(8) * 0.4
    row = blocks.shares(np.zeros(8), t, np.ones((8, 1)), np.full((8, 1), 0.7), np.full((8, 1), 0.4))[0]
    assert [row[k] for k in ("value", "low", "high")] == pytest.approx([0.5] * 3)


def test_shares_of_forces_take_the_best_floor_that_is_known():
    rng = np.random.default_rng(5)
    parts = [np.column_stack([p] * 6) for p in squared(rng, 90.0, 0.5)]
    old, new, floor = (Squares(np.zeros(len(p)), np.arange(len(p)) * STEP, p) for p in parts)
    whole = removed(old, new, floor, floor.mean())["Fz"]
    was, now, least = (p.mean()[2] for p in (old, new, floor))
    assert whole["value"] == pytest.approx((was - now) / (was - least))
    better = removed(old, new, floor, 0.8 * floor.mean())["Fz"]
    assert better["value"] == pytest.approx((was - now) / (was - 0.8 * least))
    # no floor lies above what is reached: the share is all of it
    best = removed(old, floor, new, new.mean())["Fz"]
    assert best["value"] == 1.0 and best["high"] == 1.0 and best["low"] > 0.9
    yardstick = removed(old, new, old, old.mean(), floor)["Fz"]
    assert yardstick["value"] == pytest.approx((was - now) / (was - least))
