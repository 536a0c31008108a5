"""Write Crazyflie micro-SD logs, for tests and for the fuzzer of the readers."""

import struct
import zlib
from collections.abc import Mapping, Sequence

STAMPS = {1: ("I", 1e3), 2: ("Q", 1e6)}  # version: letter of the time stamp, counts per second


def encode_log(
    types: Mapping[int, tuple[str, Sequence[str]]], records: Sequence[tuple[int, float, Sequence[float]]],
    version: int = 2,
) -> bytes:  # fmt: skip
    """A whole log with its checksum.

    types  {id: (name, ["group.name(c)", ...])}; records [(id, time in s, values)]
    """
    data = struct.pack("<BHH", 0xBC, version, len(types))
    for number, (name, variables) in types.items():
        data += struct.pack("<H", number) + name.encode() + b"\0" + struct.pack("<H", len(variables))
        data += b"".join(text.encode() + b"\0" for text in variables)
    letter, counts = STAMPS[version]
    for number, t, values in records:
        letters = [text[-2] for text in types[number][1]]
        numbers = [v if c in "efd" else int(v) for c, v in zip(letters, values)]
        data += struct.pack(f"<H{letter}{''.join(letters)}", number, round(t * counts), *numbers)
    return data + struct.pack("<I", zlib.crc32(data))
