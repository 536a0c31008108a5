"""Write a model as C99, compile it as double and as float, and compare both with the model."""

from quasi.export.agreement import hand_over
from quasi.export.c_source import c_files
from quasi.export.compiler import NO_COMPILER, find_compiler, write_files
from quasi.export.running import check_c
from quasi.model.extensions import actuators_of
from quasi.model.model import read_model
from quasi.running.job_log import job, print_at_end


def main(model: str, folder: str) -> None:
    """Read the model; write header, source and agreement report."""
    portable = read_model(model)
    files = c_files(portable)
    write_files(folder, files)
    notes = [*actuators_of(portable).notes]
    checks = []
    if find_compiler():
        checks = check_c(portable, files)
    else:
        notes.append(f"not compared: {NO_COMPILER}")
    print_at_end(hand_over(folder, portable, "C", checks, notes, list(files)))


if __name__ == "__main__":
    with job(snakemake.log[0], f"C export of {snakemake.wildcards.model}"):
        main(snakemake.input.model, snakemake.output.folder)
