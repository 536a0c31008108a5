"""Write a filtered flight as MCAP, with a PlotJuggler layout."""

from quasi.airframe import read_airframe
from quasi.errors import ConfigError
from quasi.export.mcap.plotjuggler import layout_text
from quasi.export.mcap.recording import write_recording
from quasi.export.mcap.vehicles import phases_of, vehicle_of
from quasi.running.job_log import LOG, job
from quasi.tables import read_table, write_text


def main(flight: str, settings: dict, target: str, layout: str) -> None:
    """Read the filtered flight; write recording and layout."""
    if settings["problem"]:
        raise ConfigError(settings["problem"])
    table = read_table(flight)
    vehicles = [vehicle_of("measured", table)]
    airframe = read_airframe(settings["quadrotor"], settings["quadrotor"]["file"], settings["mass"])
    LOG.info("%d messages", write_recording(target, vehicles, phases_of(table), airframe))
    write_text(layout, layout_text(vehicles))


if __name__ == "__main__":
    with job(snakemake.log[0], f"MCAP of {snakemake.wildcards.flight}"):
        main(snakemake.input.flight, snakemake.params.settings, snakemake.output.recording, snakemake.output.layout)
