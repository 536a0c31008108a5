"""What the sensors and the rotors' drive of a gap's flights are wrong by, before anything aerodynamic is asked."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from quasi.airframe import read_airframe
from quasi.errors import ConfigError
from quasi.filtering.flight import filter_flight
from quasi.filtering.rotor_speeds import add_estimated_speeds
from quasi.gap.catalogue import catalogue, chosen
from quasi.gap.flights.gathering import refuse_another_vehicle
from quasi.gap.flights.level import Flown
from quasi.gap.flights.sessions import sessions_of
from quasi.gap.flights.unusable import USE_UNUSABLE, exclude_unusable, exclusion_notes
from quasi.gap.levels.sensors_and_drive import examine, units_of
from quasi.importing.flight import import_flight
from quasi.model.commands import map_of
from quasi.model.model import read_model
from quasi.project.same_recordings import refuse_trained, repeated_recordings
from quasi.running.job_log import LOG, job, show_progress
from quasi.tables import read_json, read_table, write_json, write_table


def main(source: dict, asked: dict, settings: dict, names: dict[str, str], output: dict[str, str]) -> None:
    """Read the flights that may choose and fit; write what sensors and drive found, and their tables.

    names  {"quadrotor/flight": its row}, for messages
    """
    if asked["problem"]:
        raise ConfigError(asked["problem"])
    if repeated := repeated_recordings({**asked, "name": asked["file"]}, names):
        raise ConfigError(repeated[0])
    effects = chosen(asked["settings"]["effects"], catalogue(asked["effect files"]), asked["file"])
    model, flights = read_model(source["model"]), []
    refuse_trained(asked, model.document, names)
    kinds = ("imported", "imported_metadata", "filtered", "filtered_metadata")
    for paths in show_progress(list(zip(*(source[kind] for kind in kinds), strict=True)), "reading flights"):
        key = Path(paths[0]).stem
        airframe = read_airframe(asked["quadrotor"], asked["quadrotor"]["file"], asked["masses"][key])
        refuse_another_vehicle(f"{asked['file']}: flight {key}", airframe, model)
        imported, about, filtered, filtered_about = (
            read_table(p) if p.endswith(".parquet") else read_json(p) for p in paths
        )
        drive = map_of(model.document)
        filtered = add_estimated_speeds(filtered, filtered_about, drive, trimmed=False)
        compared = asked["roles"][key] != "reference"
        flights.append(Flown(key, compared, imported, about, filtered, filtered_about, airframe))

    learning = {f.key: f.filtered_metadata for f in flights}
    left_out = exclude_unusable(learning, asked["roles"], asked["file"], asked["settings"][USE_UNUSABLE])
    for note in exclusion_notes(left_out, asked["roles"]):
        LOG.warning("%s", note)
    flights = [f for f in flights if f.key not in left_out]

    def process(flown: Flown, calibration: Mapping[str, Any] | None) -> Flown:
        return anew(flown, settings[flown.key], calibration, map_of(model.document))

    sessions = sessions_of(asked["sessions"], {f.key: f.metadata for f in flights})
    asked_of = {**asked["settings"], "sessions": sessions}
    result, levels = examine(flights, model.document, asked_of, effects, process, len(asked["held"]))
    result["left out"] = left_out
    folder = Path(output["tables"])
    folder.mkdir(parents=True, exist_ok=True)
    for level in levels:
        LOG.info("level %s: %s", level.level, ", ".join(e["id"] for e in level.effects) or "nothing")
        for note in level.notes:
            LOG.info("%s", note)
        for name, table in level.tables.items():
            write_table(folder / f"{level.level}_{name}.parquet", table, units_of(table))
    write_json(output["calibration"], result)


def anew(flown: Flown, settings: dict, calibration: Mapping[str, Any] | None, drive: Mapping[str, Any] | None) -> Flown:
    """A flight imported and filtered again with a calibration, speeds by the map `drive`. Raises ConfigError."""
    for stage in ("importing", "filtering"):
        if settings[stage]["problem"]:
            raise ConfigError(settings[stage]["problem"])
    of = settings["importing"]
    imported, about = import_flight(of["flight"], of["quadrotor"], of["options"], calibration)
    result = filter_flight(imported, about, flown.airframe, settings["filtering"]["options"])
    filtered = add_estimated_speeds(result.with_gravity, result.metadata, drive, trimmed=False)
    return replace(flown, imported=imported, metadata=about, filtered=filtered, filtered_metadata=result.metadata)


if __name__ == "__main__":
    with job(snakemake.log[0], f"calibration of gap {snakemake.wildcards.gap}"):
        main(
            dict(snakemake.input.items()),
            snakemake.params.asked,
            snakemake.params.settings,
            snakemake.params.names,
            dict(snakemake.output.items()),
        )
