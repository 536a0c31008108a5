"""A flight from its raw files to one grid, against the truth it was made from."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_motion import at_times, body, motive_text
from made_recordings import written
from recordings import SHARED
from scipy.spatial.transform import Rotation

from quasi.attitude import from_euler
from quasi.errors import ConfigError, DataError, ReadError
from quasi.importing.contradictions import rates_explained
from quasi.importing.figures import alignment_figure
from quasi.importing.flight import import_flight
from quasi.tables import COLUMNS, read_json
from quasi_synthesis.campaign import make_flight, read_campaign

ROOT = Path(__file__).parents[2]
NANODRONE = SHARED.parent / "nanodrone"
FLAGS = ("attitude_sample", "position_sample", "velocity_sample", "onboard_valid")


def angle(a, b):
    return (Rotation.from_quat(a, scalar_first=True).inv() * Rotation.from_quat(b, scalar_first=True)).magnitude()


def rms(error, where):
    return float(np.sqrt(np.mean(np.asarray(error)[where] ** 2)))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A made flight of 30 s in real formats, its truth, and what the importer makes of it."""
    folder = tmp_path_factory.mktemp("made")
    campaign = read_campaign({"seed": 5, "duration": 20.0, "flights": [{"key": "made-01"}]})
    flight = make_flight(campaign, campaign.flights[0])
    asked = written(folder, "made-01", flight)
    offset = flight.metadata["capture"]["offset"]
    quadrotor = {"motor poles": "14", "optitrack marker cg offset": dict(zip("xyz", map(str, offset)))}
    return asked, quadrotor, flight, *import_flight(asked, quadrotor, {"resampling rate": 500})


def truth_on_grid(made):
    _, _, flight, frame, about = made
    truth = flight.truth
    at = frame["t"].to_numpy() + about["start"]["value"]
    t = truth["t"].to_numpy() - truth["t"].iloc[0]
    return pd.DataFrame({c: np.interp(at, t, truth[c]) for c in truth.columns})


def test_lag_and_clock_rate_of_a_made_flight(made):
    _, _, flight, _, about = made
    drawn, sync = flight.metadata["nuisance"], about["synchronisation"]
    onboard, capture = 1 + drawn["on-board clock"], 1 + drawn["capture clock"]
    rate = onboard / capture - 1
    lag = drawn["capture start"] * onboard + sync["lag"]["at capture time"] * rate
    assert sync["lag"]["value"] == pytest.approx(lag, abs=5e-4)
    assert abs(sync["lag"]["value"] - lag) < 5 * sync["lag"]["std"]
    assert sync["clock rate"]["value"] == pytest.approx(rate, abs=max(2e-5, 4 * sync["clock rate"]["std"]))


def test_columns_are_near_the_truth(made):
    _, _, _, frame, _ = made
    true = truth_on_grid(made)
    seen = (frame["velocity_sample"] > 0) & (frame["attitude_sample"] > 0)
    for axis in "xyz":
        assert rms(true[axis] - frame[axis], seen) < 1.5e-3
    for axis in "uvw":
        assert rms(true[axis] - frame[axis], seen) < 0.06
    for axis in "pqr":
        assert rms(true[axis] - frame[axis] - (true[axis] - frame[axis]).mean(), seen) < 0.06
    for i in range(1, 5):
        assert rms(true[f"w{i}"] - frame[f"w{i}"], seen) < 40.0
    captured = from_euler(*frame[["roll", "pitch", "yaw"]].to_numpy().T)
    wanted = true[["qw", "qx", "qy", "qz"]].to_numpy()
    wanted = wanted / np.linalg.norm(wanted, axis=1, keepdims=True)
    assert np.degrees(rms(angle(captured, wanted), seen)) < 1.5  # the marker pose is off by design
    onboard = from_euler(*frame[["onboard_roll", "onboard_pitch", "onboard_yaw"]].to_numpy().T)
    assert np.degrees(rms(angle(onboard, wanted), seen)) < 3.0


def test_marker_swaps_leave_no_frame_behind(made):
    frame, true = made[3], truth_on_grid(made)
    error = np.linalg.norm(frame[list("xyz")].to_numpy() - true[list("xyz")].to_numpy(), axis=1)
    assert error[frame["position_sample"] > 0].max() < 0.012


