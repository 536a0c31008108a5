"""Identify one axis of a model by stepwise regression on the training rows."""

from pathlib import Path

from quasi.airframe import from_plain
from quasi.errors import DataError, ExpressionError
from quasi.filtering.rotor_speeds import add_estimated_speeds
from quasi.identification.candidates import read_specification
from quasi.identification.fit import fit_axis
from quasi.identification.map_error import add_map_error
from quasi.identification.partition import from_table
from quasi.identification.steps import describe_steps
from quasi.running.job_log import LOG, job, show_progress
from quasi.tables import read_json, read_made, read_table, write_json
from quasi.terms.normalisation import make_normalisation


def main(flights: list[str], shared: str, partition: str, settings: dict, output: str) -> None:
    """Read the training flights and what the axes share; write the axis."""
    axis, found = settings["axis"], read_json(shared)
    specification = read_specification(
        {axis: settings["specification"]}, axis, settings["specification file"], settings["bias"]
    )
    drive = found.get("rotor speeds")
    raw = {Path(path).stem: (read_table(path), read_made(path)) for path in show_progress(flights, "reading flights")}

    def with_speeds(drive: dict | None) -> dict:
        return {key: add_estimated_speeds(table, made, drive) for key, (table, made) in raw.items()}

    tables = with_speeds(drive)
    roles = from_table(read_table(partition), {key: len(table) for key, table in tables.items()}, axis)
    airframe = from_plain(found["airframe"])
    scheme = None
    if settings["normalise"]:
        scheme = make_normalisation(airframe, found["logged to rad/s"], settings["model file"])
    try:
        result = fit_axis(axis, tables, roles, airframe, found, settings, specification, scheme)
    except (DataError, ExpressionError) as error:
        problem = str(error).removeprefix(f"{axis}, ").removeprefix(f"{axis}: ")
        raise type(error)(f"{settings['specification file']}, {axis}: {problem}") from None
    if drive is not None:
        hover = found["hover speed"]["value"]
        result = add_map_error(result, axis, drive, with_speeds, roles, airframe, hover, scheme)
    for line in describe_steps(axis, result["log"], result["stop reason"]):
        LOG.info("%s", line)
    for note in result["notes"]:
        LOG.warning("%s", note)
    write_json(output, result)


if __name__ == "__main__":
    with job(snakemake.log[0], f"identification of {snakemake.wildcards.axis} of {snakemake.wildcards.model}"):
        main(
            snakemake.input.flights,
            snakemake.input.shared,
            snakemake.input.partition,
            snakemake.params.settings,
            snakemake.output[0],
        )
