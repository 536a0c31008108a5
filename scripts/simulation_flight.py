"""Simulate a model in closed loop; write its table, its summary, and the summary as text."""

from quasi.model.model import read_model
from quasi.running.job_log import job
from quasi.simulation.loop.result import format_report
from quasi.simulation.loop.run import simulate
from quasi.simulation.loop.setup import make_setup
from quasi.tables import read_numbers, write_json, write_table, write_text


def main(asked: dict, output: dict) -> None:
    """Read the model and the tables of wind and reference, simulate, write what came out."""
    wind, reference = (read_numbers(asked[k]) if asked[k] else None for k in ("wind", "reference"))
    setup = make_setup(asked["settings"], read_model(asked["model"]), wind, reference, asked["name"])
    result = simulate(setup)
    summary = result.summary()
    about = {k: summary[k] for k in ("simulation", "model", "ended", "settings", "rotor limits", "fault time")}
    write_table(output["table"], result.table, result.units, about)
    write_json(output["summary"], summary)
    write_text(output["text"], format_report(summary) + "\n")


if __name__ == "__main__":
    with job(snakemake.log[0], f"flight of simulation {snakemake.wildcards.simulation}"):
        main(snakemake.params.asked, dict(snakemake.output.items()))
