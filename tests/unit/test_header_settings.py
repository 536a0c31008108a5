"""Settings in a log's header: off, absent, absurd or cut; other firmware; high resolution."""

import math

import numpy as np
import pytest
from blackbox_writer import END, intra_frame, log_bytes, svb, uvb
from cases import case_file, flight_of, needs_cases

from quasi.errors import cautions, quoted
from quasi.importing.clocks.filter_delays import RPM_NOTCHES, STAGES, delay, header_delays
from quasi.importing.flight import import_flight
from quasi.importing.readers.blackbox import read_blackbox
from quasi.importing.readers.decoded import read_decoded

SETTINGS = [
    *(name for stage in (*STAGES, *RPM_NOTCHES) for name in stage if name),
    *("gyro_notch_hz", "gyro_notch_cutoff", "acc_lpf_hz", "dshot_bidir"),
    *(f"dyn_notch_{name}" for name in ("count", "q", "min_hz", "max_hz")),
]
GYRO = [(f"gyroADC[{i}]", True) for i in range(3)]


def log(header, fields=GYRO, intra=None, frames=40, row=None):
    body = b"".join(
        intra_frame(i, 1000 * i, row(i) if row else b"".join(svb(k + i) for k in range(len(fields))))
        for i in range(frames)
    )
    return log_bytes(fields, body + END, header=header + "\nI interval:1", intra=intra)


def write(path, content):
    path.write_bytes(content)
    return path


def test_a_dynamic_range_from_0_is_off_and_the_static_filter_counts():
    gyro = header_delays({"gyro_lpf1_static_hz": 250, "gyro_lpf1_dyn_hz": [0, 500], "acc_lpf_hz": 2500})["gyro"]
    assert gyro["value"] == pytest.approx(1 / (2 * math.pi * 250))
    assert (gyro["std"], gyro["known"]) == (0.0, True)
    both_off = header_delays({"gyro_lpf1_static_hz": 0, "gyro_lpf1_dyn_hz": [0, 500]})["gyro"]
    assert (both_off["value"], both_off["std"], both_off["known"]) == (0.0, 0.0, True)


@pytest.mark.parametrize(
    "value", [0, -1, [0, 0], [-5, 10**17], [500], 10**18, -(10**18), "", "x", "1e308", "nan", [0, 500]]
)
def test_no_setting_raises_or_delays_by_more_than_a_filter_can(value):
    for key in SETTINGS:
        usual = {"gyro_lpf1_static_hz": 250, "acc_lpf_hz": 2500, "dyn_notch_min_hz": 100, "dyn_notch_max_hz": 600}
        for one in header_delays({**usual, "dyn_notch_q": 300, key: value}).values():
            assert 0.0 <= one["value"] < 0.1 and 0.0 <= one["std"] < 0.1, key


@pytest.mark.parametrize(
    ("key", "value"), [("gyro_lpf1_static_hz", -3), ("gyro_lpf1_type", 9), ("dyn_notch_count", 10**9)]
)
def test_a_setting_that_no_firmware_writes_leaves_the_delay_unknown_and_is_named(key, value):
    found = header_delays({"gyro_lpf2_static_hz": 500, "gyro_lpf1_static_hz": 200, key: value})["gyro"]
    assert not found["known"] and found["std"] >= 2e-3
    assert any(key in name for name in found["filters"])


def test_lost_header_lines_and_other_firmware_leave_delays_unknown():
    usual = {"gyro_lpf1_static_hz": 250, "acc_lpf_hz": 2500}
    for found in (
        header_delays(usual, complete=False),
        header_delays({**usual, "Firmware revision": "INAV 5.1.0 (norevision) MATEKF722"}),
    ):
        assert not found["gyro"]["known"] and found["gyro"]["value"] == pytest.approx(delay("PT1", 250.0))
        assert found["gyro"]["std"] == 2e-3 and found["accelerometer"]["std"] == 20e-3


