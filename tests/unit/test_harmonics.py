"""Rotor notches: planted lines go away, motion stays as it is, everything compared gets the same operator."""

import re

import numpy as np
import pytest
from rigid_body import measure, move, quadrotor
from study import fly

from quasi.airframe import read_airframe
from quasi.errors import ConfigError
from quasi.filtering import forces, harmonics
from quasi.filtering.flight import filter_flight

RATE = 500.0
T = np.arange(10000) / RATE
FLYING = np.ones(len(T), bool)
INSIDE = slice(500, -500)
ROTORS = np.array([1080.0, 1140.0, 1210.0, 1260.0])  # rad/s
AIRFRAME = quadrotor()


def speeds(swing=60.0):
    """Four rotors whose speeds swing at 0.7 Hz, and their angles, integrated exactly."""
    phase = np.arange(4)
    each = ROTORS + swing * np.sin(2 * np.pi * 0.7 * T[:, None] + phase)
    angle = ROTORS * T[:, None] - swing / (2 * np.pi * 0.7) * np.cos(2 * np.pi * 0.7 * T[:, None] + phase)
    return each, angle


def found(each, harmonics_=2, centre="measured speed", width=10.0, lowest=30.0, log_rate=RATE):
    return harmonics.lines(each, FLYING, harmonics_, centre, width, lowest, log_rate, RATE)


def rms(x):
    return np.sqrt(np.mean(np.asarray(x)[INSIDE] ** 2))


@pytest.mark.parametrize(("frequency", "rate"), [(350.0, 500.0), (549.0, 500.0), (120.0, 500.0), (366.0, 250.0)])
def test_a_line_stands_where_its_samples_show_it(frequency, rate):
    t = np.arange(4096) / rate
    spectrum = np.abs(np.fft.rfft(np.cos(2 * np.pi * frequency * t) * np.hanning(len(t))))
    seen = np.fft.rfftfreq(len(t), 1 / rate)[np.argmax(spectrum)]
    assert harmonics.fold(frequency, rate) == pytest.approx(seen, abs=rate / len(t))


@pytest.mark.parametrize("order", [1, 2])
def test_planted_harmonics_fall_thirtyfold_and_five_hertz_keeps_amplitude_and_phase(order):
    # the first harmonic near 185 Hz; the second, near 370 Hz, folds to 130 Hz and crosses the first, where two lines
    # that cannot be told apart leave some hundredths
    each, angle = speeds()
    motion = np.sin(2 * np.pi * 5.0 * T + 0.4)
    line = np.cos(order * angle + 0.3).sum(axis=1)
    lines = found(each)
    left = harmonics.take_out((motion + line)[:, None], lines)[:, 0] - motion
    assert rms(line) > 1.0 and rms(left) < 0.033 * rms(line)
    kept = harmonics.take_out(motion[:, None], lines)[:, 0]
    part = T[INSIDE]
    a, b = 2 * np.mean(kept[INSIDE] * np.sin(10 * np.pi * part)), 2 * np.mean(kept[INSIDE] * np.cos(10 * np.pi * part))
    assert np.hypot(a, b) == pytest.approx(1.0, abs=1e-4)
    assert np.arctan2(b, a) == pytest.approx(0.4, abs=1e-4)


def test_a_line_that_crosses_no_other_goes_away_altogether():
    each, angle = speeds(150.0)
    line = np.cos(angle[:, :1])
    assert rms(harmonics.take_out(line, found(each[:, :1], 1))) < 1e-4 * rms(line)


def test_a_notch_at_the_median_speed_has_the_stated_gain():
    each = np.tile(ROTORS[:1], (len(T), 1))
    lines = found(each, 1, "median speed")
    centre = ROTORS[0] / (2 * np.pi)
    # at 5 Hz, half the width, one half
    for distance in (0.0, 1.0, 2.5, 5.0, 7.5, 15.0, 40.0):
        signal = np.sin(2 * np.pi * (centre + distance) * T)
        x = 2 * distance / 10.0 * (1 + np.sqrt(2)) ** 0.25
        gain = rms(harmonics.take_out(signal[:, None], lines)) / rms(signal)
        assert gain == pytest.approx((x**4 / (1 + x**4)) ** 2, abs=0.004)


def test_the_operator_is_symmetric_so_it_has_no_phase_though_the_line_moves():
    lines = found(speeds(150.0)[0])
    # at the very ends the mirrored signal is no symmetric operator
    a, b = np.random.default_rng(0).normal(size=(2, len(T))) * np.clip(np.minimum(T, T[-1] - T) - 0.2, 0.0, 1.0)
    left = a @ harmonics.take_out(b[:, None], lines)[:, 0]
    right = harmonics.take_out(a[:, None], lines)[:, 0] @ b
    assert left == pytest.approx(right, abs=1e-10 * np.linalg.norm(a) * np.linalg.norm(b))


