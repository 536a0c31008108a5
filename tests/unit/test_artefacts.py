"""Impossible samples are found, and only they."""

import numpy as np
import pytest
from made_motion import body

from quasi.attitude import exponential, multiply
from quasi.importing.artefacts import flyable, spikes


def test_aggressive_true_motion_loses_no_frame():
    truth = body(20.0, seed=7)
    # four times faster than made
    t, x, q = truth.t[::32] / 4.0, truth.position[::32], truth.quaternion[::32]
    assert np.max(np.linalg.norm(truth.rates, axis=1)) * 4 > 15
    assert flyable(t, x, q).all()


def test_a_body_carried_away_unseen_is_believed():
    truth = body(20.0)
    t, x, q = truth.t[::8], truth.position[::8].copy(), truth.quaternion[::8]
    x[1250:] += [2.0, 0.0, 0.0]
    assert flyable(t, x, q).all()


def test_a_swap_that_ends_in_a_drop_out_is_found_alone():
    """Two swapped frames at the start, then eight that are missing: the first second is not thrown away for them."""
    truth = body(20.0)
    t, x, q = truth.t[::8], truth.position[::8].copy(), truth.quaternion[::8].copy()
    bad = [134, 135]
    x[bad] += [0.02, 0.0, -0.02]
    q[bad] = multiply(q[bad], exponential(np.array([0.3, 0.9, 0.6])))
    seen = np.r_[0:136, 144 : len(t)]
    assert np.flatnonzero(~flyable(t[seen], x[seen], q[seen])).tolist() == bad


def test_spikes_are_found_and_steps_are_not():
    rng = np.random.default_rng(2)
    values = 1700 + 60 * np.sin(np.arange(2000) / 9.0) + rng.normal(0, 8, 2000)
    values[1000:] += 700.0  # throttle
    bad = [50, 51, 333, 900, 1500]
    values[[50, 51, 333]] += 11000
    values[900] = 0.0
    values[1500] -= 2000
    values[600:604] = np.nan
    assert np.flatnonzero(spikes(values, 500.0)).tolist() == bad


@pytest.mark.parametrize("seed", range(4))
def test_glitches_of_two_frames_cost_no_good_stretch(seed):
    """A glitch that is just small enough at one of its ends had spoiled the speed there: up to 1.9 s were dropped."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 30.0, 1.0 / 240.0)
    x = np.stack([2.0 * np.sin(0.9 * t), 1.5 * np.cos(1.3 * t), 0.4 * np.sin(2.0 * t) - 1.0], axis=1)
    x += 2e-4 * rng.standard_normal(x.shape)
    bad = np.zeros(len(t), bool)
    for start in rng.choice(np.arange(100, len(t) - 100, 40), 25, replace=False):
        span = slice(start, start + rng.integers(1, 3))
        x[span] += rng.normal(0.0, 0.006, 3)
        bad[span] = True
    kept = flyable(t, x, None)
    assert np.count_nonzero(~kept & ~bad) <= 4 * 25
