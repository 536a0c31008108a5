"""Blackbox logs: every encoding and predictor by hand, iterations, wrapping numbers, every kind of frame."""

import math

import numpy as np
import pytest
from blackbox_writer import (
    END,
    frames_of,
    inter_frame,
    intra_frame,
    log_bytes,
    neg14,
    svb,
    tag2_3s32,
    tag2_3svariable,
    tag8_4s16,
    tag8_8svb,
    uvb,
)


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


def test_fields_that_take_no_bytes_do_not_blow_up_memory():
    fields = [(f"f{i}", True) for i in range(200)]
    body = intra_frame(0, 1) + inter_frame(1) + b"P\x00" * 5000
    data = log_bytes(fields, body + END, intra=([9] * 200, [0] * 200), inter=([9] * 200, [1] * 200))
    frames = frames_of(data)
    assert len(frames.time) == 5002
    assert frames.values["f199"].base.nbytes <= 8 * 202 * (len(frames.time) + 2)
