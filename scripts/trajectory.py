"""Where one flight went: its path with stills of the quadrotor, and the rows of it as a table."""

from matplotlib.backends.backend_agg import FigureCanvasAgg

from quasi.airframe import read_airframe
from quasi.errors import ConfigError
from quasi.pages.drawing import TRAJECTORY_COLUMNS, make_flown_motion, select_flown_rows, trajectories
from quasi.running.job_log import job
from quasi.tables import read_fields, read_json, read_table, replace_file, write_table


def main(flight: str, metadata: str, settings: dict, table: str, figure: str) -> None:
    """Read the filtered flight; write its trajectory as Parquet and as PNG."""
    if settings["problem"]:
        raise ConfigError(settings["problem"])
    airframe = read_airframe(settings["quadrotor"], settings["quadrotor"]["file"], settings["mass"])
    key, flying = settings["flight"], select_flown_rows(read_table(flight))
    motion = make_flown_motion(flying, read_json(metadata), airframe, key)
    drawn = trajectories([motion], stills=settings["stills"], title=key)
    with replace_file(figure) as part:
        FigureCanvasAgg(drawn).print_png(part)
    fields, kept = read_fields(flight), [c for c in TRAJECTORY_COLUMNS if c in flying]
    units = {c: tuple(fields[c].get(k, "") for k in ("unit", "frame", "meaning")) for c in kept}
    write_table(table, flying[kept], units)


if __name__ == "__main__":
    with job(snakemake.log[0], f"trajectory of {snakemake.wildcards.flight}"):
        main(
            snakemake.input.flight,
            snakemake.input.metadata,
            snakemake.params.settings,
            snakemake.output.table,
            snakemake.output.figure,
        )
