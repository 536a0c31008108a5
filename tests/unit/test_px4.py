"""PX4 logs: what changed over versions, poses from outside, filters on board, and real files."""

import numpy as np
import pytest
from log_formats import ULOG_FORMATS, made_flight, ulog_of
from recordings import SHARED

from quasi.importing.clocks.filter_delays import delay
from quasi.importing.flight import import_flight
from quasi.importing.onboard_log import read_onboard

pytest.importorskip("pyulog")
REAL = SHARED.parent / "ulog"
needs_real = pytest.mark.skipif(not REAL.is_dir(), reason=f"real recordings are not at {REAL}")
POSES = {
    "older": "uint64_t timestamp;float x;float y;float z;float[4] q",
    "newer": "uint64_t timestamp;uint64_t timestamp_sample;float[3] position;float[4] q",
}


@pytest.fixture(scope="module")
def flight():
    return made_flight(seconds=4.5)


def read(path, **quadrotor):
    return read_onboard({"onboard": str(path), "flight controller": "px4", "log number": None}, quadrotor)


def written(folder, flight, formats, add, names=ULOG_FORMATS, parameters=None):
    """A made log with more topics; add(log, k, t in us) writes their messages."""
    log = ulog_of(flight, parameters, names, {n: f for n, f in formats.items() if n not in ULOG_FORMATS})
    for name in formats:
        if name in ULOG_FORMATS:
            log.subscribe(name)
    for k, t in enumerate(np.round(1e6 * flight.t).astype(int) + 5_000_000):
        add(log, k, int(t))
    path = folder / "flight.ulg"
    path.write_bytes(log.bytes())
    return path


def test_a_position_with_a_damaged_flag_is_not_known(tmp_path, flight):
    topic = "vehicle_local_position"

    def add(log, k, t):
        log.data(topic, "QQ6f4B", t + 900, t, *flight.p[k], *flight.v[k], 38 if k == 500 else 1, 1, 1, 1)

    path = written(tmp_path, flight, {topic: ULOG_FORMATS[topic]}, add, [n for n in ULOG_FORMATS if n != topic])
    position = read(path).series["onboard position, velocity (vehicle_local_position)"].matrix(("x", "y", "z"))
    assert list(np.flatnonzero(np.isnan(position).any(axis=1))) == [500]


def test_the_delay_of_filters_on_board_is_no_lag_of_other_sources(tmp_path, flight):
    topic, hertz = "vehicle_angular_velocity", 30.0
    late = delay("biquad", hertz)

    def add(log, k, t):
        rates = [np.interp(flight.t[k] - late, flight.t, r) for r in flight.rates.T]
        log.data(topic, "QQ3f", t + 100, t, *rates)

    fields = {topic: "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz"}
    path = written(tmp_path, flight, fields, add, parameters={"IMU_GYRO_CUTOFF": hertz})
    log = read(path, **{"log topics": {"body rates": topic}})
    attitude = log.series["onboard attitude (vehicle_attitude)"]
    at = np.rint(attitude.t * 250).astype(int)
    assert np.abs(attitude.t - flight.t[at]).max() < 2e-4


def test_four_motors_of_eight_are_no_news(tmp_path, flight):
    log = read(written(tmp_path, flight, {}, lambda *_: None))
    assert "command4" in log.series["onboard commands (actuator_motors)"].values
    assert not [note for note in log.notes if "command5" in note]


@pytest.mark.parametrize("version", POSES)
@pytest.mark.parametrize("topic", ["vehicle_mocap_odometry", "vehicle_visual_odometry"])
def test_a_pose_from_outside_is_the_capture(tmp_path, flight, version, topic):
    def add(log, k, t):
        if k % 2 == 0:
            stamps = (t,) if version == "older" else (t + 4000, t)
            log.data(topic, "Q" * len(stamps) + "7f", *stamps, *flight.p[k], *flight.q[k])

    path = written(tmp_path, flight, {topic: POSES[version]}, add)
    seen = read(path).series["capture"]
    at = np.rint(seen.t * 250).astype(int)
    assert np.abs(seen.t - flight.t[at]).max() < 2e-6
    assert np.abs(np.stack([seen.values[n] for n in "xyz"], axis=1) - flight.p[at]).max() < 1e-5


