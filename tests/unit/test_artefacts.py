"""Impossible samples are found, and only they."""

import numpy as np
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