def test_the_frame_keeps_the_contract(made):
    _, _, _, frame, about = made
    assert all(c in COLUMNS for c in frame.columns)
    assert np.isfinite(frame.to_numpy()).all()
    assert np.diff(frame["t"]) == pytest.approx(0.002, abs=1e-9)
    assert frame["t"].iloc[0] == 0.0
    for flag in FLAGS:
        assert set(np.unique(frame[flag])) <= {0.0, 1.0}
    assert frame["attitude_sample"].mean() == pytest.approx(120 / 500, abs=0.02)
    assert about["schema"] == "quasi.imported/1"
    assert about["attitude source"] == "capture"
    assert about["position source"] == "capture"
    assert about["velocity source"] == "capture position"
    assert about["motor poles"]["value"] == 14
    assert about["logged to rad/s"] == pytest.approx(100 * 2 * np.pi / 60 / 7)
    assert about["verdict"] in ("good", "usable with care")
    assert all(isinstance(n, str) for n in about["notes"])


def test_on_board_attitude_is_taken_when_asked_for(made):
    asked, quadrotor, *_ = made
    frame, about = import_flight(asked, quadrotor, {"use onboard attitude": True, "resampling rate": 250})
    assert about["attitude source"] == "estimated on board"
    assert frame["roll"].to_numpy() == pytest.approx(frame["onboard_roll"].to_numpy())
    assert np.diff(frame["t"]) == pytest.approx(0.004, abs=1e-9)


def test_without_capture_the_flight_is_still_read(made):
    asked, quadrotor, *_ = made
    frame, about = import_flight(asked | {"capture": None}, quadrotor, {})
    assert "x" not in frame
    assert about["synchronisation"] is None
    assert about["position source"] == "none"
    assert about["verdict"] == "unusable"
    assert about["verdict because"].startswith("unusable for identification: neither position nor velocity")
    assert "its page still shows body rates, specific force, attitude, rotor speeds" in about["verdict because"]


def test_the_imu_is_moved_to_the_cg_by_rigid_body_kinematics(made):
    asked, quadrotor, *_ = made
    arm = np.array([0.03, -0.02, 0.01])
    plain, _ = import_flight(asked, quadrotor, {})
    moved, about = import_flight(
        asked, quadrotor | {"imu position": dict(zip("xyz", arm))}, {"do onboard c.g. correction": True}
    )
    assert about["corrections"]["imu position"]["value"] == pytest.approx(arm)
    w = plain[list("pqr")].to_numpy()
    # motion of a point at the arm, by its path in a frame that turns: second derivative of R r, back in body axes
    turn = Rotation.from_rotvec(np.zeros(3))
    middle = slice(4000, 4400)
    turns = [turn]
    for rate in 0.5 * (w[middle][1:] + w[middle][:-1]):
        turns.append(turns[-1] * Rotation.from_rotvec(rate * 0.002))
    path = np.stack([r.apply(arm) for r in turns])
    acceleration = np.gradient(np.gradient(path, 0.002, axis=0), 0.002, axis=0)
    expected = np.stack([r.inv().apply(a) for r, a in zip(turns, acceleration)])
    got = (plain[["ax", "ay", "az"]].to_numpy() - moved[["ax", "ay", "az"]].to_numpy())[middle]
    smooth = np.ones(25) / 25
    for k in range(3):
        a, b = (np.convolve(v[:, k], smooth, "valid")[20:-20] for v in (expected, got))
        assert np.sqrt(np.mean((a - b) ** 2)) < 0.1 * np.std(expected) + 0.02
    _, unknown = import_flight(asked, quadrotor, {"do onboard c.g. correction": True})
    assert any("imu position" in n for n in unknown["notes"])


def test_a_configured_calibration_is_applied_like_one_that_was_found_and_before_it(made):
    asked, quadrotor, *_ = made
    turned = {"capture": {"misalignment": [0.03, 0.0, -0.02]}}
    scaled = {"imu": {"gyro scale": [1.03, 1.0, 0.98]}}
    plain, _ = import_flight(asked, quadrotor, {})
    found, _ = import_flight(asked, quadrotor, {}, turned)
    known, about = import_flight(asked, quadrotor | {"sensor calibration": turned}, {})
    pd.testing.assert_frame_equal(known, found)
    assert about["calibration"] is None
    assert about["sensor calibration"] == turned
    apart = Rotation.from_euler("ZYX", plain[["yaw", "pitch", "roll"]]).inv() * Rotation.from_euler(
        "ZYX", known[["yaw", "pitch", "roll"]]
    )
    np.testing.assert_allclose(np.median(apart.as_rotvec(), axis=0), [-0.03, 0.0, 0.02], atol=1e-3)
    both, _ = import_flight(asked, quadrotor | {"sensor calibration": turned}, {}, scaled)
    pd.testing.assert_frame_equal(both, import_flight(asked, quadrotor, {}, turned | scaled)[0])