def test_a_firmware_revision_that_is_a_number_stops_nothing(tmp_path):
    content = log("").replace(b"Betaflight 4.5.1 (77d01ba3b) STM32F7X2", b"0")
    found = read_blackbox(write(tmp_path / "a.bbl", content))
    assert header_delays(found.metadata["header"])["gyro"]["value"] == 0.0


def test_fields_predicted_from_an_absent_line_are_left_out_and_the_line_is_named(tmp_path):
    fields = [*GYRO, ("vbatLatest", False), ("motor[0]", False), ("motor[1]", False), ("rcCommand[3]", False)]
    intra = ([0, 0, 0, 3, 1, 0, 1], [0, 0, 0, 9, 11, 5, 4])
    row = lambda i: b"".join(svb(7) for _ in range(3)) + uvb(0) + uvb(10) + svb(1) + uvb(0)  # noqa: E731
    lines = {"vbatref": "1650", "motorOutput": "158,2047", "minthrottle": "1070"}
    whole = read_blackbox(
        write(tmp_path / "a.bbl", log("\n".join(f"{k}:{v}" for k, v in lines.items()), fields, intra, row=row))
    )
    values = whole.series["onboard"].values
    assert values["battery_voltage"][0] == pytest.approx(16.5) and values["command2"][0] == pytest.approx(11 / 1889)
    for line, gone in (
        ("vbatref", {"battery_voltage"}),
        ("motorOutput", {"command1", "command2"}),
        ("minthrottle", {"throttle"}),
    ):
        header = "\n".join(f"{k}:{v}" for k, v in lines.items() if k != line)
        found = read_blackbox(write(tmp_path / f"{line}.bbl", log(header, fields, intra, row=row)))
        assert set(values) - set(found.series["onboard"].values) == gone
        assert any(f"'{line}'" in note for note in cautions(found.notes))


def test_a_header_cut_within_a_line_keeps_raw_bytes_out_of_settings_and_notes(tmp_path):
    content = log("gyro_scale:0x3f800000\nacc_1G:2048")
    at = content.index(b"acc_1G:2") + 8
    found = read_blackbox(write(tmp_path / "cut.bbl", content[:at] + content[content.index(b"I\x00\x00") :]))
    assert "acc_1G" not in found.metadata["header"] and found.metadata["header lines lost"] == 1
    assert len(found.series["onboard"].t) >= 38
    assert all(note.isprintable() for note in found.notes)


@pytest.mark.parametrize("line", ["I interval:0", "I interval:x", "P interval:-4", "P interval:1/99999999999"])
def test_unusable_intervals_stop_nothing(tmp_path, line):
    content = log("").replace(b"I interval:32\n", b"").replace(b"P interval:1\n", b"")
    key = line.partition(":")[0]
    content = content.replace(b"H I interval:1\n", b"") if key == "I interval" else content
    found = read_blackbox(
        write(tmp_path / "a.bbl", content.replace(b"H Firmware type", f"H {line}\nH Firmware type".encode()))
    )
    assert len(found.series["onboard"].t) == 40
    assert any("I interval" in note for note in found.notes)


def test_file_text_in_messages_is_printable_and_short():
    assert quoted("2I\x07" + "x" * 500) == "'2I?" + "x" * 37 + "...'"


@pytest.mark.parametrize(
    "revision", ["INAV 5.1.0 (abc) F722", "EmuFlight 0.4.1 (abc) F7", "Rotorflight 4.3.0 (abc) F7"]
)
def test_other_firmware_calls_for_care_and_its_debug_numbers_are_unknown(tmp_path, revision):
    fields = [*GYRO, *((f"debug[{i}]", True) for i in range(4))]
    content = log("debug_mode:45", fields)
    own = read_blackbox(write(tmp_path / "own.bbl", content))
    assert "w1" in own.series["onboard"].values
    other = content.replace(b"Betaflight 4.5.1 (77d01ba3b) STM32F7X2", revision.encode())
    found = read_blackbox(write(tmp_path / "other.bbl", other))
    assert "w1" not in found.series["onboard"].values
    assert found.metadata["debug mode"] == {"number": 45, "name": ""}
    assert any(revision in note for note in cautions(found.notes))


