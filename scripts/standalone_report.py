"""The page of a model: verdict, scores, a comparison to zoom into, coverage, terms, rotors, warnings."""

from quasi.pages.model import render_model_page
from quasi.running.job_log import job
from quasi.tables import read_json, read_table, write_text


def main(source: dict[str, str], target: str) -> None:
    """Read what the scores' job wrote; write one HTML file."""
    model, summary, diagnosis = (read_json(source[k]) for k in ("model", "summary_json", "diagnosis"))
    write_text(
        target, render_model_page(model, summary, diagnosis, read_table(source["coverage"]), read_table(source["rows"]))
    )


if __name__ == "__main__":
    with job(snakemake.log[0], f"report of {snakemake.wildcards.model}"):
        main(dict(snakemake.input.items()), snakemake.output[0])
