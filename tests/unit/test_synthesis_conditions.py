"""Conditions of made flights: each has the stated size, sign and frequency, and a wrong one is refused by name."""

import math

import jsonschema
import numpy as np
import pytest
from plain_blackbox import Plain
from scipy.signal import lfilter, welch
from worlds import draw_world

from quasi.attitude import GRAVITY
from quasi.errors import ConfigError
from quasi.importing.clocks.filter_delays import delay, header_delays
from quasi.importing.readers.blackbox import decode
from quasi.importing.readers.blackbox_header import find_logs, plain_header
from quasi.project import configuration
from quasi_synthesis import conditions, nuisance, physics, sensors
from quasi_synthesis.campaign import logbook, make_flight, read_campaign
from quasi_synthesis.pilot import pilot
from quasi_synthesis.sensors import BIQUAD, LOST, PT1, PT2, REPEATED_PACKET
from quasi_synthesis.vehicle import BASE_HOVER_SPEED

QUIET = {"duration": 18, "nuisance": 0.0, "noise": 0.0, "log rate": 4000, "seed": 3}
STEP = 1.0 / 4000.0


def make(profile="hover", **config):
    campaign = read_campaign({**QUIET, "flights": [{"key": "a", "profile": profile}], **config}, "test")
    return make_flight(campaign, campaign.flights[0])


def columns(made):
    return decode(made.onboard, find_logs(made.onboard, "made")[0]).values


def test_white_noise_has_its_stated_size_at_2_khz_and_what_the_filter_leaves_of_it():
    made = make("rest", **{"accelerometer noise": 0.5, "gyro noise": 4.0, "duration": 20})
    log = columns(made)
    still = slice(400, 13600)  # rotors off
    for k in range(3):
        pairs = log[f"gyroUnfilt[{k}]"][still].reshape(-1, 2).mean(axis=1)
        assert np.std(pairs) == pytest.approx(4.0, rel=0.05)
        # noise bandwidth of two equal lags with corner c: pi c / 4, of the 1000 Hz that 2 kHz sampling has
        left = math.sqrt(math.pi / 4.0 * 100.0 / math.sqrt(math.sqrt(2.0) - 1.0) / 1000.0)
        assert np.std(log[f"accSmooth[{k}]"][still]) / 2048 * GRAVITY == pytest.approx(0.5 * left, rel=0.1)


def test_structural_modes_stand_in_the_spectrum_at_their_frequency_and_size():
    modes = {
        "x": {"frequency": 17.0, "damping": 0.03, "acceleration": 1.0},
        "y": {"frequency": 41.0, "damping": 0.03, "acceleration": 0.5, "rate": 6.0},
        "z": {"frequency": 28.0, "damping": 0.03, "acceleration": 0.8},
    }
    made = make(**{"structural modes": modes, "duration": 40})
    log, truth = columns(made), made.truth
    flying = slice(10 * 4000, 32 * 4000)
    for k, (axis, mode) in enumerate(modes.items()):
        sign = 1.0 if k == 0 else -1.0
        rest = sign * log[f"accSmooth[{k}]"] / 2048 * GRAVITY - truth[f"a{axis}"].to_numpy()
        f, power = welch(rest[flying], 4000.0, nperseg=8000)
        near = (f > 8.0) & (f < 70.0)
        assert f[near][np.argmax(power[near])] == pytest.approx(mode["frequency"], abs=1.5)
        inside = (f > 0.8 * mode["frequency"]) & (f < 1.2 * mode["frequency"])
        assert math.sqrt(np.trapezoid(power[inside], f[inside])) == pytest.approx(mode["acceleration"], rel=0.35)
    f, power = welch(-log["gyroUnfilt[1]"][flying] - np.degrees(truth["q"].to_numpy()[flying]), 4000.0, nperseg=8000)
    assert f[np.argmax(power * (f > 8.0))] == pytest.approx(41.0, abs=1.5)


def lateness(measured, true):
    """How late a signal is, s, to first order: measured - true = -late d(true)/dt."""
    slope = np.gradient(true, STEP)
    return -float((measured - true) @ slope) / float(slope @ slope)


