"""Decoded blackbox CSVs: both programs' shapes, their units and text lines, and agreement with the binary reader."""

import gzip
import math

import numpy as np
import pytest
from recordings import SHARED, needs_real
from spreadsheets import FORMS, saved_anew

from quasi.airframe import erpm100_to_rad_s
from quasi.attitude import body_rates, to_euler
from quasi.errors import ReadError, cautions
from quasi.importing.readers.blackbox import read_blackbox
from quasi.importing.readers.decoded import read_decoded

REAL = SHARED / "betaflight-4.2.11-stm32f7"

TOOL_NAMES = (
    "loopIteration, time (us), setpoint[0], setpoint[1], setpoint[2], setpoint[3], vbatLatest (V), amperageLatest (A), "
    "gyroADC[0] (deg/s), gyroADC[1] (deg/s), gyroADC[2] (deg/s), accSmooth[0] (g), accSmooth[1] (g), accSmooth[2] (g), "
    "motor[0], motor[1], motor[2], motor[3], roll, pitch, heading, flightModeFlags (flags)"
)
TOOL_ROW = (
    "{i}, {t}, 90, 90, 90, 500, {volt}, 3.21, 90, 180, -90, 0.5, 1, 1, "
    "158, 2047, 347, 725, 10.0, 20.0, 300.0, ANGLE_MODE"
)


def tool_csv(volt="16.55", rows=50, between=(), names=TOOL_NAMES):
    lines = [names]
    for i in range(rows):
        lines.append(TOOL_ROW.format(i=i, t=5_000_000 + 1000 * i, volt=volt))
        if i < len(between):
            lines.append(between[i])
    return "\n".join(lines) + "\n"


def read(tmp_path, text, **options):
    path = tmp_path / "decoded.csv"
    path.write_text(text, encoding="utf-8")
    return read_decoded(path, **options)


def first(recording):
    return {name: values[0] for name, values in recording.series["onboard"].values.items()}


def test_units_in_the_column_names_count(tmp_path):
    recording = read(tmp_path, tool_csv())
    value = first(recording)
    quarter = math.pi / 2
    assert recording.series["onboard"].t[[0, 1]] == pytest.approx([5.0, 5.001])
    assert (value["p"], value["q"], value["r"]) == pytest.approx((quarter, -2 * quarter, quarter))
    assert (value["ax"], value["ay"], value["az"]) == pytest.approx((4.905, -9.81, -9.81))
    assert (value["setpoint_p"], value["setpoint_q"]) == pytest.approx((quarter, -quarter))
    assert (value["throttle"], value["battery_voltage"], value["battery_current"]) == pytest.approx((0.5, 16.55, 3.21))
    assert recording.metadata["format"] == "blackbox_decode"


def test_attitude_is_roll_minus_pitch_and_heading(tmp_path):
    value = first(read(tmp_path, tool_csv()))
    angles = to_euler(np.array([value[name] for name in ("qw", "qx", "qy", "qz")]))
    assert np.degrees(angles) == pytest.approx([10.0, -20.0, -60.0])


def test_commands_need_the_header_of_the_binary_log(tmp_path):
    without = read(tmp_path, tool_csv())
    assert "command1" not in without.series["onboard"].values
    assert any("motor output range" in note for note in without.notes)
    value = first(read(tmp_path, tool_csv(), header={"motorOutput": "158,2047"}))
    assert [value[f"command{i}"] for i in range(1, 5)] == pytest.approx([0.0, 1.0, 189 / 1889, 567 / 1889])


@pytest.mark.parametrize(
    ("printed", "volt"), [("243.6", 24.36), ("16.55", 16.55), ("24.40", 24.4), ("16.5", 16.5), ("168.0", 16.8)]
)
def test_voltage_printed_ten_times_too_large_is_put_right(tmp_path, printed, volt):
    recording = read(tmp_path, tool_csv(volt=printed))
    assert first(recording)["battery_voltage"] == pytest.approx(volt)
    assert any("divided by 10" in note for note in recording.notes) is (float(printed) > 30)


