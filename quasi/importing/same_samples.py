"""Whether two logs hold the same flight, whatever their format or compression: by a sketch of their gyro's samples."""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

SUCCESSIVE = 3  # samples of three axes that are taken together: alone, coarse ones come again in any hover
SIZE = 32  # numbers of a sketch
# shared numbers from which two sketches are of one flight: of a recording and its fourth part. The standard error of
# the share is at most 0.09 (Broder, Compression and Complexity of Sequences, 1997), and other flights share none
LEAST_SHARED = 8


def sketch(gyro: np.ndarray) -> list[str]:
    """The smallest numbers that a hash makes of successive samples (n, 3) of a gyro, as text; [] for a log of fewer.

    Rows that are absent at either end, other separators, rounding in the last digits of a float and compression leave
    most of them as they are.
    """
    fine = np.ascontiguousarray(gyro[np.isfinite(gyro).all(axis=1)], np.float32)
    if len(fine) < SUCCESSIVE:
        return []
    words = np.lib.stride_tricks.sliding_window_view((fine + 0.0).view(np.uint32).ravel(), 3 * SUCCESSIVE)[::3]
    found = np.zeros(len(words), np.uint64)
    for word in words.T:  # the finalizer of SplitMix64 after each word (Steele, Lea & Flood, OOPSLA 2014)
        found = (found + word.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        found ^= found >> np.uint64(30)
        found *= np.uint64(0xBF58476D1CE4E5B9)
        found ^= found >> np.uint64(27)
    return [f"{number:016x}" for number in np.unique(found)[:SIZE]]


def is_same_flight(one: Sequence[str], other: Sequence[str]) -> bool:
    """Whether two sketches share at least LEAST_SHARED of the smallest SIZE numbers of both together."""
    smallest = sorted({*one, *other})[:SIZE]
    return len(smallest) == SIZE and len({*smallest} & {*one} & {*other}) >= LEAST_SHARED


def find_same_flights(sketches: Mapping[str, Sequence[str]]) -> list[tuple[str, str]]:
    """Pairs of names whose sketches are of one flight."""
    holders: dict[str, list[str]] = {}
    for name, numbers in sketches.items():
        for number in numbers:
            holders.setdefault(number, []).append(name)
    # only logs that share a number are compared: there may be thousands
    pairs = dict.fromkeys(pair for names in holders.values() for pair in combinations(names, 2))
    return [pair for pair in pairs if is_same_flight(sketches[pair[0]], sketches[pair[1]])]
