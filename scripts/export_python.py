"""Write a model as one Python file, run it in a process without quasi, and compare it with the model."""

from quasi.export.agreement import hand_over
from quasi.export.compiler import write_files
from quasi.export.python_source import python_file
from quasi.export.running import check_python
from quasi.model.extensions import actuators_of
from quasi.model.model import read_model
from quasi.running.job_log import job, print_at_end


def main(model: str, folder: str) -> None:
    """Read the model; write the file and its agreement report."""
    portable = read_model(model)
    name, text = python_file(portable)
    write_files(folder, {name: text})
    checks = check_python(portable, name, text)
    print_at_end(hand_over(folder, portable, "Python", checks, actuators_of(portable).notes, [name]))


if __name__ == "__main__":
    with job(snakemake.log[0], f"Python export of {snakemake.wildcards.model}"):
        main(snakemake.input.model, snakemake.output.folder)
