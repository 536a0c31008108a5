"""The page of a diagnosis: the sentence, what is wrong, why, and what the extended model gains."""

from pathlib import Path

from quasi.gap.catalogue import catalogue
from quasi.gap.report.localised import LEVELS_WITH_PLACES
from quasi.gap.report.page import page
from quasi.running.job_log import job
from quasi.tables import read_bytes, read_json, read_table, write_text


def main(diagnosis: str, tables: list[str], figures: str, files: list[str], target: str) -> None:
    """Read the diagnosis, its rows and its figures; write one HTML file. tables  their folders"""
    found = {p.stem: p for folder in tables for p in Path(folder).glob("*.parquet")}
    where = {level: read_table(found[f"{level}_where"]) for level in LEVELS_WITH_PLACES if f"{level}_where" in found}
    pictures = {p.stem: read_bytes(p) for p in sorted(Path(figures).glob("*.png"))}
    residuals = read_table(found["forces_residuals"]) if "forces_residuals" in found else None
    write_text(target, page(read_json(diagnosis), catalogue(files), residuals, pictures, where))


if __name__ == "__main__":
    with job(snakemake.log[0], f"report of gap {snakemake.wildcards.gap}"):
        main(
            snakemake.input.diagnosis,
            [snakemake.input.sensors, snakemake.input.tables],
            snakemake.input.figures,
            snakemake.params.files,
            snakemake.output[0],
        )
