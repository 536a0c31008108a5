"""Import a flight of a gap anew with the calibration that was found; where that corrects nothing, take it as it is."""

from quasi.errors import ReadError
from quasi.gap.levels.corrections import for_flight
from quasi.importing.flight import import_flight
from quasi.running.job_log import LOG, job
from quasi.tables import copy_file, read_json, write_json, write_table


def main(source: dict[str, str], settings: dict, role: str, flight: str, metadata: str) -> None:
    """Read the calibration and the raw files; write the flight and its metadata."""
    calibration = for_flight(read_json(source["calibration"]), role != "reference")
    if calibration is None:
        copy_file(source["flight"], flight)
        copy_file(source["metadata"], metadata)
        return
    if settings["problem"]:
        raise ReadError(settings["problem"])
    columns, about = import_flight(settings["flight"], settings["quadrotor"], settings["options"], calibration)
    about["logbook"] = read_json(source["metadata"]).get("logbook")
    for note in about["notes"]:
        LOG.warning("%s", note)
    write_table(flight, columns, made=about)
    write_json(metadata, about)


if __name__ == "__main__":
    with job(snakemake.log[0], f"import of {snakemake.wildcards.flight}, calibrated"):
        main(
            {name: snakemake.input[name] for name in ("calibration", "flight", "metadata")},
            snakemake.params.settings,
            snakemake.params.role,
            snakemake.output.flight,
            snakemake.output.metadata,
        )
