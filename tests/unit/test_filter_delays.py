"""Group delays against measured ones of the filters themselves."""

import math

import numpy as np
import pytest
from test_decoded import tool_csv

from quasi.errors import cautions
from quasi.importing.clocks.filter_delays import delay, header_delays, notch_delay
from quasi.importing.onboard_log import gather, read_onboard


def measured(kind, cutoff, rate=100000.0):
    """Delay of a slow ramp behind itself, by stepping the filter's difference equation."""
    order = {"PT1": 1, "PT2": 2, "PT3": 3}[kind]
    corner = cutoff / math.sqrt(2 ** (1 / order) - 1)
    rc, dt = 1 / (2 * math.pi * corner), 1 / rate
    gain = dt / (rc + dt)
    stages = np.zeros(order)
    n = int(0.4 * rate)
    for i in range(n):
        x = i * dt
        for k in range(order):
            stages[k] += gain * (x - stages[k])
            x = stages[k]
    return (n - 1) * dt - stages[-1]


@pytest.mark.parametrize(("kind", "cutoff"), [("PT1", 250.0), ("PT2", 100.0), ("PT3", 40.0)])
def test_delay_equals_what_a_ramp_shows(kind, cutoff):
    assert delay(kind, cutoff) == pytest.approx(measured(kind, cutoff), rel=1e-3)


def test_butterworth_delay_equals_its_phase_slope():
    f = 1e-3
    s = 2j * math.pi * f / (2 * math.pi * 80.0)
    phase = np.angle(1 / (s**2 + math.sqrt(2) * s + 1))
    assert delay("biquad", 80.0) == pytest.approx(-phase / (2 * math.pi * f), rel=1e-6)


def test_header_names_of_both_generations_are_understood():
    old = header_delays({"gyro_lowpass_hz": 200, "gyro_lowpass_type": 0, "gyro_lowpass2_hz": 0, "acc_lpf_hz": 1000})
    assert old["gyro"]["value"] == pytest.approx(1 / (2 * math.pi * 200))
    assert old["accelerometer"]["filters"] == ["PT2 10 Hz"]
    new = header_delays({"gyro_lpf1_static_hz": 250, "gyro_lpf1_dyn_hz": [0, 0], "gyro_lpf2_static_hz": 500})
    assert new["gyro"]["value"] == pytest.approx((1 / 250 + 1 / 500) / (2 * math.pi))
    assert new["accelerometer"]["value"] == 0.0


def test_notch_delay_equals_its_phase_slope():
    f, centre, quality = 1e-2, 150.0, 2.5
    s = 1j * f / centre
    phase = np.angle((s**2 + 1) / (s**2 + s / quality + 1))
    assert notch_delay(centre, quality) == pytest.approx(-phase / (2 * math.pi * f), rel=1e-5)


def test_hundredths_of_a_hertz_and_single_notches_of_old_firmware_are_understood():
    plain = {"gyro_lowpass_hz": 90, "gyro_notch_hz": [400, 200], "gyro_notch_cutoff": [300, 100]}
    old = {"gyro_lowpass_hz": 9000, "gyro_notch_hz": [40000, 20000], "gyro_notch_cutoff": [30000, 10000]}
    assert header_delays(old) == header_delays(plain)
    single = header_delays({"gyro_notch_hz": 400, "gyro_notch_cutoff": 300})["gyro"]
    assert single["value"] == pytest.approx(notch_delay(400.0, 400 * 300 / (400**2 - 300**2)))


def test_what_moves_in_flight_leaves_a_doubt_and_what_does_not_leaves_none():
    assert header_delays({"gyro_lpf1_static_hz": 250, "acc_lpf_hz": 10})["gyro"]["std"] == 0.0
    moving = header_delays({"gyro_lpf1_dyn_hz": [200, 500]})["gyro"]
    assert moving["value"] == pytest.approx(delay("PT1", 200.0))
    assert moving["std"] == pytest.approx(0.5 * (delay("PT1", 200.0) - delay("PT1", 500.0)))
    rotors = {"gyro_rpm_notch_harmonics": 1, "gyro_rpm_notch_q": 500, "gyro_rpm_notch_min": 100, "dshot_bidir": 1}
    found = header_delays(rotors)["gyro"]
    # rotors turn at 100 to 400 Hz: four notches of one to a quarter of the delay at 100 Hz
    assert found["value"] - found["std"] == pytest.approx(notch_delay(100.0, 5.0))
    assert found["value"] + found["std"] == pytest.approx(4 * notch_delay(100.0, 5.0))
    assert header_delays({**rotors, "dshot_bidir": 0})["gyro"] == header_delays({"gyro_lpf1_static_hz": 0})["gyro"]
    fixed = header_delays({"gyro_notch_hz": [150, 0], "gyro_notch_cutoff": [100, 0]})["gyro"]
    assert fixed["value"] == pytest.approx(notch_delay(150.0, 150 * 100 / (150**2 - 100**2)))
    assert fixed["std"] == 0.0


def test_filters_that_a_header_does_not_tell_are_not_known_and_those_it_turns_off_are():
    for sensor in header_delays({}).values():
        assert sensor["value"] == 0.0 and sensor["std"] >= 2e-3 and not sensor["known"]
    off = header_delays({"gyro_lowpass_hz": 0, "acc_lpf_hz": 0})
    for sensor in off.values():
        assert sensor["value"] == sensor["std"] == 0.0 and sensor["known"]
    half = header_delays({"acc_lpf_hz": 25})
    assert half["accelerometer"]["known"] and not half["gyro"]["known"]


def test_a_decoded_log_without_its_header_leaves_the_delays_in_doubt(tmp_path):
    flight = {"flight": "f", "flight controller": "betaflight", "onboard": str(tmp_path / "log.csv")}
    text, notes = tool_csv(rows=600), []
    (tmp_path / "log.csv").write_text(text)
    board = gather(read_onboard(flight, {"motor poles": 14}), "f", notes)
    assert board.delays["gyro"]["std"] == board.motion().gyro_doubt == 2e-3
    assert board.motion().accelerometer_doubt == 20e-3
    assert any("gyro and accelerometer were filtered on board" in n and "Give the .bbl" in n for n in cautions(notes))
    (tmp_path / "log.csv").write_text('"gyro_lpf1_static_hz","250"\n"acc_lpf_hz","0"\n' + text)
    notes.clear()
    told = gather(read_onboard(flight, {"motor poles": 14}), "f", notes).delays
    assert told["gyro"]["value"] > 0.0 and told["gyro"]["std"] == told["accelerometer"]["std"] == 0.0
    assert not any("filtered on board" in n for n in notes)
