"""Commands about models: summary, constants, comparison, causes, flight cards, published models."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quasi.commands.folder import folder_of
from quasi.errors import ConfigError, QuasiError
from quasi.project.model_files import model_place

if TYPE_CHECKING:
    from quasi.gap.effect import Vehicle


def add_model_commands(commands: argparse._SubParsersAction, place: argparse.ArgumentParser) -> None:
    """Add `summary`, `constants`, `compare`, `plan`, `causes` and `import-model`. place  parser of --directory"""
    summary = commands.add_parser(
        "summary", parents=[place], help="print a model: its terms, coefficients, standard errors and scores"
    )
    summary.add_argument("model", help="model ID, or the path of a standalone model")
    summary.set_defaults(run=lambda o: summarise(o.model, Path(o.directory)))

    constants = commands.add_parser(
        "constants",
        parents=[place],
        help="physical constants of a model for simulators: thrust and torque coefficients, time constants, drag, ...",
        description="Thrust and torque coefficients, time constants, limits, levers, inertia and drag about hover, "
        "with standard errors where the data give them.",
    )
    constants.add_argument("model", help="model ID, or the path of a standalone model")
    constants.add_argument("--json", action="store_true", help="print JSON instead of a table")
    constants.set_defaults(run=print_constants)

    compare = commands.add_parser(
        "compare",
        parents=[place],
        help="what differs between two flights, or between two models on the same flights, beyond the spread",
        description="Flights are filtered tables (results/filtered/...) or their keys; models are IDs or paths.",
    )
    compare.add_argument("a", help="flight or model")
    compare.add_argument("b", help="flight or model")
    compare.add_argument("--flights", nargs="+", default=[], help="flights for models (those held out of both)")
    compare.add_argument("--repeats", nargs="+", default=[], help="three or more flights of the healthy vehicle")
    compare.add_argument("--json", action="store_true", help="print JSON instead of a table")
    compare.set_defaults(run=compare_two)

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


def print_constants(options: argparse.Namespace) -> str:
    """The physical constants of a model as a table or as JSON. Raises a QuasiError where it is absent or lacks them."""
    from quasi.export.physical_constants import constants_plain, constants_text, physical_constants
    from quasi.model.model import read_model

    found = physical_constants(read_model(model_place(options.model, Path(options.directory))))
    return json.dumps(constants_plain(found), indent=2) if options.json else constants_text(found)


def compare_two(options: argparse.Namespace) -> str:
    """Two flights, or two models on the same flights, as text or JSON. Raises a QuasiError where one is absent."""
    from quasi.gap.comparing.files import compare_flight_files, compare_model_files, filtered_flight

    directory, kinds = Path(options.directory), {}
    for name in (options.a, options.b):
        kinds[name] = filtered_flight(name, directory, required=False) is not None
    if len(set(kinds.values())) > 1:
        flight, model = (next(n for n, is_flight in kinds.items() if is_flight is want) for want in (True, False))
        raise ConfigError(f"'{flight}' is a flight and '{model}' is not; compare two flights, or two models")
    if all(kinds.values()):
        plain, text = compare_flight_files(options.a, options.b, directory, options.repeats)
    else:
        from quasi.export.physical_constants import physical_constants, uncertain_constants
        from quasi.model.model import read_model

        models = [read_model(model_place(n, directory)) for n in (options.a, options.b)]
        constants = []
        for model in models:
            try:
                constants.append(uncertain_constants(physical_constants(model)))
            except QuasiError:  # a model without these constants is compared by its errors alone
                constants.append({})
        plain, text = compare_model_files(*models, *constants, directory, options.flights)
    return json.dumps(plain, indent=2) if options.json else text


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

    from quasi.gap.catalogue import catalogue, chosen, in_room
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
        asked = ask_gap(gap, directory)
        settings = asked["settings"]
        effects = chosen(settings["effects"], catalogue(directory / p for p in asked["effect files"]), asked["file"])
        room, rate, noise = room_of(settings["room"]), settings["false alarm rate"], noise_of(gap, directory)
    effects = in_room(effects, room)
    card = examine(flown, used, effects, flights, references, rate, noise, metadata=about, room=room)
    text = flight_card.text(card)
    if out is not None:
        folder = directory / out
        write_json(folder / "plan.json", flight_card.data(card))
        write_text(folder / "plan.html", flight_card.page(card))
        text += f"\n\nMade {folder}: plan.json, plan.html"
    return text


def ask_gap(gap: str, directory: Path) -> dict[str, Any]:
    """What a folder asks of a gap; a notice on stderr names the effect files that will run."""
    from quasi.project.gaps import describe_run_code

    asked = folder_of(directory).gap(gap)
    if notice := describe_run_code(asked):
        print(f"[NOTICE] {notice}", file=sys.stderr)
    return asked


def causes_of(model: str | None, directory: Path, gap: str | None = None) -> str:
    """The catalogue of causes in Markdown; sizes are typical of the model's vehicle, or of made flights' without one.

    Raises a QuasiError where model or gap are absent.
    """
    from quasi.gap import causes_page
    from quasi.gap.catalogue import catalogue
    from quasi.gap.effect import vehicle_of
    from quasi.model.model import read_model

    files = ask_gap(gap, directory)["effect files"] if gap is not None else []
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
    from quasi_synthesis.vehicle import base_vehicle, hover_factors

    p = base_vehicle().physics
    factors = hover_factors(p)
    induced = float(np.sqrt(p.mass * GRAVITY / (8.0 * np.pi * p.density * p.radius**2)))  # momentum theory, hover
    return Vehicle(p.hubs, p.spin, p.radius, factors["thrust"], factors["torque"], p.mass, p.inertia, induced, 0.0, 0.0)


def import_model(file: Path, name: str, directory: Path, poles: int | None = None) -> str:
    """Write a published model as models/NAME/standalone/model.json; returns what was made and what to know.

    Raises a QuasiError for a file that is no such model, for a name that cannot be or that is taken.
    """
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