def test_lines_of_text_and_missing_numbers_cost_nothing_else(tmp_path):
    between = [
        "S frame: ANGLE_MODE, 0, IDLE, 1, 1",
        "P Frame unusuable due to prior corruption, offset 3645, size 25",
        "",
        TOOL_ROW.format(i=3, t="HORIZON MODE ON", volt="16.55"),
        TOOL_ROW.format(i=4, t=5_004_500, volt="NaN"),
        TOOL_ROW.format(i=5, t=5_000_000, volt="16.55"),
        "7, 5006500, 1",
    ]
    recording = read(tmp_path, tool_csv(between=between))
    onboard = recording.series["onboard"]
    assert recording.metadata["frames"] == {"samples": 54, "text lines": 2}
    assert len(onboard.t) == 52
    assert np.all(np.diff(onboard.t) > 0)
    assert np.isnan(onboard.values["battery_voltage"]).sum() == 2
    assert any("2 rows have no time or step back" in note for note in recording.notes)


def test_extra_cells_behind_the_named_columns_are_ignored(tmp_path):
    text = tool_csv().replace("ANGLE_MODE", "ANGLE_MODE, I, offset 3591, size 42")
    assert first(read(tmp_path, text))["p"] == pytest.approx(math.pi / 2)


def test_lines_shorter_than_the_names_and_absurd_numbers_count_as_missing(tmp_path):
    text = "loopIteration,time,gyroADC[0],gyroADC[1],accSmooth[0],rssi,heading\n" + "".join(
        f"{i},{1000 * i},{5 if i else '1e300'},7\n" for i in range(5)
    )
    recording = read(tmp_path, text)
    rate = recording.series["onboard"].values["p"]
    assert np.isnan(rate[0])
    assert rate[1:] == pytest.approx(math.radians(5))
    assert any("1 cells hold text or absurd numbers" in note for note in recording.notes)


VIEWER = (
    '"Product","Blackbox flight data recorder by Nicholas Sherlock"\n'
    '"firmwareType","3"\n"Firmware revision","Betaflight 4.5.1 (77d01ba3b) STM32F7X2"\n'
    f'"gyroScale","{math.radians(1) * 1e-6!r}"\n"acc_1G","2048"\n"motorOutput","158,2047"\n"motor_poles","12"\n'
    '"vbatcellvoltage","330,350,430"\n"debug_mode","0"\n'
    '"loopIteration","time","vbatLatest","gyroADC[0]","gyroADC[1]","gyroADC[2]","accSmooth[0]","accSmooth[1]",'
    '"accSmooth[2]","motor[0]","motor[1]","motor[2]","motor[3]","eRPM[0]","eRPM[1]","eRPM[2]","eRPM[3]",'
    '"heading[0]","heading[1]","heading[2]"\n'
)


def viewer_csv(rows=20):
    row = "{i},{t},1655,90,180,-90,1024,2048,2048,158,2047,347,725,100,200,300,400,0.1,0.2,0.3\n"
    return VIEWER + "".join(row.format(i=i, t=1_000_000 + 500 * i) for i in range(rows))


def test_viewer_export_is_read_with_its_own_header(tmp_path):
    recording = read(tmp_path, viewer_csv())
    value = first(recording)
    assert recording.metadata["format"] == "viewer export"
    assert (value["p"], value["az"], value["battery_voltage"]) == pytest.approx((math.pi / 2, -9.81, 16.55))
    assert value["command4"] == pytest.approx(567 / 1889)
    assert value["w3"] == pytest.approx(300 * erpm100_to_rad_s(12))
    angles = to_euler(np.array([value[name] for name in ("qw", "qx", "qy", "qz")]))
    assert angles == pytest.approx([0.1, -0.2, 0.3])
    assert first(read(tmp_path, viewer_csv(), poles=14))["w3"] == pytest.approx(300 * erpm100_to_rad_s(14))


def test_header_lines_that_a_spreadsheet_filled_up_say_the_same(tmp_path):
    at = viewer_csv().index('"loopIteration"')
    filled = viewer_csv()[:at].replace("\n", "," * 18 + "\n") + viewer_csv()[at:]
    plain, padded = read(tmp_path, viewer_csv()), read(tmp_path, filled)
    assert first(padded) == first(plain)
    assert padded.notes == plain.notes


@pytest.mark.parametrize(("top", "separator", "decimal", "encoding"), FORMS)
@pytest.mark.parametrize("program", [tool_csv, viewer_csv])
def test_what_a_spreadsheet_saved_reads_as_what_it_opened(tmp_path, program, top, separator, decimal, encoding):
    plain = read(tmp_path, program(rows=40))
    path = tmp_path / "saved.csv"
    path.write_text(top + saved_anew(program(rows=40), separator, decimal), encoding=encoding, newline="")
    saved = read_decoded(path)
    np.testing.assert_array_equal(saved.series["onboard"].t, plain.series["onboard"].t)
    for name, values in plain.series["onboard"].values.items():
        np.testing.assert_array_equal(saved.series["onboard"].values[name], values, err_msg=name)
    assert saved.series["onboard"].values.keys() == plain.series["onboard"].values.keys()
    assert saved.metadata["header"] == plain.metadata["header"]
    assert saved.metadata["format"] == plain.metadata["format"]
    extra = [note for note in cautions(saved.notes) if note not in plain.notes]
    assert len(extra) == 1 and "has been through a spreadsheet" in extra[0]


