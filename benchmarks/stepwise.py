"""Time and memory of the stepwise regression on large pools, and what resampling it costs.

    python benchmarks/stepwise.py [--cases usual large stage] [--out results/benchmarks/stepwise.json]

usual   200,000 rows (eight made flights) x the 623 candidates of the Fz pool of the manual's FM file, 3 steps: with the
        manual's constant F, with the significance over the pool, and with 100 resamples of it
large   1,000,000 rows x about 2,000 candidates, 10 steps, significance
stage   all six axes with the manual's FM file on twelve flights of 45,000 rows, one after the other, 10 steps,
        significance, 100 resamples
Each case runs in a process of its own, so that the peak memory is its own. Time is that of the fit of one axis: pool,
selection, coefficients, standard errors, rivals; flights are in memory.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import recovery

from quasi.identification.candidates import read_specification
from quasi.identification.fit import fit_axis
from quasi.identification.partition import TRAINING
from quasi.tables import read_json, write_json

ROOT = Path(__file__).resolve().parents[1]
SIZES = {"usual": (8, 25_000), "large": (20, 50_000), "stage": (12, 45_000)}
CASES = {
    "usual": {"F": {"F in": 4}, "significance": {}, "100 resamples": {"bootstrap": 100}},
    "large": {"significance": {}},
    "stage": {"100 resamples": {"bootstrap": 100}},
}
# seconds and GB; a stage runs two axes at a time
TARGETS = {
    ("usual", "F"): (3.0, 1.2),
    ("usual", "significance"): (3.0, 1.2),
    ("large", "significance"): (60.0, 4.0),
    ("stage", "100 resamples"): (180.0, np.inf),
}


def document(case: str) -> dict:
    """The pool of a case."""
    whole = read_json(ROOT / f"config/polynomials/{recovery.POOL}.json")
    if case == "stage":
        return whole
    pool = whole["Fz"]
    if case == "large":
        more = ["u_p", "u_q", "u_r", "p*q", "q*r", "p*r", "|u_p|", "|u_q|", "|u_r|", "w_avg", "r^2", "p^2", "q^2"]
        for entry in pool["candidates"]:
            entry["sets"] += more if len(entry["sets"]) > 1 else []
    return {"Fz": pool}


def one(case: str, way: str) -> dict:
    """Run one case in this process."""
    pools = {axis: read_specification({axis: section}, axis, case) for axis, section in document(case).items()}
    flights, rows = SIZES[case]
    generator = np.random.default_rng(1)
    made = {}
    for i in range(flights):
        flight = recovery.motion(generator, rows)
        squares = sum(flight[f"w{k}"] ** 2 for k in range(1, 5))
        flight["Fz"] = (
            -3e-7 * squares - 0.05 * flight["w"] - 0.01 * flight["u"].abs() * flight["w"] - 2e-3 * flight["v"] ** 2
            + 2e-5 * (squares / 4) ** 0.5 * flight["w"] ** 2 + 0.3 * recovery.noise(generator, rows, 0.1)
        )  # fmt: skip
        wave = dict(zip(("Fx", "Fy", "Mx", "My", "Mz"), "uvpqr"))
        for axis, name in wave.items():
            x = flight[name]
            flight[axis] = -0.1 * x - 0.01 * x * x.abs() + 0.1 * recovery.noise(generator, rows, 0.1)
        made[f"flight-{i}"] = flight
    roles = {key: np.full(rows, TRAINING, np.int8) for key in made}
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    config = {"regressor cap": 3 if case == "usual" else 10, **CASES[case][way]}
    begin, busy = time.perf_counter(), time.process_time()
    fits = [fit_axis(a, made, roles, recovery.airframe(), recovery.SHARED, config, p) for a, p in pools.items()]
    took, busy = time.perf_counter() - begin, time.process_time() - busy
    return {
        "rows": fits[0]["n"],
        "candidates": sum(f["candidates"] for f in fits),
        "terms": sum(len(f["terms"]) for f in fits),
        "seconds": took,
        "processor seconds": busy,
        "peak GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
        "GB before": base,
    }


def main() -> int:
    """Run the cases, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--one", nargs=2, metavar=("CASE", "WAY"), help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, default=ROOT / "results/benchmarks/stepwise.json")
    a = parser.parse_args()
    if a.one:
        print(json.dumps(one(*a.one)))
        return 0
    results, missed = {}, False
    for case in a.cases:
        for way in CASES[case]:
            command = [sys.executable, str(Path(__file__).resolve()), "--one", case, way]
            # one thread, as a job of the workflow has
            alone = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
            found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True, env=alone).stdout)
            results[f"{case}, {way}"] = found
            seconds, memory = TARGETS.get((case, way), (np.inf, np.inf))
            late = found["seconds"] > seconds or found["peak GB"] > memory
            missed |= late
            aim = f"  (at most {seconds:g} s, {memory:g} GB) {'MISSED' if late else ''}" if np.isfinite(seconds) else ""
            print(f"{case + ', ' + way:24}{found['rows']:9,d} x {found['candidates']:5,d}  {found['terms']:3d} terms"
                  f"{found['seconds']:8.2f} s ({found['processor seconds']:.2f} of processor)"
                  f"{found['peak GB']:7.2f} GB{aim}", flush=True)  # fmt: skip
    if "usual" in a.cases:
        key = "processor seconds"
        factor = results["usual, 100 resamples"][key] / results["usual, significance"][key]
        missed |= factor > 6.0
        print(f"100 resamples cost {factor - 1:.2f} times a fit  (at most 5) {'MISSED' if factor > 6 else ''}")
    write_json(a.out, results)
    return int(missed)


if __name__ == "__main__":
    raise SystemExit(main())
