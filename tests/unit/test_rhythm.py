"""Peaks of a residual's spectrum: found where they were planted, along the room's axes too; manoeuvres are none."""

import numpy as np
import pytest
from scipy.signal import lfilter

from quasi import attitude
from quasi.gap.levels.forces.spectral_peaks import Signal, amplitudes, search

RATE, SECONDS = 25.0, 40.0
T = np.arange(int(RATE * SECONDS)) / RATE


def coloured(rng, size, channels):
    a = np.exp(-1.0 / RATE)  # gusts remember a second
    x = lfilter([1.0], [1.0, -a], rng.standard_normal((len(T), channels)), axis=0)
    return size * x / x.std(axis=0)


def signal(seed, size=0.0, north=False, term=0.0):
    """Coloured noise of 0.05 N; a pull of `size` at 0.45 Hz of a phase of its own; a term of the model that does it."""
    rng = np.random.default_rng(seed)
    values = coloured(rng, [0.05, 0.05, 0.05, 1e-3, 1e-3, 1e-3], 6)
    turned = attitude.from_euler(0.0 * T, 0.0 * T, 0.05 * T * rng.uniform(0.5, 2.0) + rng.uniform(-3, 3))
    pull = np.sin(2.0 * np.pi * 0.45 * T + rng.uniform(0, 6))
    if north:
        values[:, :3] += attitude.rotate_inverse(turned, size * pull[:, None] * np.eye(3)[0])
    else:
        values[:, 0] += size * pull
    modelled = np.zeros((len(T), 6, 2))
    modelled[:, 0, 0] = coloured(rng, 0.3, 1)[:, 0] + term * pull
    modelled[:, 2, 1] = coloured(rng, 0.3, 1)[:, 0]
    return Signal(values, np.arange(len(T)) == 0, T, turned, modelled)


def test_noise_alone_has_no_rhythm():
    assert search([signal(s) for s in range(3)], [True] * 3, 0.01) == []


def test_a_pull_that_keeps_time_is_found_whatever_its_phase():
    [line] = search([signal(s, 0.05) for s in range(3)], [True] * 3, 0.01)
    assert line.view == "Fx" and line.low < 0.45 < line.high and line.since == "always" and line.p < 1e-6


def test_a_pull_along_the_room_is_found_along_the_room_and_told_by_body_axes():
    signals = [signal(s, 0.06, north=True) for s in range(3)]
    [line] = search(signals, [True] * 3, 0.01)
    assert line.view == "north" and line.middle == pytest.approx(0.45, abs=0.02)
    power = np.mean([amplitudes(line, s) for s in signals], axis=0)
    assert power[:2].sum() == pytest.approx(0.06**2 / 2, rel=0.35)
    np.testing.assert_array_equal(power[3:], 0.0)


def test_what_the_reference_flights_have_too_is_no_change():
    both = [signal(s, 0.06) for s in range(6)]
    assert search(both, [False] * 3 + [True] * 3, 0.01)[0].since == "always"
    new = [signal(s) for s in range(3)] + both[3:]
    assert search(new, [False] * 3 + [True] * 3, 0.01)[0].since == "changed"


def test_one_flight_alone_is_not_common_to_all():
    assert search([signal(0, 0.2), signal(1), signal(2)], [True] * 3, 0.01) == []


def test_a_rhythm_that_the_models_own_terms_have_may_be_their_error():
    assert search([signal(s, 0.06, term=0.3) for s in range(3)], [True] * 3, 0.01) == []
