"""Whether the fuzzer finds faults: 20 faults are planted in copies of the readers, and each is searched for.

    python benchmarks/planted_faults.py [--seconds 600] [--only NAME] [--seed 0] [--record]

A fault is one changed text of one file. The search is that of `fuzz_readers.py`: round trips and damaged files, with
kernels that check their bounds. Every fault is searched in a process of its own; the sound code is searched first and
must hold. Prints for each fault the seconds, the inputs and what was seen; the exit code is 1 where one is not found.
"""

import argparse
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
READERS = "quasi/importing/readers"
HANGING = 60  # s after which one input counts as a hang
COMPILING = 4  # inputs
ROUND_TRIP_SHARE = 4  # every 4th input is a round trip


class Fault(NamedTuple):
    """One fault: the reader whose search finds it, the file, its text, and the text that takes its place."""

    name: str
    reader: str
    file: str
    sound: str
    faulty: str


KERNEL = f"{READERS}/blackbox_kernel.py"
FAULTS = (
    # reads beyond an array in compiled code
    Fault("number read beyond the file", "blackbox", KERNEL,
          "        if at + i >= end:\n            return 0, -1\n        byte", "        byte"),
    Fault("letter read beyond the file", "blackbox", KERNEL,
          "if after >= 0 and after < end and known", "if after >= 0 and known"),
    Fault("tag read beyond the file", "blackbox", KERNEL,
          "            if at + width > end:\n                return -1\n", ""),
    Fault("end text read beyond the file", "blackbox", KERNEL,
          "if at + k >= end or data[at + k]", "if data[at + k]"),
    # values that are silently lost or changed
    Fault("first frame lost", "blackbox", f"{READERS}/blackbox.py",
          "        time=time[:n],\n        values={names[i]: main[k, :n]",
          "        time=time[1:n],\n        values={names[i]: main[k, 1:n]"),
    Fault("sign of a number lost", "blackbox", KERNEL, "(value >> 1) ^ -(value & 1), at", "(value >> 1), at"),
    Fault("half bytes exchanged", "blackbox", KERNEL, "(held & 15)", "(held >> 4)"),
    Fault("mean of two frames rounded down", "blackbox", KERNEL,
          "(both + 1) >> 1 if both < 0 else both >> 1", "both >> 1"),
    Fault("straight line predicted as constant", "blackbox", KERNEL,
          "2 * history[before, i] - history[before2, i]", "history[before, i]"),
    Fault("last record lost", "crazyflie", f"{READERS}/crazyflie_events.py",
          "    while at + 2 <= end:\n        number", "    while at + 30 <= end:\n        number"),
    Fault("first row lost", "table", f"{READERS}/table_text.py",
          "    lines = sum(1 for line in text.split",
          "    table = table.iloc[1:]\n    lines = sum(1 for line in text.split"),
    Fault("rows and columns exchanged", "mat", f"{READERS}/mat5.py", 'sizes], order="F")', 'sizes], order="C")'),
    Fault("last frame lost", "qualisys", f"{READERS}/qualisys.py",
          "return facts, header, np.array(cells, float)", "return facts, header, np.array(cells[:-1], float)"),
    Fault("axis with the wrong sign", "vicon", f"{READERS}/vicon.py",
          "np.array([1.0, 1.0, -1.0, -1.0])", "np.array([1.0, 1.0, 1.0, -1.0])"),
    Fault("samples moved by one", "motive", f"{READERS}/motive.py",
          "return frame / rate, {", "return (frame + 1) / rate, {"),
    Fault("last sample of the wind lost", "lvm", "quasi/importing/wind.py",
          "t, speed = values[ahead].T", "t, speed = values[ahead][:-1].T"),
    Fault("time of publication for time of sampling", "px4", f"{READERS}/px4.py",
          "        stamp = sampled.astype(float) * MICRO\n    return [(name, stamp, fields)]",
          "        stamp = stamp + 5e-3\n    return [(name, stamp, fields)]"),
    # errors that are not the readers' own
    Fault("message cut off is read", "ardupilot", f"{READERS}/dataflash.py",
          "if not length or at + length > end:", "if not length:"),
    Fault("damaged packing is not caught", "gzip", "quasi/tables.py",
          "    except (OSError, EOFError, zlib.error) as error:", "    except OSError as error:"),
    Fault("damaged Parquet is not caught", "parquet", "quasi/tables.py",
          "except (pyarrow.ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError) as error:",
          "except (KeyError, TypeError, MemoryError) as error:"),
)  # fmt: skip


