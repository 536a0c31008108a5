"""Gather a finished simulation, its summary and pictures into the folder that is handed over."""

from pathlib import Path

from quasi.running.job_log import hand_over, job, print_at_end
from quasi.tables import read_text


def main(files: list[str], folder: str) -> None:
    """Copy files and folders into the folder and print what was made."""
    target = hand_over(files, folder)
    made = ", ".join(sorted(Path(p).name for p in files))
    print_at_end(f"{read_text(target / 'summary.txt').rstrip()}\nMade {folder}: {made}")


if __name__ == "__main__":
    with job(snakemake.log[0], f"simulation {snakemake.wildcards.simulation}"):
        main(snakemake.input, snakemake.output.folder)
