"""The blackbox writer against a plain decoder written from the format's public description."""

import numpy as np
import pytest
from plain_blackbox import Plain

from quasi_synthesis import blackbox_writer as writer


@pytest.mark.parametrize(
    ("data", "expected"),
    # the printed examples in the tests of the crate blackbox-log
    [(b"\x0d", [0, -1, 1]), (b"\x41\x23", [1, 2, 3]), (b"\x81\x02\x03", [1, 2, 3])],
)
def test_the_plain_decoder_and_the_writer_agree_with_printed_triples(data, expected):
    assert Plain(data).three() == expected
    out = np.zeros(16, np.uint8)
    assert bytes(out[: writer._put_three(out, 0, *expected)]) == data or data[0] == 0x81
    assert Plain(bytes(out)).three() == expected


def test_the_plain_decoder_and_the_writer_agree_with_a_printed_quadruple():
    data = bytes([0x30, 181, 61])
    assert Plain(data).four() == [0, 0, -19139, 0]
    out = np.zeros(16, np.uint8)
    assert bytes(out[: writer._put_four(out, 0, np.array([0, 0, -19139, 0]), 0)]) == data


def sample(n: int, seed: int, wild: bool) -> np.ndarray:
    rng = np.random.default_rng(seed)
    size = {"axis": 300, "rcCommand": 500, "setpoint": 700, "gyro": 2000, "acc": 30000}
    values = np.zeros((n, len(writer.FIELD_NAMES)), np.int64)
    for k, name in enumerate(writer.FIELD_NAMES):
        top = next((v for word, v in size.items() if name.startswith(word)), 100)
        steps = rng.normal(0, top if wild else top / 50, n)
        values[:, k] = np.clip(steps if wild else np.cumsum(steps), -32000, 32000)
        if name.startswith(("motor", "eRPM")):
            values[:, k] = 158 + np.abs(values[:, k]) * 5
        if name in ("rcCommand[3]", "rssi"):
            values[:, k] = np.abs(values[:, k]) + 1000
        if name == "vbatLatest":
            values[:, k] = 1600 + values[:, k] % 90
    values[:, 0] = 1024 + 4 * np.arange(n)
    values[:, 1] = 40_000_000 + 1000 * np.arange(n) + rng.integers(-3, 4, n)
    return values


@pytest.mark.parametrize("wild", [False, True])
def test_every_value_written_is_read_back_by_the_plain_decoder(wild):
    values = sample(300, 3, wild)
    others = [(0, writer.slow_frame(2, 0)), (0, writer.event("sync beep", 40_000_000)), (100, writer.slow_frame(3, 31))]
    others += [(100, writer.event("flight mode", 3, 2)), (300, writer.event("disarm", 4)), (300, writer.event("end"))]
    data, rows = writer.encode_log(values, others)
    assert rows == 300
    names, frames = Plain(data).frames()
    assert tuple(names) == writer.FIELD_NAMES
    np.testing.assert_array_equal([row for kind, row in frames if kind in "IP"], values)
    assert [f for f in frames if f[0] not in "IP"] == [
        ("S", [2, 0, 0, 1, 1]),
        ("E", [0, 40_000_000]),
        ("S", [3, 31, 0, 1, 1]),
        ("E", [30, 3, 2]),
        ("E", [15, 4]),
        ("E", [255]),
    ]


def test_whole_frames_come_every_interval_and_after_lost_rows_only_from_the_next_one():
    values = sample(200, 5, False)
    keep = np.ones(200, bool)
    keep[40:50] = False
    data, rows = writer.encode_log(values[keep], [])
    _, frames = Plain(data).frames()
    iterations = [row[0] for _, row in frames]
    kept = [1024 + 4 * k for k in range(200) if k < 40 or k >= 64]  # I frames lie 32 rows apart
    assert iterations == kept and rows == len(kept)
    assert [row[0] for kind, row in frames if kind == "I"] == [i for i in kept if i % 128 == 0]
    np.testing.assert_array_equal([row for _, row in frames], values[(np.array(kept) - 1024) // 4])


def test_headers_describe_every_field_and_name_what_a_reader_needs():
    plain = Plain(writer.headers({"motor_poles": "12", "Craft name": "X"}))
    count = len(writer.FIELD_NAMES)
    for name in ("I signed", "I predictor", "I encoding", "P predictor", "P encoding"):
        assert len(plain.numbers(f"Field {name}")) == count
    assert plain.header["motor_poles"] == "12" and plain.header["Craft name"] == "X"
    assert plain.header["Firmware revision"].startswith("Betaflight 4.5.")
    assert {"gyro_scale", "acc_1G", "motorOutput", "vbatref", "looptime", "debug_mode"} <= set(plain.header)
