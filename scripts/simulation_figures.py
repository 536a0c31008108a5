"""Draw the figures of a simulation from its table."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg

from quasi.model.model import read_model
from quasi.running.job_log import job, show_progress
from quasi.simulation.tools.figures import draw_simulation
from quasi.tables import read_json, read_table, replace_file


def main(table: str, summary: str, model: str, folder: str) -> None:
    """Read the table and its summary; write one PNG per figure."""
    about = read_json(summary)
    about = {
        "name": about["simulation"],
        "speed limits": [about["rotor limits"]["lowest"], about["rotor limits"]["highest"]],
        "fault time": about["fault time"],
        "ended": about["ended"],
    }
    figures = draw_simulation(read_table(table), read_model(model).airframe, about)
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for name, figure in show_progress(list(figures.items()), "drawing"):
        with replace_file(target / f"{name}.png") as part:
            FigureCanvasAgg(figure).print_png(part)


if __name__ == "__main__":
    with job(snakemake.log[0], f"figures of simulation {snakemake.wildcards.simulation}"):
        main(snakemake.input.table, snakemake.input.summary, snakemake.input.model, snakemake.output[0])
