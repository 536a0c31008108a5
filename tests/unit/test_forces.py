"""Zero-phase filters, forces, moments and induced velocity against closed forms and printed numbers."""

import numpy as np
import pytest

from quasi import attitude
from quasi.errors import DataError
from quasi.filtering import forces

RATE, CUTOFF = 500.0, 40.0
T = np.arange(4000) / RATE
INSIDE = slice(200, -200)


@pytest.mark.parametrize("frequency", [0.5, 3.0, 10.0, 20.0])
def test_pass_band_keeps_amplitude_and_phase(frequency):
    signal = np.sin(2 * np.pi * frequency * T + 0.3)
    np.testing.assert_allclose(forces.low_pass(signal, CUTOFF, RATE)[INSIDE], signal[INSIDE], atol=1.5e-3)
    slope = 2 * np.pi * frequency * np.cos(2 * np.pi * frequency * T + 0.3)
    found = forces.derivative(signal, CUTOFF, RATE)
    np.testing.assert_allclose(found[INSIDE], slope[INSIDE], atol=1.5e-3 * 2 * np.pi * frequency)


def test_cutoff_halves_and_stop_band_is_silent():
    def gain(frequency):
        return np.ptp(forces.low_pass(np.sin(2 * np.pi * frequency * T), CUTOFF, RATE)[INSIDE]) / 2

    assert gain(CUTOFF) == pytest.approx(0.5, abs=0.02)
    for frequency in (65.0, 90.0, 150.0, 240.0):
        assert gain(frequency) < 1e-3


@pytest.mark.parametrize("rate", [100.0, 250.0, 500.0, 1000.0])
def test_constants_and_slopes_are_kept_to_the_ends(rate):
    t = np.arange(600) / rate
    line = 3.0 - 2.0 * t
    cutoff = 0.15 * rate
    np.testing.assert_allclose(forces.low_pass(line, cutoff, rate), line, atol=1e-9)
    np.testing.assert_allclose(forces.derivative(line, cutoff, rate), -2.0, atol=1e-8)


def test_derivative_is_that_of_the_low_passed_signal():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=4000)
    smooth, slope = forces.low_pass(noise, CUTOFF, RATE), forces.derivative(noise, CUTOFF, RATE)
    # an independent derivative: by the Fourier transform of a windowed stretch
    window = np.hanning(len(T))
    spectrum = np.fft.rfft(smooth * window)
    frequency = np.fft.rfftfreq(len(T), 1 / RATE)
    expected = np.fft.irfft(2j * np.pi * frequency * spectrum, len(T))
    product = slope * window + smooth * np.gradient(window, 1 / RATE, edge_order=2)
    assert np.sqrt(np.mean((product - expected)[INSIDE] ** 2)) < 2e-3 * np.sqrt(np.mean(expected[INSIDE] ** 2))


def test_filtering_commutes_with_sums_so_regressions_compare_equal_bands():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 4000))
    both = forces.low_pass(np.stack([a, b], axis=1), CUTOFF, RATE)
    np.testing.assert_allclose(
        2 * both[:, 0] - 3 * both[:, 1], forces.low_pass(2 * a - 3 * b, CUTOFF, RATE), atol=1e-12
    )


def test_time_reversal_changes_nothing_so_there_is_no_phase():
    rng = np.random.default_rng(2)
    signal = rng.normal(size=3000)
    np.testing.assert_allclose(
        forces.low_pass(signal[::-1], CUTOFF, RATE)[::-1], forces.low_pass(signal, CUTOFF, RATE), atol=1e-12
    )


def test_short_flight_is_refused():
    with pytest.raises(DataError, match="shorter than the low-pass"):
        forces.low_pass(np.zeros(10), CUTOFF, RATE)


def test_hover_force_is_minus_weight_and_net_force_zero():
    q = attitude.from_euler(np.array([0.3]), np.array([-0.2]), np.array([1.0]))
    specific = attitude.rotate_inverse(q, np.array([0.0, 0.0, -attitude.GRAVITY]))
    level = np.array([[0.0, 0.0, -attitude.GRAVITY]])
    np.testing.assert_allclose(forces.forces(level, 0.43), [[0, 0, -0.43 * 9.81]])
    np.testing.assert_allclose(forces.net_forces(specific, q, 0.43), 0.0, atol=1e-12)


def test_moment_equals_rate_of_change_of_angular_momentum():
    inertia = np.array([[8e-4, 2e-5, -3e-5], [2e-5, 1.1e-3, 1e-5], [-3e-5, 1e-5, 1.7e-3]])
    dt = 1e-4
    t = np.arange(0, 0.2, dt)
    rates = np.stack([3 * np.sin(9 * t), 2 * np.cos(7 * t), 4 * np.sin(5 * t + 1)], axis=1)
    rates_dot = np.stack([27 * np.cos(9 * t), -14 * np.sin(7 * t), 20 * np.cos(5 * t + 1)], axis=1)
    q = np.empty((len(t), 4))
    q[0] = [1, 0, 0, 0]
    for k in range(1, len(t)):
        q[k] = attitude.multiply(q[k - 1], attitude.exponential(0.5 * (rates[k - 1] + rates[k]) * dt))
    momentum = attitude.rotate(q, rates @ inertia)  # in the earth frame
    torque = attitude.rotate_inverse(q, np.gradient(momentum, dt, axis=0))
    np.testing.assert_allclose(forces.moments(rates, rates_dot, inertia)[5:-5], torque[5:-5], atol=3e-6)


def test_hover_induced_velocity_is_the_printed_one():
    # 0.433 kg on four rotors of 38.1 mm radius: about 9.75 m/s
    still = forces.induced_velocity(np.zeros((1, 3)), 0.433, 0.0381)
    assert still[0] == pytest.approx(9.75, abs=0.03)


def test_induced_velocity_solves_momentum_theory_and_is_empty_in_descent():
    rng = np.random.default_rng(3)
    velocity = rng.uniform([-15, -15, -10], [15, 15, 2], (500, 3))
    v = forces.induced_velocity(velocity, 0.433, 0.0381)
    area = 4 * np.pi * 0.0381**2
    through = np.sqrt(velocity[:, 0] ** 2 + velocity[:, 1] ** 2 + (v - velocity[:, 2]) ** 2)
    np.testing.assert_allclose(2 * 1.225 * area * v * through, 0.433 * 9.81, rtol=1e-9)
    axial = forces.induced_velocity(np.array([[0.0, 0.0, -4.0]]), 0.433, 0.0381)[0]
    hover = np.sqrt(0.433 * 9.81 / (2 * 1.225 * area))
    assert axial == pytest.approx(
        -2.0 + np.sqrt(4.0 + hover**2)
    )  # Leishman, equation 2.62: vc/2 off, root of vc2/4 + vh2
    assert np.isnan(forces.induced_velocity(np.array([[0.0, 0.0, 6.0]]), 0.433, 0.0381))[0]


def test_spread_reaches_both_ways():
    mask = np.zeros(50, bool)
    mask[[0, 30]] = True
    np.testing.assert_array_equal(np.flatnonzero(forces.spread(mask, 2)), [0, 1, 2, 28, 29, 30, 31, 32])