def test_alignment_figure_draws_both_sides(made):
    figure = alignment_figure(made[3], made[4])
    assert len(figure.axes) == 9
    assert "lag" in figure.get_suptitle()
    assert all(len(axis.lines) >= 2 for axis in figure.axes)


def test_wrong_rigid_body_controller_and_rate_are_refused(made):
    asked, quadrotor, *_ = made
    with pytest.raises(ReadError, match="did you mean 'MadeBeetle'"):
        import_flight(asked | {"rigid body": "MadeBeatle"}, quadrotor, {})
    with pytest.raises(ReadError, match="is a blackbox log, expected a PX4 ULog"):
        import_flight(asked | {"flight controller": "px4"}, quadrotor, {})
    with pytest.raises(ReadError, match="is a blackbox log, expected a table"):
        import_flight(asked | {"flight controller": "table"}, quadrotor, {})
    with pytest.raises(ReadError, match="is not from INDIflight: it names the firmware 'Betaflight"):
        import_flight(asked | {"flight controller": "indiflight"}, quadrotor, {})
    with pytest.raises(ConfigError, match="0 is less than the minimum of 10"):
        import_flight(asked, quadrotor, {"resampling rate": 0})


def table_flight(folder, truth, columns):
    """An on-board table of the truth, and the flight and mapping that read it."""
    table = pd.DataFrame({"t": truth.t} | columns)
    table.to_csv(folder / "log.csv", index=False)
    plan = {"time": "t", "sources": [{"name": "imu", "columns": {n: n for n in columns}}]}
    flight = {"flight": "f", "quadrotor": "q", "flight controller": "table", "onboard": str(folder / "log.csv")}
    return flight, {"table columns": plan}


def imu(truth):
    rng = np.random.default_rng(1)
    noisy = truth.rates + rng.normal(0, 0.02, truth.rates.shape), truth.force + rng.normal(0, 0.2, truth.force.shape)
    return dict(zip(("p", "q", "r"), noisy[0].T)) | dict(zip(("ax", "ay", "az"), noisy[1].T))


def test_a_lost_span_of_the_log_is_flagged(tmp_path):
    truth = body(12.0, rate=500.0)
    keep = (truth.t < 6.0) | (truth.t > 6.5)
    short = truth._replace(**{k: v[keep] for k, v in truth._asdict().items()})
    frame, about = import_flight(*table_flight(tmp_path, short, imu(short)), {})
    lost = frame["onboard_valid"].to_numpy() == 0
    inside = (frame["t"] > 6.005) & (frame["t"] < 6.495)
    assert lost[inside].all()
    assert not lost[~((frame["t"] > 5.99) & (frame["t"] < 6.51))].any()
    assert "lost" in about["verdict because"]


def test_rotor_speeds_that_begin_late_and_end_early_are_said_with_what_they_cost(tmp_path):
    truth = body(20.0, rate=500.0)
    still = truth.t < 5.0
    truth.rates[still], truth.force[still] = 0.0, [0.0, 0.0, -9.81]
    flight, quadrotor = table_flight(tmp_path, truth, imu(truth))
    table = pd.read_csv(flight["onboard"])
    turning = (truth.t > 3.0) & (truth.t < 18.0)
    wave = np.sin(2 * np.pi * 3.0 * truth.t)
    speeds = {f"w{i}": np.where(turning, 1500.0 + 20 * i * wave, np.nan) for i in range(1, 5)}
    table.assign(**speeds, stamp=np.where(turning, truth.t, np.nan)).to_csv(flight["onboard"], index=False)
    quadrotor["table columns"]["sources"].append({"name": "esc", "time": "stamp", "columns": {n: n for n in speeds}})
    frame, about = import_flight(flight, quadrotor, {})
    assert frame["t"].iloc[-1] == pytest.approx(15.0, abs=0.01)
    assert about["start"]["value"] == pytest.approx(3.0, abs=0.01)
    said = next(n for n in about["notes"] if "the sources share 15.0 s of the 20.0 s" in n)
    assert said.endswith(
        "left out are 3.0 s before the rotor telemetry begins and 2.0 s after the rotor telemetry ends"
    )
    assert about["rest before take-off"]["value"] == pytest.approx(2.0, abs=0.6)  # 5 s, of which 3 s are left out