def test_erpm_fields_of_development_builds_are_read(tmp_path):
    fields = [*GYRO, *((f"eRPM(/100)[{i}]", False) for i in range(4))]
    found = read_blackbox(write(tmp_path / "a.bbl", log("motor_poles:14", fields)), poles=14)
    # eRPM/100 of 3 at the first frame: 300 / 7 pole pairs in rpm
    assert found.series["onboard"].values["w1"][0] == pytest.approx(3 * 100 / 7 * 2 * math.pi / 60)
    names = ["time (us)", "gyroADC[0] (deg/s)", "motor[0]", *(f"eRPM(/100)[{i}]" for i in range(4))]
    rows = [",".join(map(str, [1000 * i, 0, 0, 3, 3, 3, 3])) for i in range(30)]
    text = "\n".join([",".join(names), *rows])
    again = read_decoded(write(tmp_path / "a.csv", text.encode()), poles=14)
    assert again.series["onboard"].values["w1"][0] == found.series["onboard"].values["w1"][0]


@pytest.mark.parametrize(("fine", "gyro"), [(10, 10), (10, 1), (1, 1)])
def test_high_resolution_is_recognised_by_the_throttle_and_not_divided_twice(tmp_path, fine, gyro):
    names = ["time (us)", "gyroADC[0] (deg/s)", "gyroADC[1] (deg/s)", "setpoint[0]", "setpoint[3]", "rcCommand[3]"]
    rate = np.rint(100 * np.sin(0.1 * np.arange(200))).astype(int)
    rows = [",".join(map(str, [1000 * i, gyro * r, 0, fine * r, 250 * fine, 1250 * fine])) for i, r in enumerate(rate)]
    found = read_decoded(write(tmp_path / "a.csv", "\n".join([",".join(names), *rows]).encode()))
    values = found.series["onboard"].values
    assert np.degrees(values["p"].max()) == pytest.approx(100.0)
    assert np.degrees(values["setpoint_p"].max()) == pytest.approx(100.0)
    assert values["throttle"][5] == pytest.approx(0.25)
    assert any("high resolution" in note for note in found.notes) == (fine == 10)


@needs_cases
def test_cases_of_headers_come_out_right(tmp_path):
    frame, about = import_flight(
        flight_of(case_file("1_dyn_lowpass_off/bf44_static_250_dyn_0_500.bbl", tmp_path)), {}, {}
    )
    assert "PT1 250 Hz" in about["corrections"]["gyro filter delay"]["filters"]
    for name in ("acc_1G", "motorOutput", "vbatcellvoltage", "vbatref"):
        frame, about = import_flight(flight_of(case_file(f"4_header_cut/cut_in_{name}.bbl", tmp_path)), {}, {})
        assert about["verdict because"].isprintable() and "'vbatref'" in about["verdict because"]
        assert (
            "battery_voltage" not in frame and frame.filter(like="command").abs().max().max() < 1.5
        ) or name == "motorOutput"
    for name in ("inav", "emuflight", "rotorflight"):
        frame, about = import_flight(flight_of(case_file(f"6_other_firmware/{name}.bbl", tmp_path)), {}, {})
        assert "w1" not in frame and "Betaflight" in about["verdict because"]
    frame, about = import_flight(flight_of(case_file("7_highres_csv/highres_deg.csv.gz", tmp_path)), {}, {})
    assert about["sources"]["onboard"]["high resolution"]
    frame, about = import_flight(flight_of(case_file("8_erpm_slash_name/erpm_slash.bbl", tmp_path)), {}, {})
    assert {"w1", "w2", "w3", "w4"} <= set(frame)
