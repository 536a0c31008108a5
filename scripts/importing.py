"""Import one flight: read its sources, synchronise their clocks, fuse them on one time base."""

from quasi.errors import ReadError, cautions_first
from quasi.importing.flight import import_flight
from quasi.project.logbook import describe_row
from quasi.running.job_log import LOG, job, log_verdict
from quasi.tables import write_json, write_table


def main(settings: dict, logbook: str, flight: str, metadata: str) -> None:
    """Read the raw files that the settings name; write the fused flight and its metadata.

    logbook  path; the flight's row is read here, because cells that the import does not use must not make it stale
    """
    if settings["problem"]:
        raise ReadError(settings["problem"])
    columns, about = import_flight(settings["flight"], settings["quadrotor"], settings["options"])
    about["logbook"] = describe_row(logbook, settings["flight"]["quadrotor"], settings["flight"]["flight"])
    if about["verdict"] != "good":
        log_verdict(about["verdict"], about["verdict because"])
    for note in cautions_first(about["notes"]):
        LOG.warning("%s", note)
    write_table(flight, columns, made=about)
    write_json(metadata, about)


if __name__ == "__main__":
    with job(snakemake.log[0], f"import of {snakemake.wildcards.flight}"):
        main(snakemake.params.settings, snakemake.params.logbook, snakemake.output.flight, snakemake.output.metadata)
