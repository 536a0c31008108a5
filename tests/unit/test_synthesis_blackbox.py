"""The blackbox writer against a plain decoder written from the format's public description."""

import numpy as np
import pytest

from quasi.synthesis import blackbox_writer as writer


class Plain:
    """A slow decoder of data version 2, one byte at a time."""

    def __init__(self, data: bytes):
        self.data, self.at = data, 0
        self.header: dict[str, str] = {}
        while self.data[self.at : self.at + 2] == b"H ":
            end = self.data.index(b"\n", self.at)
            name, _, value = self.data[self.at + 2 : end].decode().partition(":")
            self.header[name] = value
            self.at = end + 1

    def byte(self) -> int:
        self.at += 1
        return self.data[self.at - 1]

    def unsigned(self) -> int:
        value, shift = 0, 0
        while True:
            b = self.byte()
            value |= (b & 127) << shift
            shift += 7
            if b < 128:
                return value

    def signed(self) -> int:
        value = self.unsigned()
        return (value >> 1) ^ -(value & 1)

    @staticmethod
    def extend(value: int, bits: int) -> int:
        return value - (1 << bits) if value >> (bits - 1) & 1 else value

    def three(self) -> list[int]:
        lead = self.byte()
        kind = lead >> 6
        if kind == 0:
            return [self.extend(lead >> s & 3, 2) for s in (4, 2, 0)]
        if kind == 1:
            b = self.byte()
            return [self.extend(v, 4) for v in (lead & 15, b >> 4, b & 15)]
        if kind == 2:
            return [self.extend(v & 63, 6) for v in (lead, self.byte(), self.byte())]
        values = []
        for k in range(3):
            size = (lead >> 2 * k & 3) + 1
            values.append(self.extend(sum(self.byte() << 8 * n for n in range(size)), 8 * size))
        return values

    def four(self) -> list[int]:
        sizes = self.byte()
        sizes = [(0, 1, 2, 4)[sizes >> 2 * k & 3] for k in range(4)]
        nibbles: list[int] = []
        for _ in range((sum(sizes) + 1) // 2):
            b = self.byte()
            nibbles += [b >> 4, b & 15]
        values = []
        for size in sizes:
            value = 0
            for n in nibbles[:size]:
                value = value << 4 | n
            nibbles = nibbles[size:]
            values.append(self.extend(value, 4 * size) if size else 0)
        return values

    def fields(self, encodings: list[int]) -> list[int]:
        values: list[int] = []
        while len(values) < len(encodings):
            encoding = encodings[len(values)]
            if encoding == 0:
                values.append(self.signed())
            elif encoding == 1:
                values.append(self.unsigned())
            elif encoding == 3:
                values.append(-self.extend(self.unsigned() & 0x3FFF, 14))
            elif encoding == 6:
                count = 0
                while count < 8 and encodings[len(values) : len(values) + count + 1] == [6] * (count + 1):
                    count += 1
                if count == 1:
                    values.append(self.signed())
                    continue
                tag = self.byte()
                values += [self.signed() if tag >> k & 1 else 0 for k in range(count)]
            elif encoding == 7:
                values += self.three()
            elif encoding == 8:
                values += self.four()
            else:
                values.append(0)
        return values

    def numbers(self, name: str) -> list[int]:
        return [int(v) for v in self.header[name].split(",")]

    def frames(self):
        """(kind, values) of every frame; main frames' values are whole, one dict each."""
        names = self.header["Field I name"].split(",")
        plans = {k: (self.numbers(f"Field {k} predictor"), self.numbers(f"Field {k} encoding")) for k in ("P",)} | {
            "I": (self.numbers("Field I predictor"), self.numbers("Field I encoding"))
        }
        step = int(self.header["P interval"])
        last = older = [0] * len(names)
        found = []
        while self.at < len(self.data):
            kind = chr(self.byte())
            if kind in "IP":
                predictors, encodings = plans[kind]
                raw, row = self.fields(encodings), []
                for k, (value, predictor) in enumerate(zip(raw, predictors)):
                    guess = {
                        0: 0,
                        1: last[k],
                        2: 2 * last[k] - older[k],
                        3: int((last[k] + older[k]) / 2),
                        5: row[names.index("motor[0]")] if predictor == 5 else 0,
                        6: last[k] + step,
                        9: int(self.header["vbatref"]),
                        11: int(self.header["motorOutput"].split(",")[0]),
                    }[predictor]
                    row.append((value + guess + 2**31) % 2**32 - 2**31)
                older, last = (row, row) if kind == "I" else (last, row)
                found.append((kind, row))
            elif kind == "S":
                found.append((kind, self.fields(self.numbers("Field S encoding"))))
            elif kind == "E":
                number = self.byte()
                if number == 255:
                    assert self.data[self.at : self.at + 11] == b"End of log\0"
                    self.at += 11
                    found.append((kind, [255]))
                else:
                    count = {0: 1, 14: 2, 15: 1, 30: 2}[number]
                    found.append((kind, [number, *[self.unsigned() for _ in range(count)]]))
            else:
                raise AssertionError(f"frame kind {kind!r} at byte {self.at}")
        return names, found


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
    values = np.zeros((n, len(writer.NAMES)), np.int64)
    for k, name in enumerate(writer.NAMES):
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
    assert tuple(names) == writer.NAMES
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
    count = len(writer.NAMES)
    for name in ("I signed", "I predictor", "I encoding", "P predictor", "P encoding"):
        assert len(plain.numbers(f"Field {name}")) == count
    assert plain.header["motor_poles"] == "12" and plain.header["Craft name"] == "X"
    assert plain.header["Firmware revision"].startswith("Betaflight 4.5.")
    assert {"gyro_scale", "acc_1G", "motorOutput", "vbatref", "looptime", "debug_mode"} <= set(plain.header)