def plant(fault: Fault | None, folder: Path) -> None:
    """Copy what the search needs into a folder, with the fault. Raises ValueError where its text is not there once."""
    for part in ("quasi", "quasi_synthesis", "config/schemas", "benchmarks", "tests/unit"):
        shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__", "results", "vendor"))
    if fault is not None:
        path = folder / fault.file
        text = path.read_text(encoding="utf-8")
        if text.count(fault.sound) != 1:
            raise ValueError(f"fault '{fault.name}': its text stands {text.count(fault.sound)} times in {fault.file}")
        path.write_text(text.replace(fault.sound, fault.faulty), encoding="utf-8")


def search(reader: str, seconds: float, seed: int, inputs: int | None = None) -> tuple[int, str]:
    """(inputs, what was seen or "") of a search in this process; it ends after `seconds` or `inputs`."""
    import numpy as np
    from fuzz_readers import check
    from reader_inputs import READERS as readers
    from reader_inputs import broken_input
    from reader_round_trips import round_trip

    from quasi.errors import QuasiError

    def hang(*_: object) -> None:
        raise TimeoutError(f"more than {HANGING} s")

    signal.signal(signal.SIGALRM, hang)
    warnings.simplefilter("error")
    read, seeds = readers[reader]
    rng = np.random.default_rng(seed)
    originals = seeds(rng)
    start, i = time.monotonic(), 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{reader}.raw"
        while time.monotonic() - start < seconds and (inputs is None or i < inputs):
            # the first inputs compile the kernels
            signal.alarm(HANGING if i >= COMPILING else int(seconds))
            try:
                if i % ROUND_TRIP_SHARE == 0:
                    round_trip(reader, rng)
                else:
                    path.write_bytes(broken_input(reader, originals, i, rng))
                    with contextlib.suppress(QuasiError):
                        check(read(path))
            except Exception as error:
                return i + 1, f"{type(error).__name__}: {' '.join(str(error).split())[:80]}"
            finally:
                signal.alarm(0)
            i += 1
    return i, ""


def searched(fault: Fault | None, reader: str, seconds: float, seed: int, inputs: int | None) -> dict:
    """A search in a process of its own: {"name", "reader", "inputs", "seconds", "seen"}."""
    with tempfile.TemporaryDirectory(prefix="quasi-planted-") as name:
        folder = Path(name)
        plant(fault, folder)
        changed = {
            "PYTHONPATH": os.pathsep.join(str(folder / p) for p in ("", "tests/unit", "benchmarks")),
            "NUMBA_BOUNDSCHECK": "1",
            "NUMBA_OPT": "1",
            "NUMBA_CACHE_DIR": str(folder / "kernels"),
        }
        code = (
            f"import planted_faults as p\nn, seen = p.search({reader!r}, {seconds}, {seed}, {inputs})\nprint(n)\n"
            "print(seen)"
        )
        start = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, **changed}, cwd=folder, capture_output=True, text=True
        )
        took = time.monotonic() - start
        lines = done.stdout.splitlines()
        if done.returncode < 0:  # the fault ended the process: found as well
            lines = ["1", f"the process was ended by signal {-done.returncode}"]
        elif done.returncode:
            raise RuntimeError(f"the search of {reader} did not run: {done.stderr[-500:]}")
    name = fault.name if fault else "none"
    return {"name": name, "reader": reader, "inputs": int(lines[0]), "seconds": took, "seen": "\n".join(lines[1:])}


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seconds", type=float, default=600.0, help="that each fault is searched for")
    arguments.add_argument("--only", help="the fault of this name alone")
    arguments.add_argument("--jobs", type=int, default=1, help="searches at the same time")
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--sound", type=int, default=200, help="inputs of each reader for the sound code")
    arguments.add_argument("--record", action="store_true", help="write benchmarks/results/planted_faults.json")
    given = arguments.parse_args()
    faults = [f for f in FAULTS if given.only in (None, f.name)]
    held = True
    for reader in dict.fromkeys(f.reader for f in faults) if given.sound else ():
        found = searched(None, reader, given.seconds, given.seed, given.sound)
        print(f"sound code, {reader}: {found['inputs']} inputs, {found['seen'] or 'nothing seen'}", flush=True)
        held &= not found["seen"]
    rows = []
    pool = ThreadPoolExecutor(given.jobs)
    for row in pool.map(lambda f: searched(f, f.reader, given.seconds, given.seed, None), faults):
        rows.append(row)
        print(
            f"{row['name']:42} {row['reader']:10} {row['seconds']:6.1f} s {row['inputs']:7} {row['seen']}", flush=True
        )
    found = [row for row in rows if row["seen"]]
    slowest = max((row["seconds"] for row in found), default=0.0)
    print(f"{len(found)} of {len(rows)} found, the slowest after {slowest:.0f} s")
    if given.record:
        import measured_table

        values = {"found": len(found), "planted": len(rows), "slowest, s": slowest}
        values["inputs"] = max((row["inputs"] for row in found), default=0)
        measured_table.record("planted_faults", values)
    return int(not held or len(found) < len(rows))


if __name__ == "__main__":
    sys.exit(main())
