"""The `quasi` command: its parser, the errors that it prints, its exit codes."""

import argparse
import signal
import sys
from collections.abc import Sequence

from quasi.commands.models import add_model_commands
from quasi.commands.recordings import add_recording_commands
from quasi.commands.simulations import add_simulation_commands
from quasi.errors import QuasiError, nearest


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

    add_model_commands(commands, place)
    add_simulation_commands(commands, place)
    add_recording_commands(commands)
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


if __name__ == "__main__":
    raise SystemExit(main())
