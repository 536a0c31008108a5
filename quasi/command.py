"""The `quasi` command: what a model holds, a project folder of one's own, the noise of sensors at rest."""

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from quasi.commands.standalone import add_standalone_commands
from quasi.errors import QuasiError, nearest
from quasi.project.model_files import model_place
from quasi.project.templates import lay_folder, new_simulation

if TYPE_CHECKING:
    from quasi.gap.effect import Vehicle
    from quasi.project.workflow import Folder

LIBRARY = Path(__file__).parent.parent


def _parser() -> argparse.ArgumentParser:
    """The command line: each command says in `run` what it does with its options, and returns what is printed."""
    parser = argparse.ArgumentParser(
        prog="quasi",
        description="From a logbook of quadrotor flights to aerodynamic models. "
        "The main job itself is run by Snakemake: snakemake -j2 models/MODEL/standalone",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    place = argparse.ArgumentParser(add_help=False)
    place.add_argument("-d", "--directory", default=".", help="project folder (default: here)")

    summary = commands.add_parser(
        "summary", parents=[place], help="print a model: its terms, coefficients, standard errors and scores"
    )
    summary.add_argument("model", help="model ID, or the path of a standalone model")
    summary.set_defaults(run=lambda o: summarise(o.model, Path(o.directory)))

    fly = commands.add_parser(
        "fly",
        parents=[place],
        help="show a configured simulation live, or fly its model by hand",
        description="Shows config/simulations/NAME.json in real time with its reference. With --by-hand: w a s d fly, "
        "arrows turn and change height. q or closing the window ends. Keys work in the "
        "terminal and in the window.",
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

    add_standalone_commands(commands, place)

    margins = commands.add_parser(
        "margins",
        parents=[place],
        help="gains and stability margins of a simulation's controller, and gains for Betaflight and PX4",
        description="The gains in force, which may be copied into config/simulations/SIMULATION.json and changed, and "
        "how much gain, phase and delay the loop about hover can bear in each direction.",
    )
    margins.add_argument("simulation", help="name of the simulation")
    margins.set_defaults(run=lambda o: margins_of(o.simulation, Path(o.directory)))

    plan = commands.add_parser(
        "plan",
        parents=[place],
        help="which causes of disagreement a trajectory could reveal, and which manoeuvres are missing",
        description="For every cause in the catalogue, at its typical size: the expected t after all that could "
        "stand in for it, what it would be confused with, and the manoeuvres that would show more.",
    )
    plan.add_argument("model", help="model ID, or the path of a standalone model")
    described = "filtered flight, simulation, or table of t x y z yaw (s, m, z down, rad); several are flown in turn"
    plan.add_argument("trajectories", nargs="+", metavar="TRAJECTORY", help=described)
    plan.add_argument("--flights", type=int, default=4, help="flights to compare (4)")
    plan.add_argument(
        "--references", type=int, default=0, help="further reference flights, believed free of faults (0)"
    )
    plan.add_argument("--gap", help="take the noise, the room and further causes from this gap")
    plan.add_argument("--out", help="folder for the card: plan.json and plan.html")
    plan.set_defaults(
        run=lambda o: plan_of(o.model, o.trajectories, Path(o.directory), o.flights, o.references, o.gap, o.out)
    )

    causes = commands.add_parser(
        "causes",
        parents=[place],
        help="the catalogue of causes that a gap can name, with sizes typical of a model's vehicle",
    )
    causes.add_argument("model", nargs="?", help="model ID, or the path of a standalone model (the made vehicle)")
    causes.add_argument("--gap", help="with the causes of your own that this gap has")
    causes.set_defaults(run=lambda o: causes_of(o.model, Path(o.directory), o.gap).removesuffix("\n"))

    check = commands.add_parser(
        "check",
        help="open every raw file that a project folder names: what is there, what is missing, what it is good for",
        description="Reads configuration and raw files; nothing is synchronised or filtered. The exit code is 1 where "
        "something is broken.",
    )
    check.add_argument("folder", nargs="?", default=".", help="project folder (default: here)")
    check.add_argument("--data", metavar="PATH", help="where data/ is, as `--config data=PATH` of snakemake")
    check.set_defaults(run=lambda o: check_raw_files(Path(o.folder), o.data))

    init = commands.add_parser("init", help="lay a project folder: commented configuration and a logbook")
    init.add_argument("folder", help="folder to make; it must be empty or absent")
    init.add_argument("--from", dest="log", metavar="LOG", help="write what this log says of vehicle and columns")
    init.add_argument("--capture", help="export of the motion capture of the same flight")
    init.set_defaults(run=init_folder)

    decode = commands.add_parser(
        "decode",
        help="write any log or capture that quasi reads in SI units, as Parquet, CSV or MCAP",
        description="Each quantity at its own samples, without interpolation. Columns of a table are guessed, or "
        "taken from the 'table columns' of --quadrotor.",
    )
    decode.add_argument("log", help="log or capture")
    decode.add_argument("-o", "--out", metavar="FILE", help="out.parquet, out.csv or out.mcap (default: LOG.parquet)")
    decode.add_argument("--quadrotor", metavar="JSON", help="quadrotor configuration")
    decode.add_argument("--rigid-body", help="name of the vehicle in a capture (its only one)")
    decode.add_argument("--log-number", type=int, help="which log of a file that holds several")
    decode.add_argument("--flight-controller", help="read it as of this one (default: what the file holds)")
    decode.set_defaults(run=decode_log)

    noise = commands.add_parser(
        "noise",
        help="noise of gyro and accelerometer from logs of a quadrotor at rest",
        description="Mean and standard deviation of p q r ax ay az (and roll pitch yaw, where logged or captured), "
        "pooled over logs of a quadrotor that stands still, best armed with idling rotors.",
    )
    noise.add_argument("quadrotor", help="quadrotor configuration, JSON")
    noise.add_argument("logs", nargs="+", metavar="LOG", help="rest log, or motion-capture export of a rest")
    noise.add_argument("--cut", type=float, default=0.1, help="share of a log left out at either end (0.1)")
    noise.add_argument("--rigid-body", help="name of the rigid body in motion-capture exports")
    noise.add_argument("--log-number", type=int, help="which log of a file that holds several")
    noise.add_argument("--write", action="store_true", help="write the statistics into the quadrotor configuration")
    noise.set_defaults(
        run=lambda o: noise_at_rest(
            Path(o.quadrotor), [Path(log) for log in o.logs], o.cut, o.rigid_body, o.log_number, o.write
        )
    )

    published = commands.add_parser(
        "import-model",
        parents=[place],
        help="make a model from a JSON file that QuaSI published",
        description="Writes models/NAME/standalone/model.json. Nothing from the file is run.",
    )
    published.add_argument("file", help="JSON file of the published model")
    published.add_argument("name", help="model ID that it gets")
    published.add_argument("--motor-poles", type=int, help="magnets of its motors, which the file does not state (14)")
    published.set_defaults(run=lambda o: import_model(Path(o.file), o.name, Path(o.directory), o.motor_poles))
    parser.set_defaults(commands=list(commands.choices))
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser, given = _parser(), list(sys.argv[1:] if arguments is None else arguments)
    if not given:
        parser.print_help()
        return 0
    known = parser.get_default("commands")
    if not given[0].startswith("-") and given[0] not in known:
        print(
            f"[ERROR] quasi has no command '{given[0]}'{nearest(given[0], known)}; see `quasi --help`", file=sys.stderr
        )
        return 2
    options = parser.parse_args(given)
    if arguments is None and hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `quasi summary M | head` ends silently, as other commands do
    try:
        answer = options.run(options)
        text, code = answer if isinstance(answer, tuple) else (answer, 0)
        print(text)
    except QuasiError as error:
        print(f"[ERROR] {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"[ERROR] {error.filename}: {error.strerror}; name another folder or correct it", file=sys.stderr)
        return 1
    return code


def init_folder(options: argparse.Namespace) -> str:
    """Lay a project folder, empty or for a first log."""
    folder = Path(options.folder)
    if options.log is None and options.capture is None:
        return lay_folder(folder, LIBRARY)
    from quasi.errors import ConfigError
    from quasi.importing.first_configuration import lay_folder_from

    if options.log is None:
        raise ConfigError("--capture needs the log of the same flight; add --from LOG")
    return lay_folder_from(folder, LIBRARY, Path(options.log), Path(options.capture) if options.capture else None)


def decode_log(options: argparse.Namespace) -> str:
    """Write a log in SI units; see `quasi.importing.decode`."""
    from quasi.importing.decode import decode_file
    from quasi.tables import read_json

    return decode_file(
        Path(options.log), Path(options.out) if options.out else None,
        read_json(options.quadrotor) if options.quadrotor else None,
        options.rigid_body, options.log_number, options.flight_controller,
    )  # fmt: skip


def check_raw_files(directory: Path, data: str | None) -> tuple[str, int]:
    """What a project folder's raw files hold, and the exit code; see `quasi.importing.check`."""
    from quasi.importing.check import check_folder

    return check_folder(directory, LIBRARY, data)


def summarise(model: str, directory: Path) -> str:
    """The summary of a model given by ID or path, with its scores where they exist."""
    from quasi.model.model import read_model
    from quasi.tables import read_text

    path = model_place(model, directory)
    text = read_model(path).summary()
    scores = (path if path.is_dir() else path.parent) / "summary.txt"
    if scores.is_file():
        text += "\n\n" + read_text(scores).rstrip()
    return text


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


def plan_of(
    model: str,
    trajectories: Sequence[str],
    directory: Path,
    flights: int = 4,
    references: int = 0,
    gap: str | None = None,
    out: str | None = None,
) -> str:
    """The flight card as text, and in the folder `out` as plan.json and plan.html.

    Raises a QuasiError where model, trajectory or gap are absent, or the vehicle cannot fly the trajectory.
    """
    import os

    os.environ.setdefault("OMP_NUM_THREADS", "1")  # many small matrices: threads would only wait for each other

    from quasi.gap.catalogue import catalogue, chosen
    from quasi.gap.effect import room_of
    from quasi.gap.planning import flight_card
    from quasi.gap.planning.plan import examine
    from quasi.gap.planning.plan_input import flights_of, noise_of
    from quasi.model.model import read_model
    from quasi.tables import write_json, write_text

    used = read_model(model_place(model, directory))
    flown, about = flights_of(trajectories, used, directory)
    effects, noise, room, rate = catalogue(), None, None, 0.01
    if gap is not None:
        asked = folder_of(directory).gap(gap)
        settings = asked["settings"]
        effects = chosen(settings["effects"], catalogue(directory / p for p in asked["effect files"]), asked["file"])
        room, rate, noise = room_of(settings["room"]), settings["false alarm rate"], noise_of(gap, directory)
    card = examine(flown, used, effects, flights, references, rate, noise, metadata=about, room=room)
    text = flight_card.text(card)
    if out is not None:
        folder = directory / out
        write_json(folder / "plan.json", flight_card.data(card))
        write_text(folder / "plan.html", flight_card.page(card))
        text += f"\n\nMade {folder}: plan.json, plan.html"
    return text


def folder_of(directory: Path) -> "Folder":
    """The project folder as Snakemake sees it: raw data lies where config/config.yaml says."""
    from quasi.project.folder import read_settings
    from quasi.project.workflow import Folder

    return Folder(directory, data=read_settings(directory / "config/config.yaml").get("data"))


def causes_of(model: str | None, directory: Path, gap: str | None = None) -> str:
    """The catalogue of causes in Markdown; sizes are typical of the model's vehicle, or of made flights' without one.

    Raises a QuasiError where model or gap are absent.
    """
    from quasi.gap import causes_page
    from quasi.gap.catalogue import catalogue
    from quasi.gap.effect import vehicle_of
    from quasi.model.model import read_model

    files = folder_of(directory).gap(gap)["effect files"] if gap is not None else []
    effects = catalogue(directory / p for p in files)
    if model is None:
        return causes_page.text(effects, made_vehicle(), "the 0.43 kg vehicle of made flights")
    used = read_model(model_place(model, directory))
    return causes_page.text(effects, vehicle_of(used), f"model {used.id}")


def made_vehicle() -> "Vehicle":
    """The vehicle of made flights, as far as typical sizes of causes need it."""
    import numpy as np

    from quasi.attitude import GRAVITY
    from quasi.gap.effect import Vehicle
    from quasi.synthesis.vehicle import base_vehicle, hover_factors

    p = base_vehicle().physics
    factors = hover_factors(p)
    induced = float(np.sqrt(p.mass * GRAVITY / (8.0 * np.pi * p.density * p.radius**2)))  # momentum theory, hover
    return Vehicle(p.hubs, p.spin, p.radius, factors["thrust"], factors["torque"], p.mass, p.inertia, induced, 0.0, 0.0)


def import_model(file: Path, name: str, directory: Path, poles: int | None = None) -> str:
    """Write a published model as models/NAME/standalone/model.json; returns what was made and what to know.

    Raises a QuasiError for a file that is no such model, for a name that cannot be or that is taken.
    """
    from quasi.errors import ConfigError
    from quasi.model.published import read_published
    from quasi.tables import write_json

    model = read_published(file, name, poles)
    folder = directory / "models" / name / "standalone"
    configured = directory / "config" / "models" / f"{name}.json"
    for taken in (folder, configured):
        if taken.exists():
            raise ConfigError(f"{taken} exists already; choose another name than '{name}'")
    write_json(folder / "model.json", model.document)
    made = f"Made {folder / 'model.json'}: {', '.join(model.axes)}, forces {model.gravity}"
    return "\n".join([made, *(f"note: {note}" for note in model.document["notes"])])


def noise_at_rest(
    quadrotor: Path,
    logs: Sequence[Path],
    cut: float = 0.1,
    rigid_body: str | None = None,
    log_number: int | None = None,
    write: bool = False,
) -> str:
    """Noise statistics of rest logs as a table; with `write` they go into the quadrotor configuration as well.

    Raises a QuasiError for a log that cannot be read or moves; the configuration is then left as it was.
    """
    import json

    from quasi.filtering.noise_statistics import ANGLES, RestLog, noise_statistics, section
    from quasi.importing.rest import read_rest
    from quasi.project.configuration import check, read, with_section
    from quasi.tables import read_bytes, write_bytes

    configuration, _ = read(quadrotor, "quadrotor")
    rests = {str(path): read_rest(path, configuration, rigid_body, log_number) for path in logs}
    notes = [note for rest in rests.values() for note in rest.notes]
    # a log's own attitude is what its noise is needed for; a capture's stands in where there is none
    if any({"p", "roll"} <= set(rest.columns) for rest in rests.values()):
        for name in [name for name, rest in rests.items() if set(rest.columns) == set(ANGLES)]:
            notes.append(f"{name}: not used, the logs hold an attitude of their own")
            del rests[name]
    found = noise_statistics(
        [RestLog(name, rest.t, rest.columns, rest.speeds, rest.step) for name, rest in rests.items()], cut
    )
    lines = [f"{'':6}{'standard deviation':>20}{'mean':>14}{'samples':>10}"]
    for name, entry in found.values.items():
        unit = "rad/s" if name in "pqr" else "rad" if name in ANGLES else "m/s2"
        lines.append(f"{name:6}{entry['std']:>14.5g} {unit:<5}{entry['mean']:>14.4g}{found.samples[name]:>10}")
    lines += [f"{seconds:.1f} s of {name}" for name, seconds in found.seconds.items()]
    lines += [f"note: {note}" for note in [*notes, *found.notes]]
    if not write:
        return "\n".join([*lines, f"{quadrotor} is unchanged; --write writes them there"])
    data = bytes(read_bytes(quadrotor))
    try:
        text, encoding = data.decode("utf-8"), "utf-8"
    except UnicodeDecodeError:
        text, encoding = data.decode("latin-1"), "latin-1"
    text = with_section(text, "(estimated) imu sensor noise statistics", section(found))
    check(json.loads(text.removeprefix("\ufeff")), "quadrotor", str(quadrotor))
    write_bytes(quadrotor, text.encode(encoding))
    return "\n".join([*lines, f"wrote them into {quadrotor}"])


if __name__ == "__main__":
    raise SystemExit(main())
