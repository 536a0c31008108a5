"""The `quasi` command: what a model holds, a project folder of one's own."""

import argparse
import shutil
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

    init = commands.add_parser("init", help="lay a project folder: commented configuration and an empty logbook")
    init.add_argument("folder", help="folder to make; it must be empty or absent")

    options = parser.parse_args(arguments)
    try:
        if options.command == "summary":
            print(summarise(options.model, Path(options.directory)))
        else:
            print(lay(Path(options.folder)))
    except QuasiError as error:
        print(f"[ERROR] {error}", file=sys.stderr)
        return 1
    return 0


def summarise(model: str, directory: Path) -> str:
    """The summary of a model given by ID or path, with its scores when they stand beside it."""
    from quasi.errors import ReadError, nearest
    from quasi.standalone.model import read_model
    from quasi.tables import read_text

    named = directory / "models" / model / "standalone"
    path = named if named.is_dir() else directory / model
    if not path.exists():
        made = [p.parent.name for p in directory.glob("models/*/standalone")]
        raise ReadError(
            f"no model '{model}': neither {named} nor {directory / model} exists{nearest(model, made)}; "
            f"make it with `snakemake -j2 models/{model}/standalone`"
        )
    text = read_model(path).summary()
    scores = (path if path.is_dir() else path.parent) / "summary.txt"
    if scores.is_file():
        text += "\n\n" + read_text(scores).rstrip()
    return text


def lay(folder: Path) -> str:
    """Lay a project folder; returns what to do next. Raises ConfigError when the folder holds something."""
    from quasi.errors import ConfigError

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError(f"{folder} already holds something; name a new or an empty folder")
    shutil.copytree(TEMPLATE, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns(".gitkeep"))
    return (
        f"Made {folder}:\n"
        f"  data/logbook.csv                 one row per flight; fill it in\n"
        f"  data/my_quadrotor.json           geometry, mass, inertia of your quadrotor\n"
        f"  config/processing.json           how flights are imported and filtered\n"
        f"  config/models/my_model.json      which flights make the model, which are held out\n"
        f"Then:  snakemake -s {LIBRARY / 'Snakefile'} -d {folder} -j2 models/my_model/standalone"
    )


if __name__ == "__main__":
    raise SystemExit(main())
