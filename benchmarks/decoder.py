"""Time the blackbox reader and compare its values with independent decoders.

    python benchmarks/decoder.py [LOG.bbl] [--log N] [--seconds S] [--tool PATH] [--orangebox] [--json OUT]

Without a file a log is made (1 kHz, Betaflight 4.5 fields, random walks). `--tool` names the C program blackbox_decode
(else it is looked for on PATH); `--orangebox` also runs the Python package of that name, in a process of its own.
Every frame that both hold must have equal values in every main field; the exit code is 1 where one differs.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from stopwatch import best

from quasi import tables
from quasi.importing.readers.blackbox import Frames, decode, read_blackbox
from quasi.importing.readers.blackbox_header import find_logs
from quasi.importing.readers.blackbox_units import WANTED

RAW = ["--unit-vbat", "raw", "--unit-amperage", "raw", "--unit-flags", "raw", "--unit-rotation", "raw"]
ORANGEBOX = """
import sys, time, numpy as np
from orangebox import Parser
start = time.perf_counter()
parser = Parser.load(sys.argv[1], log_index=int(sys.argv[2]))
names = parser.field_names
rows = [frame.data for frame in parser.frames()]
took = time.perf_counter() - start
count = min(map(len, rows))
table = np.array([[float(x) if isinstance(x, (int, float)) else np.nan for x in row[:count]] for row in rows])
np.savez(sys.argv[3], names=np.array(names[:count]), table=table, took=took)
"""


def made_log(seconds: float, rate: int = 1000) -> bytes:
    """A log with the fields and the packing of a Betaflight 4.5 flight, values wandering as in flight."""
    from quasi_synthesis.blackbox_writer import BLACKBOX_FIELDS, FIELD_NAMES, encode_log, event

    rng = np.random.default_rng(0)
    n = int(seconds * rate)
    spread = {
        "gyroADC": 12,
        "accSmooth": 40,
        "motor": 15,
        "eRPM": 4,
        "axisP": 6,
        "axisD": 8,
        "setpoint": 3,
        "rcCommand": 1,
    }
    start = {"motor": 800, "eRPM": 900, "vbatLatest": 1600}
    values = np.zeros((n, len(FIELD_NAMES)), np.int64)
    for i, name in enumerate(FIELD_NAMES):
        base = name.split("[")[0]
        steps = np.round(rng.normal(0, spread.get(base, 0.3), n))
        walk = np.zeros(n)
        # wandering that returns, so that the numbers stay as large as in flight
        for k in range(1, n):
            walk[k] = 0.98 * walk[k - 1] + steps[k]
        values[:, i] = start.get(base, 0) + walk
    values[:, FIELD_NAMES.index("loopIteration")] = 4 * np.arange(n)
    values[:, FIELD_NAMES.index("time")] = 10_000_000 + np.round(np.arange(n) * 1e6 / rate + rng.normal(0, 2, n))
    whole = [i for i, field in enumerate(BLACKBOX_FIELDS) if not field[1]]
    values[:, whole] = np.maximum(values[:, whole], 0)
    motors = [i for i, name in enumerate(FIELD_NAMES) if name.startswith("motor[")]
    values[:, motors] = np.maximum(values[:, motors], 158)
    return encode_log(values, [(0, event("sync beep", 9_999_000))])[0] + event("end")


def memory_added(path: Path, number: int | None) -> float | None:
    """Peak memory that reading adds, bytes, in a fresh process after start-up; None where Linux cannot tell."""
    program = """
import sys, numpy as np
from quasi.importing.readers.blackbox import decode, read_blackbox
from quasi.importing.readers.blackbox_header import find_logs
def status(key):
    return next(int(l.split()[1]) for l in open("/proc/self/status") if l.startswith(key)) * 1024
number = int(sys.argv[2]) or None
data = open(sys.argv[1], "rb").read(20000)
log = find_logs(data, "start")[0]
if not log.fault:
    decode(data, log)