def test_undeclared_delays_are_recovered_and_positive_is_late():
    made = make("aggressive", **{"sensor delay": {"gyro": 0.0007, "accelerometer": 0.0009}})
    log, truth = columns(made), made.truth
    flying = slice(8 * 4000, 17 * 4000)
    gyro = lateness(np.radians(log["gyroUnfilt[0]"])[flying], truth["p"].to_numpy()[flying])
    assert gyro == pytest.approx(0.0007, abs=5e-5)
    gain = STEP / (STEP + math.sqrt(math.sqrt(2.0) - 1.0) / (2.0 * math.pi * 100.0))
    expected = -truth["az"].to_numpy()
    for _ in range(2):
        expected = lfilter([gain], [1.0, gain - 1.0], expected)
    force = lateness((log["accSmooth[2]"] / 2048 * GRAVITY)[flying], expected[flying])
    assert force == pytest.approx(0.0009, abs=1e-4)
    stated = header_delays(plain_header(Plain(made.onboard).header))["accelerometer"]["value"]
    assert stated == pytest.approx(delay("PT2", 100.0))  # the header knows nothing of it


@pytest.mark.parametrize(("kind", "name"), [(PT1, "PT1"), (PT2, "PT2"), (BIQUAD, "biquad")])
def test_low_passes_lag_a_ramp_by_their_group_delay_and_are_3_db_down_at_their_cutoff(kind, name):
    cut = 20.0
    c, memory = sensors.filter_coefficients(kind, cut, STEP), np.zeros(2)
    t = np.arange(8000) * STEP
    sensors.start_filter(2.0, kind, c, memory)
    ramp = np.array([sensors.filter_step(2.0 + x, kind, c, memory) for x in t])
    assert t[-1] - (ramp[-1] - 2.0) == pytest.approx(delay(name, cut), rel=2e-3)
    memory[:] = 0.0
    wave = np.array([sensors.filter_step(x, kind, c, memory) for x in np.sin(2 * math.pi * cut * t)])
    assert 20 * math.log10(np.std(wave[4000:]) * math.sqrt(2.0)) == pytest.approx(-3.01, abs=0.2)


@pytest.mark.parametrize(
    ("firmware", "stages", "accelerometer"),
    [
        ("4.2.11", [("biquad", 150.0), ("PT1", 300.0)], "biquad"),
        ("4.5.1", [("PT2", 120.0), ("biquad", 400.0)], "PT2"),
        ("4.3.2", [("PT1", 200.0)], "PT2"),
        ("4.4.3", [], "PT2"),
    ],
)
def test_the_header_declares_the_filters_as_the_reader_reads_them(firmware, stages, accelerometer):
    gyro = [{"type": kind, "cutoff": cutoff} for kind, cutoff in stages]
    made = make("rest", filters={"firmware": firmware, "gyro": gyro, "accelerometer": 50}, duration=5)
    header = plain_header(Plain(made.onboard).header)
    assert firmware in header["Firmware revision"]
    stated = header_delays(header)
    assert stated["gyro"]["known"] and stated["accelerometer"]["known"]
    assert stated["gyro"]["value"] == pytest.approx(sum(delay(*stage) for stage in stages))
    assert stated["accelerometer"]["value"] == pytest.approx(delay(accelerometer, 50.0))


def test_filters_are_flown_as_they_are_declared():
    stages = [{"type": "PT2", "cutoff": 120.0}, {"type": "biquad", "cutoff": 300.0}]
    made = make("aggressive", filters={"gyro": stages, "accelerometer": 100})
    log, flying = columns(made), slice(8 * 4000, 17 * 4000)
    late = lateness(np.radians(log["gyroADC[0]"])[flying], made.truth["p"].to_numpy()[flying])
    assert late == pytest.approx(delay("PT2", 120.0) + delay("biquad", 300.0), rel=0.08)


def test_packets_are_lost_in_bursts_and_repeated_alone_at_their_shares():
    faults = conditions.packet_faults(200_000, {"lost": 0.08, "repeated": 0.05}, np.random.default_rng(1))
    assert np.mean(faults == LOST) == pytest.approx(0.08, abs=0.005)
    assert np.mean(faults == REPEATED_PACKET) == pytest.approx(0.05 * 0.92, abs=0.005)
    lost = (faults[:, 0] == LOST).astype(int)
    bursts = np.count_nonzero(np.diff(lost) == 1)
    assert lost.sum() / bursts == pytest.approx(conditions.BURST, rel=0.15)
    assert not conditions.packet_faults(1000, {"lost": 0.0, "repeated": 0.0}, np.random.default_rng(1)).any()


