"""Speed of a model: evaluations in a compiled loop, single rows, batches.

    python benchmarks/predict.py [MODEL] [--repeats 7] [--record]

MODEL is a standalone model (default: a made one of 60 terms over six axes). Printed, as figure and as share of its
target: time of one evaluation inside a compiled loop (four of them make a Runge-Kutta step of a simulation), of one
`predict` of a single row, and of 100,000 rows at once, on one core. The best of the repeats counts; written to
results/benchmarks/predict.json.
"""

import argparse
import time
from pathlib import Path

import numba as nb
import numpy as np
from measured_table import record
from stopwatch import best

from quasi.airframe import read_airframe, to_plain
from quasi.model.document import MODEL_SCHEMA
from quasi.model.model import Model, read_model
from quasi.tables import write_json
from quasi.terms.kernel import INPUTS, Kernel, compute_wrench

ROOT = Path(__file__).resolve().parents[1]
COMPILED, SINGLE, BATCH = 0.4e-6, 60e-6, 50e-3  # targets, s
REFERENCE_SINGLE, REFERENCE_BATCH = 1 / 3_682.0, 100_000 / 3.6e5  # s, the published pipeline's portable model
ROWS = 100_000

TERMS = {
    "Fx": ["1", "u*w_tot", "|u|*u", "u*w", "q*w_tot", "mu_x*w_tot", "u*mu_z", "sin[pitch]", "q*w", "U_q*u"],
    "Fy": ["1", "v*w_tot", "|v|*v", "v*w", "p*w_tot", "mu_y*w_tot", "v*mu_z", "sin[roll]", "p*w", "U_p*v"],
    "Fz": ["1", "w2_1 + w2_2 + w2_3 + w2_4", "d_w_tot", "w*w_tot", "mu_z^2*w_tot^2", "(u^2 + v^2)*w_avg",
           "(mu_x^2 + mu_y^2)*w_tot^2", "|w|*w", "w_tot_dot", "mu_z^3*w_tot^2"],
    "Mx": ["1", "U_p", "p*w_tot", "v*w_tot", "q*r", "q*u_r", "u*U_p", "|p|*p", "v*mu_z", "U_p^2*mu_y"],
    "My": ["1", "U_q", "q*w_tot", "u*w_tot", "p*r", "p*u_r", "v*U_q", "|q|*q", "u*mu_z", "U_q^2*mu_x"],
    "Mz": ["1", "U_r", "r*w_tot", "u_r_dot", "p*q", "u*v", "w*U_r", "|r|*r", "u*U_p", "v*U_q"],
}  # fmt: skip


def made() -> Model:
    """Six axes of ten terms each, with the shapes that identified models hold."""
    airframe = read_airframe(
        {
            "rotor config": {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3},
            "rotor1 rotation direction": "CW", "b": 0.077, "rotor radius": 0.0381, "mass": 0.433,
            "moment of inertia": "[8.65e-4, 0, 0; 0, 1.07e-3, 0; 0, 0, 1.71e-3]",
        },
        "made",
    )  # fmt: skip
    axes = {}
    for axis, terms in TERMS.items():
        entries = [{"name": e, "expression": e, "coefficient": 1e-3, "std": 1e-4, "unit": "-"} for e in terms]
        axes[axis] = {
            "unit": "N", "terms": entries, "covariance": np.eye(len(terms)).tolist(), "sigma2": 1.0,
            "effective rows": 100, "confidence level": 0.95, "R2": 1.0, "RMSE": 0.0, "n": 100,
        }  # fmt: skip
    return Model(
        {"schema": MODEL_SCHEMA, "id": "made", "gravity": "withGravity", "airframe": to_plain(airframe),
         "hover speed": {"value": 900.0}, "axes": axes}
    )  # fmt: skip


@nb.njit
def loop(kernel: Kernel, rows: np.ndarray, work: np.ndarray, out: np.ndarray, times: int) -> float:
    """Evaluate all rows again and again; the sum keeps the compiler from leaving anything out."""
    total = 0.0
    for _ in range(times):
        for k in range(len(rows)):
            compute_wrench(kernel, rows[k], work, out)
            total += out[2]
    return total


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", nargs="?", help="standalone model (default: a made one of 60 terms)")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    options = parser.parse_args()
    model = read_model(options.model) if options.model else made()

    r = np.random.default_rng(0)
    states, speeds = r.normal(size=(ROWS, 12)), r.uniform(400, 1400, (ROWS, 4))
    accelerations = r.normal(size=(ROWS, 4)) * 1000
    start = time.perf_counter()
    kernel = model.kernel
    compiled_in = time.perf_counter() - start
    rows = np.hstack([states, speeds, accelerations])[:1000]
    rows = np.hstack([rows, np.ones((1000, len(model.inputs) - len(INPUTS)))])
    work, out = kernel.work, np.empty(6)

    figures = {
        "terms": sum(len(part["terms"]) for part in model.document["axes"].values()),
        "instructions": int(kernel.code[3]),
        "kernel made, s": compiled_in,
        "evaluation in a compiled loop, s": best(lambda: loop(kernel, rows, work, out, 100), options.repeats) / 1e5,
        "predict of one row, s": best(
            lambda: [model.predict(states[0], speeds[0]) for _ in range(1000)], options.repeats
        )
        / 1000,
        "predict of 100,000 rows, s": best(lambda: model.predict(states, speeds, accelerations), options.repeats),
    }
    targets = {
        "evaluation in a compiled loop, s": (COMPILED, None),
        "predict of one row, s": (SINGLE, REFERENCE_SINGLE),
        "predict of 100,000 rows, s": (BATCH, REFERENCE_BATCH),
    }
    print(f"model {model.id}: {figures['terms']} terms, {figures['instructions']} instructions")
    for name, (target, reference) in targets.items():
        beside = f", {reference / figures[name]:.0f} times the published pipeline's speed" if reference else ""
        print(f"{name:36}{figures[name]:12.3g}   {figures[name] / target:6.1%} of the target {target:g}{beside}")
    write_json(ROOT / "results/benchmarks/predict.json", figures)
    if options.record:
        record("predict", figures)


if __name__ == "__main__":
    main()
