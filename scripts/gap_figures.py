"""Draw the figures of a diagnosis."""

from pathlib import Path

from quasi.gap.report.figures import figures
from quasi.running.figure_files import write_figures
from quasi.running.job_log import job
from quasi.tables import read_json, read_table


def main(diagnosis: str, tables: str, folder: str, processes: int = 1) -> None:
    """Read the trim and the tables; write one PNG per figure."""
    found = {p.stem: read_table(p) for p in sorted(Path(tables).glob("*.parquet"))}
    write_figures(figures(found, read_json(diagnosis).get("hover trim")), folder, processes)


if __name__ == "__main__":
    with job(snakemake.log[0], f"figures of gap {snakemake.wildcards.gap}"):
        main(snakemake.input.diagnosis, snakemake.input.tables, snakemake.output[0], snakemake.threads)
