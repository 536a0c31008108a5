"""The `quasi` command: what a model holds, a project folder of one's own, the noise of sensors at rest."""

import argparse
import shutil
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from quasi.errors import QuasiError

LIBRARY = Path(__file__).parent.parent
TEMPLATE = LIBRARY / "config" / "template"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="quasi",
        description="From a logbook of quadrotor flights to aerodynamic models. "
        "The main job itself is run by Snakemake: snakemake -j2 models/MODEL/standalone",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    summary = commands.add_parser("summary", help="print a model: its terms, coefficients, standard errors and scores")
    summary.add_argument("model", help="model ID, or the path of a standalone model")
    summary.add_argument("-d", "--directory", default=".", help="project folder (default: here)")

    fly = commands.add_parser(
        "fly",
        help="fly a model by hand, in a live view",
        description="w a s d fly, arrows turn and change height, q or closing the window ends. Keys work in the "
        "terminal and in the window.",
    )
    fly.add_argument("model", nargs="?", help="model ID, or the path of a standalone model; the only one if left out")
    fly.add_argument("-d", "--directory", default=".", help="project folder (default: here)")
    fly.add_argument("--simulation", help="controller, wind and so on as in config/simulations/SIMULATION.json")

    init = commands.add_parser("init", help="lay a project folder: commented configuration and an empty logbook")
    init.add_argument("folder", help="folder to make; it must be empty or absent")

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

    options = parser.parse_args(arguments)
    if arguments is None and hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `quasi summary M | head` ends silently, as other commands do
    try:
        if options.command == "summary":
            print(summarise(options.model, Path(options.directory)))
        elif options.command == "fly":
            print(fly_by_hand(options.model, Path(options.directory), options.simulation))
        elif options.command == "noise":
            logs = [Path(log) for log in options.logs]
            names = (options.cut, options.rigid_body, options.log_number, options.write)
            print(noise_at_rest(Path(options.quadrotor), logs, *names))
        else:
            print(lay(Path(options.folder)))
    except QuasiError as error:
        print(f"[ERROR] {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"[ERROR] {error.filename}: {error.strerror}; name another folder or correct it", file=sys.stderr)
        return 1
    return 0


def summarise(model: str, directory: Path) -> str:
    """The summary of a model given by ID or path, with its scores when they stand beside it."""
    from quasi.standalone.model import read_model
    from quasi.tables import read_text

    path = model_place(model, directory)
    text = read_model(path).summary()
    scores = (path if path.is_dir() else path.parent) / "summary.txt"
    if scores.is_file():
        text += "\n\n" + read_text(scores).rstrip()
    return text


def model_place(model: str, directory: Path) -> Path:
    """Where a model given by ID or path is. Raises ReadError when it is nowhere."""
    from quasi.errors import ReadError, nearest

    named = directory / "models" / model / "standalone"
    path = named if named.is_dir() else directory / model
    if not path.exists():
        made = [p.parent.name for p in directory.glob("models/*/standalone")]
        raise ReadError(
            f"no model '{model}': neither {named} nor {directory / model} exists{nearest(model, made)}; "
            f"make it with `snakemake -j2 models/{model}/standalone`"
        )
    return path


def fly_by_hand(model: str | None, directory: Path, simulation: str | None = None) -> str:
    """Fly a model by hand until q is pressed or the window closes; returns a sentence on the flight.

    model  ID or path; None for that of the simulation, or the only one there is
    Raises a QuasiError where there is no such model or no window can be opened.
    """
    from contextlib import ExitStack

    from quasi.errors import ConfigError, ReadError, nearest
    from quasi.simulation import fly
    from quasi.simulation.keyboard import Terminal
    from quasi.simulation.run import Session
    from quasi.simulation.setup import make_setup
    from quasi.simulation.window import Window
    from quasi.standalone.model import read_model
    from quasi.tables import read_numbers
    from quasi.workflow import Folder

    wind, settings = None, {"initial state conditions": {"position": [0, 0, -1.5]}}
    if simulation is not None:
        asked = Folder(directory).simulation(simulation)
        settings = asked["settings"] | {"references": {}}  # the keys take its place
        wind = read_numbers(directory / asked["wind"]) if asked["wind"] else None
        model = model or asked["model"]
    if model is None:
        made = sorted(p.parent.name for p in directory.glob("models/*/standalone"))
        if len(made) != 1:
            raise ReadError(
                f"{directory / 'models'} holds {len(made) or 'no'} models{nearest('', made) if made else ''}; "
                + ("name the one to fly" if made else "make one first, or name a project folder with -d")
            )
        model = made[0]
    flown = read_model(model_place(model, directory))
    settings["model"] = {**settings.get("model", {}), "model ID": flown.id}
    session = Session(make_setup(settings, flown, wind, name=simulation or f"flight of {flown.id}"))
    with ExitStack() as open_things:
        window = Window(flown.airframe, flown.id, fly.HELP)
        open_things.callback(window.close)
        keys: fly.Keys | None = None
        try:
            keys = open_things.enter_context(Terminal())
        except ConfigError:
            print("standard input is no terminal: press the keys in the window")
        print("getting ready (half a minute the first time) ...", flush=True)
        session.advance(fly.Pilot(session.weight).goal(set(), session.dt), 1)
        session.restart()
        print(fly.HELP, flush=True)
        return fly.fly(session, window, keys)


def lay(folder: Path) -> str:
    """Lay a project folder; returns what to do next. Raises ConfigError when the folder holds something."""
    from quasi.errors import ConfigError

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError(f"{folder} already holds something; name a new or an empty folder")
    shutil.copytree(TEMPLATE, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns(".gitkeep"))
    beside = Path(sys.executable).parent / "snakemake"
    snakemake = beside if beside.exists() and not shutil.which("snakemake") else "snakemake"
    return (
        f"Made {folder}:\n"
        f"  data/logbook.csv                 one row per flight; fill it in\n"
        f"  data/my_quadrotor.json           geometry, mass, inertia of your quadrotor\n"
        f"  config/processing.json           how flights are imported and filtered\n"
        f"  config/models/my_model.json      which flights make the model, which are held out\n"
        f"Then:  {snakemake} -s {LIBRARY / 'Snakefile'} -d {folder} -j2 models/my_model/standalone"
    )


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

    from quasi.configuration import check, read, with_section
    from quasi.filtering.noise_statistics import ANGLES, RestLog, noise_statistics, section
    from quasi.importing.rest import read_rest
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
