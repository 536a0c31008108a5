"""A whole flight through the filtering stage: truth comes back, and every fault of the input is named."""

import numpy as np
import pytest
from rigid_body import INERTIA, MASS, measure, move, quadrotor

from quasi import attitude, tables
from quasi.errors import ConfigError, DataError
from quasi.filtering import forces
from quasi.filtering.band import _cutoff
from quasi.filtering.estimation import CONVERGENCE_UNITS
from quasi.filtering.flight import course, filter_flight

BIAS = np.array([0.02, -0.03, 0.01, 0.1, -0.15, 0.2])
STATISTICS = {
    a: {"mean": "0", "std": s}
    for a, s in zip(("p", "q", "r", "ax", "ay", "az", "roll"), ("0.02", "0.02", "0.02", "0.3", "0.3", "0.3", "0.001"))
}
AIRFRAME = quadrotor(**{"(estimated) imu sensor noise statistics": STATISTICS})


@pytest.fixture(scope="module")
def motion():
    return move(seconds=18.0, seed=4)


@pytest.fixture
def made(motion):
    return measure(motion, alignment=(0.004, -0.005, 0.003))


@pytest.fixture(scope="module")
def plain(motion):
    return filter_flight(*measure(motion, alignment=(0.004, -0.005, 0.003)), AIRFRAME, {"add induced velocity": True})


def about(metadata, words):
    return [note for note in metadata["notes"] if words in note]


def applied(result):
    b = result.metadata["biases"]
    return np.array(b["gyro"]["value"] + b["accelerometer"]["value"]), np.array(
        b["gyro"]["std"] + b["accelerometer"]["std"]
    )


def test_states_come_back(motion, plain):
    table = plain.with_gravity
    valid = table["valid"].to_numpy() > 0.5
    assert valid.mean() > 0.8
    q = attitude.from_euler(*table[["roll", "pitch", "yaw"]].to_numpy().T)
    turn = attitude.logarithm(attitude.multiply(attitude.conjugate(q), motion.q))[valid]
    assert np.degrees(np.sqrt(np.mean(turn**2))) < 0.05
    body = attitude.rotate_inverse(motion.q, motion.v)
    assert np.sqrt(np.mean((table[["u", "v", "w"]].to_numpy() - body)[valid] ** 2)) < 0.006
    assert np.sqrt(np.mean((table[["x", "y", "z"]].to_numpy() - motion.p)[valid] ** 2)) < 0.001


def test_forces_and_moments_come_back_to_within_the_sensors_noise_in_the_band(motion, plain):
    table, band = plain.with_gravity, plain.metadata["filters"]["low-pass cutoff Hz"]
    valid = table["valid"].to_numpy() > 0.5
    truth = MASS * forces.low_pass(motion.force, band, 500.0)
    error = (table[["Fx", "Fy", "Fz"]].to_numpy() - truth)[valid]
    noise = MASS * 0.3 * np.sqrt(2 * band / 500.0)
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 1.1 * noise)
    assert np.abs(error.mean(axis=0)).max() < 0.005
    w = motion.rates
    moment = motion.rates_dot @ INERTIA + np.cross(w, w @ INERTIA)
    error = (table[["Mx", "My", "Mz"]].to_numpy() - moment)[valid]
    density = 0.02 * np.sqrt(2 / 500.0)
    noise = np.diag(INERTIA) * 2 * np.pi * density * np.sqrt(band**3 / 3)
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 1.15 * noise)


def test_net_force_is_force_plus_weight_in_body_axes(plain):
    q = attitude.from_euler(*plain.with_gravity[["roll", "pitch", "yaw"]].to_numpy().T)
    weight = MASS * attitude.rotate_inverse(q, np.array([0.0, 0.0, 9.81]))
    for i, name in enumerate(("Fx", "Fy", "Fz")):
        difference = plain.no_gravity[name].to_numpy() - plain.with_gravity[name].to_numpy()
        np.testing.assert_allclose(difference, weight[:, i], atol=1e-9)
    rest = plain.no_gravity["t"] < 2.5
    assert np.abs(plain.no_gravity.loc[rest, "Fz"].mean()) < 0.01
    assert plain.with_gravity.loc[rest, "Fz"].mean() == pytest.approx(-MASS * 9.81, abs=0.01)


