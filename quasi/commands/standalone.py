"""Commands that need no run of the workflow: constants of a model, a log tied to a capture, comparisons."""

import argparse
import json
from pathlib import Path

from quasi.errors import ConfigError, QuasiError
from quasi.project.model_files import model_place


def add_standalone_commands(commands: argparse._SubParsersAction, place: argparse.ArgumentParser) -> None:
    """Add `constants`, `sync` and `compare` to the command line. place  parser of the option --directory"""
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

    sync = commands.add_parser(
        "sync",
        help="tie a log and a motion capture of one flight: lag, clock rate, lever arm and yaw",
        description="Needs no project: prints lag, clock rate, lever arm (IMU from the captured point) and yaw with "
        "standard errors, and draws both sides as aligned.",
    )
    sync.add_argument("log", help="on-board log, of any format that quasi reads")
    sync.add_argument("capture", help="export of the motion capture")
    sync.add_argument("--quadrotor", metavar="JSON", help="quadrotor configuration; tables need its 'table columns'")
    sync.add_argument("--rigid-body", help="name of the vehicle in the capture (its only one)")
    sync.add_argument("--log-number", type=int, help="which log of a file that holds several")
    sync.add_argument("--longest-lag", type=float, default=25.0, help="s, between the beginnings of the records (25)")
    sync.add_argument("-o", "--out", metavar="PNG", help="the picture (default: sync.png here)", default="sync.png")
    sync.add_argument("--json", action="store_true", help="print JSON instead of text")
    sync.set_defaults(run=align_log)

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


def print_constants(options: argparse.Namespace) -> str:
    """The physical constants of a model as a table or as JSON. Raises a QuasiError where it is absent or lacks them."""
    from quasi.export.physical_constants import constants_plain, constants_text, physical_constants
    from quasi.model.model import read_model

    found = physical_constants(read_model(model_place(options.model, Path(options.directory))))
    return json.dumps(constants_plain(found), indent=2) if options.json else constants_text(found)


def align_log(options: argparse.Namespace) -> str:
    """Lag, clock rate, lever arm and yaw of a log and a capture as text or JSON, and the picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from quasi.importing import sync_files
    from quasi.tables import read_json, replace_file

    quadrotor = read_json(Path(options.quadrotor)) if options.quadrotor else {}  # a part of one will do
    found = sync_files.align_files(
        Path(options.log), Path(options.capture), quadrotor, options.rigid_body, options.log_number, options.longest_lag
    )
    with replace_file(Path(options.out)) as part:
        FigureCanvasAgg(sync_files.alignment_picture(found)).print_png(part)
    if options.json:
        return json.dumps(sync_files.alignment_plain(found), indent=2)
    return f"{sync_files.alignment_text(found)}\nMade {options.out}"


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
