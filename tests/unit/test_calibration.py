"""Calibrations: the definitions undone, and a flight's raw logs processed anew no longer show what was found."""

import numpy as np
import pytest
from made_recordings import planted
from scipy.spatial.transform import Rotation

from quasi import attitude
from quasi.errors import ConfigError
from quasi.gap.catalogue import catalogue
from quasi.gap.flights.level import Level
from quasi.gap.levels import corrections
from quasi.gap.levels.drive import identify as drive_level
from quasi.gap.levels.sensors import identify as sensor_level
from quasi.importing.calibration import check, is_identity, true_inertial, true_pose

ACTUATORS = {  # of the vehicle that made flights are of
    "time constants": {"value": [0.026] * 4},
    "time constants up": {"value": [0.022] * 4},
    "time constants down": {"value": [0.030] * 4},
    "delay": {"value": [0.0008] * 4},
    "command map": {
        "coefficients": [385.4, 4659.0, -1211.1], "powers": [0, 1, 2], "reference voltage": 15.76,
        "voltage exponent": {"value": 0.994},
    },
}  # fmt: skip


def test_what_is_examined_and_corrected_bears_the_catalogues_names_and_units():
    causes = catalogue()
    for cause, effect in sensor_level.SENSOR_CAUSES.items():
        assert effect.level == "sensors"
        assert len({(p.unit, p.neutral) for p in effect.parameters.values()}) == 1
        assert (effect.corrects is None) == (cause == "attitude_error")
    assert set(drive_level.DRIVE_CAUSES) <= set(causes)
    for cause, (_, _, names) in corrections.CORRECTS.items():
        assert tuple(causes[cause].parameters) == names


def test_an_unknown_part_a_wrong_number_and_an_impossible_scale_are_one_sentence_each():
    with pytest.raises(ConfigError, match="no part 'imus'.*did you mean 'imu'"):
        check({"imus": {}})
    with pytest.raises(ConfigError, match="has no 'gyro scal'"):
        check({"imu": {"gyro scal": [1, 1, 1]}})
    with pytest.raises(ConfigError, match="expected 3 finite numbers, above zero"):
        check({"imu": {"gyro scale": [1.0, 0.0, 1.0]}})
    with pytest.raises(ConfigError, match="expected 1 finite number"):
        check({"clock": {"rate": [0.1, 0.2]}})
    with pytest.raises(ConfigError, match=r"expected 'quasi.calibration/1'"):
        check({"schema": "other"})
    assert is_identity(None)
    assert is_identity({"imu": {"gyro scale": [1, 1, 1]}, "clock": {"rate": 0.0}})
    assert not is_identity({"telemetry": {"age": 0.001}})


def test_inertial_faults_are_undone_as_they_are_defined():
    rng = np.random.default_rng(1)
    rates, force = rng.normal(size=(50, 3)), rng.normal(size=(50, 3))
    turn, scale, bias = np.array([0.05, -0.03, 0.02]), np.array([1.02, 0.97, 1.01]), np.array([0.01, 0.02, -0.03])
    seen = Rotation.from_rotvec(turn).inv()
    gyro, felt = (seen.apply(v) * scale + bias for v in (rates, force))
    imu = check({"imu": {"misalignment": turn, "gyro scale": scale, "gyro bias": bias, "accelerometer scale": scale,
                         "accelerometer bias": bias}})["imu"]  # fmt: skip
    for recovered, truth in zip(true_inertial(gyro, felt, imu), (rates, force)):
        np.testing.assert_allclose(recovered, truth, atol=1e-12)


def test_faults_of_the_capture_are_undone_as_they_are_defined():
    t = np.arange(0.0, 4.0, 0.005)
    true = Rotation.from_euler("ZYX", np.stack([0.5 * np.sin(t), 0.3 * np.sin(2 * t), 0.2 * np.cos(3 * t)], axis=1))
    place = np.stack([np.sin(t), np.cos(2 * t), t], axis=1)
    arm, late, markers, tilt = np.array([0.01, -0.02, -0.05]), 0.010, (0.03, 0.02, -0.04), (0.02, -0.03)
    room = Rotation.from_rotvec([*tilt, 0.0])
    behind = t - late
    old = Rotation.from_euler(
        "ZYX", np.stack([0.5 * np.sin(behind), 0.3 * np.sin(2 * behind), 0.2 * np.cos(3 * behind)], axis=1)
    )
    seen = room.inv() * old * Rotation.from_rotvec(markers)
    position = room.inv().apply(place + true.apply(arm)) - seen.apply(arm)
    capture = check({"capture": {"misalignment": markers, "room tilt": tilt, "rotation delay": late}})["capture"]
    where, turned = true_pose(t, position, seen.as_quat(scalar_first=True), arm, capture)
    inside = slice(5, -5)
    apart = attitude.multiply(attitude.conjugate(turned), true.as_quat(scalar_first=True))
    assert np.abs(attitude.logarithm(apart))[inside].max() < 1e-4
    assert np.abs(where - place)[inside].max() < 1e-5


