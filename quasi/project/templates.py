"""Folders that quasi lays for a user: a project, a simulation of a system of one's own. library  folder of quasi."""

import shutil
import sys
from pathlib import Path

from quasi.errors import ConfigError
from quasi.tables import read_text, write_text


def new_simulation(name: str, directory: Path, library: Path) -> str:
    """Lay a simulation of a user's own system; returns what to do next. Raises ConfigError for an unfit name."""
    if not name.isidentifier() or name == "NAME":
        raise ConfigError(f"a simulation cannot be called '{name}'; use letters, digits and _, a letter first")
    folder = directory / name
    if folder.exists():
        raise ConfigError(f"{folder} already exists; choose another name")
    for suffix in (".py", ".json"):
        text = read_text(library / "config" / "new_simulation" / f"simulation{suffix}")
        write_text(folder / f"{name}{suffix}", text.replace("NAME", name))
    return (
        f"Made {folder}:\n"
        f"  {name}.py    the system: model, controller, actuator, forces, equations of motion; replace them by yours\n"
        f"  {name}.json  its settings\n"
        f"Then:  python {folder / name}.py"
    )


def lay_folder(folder: Path, library: Path) -> str:
    """Lay a project folder; returns what to do next. Raises ConfigError when the folder holds something."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError(f"{folder} already holds something; name a new or an empty folder")
    shutil.copytree(
        library / "config" / "template", folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns(".gitkeep")
    )
    installed = Path(sys.executable).parent / "snakemake"
    snakemake = installed if installed.exists() and not shutil.which("snakemake") else "snakemake"
    return (
        f"Made {folder}:\n"
        f"  data/logbook.csv                 one row per flight; fill it in\n"
        f"  data/my_quadrotor.json           geometry, mass, inertia of your quadrotor\n"
        f"  config/processing.json           how flights are imported and filtered\n"
        f"  config/models/my_model.json      which flights make the model, which are held out\n"
        f"  config/simulations/my_simulation.json  how the model is flown in a simulation\n"
        f"  config/gaps/my_gap.json          which flights the model is compared with, to see what it gets wrong\n"
        f"Check: quasi check {folder}\n"
        f"Then:  {snakemake} -s {library / 'Snakefile'} -d {folder} -j2 models/my_model/standalone"
    )
