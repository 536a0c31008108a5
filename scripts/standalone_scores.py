"""Score a model on its training, test and validation rows, and draw it beside the measurements."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from quasi.identification.partition import ROLES, from_table, partition
from quasi.joblog import job, progress
from quasi.standalone.figures import closeup, comparison
from quasi.standalone.model import read_model
from quasi.standalone.score import UNITS, score, table_text
from quasi.tables import read_table, whole_file, write_table, write_text


def main(model: str, partition_parquet: str, flights: list[str], roles: dict, options: dict, output: dict) -> None:
    """Read the model and all of its flights, held-out ones included; write scores, their table, figures."""
    portable = read_model(model)
    tables = {Path(path).stem: read_table(path) for path in progress(flights, "reading flights")}
    training = {key: tables[key] for key in roles["training"]}
    held_out = {key: tables[key] for key in roles["validation"]}
    codes = from_table(read_table(partition_parquet), {key: len(table) for key, table in training.items()})
    if held_out:
        codes |= partition(held_out, validation=held_out, options=options)
    scores = score(portable, tables, codes, ROLES)
    write_table(output["scores"], scores, UNITS)
    write_text(output["summary"], table_text(scores, portable))
    used = {key: table[np.asarray(codes[key]) > 0] for key, table in tables.items()}
    folder = Path(output["figures"])
    figures = {axis: comparison(portable, used, axis, roles["validation"]) for axis in portable.axes}
    figures |= {f"closeup_{key}": closeup(portable, used[key], key) for key in roles["validation"] or roles["training"]}
    for name, figure in progress(list(figures.items()), "drawing"):
        with whole_file(folder / f"{name}.png") as part:
            FigureCanvasAgg(figure).print_png(part)


if __name__ == "__main__":
    with job(snakemake.log[0], f"scores of {snakemake.wildcards.model}"):
        main(
            snakemake.input.model,
            snakemake.input.partition,
            snakemake.input.flights,
            snakemake.params.flights,
            snakemake.params.options,
            dict(snakemake.output.items()),
        )