def test_a_plain_slow_version_gives_the_same():
    each, _ = speeds()
    lines = found(each[:, 1:2], 1)
    values = np.random.default_rng(2).normal(size=len(T))
    from scipy.signal import butter, lfilter

    b, a = butter(2, 5.0 / (1 + np.sqrt(2)) ** 0.25 / (RATE / 2))
    frequency, weight = lines.frequency[:, 0], lines.weight[:, 0]
    angle = np.concatenate([[0.0], np.cumsum(np.pi * (frequency[1:] + frequency[:-1]) / RATE)])

    def above(x):
        return x - forces.low_pass(x, 30.0 / 1.4, RATE)

    left = above(values)
    for _ in range(2):
        slow = lfilter(b, a, lfilter(b, a, weight * np.exp(-1j * angle) * left)[::-1])[::-1]
        left = left - 2.0 * weight * np.real(np.exp(1j * angle) * slow)
    expected = values - above(above(values) - left)
    np.testing.assert_allclose(harmonics.take_out(values[:, None], lines)[:, 0], expected, atol=1e-10)


def test_notches_that_sweep_shake_nothing_off_the_motion():
    # rotor speeds that jump about, so that harmonic 3 folds all over the band, and motion a thousandfold the tolerance
    rng = np.random.default_rng(3)
    each = ROTORS + forces.low_pass(rng.normal(0.0, 900.0, (len(T), 4)), 8.0, RATE)
    motion = 5.0 * np.sin(2 * np.pi * 2.0 * T) + 2.0 * np.sin(2 * np.pi * 9.0 * T)
    lines = found(each, 3)
    assert (lines.frequency[:, lines.harmonic == 3] < 60.0).mean() > 0.15
    left = harmonics.take_out(motion[:, None], lines)[:, 0]
    assert rms(left - motion) < 1e-3 * rms(motion)


def test_constants_and_lines_below_the_lowest_frequency_stay():
    each = np.full((len(T), 1), 2 * np.pi * 167.0)  # its third harmonic, 501 Hz, folds to 1 Hz
    lines = found(each, 3)
    assert lines.frequency[0, 2] == pytest.approx(1.0) and not lines.weight[:, 2].any()
    np.testing.assert_allclose(harmonics.take_out(np.full((len(T), 2), -9.81), lines), -9.81, atol=1e-12)
    standing = found(np.zeros((len(T), 4)))
    assert not standing.weight.any()


def test_what_the_import_took_out_is_not_looked_for_where_it_would_fold():
    each = np.full((len(T), 1), 2 * np.pi * 185.0)
    assert found(each, 2, log_rate=500.0).weight[0, 1] == 1.0
    # logged at 1 kHz the line at 370 Hz was beyond the grid's half rate and went with the import's low-pass
    assert not found(each, 2, log_rate=1000.0).weight[:, 1].any()


def test_notches_bring_a_slow_log_nearer_to_the_truth():
    # at 250 Hz the rotors' lines near 330 Hz fold to 80 Hz; from the raw log on
    made, frame, about, quad = fly("a", profile="mixed", seed=3, duration=20.0, nuisance=0.0, **{"log rate": 250})
    at, t = frame["t"].to_numpy() + about["start"]["value"], made.truth["t"].to_numpy()
    error = {}
    for wanted in (0, 1):
        options = {"low-pass cutoff Hz": 90.0, "rotor notch harmonics": wanted}
        table = filter_flight(frame, about, read_airframe(quad, "made"), options).with_gravity
        rows = table["valid"].to_numpy() > 0.5
        error[wanted] = [np.std((table[c] - np.interp(at, t, made.truth[c]))[rows]) for c in ("p", "q", "Fx", "Fy")]
    assert np.all(np.array(error[1]) < 0.6 * np.array(error[0]))


@pytest.fixture(scope="module")
def motion():
    return move(seconds=12.0, seed=4)


@pytest.fixture
def made(motion):
    frame, metadata = measure(motion)
    metadata["streams"] = {"gyro": {"rate": RATE}}
    return frame, metadata


def shaken(frame, frequency, size):
    """The frame with a vibration that turns with rotor 1, at `frequency` x its speed."""
    angle = np.cumsum(frame["w1"].to_numpy()) / RATE * frequency
    frame = frame.copy()
    for axis in ("p", "ax", "az"):
        frame[axis] += size * np.cos(angle) * (frame["t"] > 4.0)
    return frame


def test_rotor_speeds_commands_rates_and_accelerations_get_the_same_operator(made):
    frame, metadata = made
    same = frame["p"].to_numpy()
    frame = frame.assign(command1=same, w2=500.0 + 10.0 * same, ax=3.0 * same)
    table = filter_flight(frame, metadata, AIRFRAME, {"rotor notch harmonics": 2}).with_gravity
    for other, factor, rate in (("command1", 1.0, "p"), ("w2", 10.0, "p"), ("ax", 3.0, "p"), ("w2_dot", 10.0, "p_dot")):
        difference = table[other] - factor * table[rate]
        assert np.ptp(difference) < 1e-8 * np.ptp(table[other]), other


