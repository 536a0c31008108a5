"""Crazyflie micro-SD logs: layout, units, axes by an independent rotation, damage, and the real flights."""

import struct

import numpy as np
import pytest
from crazyflie_writer import encode_log
from recordings import SHARED
from scipy.spatial.transform import Rotation

from quasi.errors import ReadError, cautions
from quasi.importing.readers.crazyflie import TIME_COLUMN, read_crazyflie
from quasi.importing.readers.crazyflie_events import decode_events
from quasi.project.recognition import recognise

CRAZYPAD = SHARED.parent / "crazypad"
needs_crazypad = pytest.mark.skipif(not CRAZYPAD.is_dir(), reason=f"the flights of CrazyPAD are not at {CRAZYPAD}")
N = 60
ANGLES = Rotation.from_euler("ZYX", [0.4, 0.2, -0.3])  # body FLU to room z up


def names():
    estimate = [f"stateEstimate.{v}(f)" for v in ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw")]
    sensors = [f"{group}.{axis}(f)" for group in ("gyro", "acc") for axis in "xyz"]
    return [*estimate, *sensors, *(f"motor.m{i}(H)" for i in range(1, 5)), "pm.vbatMV(H)"]


def rows(wave=0.0):
    """One attitude, values that differ from row to row so that none is held; pitch as the firmware has it."""
    yaw, pitch, roll = ANGLES.as_euler("ZYX", degrees=True)
    out = []
    for i in range(N):
        e = wave * np.sin(0.3 * i) + 1e-4 * i
        out.append([1 + e, 2 + e, 3 + e, 0.1 + e, 0.2 + e, 0.3 + e, roll, -pitch, yaw, 10 + e, 20 + e, 30 + e,
                    0.1 + e, 0.2 + e, 0.9 + e, 0, 65535, 32768, 1000 + i, 3712])  # fmt: skip
    return out


def write(path, version=2, cut=0, **changes):
    data = encode_log({65535: ("fixedFrequency", names())},
                      [(65535, 5.0 + 0.01 * i, row) for i, row in enumerate(rows())], version)  # fmt: skip
    data = data[: len(data) - cut] if cut else data
    path.write_bytes(changes.get("instead", data))
    return data


@pytest.mark.parametrize("version", [1, 2])
def test_units_and_axes_agree_with_an_independent_rotation(tmp_path, version):
    write(tmp_path / "log00", version)
    recording = read_crazyflie(tmp_path / "log00")
    values = recording.series["onboard"].values
    half = np.diag([1.0, -1.0, -1.0])  # half a turn about x: FLU to FRD, z up to z down
    np.testing.assert_allclose(recording.series["onboard"].t, 0.01 * np.arange(N), atol=1e-3)
    first = {n: v[0] for n, v in values.items()}
    np.testing.assert_allclose([first[n] for n in "xyz"], half @ [1, 2, 3], atol=1e-5)
    np.testing.assert_allclose([first[n] for n in ("vx", "vy", "vz")], half @ [0.1, 0.2, 0.3], atol=1e-5)
    np.testing.assert_allclose([first[n] for n in "pqr"], half @ np.radians([10, 20, 30]), rtol=1e-5)
    np.testing.assert_allclose([first[n] for n in ("ax", "ay", "az")], 9.80665 * half @ [0.1, 0.2, 0.9], rtol=1e-5)
    turned = Rotation.from_quat([first["qx"], first["qy"], first["qz"], first["qw"]])
    np.testing.assert_allclose(turned.as_matrix(), half @ ANGLES.as_matrix() @ half, atol=1e-6)
    np.testing.assert_allclose([first[f"command{i}"] for i in range(1, 4)], [0.0, 1.0, 32768 / 65535])
    assert first["battery_voltage"] == pytest.approx(3.712)
    assert recording.metadata["checksum"] == "right"
    assert not recording.notes


def test_angles_stay_single_where_pitch_is_not_logged(tmp_path):
    variables = ["stateEstimate.x(f)", "stateEstimate.y(f)", "stateEstimate.z(f)", "stateEstimate.roll(f)",
                 "stateEstimate.yaw(f)", "stateEstimate.vx(f)"]  # fmt: skip
    data = encode_log({1: ("a", variables)}, [(1, 0.01 * i, [i, 2 * i, 3, 10, 20, 1]) for i in range(N)])
    (tmp_path / "log").write_bytes(data)
    values = read_crazyflie(tmp_path / "log").series["onboard"].values
    assert {"roll", "yaw"} <= set(values)
    assert not {"pitch", "qw", "vx", "vy"} & set(values)  # one component is no velocity
    assert np.degrees(values["roll"][0]) == pytest.approx(10)
    assert np.degrees(values["yaw"][0]) == pytest.approx(-20)


def test_a_mapping_replaces_the_standard_names_and_reads_other_event_types(tmp_path):
    types = {1: ("imu", ["g.x(f)", "g.y(f)", "g.z(f)"]), 2: ("power", ["bat(f)"])}
    records = [(1, 0.01 * i, [i, 2, 3]) for i in range(N)] + [(2, 0.02 * i, [3.5 + i]) for i in range(N // 2)]
    (tmp_path / "log").write_bytes(encode_log(types, sorted(records, key=lambda r: r[1])))
    mapping = {
        "time": {"column": TIME_COLUMN},
        "sources": [
            {"name": "imu", "columns": {n: {"column": f"g.{a}", "unit": "deg/s"} for n, a in zip("pqr", "xyz")}},
            {"name": "power", "columns": {"battery_voltage": "power/bat"}},
        ],
    }
    series = read_crazyflie(tmp_path / "log", mapping).series
    assert len(series["onboard"].t) == N
    np.testing.assert_allclose(series["onboard power"].t, 0.02 * np.arange(N // 2), atol=1e-6)
    assert series["onboard power"].values["battery_voltage"][3] == pytest.approx(6.5)


def test_a_wrong_checksum_is_a_doubt(tmp_path):
    data = bytearray(write(tmp_path / "log"))
    data[-1] ^= 1
    (tmp_path / "log").write_bytes(data)
    recording = read_crazyflie(tmp_path / "log")
    assert recording.metadata["checksum"] == "wrong"
    assert any("checksum" in note for note in cautions(recording.notes))


@pytest.mark.parametrize("cut", [4, 30, 200])
def test_a_truncated_log_is_read_up_to_its_last_whole_record(tmp_path, cut):
    write(tmp_path / "log", cut=cut)
    recording = read_crazyflie(tmp_path / "log")
    size = 10 + 15 * 4 + 5 * 2
    assert len(recording.series["onboard"].t) == N - int(np.ceil((cut - 4) / size))
    assert recording.metadata["checksum"] == "missing"
    assert recording.metadata["ended"] is False
    assert any("no checksum" in note for note in cautions(recording.notes))


def test_an_unknown_id_ends_what_is_read_and_is_named(tmp_path):
    data = write(tmp_path / "log")
    size = 10 + 15 * 4 + 5 * 2
    at = len(data) - 4 - 10 * size
    (tmp_path / "log").write_bytes(data[:at] + struct.pack("<H", 4711) + data[at + 2 :])
    recording = read_crazyflie(tmp_path / "log")
    assert len(recording.series["onboard"].t) == N - 11
    assert any("4711" in note and str(at) in note for note in cautions(recording.notes))


def test_the_record_in_which_bytes_are_missing_is_left_out(tmp_path):
    data = write(tmp_path / "log")
    whole = read_crazyflie(tmp_path / "log").series["onboard"]
    at = len(data) - 4 - 10 * (10 + 15 * 4 + 5 * 2)
    (tmp_path / "log").write_bytes(data[: at + 20] + data[at + 57 :])
    cut = read_crazyflie(tmp_path / "log").series["onboard"]
    assert len(cut.t) == N - 10
    for name, values in cut.values.items():
        np.testing.assert_array_equal(values, whole.values[name][: N - 10])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "empty"),
        (b"\xbc\x02", "header"),
        (b"\xbb\x02\x00", "0xBC"),
        (b"\xbc\x03\x00\x01\x00", "version 3"),
        (b"\xbc\x02\x00\x00\x00", "no event type"),
        (b"\xbc\x02\x00\x01\x00\x01\x00abc\x00\x01\x00x(z)\x00", "'x\\(z\\)'"),
        (b"\xbc\x02\x00\x01\x00\x01\x00abc\x00\x02\x00x(f)\x00", "variable 2 of abc"),
        (b"\xbc\x02\x00\x01\x00\x01\x00abc\x00\x01\x00x(f)\x00", "0 of abc"),
    ],
)
def test_what_is_no_log_is_refused_with_the_file_and_the_place(tmp_path, content, says):
    (tmp_path / "log").write_bytes(content)
    with pytest.raises(ReadError, match=says) as caught:
        read_crazyflie(tmp_path / "log")
    assert "log" in str(caught.value)


def test_it_is_recognised_by_content():
    assert recognise(encode_log({1: ("a", ["b.c(f)"])}, [])).kind == "crazyflie"


@needs_crazypad
def test_all_85_flights_are_read_whole():
    files = sorted(CRAZYPAD.glob("*/E8_log*"))
    assert len(files) == 85
    for path in files:
        log = decode_events(path.read_bytes(), path)
        assert (log.checksum, log.ending) == ("right", []), path
        assert len(log.types[65535].chunks) > 2500


@needs_crazypad
def test_the_sign_of_the_logged_roll_agrees_with_the_motion():
    """Specific force from the logged acceleration, turned by yaw alone, leans where roll says, in NED and FRD."""
    agree = []
    for path in sorted(CRAZYPAD.glob("cut_propeller_M3_3*/E8_log00")):
        values = read_crazyflie(path).series["onboard"].values
        smooth = {
            n: np.convolve(values[n], np.ones(11) / 11, "same") for n in ("linear_ax", "linear_ay", "roll", "yaw")
        }
        flying = (values["z"] < -0.3) & (values["command1"] > 0.1)
        right = -np.sin(smooth["yaw"]) * smooth["linear_ax"] + np.cos(smooth["yaw"]) * smooth["linear_ay"]
        agree.append(np.corrcoef(right[flying], smooth["roll"][flying])[0, 1])
        assert np.median(values["z"][flying]) < 0.0
    assert np.min(agree) > 0.5
