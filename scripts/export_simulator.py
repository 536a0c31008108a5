"""Write a model's physical constants for one simulator, and compare the files, read back, with the model."""

from pathlib import Path

from quasi.export.agreement import hand_over
from quasi.export.physical_constants import constants_plain, constants_text, physical_constants
from quasi.export.registry import export_to_simulator
from quasi.model.model import read_model
from quasi.running.job_log import job, print_at_end
from quasi.tables import write_json, write_text


def main(model: str, name: str, folder: str) -> None:
    """Read the model; write the target's files, the table of constants and the agreement report."""
    portable = read_model(model)
    checks, notes, files = export_to_simulator(portable, name, folder)
    constants = physical_constants(portable)
    write_json(Path(folder) / "constants.json", constants_plain(constants))
    write_text(Path(folder) / "constants.txt", constants_text(constants) + "\n")
    print_at_end(hand_over(folder, portable, name, checks, notes, [*files, "constants.json", "constants.txt"]))


if __name__ == "__main__":
    with job(snakemake.log[0], f"{snakemake.wildcards.simulator} export of {snakemake.wildcards.model}"):
        main(snakemake.input.model, snakemake.wildcards.simulator, snakemake.output.folder)