def test_logged_position_and_velocity_serve_where_nothing_captured(tmp_path):
    truth = body(10.0, rate=200.0)
    speed = np.gradient(truth.position, truth.t, axis=0)
    more = dict(zip(("x", "y", "z"), truth.position.T)) | dict(zip(("vx", "vy", "vz"), speed.T))
    more |= dict(zip(("qw", "qx", "qy", "qz"), truth.quaternion.T))
    frame, about = import_flight(*table_flight(tmp_path, truth, imu(truth) | more), {"resampling rate": 200})
    assert about["position source"] == about["velocity source"] == about["attitude source"] == "onboard"
    in_body = Rotation.from_quat(truth.quaternion, scalar_first=True).inv().apply(speed)
    inner = slice(20, len(frame) - 20)
    assert frame[list("uvw")].to_numpy()[inner] == pytest.approx(in_body[: len(frame)][inner], abs=0.02)


def test_rotors_of_several_sources_are_valid_where_all_are_known(tmp_path):
    truth = body(12.0, rate=500.0)
    flight, quadrotor = table_flight(tmp_path, truth, imu(truth))
    late = truth.t > 4.0
    speeds = {f"w{i}": 1500.0 + 20 * i * np.sin(20.0 * truth.t) for i in range(1, 5)}
    speeds |= {n: np.where(late, speeds[n], np.nan) for n in ("w3", "w4")}
    table = pd.read_csv(flight["onboard"]).assign(**speeds, stamp=np.where(late, truth.t, np.nan))
    table.to_csv(flight["onboard"], index=False)
    front = {"name": "front", "columns": {n: n for n in ("w1", "w2")}}
    rear = {"name": "rear", "time": "stamp", "columns": {n: n for n in ("w3", "w4")}}
    quadrotor["table columns"]["sources"] += [front, rear]
    frame, about = import_flight(flight, quadrotor, {})
    np.testing.assert_array_equal(frame["onboard_valid"] > 0, frame["t"] > 4.001)
    assert "the on-board log lost 33" in about["verdict because"]
    quadrotor["table columns"]["sources"].remove(rear)
    _, about = import_flight(flight, quadrotor, {})
    assert "unusable for identification: no rotor speeds of 3, 4" in about["verdict because"]


@pytest.mark.parametrize(
    ("signs", "fits"),
    [((1, 1, 1, 1), True), ((-1, 1, 1, 1), False), ((1, 1, -1, -1), False)],
    ids=["", "inverse", "FLU"],
)
def test_an_on_board_attitude_that_turns_unlike_the_gyro_is_told(tmp_path, signs, fits):
    truth = body(10.0, rate=200.0)
    late = np.maximum(np.arange(len(truth.t)) - 4, 0)  # 20 ms
    more = dict(zip(("qw", "qx", "qy", "qz"), (truth.quaternion * signs)[late].T))
    _, about = import_flight(*table_flight(tmp_path, truth, imu(truth) | more), {"resampling rate": 200})
    assert ("turns unlike the gyro" not in about["verdict because"]) == fits


@pytest.mark.parametrize("source", ["the on-board attitude", "the captured attitude"])
@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (57.3, r"body rates are 5[67]\.\d times those of {}, as with deg/s taken for rad/s.*correct it"),
        (1 / 57.3, r"body rates are 0\.017\d? times those of {}, as with rad/s taken for deg/s"),
        (1e3, "times those of {}; check the unit of the gyro, of the attitude and of time, and correct it"),
        (6.28, r"body rates are 6\.\d+ times those of {}; check the unit of the gyro"),
        (1.5, None),
    ],
)
def test_body_rates_in_another_unit_than_the_attitude_tells_are_noticed(tmp_path, source, factor, said):
    truth = body(15.0, rate=200.0)
    measured = imu(truth)
    measured |= {n: factor * measured[n] for n in ("p", "q", "r")}
    seen = dict(zip(("qw", "qx", "qy", "qz", "x", "y", "z"), np.hstack([truth.quaternion, truth.position]).T))
    flight, quadrotor = table_flight(tmp_path, truth, measured | seen)
    if source == "the captured attitude":
        quadrotor["table columns"]["sources"] = [
            {"name": "imu", "columns": {n: n for n in measured}},
            {"name": "room", "motion capture": True, "columns": {n: n for n in seen}},
        ]
    if factor in (1.5, 6.28):
        because = import_flight(flight, quadrotor, {"resampling rate": 200})[1]["verdict because"]
        assert re.search(said.format(source), because) if said else "body rates are" not in because
        return
    with pytest.raises(DataError, match=said.format(source)):
        import_flight(flight, quadrotor, {"resampling rate": 200})


