"""Gather a finished diagnosis, its report, tables and figures into the folder that is handed over."""

import re
from pathlib import Path

from quasi.running.job_log import hand_over, job, print_at_end
from quasi.tables import read_json


def name_in_folder(path: Path) -> str:
    """Name of a result in the folder of the gap."""
    if path.parent.name == "calibrations":
        return "calibration.json"
    return "tables" if path.name == "sensors" and path.is_dir() else path.name


def main(files: list[str], folder: str) -> None:
    """Copy files and folders into the folder and print what was found."""
    target = hand_over(files, folder, name_in_folder)
    found = read_json(target / "diagnosis.json")
    sentences = re.split(r"(?<=\.) (?=[A-Z])", found["summary"])
    lines = [f"Gap {target.name}: {found['verdict']}", *(f"  {sentence}" for sentence in sentences)]
    print_at_end("\n".join([*lines, f"Made {folder}; begin with {folder}/report.html"]))


if __name__ == "__main__":
    with job(snakemake.log[0], f"gap {snakemake.wildcards.gap}"):
        files = [str(path) for name, path in snakemake.input.items() if name != "inspected"]
        main(files, snakemake.output.folder)
