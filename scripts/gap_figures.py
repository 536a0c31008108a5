"""Draw the figures of a diagnosis from its tables."""

from pathlib import Path

from quasi.gap.report.figures import figures
from quasi.running.figure_files import write_figures
from quasi.running.job_log import job
from quasi.tables import read_table


def main(tables: str, folder: str, processes: int = 1) -> None:
    """Read the tables; write one PNG per figure."""
    found = {p.stem: read_table(p) for p in sorted(Path(tables).glob("*.parquet"))}
    write_figures(figures(found), folder, processes)


if __name__ == "__main__":
    with job(snakemake.log[0], f"figures of gap {snakemake.wildcards.gap}"):
        main(snakemake.input.tables, snakemake.output[0], snakemake.threads)
