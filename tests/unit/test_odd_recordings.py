"""Recordings that are not quite as they should be: read as what they are, or refused, never taken for another thing."""

import numpy as np
import pytest
from test_decoded import read, tool_csv
from test_filter_delays import header_delays

from quasi.errors import ReadError
from quasi.filtering.measurements import Imu, frozen
from quasi.importing.clocks.table_clocks import uncrowded
from quasi.importing.clocks.telemetry import rotor_age
from quasi.importing.onboard_log import read_onboard
from quasi.importing.readers.table_text import open_table


def test_a_crowd_goes_back_to_where_it_was_sampled_and_a_faster_source_stays():
    t = np.arange(300) / 100.0
    burst = t.copy()
    burst[100:110] = burst[109] + 0.0005 * (np.arange(10) - 9)  # ten messages waited for the last of them
    mended = uncrowded(burst)
    assert np.all(np.diff(mended) > 0.0)
    np.testing.assert_allclose(mended[100:110], burst[109] + 0.008 * (np.arange(10) - 9), atol=1e-9)
    np.testing.assert_array_equal(mended[110:], burst[110:])
    faster = np.concatenate([np.arange(6000) / 100.0, 60.0 + np.arange(5000) / 250.0])
    np.testing.assert_array_equal(uncrowded(faster), faster)


def test_a_comma_at_the_end_of_each_line_shifts_nothing_and_lines_left_out_are_counted(tmp_path):
    path, notes = tmp_path / "log.csv", []
    path.write_text("t,p,q\n" + "".join(f"{0.01 * k:.2f},{k},{-k},\n" for k in range(30)))
    table = open_table(path, notes)
    assert list(table) == ["t", "p", "q"] and table["p"].iloc[7] == 7 and table["q"].iloc[7] == -7 and not notes
    path.write_text("t,p,q\n" + "".join(f"{0.01 * k:.2f},{k},{-k}{',1,2,3' * (k > 26)}\n" for k in range(30)))
    assert len(open_table(path, notes)) == 27 and "3 lines have more cells" in notes[0]


def test_counts_per_g_of_the_configuration_stand_in_for_a_header(tmp_path):
    raw = tool_csv().replace(
        "accSmooth[0] (g), accSmooth[1] (g), accSmooth[2] (g)", "accSmooth[0], accSmooth[1], accSmooth[2]"
    )
    at = {name: float(values[0]) for name, values in read(tmp_path, raw, counts=4.0).series["onboard"].values.items()}
    plain = {name: float(v[0]) for name, v in read(tmp_path, raw).series["onboard"].values.items()}
    assert at["az"] == pytest.approx(plain["az"] * 2048 / 4.0)


def test_a_log_number_of_a_file_that_holds_one_log_is_refused(tmp_path):
    path = tmp_path / "LOG00012.csv"
    path.write_text(tool_csv())
    flight = {"flight controller": "betaflight", "onboard": str(path), "log number": 2}
    with pytest.raises(ReadError, match="no blackbox file of several logs, but the logbook asks for log 2"):
        read_onboard(flight, {"motor poles": 14})
    assert read_onboard({**flight, "log number": 1}, {"motor poles": 14}).series["onboard"].values


def test_a_clock_that_starts_again_is_refused(tmp_path):
    lines = tool_csv().splitlines()
    with pytest.raises(ReadError, match="49 % of the rows .* clock starts again"):
        read(tmp_path, "\n".join([*lines, *lines[1:-2]]))


def test_a_sensor_that_repeats_itself_is_seen_beneath_the_rounding_of_resampling():
    rng = np.random.default_rng(1)
    values = rng.standard_normal((2000, 3))
    values[800:1200] = values[800] * (1.0 + 1e-16 * rng.standard_normal((400, 3)))
    imu = Imu(rng.standard_normal((2000, 3)), values, np.zeros(2000, bool), [])
    found, notes = frozen(imu, np.zeros(2000, bool), 0.002 * np.arange(2000), 0.002)
    assert found[805:1195].all() and not found[:790].any() and "accelerometer repeats" in notes[0]


def test_rotor_speeds_that_never_share_a_row_tell_no_age():
    t = 0.01 * np.arange(4000)
    speeds = np.full((4000, 4), np.nan)
    for i in range(4):
        speeds[i::4, i] = 1500.0
    assert rotor_age(t, speeds, t, np.zeros((4000, 3))) is None


@pytest.mark.parametrize(("firmware", "kind"), [("4.2.11", "biquad"), ("4.3.0", "PT2"), ("4.5.1", "PT2")])
def test_the_accelerometers_filter_is_that_of_the_firmware(firmware, kind):
    told = header_delays({"Firmware revision": f"Betaflight {firmware} (abc) STM32F405", "acc_lpf_hz": 10})
    assert told["accelerometer"]["filters"] == [f"{kind} 10 Hz"]
