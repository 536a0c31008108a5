"""INDIflight logs, as CSV and as binary, against the motion they were made from."""

import numpy as np
import pytest
from blackbox_writer import END, intra_frame, log_bytes, svb
from made_motion import at_times, body
from scipy.spatial.transform import Rotation

from quasi.attitude import from_euler
from quasi.errors import ReadError
from quasi.importing.flight import import_flight
from quasi.importing.readers.external import messages

LATE = 0.012  # s between the capture and its message in the log
HEAD = '"Product","Blackbox flight data recorder by Nicholas Sherlock"\n"motorOutput","158,2047"\n'
FIELDS = (
    [f"quat[{i}]" for i in range(4)]
    + [f"{name}[{i}]" for name in ("gyroADCafterRpm", "gyroADC", "accADCafterRpm", "accSmooth") for i in range(3)]
    + [f"omegaUnfiltered[{i}]" for i in range(4)]
    + [f"motor[{i}]" for i in range(4)]
    + [f"{name}[{i}]" for name in ("extPos", "pos", "extVel", "vel") for i in range(3)]
)


def held(values, every):
    """Rows that repeat the last message."""
    return values[(np.arange(len(values)) // every) * every]


@pytest.fixture(scope="module")
def flown():
    """Truth, rotor speeds (n, 4) rad/s, and the raw integers of the log's rows."""
    rate = 500.0
    truth = body(30.0, rate=rate, rest=4.0)
    rng = np.random.default_rng(4)
    speed = np.gradient(truth.position, truth.t, axis=0)
    rotors = 900 + 60 * np.stack([np.sin(truth.t * (k + 2)) for k in range(4)], axis=-1)
    place, _ = at_times(truth, truth.t - LATE)
    moving = np.stack([np.interp(truth.t - LATE, truth.t, v) for v in speed.T], axis=-1)
    gyro = np.degrees(truth.rates) + rng.normal(0, 1, truth.rates.shape)
    force = truth.force / 9.81 * 2048 + rng.normal(0, 30, truth.force.shape)
    blocks = [
        truth.quaternion * 8127, gyro, gyro * 0.5, force, force * 0.5, rotors, 158 + 0.4 * 1889 + 0 * rotors,
        held(place, 5) * 1000, held(place, 5) * 1000 + 400, held(moving, 5) * 100, held(moving, 5) * 100 + 90,
    ]  # fmt: skip
    return truth, speed, rotors, np.rint(np.hstack(blocks)).astype(int)


def as_csv(folder, flown, fields=FIELDS, head=HEAD):
    truth, _, _, table = flown
    chosen = [FIELDS.index(f) for f in fields]
    lines = [head + ",".join(f'"{n}"' for n in ["loopIteration", "time", *fields])]
    stamps = np.rint(truth.t * 1e6).astype(int) + 12_000_000
    lines += [",".join(map(str, [i, stamps[i], *table[i, chosen]])) for i in range(len(table))]
    (folder / "indi.csv").write_text("\n".join(lines) + "\n")
    return {"flight": "i", "quadrotor": "Q", "flight controller": "indiflight", "onboard": str(folder / "indi.csv")}


def truth_at(truth, values, frame, about):
    at = frame["t"].to_numpy() + about["start"]["value"]
    return np.stack([np.interp(at, truth.t, v) for v in values.T], axis=-1)


def check(flown, frame, about):
    truth, speed, rotors, _ = flown
    at = frame["t"].to_numpy() + about["start"]["value"]
    inner = (at > 5.0) & (at < 29.0)

    def rms(columns, values):
        error = frame[list(columns)].to_numpy() - truth_at(truth, values, frame, about)
        return np.sqrt(np.mean(error[inner] ** 2))

    in_body = Rotation.from_quat(truth.quaternion, scalar_first=True).inv().apply(speed)
    assert rms("xyz", truth.position) < 0.004
    assert rms("uvw", in_body) < 0.05 < 0.3 * np.std(in_body - speed)  # earth axes would be far off
    assert rms("pqr", truth.rates) < 0.05
    assert rms(("ax", "ay", "az"), truth.force) < 0.3
    assert rms([f"w{i}" for i in range(1, 5)], rotors) < 1.0
    assert "w5" not in frame
    attitude = from_euler(*frame[["roll", "pitch", "yaw"]].to_numpy().T)
    _, true = at_times(truth, at)
    away = Rotation.from_quat(attitude, scalar_first=True).inv() * Rotation.from_quat(true, scalar_first=True)
    assert np.degrees(np.sqrt(np.mean(away.magnitude()[inner] ** 2))) < 1.0
    assert about["attitude source"] == "onboard"
    assert (about["position source"], about["velocity source"]) == ("capture", "capture position")
    external = about["sources"]["onboard"]["external motion"]
    assert external["fields"] == "extPos and extVel"
    assert external["rate"] == pytest.approx(100.0)
    lag = about["synchronisation"]["lag"]
    assert lag["value"] == pytest.approx(-LATE - 0.0, abs=max(2e-3, 4 * lag["std"]))
    assert frame["position_sample"][inner].mean() == pytest.approx(0.2, abs=0.02)
    assert about["logged to rad/s"] is None  # what an idle RPM is in, eRPM/100, takes a pole count
    assert about["sources"]["onboard"]["units"]["rotor speed"]["factor"] == 1.0


def test_csv_with_four_omega_columns_comes_out_as_the_truth(tmp_path, flown):
    frame, about = import_flight(as_csv(tmp_path, flown), {}, {"resampling rate": 500})
    check(flown, frame, about)
    assert frame["command1"].to_numpy() == pytest.approx(0.4, abs=1e-3)
    assert about["corrections"]["gyro filter delay"]["value"] == 0.0


def test_binary_log_comes_out_as_the_csv(tmp_path, flown):
    truth, _, _, table = flown
    fields = [(name, True) for name in FIELDS]
    frames = b"".join(
        intra_frame(32 * i, 12_000_000 + 2000 * i, b"".join(map(svb, row))) for i, row in enumerate(table.tolist())
    )
    header = (
        "Firmware revision:INDIflight 1.0.0 (1234567) HOOP\ngyro_scale:0x3f800000\nacc_1G:2048\nmotorOutput:158,2047\n"
        "gyro_lpf1_static_hz:100\nI interval:32\nP interval:1/32"
    )
    path = tmp_path / "indi.bfl"
    path.write_bytes(log_bytes(fields, frames + END, header=header))
    flight = {"flight": "i", "quadrotor": "Q", "flight controller": "indiflight", "onboard": str(path)}
    frame, about = import_flight(flight, {}, {"resampling rate": 500})
    check(flown, frame, about)
    # gyroADCafterRpm is taken before the low-pass filters
    assert about["corrections"]["gyro filter delay"]["value"] == 0.0


def test_without_captured_motion_the_on_board_estimate_serves(tmp_path, flown):
    fields = [f for f in FIELDS if not f.startswith("ext")]
    frame, about = import_flight(as_csv(tmp_path, flown, fields, head=""), {}, {})
    assert about["position source"] == about["velocity source"] == "onboard"
    assert any("motor output range" in n for n in about["notes"])
    assert frame["x"].iloc[3000] == pytest.approx(
        truth_at(flown[0], flown[0].position, frame, about)[3000, 0] + 0.4, abs=0.05
    )


def test_captured_velocity_alone_is_turned_into_body_axes(tmp_path, flown):
    truth, speed, _, _ = flown
    fields = [f for f in FIELDS if f[:3] not in ("pos", "vel") and not f.startswith("extPos")]
    frame, about = import_flight(as_csv(tmp_path, flown, fields), {}, {})
    assert about["velocity source"] == "onboard"
    in_body = Rotation.from_quat(truth.quaternion, scalar_first=True).inv().apply(speed)
    error = frame[list("uvw")].to_numpy() - truth_at(truth, in_body, frame, about)
    assert np.sqrt(np.mean(error[2500:-500] ** 2)) < 0.1


def test_a_log_of_another_firmware_is_refused(tmp_path, flown):
    fields = [f for f in FIELDS if f.startswith(("gyroADC[", "accSmooth"))]
    with pytest.raises(ReadError, match="not from INDIflight"):
        import_flight(as_csv(tmp_path, flown, fields), {}, {})


def test_the_log_counts_more_than_the_logbook(tmp_path, flown):
    flight = as_csv(tmp_path, flown) | {"flight controller": "betaflight"}
    frame, about = import_flight(flight, {}, {})
    check(flown, frame, about)
    assert any("comes from INDIflight" in n for n in about["notes"])


def test_captured_motion_that_never_changes_is_said(tmp_path, flown):
    truth, speed, rotors, table = flown
    still = table.copy()
    still[:, [i for i, f in enumerate(FIELDS) if f.startswith("ext")]] = 0
    _, about = import_flight(as_csv(tmp_path, (truth, speed, rotors, still)), {}, {})
    assert about["position source"] == "onboard"
    assert any("no captured motion reached the flight controller" in n for n in about["notes"])


def test_repeated_rows_are_one_message_and_a_jump_after_a_pause_is_none():
    x = np.repeat([0.0, 0.01, 0.02, 0.02, 0.02, 0.02, 0.03, 0.04, 0.04, 0.04, 0.04, 0.5, 0.51], 4)[:, None]
    assert messages(x, np.array([0.02])).tolist() == [0, 4, 8, 12, 16, 20, 24, 28, 44, 48]
