"""Sensors that a log lacks, made from its other signals: against the truth of a made rigid-body motion."""

import copy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rigid_body
from recordings import SHARED
from scipy.spatial.transform import Rotation

from quasi.attitude import GRAVITY, body_rates, from_euler, rotate_inverse, to_euler
from quasi.errors import ConfigError, DataError, cautions
from quasi.filtering.flight import filter_flight
from quasi.importing.captured_sensors import Captured
from quasi.importing.derivatives import derivative_error
from quasi.importing.flight import import_flight
from quasi.importing.inspection import inspect_flight
from quasi.importing.onboard_log import HELD_HEADING
from quasi.importing.readers.table_mapping import read_mapping
from quasi.importing.reconstruction import complete_sensors, thrust_angles
from quasi.importing.resampling import low_pass, velocity
from quasi.importing.series import Series, Track
from quasi.importing.verdict import made_too
from quasi.project.flights import IMPORTING
from quasi.tables import read_json

CRAZYPAD = SHARED.parent / "crazypad"
POSITION, VELOCITY, LINEAR = ("x", "y", "z"), ("vx", "vy", "vz"), ("linear_ax", "linear_ay", "linear_az")
FULL = {"q": ("qw", "qx", "qy", "qz"), "v": VELOCITY, "p": POSITION}


@pytest.fixture(scope="module")
def motion():
    return rigid_body.move(seconds=14.0, rate=200.0, rest=1.0, loops=False)


@pytest.fixture(scope="module")
def flat(motion):
    """A flight whose thrust is along body z: attitude from acceleration and yaw, by scipy, independent of ours."""
    t = motion.t
    acceleration = np.stack([1.5 * np.sin(1.1 * t), 2.0 * np.cos(0.9 * t), 1.0 * np.sin(1.7 * t)], axis=1)
    yaw = 0.8 * np.sin(0.3 * t) + 2.0
    down = np.array([0.0, 0.0, GRAVITY]) - acceleration  # thrust accelerates along minus body z
    z = down / np.linalg.norm(down, axis=1)[:, None]
    ahead = np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], axis=1)
    y = np.cross(z, ahead)
    y /= np.linalg.norm(y, axis=1)[:, None]
    turned = Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=-1))
    return t, acceleration, turned.as_euler("ZYX")[:, ::-1], np.linalg.norm(down, axis=1)


def series(t, **groups):
    values = {}
    for names, columns in groups.values():
        values |= dict(zip(names, np.asarray(columns).T))
    return {"onboard": Series(t, values)}


def rms(error):
    return float(np.sqrt(np.mean(np.asarray(error)[200:-200] ** 2)))


@pytest.mark.parametrize("smooth", [0.0, 0.15])
def test_specific_force_comes_from_velocity_with_the_stated_error(flat, smooth):
    """smooth  m/s, of an error below the bandwidth on each axis, as that of an estimate is"""
    t, acceleration, angles, _ = flat
    speed = np.stack([-1.5 / 1.1 * np.cos(1.1 * t), 2.0 / 0.9 * np.sin(0.9 * t), -1.0 / 1.7 * np.cos(1.7 * t)], axis=1)
    wrong = smooth * np.sin(np.outer(t, [7.0, 9.0, 8.0]) + np.arange(3.0))
    noise = np.random.default_rng(1).normal(0, 0.002, speed.shape)
    q = from_euler(*angles.T)
    notes = []
    made = complete_sensors(
        series(t, q=(FULL["q"], q), v=(VELOCITY, speed + noise + wrong), w=(("p", "q", "r"), body_rates(q, t))),
        10.0, "a", notes,
    )  # fmt: skip
    assert set(made.made) == {"accelerometer"}
    error = rms(made.force.values - rotate_inverse(q, acceleration - np.array([0.0, 0.0, GRAVITY])))
    assert made.made["accelerometer"]["std"]["value"] == pytest.approx(error, rel=0.5)
    assert made.made["accelerometer"]["bandwidth"]["value"] == 10.0
    assert error < 0.15 + 10.0 * smooth
    assert len(cautions(notes)) == 1


