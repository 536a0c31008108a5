"""Speed and agreement of the MATLAB export, in GNU Octave.

    python benchmarks/export_matlab.py [MODEL]

MODEL is a standalone model (default: the made one of 60 terms over six axes). Printed: time to write the folder, to get
forces and moments of 100,000 rows (target 2 s), of A and B beside them, of one row in a loop; the largest relative
difference from the model on 10,000 random states. Written to results/benchmarks/export_matlab.json.
"""

import argparse
import tempfile
import time
from pathlib import Path

from measured_table import record
from predict import made

from quasi.export.matlab import write_matlab
from quasi.export.matlab_check import check_matlab, run_octave
from quasi.model.model import read_model
from quasi.tables import write_json

ROOT = Path(__file__).resolve().parents[1]
TARGET = 2.0  # s for 100,000 rows
U = ("U_p", "U_q", "U_r")
SCRIPT = """[m, d] = model_init();
rows = 100000;
state = rand(rows, 12) - 0.5;
speeds = 1500*(0.5 + rand(rows, 4));
getFM(state(1:10, :), speeds(1:10, :), m, d);
tic;
[F, M, v] = getFM(state, speeds, m, d);
many = toc;
tic;
[A, B] = get_PQRDiffSys(v);
form = toc;
tic;
for k = 1:500
    [F, M] = getFM(state(k, :), speeds(k, :), m, d);
end
single = toc/500;
save('-v7', 'found.mat', 'many', 'form', 'single');
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", nargs="?")
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    asked = parser.parse_args()
    model = read_model(asked.model) if asked.model else made()
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        write_matlab(model, folder, U)
        wrote = time.perf_counter() - began
        checks = check_matlab(model, folder, U)
        took = run_octave(folder, SCRIPT)
    found = {
        "model": model.id, "terms": sum(len(part["terms"]) for part in model.document["axes"].values()),
        "write the folder, s": wrote, "100,000 rows, s": float(took["many"]), "target, s": TARGET,
        "A and B of 100,000 rows, s": float(took["form"]), "one row, s": float(took["single"]),
        "largest relative difference": max(c.largest for c in checks),
    }  # fmt: skip
    for name, value in found.items():
        print(f"{name:<30} {value:.3g}" if isinstance(value, float) else f"{name:<30} {value}")
    write_json(ROOT / "results/benchmarks/export_matlab.json", found)
    if asked.record:
        record("export_matlab", found)


if __name__ == "__main__":
    main()
