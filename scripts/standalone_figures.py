"""Draw a model with the measurements: comparison, quartiles, coverage, isolation."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg

from quasi.filtering.rotor_speeds import read_flight
from quasi.identification.partition import ROLES, TRAINING, isolated, judged_rows
from quasi.model.model import read_model
from quasi.running.job_log import job, progress
from quasi.scoring.figures import (
    actuator_figure,
    closeup,
    comparison,
    coverage_figure,
    isolation_figure,
    quartile_figure,
)
from quasi.scoring.review import review
from quasi.tables import masses_of, read_made, read_table, whole_file


def main(model: str, partition: str, flights: list[str], roles: dict, options: dict, folder: str) -> None:
    """Read the model and all of its flights; write one PNG per figure."""
    portable = read_model(model)
    drive = portable.document.get("rotor speeds")
    tables = {Path(path).stem: read_flight(path, drive) for path in progress(flights, "reading flights")}
    table = read_table(partition)
    codes, aside = judged_rows(table, tables, roles["validation"], options)
    masses = masses_of({Path(path).stem: read_made(path) for path in flights})
    found = review(portable, tables, codes, ROLES, aside, options, masses=masses)
    units = {axis: portable.document["axes"][axis]["unit"] for axis in portable.axes}
    drawings = {
        axis: (comparison, found.judged[axis], axis, units[axis], roles["validation"]) for axis in portable.axes
    }
    drawings |= {f"quartiles_{a}": (quartile_figure, found.judged[a], a, f) for a, f in found.diagnosis["axes"].items()}
    for key in roles["validation"] or roles["training"]:
        if (codes[key] > 0).any():
            drawings[f"closeup_{key}"] = (closeup, found.judged, key, units)
    drawings["coverage"] = (coverage_figure, found.coverage)
    drawings["actuators"] = (actuator_figure, portable.document.get("actuators"))
    training = {key: t[codes[key] > 0] for key, t in tables.items() if (codes[key] == TRAINING).any()}
    for axis, regions in isolated(table, {key: len(t) for key, t in tables.items()}).items():
        if axis in portable.axes:
            inside = {key: regions[key][codes[key] > 0] for key in training}
            drawings[f"isolation_{axis}"] = (isolation_figure, training, inside, axis, units[axis])
    Path(folder).mkdir(parents=True, exist_ok=True)
    for name, (draw, *arguments) in progress(list(drawings.items()), "drawing"):
        figure = draw(*arguments)
        if figure is not None:
            with whole_file(Path(folder) / f"{name}.png") as part:
                FigureCanvasAgg(figure).print_png(part)


if __name__ == "__main__":
    with job(snakemake.log[0], f"figures of {snakemake.wildcards.model}"):
        main(
            snakemake.input.model,
            snakemake.input.partition,
            snakemake.input.flights,
            snakemake.params.flights,
            snakemake.params.options,
            snakemake.output[0],
        )