def test_a_logged_acceleration_serves_before_velocity_and_position(motion):
    acceleration = np.gradient(motion.v, motion.t, axis=0)
    made = complete_sensors(
        series(motion.t, q=(FULL["q"], motion.q), v=(VELOCITY, motion.v), a=(LINEAR, acceleration)), 10.0, "a", []
    )
    assert made.made["accelerometer"]["from"].startswith("the logged acceleration")
    assert rms(made.force.values - motion.force) < 0.1
    biased = complete_sensors(
        series(motion.t, q=(FULL["q"], motion.q), v=(VELOCITY, motion.v), a=(LINEAR, acceleration + 0.3)), 10.0, "a", []
    )
    np.testing.assert_allclose((biased.force.values - motion.force)[400:-400].mean(axis=0), 0.0, atol=0.03)
    from_place = complete_sensors(series(motion.t, q=(FULL["q"], motion.q), p=(POSITION, motion.p)), 10.0, "a", [])
    assert from_place.made["accelerometer"]["from"] == "the position"
    assert rms(from_place.force.values - motion.force) < 0.1


def test_body_rates_come_from_the_attitude(motion):
    made = complete_sensors(series(motion.t, q=(FULL["q"], motion.q), v=(VELOCITY, motion.v)), 10.0, "a", [])
    assert set(made.made) == {"accelerometer", "gyro"}
    assert rms(made.gyro.values - motion.rates) < 0.05


def test_pitch_and_roll_come_from_acceleration_and_yaw(flat):
    t, acceleration, euler, size = flat
    roll, pitch = thrust_angles(acceleration - np.array([0.0, 0.0, GRAVITY]), euler[:, 2])
    np.testing.assert_allclose(np.stack([roll, pitch], axis=1), euler[:, :2], atol=1e-9)
    made = complete_sensors(series(t, a=(LINEAR, acceleration), y=(("yaw",), euler[:, 2:])), 10.0, "a", [])
    assert made.made["attitude"]["angles"] == ["roll", "pitch"]
    assert rms(to_euler(made.attitude.values)[:, :2] - euler[:, :2]) < 0.01
    assert rms(made.force.values - np.stack([0 * t, 0 * t, -size], axis=1)) < 0.1