def test_biases_come_back_with_the_right_sign_and_honest_errors(plain):
    value, std = applied(plain)
    assert np.abs((value - BIAS) / std).max() < 3.5
    assert std[:3].max() < 1e-3 and std[3:].max() < 0.02
    found = [plain.metadata["attitude alignment"][a] for a in ("roll", "pitch", "yaw")]
    error = [(f["value"] - truth) / f["std"] for f, truth in zip(found, (0.004, -0.005, 0.003))]
    assert np.abs(error).max() < 3.5


def test_rest_policy_takes_what_the_rest_shows(made):
    result = filter_flight(*made, AIRFRAME, {"bias policy": "rest"})
    value, std = applied(result)
    assert result.metadata["biases"]["policy"] == "rest"
    assert np.abs((value - BIAS) / std).max() < 3.5
    # at rest a tilt of the markers of 0.3 degrees cannot be told from 0.05 m/s2, and the error says so
    assert std[3] > 0.03 and std[5] < 0.03


def test_time_varying_biases_follow_a_drift(motion):
    frame, metadata = measure(motion)
    drift = np.linspace(0.0, 0.03, len(frame))
    frame["p"] += drift
    result = filter_flight(frame, metadata, AIRFRAME, {"bias policy": "time varying"})
    error = result.convergence["bias_p"].to_numpy() - (0.02 + drift)
    assert np.sqrt(np.mean(error[1500:] ** 2)) < 0.006
    constant = filter_flight(frame, metadata, AIRFRAME, {"bias policy": "whole flight"})
    assert about(constant.metadata, "bias of p differs")


def test_filter_without_smoother_is_the_forward_pass(made):
    result = filter_flight(*made, AIRFRAME, {"smoother": False})
    kept = result.convergence
    np.testing.assert_allclose(kept["filter_roll"], result.with_gravity["roll"])
    np.testing.assert_allclose(kept["filter_bias_p"], kept["bias_p"])


def test_course_is_kept_thinned_unless_asked_for_whole(plain, made):
    assert len(course(plain, whole=True)) == len(plain.convergence)
    thin = course(plain, whole=False)
    assert np.median(np.diff(thin["t"])) == pytest.approx(0.02)
    np.testing.assert_array_equal(
        thin["bias_p"], plain.convergence["bias_p"][:: round(0.02 / np.diff(made[0]["t"])[0])]
    )
    none = filter_flight(*made, AIRFRAME, {"run extended kalman filter": False})
    assert len(course(none, whole=True)) == 0


def test_without_filter_states_are_the_imported_and_biases_from_rest(made):
    frame, metadata = made
    result = filter_flight(frame, metadata, AIRFRAME, {"run extended kalman filter": False})
    assert result.convergence is None
    np.testing.assert_allclose(result.with_gravity["roll"], frame["roll"], atol=1e-9)
    np.testing.assert_allclose(result.with_gravity["u"], frame["u"], atol=1e-9)
    value, std = applied(result)
    assert np.abs((value - BIAS) / std).max() < 3.5


def test_noise_levels_in_flight_are_found(plain):
    noise = plain.metadata["noise"]
    assert noise["in flight"]["p"] == pytest.approx(0.02, rel=0.5)
    assert noise["in flight"]["ax"] == pytest.approx(0.3, rel=0.5)
    assert noise["measurements"]["attitude"]["std"][0] == pytest.approx(0.0035, rel=0.1)
    assert noise["measurements"]["position"]["std"][0] == pytest.approx(0.001, rel=0.1)
    for kind in ("attitude", "position"):
        assert plain.metadata["NIS"][kind]["mean"] == pytest.approx(1.0, abs=0.12)
    assert plain.metadata["consistent"] is True


def test_everything_written_has_a_unit_and_no_number_is_missing(plain, tmp_path):
    tables.write_table(tmp_path / "a.parquet", plain.with_gravity)
    tables.write_table(tmp_path / "b.parquet", plain.convergence, units=CONVERGENCE_UNITS)
    tables.write_json(tmp_path / "a.json", plain.metadata)
    columns = plain.with_gravity.drop(columns="v_in")
    assert np.isfinite(columns.to_numpy()).all()
    assert plain.metadata["schema"] == "quasi.filtered/1"
    hover = plain.with_gravity["v_in"][100]
    assert hover == pytest.approx(9.71, abs=0.05)


