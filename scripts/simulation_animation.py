"""Animate a simulated flight: MP4 where an encoder is installed, else GIF."""

from pathlib import Path

from quasi.model.model import read_model
from quasi.pages.animation import animate, can_write_mp4
from quasi.pages.drawing import make_motion
from quasi.running.job_log import LOG, job
from quasi.simulation.tools.figures import cut_runaway_rows
from quasi.tables import read_table


def main(table: str, model: str, name: str, settings: dict, folder: str) -> None:
    """Read the table and write the animation."""
    flight = cut_runaway_rows(read_table(table))
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    kind = "mp4" if can_write_mp4() else "gif"
    if kind == "gif":
        LOG.info("written as GIF; `pip install 'quasi[animation]'` makes it an MP4 of a tenth of the size")
    motion = make_motion(flight, read_model(model).airframe, name)
    rate, speed = settings["frames per second"], settings["speed"]
    count = animate([motion], target / f"animation.{kind}", rate, speed, trail=5.0 * speed, title=name)
    LOG.info("%d frames", count)


if __name__ == "__main__":
    with job(snakemake.log[0], f"animation of simulation {snakemake.wildcards.simulation}"):
        main(
            snakemake.input.table,
            snakemake.input.model,
            snakemake.wildcards.simulation,
            snakemake.params.settings,
            snakemake.output[0],
        )
