"""Rotor lines that folding moves to nearly 0 Hz: where they are, and how much noise they are worth to the filter."""

import numpy as np
import pytest
from rigid_body import measure, move
from test_ekf import inputs_of

from quasi.filtering import harmonics, noise

LOG, GRID = 1000.0, 500.0  # Hz


@pytest.mark.parametrize("frequency", [333.0, 331.5, 320.0, 250.0, 500.0])
def test_share_is_the_power_that_a_low_pass_leaves_of_the_sampled_line(frequency):
    t = np.arange(20000) / LOG
    spectrum = np.abs(np.fft.rfft(np.cos(2 * np.pi * 3 * frequency * t + 0.3) * np.hanning(len(t)))) ** 2
    f = np.fft.rfftfreq(len(t), 1 / LOG)
    expected = np.sum(spectrum / (1.0 + (f / harmonics.VELOCITY_BAND) ** 4)) / np.sum(spectrum)
    others = [1.0 / (1.0 + (harmonics.fold(k * frequency, LOG) / harmonics.VELOCITY_BAND) ** 4) for k in (1, 2)]
    share = harmonics.near_zero(np.full((5, 4), 2 * np.pi * frequency), LOG, LOG)
    assert share == pytest.approx(max(expected, *others), rel=0.05, abs=1e-6)


def test_resting_rotors_and_lines_that_the_import_has_removed_count_for_nothing():
    assert not harmonics.near_zero(np.zeros((3, 4)), LOG, GRID).any()
    # 500 Hz stands at 500 Hz in the log; only a log as slow as the grid shows it at 0 Hz
    first = np.full((3, 1), 2 * np.pi * 500.0 / 3.0 * 3.0)
    alone = [harmonics.on_grid(first[0] / (2 * np.pi), rate, GRID) for rate in (LOG, GRID)]
    assert [bool(there.all()) for _, there in alone] == [False, True]
    assert harmonics.near_zero(first, GRID, GRID) == pytest.approx(1.0)


@pytest.mark.parametrize("planted", [1.0, 4.0])
def test_noise_during_folding_is_found_apart_from_the_rest(planted):
    motion = move(seconds=30.0, seed=6, loops=False)
    frame = measure(motion, accel_noise=0.0)[0]
    folded = (np.sin(2 * np.pi * motion.t / 6.0) > 0.0).astype(float)
    size = 0.3 * planted**folded
    frame[["ax", "ay", "az"]] += size[:, None] * np.random.default_rng(2).standard_normal((len(frame), 3))
    inputs = inputs_of(motion, frame, noise=np.tile([0.02] * 3 + [0.3] * 3, (len(frame), 1)))
    flying = motion.t > 4.0
    found = noise.estimate_levels(inputs, flying, np.array([0.1, 0.1]), folded)
    assert found[1] == pytest.approx(1.0, rel=0.25)
    assert found[noise.FOLDED] == pytest.approx(planted, rel=0.25)


def test_without_folding_there_is_no_factor_for_it():
    motion = move(seconds=8.0, rest=0.5, seed=3, loops=False)
    inputs = inputs_of(motion, measure(motion, rest=0.5)[0])
    found = noise.estimate_levels(inputs, motion.t > 1.0, np.array([0.1, 0.1]), np.zeros(len(motion.t)))
    assert found[noise.FOLDED] == 1.0 and len(found) == noise.FACTORS
