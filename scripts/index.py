"""The index page of the folder: what stands in it, with verdicts and links."""

from pathlib import Path

from quasi.joblog import job
from quasi.pages.index import collect, page
from quasi.tables import write_text


def main(root: str, target: str) -> None:
    """Read the summaries that stand in the folder; write one HTML file."""
    write_text(target, page(collect(root), Path(root).absolute().name))


if __name__ == "__main__":
    with job(snakemake.log[0], "index of the folder", snakemake.output[0]):
        main(".", snakemake.output[0])