def test_the_log_holds_the_last_rotor_speed_where_a_packet_is_lost_and_the_one_before_where_it_is_repeated():
    whole = columns(make("aggressive", **{"log rate": 1000}))["eRPM[0]"][8000:17000]  # one report a row
    for name, share in (("lost", 0.3), ("repeated", 0.3)):
        faulty = columns(make("aggressive", **{"log rate": 1000, "telemetry": {name: share}}))["eRPM[0]"][8000:17000]
        moved = np.flatnonzero(whole[1:] != whole[:-1]) + 1
        changed = faulty != whole
        assert np.mean(changed[moved]) == pytest.approx(share, abs=0.05), name
        before = {"lost": np.roll(faulty, 1), "repeated": np.roll(whole, 1)}[name]
        np.testing.assert_array_equal(faulty[changed][1:], before[changed][1:])


def spread_of(sessions, flights):
    """Each rotor's thrust (sessions, flights, 4) and gyro bias (sessions, flights, 3)."""
    start = nuisance.nominal(120.0, 0.0)
    thrust, bias = np.empty((sessions, flights, 4)), np.empty((sessions, flights, 3))
    for i in range(sessions):
        for j in range(flights):
            session = nuisance.Session(0.02, 0.005, np.random.default_rng([5, i]))
            setup, _ = nuisance.vary(start, 1.0, np.random.default_rng([6, i, j]), session)
            thrust[i, j], bias[i, j] = setup.vehicle.physics.thrust_gain, setup.inertial.gyro_bias
    return thrust, bias


def test_sessions_differ_by_their_spread_and_flights_within_one_by_less():
    thrust, bias = spread_of(150, 3)
    assert np.std(thrust.mean(axis=1)) == pytest.approx(0.02, rel=0.15)
    assert np.sqrt(np.mean(np.var(thrust, axis=1, ddof=1))) == pytest.approx(0.005, rel=0.15)
    usual = nuisance.SPREAD["gyro bias"]
    assert np.std(bias.mean(axis=1)) == pytest.approx(usual, rel=0.15)
    assert np.sqrt(np.mean(np.var(bias, axis=1, ddof=1))) == pytest.approx(0.25 * usual, rel=0.15)


def test_flights_of_one_session_share_its_part_and_the_logbook_names_it():
    flights = [{"key": k, "profile": "rest", "session": s} for k, s in (("a", "may"), ("b", "may"), ("c", "june"))]
    config = {**QUIET, "duration": 5, "nuisance": 1.0, "log rate": 250, "flights": flights}
    campaign = read_campaign({**config, "sessions": {"between": 0.02, "within": 0.0}}, "test")
    gains = [make_flight(campaign, f).metadata["physics"]["thrust_gain"] for f in campaign.flights]
    np.testing.assert_allclose(gains[0], gains[1])
    assert np.abs(np.subtract(gains[0], gains[2])).max() > 0.002
    assert [row["Session"] for row in logbook(campaign)] == ["may", "may", "june"]
    assert "Session" not in logbook(read_campaign({**QUIET, "flights": [{"key": "a"}]}))[0]


def test_the_nose_keeps_its_heading_where_the_heading_is_fixed():
    table = pilot("mixed", 60.0, np.random.default_rng(1), True)
    assert not table[:, [9, 10, 13]].any() and table[:, 11].any()
    assert make("mixed", duration=24, **{"fixed heading": True}).truth["yaw"].abs().max() < math.radians(8.0)
    assert make("mixed", duration=24).truth["yaw"].abs().max() > math.radians(30.0)


def loads(airframe, speed, velocity=(4.0, 0.0, 0.0)):
    setup = conditions.apply_conditions(nuisance.nominal(120.0, 0.0), {"airframe": airframe})
    x = np.zeros(physics.PLANT_STATES)
    x[2], x[3:6], x[6], x[13:17], x[17:21] = -2.0, velocity, 1.0, speed, 9.5 * speed / BASE_HOVER_SPEED
    dx, out = np.empty(physics.PLANT_STATES), np.empty(14)
    physics.derivative(0.0, x, x[13:17].copy(), np.zeros(7), setup.vehicle.physics, dx, out)
    return out.copy()


