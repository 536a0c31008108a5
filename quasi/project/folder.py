"""A project folder: whether it is one, its settings, and the paths in it."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from quasi.errors import ConfigError, ReadError, nearest, quoted
from quasi.input_limits import MAX_YAML_BYTES
from quasi.project import configuration
from quasi.project.misplaced_files import misplaced_files
from quasi.tables import read_text

MADE = ("results", "models", "logs")  # folders that runs write into

SETTINGS = ("data",)  # keys of config/config.yaml and --config


def with_suffix(path: Path, suffix: str) -> Path:
    """The path with a suffix added unless it ends in it."""
    return path if path.suffix.lower() == suffix.lower() else Path(f"{path}{suffix}")


def is_file(path: Path) -> bool:
    """Whether the path is a file; a name that the file system cannot hold is none."""
    try:
        return path.is_file()
    except OSError:
        return False


def given_model_path(name: str) -> str:
    """Path of a model.json that a user has put there: from the project folder, which may move.

    The dot keeps rules from taking it for one that they make.
    """
    return f"models/./{name}/standalone/model.json"


def braced(path: str | Path) -> str | None:
    """Why a path cannot be one of a run, with the remedy; None where it can: Snakemake reads braces as wildcards."""
    if not {"{", "}"} & {*str(path)}:
        return None
    return f"the path {path} holds a brace, which Snakemake reads as a wildcard; rename the folder or file"


def check_writable(folder: str | Path) -> None:
    """Raise ConfigError for a project folder into which, or into whose folders of results, nothing can be written."""
    for place in (Path(folder), *(Path(folder) / made for made in MADE)):
        if place.exists() and not place.is_dir():
            raise ConfigError(f"{place.absolute()} is a file, expected a folder for what is made; move it away")
        if place.exists() and not os.access(place, os.W_OK):
            raise ConfigError(
                f"nothing can be written into {place.absolute()}; change its permissions, or copy the project to a "
                "folder of your own"
            )


def check_project(folder: str | Path) -> None:
    """Raise ConfigError for a folder that is no project's, as a slip in what -d names gives, or that no run can use."""
    place = Path(folder).absolute()
    if fault := braced(place):
        raise ConfigError(f"project folder: {fault}")
    if any((place / name).is_dir() for name in ("config", "models")):
        return
    found = "holds neither config/ nor models/"
    if not place.is_dir():
        found = "does not exist"
    elif all(p.name == ".snakemake" for p in place.iterdir()):
        found = "is empty"  # Snakemake makes the folder that -d names
    raise ConfigError(
        f"{place} is no project folder: it {found}, expected config/ with the configuration and data/ with the "
        "logbook; correct what -d names, run in the project's folder, or lay one with `quasi init FOLDER`"
        f"{misplaced_files(place)}"
    )


def read_settings(path: str | Path) -> dict[str, Any]:
    """What the folder's config.yaml sets; {} when it is absent or holds comments only. Raises ConfigError."""
    if not is_file(Path(path)):
        return {}
    try:
        settings = yaml.safe_load(read_text(path, MAX_YAML_BYTES))
    except (yaml.YAMLError, ReadError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f" at line {mark.line + 1}" if mark else ""
        raise ConfigError(f"{path} is not valid YAML{line}; write lines like `data: /path/to/recordings`") from None
    if settings is None:
        return {}
    if not isinstance(settings, dict) or not isinstance(settings.get("data", ""), str):
        raise ConfigError(f"{path}: expected `data: /path/to/recordings`; correct it, or leave only comments")
    check_settings(settings, str(path))
    return settings


def check_settings(keys: Iterable[Any], where: str) -> None:
    """Raise ConfigError for a setting that nothing reads. where  the file or option that gives it, for messages"""
    for key in keys:
        if key not in SETTINGS:
            raise ConfigError(f"{where}: unknown key {quoted(key)}{nearest(str(key), SETTINGS)}; correct or remove it")


class Places:
    """Paths of a project folder: config/ and data/ in, results/ and models/ out.

    root  the folder; data  what replaces the prefix `data/` of raw paths (`--config data=PATH`), or None;
    library  the folder that holds quasi's own config/polynomials; notices  remarks of the configuration files read
    """

    def __init__(self, root: str | Path = ".", data: str | Path | None = None, library: str | Path | None = None):
        self.root = Path(root)
        self.data = str(data) if data else None
        if self.data and (fault := braced(self.data)):
            raise ConfigError(f"'data' of --config or config/config.yaml: {fault}")
        self.library = Path(library) if library else Path(__file__).parents[2]
        self.notices: list[str] = []

    def place(self, path: str) -> Path:
        """A path of a configuration or logbook as the run sees it: relative to the folder, `data/` replaced."""
        text = str(path).strip().replace("\\", "/")
        while text.startswith("./"):
            text = text[2:]
        if self.data and (text == "data" or text.startswith("data/")):
            return Path(self.data) / text.removeprefix("data").lstrip("/")
        return Path(text)

    def here(self, path: str | Path) -> Path:
        """A path of the folder as this process sees it."""
        return self.root / path

    def settled(self, path: str | Path) -> Path:
        """Path of a logbook or quadrotor configuration: the folder's own file first, else with `data/` replaced where
        there is one; where neither is, the folder's own, where it belongs."""
        own, other = Path(path), self.place(Path(path).as_posix())
        return own if is_file(self.here(own)) or not is_file(self.here(other)) else other

    def describe_other_place(self, path: Path) -> str:
        """Where else a logbook or quadrotor configuration was looked for."""
        other = self.place(path.as_posix())
        return "" if other == path else f", nor does {other}"

    def read(self, path: str | Path, kind: str) -> dict[str, Any]:
        """A configuration file, checked, with defaults; see `configuration.read`. Raises ConfigError."""
        if not is_file(self.here(path)):
            raise ConfigError(
                f"{path} does not exist in {self.root.absolute()}; run snakemake in a project folder or name it with "
                f"-d (`quasi init FOLDER` lays one){misplaced_files(self.root)}"
            )
        document, notices = configuration.read(self.here(path), kind, str(path))
        self.notices += [n for n in notices if n not in self.notices]
        return document

    def names(self, folder: str) -> list[str]:
        """Names of the JSON files in a folder, sorted, without their ending."""
        # systems and editors leave files with a leading dot
        return sorted(p.stem for p in self.here(folder).glob("*.json") if not p.name.startswith("."))
