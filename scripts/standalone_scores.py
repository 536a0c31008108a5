"""Score a model on its training, test and validation rows; say in words what it is worth."""

from pathlib import Path

from quasi.filtering.rotor_speeds import read_flight
from quasi.identification.partition import ROLES, judged_rows
from quasi.model.commands import map_of
from quasi.model.model import read_model
from quasi.running.job_log import LOG, job, show_progress
from quasi.scoring.diagnostics import COVERAGE_UNITS
from quasi.scoring.review import review_model
from quasi.scoring.score import SCORE_UNITS
from quasi.scoring.summary import format_latex, format_summary, make_summary
from quasi.scoring.thinning import list_thinned_units, thin_rows
from quasi.scoring.verdict import describe_flights_without_voltage, describe_unusable_flights, lower_verdict
from quasi.tables import list_masses, read_made, read_table, write_json, write_table, write_text


def main(source: dict, roles: dict, options: dict, output: dict) -> None:
    """Read the model, all of its flights, and of an extended one its base; write scores, diagnosis, summaries."""
    portable, base = (read_model(source[k]) if source.get(k) else None for k in ("model", "base"))
    drive = map_of(portable.document)
    tables = {Path(path).stem: read_flight(path, drive) for path in show_progress(source["flights"], "reading flights")}
    codes, aside = judged_rows(read_table(source["partition"]), tables, roles["validation"], options)
    made = {Path(path).stem: read_made(path) for path in source["flights"]}
    found = review_model(portable, tables, codes, ROLES, aside, options, base, list_masses(made))
    doubts = describe_unusable_flights(made, roles["validation"])
    doubts += describe_flights_without_voltage(tables, drive, roles["validation"])
    found = found._replace(diagnosis=lower_verdict(found.diagnosis, doubts))
    for sentence in doubts:
        LOG.warning("%s", sentence)
    for line in found.diagnosis["summary"]:
        LOG.info("%s", line)
    write_table(output["scores"], found.scores, SCORE_UNITS)
    write_table(output["coverage"], found.coverage, COVERAGE_UNITS)
    write_table(output["rows"], thin_rows(found.comparisons, roles["validation"]), list_thinned_units(portable.axes))
    write_json(output["diagnosis"], found.diagnosis)
    write_json(output["summary_json"], make_summary(portable, found.scores, found.diagnosis))
    write_text(output["summary_latex"], format_latex(portable, found.scores, found.diagnosis))
    write_text(output["summary"], format_summary(portable, found.scores, found.diagnosis))


if __name__ == "__main__":
    with job(snakemake.log[0], f"scores of {snakemake.wildcards.model}"):
        main(
            dict(snakemake.input.items()),
            snakemake.params.flights,
            snakemake.params.options,
            dict(snakemake.output.items()),
        )