def test_thrust_follows_its_exponent_and_flapping_its_scale():
    usual, other = ({"thrust exponent": n, "flapping": 1.0} for n in (2.0, 1.9))
    np.testing.assert_allclose(loads(other, BASE_HOVER_SPEED)[6:10], loads(usual, BASE_HOVER_SPEED)[6:10])
    ratio = loads(other, 1.2 * BASE_HOVER_SPEED, (0, 0, 0))[6:10] / loads(other, BASE_HOVER_SPEED, (0, 0, 0))[6:10]
    np.testing.assert_allclose(ratio, 1.2**1.9, rtol=1e-6)
    x_force, pitching = ([loads({"thrust exponent": 2.0, "flapping": f}, BASE_HOVER_SPEED)[k] for f in (0.0, 1.0, 2.0)]
                         for k in (0, 4))  # fmt: skip
    assert x_force[2] - x_force[1] == pytest.approx(x_force[1] - x_force[0], rel=1e-6)
    assert x_force[1] < x_force[0] and pitching[1] > pitching[0]  # against the motion, nose up


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"gyro noise": -1}, ["'gyro noise'", "-1", "deg/s"]),
        ({"gyro nois": 1}, ["'gyro nois'", "'gyro noise'"]),
        ({"sensor delay": {"gyro": 0.1}}, ["'sensor delay'", "'gyro'", "0.005 s"]),
        ({"sensor delay": {"gyr": 0.001}}, ["'gyr'", "'gyro'"]),
        ({"sensor delay": 0.001}, ["'sensor delay'", "0.001", "'accelerometer'"]),
        ({"telemetry": {"lost": 0.9}}, ["'telemetry'", "'lost'", "0.9"]),
        ({"sessions": {"between": 0.02}}, ["'sessions'", "'within'"]),
        ({"airframe": {"thrust exponent": True}}, ["'airframe'", "'thrust exponent'", "True"]),
        ({"structural modes": {"w": {}}}, ["'structural modes'", "'w'", "'z'"]),
        ({"structural modes": {"x": {"frequency": 20}}}, ["'x'", "'damping'"]),
        ({"structural modes": {}}, ["'structural modes'", "'x'"]),
        ({"filters": {"firmware": "5.0"}}, ["'firmware'", "'5.0'", "4.5.1"]),
        ({"filters": {"firmware": "4.2.11", "gyro": [{"type": "PT2", "cutoff": 100}]}}, ["'PT2'", "PT1", "4.2.11"]),
        ({"filters": {"gyro": [{"type": "PT1"}]}}, ["low-pass 1", "'cutoff'"]),
        ({"filters": {"gyro": [{"type": "PT1", "cutoff": 5}]}}, ["'cutoff'", "10", "1000 Hz"]),
        ({"filters": {"gyros": []}}, ["'gyros'", "'gyro'"]),
        ({"filters": {"gyro": "PT1"}}, ["'gyro'", "'PT1'", "two"]),
        ({"filters": 100}, ["'filters'", "100", "'firmware'"]),
        ({"fixed heading": 1}, ["'fixed heading'", "1", "true or false"]),
        ({"flights": [{"key": "a", "session": 3}]}, ["flight 1", "'session'", "3"]),
    ],
)
def test_a_wrong_condition_is_refused_by_name(config, words):
    with pytest.raises(ConfigError) as error:
        read_campaign({"flights": [{"key": "a"}], **config}, "c")
    assert all(word in str(error.value) for word in words), str(error.value)


def test_drawn_worlds_are_valid_campaigns_and_cover_their_ranges():
    rules = configuration.schema("synthesis")
    worlds = [draw_world(seed) for seed in range(80)]
    for world in worlds:
        config = {"flights": [{"key": "a", "session": "s"}], **world}
        assert set(read_campaign(config).conditions) == set(conditions.CONDITION_KEYS)
        jsonschema.validate(config, rules)
    noise = [w["accelerometer noise"] for w in worlds]
    assert min(noise) < 0.07 and max(noise) > 0.7
    assert {w["log rate"] for w in worlds} == {250, 500, 1000, 2000}
    assert {s["type"] for w in worlds for s in w["filters"]["gyro"]} == {"PT1", "PT2", "biquad"}
    assert 0.1 < np.mean([w["fixed heading"] for w in worlds]) < 0.4
    assert draw_world(3) == draw_world(3) != draw_world(4)
