"""Commands about simulations: fly, where a quadrotor can be, margins of a controller, a system of one's own."""

import argparse
from pathlib import Path

from quasi.commands.folder import LIBRARY, folder_of
from quasi.errors import QuasiError
from quasi.project.model_files import model_place
from quasi.project.templates import new_simulation


def add_simulation_commands(commands: argparse._SubParsersAction, place: argparse.ArgumentParser) -> None:
    """Add `fly`, `reach`, `new-simulation` and `margins`. place  parser of --directory"""
    fly = commands.add_parser(
        "fly",
        parents=[place],
        help="show a configured simulation live, or fly its model by hand",
        description="Shows config/simulations/NAME.json in real time with its reference. With --by-hand: w a s d fly, "
        "arrows turn and change height. q or closing the window ends. Keys work in the terminal and in the window.",
    )
    fly.add_argument(
        "name",
        nargs="?",
        help="simulation; with --by-hand also a model ID, or the path of a standalone model; the only one if left out",
    )
    fly.add_argument("--by-hand", action="store_true", help="the keys take the place of the reference")
    fly.set_defaults(run=lambda o: fly_live(o.name, Path(o.directory), o.by_hand))

    find_reachable = commands.add_parser(
        "reach",
        parents=[place],
        help="where a quadrotor can be after a while",
        description="Flies from the start of config/simulations/SIMULATION.json to targets on a sphere about it, "
        "all at once, and writes results/reach/SIMULATION: positions, extremes, and a figure of the hull.",
    )
    find_reachable.add_argument("simulation", help="name of the simulation; its reference and duration do not count")
    find_reachable.add_argument("--horizon", type=float, default=1.0, help="s (default 1)")
    find_reachable.add_argument("--radius", type=float, default=4.0, help="of the sphere of targets, m (default 4)")
    find_reachable.add_argument(
        "--spacing", type=float, default=20.0, help="angle between targets, degrees (default 20)"
    )
    find_reachable.set_defaults(run=lambda o: reach_of(o.simulation, Path(o.directory), o.horizon, o.radius, o.spacing))

    fresh = commands.add_parser(
        "new-simulation",
        help="lay a simulation of a system of your own: a runnable Python file and its settings",
        description="Writes NAME/NAME.py and NAME/NAME.json: a mass on a spring, to be replaced part by part.",
    )
    fresh.add_argument("name", help="name of the simulation")
    fresh.add_argument("-d", "--directory", default=".", help="folder in which NAME is made (default: here)")
    fresh.set_defaults(run=lambda o: new_simulation(o.name, Path(o.directory), LIBRARY))

    margins = commands.add_parser(
        "margins",
        parents=[place],
        help="gains and stability margins of a simulation's controller, and gains for Betaflight and PX4",
        description="The gains in force, which may be copied into config/simulations/SIMULATION.json and changed, and "
        "how much gain, phase and delay the loop about hover can bear in each direction.",
    )
    margins.add_argument("simulation", help="name of the simulation")
    margins.set_defaults(run=lambda o: margins_of(o.simulation, Path(o.directory)))


def fly_live(name: str | None, directory: Path, by_hand: bool) -> str:
    """Show a simulation live, or fly a model by hand; see `quasi.simulation.tools.fly_command`."""
    from quasi.project.folder import check_project
    from quasi.simulation.tools.fly_command import fly_by_hand, fly_simulation

    if not by_hand:
        check_project(directory)
        return fly_simulation(name, directory, folder_of(directory))
    folder = folder_of(directory) if (directory / "config/simulations").is_dir() else None
    return fly_by_hand(name, directory, folder, model_place)


def margins_of(simulation: str, directory: Path) -> str:
    """Gains and margins of a simulation's controller as text. Raises a QuasiError where it or its model are absent."""
    from quasi.model.model import read_model
    from quasi.project.folder import check_project
    from quasi.simulation.loop.setup import make_setup
    from quasi.simulation.tools.firmware_gains import gains_of_setup
    from quasi.simulation.tools.margins import describe_margins
    from quasi.tables import read_numbers

    check_project(directory)
    asked = folder_of(directory).simulation(simulation)
    wind, reference = (read_numbers(directory / asked[k]) if asked[k] else None for k in ("wind", "reference"))
    model = read_model(model_place(asked["model"], directory))
    setup = make_setup(asked["settings"], model, wind, reference, simulation)
    text = describe_margins(setup)
    try:
        return f"{text}\n\n{gains_of_setup(setup)}"
    except QuasiError as reason:  # the margins hold without the table
        return f"{text}\n\ngains for flight controllers are left out: {reason}"


def reach_of(simulation: str, directory: Path, horizon: float, radius: float, spacing: float) -> str:
    """Write where a simulation's quadrotor can be after the horizon, s; returns what was found in a sentence.

    radius m and spacing deg of the targets. Raises a QuasiError where simulation or model are absent or cannot fly.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from quasi.model.model import read_model
    from quasi.project.folder import check_project
    from quasi.simulation.tools.reach import REACH_UNITS, find_reachable
    from quasi.simulation.tools.reach_figure import draw_reach
    from quasi.tables import read_numbers, replace_file, write_json, write_table

    check_project(directory)
    asked = folder_of(directory).simulation(simulation)
    wind = read_numbers(directory / asked["wind"]) if asked["wind"] else None
    model = read_model(model_place(asked["model"], directory))
    found = find_reachable(asked["settings"], model, horizon, radius, spacing, wind, simulation)
    folder, summary = directory / "results/reach" / simulation, found.summary()
    write_table(folder / "positions.parquet", found.table(), REACH_UNITS, {"simulation": simulation, "model": model.id})
    write_json(folder / "summary.json", summary)
    with replace_file(folder / "reach.png") as part:
        FigureCanvasAgg(draw_reach(found)).print_png(part)
    ends = summary["at the horizon"]["extremes"] if summary["at the horizon"] else {}
    spans = ", ".join(f"{a} {ends[a]['min']:.2f} to {ends[a]['max']:.2f} m" for a in ends)
    lost = f"; {len(found.ended)} of {len(found.targets)} simulations did not last" if found.ended else ""
    return f"After {horizon:g} s: {spans}{lost}. Made {folder}: positions.parquet, summary.json, reach.png"
