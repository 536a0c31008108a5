"""Feed damaged files to the readers: nothing but the readers' own error may come out, in bounded time and memory.

    python benchmarks/fuzz_readers.py [--reader blackbox|decoded|all] [--inputs 100000] [--seed 0] [--slowest 2.0]

Prints per reader how many inputs were read and refused, the slowest, and the memory grown; the exit code is 1 after a
crash, and the input that caused it is left in the working folder.
"""

import argparse
import resource
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from quasi import tables
from quasi.errors import ReadError
from quasi.importing.blackbox import read_blackbox
from quasi.importing.decoded import read_decoded
from quasi.importing.series import Recording
from quasi.synthesis.blackbox_writer import NAMES, encode_log, event, slow_frame


def blackbox_seeds(rng: np.random.Generator) -> list[bytes]:
    """Short logs: one, two in one file, headers without frames."""
    n = 120
    values = rng.integers(0, 40, (n, len(NAMES)))
    values[:, NAMES.index("loopIteration")] = 4 * np.arange(n)
    values[:, NAMES.index("time")] = 1_000_000 + 1000 * np.arange(n)
    others = [(0, event("sync beep", 5)), (3, slow_frame(1, 0)), (60, event("flight mode", 1, 0))]
    log = encode_log(values, others)[0] + event("end")
    bare = log[: log.rfind(b"H ")]
    return [log, log + log[: len(log) // 2], (bare[: bare.rfind(b"\n") + 1]) * 5]


def decoded_seeds(rng: np.random.Generator) -> list[bytes]:
    """Both programs' shapes."""
    names = (
        "loopIteration, time (us), vbatLatest (V), gyroADC[0] (deg/s), gyroADC[1] (deg/s), accSmooth[0] (g), motor[0]"
    )
    rows = [", ".join(map(str, [i, 1000 * i, 16.5, *rng.integers(-200, 200, 4)])) for i in range(40)]
    tool = "\n".join([names, *rows[:5], "S frame: ANGLE_MODE, 0, IDLE, 1, 1", *rows[5:]])
    head = '"Product","Blackbox"\n"gyroScale","1.745e-8"\n"motorOutput","158,2047"\n'
    viewer = (
        head
        + '"loopIteration","time","gyroADC[0]","accSmooth[0]","motor[0]","eRPM[0]"\n'
        + "\n".join(",".join(map(str, [i, 500 * i, *rng.integers(0, 900, 4)])) for i in range(40))
    )
    return [tool.encode(), viewer.encode()]


READERS: dict[str, tuple[Callable[[Path], Recording], Callable[[np.random.Generator], list[bytes]]]] = {
    "blackbox": (read_blackbox, blackbox_seeds),
    "decoded": (read_decoded, decoded_seeds),
}


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes flipped, runs overwritten, removed, repeated or inserted, numbers swapped, the end cut off."""
    broken = bytearray(data)
    for _ in range(int(rng.integers(1, 10))):
        if not broken:
            break
        at = int(rng.integers(0, len(broken)))
        length = int(min(len(broken) - at, 1 << rng.integers(0, 8)))
        kind = int(rng.integers(0, 8))
        if kind == 0:
            broken[at] = int(rng.integers(0, 256))
        elif kind == 1:
            broken[at : at + length] = rng.bytes(length)
        elif kind == 2:
            del broken[at : at + length]
        elif kind == 3:
            broken[at:at] = broken[at : at + length]
        elif kind == 4:
            broken[at:at] = bytes([int(rng.choice([0, 255, 73, 80, 69, 72]))]) * length
        elif kind == 5 and rng.random() < 0.3:
            del broken[at:]
        elif kind == 6:
            # a number of the text becomes another, where the readers believe what is stated
            digits = [i for i in range(at, min(len(broken), at + 200)) if 48 <= broken[i] <= 57]
            if digits:
                words = [b"0", b"-1", b"99999999999999999999", b"1e308", b"nan", b"x", b"255"]
                broken[digits[0] : digits[0] + 1] = words[int(rng.integers(0, len(words)))]
        else:
            other = int(rng.integers(0, len(broken)))
            broken[at : at + length] = broken[other : other + length]
    return bytes(broken)


def fuzz(name: str, inputs: int, seed: int, slowest: float) -> bool:
    """Run one reader over many inputs; whether it held."""
    read, seeds = READERS[name]
    rng = np.random.default_rng(seed)
    originals = seeds(rng)
    counts = {"read": 0, "refused": 0}
    worst = 0.0
    started = time.perf_counter()
    grown = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.raw"
        for i in range(inputs):
            broken = mutate(originals[i % len(originals)], rng)
            path.write_bytes(broken)
            start = time.perf_counter()
            try:
                recording = read(path)
                onboard = recording.series["onboard"]
                assert np.all(np.diff(onboard.t) > 0), "time does not increase"
                assert all(len(v) == len(onboard.t) for v in onboard.values.values()), "lengths differ"
                tables.fingerprint(recording.metadata)
                counts["read"] += 1
            except ReadError:
                counts["refused"] += 1
            except Exception as error:
                kept = Path(f"crash-{name}-{seed}-{i}.raw")
                kept.write_bytes(broken)
                print(f"{name}: input {i} raised {type(error).__name__}: {error}; kept as {kept}")
                return False
            took = time.perf_counter() - start
            if i:
                worst = max(worst, took)
            if i == min(200, inputs // 2):
                grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - grown) / 1024
    rate = inputs / (time.perf_counter() - started)
    print(f"{name:10} {inputs:8} inputs, {counts['read']} read, {counts['refused']} refused, {rate:.0f}/s")
    print(f"{'':10} slowest {worst * 1e3:.1f} ms, memory grown {grown:.0f} MB after the first")
    return worst < slowest


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--reader", choices=[*READERS, "all"], default="all")
    arguments.add_argument("--inputs", type=int, default=100_000)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--slowest", type=float, default=2.0, help="seconds that one input may take")
    given = arguments.parse_args()
    warnings.simplefilter("error")
    chosen = list(READERS) if given.reader == "all" else [given.reader]
    return int(not all(fuzz(name, given.inputs, given.seed, given.slowest) for name in chosen))


if __name__ == "__main__":
    sys.exit(main())
