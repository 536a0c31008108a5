"""Filter one imported flight: states, biases, forces and moments, with gravity and without; the filter's course."""

import time

from quasi.airframe import read_airframe
from quasi.errors import ConfigError, cautions_first
from quasi.filtering.estimation import CONVERGENCE_UNITS
from quasi.filtering.flight import NONE_VALID, course, filter_flight
from quasi.running.job_log import LOG, job, log_verdict, show_progress
from quasi.tables import read_json, read_table, write_json, write_table


def main(settings: dict, flight: str, metadata: str, output: dict[str, str]) -> None:
    """Read the imported flight, filter it and write both kinds of force, their metadata and the filter's course."""
    if settings["problem"]:
        raise ConfigError(settings["problem"])
    airframe = read_airframe(settings["quadrotor"], settings["quadrotor"]["file"], settings["mass"])
    imported, began = read_table(flight), time.perf_counter()
    result = filter_flight(imported, read_json(metadata), airframe, settings["options"], show_progress)
    seconds = time.perf_counter() - began
    LOG.info("%d samples filtered in %.1f s, %.0f a second", len(imported), seconds, len(imported) / seconds)
    if result.metadata["unusable because"]:
        log_verdict("unusable", "; ".join(result.metadata["unusable because"]))
    for note in cautions_first(n for n in result.metadata["notes"] if not n.startswith(NONE_VALID)):
        LOG.warning("%s", note)
    for kind, columns in (("with_gravity", result.with_gravity), ("no_gravity", result.no_gravity)):
        about = {**result.metadata, "forces": "withGravity" if kind == "with_gravity" else "noGravity"}
        write_table(output[kind], columns, made=about)
        write_json(output[f"{kind}_metadata"], about)
    whole = bool(settings["options"]["save kalman filter convergence results"])
    write_table(output["convergence"], course(result, whole), CONVERGENCE_UNITS, made=result.metadata["sampling"])


if __name__ == "__main__":
    with job(snakemake.log[0], f"filtering of {snakemake.wildcards.flight}"):
        main(
            snakemake.params.settings,
            snakemake.input.flight,
            snakemake.input.metadata,
            dict(snakemake.output.items()),
        )
