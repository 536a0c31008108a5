"""`quasi fly`: a configured simulation shown live, or a model flown by hand."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quasi.errors import ConfigError, ReadError, nearest
from quasi.model.model import read_model
from quasi.simulation.control.references import evaluate_reference
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
    """Show a configured simulation live with its reference; return a sentence about the flight.

    name  of config/simulations/<name>.json; None for the only one
    Raises a QuasiError where it or its model is absent, or no window can be opened.
    """
    name = name or _require_single(folder.configuration.simulations, directory / "config/simulations", "simulation")
    if name not in folder.configuration.simulations and (directory / "models" / name).exists():
        raise ConfigError(
            f"config/simulations/{name}.json does not exist, but a model '{name}' does; fly it by hand with "
            f"`quasi fly --by-hand {name}`, or add a simulation of it"
        )
    setup = _make_setup(folder.simulation(name), directory)
    session = Session(setup, by_hand=False)
    loop_parameters = setup.loop_parameters
    path = watch.sample_path(
        lambda t, setpoint: evaluate_reference(
            loop_parameters.reference, loop_parameters.path, loop_parameters.table, t, setpoint
        ),
        session.duration,
    )
    with ExitStack() as opened:
        window, keys = _open_window(setup, name, watch.REFERENCE_HELP, opened, path)
        session.advance(None, 1)  # compiles
        session.restart()
        print(watch.REFERENCE_HELP, flush=True)
        return watch.show_reference_flight(session, window, keys)


def fly_by_hand(
    name: str | None, directory: Path, folder: "Folder | None", find_model: Callable[[str, Path], Path]
) -> str:
    """Fly a model by hand until q is pressed or the window closes; return a sentence about the flight.

    name  a simulation with its model, controller, wind and faults; else a model ID or path; None for the only model
    find_model  finds the path of a model ID in a folder
    Raises a QuasiError where there is no such model or no window can be opened.
    """
    if folder is not None and name in folder.configuration.simulations:
        asked = folder.simulation(name)
        asked = {**asked, "settings": {**asked["settings"], "references": {}}, "reference": None}
        setup = _make_setup(asked, directory)
    else:
        made = sorted(p.parent.name for p in directory.glob("models/*/standalone"))
        model = read_model(find_model(name or _require_single(made, directory / "models", "model"), directory))
        setup = make_setup({**START, "model": {"model ID": model.id}}, model, name=f"flight of {model.id}")
    session = Session(setup)
    with ExitStack() as opened:
        window, keys = _open_window(setup, setup.model.id, fly.MANUAL_HELP, opened)
        session.advance(fly.Pilot(session.weight).setpoint(set(), session.dt), 1)  # compiles
        session.restart()
        print(fly.MANUAL_HELP, flush=True)
        return fly.fly_manually(session, window, keys)


def _require_single(names: list[str], where: Path, kind: str) -> str:
    if len(names) == 1:
        return names[0]
    raise ReadError(
        f"{where} holds {len(names) or 'no'} {kind}s{nearest('', names) if names else ''}; "
        + ("give its name" if names else f"make a {kind} first, or name a project folder with -d")
    )


def _make_setup(asked: dict[str, Any], directory: Path) -> Setup:
    wind, reference = (read_numbers(directory / asked[k]) if asked[k] else None for k in ("wind", "reference"))
    path = directory / asked["model"]
    if not path.exists():
        raise ReadError(f"{path} does not exist; make it with `snakemake -j2 {Path(asked['model']).parent.as_posix()}`")
    return make_setup(asked["settings"], read_model(path), wind, reference, asked["name"])


def _open_window(
    setup: Setup, name: str, text: str, opened: ExitStack, path: Any = None
) -> tuple[Window, Terminal | None]:
    """Open a window, and the keys of the terminal where one exists."""
    window = Window(setup.airframe, name, text, path=path)
    opened.callback(window.close)
    keys: Terminal | None = None
    try:
        keys = opened.enter_context(Terminal())
    except ConfigError:
        print("standard input is no terminal: press the keys in the window")
    print("compiling (half a minute the first time) ...", flush=True)
    return window, keys
