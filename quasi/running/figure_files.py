"""Write many figures as PNG files, on more than one core where a job has more."""

import multiprocessing
import signal
from collections.abc import Callable, Mapping
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from quasi.running.job_log import show_progress
from quasi.tables import replace_file


def write_figures(
    drawings: Mapping[str, Figure | Callable[[], Figure | None]], folder: str | Path, processes: int = 1
) -> None:
    """Write figures as {name}.png; one that turns out to be None is left out.

    drawings  {name: figure, or what draws it}; processes  how many work at once, one where the system cannot fork
    What a drawing raises is raised here.
    """
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)

    def write(names: list[str]) -> None:
        for name in show_progress(names, "drawing"):
            figure = drawings[name]
            figure = figure if isinstance(figure, Figure) else figure()
            if figure is not None:
                with replace_file(target / f"{name}.png") as part:
                    FigureCanvasAgg(figure).print_png(part)

    def write_others(names: list[str]) -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # the job itself reports that it was interrupted
        write(names)

    if "fork" not in multiprocessing.get_all_start_methods():
        processes = 1
    own, *others = [list(drawings)[first::processes] for first in range(processes)]
    context = multiprocessing.get_context("fork" if others else None)
    helpers = [context.Process(target=write_others, args=(names,)) for names in others]
    for helper in helpers:
        helper.start()
    write(own)
    for helper, names in zip(helpers, others):
        helper.join()
        if helper.exitcode:  # what went wrong there goes wrong here as well, where it can be reported
            write(names)
