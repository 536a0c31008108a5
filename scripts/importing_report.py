"""The page of one flight, and its figures as files: what was read, lost, tied and estimated; can it be trusted?"""

from io import BytesIO
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from quasi.filtering.figures import figures
from quasi.importing.figures import alignment_figure, close_up, trajectory_figure
from quasi.pages.flight import compute_saturation, derive_flight_verdict, render_flight_page
from quasi.pages.gyro_spectrum import draw_gyro_spectrum
from quasi.running.job_log import job
from quasi.tables import read_json, read_table, write_bytes, write_json, write_text

# figure: heading, caption; in the order of the page
PICTURES = {
    "alignment": (
        "Alignment",
        "On board against captured: attitude, body rates, accelerations along earth axes with gravity removed. ± is "
        "one standard error.",
    ),
    "alignment_close_up": (
        "Alignment before and after",
        "The liveliest seconds. Before: both records laid side by side from their beginnings.",
    ),
    "trajectory": ("Trajectory", "Where the flight went, coloured by time."),
    "attitude": ("Attitude", "Imported and filtered."),
    "velocity": ("Velocity", "Body axes, over ground, imported and filtered."),
    "position": ("Position", "Imported and filtered; the band is two standard errors to either side."),
    "forces": ("Forces", "Body axes; grey where rows are on the ground, lost or unsure."),
    "moments": ("Moments", "Body axes, about the centre of gravity."),
    "gyro_bias": ("Gyro bias", "How the filter learnt it, with its bounds; red what was taken off."),
    "accelerometer_bias": ("Accelerometer bias", "How the filter learnt it, with its bounds; red what was taken off."),
    "vibration": (
        "Vibration",
        "Spectra in flight before and after the filters that everything goes through, and where the rotors' first "
        "harmonics stand at the log's rate (the middle 80 % of the flight).",
    ),
}
TRACED = ("trajectory", "attitude", "velocity", "forces", "moments")  # shown by the traces of the page
SPECTRUM = (
    "Power spectral density of the gyro in flight, against what the horizontal axis names. Bright level lines are "
    "resonances. Dashed lines, where rotor speeds were logged, are the rotors' first two harmonics."
)


def main(source: dict[str, str], target: str, folder: str) -> None:
    """Read the imported and filtered flight, draw it, write the page and each figure as PNG."""
    imported, about = read_table(source["flight"]), read_json(source["metadata"])
    filtered, filtered_about = read_table(source["filtered"]), read_json(source["filtered_metadata"])
    course = read_table(source["convergence"])
    drawn = {
        "alignment": alignment_figure(imported, about),
        "alignment_close_up": close_up(imported, about),
        "trajectory": trajectory_figure(imported, about),
        **figures(imported, filtered, filtered_about, course if len(course) else None),
    }
    pictures = {}
    for name, (heading, caption) in PICTURES.items():
        if drawn.get(name) is None:
            continue
        png = draw_png(drawn[name], Path(folder) / f"{name}.png")
        if name not in TRACED:
            pictures[heading] = (png, caption)
    flying = filtered["in_flight"].to_numpy() > 0
    spectrum = None
    if (figure := draw_gyro_spectrum(imported, flying)) is not None:
        spectrum = (draw_png(figure, Path(folder) / "gyro_spectrum.png"), SPECTRUM)
    word, because = derive_flight_verdict(about, filtered_about, compute_saturation(imported, flying))
    write_json(Path(folder) / "verdict.json", {"verdict": word, "because": because})
    write_text(target, render_flight_page(imported, about, filtered, filtered_about, pictures, spectrum))


def draw_png(figure: Figure, path: Path) -> bytes:
    """Draw a figure, write it, and return it as PNG."""
    png = BytesIO()
    FigureCanvasAgg(figure).print_png(png)
    write_bytes(path, png.getvalue())
    return png.getvalue()


if __name__ == "__main__":
    with job(snakemake.log[0], f"page of {snakemake.wildcards.flight}", snakemake.output.page):
        main(dict(snakemake.input.items()), snakemake.output.page, snakemake.output.figures)
