"""A swinging load against textbook pendulums, and told from raw physics where a mass is not."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from quasi.attitude import GRAVITY
from quasi.gap.catalogue import catalogue
from quasi.gap.entries import parameters_of
from quasi.gap.flights.pendulum import swing

RATE = 100.0
T = np.arange(0.0, 12.0, 1.0 / RATE)
HIGH = np.full(len(T), 5.0)
WHOLE = np.arange(len(T)) == 0


def pushed(t):
    """A smooth push northwards of 0.6 s, then rest."""
    return np.where(t < 0.6, 2.5 * np.sin(np.pi * t / 0.6), 0.0)


def driven(east=0.0):
    return np.column_stack([pushed(T), east * np.ones(len(T)), np.zeros(len(T))])


def test_a_plane_pendulum_follows_its_own_equation():
    """theta'' = -(g sin theta + a cos theta)/L, solved by another method; tension g cos - a sin + L theta'^2."""
    length = 0.4

    def slope(t, y):
        return [y[1], -(GRAVITY * np.sin(y[0]) + pushed(t) * np.cos(y[0])) / length]

    solved = solve_ivp(slope, (0, T[-1]), [0.0, 0.0], t_eval=T, rtol=1e-9, atol=1e-10, max_step=0.01).y
    tension = GRAVITY * np.cos(solved[0]) - pushed(T) * np.sin(solved[0]) + length * solved[1] ** 2
    pull = swing(driven(), HIGH, T, WHOLE, length, 0.0)
    early = T < 3.0
    expected = (tension * np.sin(solved[0]))[early]
    assert np.max(np.abs(pull[early, 0] - expected)) < 0.12 * np.max(np.abs(expected))
    assert np.max(np.abs(pull[:, 1])) < 1e-12
    # frequency: zero crossings of the free swing
    crossings = T[1:][np.diff(np.sign(pull[:, 0])) > 0]
    crossed = T[1:][np.diff(np.sign(solved[0])) > 0]
    assert np.mean(np.diff(crossings)) == pytest.approx(np.mean(np.diff(crossed)), rel=5e-3)


def test_a_free_swing_fades_as_its_damping_says():
    fading, length = 0.1, 0.5
    pull = swing(driven(), HIGH, T, WHOLE, length, fading)[:, 0]
    peaks = np.abs(pull[1:-1][(np.diff(np.abs(pull))[:-1] > 0) & (np.diff(np.abs(pull))[1:] <= 0)])[1:5]
    half_swing = np.pi * fading / np.sqrt(1.0 - fading**2)
    np.testing.assert_allclose(np.log(peaks[:-1] / peaks[1:]), half_swing, rtol=0.1)


def test_under_a_steady_acceleration_the_string_comes_to_hang_along_the_apparent_vertical():
    steady = np.tile([3.0, 0.0, -1.0], (len(T), 1))
    pull = swing(steady, HIGH, T, WHOLE, 0.3, 0.3)
    np.testing.assert_allclose(pull[-1], [-3.0, 0.0, GRAVITY + 1.0], rtol=1e-3, atol=1e-3)


def test_a_load_on_the_floor_pulls_nothing_and_hangs_still_after_a_gap():
    low = np.where(T < 5.0, 5.0, 0.2)
    pull = swing(driven(), low, T, WHOLE, 0.4, 0.1)
    assert not pull[T >= 5.0].any()
    gap = WHOLE.copy()
    gap[300] = True
    np.testing.assert_allclose(swing(driven(), HIGH, T, gap, 0.4, 0.0)[300], [0.0, 0.0, GRAVITY], atol=1e-12)


def test_the_extension_holds_one_load_of_the_total_mass_and_the_middle_length():
    effect = catalogue()["payload_swing"]
    masses = dict.fromkeys(effect.parameters, 0.0)
    load = effect.extension({**masses, "mass at 0.32 m": 0.01, "mass at 0.5 m": 0.01}, None, None).states
    assert load["swinging load"]["mass"] == pytest.approx(0.02)
    assert load["swinging load"]["length"] == pytest.approx(np.sqrt(0.32 * 0.5))
    assert not effect.extension(masses, None, None).states


def test_of_a_load_its_whole_mass_and_its_length_are_told():
    effect = catalogue()["payload_swing"]
    value = {"mass at 0.32 m": 0.01, "mass at 0.5 m": 0.01}
    told = parameters_of(effect, value, dict.fromkeys(value, 0.003), None)
    assert told["mass"] == {"value": pytest.approx(0.02), "std": pytest.approx(0.003 * np.sqrt(2.0)), "unit": "kg"}
    assert told["length"]["value"] == pytest.approx(0.4) and told["length"]["unit"] == "m"
    assert list(told) == ["mass", "length"]
