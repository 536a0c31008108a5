"""Exports: speed of the C file, and how long each form takes to be made and compared.

    python benchmarks/export.py [MODEL] [--repeats 7] [--record]

MODEL is a standalone model (default: the made one of 60 terms over six axes of benchmarks/predict.py). Printed, each
beside its target: one evaluation of forces and moments in C, as double and as float, and of the differential form, -O2,
on one core; seconds to write, compile, run and compare the C files, the Python file and the FMUs. The best of the
repeats counts; written to results/benchmarks/export.json.
"""

import argparse
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from measured_table import record
from predict import made

from quasi.export.agreement import Check
from quasi.export.c_source import c_files
from quasi.export.compiler import shared_library, write_files
from quasi.export.contents import differential_inputs, name_in_source
from quasi.export.fmu_archive import write_fmu
from quasi.export.fmu_running import check_forces, check_vehicle
from quasi.export.fmu_source import forces_fmu, vehicle_fmu
from quasi.export.python_source import python_file
from quasi.export.running import check_c, check_python
from quasi.model.model import Model, read_model
from quasi.tables import write_json

ROOT = Path(__file__).resolve().parents[1]
EVALUATION, EXPORT = 2e-6, 5.0  # targets, s
DRIVER = """
#include "@.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

int main(int count, char **given)
{
    static @_real state[1000][12], speeds[1000][4], slopes[1000][4], extra[1000][16], a[9], b[64];
    const int times = atoi(given[1]), form = count > 2;
    double sum = 0.0;
    clock_t start;
    int i, k;
    for (i = 0; i < 1000; i++) {
        for (k = 0; k < 12; k++) state[i][k] = (@_real)(rand()/(double)RAND_MAX - 0.5);
        for (k = 0; k < 4; k++) speeds[i][k] = (@_real)(400 + 1000*(rand()/(double)RAND_MAX));
        for (k = 0; k < 16; k++) extra[i][k] = 1;
    }
    start = clock();
    for (k = 0; k < times; k++) {
        for (i = 0; i < 1000; i++) {
            @_real f[3], m[3];
            if (form) {
                FORM
                sum += (double)(a[0] + b[0]);
            } else {
                @_forces_and_moments(state[i], speeds[i], slopes[i], extra[i], f, m);
                sum += (double)(f[2] + m[0]);
            }
        }
    }
    printf("%.17g %.17g\\n", (double)(clock() - start)/CLOCKS_PER_SEC/times/1000, sum);
    return 0;
}
"""


def evaluation(model: Model, folder: str, float32: bool, form: bool, repeats: int) -> float:
    """Least time of one evaluation in C, s."""
    p = name_in_source(model)
    call = f"{p}_differential_form(state[i], speeds[i], slopes[i], extra[i], a, b);" if form else ""
    write_files(folder, {**c_files(model), "main.c": DRIVER.replace("FORM", call).replace("@", p)})
    program = shared_library(
        folder, ["main.c", f"{p}.c"], "run", ["QUASI_FLOAT32"] if float32 else [], ("-std=c99", "-O2")
    )
    asked = [str(program), "300", *(["form"] if form else [])]
    runs = [subprocess.run(asked, capture_output=True, text=True, check=True).stdout for _ in range(repeats)]
    return min(float(run.split()[0]) for run in runs)


def timed(work: Callable[[], list[Check]]) -> float:
    """Seconds that one export takes, its comparison included. Raises ValueError when it does not agree."""
    start = time.perf_counter()
    if not all(check.agrees for check in work()):
        raise ValueError("an export differs from its model")
    return time.perf_counter() - start


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", nargs="?", help="standalone model (default: a made one of 60 terms)")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    options = parser.parse_args()
    model = read_model(options.model) if options.model else made()
    figures: dict[str, float] = {"terms": sum(len(part["terms"]) for part in model.document["axes"].values())}
    with tempfile.TemporaryDirectory() as folder:
        for name, float32, form in (("double", False, False), ("float", True, False), ("A and B, double", False, True)):
            if not form or differential_inputs(model):
                figures[f"C, {name}, s"] = evaluation(model, folder, float32, form, options.repeats)
        exports: dict[str, Callable[[], list[Check]]] = {
            "C": lambda: check_c(model, c_files(model)),
            "Python": lambda: check_python(model, *python_file(model)),
        }
        if model.airframe.mass is not None:
            forces, vehicle = forces_fmu(model), vehicle_fmu(model)
            exports["FMU, forces and moments"] = lambda: check_forces(
                model, forces, write_fmu(Path(folder) / "forces.fmu", forces, folder)
            )
            exports["FMU, vehicle"] = lambda: check_vehicle(
                model, vehicle, write_fmu(Path(folder) / "vehicle.fmu", vehicle, folder)
            )
        exports["Python"]()  # compiles what predicts the reference numbers
        for name, work in exports.items():
            figures[f"export of {name}, s"] = min(timed(work) for _ in range(min(options.repeats, 3)))
    figures["export of all, s"] = sum(v for name, v in figures.items() if name.startswith("export of"))
    print(f"model {model.id}: {figures['terms']} terms")
    for name, value in figures.items():
        target = EVALUATION if name.startswith("C,") else EXPORT if name == "export of all, s" else None
        if name != "terms":
            print(f"{name:36}{value:12.3g}" + (f"   {value / target:6.1%} of the target {target:g}" if target else ""))
    write_json(ROOT / "results/benchmarks/export.json", figures)
    if options.record:
        record("export", figures)


if __name__ == "__main__":
    main()