def test_a_scale_that_a_spreadsheet_rounded_is_assumed_and_called_for_care(tmp_path):
    rounded = saved_anew(viewer_csv()).replace("1,7453292519943295e-08", "1,75E-08")
    recording = read(tmp_path, rounded)
    assert first(recording)["p"] == pytest.approx(math.pi / 2)
    assert any("gyro_scale is '1,75E-08'; 1 deg/s per count is assumed" in note for note in cautions(recording.notes))


def test_quotes_around_plain_numbers_are_no_spreadsheet(tmp_path):
    quoted = "\n".join(",".join(f'"{cell.strip()}"' for cell in line.split(",")) for line in tool_csv().splitlines())
    plain, found = read(tmp_path, tool_csv()), read(tmp_path, quoted)
    assert first(found) == first(plain)
    assert found.notes == plain.notes


def dutch(change=lambda row: row):
    """The tool's log as a Dutch spreadsheet saved it, each row of cells changed."""
    names, *rows = saved_anew(tool_csv()).splitlines()
    return "\n".join([names, *(";".join(change(row.split(";"))) for row in rows)])


def with_cell(place, text):
    return lambda row: [*row[:place], text(row) if callable(text) else text, *row[place + 1 :]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            dutch(with_cell(11, "0.52")),
            "decimal commas (such as 16,55) and column 'accSmooth[0]' decimal points",
        ),
        (dutch(with_cell(14, "1.158")), "points of column 'motor[0]' (such as 1.158) may be decimal points or stand"),
        (
            dutch(with_cell(1, lambda row: f"{int(row[1]):,}".replace(",", "."))),
            "5.000.000, whose thousands are",
        ),
        (dutch(lambda row: [cell.replace(",", "") for cell in row]), "is in V but has no decimals, nor has any other"),
        (dutch(with_cell(1, lambda row: f"{int(row[1]):.2E}".replace(".", ","))), "time' have lost their digits in 50"),
    ],
)
def test_what_a_spreadsheet_spoilt_is_refused(tmp_path, text, words):
    with pytest.raises(ReadError, match=r"decoded\.csv") as error:
        read(tmp_path, text)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("rows", [50, 2000])
def test_time_that_was_shortened_is_refused_and_time_with_an_exponent_but_all_digits_is_read(tmp_path, rows):
    names, *lines = tool_csv(rows=rows).splitlines()
    cells = [line.split(", ", 2) for line in lines]

    def rewritten(form, names=names, scale=1.0):
        return "\n".join([names, *(f"{i}, {form % (int(t) * scale)}, {rest}" for i, t, rest in cells)])

    whole = read(tmp_path, rewritten("%.9e")).series["onboard"].t
    assert whole == pytest.approx(5.0 + 1e-3 * np.arange(rows))
    for form in ("%.2E", "%.3E"):
        with pytest.raises(ReadError, match=rf"have lost their digits in {rows} of {rows} rows"):
            read(tmp_path, rewritten(form))
    seconds = names.replace("time (us)", "time (s)")
    assert read(tmp_path, rewritten("%.3f", seconds, 1e-6)).series["onboard"].t == pytest.approx(whole)
    with pytest.raises(ReadError, match=r"lost their digits in .* \(such as 5.0*\)"):
        read(tmp_path, saved_anew(rewritten("%.2f", seconds, 1e-6)))


def test_rows_that_repeat_a_time_are_dropped_however_many(tmp_path):
    names, *rows = tool_csv().splitlines()
    recording = read(tmp_path, "\n".join([names, *[row for row in rows for _ in range(3)]]))
    assert len(recording.series["onboard"].t) == 50
    assert "100 rows repeat the time of the row before; they were dropped" in recording.notes


def test_a_counter_of_32_bits_that_starts_again_is_carried_on(tmp_path):
    names, *rows = tool_csv().splitlines()
    cells = [row.split(", ", 2) for row in rows]
    turned = [f"{i}, {(int(t) - 5_020_000) % 2**32}, {more}" for i, t, more in cells]
    recording = read(tmp_path, "\n".join([names, *turned]))
    assert np.diff(recording.series["onboard"].t) == pytest.approx(np.full(49, 1e-3))
    assert any("starts again from 0 1 times" in note for note in recording.notes)


