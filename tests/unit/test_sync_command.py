"""`quasi sync`: lag, clock rate, lever arm and yaw of a made flight against the ones it was made with."""

import json

import numpy as np
import pandas as pd
import pytest
from made_motion import at_times, body, motive_text
from scipy.spatial.transform import Rotation
from test_synchronisation import BOTH

from quasi.command import main
from quasi.importing.clocks.synchronisation import Motion, synchronise
from quasi.importing.lever_arm_fit import fit_arm
from quasi.importing.sync_files import yaw_difference

ARM, LAG, RATE, YAW, DRIFT = np.array([0.03, -0.012, -0.02]), 1.2345, 4e-5, 0.3, 2e-3
IMU = ("p", "q", "r", "ax", "ay", "az")


def flown(seed, seconds=30.0, arm=ARM):
    """On-board table columns and capture (tau, position, quaternion) of a body whose IMU is at `arm`, with noise.

    On-board yaw is less by YAW + DRIFT t than the true one.
    """
    rng = np.random.default_rng(seed)
    truth = body(seconds, rate=500.0, seed=seed)
    turning = np.gradient(truth.rates, truth.t, axis=0)
    felt = np.cross(turning, arm) + np.cross(truth.rates, np.cross(truth.rates, arm))
    force = truth.force + felt + rng.normal(0, 0.3, truth.force.shape) + [0.05, -0.03, 0.1]
    gyro = truth.rates + rng.normal(0, 0.03, truth.rates.shape)
    turn = Rotation.from_rotvec(np.outer(-(YAW + DRIFT * truth.t), [0, 0, 1]))
    sensed = (turn * Rotation.from_quat(truth.quaternion, scalar_first=True)).as_quat(scalar_first=True)
    tau = np.arange(int((seconds - 3.0) * 120)) / 120 + 1.0
    position, quaternion = at_times(truth, tau + LAG + RATE * tau)
    position = position + rng.normal(0, 1e-4, position.shape)
    jitter = Rotation.from_rotvec(rng.normal(0, 1e-3, position.shape))
    quaternion = (Rotation.from_quat(quaternion, scalar_first=True) * jitter).as_quat(scalar_first=True)
    return Motion(truth.t, gyro, force, sensed), Motion(tau, quaternion=quaternion, position=position)


def aligned(seed, **how):
    onboard, capture = flown(seed, **how)
    return onboard, capture, synchronise(onboard, capture, BOTH, 25.0, "flight")


def test_arm_and_yaw_are_found_within_their_errors():
    onboard, capture, clocks = aligned(1)
    arm, yaw = fit_arm(onboard, capture, clocks), yaw_difference(onboard, capture, clocks)
    assert np.max(np.abs(arm.position - ARM)) < 3e-3
    assert (np.abs(arm.position - ARM) < 4 * arm.std).all() and arm.std.max() < 3e-3
    assert abs(yaw.offset - (YAW + DRIFT * yaw.reference)) < max(4 * yaw.offset_std, 1e-3) and yaw.offset_std < 2e-3
    assert abs(yaw.drift - DRIFT) < 4 * yaw.drift_std


def test_standard_errors_of_arm_and_yaw_are_honest_over_draws():
    ratios = []
    for seed in range(20, 28):
        onboard, capture, clocks = aligned(seed, seconds=30.0)
        arm, yaw = fit_arm(onboard, capture, clocks), yaw_difference(onboard, capture, clocks)
        ratios.append([*((arm.position - ARM) / arm.std), (yaw.offset - YAW - DRIFT * yaw.reference) / yaw.offset_std])
    spread = np.sqrt(np.mean(np.square(ratios), axis=0))
    # 24 values for the arm, 8 for yaw: chi-square bounds of 99.9 % about 1
    assert 0.5 < np.sqrt(np.mean(spread[:3] ** 2)) < 1.7
    assert 0.3 < spread[3] < 1.9


