"""Animate one flight; the name of the target decides between GIF and MP4."""

from pathlib import Path

from quasi.airframe import read_airframe
from quasi.errors import ConfigError
from quasi.pages.animation import animate
from quasi.pages.drawing import make_flown_motion, select_flown_rows
from quasi.running.job_log import LOG, job
from quasi.tables import read_json, read_table

TRAIL = 5.0  # s of the path behind the quadrotor, as in the animations of a model's flights


def main(flight: str, metadata: str, settings: dict, target: str) -> None:
    """Read the filtered flight; write its animation."""
    if settings["problem"]:
        raise ConfigError(settings["problem"])
    airframe = read_airframe(settings["quadrotor"], settings["quadrotor"]["file"], settings["mass"])
    key = settings["flight"]
    motion = make_flown_motion(select_flown_rows(read_table(flight)), read_json(metadata), airframe, key)
    Path(target).parent.mkdir(parents=True, exist_ok=True)
    count = animate([motion], target, speed_up=settings["speed up"], trail=TRAIL, title=key)
    LOG.info("%d frames", count)


if __name__ == "__main__":
    with job(snakemake.log[0], f"animation of {snakemake.wildcards.flight}"):
        main(
            snakemake.input.flight,
            snakemake.input.metadata,
            snakemake.params.settings,
            snakemake.output[0],
        )
