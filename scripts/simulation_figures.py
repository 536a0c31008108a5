"""Draw the figures of a simulation from its table."""

from quasi.model.model import read_model
from quasi.running.figure_files import write_figures
from quasi.running.job_log import job
from quasi.simulation.tools.figures import draw_simulation
from quasi.tables import read_json, read_table


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
    write_figures(figures, folder)


if __name__ == "__main__":
    with job(snakemake.log[0], f"figures of simulation {snakemake.wildcards.simulation}"):
        main(snakemake.input.table, snakemake.input.summary, snakemake.input.model, snakemake.output[0])
