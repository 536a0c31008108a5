"""Blackbox logs: every encoding and predictor by hand, damage, units, and real logs against a reference decode."""

import gzip
import math
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from quasi.airframe import erpm100_to_rad_s
from quasi.errors import ReadError
from quasi.importing import blackbox_header, blackbox_units
from quasi.importing.blackbox import decode, list_logs, read_blackbox
from quasi.importing.blackbox_header import find_logs

SHARED = Path(os.environ.get("QUASI_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data")) / "blackbox"
REAL = "betaflight-4.2.11-stm32f7"
needs_real = pytest.mark.skipif(
    not SHARED.is_dir(),
    reason=f"real recordings are not at {SHARED}; set QUASI_SHARED_DATA to the folder that holds them",
)


# A plain writer of each encoding, slow and apart from the reader.


def uvb(value):
    value &= 0xFFFFFFFF
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def svb(value):
    return uvb((value << 1) ^ (value >> 31))


def neg14(value):
    return uvb(-value & 0x3FFF)


def tag8_8svb(values):
    if len(values) == 1:
        return svb(values[0])
    tag = sum(1 << i for i, v in enumerate(values) if v)
    return bytes([tag]) + b"".join(svb(v) for v in values if v)


def bits(values, widths):
    """Fields of given widths, highest bit first, filled up to whole bytes."""
    text = "".join(format(v & ((1 << w) - 1), f"0{w}b") for v, w in zip(values, widths) if w)
    text += "0" * (-len(text) % 8)
    return bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8))


def widest(values, widths):
    return next(w for w in widths if all(-(1 << (w - 1)) <= v < 1 << (w - 1) for v in values))


