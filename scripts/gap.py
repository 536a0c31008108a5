"""Gather a finished diagnosis, its report, tables and figures into the folder that is handed over."""

import shutil
from pathlib import Path

from quasi.running.job_log import job, print_at_end
from quasi.tables import read_json


def main(files: list[str], folder: str) -> None:
    """Copy files and folders into the folder and say what was found."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for path in map(Path, files):
        name = "calibration.json" if path.parent.name == "calibrations" else path.name
        if path.is_dir():
            shutil.copytree(path, target / ("tables" if name == "sensors" else name), dirs_exist_ok=True)
        else:
            shutil.copy(path, target / name)
    found = read_json(target / "diagnosis.json")
    print_at_end(
        f"{target.name}: {found['verdict']}. {found['summary']}\nMade {folder}; begin with {folder}/report.html"
    )


if __name__ == "__main__":
    with job(snakemake.log[0], f"gap {snakemake.wildcards.gap}"):
        files = [str(path) for name, path in snakemake.input.items() if name != "inspected"]
        main(files, snakemake.output.folder)
