"""How long a whole diagnosis takes: four flights at 500 Hz, sensors, drive, forces and roll-outs, figures and report,
one process.

    python benchmarks/gap.py [--seconds 90] [--references]

Flights with a weak rotor are made, imported and filtered first, which is not counted. --references adds four of the
flights that made the model, as the workflow does. Printed are wall and CPU seconds of each part and the peak memory.
"""

import argparse
import os
import resource
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from hidden import affected, again, healthy_model, processed, trained
from hide_and_seek import OUT, SAMPLING, SETTINGS
from matplotlib.backends.backend_agg import FigureCanvasAgg
from measured_table import record

from quasi.gap.catalogue import catalogue
from quasi.gap.diagnosis import diagnose
from quasi.gap.flights.gathering import gather
from quasi.gap.levels import sensors_and_drive
from quasi.gap.levels.corrections import for_flight
from quasi.gap.report.figures import figures
from quasi.gap.report.page import page


def main() -> None:
    """Make the flights, diagnose them, print the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--references", action="store_true")
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    arguments = parser.parse_args()
    model, effects = healthy_model(OUT / "healthy"), catalogue()
    with tempfile.TemporaryDirectory() as raw:
        made = affected(Path(raw), 60_000, {"rotor_effectiveness": {"rotor2": 0.92}}, arguments.seconds)
        flown = [processed(r, True) for r in made]
        learned = [*(trained(OUT / "healthy", 0) if arguments.references else []), *zip(made[1:], flown[1:])]
        recorded, learning = [list(part) for part in zip(*learned)]
        files = {f.key: r for r, f in learned}
        clock = [(time.perf_counter(), time.process_time())]

        def tick(what: str) -> None:
            clock.append((time.perf_counter(), time.process_time()))
            wall, cpu = np.diff(clock[-2:], axis=0)[0]
            print(f"{what:32s} {wall:6.1f} s, CPU {cpu:6.1f} s", flush=True)

        told, _ = sensors_and_drive.examine(
            learning, model.document, SETTINGS, effects, lambda f, c: again([files[f.key]], [f], [c])[0], 1
        )
        tick("sensors and drive")
        corrections = [for_flight(told, f.compared) for f in [*learning, flown[0]]]
        everything = again([*recorded, made[0]], [*learning, flown[0]], corrections)
        tick("flights processed anew")
    roles = {f.key: "compared" if f.compared else "reference" for f in everything}
    roles[flown[0].key] = "held out"
    evidence = {f.key: gather(f.key, f.filtered, f.filtered_metadata, f.airframe, model, SAMPLING) for f in everything}
    found = diagnose(
        model, told, evidence, {f.key: f.filtered for f in everything}, roles, effects,
        {**SETTINGS, "horizons": [0.1, 0.25, 0.5, 1.0]}, ([flown[0]], [everything[-1]]), "benchmark", (),
        "training" if arguments.references else "none",
    )  # fmt: skip
    tick("forces and roll-outs, gain")
    pictures = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, figure in figures(found.tables).items():
            FigureCanvasAgg(figure).print_png(f"{folder}/{name}.png")
            pictures[name] = Path(f"{folder}/{name}.png").read_bytes()
        text = page(found.document, effects, found.tables["forces_residuals"], pictures)
    tick("figures and report")
    wall, cpu = np.subtract(clock[-1], clock[0])
    rows = sum(len(f.filtered) for f in everything)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0**2
    print(f"{'whole diagnosis':32s} {wall:6.1f} s, CPU {cpu:6.1f} s; {len(everything)} flights, {rows} rows at 500 Hz; "
          f"peak memory {memory:.2f} GB, page {len(text) / 1e6:.1f} MB")  # fmt: skip
    if arguments.record:
        names = ("with references s", "with references GB") if arguments.references else ("wall s", "memory GB")
        record("gap", dict(zip(names, (wall, memory))))
    print(f"target 20 s and 1 GB: {wall / 20.0:.2f} and {memory:.2f} of it; {found.document['verdict']}")


if __name__ == "__main__":
    main()
