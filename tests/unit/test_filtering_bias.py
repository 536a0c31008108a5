"""Rest, take-off and ground, on made signals with known times."""

import numpy as np
import pytest

from quasi.filtering import bias

DT = 0.002
STEP = np.zeros(6)


def still(seconds, seed=0, gyro=(0.02, -0.03, 0.01), noise=0.02):
    rng = np.random.default_rng(seed)
    n = round(seconds / DT)
    w = np.array(gyro) + rng.normal(0, noise, (n, 3))
    a = np.array([0.1, -0.15, -9.6]) + rng.normal(0, 0.1, (n, 3))
    return w, a


def shaken(seconds, seed=1):
    rng = np.random.default_rng(seed)
    n = round(seconds / DT)
    t = np.arange(n) * DT
    w = np.stack([2 * np.sin(9 * t), np.cos(7 * t), np.sin(3 * t)], axis=1) + rng.normal(0, 0.1, (n, 3))
    a = np.stack([np.sin(t), np.cos(t), -9.81 - 3 * np.sin(5 * t)], axis=1) + rng.normal(0, 1.0, (n, 3))
    return w, a


def joined(*parts):
    return tuple(np.vstack([p[i] for p in parts]) for i in range(2))


def test_take_off_is_when_the_last_working_rotor_has_reached_the_threshold():
    speeds = np.full((3000, 4), 150.0)
    for rotor, at in enumerate((1000, 1400, 1200, 1100)):
        speeds[at:, rotor] = 900.0
    speeds[500:503, 3] = 900.0  # a spike of telemetry is no take-off
    assert bias.take_off_sample(speeds, 300.0, 10) == (1400, [])
    speeds[:, 1] = 150.0  # broken telemetry of one rotor must not stop the search
    assert bias.take_off_sample(speeds, 300.0, 10) == (1200, [2])
    assert bias.take_off_sample(np.zeros((100, 4)), 300.0, 10) == (None, [1, 2, 3, 4])


def test_rest_is_the_longest_quiet_stretch_before_take_off():
    w, a = joined(still(0.5), shaken(1.0), still(3.0, seed=2), shaken(2.0, seed=3), still(9.0, seed=4))
    last = round(6.5 / DT)
    rest = bias.find_rest(w, a, np.zeros(len(w), bool), STEP, last, DT)
    assert rest.first * DT == pytest.approx(1.5, abs=0.11)
    assert rest.last * DT == pytest.approx(1.5 + 0.9 * 3.0, abs=0.25)
    np.testing.assert_allclose(rest.gyro, [0.02, -0.03, 0.01], atol=4 * rest.gyro_std.max())
    assert rest.gyro_std.mean() == pytest.approx(0.02 / np.sqrt(1350), rel=0.4)
    np.testing.assert_allclose(rest.noise, np.repeat([0.02, 0.1], 3), rtol=0.5)


def test_short_rest_and_slow_carrying_are_refused():
    w, a = joined(still(0.8), shaken(3.0))
    assert bias.find_rest(w, a, np.zeros(len(w), bool), STEP, 400, DT) is None
    turn = np.linspace(0, 1.2, 2000)
    tilted = 9.81 * np.stack([np.sin(turn), 0 * turn, -np.cos(turn)], axis=1)
    carried = (np.full((2000, 3), 0.1) + np.linspace(0, 0.4, 2000)[:, None], tilted)
    assert bias.find_rest(*carried, np.zeros(2000, bool), STEP, 2000, DT) is None


def test_coarse_steps_widen_the_error_of_the_rest():
    w, a = still(4.0, noise=0.002)
    step = np.radians(1.0)
    coarse = np.round(w / step) * step
    rest = bias.find_rest(coarse, a, np.zeros(len(w), bool), np.repeat([step, 0.0], 3), len(w), DT)
    assert rest.gyro_std.min() > 0.9 * step / np.sqrt(12)
    assert np.abs(rest.gyro - [0.02, -0.03, 0.01]).max() < 2 * rest.gyro_std.min()


def test_free_fall_is_flight_and_a_landing_is_ground():
    flight, fall = shaken(4.0), (shaken(0.8)[0] * 0.05, np.random.default_rng(5).normal(0, 0.2, (400, 3)))
    w, a = joined(still(2.0), flight, fall, flight, still(2.0))
    speeds = np.full((len(w), 4), 1100.0)
    speeds[:1000] = speeds[3000:3400] = speeds[-1000:] = 150.0
    ground = bias.find_ground(w, a, speeds, None, DT)
    assert ground[:950].all() and not ground[1050:-1150].any() and ground[-900:].all()


def test_spool_up_on_the_spot_is_ground():
    w, a = joined(still(3.0), shaken(3.0))
    speeds = np.full((len(w), 4), 1100.0)
    speeds[:1000] = 150.0
    speeds[1000:1500] = np.linspace(150, 1000, 500)[:, None]
    position = np.zeros((len(w), 3))
    position[1500:, 2] = -np.linspace(0, 1, len(w) - 1500)
    ground = bias.find_ground(w, a, speeds, position, DT)
    assert ground[:1500].all() and not ground[1600:].any()


def test_wrong_idle_speed_is_said_and_the_flight_itself_used():
    w, a = joined(still(3.0), shaken(5.0))
    speeds = np.full((len(w), 4), 1100.0)
    speeds[:1500] = 150.0
    found = bias.phases(w, a, np.zeros(len(w), bool), STEP, speeds, None, 900.0, DT)
    assert found.take_off == 1500 and "check 'idle RPM'" in found.notes[0]
    assert found.rest is not None
    none = bias.phases(w, a, np.zeros(len(w), bool), STEP, None, None, None, DT)
    assert "no rotor speeds" in none.notes[0] and none.rest is not None