del data, log
open("/proc/self/clear_refs", "w").write("5")
before = status("VmRSS")
recording = read_blackbox(sys.argv[1], log_number=number)
print(status("VmHWM") - before)
"""
    done = subprocess.run([sys.executable, "-c", program, str(path), str(number or 0)], capture_output=True, text=True)
    return float(done.stdout) if done.returncode == 0 else None


def by_tool(tool: str, path: Path, number: int, folder: Path) -> tuple[dict[str, np.ndarray], float]:
    """Columns of the C program's CSV, raw numbers, and the seconds it took."""
    copy = folder / "log.bbl"
    shutil.copy(path, copy)
    start = time.perf_counter()
    subprocess.run([tool, "--index", str(number), *RAW, str(copy)], check=True, capture_output=True)
    took = time.perf_counter() - start
    made = sorted(folder.glob("log.*.csv"))
    lines = next(p for p in made if ".gps." not in p.name and ".event" not in p.name).read_text().splitlines()
    names = [re.sub(r"\s*\(.*\)$", "", name.strip()) for name in lines[0].split(",")]
    units = dict(zip(names, lines[0].split(",")))
    keep = [i for i, name in enumerate(names) if "(" not in units[name] or re.search(r"\((us|raw)\)", units[name])]
    rows = [line.split(",") for line in lines[1:] if line.lstrip()[:1].isdigit()]
    columns = {}
    for i in keep:
        try:
            columns[names[i]] = np.array([float(row[i]) for row in rows])
        except ValueError:
            continue
    return columns, took


def by_orangebox(path: Path, number: int, folder: Path) -> tuple[dict[str, np.ndarray], float]:
    """The columns of orangebox, and the seconds it took without start-up."""
    out = folder / "orangebox.npz"
    subprocess.run([sys.executable, "-c", ORANGEBOX, str(path), str(number), str(out)], check=True, capture_output=True)
    with np.load(out) as made:
        return dict(zip(made["names"].tolist(), made["table"].T)), float(made["took"])


def compare(frames: Frames, columns: dict[str, np.ndarray]) -> dict:
    """Frames in common (matched on time), main fields compared, and how many values differ.

    loopIteration is left out: the C program counts P frames there, not the firmware's iterations.
    """
    theirs = columns["time"].astype(np.int64)
    _, ours_at, theirs_at = np.intersect1d(frames.time, theirs, return_indices=True)
    fields = [name for name in frames.values if name in columns and name not in ("time", "loopIteration")]
    wrong = {name: int(np.sum(frames.values[name][ours_at] != columns[name][theirs_at])) for name in fields}
    return {
        "frames": len(theirs),
        "common": len(ours_at),
        "only here": len(frames.time) - len(ours_at),
        "only there": len(theirs) - len(ours_at),
        "fields": len(fields),
        "different": {name: count for name, count in wrong.items() if count},
    }


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("path", nargs="?", type=Path)
    arguments.add_argument("--log", type=int)
    arguments.add_argument("--seconds", type=float, default=90.0)
    arguments.add_argument("--repeat", type=int, default=5)
    arguments.add_argument("--tool", default=shutil.which("blackbox_decode"))
    arguments.add_argument("--orangebox", action="store_true")
    arguments.add_argument("--json", type=Path)
    given = arguments.parse_args()

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = given.path
        if path is None:
            path = folder / "made.bbl"
            tables.write_bytes(path, made_log(given.seconds))
        start = time.perf_counter()
        recording = read_blackbox(path, log_number=given.log)
        first = time.perf_counter() - start
        number = recording.metadata["log"]
        data = tables.read_bytes(path)
        log = find_logs(data, str(path))[number - 1]
        frames = decode(data, log)
        count = len(frames.time)
        kernel_all = best(lambda: decode(data, log), given.repeat)
        kernel = best(lambda: decode(data, log, WANTED), given.repeat)
        reading = best(lambda: read_blackbox(path, log_number=number), given.repeat)
        added = memory_added(path, given.log)
        result = {
            "log": str(given.path or f"made, {given.seconds:g} s"),
            "bytes": len(data),
            "frames": count,
            "fields": len(frames.values),
            "first read s": first,
            "decode, all fields, frames/s": count / kernel_all,
            "decode, fields in use, frames/s": count / kernel,
            "read s": reading,
            "read, frames/s": count / reading,
            "memory added / file size": added / len(data) if added is not None else None,
        }
        if given.tool:
            columns, took = by_tool(given.tool, path, number, folder)
            result["blackbox_decode"] = {
                "frames/s": count / took,
                "times slower": took / reading,
                **compare(frames, columns),
            }
        else:
            print("blackbox_decode is not on PATH; give it with --tool to compare with it")
        if given.orangebox:
            columns, took = by_orangebox(path, number, folder)
            result["orangebox"] = {"frames/s": count / took, "times slower": took / reading, **compare(frames, columns)}
    for key, value in result.items():
        shown = f"{value:,.4g}" if isinstance(value, float) and value < 1000 else value
        print(f"{key:34} {f'{value:,.0f}' if isinstance(value, float) and value >= 1000 else shown}")
    if given.json:
        tables.write_json(given.json, result)
    return int(any(result.get(other, {}).get("different") for other in ("blackbox_decode", "orangebox")))


if __name__ == "__main__":
    sys.exit(main())
