"""Numbers in MATLAB files of version 5 (what `save` writes with -v6 and -v7): arrays, and structures of arrays.

An own reader, because scipy's crashes the process on damaged files. Every length is checked against the bytes that are
there. Cells, text, sparse arrays, objects and functions are named and left out.
Source: MathWorks, "MAT-File Format", chapter 1 (Level 5 MAT-files).
"""

import math
import zlib
from collections.abc import Iterator

import numpy as np

from quasi.input_limits import MAX_UNPACKED_BYTES

HEADER = 128  # bytes; the last four are version and byte order
MAT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
MATRIX, COMPRESSED = 14, 15
STRUCTURE, FIRST_NUMERIC, LAST_NUMERIC = 2, 6, 15  # classes of arrays
DEEPEST = 8  # structures within structures


class Damaged(ValueError):
    """A length or type that does not fit the bytes of the file."""


def read_variables(data: bytes, left_out: list[str]) -> Iterator[tuple[str, np.ndarray]]:
    """(name, array) of every variable of numbers, those of structures as "a.b".

    left_out  receives the names of variables of other classes
    Raises    Damaged
    """
    if len(data) < HEADER:
        raise Damaged("it ends within its header")
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise Damaged("its byte order is neither IM nor MI")
    left = MAX_UNPACKED_BYTES
    for kind, body in _elements(data[HEADER:], order):
        if kind == COMPRESSED:
            unpacker = zlib.decompressobj()
            try:
                body = unpacker.decompress(body, left + 1)
            except zlib.error as error:
                raise Damaged(str(error)) from None
            left -= len(body)
            if left < 0:
                raise Damaged(f"its variables unpack to more than {MAX_UNPACKED_BYTES / 1e6:,.0f} MB")
            kind, body = next(_elements(body, order), (0, b""))
        if kind == MATRIX:
            yield from _matrix(body, order, "", left_out, 0)


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """(type, content) one after the other; each begins on a multiple of 8 bytes unless it is compressed."""
    at, byte_order = 0, "little" if order == "<" else "big"
    while at + 8 <= len(data):
        first = int.from_bytes(data[at : at + 4], byte_order)
        if first >> 16:  # a small element: length and type in one word, the content in the next
            kind, size, start, step = first & 0xFFFF, first >> 16, at + 4, 8
            if size > 4:
                raise Damaged(f"a small element of {size} bytes")
        else:
            kind, size, start = first, int.from_bytes(data[at + 4 : at + 8], byte_order), at + 8
            step = 8 + (size if kind == COMPRESSED else size + -size % 8)
        if start + size > len(data):
            raise Damaged(f"an element of {size} bytes where {len(data) - start} are left")
        yield kind, data[start : start + size]
        at += step


def _numbers(element: tuple[int, bytes], order: str) -> np.ndarray:
    kind, body = element
    if kind not in MAT_TYPES or len(body) % np.dtype(MAT_TYPES[kind]).itemsize:
        raise Damaged(f"an element of type {kind} and {len(body)} bytes in place of numbers")
    return np.frombuffer(body, order + MAT_TYPES[kind])


def _matrix(
    body: bytes, order: str, prefix: str, left_out: list[str], depth: int, name: str | None = None
) -> Iterator[tuple[str, np.ndarray]]:
    """The variables in one array element; `name` replaces its own, which fields of structures do not have."""
    parts = _elements(body, order)
    try:
        flags, sizes, title = _numbers(next(parts), order), _numbers(next(parts), order), next(parts)[1]
        own = f"{prefix}{title.decode('latin-1') if name is None else name}"
        kind, count = int(flags[0]) & 0xFF, math.prod(int(n) for n in sizes)
        if kind == STRUCTURE and count == 1 and depth < DEEPEST:
            length = int(_numbers(next(parts), order)[0])
            names = next(parts)[1]
            if length < 1 or len(names) % length:
                raise Damaged("names of fields that do not fit their length")
            for start in range(0, len(names), length):
                label = names[start : start + length].partition(b"\0")[0].decode("latin-1")
                field, content = next(parts)
                if field == MATRIX and content:
                    yield from _matrix(content, order, f"{own}.", left_out, depth + 1, label)
        elif FIRST_NUMERIC <= kind <= LAST_NUMERIC:
            values = _numbers(next(parts), order)
            if any(n < 0 for n in sizes) or len(values) != count:
                raise Damaged(f"{len(values)} numbers in '{own[:40]}' of {count}")
            yield own, values.astype(values.dtype.newbyteorder("=")).reshape([int(n) for n in sizes], order="F")
        elif own:
            left_out.append(own)
    except (StopIteration, IndexError):
        raise Damaged("an array without its parts") from None