def test_a_logged_roll_is_kept_and_checks_the_pitch(flat):
    t, acceleration, euler, _ = flat
    off = euler[:, :1] + 0.03
    made = complete_sensors(
        series(t, a=(LINEAR, acceleration), r=(("roll",), off), y=(("yaw",), euler[:, 2:])), 10.0, "a", []
    )
    assert made.made["attitude"]["angles"] == ["pitch"]
    assert made.made["attitude"]["std"]["value"] == pytest.approx(0.03, rel=0.1)
    np.testing.assert_allclose(to_euler(made.attitude.values)[:, 0], off[:, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("groups", "lacking"),
    [({"a": LINEAR}, "yaw"), ({"a": LINEAR, "r": ("roll", "pitch")}, "yaw"), ({"y": ("yaw",)}, "acceleration"),
     ({"q": FULL["q"]}, "accelerometer"), ({"g": ("p", "q", "r")}, "log the accelerometer")],
)  # fmt: skip
def test_what_cannot_be_made_is_refused_by_name(groups, lacking):
    t = 0.01 * np.arange(500)
    values = np.random.default_rng(0).normal(size=(500, 4))
    with pytest.raises(DataError, match=lacking) as caught:
        complete_sensors(series(t, **{k: (n, values[:, : len(n)]) for k, n in groups.items()}), 10.0, "flight", [])
    assert str(caught.value).startswith("flight")


def test_the_error_of_a_derivative_is_that_of_white_noise():
    noise = np.random.default_rng(2).normal(0, 0.01, (20000, 3))
    t = np.arange(len(noise)) / 200.0
    found, _ = velocity(t, noise, t, 10.0)
    assert derivative_error(Track(t, noise), 200.0, 10.0, 1) == pytest.approx(found.std(), rel=0.2)


def test_the_error_of_a_derivative_of_slow_samples_is_not_zero():
    noise = np.random.default_rng(2).normal(0, 0.01, (20000, 3))
    found = np.gradient(noise, 0.05, axis=0).std()  # at 20 Hz nothing lies above 10 Hz
    assert found < derivative_error(Track(0.05 * np.arange(20000), noise), 20.0, 10.0, 1) < 3.0 * found


def test_single_angles_need_axes_that_turn_alike():
    section = {"time": "t", "sources": [{"name": "s", "frame": "FLU", "world": "NED", "columns": {"yaw": "yaw"}}]}
    with pytest.raises(ConfigError, match="yaw"):
        read_mapping(section, None, "table columns")


def quadrotor_of(columns):
    mapped = {"time": "t", "sources": [{"name": "s", "columns": {c: c for c in columns}}]}
    return {**rigid_body.CONFIG, "table columns": mapped}


@pytest.mark.parametrize("gyro", [True, False])
def test_import_and_filter_run_with_what_is_there(motion, tmp_path, gyro):
    rng = np.random.default_rng(3)
    q = from_euler(*to_euler(motion.q).T)
    table = {"t": motion.t, **dict(zip(FULL["q"], q.T))}
    table |= dict(zip(VELOCITY, (motion.v + rng.normal(0, 0.002, motion.v.shape)).T)) | dict(zip(POSITION, motion.p.T))
    if gyro:
        table |= dict(zip("pqr", (motion.rates + 0.02 + rng.normal(0, 0.01, motion.rates.shape)).T))
    lift = np.clip(np.linalg.norm(motion.force, axis=1) / GRAVITY, 0, 3) * (motion.t > 1.0)
    table |= {f"command{i}": 0.5 * np.sqrt(lift) for i in range(1, 5)}
    pd.DataFrame(table).to_csv(tmp_path / "a.csv", index=False)
    flight = {"flight": "a", "quadrotor": "X", "flight controller": "table", "rigid body": "",
              "onboard": str(tmp_path / "a.csv"), "capture": None, "log number": None}  # fmt: skip
    columns = [c for c in table if c != "t"]
    frame, about = import_flight(
        flight, quadrotor_of(columns), {"resampling rate": 200.0, "use onboard attitude": True}
    )
    assert set(about["reconstructed"]) == ({"accelerometer"} if gyro else {"accelerometer", "gyro"})
    assert "gyro" in about["streams"] if gyro else "gyro" not in about["streams"]
    result = filter_flight(frame, about, rigid_body.quadrotor(), {})
    assert (result.convergence is not None) is gyro
    biases = result.metadata["biases"]
    assert biases["accelerometer"]["value"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
    if gyro:
        assert biases["gyro"]["value"] == pytest.approx([0.02] * 3, abs=0.005)
    columns = result.with_gravity
    off = columns[["Fx", "Fy", "Fz"]].to_numpy() / rigid_body.MASS - motion.force[: len(columns)]
    flying = columns["valid"].to_numpy() > 0
    assert np.sqrt(np.mean(off[flying] ** 2)) < 0.5
    assert 0.8 < flying.mean() < 0.99
    assert not flying[: int(0.7 * 200)].any()  # it stands until its commands rise


def seen_by(motion, late=0.0, gap=None, every=2):
    """A capture of the motion at 100 Hz with 0.1 mm of noise, on a clock that is `late` s behind the log's."""
    rng = np.random.default_rng(4)
    t, place, turned = (a[::every] for a in (motion.t, motion.p, motion.q))
    place = place + rng.normal(0, 1e-4, place.shape)
    if gap is not None:
        place[(t > gap[0]) & (t < gap[1])] = np.nan
    values = {**dict(zip(POSITION, place.T)), **dict(zip(FULL["q"], turned.T))}
    return Series(t - late, values)


@pytest.mark.parametrize("logged", ["gyro", "attitude", "nothing"])
def test_a_capture_replaces_what_the_log_lacks(motion, logged):
    groups = {"gyro": {"w": (("p", "q", "r"), motion.rates)}, "attitude": {"q": (FULL["q"], motion.q)}, "nothing": {}}
    capture = Captured(seen_by(motion, late=0.0 if logged == "nothing" else 3.2), logged == "nothing", 25.0)
    notes = []
    found = complete_sensors(series(motion.t, **groups[logged]), 10.0, "a", notes, captured=capture)
    about = found.made["accelerometer"]
    assert about["from"] == "the captured position and attitude"
    at = found.force.t
    off = found.force.values - np.stack([np.interp(at, motion.t, f) for f in motion.force.T], axis=1)
    assert rms(off) < 0.2
    assert about["std"]["value"] == pytest.approx(rms(off), rel=0.4)
    turning = np.stack([np.interp(found.gyro.t, motion.t, w) for w in motion.rates.T], axis=1)
    assert rms(found.gyro.values - turning) < 0.05
    assert len(cautions(notes)) == (1 if logged == "gyro" else 2)


def test_a_force_made_of_a_capture_leaves_its_gaps_out_and_the_gyros_delay(motion):
    late = Track(motion.t + 4e-3, motion.rates)  # as a log whose filters make the gyro 4 ms late
    log = {"onboard": Series(late.t, dict(zip("pqr", late.values.T)))}
    capture = Captured(seen_by(motion, late=-1.0, gap=(8.0, 8.4)), False, 25.0, gyro_delay=4e-3)
    found = complete_sensors(log, 10.0, "a", [], captured=capture)
    at = found.force.t
    assert not np.any((at > 7.99) & (at < 8.41))
    clear = (np.abs(at - 8.2) > 0.6) & (at > 1.0) & (at < at[-1] - 1.0)
    lag = [
        np.mean((found.force.values[clear] - np.stack([np.interp(at + d, motion.t, f) for f in motion.force.T], axis=1)
                 [clear]) ** 2) for d in (-4e-3, -2e-3, 0.0, 2e-3, 4e-3)
    ]  # fmt: skip
    assert np.argmin(lag) == 2


def test_a_capture_on_another_clock_needs_something_that_turns(motion):
    with pytest.raises(DataError, match=r"^a: .*nothing ties the capture.*one table"):
        complete_sensors(
            series(motion.t, c=(("command1",), motion.t[:, None])), 10.0, "a", [],
            captured=Captured(seen_by(motion), False, 25.0),
        )  # fmt: skip


@pytest.mark.parametrize("logged", ["gyro", "attitude", "nothing"])
def test_a_table_of_rotors_and_capture_is_imported(motion, tmp_path, logged):
    lift = np.clip(np.linalg.norm(motion.force, axis=1) / GRAVITY, 0, 3) * (motion.t > 1.0)
    table = {"t": motion.t} | {f"w{i}": 1000.0 * np.sqrt(lift) + 200.0 for i in range(1, 5)}
    onboard = {"gyro": ["p", "q", "r"], "attitude": ["qw", "qx", "qy", "qz"], "nothing": []}[logged]
    place = motion.p + np.random.default_rng(5).normal(0, 5e-5, motion.p.shape)  # a tracker's pose never stands still
    table |= dict(zip("pqr", motion.rates.T)) | dict(zip(FULL["q"], motion.q.T)) | dict(zip(POSITION, place.T))
    pd.DataFrame(table).to_csv(tmp_path / "a.csv", index=False)
    columns = {c: c for c in [*(f"w{i}" for i in range(1, 5)), *onboard]}
    capture = {c: c for c in (*POSITION, *FULL["q"])}
    sources = [{"name": "s", "columns": columns}, {"name": "c", "motion capture": True, "columns": capture}]
    quadrotor = {**rigid_body.CONFIG, "table columns": {"time": "t", "sources": sources}}
    flight = {"flight": "a", "quadrotor": "X", "flight controller": "table", "rigid body": "",
              "onboard": str(tmp_path / "a.csv"), "capture": None, "log number": None}  # fmt: skip
    settings = {"flight": flight, "quadrotor": quadrotor, "problem": None}
    assert inspect_flight(settings)["problem"] is None
    frame, about = import_flight(flight, quadrotor, {"resampling rate": 200.0})
    assert set(about["reconstructed"]) == {"accelerometer"} | ({"gyro"} if logged != "gyro" else set())
    at = frame["t"].to_numpy() + about["start"]["value"]
    force = np.stack([np.interp(at, motion.t, f) for f in motion.force.T], axis=1)
    assert rms(frame[["ax", "ay", "az"]].to_numpy() - force) < 0.3
    result = filter_flight(frame, about, rigid_body.quadrotor(), {})
    columns = result.with_gravity
    off = columns[["Fx", "Fy", "Fz"]].to_numpy() / rigid_body.MASS - force[: len(columns)]
    assert np.sqrt(np.mean(off[columns["valid"].to_numpy() > 0] ** 2)) < 0.3


@pytest.mark.skipif(not CRAZYPAD.is_dir(), reason=f"the flights of CrazyPAD are not at {CRAZYPAD}")
def test_a_real_flight_without_pitch_gyro_and_accelerometer():
    quadrotor = {
        "rotor config": {"front left": 4, "front right": 1, "aft right": 2, "aft left": 3},
        "rotor1 rotation direction": "CCW",
        "b": "0.046",
        "moment of inertia": "[1.7e-5,0,0;0,1.7e-5,0;0,0,2.9e-5]",
    }
    flight = {"flight": "a", "quadrotor": "E8", "flight controller": "crazyflie", "rigid body": "", "log number": None,
              "onboard": str(CRAZYPAD / "normal_flight" / "E8_log03"), "capture": None}  # fmt: skip
    frame, about = import_flight(flight, quadrotor, {"resampling rate": 100.0, "use onboard attitude": True})
    made = about["reconstructed"]
    assert set(made) == {"attitude", "accelerometer", "gyro"}
    assert np.degrees(made["attitude"]["std"]["value"]) < 2.0  # against the logged roll
    assert np.degrees(np.std(frame["pitch"])) > 0.5
    # the flight goes 2 m ahead: a nose that drops accelerates it forwards
    ahead = np.gradient(np.convolve(frame["u"], np.ones(20) / 20, "same"), 0.01)
    inside = slice(800, 2200)
    pitch = np.convolve(frame["pitch"], np.ones(20) / 20, "same")
    assert np.corrcoef(-pitch[inside], ahead[inside])[0, 1] > 0.6


@pytest.mark.skipif(not (SHARED.parent / "nanodrone").is_dir(), reason="the nano-drone recordings are absent")
@pytest.mark.parametrize("heading", [None, 10.0])
def test_a_heading_that_was_held_stands_in_for_a_yaw_that_is_not_logged(heading):
    log = CRAZYPAD / "cut_propeller_M3_3mm" / "E8_log01"
    if not log.exists():
        pytest.skip(f"{log} is not there")
    flight = {"flight": "cut", "quadrotor": "E8", "flight controller": "crazyflie", "onboard": str(log)}
    quadrotor = {} if heading is None else {"held heading": heading}
    if heading is None:
        with pytest.raises(DataError, match="'held heading'"):
            import_flight(flight, quadrotor, {})
        return
    frame, about = import_flight(flight, quadrotor, {})
    assert np.abs(np.degrees(frame["yaw"].to_numpy()) - heading).max() < 0.05
    assert any("held heading" in sentence for sentence in cautions(about["notes"]))
    assert about["reconstructed"]["attitude"]["angles"] == ["pitch"]


def test_the_import_stage_reads_the_held_heading():
    assert HELD_HEADING in IMPORTING


def test_a_logged_yaw_comes_before_a_held_heading():
    log = CRAZYPAD / "normal_flight" / "E8_log00"
    if not log.exists():
        pytest.skip(f"{log} is not there")
    flight = {"flight": "n", "quadrotor": "E8", "flight controller": "crazyflie", "onboard": str(log)}
    frame, about = import_flight(flight, {"held heading": 90.0}, {})
    assert abs(np.degrees(frame["yaw"])).median() < 20.0
    assert not any("held heading" in sentence for sentence in about["notes"])


def test_what_is_made_of_a_real_estimate_agrees_with_the_sensors_that_were_left_out():
    config = read_json(Path(__file__).parents[2] / "examples/nanodrone/config/NanoDroneConfig.json")
    flight = {"flight": "a", "quadrotor": "N", "flight controller": "table", "rigid body": "", "log number": None,
              "onboard": str(SHARED.parent / "nanodrone" / "square_run3.csv"), "capture": None}  # fmt: skip
    options = {"resampling rate": 100.0, "use onboard attitude": True}
    bare = copy.deepcopy(config)
    sources = bare["table columns"]["sources"]
    bare["table columns"]["sources"] = [s for s in sources if s["name"] not in ("accelerometer", "poses")]
    for name in "pqr":
        del bare["table columns"]["sources"][0]["columns"][name]
    truth, about = import_flight(flight, config, options)
    made, made_about = import_flight(flight, bare, options)
    assert set(made_about["reconstructed"]) == {"gyro", "accelerometer"}
    t = truth["t"] + about["start"]["value"]
    there = made["t"] + made_about["start"]["value"]
    inside = ((t > there.min()) & (t < there.max()) & (truth["z"] < truth["z"].max() - 0.3)).to_numpy()
    for names, sensor in ((("p", "q"), "gyro"), (("ax", "ay", "az"), "accelerometer")):
        both = [(low_pass(np.interp(t, there, made[n])[:, None], 100.0, 10.0)[inside, 0],
                 low_pass(truth[[n]].to_numpy(), 100.0, 10.0)[inside, 0]) for n in names]  # fmt: skip
        assert min(np.corrcoef(*pair)[0, 1] for pair in both[-1:]) > (0.98 if sensor == "gyro" else 0.9)
    off = np.std([a - b for a, b in both], axis=1)
    stated = made_about["reconstructed"]["accelerometer"]["std"]["value"]
    assert np.all((0.4 * off < stated) & (stated < 2.5 * off))


def test_what_is_lost_names_the_sensor_that_was_made_of_another_source():
    """Frames that the capture lost had been "the on-board log lost 5.8 %" of a log without a gap."""
    made = {"accelerometer": {"from": "the captured position and attitude"}}
    assert made_too(made) == ", rows without the accelerometer made from the captured position and attitude included"
    assert made_too({}) == ""