def test_ground_and_flight_are_told_apart(motion, plain):
    flight = plain.with_gravity["in_flight"].to_numpy()
    assert flight[motion.t < 2.9].max() == 0
    assert flight[motion.t > 4.0].min() == 1
    assert plain.metadata["phases"]["take-off"] == pytest.approx(3.0, abs=0.05)
    assert plain.metadata["phases"]["rest"][1] < 3.0


@pytest.mark.parametrize("policy", ["automatic", "rest"])
def test_no_rest_is_said_and_biases_come_from_the_whole_flight(made, policy):
    frame, metadata = made
    late = frame[frame["t"] > 5.0].reset_index(drop=True)
    result = filter_flight(late, metadata, AIRFRAME, {"bias policy": policy})
    assert result.metadata["biases"]["policy"] == "whole flight" and result.metadata["phases"]["rest"] is None
    assert about(result.metadata, "no rest of 1 s before take-off was found")
    assert len(about(result.metadata, "over the whole flight instead")) == (policy == "rest")
    value, std = applied(result)
    assert np.abs((value - BIAS) / std).max() < 4.0


def test_capture_lost_for_five_seconds_is_bridged_and_marked(motion, made):
    frame, metadata = made
    gone = (frame["t"] > 10.0) & (frame["t"] < 15.0)
    frame.loc[gone, ["attitude_sample", "position_sample"]] = 0.0
    frame.loc[gone, ["roll", "pitch", "yaw", "x", "y", "z", "u", "v", "w"]] = np.nan
    result = filter_flight(frame, metadata, AIRFRAME, {})
    assert about(result.metadata, "no position from t = 10.0")
    assert result.with_gravity.loc[gone, "valid"].iloc[10:-10].max() == 0
    body = attitude.rotate_inverse(motion.q, motion.v)
    error = (result.with_gravity[["u", "v", "w"]].to_numpy() - body)[gone.to_numpy()]
    claimed = result.convergence.loc[gone, "velocity_std_x"].max()
    assert np.abs(error).max() < 5 * claimed < 0.5


def test_on_board_attitude_and_velocity_without_position(motion, made):
    frame, metadata = made
    frame = frame.drop(columns=["x", "y", "z"])
    frame["position_sample"] = 0.0
    rng = np.random.default_rng(0)
    frame[["u", "v", "w"]] += rng.normal(0, 0.05, (len(frame), 3))
    metadata |= {"attitude source": "onboard", "position source": "none", "velocity source": "onboard"}
    result = filter_flight(frame, metadata, AIRFRAME, {})
    assert about(result.metadata, "no position source")
    body = attitude.rotate_inverse(motion.q, motion.v)
    valid = result.with_gravity["valid"].to_numpy() > 0.5
    error = (result.with_gravity[["u", "v", "w"]].to_numpy() - body)[valid]
    assert valid.mean() > 0.6 and np.sqrt(np.mean(error**2)) < 0.05


def test_attitude_is_found_without_any_attitude_source(motion, made):
    frame, metadata = made
    frame = frame.drop(columns=["roll", "pitch", "yaw"])
    frame["attitude_sample"] = 0.0
    metadata |= {"attitude source": "none"}
    result = filter_flight(frame, metadata, AIRFRAME, {})
    assert about(result.metadata, "no attitude source")
    table = result.with_gravity[1500:]
    q = attitude.from_euler(*table[["roll", "pitch", "yaw"]].to_numpy().T)
    turn = attitude.logarithm(attitude.multiply(attitude.conjugate(q), motion.q[1500:]))
    assert np.degrees(np.sqrt(np.mean(turn**2))) < 1.5


