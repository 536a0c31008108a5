"""Write a simulation as MCAP, its reference as a second vehicle, with a PlotJuggler layout."""

from quasi.export.mcap.plotjuggler import layout_text
from quasi.export.mcap.recording import write_recording
from quasi.export.mcap.vehicles import Event, reference_of, vehicle_of
from quasi.model.model import read_model
from quasi.running.job_log import LOG, job
from quasi.tables import read_json, read_table, write_text


def main(table: str, summary: str, model: str, target: str, layout: str) -> None:
    """Read the simulation; write recording and layout."""
    flown, about = read_table(table), read_json(summary)
    vehicles = [v for v in (vehicle_of("simulated", flown), reference_of(flown)) if v is not None]
    events = [Event(0.0, f"simulation {about['simulation']} of model {about['model']}")]
    if about["fault time"] is not None:
        events.append(Event(about["fault time"], "a rotor fails"))
    if about["ended"]:
        events.append(Event(float(vehicles[0].t[-1]), about["ended"]))
    LOG.info("%d messages", write_recording(target, vehicles, events, read_model(model).airframe))
    write_text(layout, layout_text(vehicles))


if __name__ == "__main__":
    with job(snakemake.log[0], f"MCAP of simulation {snakemake.wildcards.simulation}"):
        main(
            snakemake.input.table,
            snakemake.input.summary,
            snakemake.input.model,
            snakemake.output.recording,
            snakemake.output.layout,
        )
