"""Draw the figures of a diagnosis from its tables."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg

from quasi.gap.report.figures import figures
from quasi.running.job_log import job, show_progress
from quasi.tables import read_table, replace_file


def main(tables: str, folder: str) -> None:
    """Read the tables; write one PNG per figure."""
    found = {p.stem: read_table(p) for p in sorted(Path(tables).glob("*.parquet"))}
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for name, figure in show_progress(list(figures(found).items()), "drawing"):
        with replace_file(target / f"{name}.png") as part:
            FigureCanvasAgg(figure).print_png(part)


if __name__ == "__main__":
    with job(snakemake.log[0], f"figures of gap {snakemake.wildcards.gap}"):
        main(snakemake.input.tables, snakemake.output[0])
