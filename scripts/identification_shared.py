"""What the axes of a model share: which rows train and test, hover speed, simple model, actuator constants."""

from pathlib import Path

from quasi.airframe import read_airframe, to_plain
from quasi.errors import ConfigError
from quasi.filtering.rotor_speeds import add_estimated_speeds
from quasi.identification.isolation import excited
from quasi.identification.partition import EXCITED, PARTITION_UNITS, partition, to_table
from quasi.identification.rotor_speeds import rotor_speeds_of
from quasi.identification.shared import left_out_notes, refuse_speedless, shared, unusable_flights
from quasi.running.job_log import LOG, job, show_progress
from quasi.tables import (
    drop_identified_commands,
    list_masses,
    list_recordings,
    list_telemetry_corrections,
    read_made,
    read_table,
    write_json,
    write_table,
)

AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def main(flights: list[str], settings: dict, shared_json: str, partition_parquet: str) -> None:
    """Read the training flights; write what the axes share and the partition of their rows."""
    if settings["problem"]:
        raise ConfigError(settings["problem"])
    airframe = read_airframe(settings["quadrotor"], settings["quadrotor"]["file"], settings["mass"])
    tables = {Path(path).stem: read_table(path) for path in show_progress(flights, "reading flights")}
    made = {Path(path).stem: read_made(path) for path in flights}
    refuse_speedless(tables)
    left_out = unusable_flights(made, tables, settings["use unusable flights"])
    tables, made = ({k: v for k, v in each.items() if k not in left_out} for each in (tables, made))
    because = {key: why for key, about in made.items() if (why := about.get("phases", {}).get("none valid because"))}
    masses = list_masses(made)
    roles = partition(tables, options=settings["data partitioning"], because=because)
    drive, notes_of_speeds = rotor_speeds_of(tables, airframe, masses, settings["quadrotor"], roles)
    tables = {key: add_estimated_speeds(table, made[key], drive) for key, table in tables.items()}
    mapped = settings["quadrotor"].get("command map")
    tables = {key: drop_identified_commands(table, made[key].get("imported")) for key, table in tables.items()}
    found = shared(
        tables, roles, airframe, settings["gravity"], masses, mapped, list_telemetry_corrections(made), drive
    )
    found["notes"] = notes_of_speeds + found["notes"]
    if settings["mixed batteries"]:
        kinds = ", ".join(settings["mixed batteries"])
        found["notes"].append(f"the flights were flown with different batteries ({kinds}), as the configuration allows")
    regions = excited(tables, roles, airframe, AXES, settings["isolation"]) if settings["isolation"] else {}
    found["notes"] += left_out_notes(left_out)
    for note in found["notes"]:
        LOG.warning("%s", note)
    factors = {about.get("logged to rad/s") for about in made.values()} - {None}
    if len(factors) > 1:
        raise ConfigError(
            f"the flights convert logged rotor speeds with different factors ({sorted(factors)}); "
            "set 'motor poles' in the quadrotor configuration, so that all flights use one pole count"
        )
    about = {
        "model": settings["model"],
        "flights": {"training": list(tables), "selected": settings["flights"]},
        "airframe": to_plain(airframe),
        "logged to rad/s": next(iter(factors), None),
        "data partitioning": settings["data partitioning"],
        "isolation": settings["isolation"],
    }
    inside = ("", "", "inside a region that excites this axis")
    units = PARTITION_UNITS | {f"{EXCITED}{axis}": inside for axis in regions}
    write_table(partition_parquet, to_table(roles, regions), units, made=about)
    write_json(shared_json, {**found, **about, "recordings": list_recordings(made)})


if __name__ == "__main__":
    with job(snakemake.log[0], f"what the axes of {snakemake.wildcards.model} share"):
        main(
            snakemake.input.flights,
            snakemake.params.settings,
            snakemake.output.shared,
            snakemake.output.partition,
        )
