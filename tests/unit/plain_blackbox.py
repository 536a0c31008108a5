"""A plain slow decoder of blackbox logs, written from the format's public description."""


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