def wide_three(values):
    sizes = [widest([v], (8, 16, 24, 32)) // 8 for v in values]
    lead = 0xC0 | sum((size - 1) << (2 * i) for i, size in enumerate(sizes))
    return bytes([lead]) + b"".join((v & (1 << 8 * s) - 1).to_bytes(s, "little") for v, s in zip(values, sizes))


def tag2_3s32(values):
    width = widest(values, (2, 4, 6, 32))
    if width == 32:
        return wide_three(values)
    # the lead byte holds its two size bits, then padding up to where the fields end on whole bytes
    size = {2: 0, 4: 1, 6: 2}[width]
    if width == 6:
        return bytes([size << 6 | values[0] & 63, values[1] & 63, values[2] & 63])
    return bits([size, 0, *values], [2, 0 if width == 2 else 2, width, width, width])


def tag2_3svariable(values):
    a, b, c = values
    fits = lambda v, w: -(1 << (w - 1)) <= v < 1 << (w - 1)  # noqa: E731
    for size, widths in ((0, (2, 2, 2)), (1, (5, 5, 4)), (2, (8, 7, 7))):
        if all(map(fits, (a, b, c), widths)):
            return bits([size, *values], [2, *widths])
    return wide_three(values)


def tag8_4s16(values):
    widths = [0 if v == 0 else widest([v], (4, 8, 16)) for v in values]
    tag = sum({0: 0, 4: 1, 8: 2, 16: 3}[w] << (2 * i) for i, w in enumerate(widths))
    return bytes([tag]) + bits(values, widths)


def log_bytes(fields, frames, header="", intra=None, inter=None, start="0"):
    """A log: fields [(name, signed)], intra and inter (encodings, predictors) behind loopIteration and time."""
    names = ["loopIteration", "time", *(name for name, _ in fields)]
    n = len(fields)
    intra = intra or ([0] * n, [0] * n)
    inter = inter or ([0] * n, [1] * n)
    join = lambda values: ",".join(map(str, values))  # noqa: E731
    lines = [
        "Product:Blackbox flight data recorder by Nicholas Sherlock",
        "Data version:2",
        "Field I name:" + join(names),
        "Field I signed:" + join([0, 0, *(int(s) for _, s in fields)]),
        "Field I encoding:" + join([1, 1, *intra[0]]),
        "Field I predictor:" + join([0, 0, *intra[1]]),
        "Field P encoding:" + join([9, 0, *inter[0]]),
        "Field P predictor:" + join([6, 2, *inter[1]]),
        "Field S name:flightModeFlags,stateFlags,failsafePhase,rxSignalReceived,rxFlightChannelsValid",
        "Field S signed:0,0,0,0,0",
        "Field S encoding:1,1,7,7,7",
        "Field S predictor:0,0,0,0,0",
        "Firmware type:Cleanflight",
        "Firmware revision:Betaflight 4.5.1 (77d01ba3b) STM32F7X2",
        "I interval:32",
        "P interval:1",
        *[line for line in header.splitlines() if line],
    ]
    return "".join(f"H {line}\n" for line in lines).encode() + frames


def intra_frame(iteration, time, payload=b""):
    return b"I" + uvb(iteration) + uvb(time) + payload


def inter_frame(step, payload=b""):
    return b"P" + svb(step) + payload


END = b"E\xffEnd of log\x00"


def frames_of(data, fields=None):
    (log,) = find_logs(data, "made.bbl")
    assert log.fault == ""
    return decode(data, log, fields)


def decoded(encoding, values, payload):
    fields = [(f"f{i}", True) for i in range(len(values))]
    n = len(values)
    data = log_bytes(
        fields, intra_frame(0, 5, payload) + intra_frame(32, 9, payload) + END, intra=([encoding] * n, [0] * n)
    )
    frames = frames_of(data)
    assert frames.counts["I"] == 2
    assert frames.ended
    return [int(frames.values[f"f{i}"][1]) for i in range(n)]


@pytest.mark.parametrize(
    ("encoding", "payload", "values"),
    [
        (0, [0x80, 0x01], [64]),
        (0, [0x01], [-1]),
        (0, [0xFF, 0xFF, 0xFF, 0xFF, 0x0F], [-(2**31)]),
        (1, [0xFF, 0x01], [255]),
        (3, [0x05], [-5]),
        (3, [0xFF, 0x7F], [1]),
        (6, [0b101, 2, 1], [1, 0, -1]),
        (6, [0x03], [-2]),
        (7, [0x0D], [0, -1, 1]),
        (7, [0x4F, 0x21], [-1, 2, 1]),
        (7, [0x81, 0x3F, 0x20], [1, -1, -32]),
        (7, [0b11_10_01_00, 0xFE, 0x00, 0x80, 0x01, 0x00, 0xFF], [-2, -32768, -65535]),
        (7, [0b11_00_00_11, 0x00, 0x00, 0x00, 0x80, 1, 2], [-(2**31), 1, 2]),
        (8, [0b11100100, 0x10, 0x20, 0x00, 0x30], [0, 1, 2, 3]),
        (8, [0x30, 181, 61], [0, 0, -19139, 0]),
        (9, [], [0, 0]),
        (10, [0x1B], [1, -2, -1]),
        (10, [0b01_01111_1, 0b0000_1000], [15, -16, -8]),
        (10, [0b10_011111, 0b11_100000, 0b0_0111111], [127, -64, 63]),
        (10, [0b11_00_00_01, 0x00, 0x01, 5, 6], [256, 5, 6]),
    ],
)
def test_each_encoding_reads_bytes_written_by_hand(encoding, payload, values):
    assert decoded(encoding, values, bytes(payload)) == values


@pytest.mark.parametrize(
    ("encoding", "write", "count", "most"),
    [
        (0, lambda v: svb(v[0]), 1, 2**31),
        (3, lambda v: neg14(v[0]), 1, 2**13),
        (6, tag8_8svb, 8, 2**31),
        (6, tag8_8svb, 3, 2**31),
        (7, tag2_3s32, 3, 2**31),
        (8, tag8_4s16, 4, 2**15),
        (10, tag2_3svariable, 3, 2**31),
    ],
)
def test_each_encoding_inverts_a_plain_writer(encoding, write, count, most):
    rng = np.random.default_rng(encoding)
    n = 400
    size = rng.integers(0, int(math.log2(most)) + 1, n)
    table = [[int(v) for v in rng.integers(-(2**k), 2**k, count)] for k in size]
    table = [[max(-most, min(most - 1, v)) if rng.random() > 0.2 else 0 for v in row] for row in table]
    if encoding == 3:
        table = [[max(v, -most + 1)] for (v,) in table]
    fields = [(f"f{i}", True) for i in range(count)]
    body = b"".join(intra_frame(32 * i, 1000 * i, write(row)) for i, row in enumerate(table))
    frames = frames_of(log_bytes(fields, body + END, intra=([encoding] * count, [0] * count)))
    assert frames.counts["I"] == n
    read = np.stack([frames.values[f"f{i}"] for i in range(count)], axis=1)
    np.testing.assert_array_equal(read, table)


def test_predictors_of_intra_frames():
    names = ["minthrottle", "motor[0]", "motor[1]", "fifteen", "vbatLatest"]
    fields = [(name, False) for name in names]
    payload = svb(5) + svb(20) + svb(-3) + svb(7) + neg14(-30)
    data = log_bytes(
        fields,
        intra_frame(0, 1, payload) + intra_frame(32, 2, payload) + END,
        header="minthrottle:1070\nmotorOutput:158,2047\nvbatref:1680",
        intra=([0, 0, 0, 0, 3], [4, 11, 5, 8, 9]),
    )
    values = frames_of(data).values
    assert [values[name][0] for name in names] == [1075, 178, 175, 1507, 1650]


def test_predictors_of_inter_frames_use_the_frames_before():
    fields = [("previous", True), ("line", True), ("average", True), ("count", False)]
    body = intra_frame(0, 100, svb(10) + svb(10) + svb(-11) + uvb(4)) + b"".join(
        inter_frame(0, svb(1) + svb(1) + svb(0) + uvb(0)) for _ in range(3)
    )
    frames = frames_of(log_bytes(fields, body + END, intra=([0, 0, 0, 1], [0] * 4), inter=([0, 0, 0, 1], [1, 2, 3, 6])))
    assert frames.values["previous"].tolist() == [10, 11, 12, 13]
    # right after an intra frame it stands for both frames before: 10 + 1, then 2*11 - 10 + 1, then 2*13 - 11 + 1
    assert frames.values["line"].tolist() == [10, 11, 13, 16]
    assert frames.values["average"].tolist() == [-11, -11, -11, -11]
    assert frames.values["count"].tolist() == [4, 5, 6, 7]


@pytest.mark.parametrize(("before", "half"), [((-11, -12), -11), ((11, 12), 11), ((-3, 2), 0), ((-12, -12), -12)])
def test_average_rounds_towards_zero(before, half):
    first, second = before
    body = intra_frame(0, 1, svb(first)) + inter_frame(1, svb(second - first)) + inter_frame(0, svb(0))
    frames = frames_of(log_bytes([("a", True)], body + END, inter=([0], [3])))
    assert frames.values["a"].tolist() == [first, second, int((first + second) / 2)]
    assert frames.values["a"][2] == half


@pytest.mark.parametrize(
    ("interval", "header", "expected"),
    [
        (32, "P interval:1/1", [0, 1, 2, 3]),
        (32, "P interval:1/2", [0, 2, 4, 6]),
        (32, "P interval:2/3", [0, 2, 3, 5]),
        (256, "P interval:16\nP ratio:16", [0, 16, 32, 48]),
        (4, "P interval:3", [0, 3, 4, 7]),
    ],
)
def test_iterations_left_out_on_purpose_are_counted(interval, header, expected):
    # firmware writes a frame where (index + numerator - 1) % denominator < numerator
    body = intra_frame(0, 0) + inter_frame(10)
    if interval == 4:
        body += intra_frame(4, 20) + inter_frame(10)
    else:
        body += inter_frame(0) * 2
    data = log_bytes([], body + END, header=header).replace(b"I interval:32", b"I interval:%d" % interval)
    data = data.replace(b"H P interval:1\n", b"", 1)
    assert frames_of(data).values["loopIteration"].tolist() == expected


def test_unsigned_fields_wrap_at_32_bits_and_time_does_not():
    start = 2**32 - 1500
    body = (
        intra_frame(0, start, uvb(2**32 - 1))
        + inter_frame(1000, svb(1))
        + inter_frame(0, svb(0))
        + inter_frame(0, svb(0))
    )
    frames = frames_of(log_bytes([("u", False)], body + END, intra=([1], [0])))
    assert frames.values["u"].tolist() == [2**32 - 1, 0, 0, 0]
    assert frames.time.tolist() == [start, start + 1000, start + 2000, start + 3000]


def test_slow_gps_home_and_event_frames():
    header = (
        "Field H name:GPS_home[0],GPS_home[1]\nField H signed:1,1\nField H encoding:0,0\nField H predictor:0,0\n"
        "Field G name:time,GPS_numSat,GPS_coord[0],GPS_coord[1]\nField G signed:0,0,1,1\n"
        "Field G encoding:1,1,0,0\nField G predictor:10,0,7,7"
    )
    slow = b"S" + uvb(3) + uvb(1) + tag2_3s32([0, 1, 1])
    body = (
        intra_frame(0, 1000)
        + slow
        + b"H" + svb(520000000) + svb(-43000000)
        + b"G" + uvb(70) + uvb(12) + svb(-5) + svb(9)
        + b"E\x00" + uvb(900)
        + b"E\x0d\x05" + svb(-2)
        + b"E\x0d\x85" + b"\x00\x00\x80\x3f"
        + b"E\x1e" + uvb(1) + uvb(0)
        + inter_frame(500)
        + slow
        + b"E\x0f" + uvb(4)
        + b"E\x28" + uvb(7)
        + inter_frame(0)
        + END
    )  # fmt: skip
    frames = frames_of(log_bytes([], body, header=header))
    assert frames.counts == {
        "I": 1, "P": 2, "S": 2, "G": 1, "H": 1, "E": 7, "P after damage": 0, "rejected": 0, "unknown events": 0
    }  # fmt: skip
    assert frames.gps.tolist() == [[1070, 12, 519999995, -42999991]]
    assert frames.slow.tolist() == [[3, 1, 0, 1, 1]]
    assert frames.events[:, 0].tolist() == [0, 13, 13, 30, 15, 40, 255]
    assert frames.events[1].tolist() == [13, 1000, 5, -2]
    assert frames.time.tolist() == [1000, 1500, 2000]
    assert len(frames.spans) == 0


def test_unknown_event_is_stepped_over_and_counted():
    body = intra_frame(0, 1000) + b"E\x63\x01\x02\x03" + inter_frame(500) + inter_frame(0) + END
    frames = frames_of(log_bytes([], body))
    assert frames.counts["unknown events"] == 1
    assert frames.time.tolist() == [1000, 1500, 2000]


def test_reading_ends_with_the_end_of_log_event():
    frames = frames_of(log_bytes([], intra_frame(0, 1000) + END + intra_frame(32, 2000)))
    assert frames.time.tolist() == [1000]


def test_logging_resumed_allows_a_long_pause():
    body = intra_frame(0, 1000) + inter_frame(500) + b"E\x0e" + uvb(96000) + uvb(60_000_000)
    body += intra_frame(96000, 60_000_100) + inter_frame(500) + END
    frames = frames_of(log_bytes([], body))
    assert frames.time.tolist() == [1000, 1500, 60_000_100, 60_000_600]


def test_a_long_jump_without_resume_needs_a_second_witness():
    later = [intra_frame(96000 + 32 * i, 60_000_000 + 1000 * i) for i in range(3)]
    before = intra_frame(0, 1000) + intra_frame(32, 2000)
    frames = frames_of(log_bytes([], before + b"".join(later) + END))
    assert frames.time.tolist() == [1000, 2000, 60_001_000, 60_002_000]
    assert frames.counts["rejected"] == 1
    frames = frames_of(log_bytes([], intra_frame(0, 1000) + later[0] + intra_frame(32, 2000) + END))
    assert frames.counts["rejected"] == 1
    assert frames.time.tolist() == [1000, 2000]


def damaged_log():
    """40 intra intervals of 32 frames at 1 kHz, one field that counts them: the bytes and the offset of each frame."""
    pieces, offsets = [], []
    at = len(log_bytes([("n", False)], b"", intra=([1], [0]), inter=([0], [1])))
    for i in range(40 * 32):
        piece = intra_frame(i, 1000 * i, uvb(i)) if i % 32 == 0 else inter_frame(1000 if i % 32 == 1 else 0, svb(1))
        pieces.append(piece)
        offsets.append(at)
        at += len(piece)
    return log_bytes([("n", False)], b"".join(pieces) + END, intra=([1], [0]), inter=([0], [1])), offsets


def test_garbage_costs_the_frames_up_to_the_next_intra_frame_and_is_reported(tmp_path):
    data, offsets = damaged_log()
    broken = bytearray(data)
    broken[offsets[100] : offsets[103]] = b"\x07" * (offsets[103] - offsets[100])
    (tmp_path / "a.bbl").write_bytes(broken)
    frames = frames_of(bytes(broken))
    # the garbage begins where a frame letter should stand, so that the frame before is suspect too
    lost = sorted(set(range(40 * 32)) - set((frames.time // 1000).tolist()))
    assert lost == list(range(99, 128))
    np.testing.assert_array_equal(frames.values["n"], frames.time // 1000)
    recording = read_blackbox(tmp_path / "a.bbl")
    (span,) = recording.metadata["corrupt spans"]
    assert (span["start"], span["end"]) == (pytest.approx(0.098), pytest.approx(0.128))
    assert span["bytes"] == offsets[128] - offsets[99]
    assert [gap["cause"] for gap in recording.metadata["time gaps"]] == ["damage"]
    assert "0.030 s" in recording.notes[0]


def test_cut_anywhere_keeps_every_frame_before_the_cut(tmp_path):
    data, offsets = damaged_log()
    rng = np.random.default_rng(0)
    for cut in rng.integers(offsets[0] + 1, len(data), 60):
        frames = frames_of(data[:cut])
        whole = np.searchsorted(offsets, cut, side="right") - 1
        # a cut through the last values can leave a shorter frame that reads well
        assert whole <= len(frames.time) <= whole + 1
        np.testing.assert_array_equal(frames.time[:whole], 1000 * np.arange(whole))
    (tmp_path / "cut.bbl").write_bytes(data[: offsets[200] + 2])
    assert any("end-of-log" in note for note in read_blackbox(tmp_path / "cut.bbl").notes)


def test_much_garbage_neither_adds_frames_nor_unsays_those_before():
    data, offsets = damaged_log()
    rng = np.random.default_rng(1)
    garbage = rng.integers(0, 256, 1_000_000, dtype=np.uint8).tobytes()
    frames = frames_of(data[: offsets[640]] + garbage + data[offsets[640] :])
    expected = [*range(639), *range(640, 1280)]  # the frame before the garbage is not followed by a letter
    assert (frames.time // 1000).tolist() in (expected, sorted({*expected, 639}))
    np.testing.assert_array_equal(frames.values["n"], frames.time // 1000)
    assert len(frames.spans) == 1


def test_a_wrong_first_frame_gives_way_to_the_two_that_follow():
    data, offsets = damaged_log()
    head = data[: offsets[0]]
    wrong = intra_frame(7, 3_000_000_000, uvb(0))
    frames = frames_of(head + wrong + data[offsets[32] :])
    assert (frames.time // 1000).tolist() == list(range(64, 1280))
    assert frames.counts["rejected"] == 2


@pytest.mark.parametrize("padding", [b"\xff" * 5000, b"\x00" * 5000])
def test_blank_storage_behind_a_cut_log_is_no_damage(padding):
    data, offsets = damaged_log()
    frames = frames_of(data[: offsets[200]] + padding)
    assert len(frames.time) == 200
    assert len(frames.spans) == 0


def test_mutated_logs_raise_nothing_but_read_errors(tmp_path):
    data, _ = damaged_log()
    rng = np.random.default_rng(5)
    path = tmp_path / "fuzzed.bbl"
    for _ in range(300):
        broken = bytearray(data)
        for _ in range(rng.integers(1, 12)):
            at = int(rng.integers(0, len(broken)) if rng.random() < 0.5 else rng.integers(0, 900))
            kind = rng.integers(0, 4)
            if kind == 0:
                broken[at] = rng.integers(0, 256)
            elif kind == 1:
                broken[at : at + 20] = rng.bytes(int(rng.integers(0, 40)))
            elif kind == 2:
                del broken[at : at + int(rng.integers(1, 50))]
            else:
                broken[at:at] = broken[: int(rng.integers(1, 2000))]
        path.write_bytes(broken)
        try:
            recording = read_blackbox(path)
        except ReadError:
            continue
        t = recording.series["onboard"].t
        assert np.all(np.diff(t) > 0)
        assert all(len(v) == len(t) for v in recording.series["onboard"].values.values())


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
    path.write_bytes(one + two + log_bytes([], b""))
    assert [(log["number"], log["frames"]) for log in list_logs(path)] == [(1, 2), (2, 2), (3, 0)]
    longest = read_blackbox(path)
    assert longest.metadata["log"] == 2
    assert longest.metadata["duration"] == pytest.approx(0.009)
    assert any("3 logs" in note for note in longest.notes)
    assert read_blackbox(path, log_number=1).metadata["duration"] == pytest.approx(1e-4)
    with pytest.raises(ReadError, match="choose 1 to 3"):
        read_blackbox(path, log_number=4)
    with pytest.raises(ReadError, match="no readable frame"):
        read_blackbox(path, log_number=3)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"not a log at all", "holds no blackbox log"),
        (log_bytes([], b"") * 44, "44 logs, none with a readable frame"),
        (log_bytes([], b""), "no readable frame"),
        (log_bytes([], b"\x00" * 40), "no readable frame"),
        (log_bytes([], intra_frame(0, 1)).replace(b"version:2", b"version:1"), "data version is '1', expected 2"),
        (log_bytes([], intra_frame(0, 1)).replace(b"encoding:1,1", b"encoding:1,4"), "encoding 4"),
        (log_bytes([], intra_frame(0, 1)).replace(b"encoding:1,1", b"encoding:1"), "1 entries, expected 2"),
        (log_bytes([], intra_frame(0, 1)).replace(b"predictor:0,0", b"predictor:0,5", 1), "motor"),
        (log_bytes([], intra_frame(0, 1)).replace(b",time", b",tame"), "no time"),
        (log_bytes([], intra_frame(0, 1)).replace(b"I interval:32", b"I interval:0"), "I interval"),
        (log_bytes([], intra_frame(0, 1)).replace(b"P interval:1", b"P interval:1/9" + b"9" * 30), "P interval"),
        (log_bytes([], intra_frame(0, 1)).replace(b"signed:0,0", b"signed:0,9" + b"9" * 30), "small whole numbers"),
        (b"H Product:Blackbox\n" * 1500, "1500 log headers"),
    ],
)
def test_unreadable_files_are_refused_in_a_sentence(tmp_path, content, words):
    path = tmp_path / "bad.bbl"
    path.write_bytes(content)
    with pytest.raises(ReadError, match="bad.bbl") as error:
        read_blackbox(path)
    assert words in str(error.value)


def test_fields_that_take_no_bytes_do_not_blow_up_memory():
    fields = [(f"f{i}", True) for i in range(200)]
    body = intra_frame(0, 1) + inter_frame(1) + b"P\x00" * 5000
    data = log_bytes(fields, body + END, intra=([9] * 200, [0] * 200), inter=([9] * 200, [1] * 200))
    frames = frames_of(data)
    assert len(frames.time) == 5002
    assert frames.values["f199"].base.nbytes <= 8 * 202 * (len(frames.time) + 2)


def test_absent_file_is_named(tmp_path):
    with pytest.raises(ReadError, match=r"nowhere\.bbl does not exist"):
        read_blackbox(tmp_path / "nowhere.bbl")


def test_damaged_header_line_does_not_hide_the_log():
    data = log_bytes([("a", True)], intra_frame(0, 1, svb(4)) + END, header="Craft name:x\nacc_1G:2048")
    (log,) = find_logs(data.replace(b"H Craft name:x", b"\x01\x02\xff\x00broken"), "x")
    assert log.damage == 1
    assert log.header["acc_1G"] == "2048"


def reference(number, name=REAL):
    """Column names and {column: numbers} of a decode by the independent C program."""
    lines = gzip.decompress((SHARED / f"{name}.{number:02d}.csv.gz").read_bytes()).decode().splitlines()
    names = [column.strip() for column in lines[0].split(",")]
    rows = [line.split(",")[:35] for line in lines[1:] if line.lstrip()[:1].isdigit()]
    return names[:35], dict(zip(names, np.array(rows, float).T))


@needs_real
@pytest.mark.parametrize(("number", "more"), [(1, 11), (2, 1)])
def test_every_frame_of_a_real_log_equals_the_reference_decode(number, more):
    """The reference drops the P frames between a flight-mode event and the next I frame; these are `more` here."""
    data = (SHARED / f"{REAL}.bbl").read_bytes()
    frames = decode(data, find_logs(data, REAL)[number - 1])
    names, expected = reference(number)
    time = np.round(expected["time (s)"] * 1e6).astype(np.int64)
    assert len(frames.time) == len(time) + more
    at = np.searchsorted(frames.time, time)
    np.testing.assert_array_equal(frames.time[at], time)
    scales = {"gyroADC": math.pi / 180, "accSmooth": 9.80665 / 2048, "vbatLatest": 0.1, "amperageLatest": 0.01}
    for name in names[2:]:
        field = name.split(" ")[0]
        scale = scales.get(field.split("[")[0])
        got = frames.values[field][at]
        if scale is None:
            np.testing.assert_array_equal(got, expected[name], err_msg=name)
        else:
            # printed with two decimals; half a unit of the last, plus the float32 arithmetic of the printer
            np.testing.assert_allclose(got * scale, expected[name], atol=0.00501, err_msg=name)


@needs_real
def test_frames_that_only_this_reader_keeps_continue_the_log():
    data = (SHARED / f"{REAL}.bbl").read_bytes()
    for number in (1, 2):
        frames = decode(data, find_logs(data, REAL)[number - 1])
        # iterations run on without a jump into the next I frame, which states them itself
        assert set(np.diff(frames.values["loopIteration"])) == {16.0}
        assert np.all((np.diff(frames.time) > 1500) & (np.diff(frames.time) < 10_000))


@needs_real
def test_damaged_real_log_gives_the_two_frames_and_says_what_was_lost():
    recording = read_blackbox(SHARED / "damaged.bbl")
    _, expected = reference(1, "damaged")
    np.testing.assert_allclose(recording.series["onboard"].t, expected["time (s)"], atol=1e-9)
    (span,) = recording.metadata["corrupt spans"]
    assert span["end"] - span["start"] == pytest.approx(0.032079, abs=1e-6)
    assert recording.metadata["frames"]["P after damage"] == 5


@pytest.mark.parametrize("text", ["8\x1e", "²", "9" * 5000, "4\u00a0", "--3"])
def test_header_numbers_that_only_look_so_stay_text(text):
    """Control characters and superscripts count as blanks and digits for Python, but are no numbers."""
    header = {"looptime": text, "debug_mode": text, "Firmware revision": f"Betaflight {text}.{text}"}
    assert blackbox_header.plain_header(header)["looptime"] == text
    assert blackbox_units.debug_mode(header) is None
    assert blackbox_header.version(header) is None
