"""Whether two logs hold the same flight, whatever their format or compression: by sketches of their samples.

A log of which one quantity was changed, as a fault is planted in a recording, is another one.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from quasi.importing.series import Series, Track

SUCCESSIVE = 3  # samples that are taken together: alone, coarse ones come again in any hover
SIZE = 32  # numbers of a sketch
# shared numbers from which two sketches are of one flight: of a recording and its fourth part. The standard error of
# the share is at most 0.09 (Broder, Compression and Complexity of Sequences, 1997), and other flights share none
LEAST_SHARED = 8
HALF_STAMP = 0.5e-6  # s: logs are stamped in whole microseconds (ULog, Blackbox)
OF_GYRO = "gyro"
SKETCHED = {
    "accelerometer": ("ax", "ay", "az"), "attitude": ("qw", "qx", "qy", "qz"), "position": ("x", "y", "z"),
    "velocity": ("vx", "vy", "vz"), "body velocity": ("u", "v", "w"),
    "rotor speeds": tuple(f"w{i}" for i in range(1, 9)), "commands": tuple(f"command{i}" for i in range(1, 9)),
}  # fmt: skip
Sketches = Mapping[str, Sequence[str]]


def sketches_of(gyro: Track, series: Mapping[str, Series]) -> dict[str, list[str]]:
    """{quantity: sketch} of a log: of the gyro's samples, and of each other quantity with the gyro's nearest sample, so
    that a quantity that was moved in time is another."""
    found = {OF_GYRO: sketch(gyro.values)}
    for name, one in series.items():
        after = np.clip(np.searchsorted(gyro.t, one.t), 1, len(gyro.t) - 1)
        # midway between two, the one before: as written, and not as rounding has it
        near = np.where(2.0 * one.t - gyro.t[after - 1] - gyro.t[after] < HALF_STAMP, after - 1, after)
        for label, quantities in SKETCHED.items():
            own = [one.values[q] for q in quantities if q in one.values]
            key = f"captured {label}" if name == "capture" else label
            if own and key not in found:
                found[key] = sketch(np.column_stack([gyro.values[near], *own]))
    return found


def sketch(samples: np.ndarray) -> list[str]:
    """The smallest numbers that a hash makes of successive samples (n, C), as text; [] for a log of fewer.

    Rows that are absent at either end, other separators, rounding in the last digits of a float and compression leave
    most of them as they are.
    """
    fine = np.ascontiguousarray(samples[np.isfinite(samples).all(axis=1)], np.float32)
    if len(fine) < SUCCESSIVE:
        return []
    width = fine.shape[1]
    words = np.lib.stride_tricks.sliding_window_view((fine + 0.0).view(np.uint32).ravel(), width * SUCCESSIVE)[::width]
    found = np.zeros(len(words), np.uint64)
    for word in words.T:  # the finalizer of SplitMix64 after each word (Steele, Lea & Flood, OOPSLA 2014)
        found = (found + word.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        found ^= found >> np.uint64(30)
        found *= np.uint64(0xBF58476D1CE4E5B9)
        found ^= found >> np.uint64(27)
    return [f"{number:016x}" for number in np.unique(found)[:SIZE]]


def is_alike(one: Sequence[str], other: Sequence[str]) -> bool:
    """Whether two sketches share at least LEAST_SHARED of the smallest SIZE numbers of both together."""
    smallest = sorted({*one, *other})[:SIZE]
    return len(smallest) == SIZE and len({*smallest} & {*one} & {*other}) >= LEAST_SHARED


def is_same_flight(one: Sketches, other: Sketches) -> bool:
    """Whether two logs share the gyro's samples, and those of every other quantity that both hold enough of."""
    both = [n for n in one if n in other and min(len(one[n]), len(other[n])) == SIZE]
    return OF_GYRO in both and all(is_alike(one[n], other[n]) for n in both)


def find_same_flights(sketches: Mapping[str, Sketches]) -> list[tuple[str, str]]:
    """Pairs of names whose sketches are of one flight."""
    holders: dict[str, list[str]] = {}
    for name, of in sketches.items():
        for number in of[OF_GYRO]:
            holders.setdefault(number, []).append(name)
    # only logs that share a number are compared: there may be thousands
    pairs = dict.fromkeys(pair for names in holders.values() for pair in combinations(names, 2))
    return [pair for pair in pairs if is_same_flight(sketches[pair[0]], sketches[pair[1]])]
