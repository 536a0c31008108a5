"""What a blackbox log means: units, signs, motor poles, scales and commands, from header to recording."""

import math
import struct
from functools import partial

import numpy as np
import pytest
from blackbox_writer import END, inter_frame, intra_frame, log_bytes, svb

from quasi.airframe import erpm100_to_rad_s
from quasi.errors import ReadError, cautions
from quasi.importing.readers import blackbox_header, blackbox_units
from quasi.importing.readers.blackbox import _about_log, read_blackbox
from quasi.importing.readers.blackbox_header import find_logs

FULL = [
    *((f"gyroADC[{i}]", True) for i in range(3)),
    *((f"accSmooth[{i}]", True) for i in range(3)),
    *((f"motor[{i}]", False) for i in range(4)),
    *((f"eRPM[{i}]", False) for i in range(4)),
    *((f"setpoint[{i}]", True) for i in range(4)),
    ("vbatLatest", False),
    ("amperageLatest", True),
]
FULL_HEADER = (
    "gyro_scale:0x3f800000\nacc_1G:2048\nmotorOutput:158,2047\nmotor_poles:12\nvbatcellvoltage:330,350,430\nfeatures:0"
)
FULL_VALUES = [90, 180, -90, 1024, 2048, 2048, 158, 2047, 347, 725, 100, 200, 300, 400, 90, 90, 90, 500, 1655, 321]


def full_log(header=FULL_HEADER, values=FULL_VALUES, fields=FULL):
    payload = b"".join(map(svb, values))
    body = b"".join(intra_frame(32 * i, 1_000_000 + 1000 * i, payload) for i in range(4))
    return log_bytes(fields, body + END, header=header)


def read_full(tmp_path, poles=None, **changes):
    path = tmp_path / "full.bbl"
    path.write_bytes(full_log(**changes))
    return read_blackbox(path, poles=poles)


def test_units_and_signs_of_every_quantity(tmp_path):
    recording = read_full(tmp_path)
    onboard = recording.series["onboard"]
    value = {name: values[0] for name, values in onboard.values.items()}
    np.testing.assert_allclose(onboard.t, [1.0, 1.001, 1.002, 1.003], rtol=1e-12)
    quarter = math.pi / 2
    # logged axes are x forward, y left, z up
    assert (value["p"], value["q"], value["r"]) == pytest.approx((quarter, -2 * quarter, quarter))
    assert (value["ax"], value["ay"], value["az"]) == pytest.approx((4.905, -9.81, -9.81))
    setpoint = [value[f"setpoint_{axis}"] for axis in "pqr"]
    assert setpoint == pytest.approx([quarter, -quarter, -quarter])
    assert [value[f"command{i}"] for i in range(1, 5)] == pytest.approx([0.0, 1.0, 189 / 1889, 567 / 1889])
    # 10,000 electrical revolutions a minute of 6 pole pairs
    assert value["w1"] == pytest.approx(10_000 / 6 * 2 * math.pi / 60)
    assert (value["throttle"], value["battery_voltage"], value["battery_current"]) == pytest.approx((0.5, 16.55, 3.21))
    assert recording.metadata["motor poles"] == {"value": 12, "source": "header"}
    assert recording.metadata["header"]["motorOutput"] == [158, 2047]


@pytest.mark.parametrize(
    ("header", "poles", "count", "source", "word"),
    [
        ("motor_poles:12", 14, 14, "configuration", "the configuration 14"),
        ("motor_poles:12", None, 12, "header", None),
        ("motor_poles:14", None, 14, "header", "default"),
        ("", None, 14, "assumed", "warning"),
        ("", 12, 12, "configuration", None),
    ],
)
def test_motor_poles_come_from_configuration_then_header_then_default(tmp_path, header, poles, count, source, word):
    recording = read_full(tmp_path, poles=poles, header=FULL_HEADER.replace("motor_poles:12", header))
    assert recording.metadata["motor poles"] == {"value": count, "source": source}
    assert recording.series["onboard"].values["w4"][0] == pytest.approx(400 * erpm100_to_rad_s(count))
    about = [note for note in recording.notes if "poles" in note]
    assert (not about) if word is None else (word in about[0])


@pytest.mark.parametrize(
    ("firmware", "mode", "found"),
    [("4.2.11", 45, True), ("4.5.0", 45, True), ("4.0.6", 47, True), ("4.2.11", 46, False), ("4.2.11", 0, False)],
)
def test_rotor_speeds_of_older_logs_come_from_the_debug_fields(tmp_path, firmware, mode, found):
    fields = [(name.replace("eRPM", "debug"), True) for name, _ in FULL]
    path = tmp_path / "debug.bbl"
    data = full_log(fields=fields, header=FULL_HEADER + f"\ndebug_mode:{mode}")
    path.write_bytes(data.replace(b"Betaflight 4.5.1", f"Betaflight {firmware}".encode()))
    values = read_blackbox(path).series["onboard"].values
    assert ("w1" in values) is found
    if found:
        assert values["w2"][0] == pytest.approx(200 * erpm100_to_rad_s(12))