def test_the_arm_has_the_sign_of_the_imu_seen_from_the_point():
    found = [fit_arm(*aligned(2, arm=a)).position for a in (ARM, -ARM)]
    np.testing.assert_allclose(found[0] - found[1], 2 * ARM, atol=4e-3)


def test_without_a_captured_attitude_there_is_no_arm():
    onboard, capture = flown(3)
    bare = Motion(capture.t, position=capture.position)
    clocks = synchronise(onboard, bare, BOTH, 25.0, "flight")
    assert fit_arm(onboard, bare, clocks) is None and yaw_difference(onboard, bare, clocks) is None


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sync")
    onboard, capture = flown(5, seconds=30.0)
    table = {"t": onboard.t} | dict(zip(IMU, np.hstack([onboard.rates, onboard.specific_force]).T))
    table |= dict(zip(("qw", "qx", "qy", "qz"), onboard.quaternion.T))
    pd.DataFrame(table).to_csv(folder / "log.csv", index=False, float_format="%.8f")
    columns = {n: n for n in (*IMU, "qw", "qx", "qy", "qz")}
    mapping = {"time": {"column": "t"}, "sources": [{"name": "all", "columns": columns}]}
    (folder / "drone.json").write_text(json.dumps({"table columns": mapping}))
    frame = np.arange(len(capture.t))
    text = motive_text(frame, capture.t - capture.t[0], capture.position, capture.quaternion, digits=6)
    (folder / "take.csv").write_text(text)
    return folder, capture.t[0]


def test_the_command_ties_a_log_and_a_capture_without_a_project(files, capsys):
    folder, begin = files
    call = ["sync", str(folder / "log.csv"), str(folder / "take.csv"), "--quadrotor", str(folder / "drone.json")]
    assert main([*call, "--json", "-o", str(folder / "found.png")]) == 0
    found = json.loads(capsys.readouterr().out)
    tau = found["lag"]["at capture time"]
    # capture time begins at 0 in the file
    assert found["lag"]["value"] == pytest.approx(begin + LAG + RATE * (tau + begin), abs=1e-3)
    assert found["clock rate"]["value"] == pytest.approx(RATE, abs=2e-5)
    np.testing.assert_allclose(found["lever arm"]["value"], ARM, atol=5e-3)
    assert found["yaw"]["value"] == pytest.approx(YAW + DRIFT * found["yaw"]["at on-board time"], abs=5e-3)
    assert (folder / "found.png").read_bytes().startswith(b"\x89PNG")
    assert main([*call, "-o", str(folder / "again.png")]) == 0
    printed = capsys.readouterr().out
    for name in ("lag", "clock rate", "lever arm", "yaw", "yaw drift"):
        assert f"\n{name} " in printed
    assert "again.png" in printed


def test_a_log_that_is_a_capture_and_a_table_without_columns_are_named(files, tmp_path, capsys):
    folder, _ = files
    assert main(["sync", str(folder / "take.csv"), str(folder / "take.csv")]) == 1
    assert "take.csv" in capsys.readouterr().err
    assert main(["sync", str(folder / "log.csv"), str(folder / "take.csv")]) == 1
    assert "log.csv" in capsys.readouterr().err
    assert main(["sync", str(tmp_path / "none.bbl"), str(folder / "take.csv")]) == 1
    assert "none.bbl" in capsys.readouterr().err


def test_of_several_bodies_the_command_asks_for_one(files, tmp_path, capsys):
    folder, _ = files
    _, capture = flown(5, seconds=30.0)
    frame = np.arange(len(capture.t))
    text = motive_text(frame, capture.t - capture.t[0], capture.position, capture.quaternion, digits=6, other="Cage")
    (tmp_path / "two.csv").write_text(text)
    call = ["sync", str(folder / "log.csv"), str(tmp_path / "two.csv"), "--quadrotor", str(folder / "drone.json")]
    assert main([*call, "-o", str(tmp_path / "p.png")]) == 1
    error = capsys.readouterr().err
    assert "Cage" in error and "Quad" in error
    assert main([*call, "-o", str(tmp_path / "p.png"), "--rigid-body", "Quad"]) == 0