def test_the_capture_of_a_log_is_fused_in_place_of_the_estimate(tmp_path, flight):
    def add(log, k, t):
        log.data("vehicle_mocap_odometry", "Q7f", t, *flight.p[k], *flight.q[k])

    path = written(tmp_path, flight, {"vehicle_mocap_odometry": POSES["older"]}, add)
    flown = {"flight": "a", "quadrotor": "Q", "flight controller": "px4", "onboard": str(path), "capture": None,
             "log number": None}  # fmt: skip
    found, about = import_flight(flown, {}, {})
    assert about["synchronisation"]["lag"]["value"] == pytest.approx(0.0, abs=2e-4)
    rows = slice(200, -200)
    at = np.rint((found["t"] + about["start"]["value"]).to_numpy() * 250)[rows].astype(int)
    exact = found["t"].to_numpy()[rows] * 250 % 1 < 0.01
    assert np.abs(found["x"].to_numpy()[rows] - flight.p[at, 0])[exact].max() < 2e-3


def test_pulse_widths_of_older_versions_become_shares(tmp_path, flight):
    def add(log, k, t):
        if k % 4 == 0:
            pulses = 1075 + 875 * flight.commands[k] if k > 40 else np.full(4, 900.0)
            log.data("actuator_outputs", "QI16f", t, 8, *pulses, *[0.0] * 12)

    formats = {"actuator_outputs": "uint64_t timestamp;uint32_t noutputs;float[16] output"}
    names = [n for n in ULOG_FORMATS if n != "actuator_motors"]
    path = written(tmp_path, flight, formats, add, names, {"PWM_MIN": 1075, "PWM_MAX": 1950})
    series = next(s for s in read(path).series.values() if "command1" in s.values)
    assert (series.values["command1"][:10] == 0.0).all()
    np.testing.assert_allclose(series.values["command3"][11:], flight.commands[44::4, 2], atol=1e-6)


def test_speeds_stamped_by_each_controller_keep_their_clocks(tmp_path, flight):
    def add(log, k, t):
        if k % 4 == 0:
            rpm = np.round(flight.rotors[k] * 30 / np.pi).astype(int)
            reports = [x for m in range(4) for x in (t - 500 * m, int(rpm[m]), 101 + m, 0, 0, 0)]
            log.data("esc_status", "Q" + 4 * "QiB3B", t, *reports)

    names = [n for n in ULOG_FORMATS if n != "esc_status"]
    path = written(tmp_path, flight, {"esc_status": ULOG_FORMATS["esc_status"]}, add, names)
    found = read(path)
    times = {f"w{m}": next(s.t for s in found.series.values() if f"w{m}" in s.values) for m in range(1, 5)}
    for m in range(1, 5):
        np.testing.assert_allclose(times[f"w{m}"] - times["w1"], -500e-6 * (m - 1), atol=1e-9)


# real files


@needs_real
def test_a_recent_log_is_read_whole():
    path = REAL / "sample_px4_events.ulg"
    found = read(path)
    board = found.series["onboard"]
    assert len(board.t) == 7783 and found.metadata["firmware"]["revision"] == "PX4 1.15.0"
    force = next(s for s in found.series.values() if "az" in s.values)
    assert np.mean(force.values["az"]) == pytest.approx(-9.8, abs=0.1)
    rotors = next(s for s in found.series.values() if "w1" in s.values)
    assert sorted(rotors.values) == ["w1", "w2", "w3", "w4"]
    assert np.max(rotors.values["w1"]) == pytest.approx(3300 * np.pi / 30, rel=0.1)
    place = next(s for s in found.series.values() if "z" in s.values)
    assert np.nanmin(place.values["z"]) < -1.0  # it flew, and down is positive
    # sensor_combined comes before the filters; the other topic after a low-pass at 40 Hz
    assert found.metadata["filter delays"]["gyro"]["value"] == 0.0
    filtered = read(path, **{"log topics": {"body rates": "vehicle_angular_velocity"}})
    assert len(filtered.series["onboard"].t) == 1558
    assert filtered.metadata["filter delays"]["gyro"]["value"] == pytest.approx(np.sqrt(2) / (2 * np.pi * 40))


@needs_real
def test_a_log_of_2016_is_read_by_its_own_names():
    found = read(REAL / "sample.ulg")
    assert len(found.series["onboard"].t) == 17070
    assert found.metadata["drop-outs"] == {"count": 4, "lost": pytest.approx(0.119), "unit": "s"}
    step = np.diff(found.series["onboard"].t)
    assert np.median(step) == pytest.approx(0.004, abs=2e-4)
    commands = next(s for s in found.series.values() if "command1" in s.values)
    assert {n for n in commands.values if n.startswith("command")} == {f"command{i}" for i in range(1, 5)}
    assert (commands.values["command1"] == 0.0).all()  # 900 us throughout: never armed


@needs_real
def test_a_log_without_rotor_speeds_is_read_with_what_it_has():
    found = read(REAL / "sample_logging_tagged_and_default_params.ulg")
    held = {n for s in found.series.values() for n in s.values}
    assert {"p", "ax", "qw", "battery_voltage", "command1"} <= held and "w1" not in held