def test_changes_are_corrected_in_compared_flights_alone_and_scales_multiply():
    effect = {"parameters": {a: {"value": v} for a, v in zip("xyz", (1.02, 1.0, 0.99))}}
    level = Level("sensors", effects=[
        {"id": "gyro_scale", "since": "always", **effect}, {"id": "gyro_scale", "since": "changed", **effect},
        {"id": "clock_drift", "since": "changed", "parameters": {"rate": {"value": 1e-3}}},
        {"id": "motor_lag", "since": "changed", "parameters": {"time_constant": {"value": 0.04}}},
    ])  # fmt: skip
    whole = corrections.document([level])
    compared, reference = (corrections.for_flight(whole, flag) for flag in (True, False))
    np.testing.assert_allclose(compared["imu"]["gyro scale"], [1.02**2, 1.0, 0.99**2])
    np.testing.assert_allclose(reference["imu"]["gyro scale"], [1.02, 1.0, 0.99])
    assert compared["clock"] == {"rate": 1e-3}
    assert "clock" not in reference
    assert corrections.for_flight(corrections.document([]), True) is None


def test_of_a_tie_the_settled_member_is_corrected_else_the_first_with_a_note():
    turn = {n: {"value": 0.02} for n in ("roll", "pitch", "yaw")}
    tie = {"ids": ["imu_misalignment", "mocap_misalignment"], "since": "always",
           "parameters": {"imu_misalignment": turn, "mocap_misalignment": turn}}  # fmt: skip
    whole = corrections.document([Level("sensors", ties=[tie])], settled=("mocap_misalignment", tie["since"]))
    assert list(whole["compared"]) == ["capture"]
    assert not whole["notes"]
    whole = corrections.document([Level("sensors", ties=[tie])])
    assert list(whole["compared"]) == ["imu"]
    assert "look alike" in whole["notes"][0]


EFFECTS = {
    "gyro_scale": {"x": 1.02}, "accelerometer_scale": {"z": 0.98}, "imu_lever_arm": {"x": 0.012, "y": -0.008},
    "room_tilt": {"roll": 0.012, "pitch": -0.008}, "mocap_delay": {"delay": 0.006}, "clock_drift": {"rate": 1e-3},
    "telemetry_delay": {"delay": 0.006}, "motor_lag": {"time_constant": 0.04},
}  # fmt: skip


def test_eight_faults_at_once_are_told_from_raw_logs_and_gone_when_these_are_processed_anew(tmp_path):
    process, _ = planted(tmp_path, EFFECTS, 900, 24.0)

    def levels(applied):
        flights = process(applied)
        return sensor_level.examine(flights, {}), drive_level.examine(
            flights, {"id": "made", "actuators": ACTUATORS}, {}
        )

    sensors, drive = levels(None)
    assert not sensors.ties
    found = {e["id"]: e["parameters"] for e in (*sensors.effects, *drive.effects)}
    (late,) = drive.ties
    assert set(late["ids"]) == {"telemetry_delay", "command_delay"}
    found["telemetry_delay"] = late["parameters"]["telemetry_delay"]
    assert set(found) == set(EFFECTS)
    for cause, parameters in EFFECTS.items():
        for name, truth in parameters.items():
            value, std = found[cause][name]["value"], found[cause][name]["std"]
            assert abs(value - truth) < 4.0 * std, (cause, name, value, std, truth)
    whole = corrections.document([sensors, drive], settled=("telemetry_delay", late["since"]))
    sensors, drive = levels(corrections.for_flight(whole, True))
    assert not sensors.effects
    assert not sensors.ties
    assert [e["id"] for e in drive.effects] == ["motor_lag"]
    assert not drive.ties
