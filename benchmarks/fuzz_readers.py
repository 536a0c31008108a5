"""Feed damaged files to the readers: nothing but the readers' own error may come out, in bounded time and memory.

    python benchmarks/fuzz_readers.py [--reader NAME|all] [--inputs 100000] [--seed 0] [--slowest 2.0]

Every 25th input is a round trip: what a writer wrote is what the reader yields, sample by sample
(`reader_round_trips.py`). Compiled kernels check their array bounds (NUMBA_BOUNDSCHECK=1), so that a read beyond an
array raises an error in place of returning what lies there. `planted_faults.py` measures what the search finds.
Prints per reader how many inputs were read and refused, the slowest, and the memory grown; the exit code is 1 after a
crash, and the input that caused it is left in the working folder. No input may make the process larger than 6 GB.
"""

import argparse
import os
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests/unit"), str(ROOT / "benchmarks")]

from reader_inputs import READERS, broken_input  # noqa: E402
from reader_round_trips import round_trip  # noqa: E402

from quasi import tables  # noqa: E402
from quasi.errors import QuasiError  # noqa: E402
from quasi.importing.series import Recording  # noqa: E402

LARGEST = 6 << 30  # bytes of address space that a run may take
HANGING = 60  # s after which a reader is stopped (the first input compiles)
ROUND_TRIP_EVERY = 25  # inputs: a round trip costs up to ten times as much as a damaged file


def check(recording: Recording) -> None:
    """What every recording keeps, whatever it was read from. Raises AssertionError."""
    for series in recording.series.values():
        assert np.isfinite(series.t).all(), "time is not finite"
        assert np.all(np.diff(series.t) > 0), "time does not increase"
        assert all(len(v) == len(series.t) for v in series.values.values()), "lengths differ"
        assert all(not np.isinf(v).any() for v in series.values.values()), "infinite values"
    tables.fingerprint(recording.metadata)


def outcome(read: Callable[[Path], Recording], path: Path) -> str:
    """Whether a file is "read" or "refused", by an error that names it; raises anything else that comes out."""
    try:
        check(read(path))
    except QuasiError as error:
        assert str(path.with_suffix("")) in str(error), f"the error does not name its file: {error}"
        return "refused"
    return "read"


def fuzz(name: str, inputs: int, seed: int, slowest: float) -> bool:
    """Run one reader over many inputs; whether it held."""
    read, seeds = READERS[name]
    rng = np.random.default_rng(seed)
    originals = seeds(rng)
    counts = {"read": 0, "refused": 0}
    worst = 0.0
    started = time.perf_counter()
    grown = 0

    def hang(*_: object) -> None:
        raise TimeoutError(f"more than {HANGING} s")

    signal.signal(signal.SIGALRM, hang)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.raw"
        for i in range(inputs):
            if i % ROUND_TRIP_EVERY == 0:
                round_trip(name, np.random.default_rng([seed, i]))
            broken = broken_input(name, originals, i, rng)
            path.write_bytes(broken)
            signal.alarm(HANGING)
            start = time.perf_counter()
            try:
                counts[outcome(read, path)] += 1
            except Exception as error:
                kept = Path(f"crash-{name}-{seed}-{i}.raw")
                kept.write_bytes(broken)
                print(f"{name}: input {i} raised {type(error).__name__}: {error}; kept as {kept}")
                return False
            finally:
                signal.alarm(0)
            took = time.perf_counter() - start
            # the first inputs load compiled kernels
            if i > min(200, inputs // 2):
                worst = max(worst, took)
            if i == min(200, inputs // 2):
                grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - grown) / 1024
    rate = inputs / (time.perf_counter() - started)
    print(f"{name:10} {inputs:8} inputs, {counts['read']} read, {counts['refused']} refused, {rate:.0f}/s")
    print(f"{'':10} slowest {worst * 1e3:.1f} ms, memory grown {grown:.0f} MB (both after the first 200)")
    return worst < slowest


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--reader", choices=[*READERS, "all"], default="all")
    arguments.add_argument("--inputs", type=int, default=100_000)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--slowest", type=float, default=2.0, help="seconds that one input may take")
    given = arguments.parse_args()
    warnings.simplefilter("error")
    resource.setrlimit(resource.RLIMIT_AS, (LARGEST, LARGEST))
    chosen = list(READERS) if given.reader == "all" else [given.reader]
    return int(not all(fuzz(name, given.inputs, given.seed, given.slowest) for name in chosen))


def with_bounds_checks() -> None:
    """Start this program again with kernels that check their bounds, compiled into a folder of their own."""
    if os.environ.get("NUMBA_BOUNDSCHECK") != "1":
        folder = Path(tempfile.gettempdir()) / "quasi-bounds-checked"
        # without optimisation the kernels compile three times faster
        changed = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_OPT": "1", "NUMBA_CACHE_DIR": str(folder)}
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **changed})


if __name__ == "__main__":
    with_bounds_checks()
    sys.exit(main())
