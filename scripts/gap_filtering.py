"""Filter a flight of a gap that was imported anew; where nothing was corrected, take it as it is."""

from quasi.airframe import read_airframe
from quasi.errors import ConfigError
from quasi.filtering.flight import filter_flight
from quasi.running.job_log import LOG, job, show_progress
from quasi.tables import copy_file, read_json, read_table, write_json, write_table


def main(source: dict[str, str], settings: dict, output: dict[str, str]) -> None:
    """Read the imported flight, filter it and write both kinds of force and their metadata."""
    about = read_json(source["metadata"])
    if not about.get("calibration"):
        for name, path in output.items():
            copy_file(source[name], path)
        return
    if settings["problem"]:
        raise ConfigError(settings["problem"])
    airframe = read_airframe(settings["quadrotor"], settings["quadrotor"]["file"], settings["mass"])
    result = filter_flight(read_table(source["flight"]), about, airframe, settings["options"], show_progress)
    for note in result.metadata["notes"]:
        LOG.warning("%s", note)
    for kind, columns in (("with_gravity", result.with_gravity), ("no_gravity", result.no_gravity)):
        made = {**result.metadata, "forces": "withGravity" if kind == "with_gravity" else "noGravity"}
        write_table(output[kind], columns, made=made)
        write_json(output[f"{kind}_metadata"], made)


if __name__ == "__main__":
    with job(snakemake.log[0], f"filtering of {snakemake.wildcards.flight}, calibrated"):
        main(dict(snakemake.input.items()), snakemake.params.settings, dict(snakemake.output.items()))