def test_voltage_unit_follows_the_cell_limits_then_the_firmware(tmp_path):
    old = FULL_HEADER.replace("330,350,430", "33,35,43")
    assert read_full(tmp_path, header=old).series["onboard"].values["battery_voltage"][0] == pytest.approx(165.5)
    none = FULL_HEADER.replace("vbatcellvoltage:330,350,430\n", "")
    assert read_full(tmp_path, header=none).series["onboard"].values["battery_voltage"][0] == pytest.approx(16.55)


@pytest.mark.parametrize(
    ("header", "rate"),
    [
        (FULL_HEADER + "\nblackbox_high_resolution:1", 9.0),
        # 1 deg/s per count stated as rad/us, as before Betaflight 3.1
        (FULL_HEADER.replace("0x3f800000", "0x" + struct.pack(">f", math.radians(1) * 1e-6).hex()), 90.0),
        (FULL_HEADER.replace("gyro_scale:0x3f800000\n", ""), 90.0),
    ],
)
def test_gyro_scale_in_each_of_its_forms(tmp_path, header, rate):
    recording = read_full(tmp_path, header=header)
    assert recording.series["onboard"].values["p"][0] == pytest.approx(math.radians(rate), rel=1e-6)


def test_contradicting_units_are_noticed(tmp_path):
    recording = read_full(tmp_path, header=FULL_HEADER.replace("acc_1G:2048", "acc_1G:64"))
    assert any("contradicts" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("lacking", "said"), [("gyro_scale:0x3f800000", "1 deg/s per count"), ("acc_1G:2048", "2048 counts per g")]
)
def test_scales_that_are_assumed_are_in_doubt(tmp_path, lacking, said):
    assert not cautions(read_full(tmp_path).notes)
    told = cautions(read_full(tmp_path, header=FULL_HEADER.replace(lacking, "")).notes)
    assert len(told) == 1 and said in told[0]


def test_commands_of_analogue_motors_use_the_throttle_range(tmp_path):
    header = FULL_HEADER.replace("motorOutput:158,2047", "minthrottle:1000\nmaxthrottle:2000")
    recording = read_full(tmp_path, header=header, values=[*FULL_VALUES[:6], 1000, 1500, 2000, 1250, *FULL_VALUES[10:]])
    commands = [recording.series["onboard"].values[f"command{i}"][0] for i in range(1, 5)]
    assert commands == pytest.approx([0, 0.5, 1, 0.25])
    assert any("motorOutput" in note for note in recording.notes)


def test_on_board_quaternion_is_turned_to_front_right_down(tmp_path):
    # nose 30 degrees to the left, seen from above: positive about z up, so a yaw of -30 degrees
    z = math.sin(math.radians(15))
    fields = [*FULL, *((f"imuQuaternion[{i}]", True) for i in range(3))]
    recording = read_full(tmp_path, fields=fields, values=[*FULL_VALUES, 0, 0, round(z * 32767)])
    values = recording.series["onboard"].values
    got = [values[name][0] for name in ("qw", "qx", "qy", "qz")]
    assert got == pytest.approx([math.cos(math.radians(15)), 0, 0, -z], abs=1e-4)


def test_longest_log_is_taken_and_any_can_be_chosen(tmp_path):
    one = log_bytes([], intra_frame(0, 1000) + inter_frame(100) + END)
    two = log_bytes([], intra_frame(0, 5000) + inter_frame(9000) + END)
    path = tmp_path / "three.bbl"
    data = one + two + log_bytes([], b"")
    path.write_bytes(data)
    assert [(log["number"], log["frames"]) for log in map(partial(_about_log, data), find_logs(data, str(path)))] == [
        (1, 2),
        (2, 2),
        (3, 0),
    ]
    longest = read_blackbox(path)
    assert longest.metadata["log"] == 2
    assert longest.metadata["duration"] == pytest.approx(0.009)
    [note] = [note for note in longest.notes if "3 logs" in note]
    assert "another: 'Log number' in the logbook, `--log-number` of `quasi noise`" in note
    assert read_blackbox(path, log_number=1).metadata["duration"] == pytest.approx(1e-4)
    with pytest.raises(ReadError, match="choose 1 to 3"):
        read_blackbox(path, log_number=4)
    with pytest.raises(ReadError, match="no readable frame"):
        read_blackbox(path, log_number=3)


@pytest.mark.parametrize("text", ["8\x1e", "²", "9" * 5000, "4\u00a0", "--3"])
def test_header_numbers_that_only_look_so_stay_text(text):
    """Control characters and superscripts count as blanks and digits for Python, but are no numbers."""
    header = {"looptime": text, "debug_mode": text, "Firmware revision": f"Betaflight {text}.{text}"}
    assert blackbox_header.plain_header(header)["looptime"] == text
    assert blackbox_units.debug_mode(header) is None
    assert blackbox_header.version(header) is None