@pytest.mark.parametrize(("factor", "fits"), [(1.0, True), (1000.0, False), (-1.0, False)])
def test_an_on_board_velocity_of_another_unit_or_sign_than_the_position_is_told(tmp_path, factor, fits):
    truth = body(10.0, rate=200.0)
    speed = factor * np.gradient(truth.position, truth.t, axis=0)
    more = dict(zip(("x", "y", "z"), truth.position.T)) | dict(zip(("vx", "vy", "vz"), speed.T))
    _, about = import_flight(*table_flight(tmp_path, truth, imu(truth) | more), {"resampling rate": 200})
    assert ("is not that of the on-board position" not in about["verdict because"]) == fits


def test_capture_of_another_time_of_day_has_no_overlap(tmp_path):
    truth = body(10.0, rate=500.0)
    flight, quadrotor = table_flight(tmp_path, truth, imu(truth))
    other = body(20.0, rate=500.0, seed=99)
    tau = np.arange(120 * 15) / 120.0
    (tmp_path / "take.csv").write_text(motive_text(np.arange(len(tau)), tau, *at_times(other, tau)))
    flight |= {"capture": str(tmp_path / "take.csv"), "rigid body": "Quad"}
    with pytest.raises(DataError, match="nowhere like|match alike"):
        import_flight(flight, quadrotor, {})


@pytest.mark.skipif(
    not NANODRONE.is_dir(), reason=f"the nano-drone recordings are not at {NANODRONE}; set QUASI_SHARED_DATA"
)
@pytest.mark.parametrize("run", [1, 2, 3])
def test_real_nano_drone_flights_import(run):
    config = read_json(ROOT / "examples/nanodrone/config/NanoDroneConfig.json")
    flight = {
        "flight": f"square_run{run}",
        "quadrotor": "NanoDrone",
        "flight controller": "table",
        "onboard": str(NANODRONE / f"square_run{run}.csv"),
        "capture": None,
    }
    frame, about = import_flight(flight, config, {"resampling rate": 100})
    assert np.isfinite(frame.to_numpy()).all()
    assert about["attitude source"] == "onboard"
    assert about["position source"] == "capture"
    assert about["verdict"] == "usable with care"
    assert "no rest" in about["verdict because"]
    sync = about["synchronisation"]
    assert 0.0 < sync["lag"]["value"] < 0.06
    assert sync["explained variance"]["earth acceleration"] > 0.95
    seen = (frame["velocity_sample"] > 0) & (frame["z"] < -0.4)
    assert frame["w"][seen].abs().max() < 4.0  # 5.9 with the stamps as they crowd
    assert frame["az"][seen].median() == pytest.approx(-9.9, abs=0.4)


def test_an_estimate_that_is_set_right_once_is_no_wrong_attitude():
    """A heading that is found by 172 degrees at once, in a gentle flight."""
    t = np.arange(0.0, 30.0, 0.005)
    rates = np.outer(0.6 * np.cos(2.0 * t), [1.0, 0.0, 0.0])
    level = Rotation.from_rotvec(np.outer(0.3 * np.sin(2.0 * t), [1.0, 0.0, 0.0]))
    set_right = Rotation.from_rotvec(np.outer(np.where(t > 12.0, 3.0, 0.0), [0.0, 0.0, 1.0])) * level
    for attitude, low, high in ((level, 0.95, 1.01), (set_right, 0.95, 1.01), (level.inv(), -9.0, 0.0)):
        assert low < rates_explained(t, rates, t, attitude.as_quat(scalar_first=True)) < high
