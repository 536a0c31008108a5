"""`quasi fly`: a configured simulation shown live, or a model flown by hand."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quasi.errors import ConfigError, ReadError, nearest
from quasi.model.model import read_model
from quasi.simulation.control.references import goal_at
from quasi.simulation.loop.run import Session
from quasi.simulation.loop.setup import Setup, make_setup
from quasi.simulation.tools import manual_flight as fly
from quasi.simulation.tools import reference_flight as watch
from quasi.simulation.tools.keyboard import Terminal
from quasi.simulation.tools.window import Window
from quasi.tables import read_numbers

if TYPE_CHECKING:
    from quasi.project.workflow import Folder

START = {"initial state conditions": {"position": [0, 0, -1.5]}}  # of a model without a simulation, m, z down


def fly_simulation(name: str | None, directory: Path, folder: "Folder") -> str:
    """Show a configured simulation live, with its reference; returns a sentence on the flight.

    name  of config/simulations/<name>.json; None for the only one there is
    Raises a QuasiError where it or its model is absent, or no window can be opened.
    """
    name = name or _only(folder.simulations, directory / "config/simulations", "simulation")
    if name not in folder.simulations and (directory / "models" / name).exists():
        raise ConfigError(
            f"config/simulations/{name}.json does not exist, but a model '{name}' does; fly it by hand with "
            f"`quasi fly --by-hand {name}`, or lay a simulation of it"
        )
    setup = _setup_of(folder.simulation(name), directory)
    session = Session(setup, by_hand=False)
    machine = setup.machine
    path = watch.path_of(
        lambda t, goal: goal_at(machine.reference, machine.path, machine.table, t, goal), session.duration
    )
    with ExitStack() as opened:
        window, keys = _open(setup, name, watch.HELP, opened, path)
        session.advance(None, 1)  # compiles
        session.restart()
        print(watch.HELP, flush=True)
        return watch.watch(session, window, keys)


def fly_by_hand(
    name: str | None, directory: Path, folder: "Folder | None", find_model: Callable[[str, Path], Path]
) -> str:
    """Fly a model by hand until q is pressed or the window closes; returns a sentence on the flight.

    name  a simulation, whose model, controller, wind and faults are taken; else model ID or path; None for the only
          model there is
    find_model  where the model of an ID or path is in a folder
    Raises a QuasiError where there is no such model or no window can be opened.
    """
    if folder is not None and name in folder.simulations:
        asked = folder.simulation(name)
        asked = {**asked, "settings": {**asked["settings"], "references": {}}, "reference": None}
        setup = _setup_of(asked, directory)
    else:
        made = sorted(p.parent.name for p in directory.glob("models/*/standalone"))
        model = read_model(find_model(name or _only(made, directory / "models", "model"), directory))
        setup = make_setup({**START, "model": {"model ID": model.id}}, model, name=f"flight of {model.id}")
    session = Session(setup)
    with ExitStack() as opened:
        window, keys = _open(setup, setup.model.id, fly.HELP, opened)
        session.advance(fly.Pilot(session.weight).goal(set(), session.dt), 1)  # compiles
        session.restart()
        print(fly.HELP, flush=True)
        return fly.fly(session, window, keys)


def _only(names: list[str], where: Path, kind: str) -> str:
    if len(names) == 1:
        return names[0]
    raise ReadError(
        f"{where} holds {len(names) or 'no'} {kind}s{nearest('', names) if names else ''}; "
        + ("name the one to fly" if names else f"make a {kind} first, or name a project folder with -d")
    )


def _setup_of(asked: dict[str, Any], directory: Path) -> Setup:
    wind, reference = (read_numbers(directory / asked[k]) if asked[k] else None for k in ("wind", "reference"))
    path = directory / asked["model"]
    if not path.exists():
        raise ReadError(f"{path} does not exist; make it with `snakemake -j2 {Path(asked['model']).parent.as_posix()}`")
    return make_setup(asked["settings"], read_model(path), wind, reference, asked["name"])


def _open(setup: Setup, name: str, text: str, opened: ExitStack, path: Any = None) -> tuple[Window, fly.Keys | None]:
    """A window, and the keys of the terminal where there is one."""
    window = Window(setup.airframe, name, text, path=path)
    opened.callback(window.close)
    keys: fly.Keys | None = None
    try:
        keys = opened.enter_context(Terminal())
    except ConfigError:
        print("standard input is no terminal: press the keys in the window")
    print("compiling (half a minute the first time) ...", flush=True)
    return window, keys
