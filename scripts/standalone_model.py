"""Assemble the identified axes of a model into one portable document."""

from pathlib import Path

from quasi.airframe import from_plain
from quasi.filtering.rotor_speeds import read_flight
from quasi.identification.partition import fitted
from quasi.model.build import add_differential_form, assemble_model
from quasi.model.envelope import measure_coverage
from quasi.running.job_log import job
from quasi.tables import fingerprint, read_json, read_table, write_json


def extended(source: str, settings: dict, output: str) -> None:
    """Take over the model that a gap extended; its differential form, where it has one, is made anew."""
    document = read_json(source)
    if settings["u"] is not None:
        document = add_differential_form(document, settings["u"], f"{settings['file']}, 'DiffSys u'")
    write_json(output, document)


def main(
    axes: list[str],
    shared: str,
    partition: str,
    flights: list[str],
    roles: dict,
    settings: dict,
    model: str,
    output: str,
) -> None:
    """Read the axes, what they share and the region their data covered; write the model."""
    found = read_json(shared)
    parts = {Path(path).stem: read_json(path) for path in axes}
    airframe = from_plain(found["airframe"])
    tables = {Path(path).stem: read_flight(path, found.get("rotor speeds")) for path in flights}
    rows = fitted(read_table(partition), {key: len(table) for key, table in tables.items()}, parts)
    meta = {
        "id": model,
        "airframe": airframe,
        "logged to rad/s": found["logged to rad/s"],
        "validation flights": roles["validation"],
        **measure_coverage(tables, rows, airframe, found["hover speed"]["value"], parts),
        "provenance": {"axes": {axis: fingerprint(part) for axis, part in parts.items()}},
    }
    document = assemble_model(parts, found, meta)
    if settings["u"] is not None:
        document = add_differential_form(document, settings["u"], f"{settings['file']}, 'DiffSys u'")
    write_json(output, document)


if __name__ == "__main__":
    with job(snakemake.log[0], f"assembly of model {snakemake.wildcards.model}"):
        source = dict(snakemake.input.items())
        if "extended" in source:
            extended(source["extended"], snakemake.params.settings, snakemake.output[0])
        else:
            main(
                source["axes"],
                source["shared"],
                source["partition"],
                source["flights"],
                snakemake.params.flights,
                snakemake.params.settings,
                snakemake.wildcards.model,
                snakemake.output[0],
            )