def test_neither_position_nor_velocity_is_said_and_drift_is_not_called_valid(motion, made):
    frame, metadata = made
    frame = frame.drop(columns=["x", "y", "z", "u", "v", "w"])
    frame["position_sample"] = frame["velocity_sample"] = 0.0
    metadata |= {"position source": "none", "velocity source": "none"}
    result = filter_flight(frame, metadata, AIRFRAME, {})
    assert about(result.metadata, "no position and no velocity source")
    assert np.isfinite(result.with_gravity.to_numpy()).all()
    body = attitude.rotate_inverse(motion.q, motion.v)
    error = np.abs(result.with_gravity[["u", "v", "w"]].to_numpy() - body).max(axis=1)
    claimed = result.convergence[[f"velocity_std_{a}" for a in "xyz"]].max(axis=1).to_numpy()
    assert np.all(error < 4 * claimed + 0.02)
    assert not np.any((result.with_gravity["valid"] > 0.5) & (claimed > 0.31 * np.sqrt(3)))


def test_marker_swaps_are_gated(motion, made):
    frame, metadata = made
    swapped = np.arange(3000, 3040)
    frame.loc[swapped, "yaw"] += 1.5
    result = filter_flight(frame, metadata, AIRFRAME, {})
    assert 0 < result.metadata["NIS"]["attitude"]["gated"] < 0.01
    q = attitude.from_euler(*result.with_gravity[["roll", "pitch", "yaw"]].to_numpy().T)
    turn = attitude.logarithm(attitude.multiply(attitude.conjugate(q), motion.q))
    assert np.degrees(np.abs(turn[2900:3100]).max()) < 0.3


@pytest.mark.parametrize("channel", ["q", "az"])
def test_constant_sensor_is_an_error(made, channel):
    frame, metadata = made
    frame[channel] = 1.25
    with pytest.raises(DataError, match=f"'{channel}' is constant"):
        filter_flight(frame, metadata, AIRFRAME, {})


def test_missing_and_empty_channels_are_errors_or_notes(made):
    frame, metadata = made
    with pytest.raises(DataError, match="no column 'r'"):
        filter_flight(frame.drop(columns="r"), metadata, AIRFRAME, {})
    with pytest.raises(DataError, match="'ax' is missing in 100 %"):
        filter_flight(frame.assign(ax=np.nan), metadata, AIRFRAME, {})
    result = filter_flight(frame.assign(command1=np.nan), metadata, AIRFRAME, {})
    assert about(result.metadata, "'command1' holds no value") and "command1" not in result.with_gravity


def test_spans_without_numbers_are_bridged_marked_and_said(made):
    frame, metadata = made
    frame.loc[5000:5100, "p"] = np.nan
    frame.loc[7000:7050, "w2"] = np.nan
    result = filter_flight(frame, metadata, AIRFRAME, {})
    assert about(result.metadata, "'p' is missing in 101 samples") and about(result.metadata, "'w2' is missing in 51")
    assert result.with_gravity.loc[5000:5100, "valid"].max() == 0
    assert result.with_gravity.loc[7000:7050, "valid"].max() == 0
    assert np.isfinite(result.with_gravity.to_numpy()).all()


def test_saturated_gyro_is_said_and_attitude_survives(motion, made):
    frame, metadata = made
    frame["q"] = frame["q"].clip(-10.0, 10.0)
    result = filter_flight(frame, metadata, AIRFRAME, {})
    assert about(result.metadata, "'q' is saturated at 10")
    q = attitude.from_euler(*result.with_gravity[["roll", "pitch", "yaw"]].to_numpy().T)
    turn = attitude.logarithm(attitude.multiply(attitude.conjugate(q), motion.q))
    assert np.degrees(np.abs(turn[600:]).max()) < 2.0


def test_noise_statistics_absent_or_zero_are_said(made):
    bare = filter_flight(*made, quadrotor(), {})
    assert about(bare.metadata, "the quadrotor's file holds no noise statistics of its IMU")
    unasked = filter_flight(*made, quadrotor(), {"use noise statistics in drone config": False})
    assert not about(unasked.metadata, "noise statistics")
    zero = quadrotor(**{"(estimated) imu sensor noise statistics": {**STATISTICS, "ax": {"mean": 0, "std": 0}}})
    assert about(filter_flight(*made, zero, {}).metadata, "which no sensor has")


