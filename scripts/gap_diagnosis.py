"""Compare a model with a gap's flights: causes, what is left, the extended model, its gain; all as tables and data."""

import os

# many small matrices: the threads of a linear algebra library would only wait for each other
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

from pathlib import Path

import pandas as pd

from quasi.airframe import read_airframe
from quasi.errors import ConfigError, DataError
from quasi.filtering.rotor_speeds import add_estimated_speeds
from quasi.gap.catalogue import catalogue, chosen
from quasi.gap.diagnosis import diagnose
from quasi.gap.flights.gathering import gather_all
from quasi.gap.flights.level import Flown
from quasi.gap.flights.sessions import sessions_of
from quasi.gap.flights.unusable import USE_UNUSABLE, exclude_unusable, exclusion_notes
from quasi.gap.levels.rollouts.open_loop import flight_of, windows
from quasi.gap.levels.sensors_and_drive import units_of
from quasi.identification.partition import PARTITION_UNITS, partition, to_table
from quasi.model.commands import map_of
from quasi.model.model import read_model
from quasi.project.same_recordings import list_model_recordings, unchecked
from quasi.running.job_log import LOG, job, show_progress
from quasi.tables import drop_identified_commands, list_recordings, read_json, read_table, write_json, write_table

RATE = 100.0  # Hz, of the comparison of forces and moments


def main(source: dict, asked: dict, output: dict[str, str]) -> None:
    """Read model, calibration and flights; write the diagnosis, the extended model and the tables."""
    if asked["problem"]:
        raise ConfigError(asked["problem"])
    model, roles = read_model(source["model"]), asked["roles"]
    effects = chosen(asked["settings"]["effects"], catalogue(asked["effect files"]), asked["file"])
    tables, airframes = {}, {}
    for path, about in show_progress(list(zip(source["flights"], source["metadata"], strict=True)), "reading flights"):
        key = Path(path).stem
        airframes[key] = read_airframe(asked["quadrotor"], asked["quadrotor"]["file"], asked["masses"][key])
        made = read_json(about)
        # one map for all flights: a factor of each flight's own would hide a weak rotor
        flight = add_estimated_speeds(read_table(path), made, map_of(model.document), trimmed=False)
        tables[key] = flight, made, airframes[key]
    calibration = read_json(source["calibration"])
    left_out = _exclude(calibration, {key: about for key, (_, about, _) in tables.items()}, asked)
    tables = {key: table for key, table in tables.items() if key not in left_out}
    try:
        evidence, lost = gather_all(tables, model, RATE)
    except DataError as error:
        raise DataError(f"{asked['file']}: {error}") from None
    # where none can be compared, the extended model is the model, and is shown on all
    flights = {
        key: drop_identified_commands(table, about.get("imported"))
        for key, (table, about, _) in tables.items()
        if key in evidence or not evidence
    }
    lost = exclusion_notes(left_out, roles) + lost + unchecked(asked, model.document)
    lost += too_short(flights, roles, max(asked["settings"]["horizons"]))
    held = [
        [f for f in _flown(source, prefix, airframes, map_of(model.document)) if f.key not in left_out]
        for prefix in ("first", "held")
    ]
    found = diagnose(
        model,
        calibration,
        evidence,
        flights,
        roles,
        effects,
        {**asked["settings"], "sessions": sessions_of(asked["sessions"], {k: t[1] for k, t in tables.items()})},
        tuple(held),
        asked["name"],
        lost,
        asked["references"],
    )
    LOG.info("%s: %s", found.document["verdict"], found.document["summary"])
    folder = Path(output["tables"])
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in found.tables.items():
        write_table(folder / f"{name}.parquet", table, units_of(table))
    write_table(output["partition"], _partition(flights, roles, found.document["effects"]), PARTITION_UNITS)
    learning = {key: about for key, (_, about, _) in tables.items() if roles[key] != "held out"}
    recordings = {**list_model_recordings(model.document), **list_recordings(learning)}
    write_json(output["model"], {**found.model, "recordings": recordings})
    write_json(output["diagnosis"], found.document)


def _exclude(calibration: dict, flights: dict[str, dict], asked: dict) -> dict[str, str]:
    """{flight: why} of those that the calibration left out, and of those that contradict themselves after it."""
    before = calibration.get("left out", {})
    remaining = {key: about for key, about in flights.items() if key not in before}
    after = exclude_unusable(remaining, asked["roles"], asked["file"], asked["settings"][USE_UNUSABLE])
    for note in exclusion_notes(after, asked["roles"]):
        LOG.warning("%s", note)
    return {**before, **after}


def too_short(flights: dict[str, pd.DataFrame], roles: dict[str, str], horizon: float) -> list[str]:
    """Sentences on held-out flights that no simulation of the longest horizon, s, fits into."""
    return [
        f"flight {key} has no {horizon:g} s of valid data without a gap and is left out of the simulations; "
        "shorten 'horizons' to see it there"
        for key, table in flights.items()
        if roles[key] == "held out" and not len(windows(flight_of(key, table), horizon))
    ]


def _partition(flights: dict[str, pd.DataFrame], roles: dict[str, str], effects: list[dict]) -> pd.DataFrame:
    """Which rows the extended model may be judged on as training and as validation: where a cause is new, reference
    flights are of the vehicle as it was, and neither."""
    new = any(e["since"] == "changed" or e.get("in training flights") is False for e in effects)
    held = [k for k in flights if roles[k] == "held out"]
    judged = {k: table for k, table in flights.items() if not (new and roles[k] == "reference")}
    return to_table(partition(judged, held, {"random partition": False}))


def _flown(source: dict, prefix: str, airframes: dict, drive: dict | None) -> list[Flown]:
    names = [f"{prefix}_{n}" for n in ("imported", "imported_metadata", "filtered", "filtered_metadata")]
    result = []
    for paths in zip(*(source[n] for n in names), strict=True):
        key = Path(paths[0]).stem
        parts = [read_table(p) if p.endswith(".parquet") else read_json(p) for p in paths]
        parts[2] = add_estimated_speeds(parts[2], parts[3], drive, trimmed=False)
        result.append(Flown(key, True, *parts, airframes[key]))
    return result


if __name__ == "__main__":
    with job(snakemake.log[0], f"diagnosis of gap {snakemake.wildcards.gap}"):
        main(dict(snakemake.input.items()), snakemake.params.asked, dict(snakemake.output.items()))
