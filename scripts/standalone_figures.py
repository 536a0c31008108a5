"""Draw a model with the measurements: comparison, quartiles, coverage, isolation."""

from functools import partial
from pathlib import Path

from quasi.filtering.rotor_speeds import read_flight
from quasi.identification.partition import ROLES, TRAINING, isolated, judged_rows
from quasi.model.commands import map_of
from quasi.model.model import read_model
from quasi.running.figure_files import write_figures
from quasi.running.job_log import job, show_progress
from quasi.scoring.figures import (
    draw_actuators,
    draw_closeup,
    draw_comparison,
    draw_coverage,
    draw_isolation,
    draw_quartiles,
)
from quasi.scoring.review import review_model
from quasi.tables import list_masses, read_made, read_table


def main(
    model: str, partition: str, flights: list[str], roles: dict, options: dict, folder: str, processes: int = 1
) -> None:
    """Read the model and all of its flights; write one PNG per figure."""
    portable = read_model(model)
    drive = map_of(portable.document)
    tables = {Path(path).stem: read_flight(path, drive) for path in show_progress(flights, "reading flights")}
    table = read_table(partition)
    codes, aside = judged_rows(table, tables, roles["validation"], options)
    masses = list_masses({Path(path).stem: read_made(path) for path in flights})
    found = review_model(portable, tables, codes, ROLES, aside, options, masses=masses)
    units = {axis: portable.document["axes"][axis]["unit"] for axis in portable.axes}
    drawings = {
        axis: (draw_comparison, found.comparisons[axis], axis, units[axis], roles["validation"])
        for axis in portable.axes
    }
    drawings |= {
        f"quartiles_{a}": (draw_quartiles, found.comparisons[a], a, f) for a, f in found.diagnosis["axes"].items()
    }
    for key in roles["validation"] or roles["training"]:
        if (codes[key] > 0).any():
            drawings[f"closeup_{key}"] = (draw_closeup, found.comparisons, key, units)
    drawings["coverage"] = (draw_coverage, found.coverage)
    drawings["actuators"] = (draw_actuators, portable.document.get("actuators"))
    training = {key: t[codes[key] > 0] for key, t in tables.items() if (codes[key] == TRAINING).any()}
    for axis, regions in isolated(table, {key: len(t) for key, t in tables.items()}).items():
        if axis in portable.axes:
            inside = {key: regions[key][codes[key] > 0] for key in training}
            drawings[f"isolation_{axis}"] = (draw_isolation, training, inside, axis, units[axis])
    write_figures({name: partial(*drawing) for name, drawing in drawings.items()}, folder, processes)


if __name__ == "__main__":
    with job(snakemake.log[0], f"figures of {snakemake.wildcards.model}"):
        main(
            snakemake.input.model,
            snakemake.input.partition,
            snakemake.input.flights,
            snakemake.params.flights,
            snakemake.params.options,
            snakemake.output[0],
            snakemake.threads,
        )