def test_impossible_airframe_grid_and_options_are_sentences(made):
    frame, metadata = made
    with pytest.raises(DataError, match="no mass is known"):
        filter_flight(frame, metadata, quadrotor(mass=None), {})
    uneven = frame.assign(t=np.where(frame["t"] > 5, frame["t"] + 0.5, frame["t"]))
    with pytest.raises(DataError, match="not uniform"):
        filter_flight(uneven, metadata, AIRFRAME, {})
    with pytest.raises(ConfigError, match="'bias policy' is 'none'"):
        filter_flight(frame, metadata, AIRFRAME, {"bias policy": "none"})


def test_coarse_gyro_at_rest_does_not_decide_the_bias(motion):
    frame, metadata = measure(motion, gyro_bias=(0.006, -0.005, 0.004), gyro_noise=0.003)
    shaken = (motion.t > 3.0)[:, None] * np.random.default_rng(8).normal(0, 0.03, (len(frame), 3))
    step = np.radians(1.0)
    frame[["p", "q", "r"]] = np.round((frame[["p", "q", "r"]].to_numpy() + shaken) / step) * step
    metadata["sources"] = {"onboard": {"units": {"gyro": {"factor": step}}}}
    result = filter_flight(frame, metadata, quadrotor(), {})
    assert about(result.metadata, "coarser than their noise at rest")
    value, std = applied(result)
    assert np.abs(value[:3] - [0.006, -0.005, 0.004]).max() < 1e-3
    assert np.abs((value[:3] - [0.006, -0.005, 0.004]) / std[:3]).max() < 4.0


def test_what_shakes_the_quadrotor_after_its_landing_does_not_turn_the_capture(motion):
    truth = 0.004, -0.005, 0.003
    frame, metadata = measure(motion, alignment=truth, gyro_noise=0.005, accel_noise=0.03, attitude_noise=5e-4)
    landed, rng = motion.t > 14.0, np.random.default_rng(5)
    place, count = int(np.argmax(landed)), int(landed.sum())
    level = attitude.from_euler(0.0, 0.0, attitude.to_euler(motion.q[place])[2])
    frame.loc[landed, ["roll", "pitch", "yaw"]] = attitude.to_euler(
        attitude.multiply(level, attitude.exponential(np.array(truth)))
    )
    frame.loc[landed, ["x", "y", "z"]] = motion.p[place]
    frame.loc[landed, ["u", "v", "w"]], frame.loc[landed, ["w1", "w2", "w3", "w4"]] = 0.0, 150.0
    frame.loc[landed, ["p", "q", "r"]] = BIAS[:3] + rng.normal(0, 0.005, (count, 3))
    frame.loc[landed, ["ax", "ay", "az"]] = BIAS[3:] + [0.0, 0.0, -9.81] + rng.normal(0, 0.03, (count, 3))
    # rotors that spin down and hands shake it as much as flight does
    shaken = motion.t > 3.0
    frame.loc[shaken, ["p", "q", "r"]] += rng.normal(0, 0.2, (shaken.sum(), 3))
    frame.loc[shaken, ["ax", "ay", "az"]] += rng.normal(0, 1.0, (shaken.sum(), 3))
    result = filter_flight(frame, metadata, AIRFRAME, {"use noise statistics in drone config": False})
    assert result.with_gravity["in_flight"].to_numpy()[motion.t > 14.5].max() == 0
    # the landing itself is a jump here; by noise at rest the capture seems turned by 0.4 rad, and az is 4 m/s2 off
    found = np.array([result.metadata["attitude alignment"][a]["value"] for a in ("roll", "pitch", "yaw")])
    assert np.abs(found - truth).max() < 0.005
    error = np.abs(applied(result)[0] - BIAS)
    assert error[:3].max() < 0.01 and error[3:].max() < 0.05


def test_cutoff_too_high_for_the_grid_is_lowered_and_said(made):
    result = filter_flight(*made, AIRFRAME, {"low-pass cutoff Hz": 200.0})
    assert about(result.metadata, "too high for a grid")
    notes = []
    assert _cutoff(100.0, 500.0, 500.0 * (1 - 1e-9), notes) == pytest.approx(100.0)
    assert not notes  # the grid's rounding is no lower cut-off
    assert result.metadata["filters"]["low-pass cutoff Hz"] == pytest.approx(100.0)
