"""Allocation against scipy's bounded least squares, and against what giving up yaw means."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from quasi.simulation.control.allocation import ALLOCATION_SCRATCH_SIZE, allocate_rotors, invert_matrix

LEVER = 0.0544
EFFECT = np.array(
    [
        [-LEVER, -LEVER, LEVER, LEVER],
        [-LEVER, LEVER, -LEVER, LEVER],
        [-0.012, 0.012, 0.012, -0.012],
        [-1.0, -1.0, -1.0, -1.0],
    ]
)
WEIGHTS = np.array([1000.0, 1000.0, 1.0, 100.0])


def allocated(wanted, low, high, weights=WEIGHTS, effect=EFFECT, scale=1.0):
    u = np.clip(np.linalg.solve(effect, wanted), low, high)
    allocate_rotors(
        effect.ravel(), np.asarray(wanted, float), weights, low, high, scale, u, np.zeros(ALLOCATION_SCRATCH_SIZE)
    )
    return u


def cost(u, wanted, weights, effect=EFFECT):
    return np.sum((weights / np.abs(effect).sum(axis=1) * (effect @ u - wanted)) ** 2)


def test_the_inverse_is_that_of_lapack():
    rng = np.random.default_rng(2)
    for _ in range(20):
        a, found = rng.normal(size=(4, 4)), np.empty(16)
        invert_matrix(a.ravel(), found)
        assert np.allclose(found.reshape(4, 4), np.linalg.inv(a), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("weights", [WEIGHTS, np.ones(4), np.array([10.0, 5.0, 3.0, 1.0])])
def test_no_input_within_the_limits_does_better_than_the_allocated_one(weights):
    rng = np.random.default_rng(3)
    low, high = np.full(4, 0.05), np.full(4, 2.0)
    for _ in range(300):
        effect = EFFECT * rng.uniform(0.6, 1.4, (4, 4))
        high[rng.integers(4)] = rng.uniform(0.3, 2.0)
        wanted = effect @ rng.uniform(-1.0, 3.0, 4)
        u = allocated(wanted, low, high, weights, effect)
        assert np.all(u >= low) and np.all(u <= high)
        scale = weights / np.abs(effect).sum(axis=1)
        best = lsq_linear(scale[:, None] * effect, scale * wanted, (low, high), tol=1e-14, max_iter=500)
        least = cost(best.x, wanted, weights, effect)
        assert cost(u, wanted, weights, effect) <= least * (1 + 1e-5) + 1e-6


def test_what_can_be_had_is_given_exactly():
    low, high = np.zeros(4), np.full(4, 2.0)
    u = np.array([0.3, 1.9, 0.7, 1.1])
    assert np.allclose(allocated(EFFECT @ u, low, high), u, atol=1e-6)


def test_yaw_is_given_up_before_thrust_and_thrust_before_roll_and_pitch():
    low, high = np.full(4, 0.1), np.full(4, 1.2)
    # more yaw than there is: roll, pitch and thrust stay, yaw as far as it goes
    wanted = np.array([0.004, -0.003, 0.03, -4.0])
    given = EFFECT @ allocated(wanted, low, high)
    assert np.allclose(given[[0, 1]], wanted[[0, 1]], atol=1e-6) and given[3] == pytest.approx(wanted[3], rel=1e-3)
    most = max(y for y in np.linspace(0, 0.03, 3001) if _fits([wanted[0], wanted[1], y, -4.0], low, high))
    assert given[2] == pytest.approx(most, abs=1e-4)
    # more thrust than there is beside the roll moment: the moment stays
    wanted = np.array([0.06, 0.0, 0.0, -4.6])
    given = EFFECT @ allocated(wanted, low, high)
    assert np.allclose(given[[0, 1]], wanted[[0, 1]], rtol=0.02, atol=1e-4) and given[3] > wanted[3]


def _fits(wanted, low, high):
    u = np.linalg.solve(EFFECT, wanted)
    return np.all(u >= low) and np.all(u <= high)


def test_a_rotor_that_gives_little_is_balanced_by_its_opposite_and_yaw_is_lost():
    low, high = np.full(4, 0.02), np.array([0.6, 3.0, 3.0, 3.0])
    wanted = np.array([0.0, 0.0, 0.0, -4.0])  # hover, one newton a rotor
    u = allocated(wanted, low, high)
    assert np.allclose(u, [0.6, 1.4, 1.4, 0.6], atol=1e-3)
    assert (EFFECT @ u)[2] == pytest.approx(2 * 0.8 * 0.012, rel=1e-2)


def test_inputs_in_millions_are_allocated_as_well():
    low, high = np.full(4, 0.05), np.array([0.6, 2.0, 2.0, 2.0])
    wanted = np.array([0.01, 0.02, 0.01, -4.0])
    assert np.allclose(
        allocated(wanted, low * 4e6, high * 4e6, WEIGHTS, EFFECT / 4e6, 4e6) / 4e6,
        allocated(wanted, low, high),
        rtol=1e-5,
    )


def test_no_number_gives_no_number_and_ends():
    u = np.ones(4)
    allocate_rotors(
        EFFECT.ravel(),
        np.array([np.nan, 0, 0, -4.0]),
        WEIGHTS,
        np.zeros(4),
        np.ones(4),
        1.0,
        u,
        np.zeros(ALLOCATION_SCRATCH_SIZE),
    )
    assert u.shape == (4,)
