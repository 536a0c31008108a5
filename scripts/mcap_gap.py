"""Write the held-out flights of a gap as MCAP: measured, simulated before and after the extension, and residuals."""

from pathlib import Path

from quasi.export.mcap.plotjuggler import layout_text
from quasi.export.mcap.recording import write_recording
from quasi.export.mcap.vehicles import PATH_AFTER, PATH_BEFORE, Event, phases_of, vehicle_of, with_residuals
from quasi.gap.levels.rollouts.continuous import chase, chased_table
from quasi.gap.levels.rollouts.open_loop import flight_of
from quasi.model.model import read_model
from quasi.running.job_log import job, print_at_end, show_progress
from quasi.tables import read_json, read_table, write_text


def main(flights: list, models: tuple, diagnosis: str, masses: dict, horizon: float, folder: str) -> None:
    """Read flights and both models; write one recording and layout per flight."""
    before, after = map(read_model, models)
    summary = read_json(diagnosis)["summary"]
    written = []
    for path in show_progress(flights, "writing"):
        key, table = Path(path).stem, read_table(path)
        flight = flight_of(key, table, masses.get(key))
        vehicles, events = [vehicle_of("measured", table)], [Event(0.0, summary), *phases_of(table)]
        for name, model, color in (("before", before, PATH_BEFORE), ("after", after, PATH_AFTER)):
            found = chase(model, flight, horizon)
            vehicle = vehicle_of(name, chased_table(flight, found), color)
            vehicles.append(with_residuals(vehicle, model, table, masses.get(key)))
        zero = float(flight.t[0])
        events += [
            Event(float(flight.t[k]) - zero, "both simulations begin from the measured state") for k in found.starts
        ]
        target = Path(folder) / f"{key}.mcap"
        write_recording(target, vehicles, sorted(events), after.airframe)
        write_text(target.with_suffix(".plotjuggler.xml"), layout_text(vehicles))
        written.append(target.name)
    print_at_end(f"Made {folder}: {', '.join(written)}")


if __name__ == "__main__":
    with job(snakemake.log[0], f"MCAP of gap {snakemake.wildcards.gap}"):
        main(
            snakemake.input.flights,
            (snakemake.input.model, snakemake.input.extended),
            snakemake.input.diagnosis,
            snakemake.params.masses,
            snakemake.params.horizon,
            snakemake.output[0],
        )
