"""Where the flights of a model went: each trajectory with stills of the quadrotor, and its animation when asked for."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg

from quasi.airframe import read_airframe
from quasi.errors import ConfigError, DataError
from quasi.pages.animation import animate, can_write_mp4
from quasi.pages.drawing import make_flown_motion, select_flown_rows, trajectories
from quasi.running.job_log import LOG, job, show_progress
from quasi.tables import read_made, read_table, replace_file


def main(flights: list[str], settings: dict, folder: str) -> None:
    """Read the flights; write one PNG each, and an animation each where the configuration asks for it."""
    if settings["problem"]:
        raise ConfigError(settings["problem"])
    airframe = read_airframe(settings["quadrotor"], settings["quadrotor"]["file"], settings["mass"])
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for path in show_progress(flights, "drawing"):
        key = Path(path).stem
        try:
            motion = make_flown_motion(select_flown_rows(read_table(path)), read_made(path), airframe, key)
            figure = trajectories([motion], stills=settings["stills"], title=key)
        except DataError as error:
            LOG.warning("%s", error)
            continue
        with replace_file(target / f"{key}.png") as part:
            FigureCanvasAgg(figure).print_png(part)
        if settings["animate"]:
            kind = "mp4" if can_write_mp4() else "gif"
            animate([motion], target / f"{key}.{kind}", speed_up=settings["speed up"], trail=5.0, title=key)


if __name__ == "__main__":
    with job(snakemake.log[0], f"trajectories of {snakemake.wildcards.model}"):
        main(snakemake.input.flights, snakemake.params.settings, snakemake.output[0])