def debug_csv(follow):
    rng = np.random.default_rng(0)
    names = TOOL_NAMES + ", debug[0], debug[1], debug[2], debug[3]"
    lines = [names]
    for i in range(400):
        motor = rng.integers(300, 1500, 4)
        debug = motor // 2 if follow else rng.integers(300, 1500, 4)
        row = TOOL_ROW.format(i=i, t=1000 * i, volt="16.55").replace("158, 2047, 347, 725", ", ".join(map(str, motor)))
        lines.append(row + ", " + ", ".join(map(str, debug)))
    return "\n".join(lines)


def test_debug_columns_are_rotor_speeds_only_if_they_follow_the_motors(tmp_path):
    followed = read(tmp_path, debug_csv(True))
    assert "w1" in followed.series["onboard"].values
    assert any("debug columns" in note for note in followed.notes)
    assert "w1" not in read(tmp_path, debug_csv(False)).series["onboard"].values
    # a stated debug mode counts more than looks
    assert "w1" not in read(tmp_path, debug_csv(True), header={"debug_mode": "3"}).series["onboard"].values


def test_indiflight_csv_is_front_right_down_already(tmp_path):
    names = ["loopIteration", "time", *(f"gyroADC[{i}]" for i in range(3)), *(f"accSmooth[{i}]" for i in range(3))]
    names += [f"quat[{i}]" for i in range(4)] + [f"omega[{i}]" for i in range(4)] + [f"extPos[{i}]" for i in range(3)]
    row = "0,{t},90,90,90,0,0,-2048,8127,0,0,0,1000,1100,1200,1300,{x},2500,-500\n"
    text = ",".join(names) + "\n" + "".join(row.format(t=1000 * i, x=1500 + i) for i in range(10))
    recording = read(tmp_path, text)
    value = first(recording)
    assert (value["q"], value["az"], value["w2"], value["qw"]) == pytest.approx((math.pi / 2, -9.81, 1100.0, 1.0))
    seen = recording.series["capture"].values
    assert (seen["x"][0], seen["y"][0], seen["z"][0]) == pytest.approx((1.5, 2.5, -0.5))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b,c\n1,2,3\n", "line of column names"),
        ("\0\0\0", "line of column names"),
        (TOOL_NAMES + "\n", "holds no samples"),
        (tool_csv().replace("time (us)", "time (fortnights)"), "expected s, ms or us"),
        (tool_csv().replace("(deg/s)", "(furlongs)"), "has the unit '(furlongs)'"),
        (tool_csv(rows=1).replace("5000000", "nan"), "no row with a time"),
    ],
)
def test_unusable_files_are_refused_in_a_sentence(tmp_path, text, words):
    with pytest.raises(ReadError, match=r"decoded\.csv") as error:
        read(tmp_path, text)
    assert words in str(error.value)


@pytest.fixture
def real(tmp_path):
    path = tmp_path / "real.csv"
    path.write_bytes(gzip.decompress(REAL.with_name(REAL.name + ".02.csv.gz").read_bytes()))
    return read_decoded(path)


@needs_real
def test_reference_decode_reads_to_the_same_quantities_as_the_binary_log(real):
    binary = read_blackbox(REAL.with_name(REAL.name + ".bbl")).series["onboard"]
    onboard = real.series["onboard"]
    at = np.searchsorted(binary.t, onboard.t - 5e-7)
    np.testing.assert_allclose(binary.t[at], onboard.t, atol=1e-9)
    for name in sorted(binary.values.keys() & onboard.values.keys()):
        # printed with two decimals
        np.testing.assert_allclose(onboard.values[name], binary.values[name][at], atol=0.0051, err_msg=name)


@needs_real
def test_signs_of_attitude_and_rates_agree_in_a_real_flight(real):
    onboard = real.series["onboard"]
    q = np.stack([onboard.values[name] for name in ("qw", "qx", "qy", "qz")], axis=-1)
    later = onboard.t > onboard.t[0] + 5.0  # the decoder's estimate has settled
    rates = body_rates(q, onboard.t)[later]
    for i, name in enumerate("pqr"):
        slope = np.polyfit(onboard.values[name][later], rates[:, i], 1)[0]
        assert slope == pytest.approx(1.0, abs=0.05)
    # at rest the specific force points up: -g along body z, turned down by the attitude to earth
    assert np.median(onboard.values["az"]) < -9.0