def test_a_folded_harmonic_inside_the_band_is_named_and_taken_out(made):
    frame, metadata = made
    # the second harmonic of 1409 rad/s, 448 Hz, stands at 52 Hz, inside a low-pass of 60 Hz
    swing = 1409.0 + 15.0 * np.sin(2.0 * frame["t"])
    frame = frame.assign(**{f"w{i}": np.where(frame["t"] > 3.0, swing, 150.0) for i in range(1, 5)})
    hurt = shaken(frame, 2.0, 1.0)
    part = ((frame["t"] > 5.0) & (frame["t"] < 11.0)).to_numpy()
    options = {"low-pass cutoff Hz": 60.0}
    quiet, plain = (filter_flight(f, metadata, AIRFRAME, options) for f in (frame, hurt))
    said = [note for note in plain.metadata["notes"] if "passes the low-pass" in note]
    assert len(said) == 1 and re.search(r"harmonic 2 near 5[0-4] Hz, folded from 4[45]\d Hz; the log's rate", said[0])
    assert "harmonic 1" not in said[0] and said[0].endswith("'rotor notch harmonics' to 2")
    assert plain.metadata["doubts"] == said and quiet.metadata["doubts"] == []
    assert not any("passes the low-pass" in note for note in quiet.metadata["notes"])
    asked = options | {"rotor notch harmonics": 2}
    silent, notched = (filter_flight(f, metadata, AIRFRAME, asked) for f in (frame, hurt))
    # both were filtered alike, so what differs is what is left of the vibration
    before = np.std((plain.with_gravity["ax"] - quiet.with_gravity["ax"])[part])
    after = np.std((notched.with_gravity["ax"] - silent.with_gravity["ax"])[part])
    assert before > 0.4 and after < 0.03 * before
    about = notched.metadata["filters"]["rotor notches"]
    assert [line["harmonic"] for line in about["lines"]] == [1, 2]
    assert about["lines"][1]["folded share"] > 0.9 and about["lines"][1]["stands at"]["value"] == pytest.approx(
        52, abs=2
    )
    assert about["taken out, rms"]["accelerometer"]["value"][0] == pytest.approx(np.sqrt(0.5), rel=0.15)


def test_a_harmonic_that_folds_onto_the_motion_stays_in_and_is_said(made):
    frame, metadata = made
    # three times 1047 rad/s is 500 Hz
    frame = frame.assign(**{f"w{i}": np.where(frame["t"] > 3.5, 1047.0, 150.0) for i in range(1, 5)})
    result = filter_flight(frame, metadata, AIRFRAME, {"rotor notch harmonics": 3})
    assert any("harmonic 3 of the rotors folds below 30 Hz" in note for note in result.metadata["notes"])
    reach = filter_flight(frame, metadata, AIRFRAME, {}).metadata["filters"]["half length samples"]
    assert result.metadata["filters"]["half length samples"] > reach


def test_notches_without_rotor_speeds_are_said(made):
    frame, metadata = made
    result = filter_flight(
        frame.drop(columns=[f"w{i}" for i in range(1, 5)]), metadata, AIRFRAME, {"rotor notch harmonics": 2}
    )
    assert any("no rotor speed is known: none were made" in note for note in result.metadata["notes"])
    assert result.metadata["filters"]["rotor notches"] is None


def test_a_cutoff_beyond_half_the_logs_rate_is_said(made):
    frame, metadata = made
    metadata["streams"] = {"gyro": {"rate": 60.0}}
    result = filter_flight(frame, metadata, AIRFRAME, {})
    assert any("beyond half the log's rate of 60 Hz" in note for note in result.metadata["notes"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rotor notch harmonics": -1}, "'rotor notch harmonics' is -1"),
        ({"rotor notch harmonics": 2.5}, "'rotor notch harmonics' is 2.5"),
        ({"rotor notch centre": "speed"}, "'rotor notch centre' is 'speed'"),
        ({"rotor notch width Hz": 0.0}, "'rotor notch width Hz' is 0.0"),
        ({"rotor notch harmonics": 1, "rotor notch width Hz": 40.0}, "the width must be less"),
        ({"rotor notch harmonics": 1, "rotor notch lowest Hz": 245.0}, "no notch of 'rotor notch width Hz' 10 fits"),
    ],
)
def test_impossible_notches_are_sentences(made, options, words):
    with pytest.raises(ConfigError, match=words):
        filter_flight(*made, AIRFRAME, options)


@pytest.mark.parametrize("every", [5, 10])
def test_a_slow_grid_is_filtered_where_no_notch_is_asked_for_and_refused_where_none_fits(made, every):
    frame, metadata = made
    slow = frame.iloc[::every].reset_index(drop=True)
    result = filter_flight(slow, metadata, AIRFRAME, {})
    assert result.metadata["filters"]["rotor notches"] is None and np.isfinite(result.with_gravity.to_numpy()).all()
    with pytest.raises(ConfigError, match="no notch of 'rotor notch width Hz' 10 fits"):
        filter_flight(slow, metadata, AIRFRAME, {"rotor notch harmonics": 1})
