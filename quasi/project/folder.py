"""A project folder: its configuration, checked, its logbooks, and the flights that a selection of rows means."""

import functools
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from quasi.errors import ConfigError, LogbookError, QuasiError, ReadError, nearest
from quasi.project import configuration
from quasi.project.logbook import NAME, Row, apart, pick, read_logbook
from quasi.project.misplaced_files import misplaced_files
from quasi.tables import read_json, read_text
from quasi.terms.variables import check_expression, check_system_inputs, check_terms

MADE = ("results", "models", "logs")  # folders that runs write into
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def with_suffix(path: Path, suffix: str) -> Path:
    """The path with a suffix added unless it ends in it."""
    return path if path.suffix.lower() == suffix.lower() else Path(f"{path}{suffix}")


def is_file(path: Path) -> bool:
    """Whether the path is a file; a name that the file system cannot hold is none."""
    try:
        return path.is_file()
    except OSError:
        return False


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
    """Raise ConfigError for a folder that is no project's, as a slip in what -d names gives."""
    place = Path(folder).absolute()
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
        settings = yaml.safe_load(read_text(path))
    except (yaml.YAMLError, ReadError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f" at line {mark.line + 1}" if mark else ""
        raise ConfigError(f"{path} is not valid YAML{line}; write lines like `data: /path/to/recordings`") from None
    if settings is None:
        return {}
    if not isinstance(settings, dict) or not isinstance(settings.get("data", ""), str):
        raise ConfigError(f"{path}: expected `data: /path/to/recordings`; correct it, or leave only comments")
    return settings


def check_specification(document: dict[str, Any], where: str, normalised: bool = False) -> None:
    """Refuse a polynomial specification with an expression that means nothing, before flights are processed for it.

    normalised  whether it is for a non-dimensional model
    """
    for axis in AXES:
        section = document.get(axis, {})
        parts = {"fixed": section.get("fixed", [])}
        for number, entry in enumerate(section.get("candidates", []), 1):
            parts |= {f"candidates entry {number}, {key}": entry.get(key, []) for key in ("vars", "sets")}
        for part, expressions in parts.items():
            for text in expressions:
                check_expression(str(text), f"{where}, {axis}, {part}", normalised)


def check_model_file(path: Path, shown: str) -> None:
    """Refuse a model that was put into the folder and has a term that means nothing, before anything runs with it."""
    check_terms(read_json(path), shown)


class Project:
    """A project folder: config/ and data/ in, results/ and models/ out.

    root  the folder; data  what replaces the prefix `data/` of raw paths (`--config data=PATH`), or None;
    library  the folder that holds quasi's own config/polynomials.
    """

    def __init__(self, root: str | Path = ".", data: str | Path | None = None, library: str | Path | None = None):
        self.root = Path(root)
        self.data = str(data) if data else None
        self.library = Path(library) if library else Path(__file__).parents[2]
        self.notices: list[str] = []

    # paths

    def place(self, path: str) -> Path:
        """A path of a configuration or logbook as the run sees it: relative to the folder, `data/` replaced."""
        text = str(path).strip().replace("\\", "/")
        while text.startswith("./"):
            text = text[2:]
        if self.data and (text == "data" or text.startswith("data/")):
            return Path(self.data) / text.removeprefix("data").lstrip("/")
        return Path(text)

    def _here(self, path: str | Path) -> Path:
        return self.root / path

    def _settled(self, path: str | Path) -> Path:
        """Path of a logbook or quadrotor configuration: the folder's own file first, else with `data/` replaced where
        there is one; where neither is, the folder's own, where it belongs."""
        own, other = Path(path), self.place(Path(path).as_posix())
        return own if is_file(self._here(own)) or not is_file(self._here(other)) else other

    def _nor(self, path: Path) -> str:
        """Where else a logbook or quadrotor configuration was looked for."""
        other = self.place(path.as_posix())
        return "" if other == path else f", nor does {other}"

    def _read(self, path: str | Path, kind: str) -> dict[str, Any]:
        if not is_file(self._here(path)):
            raise ConfigError(
                f"{path} does not exist in {self.root.absolute()}; run snakemake in a project folder or name it with "
                f"-d (`quasi init FOLDER` lays one){misplaced_files(self.root)}"
            )
        document, notices = configuration.read(self._here(path), kind, str(path))
        self.notices += [n for n in notices if n not in self.notices]
        return document

    # configuration

    @functools.cached_property
    def processing(self) -> dict[str, Any]:
        """config/processing.json, checked, with defaults."""
        return self._read("config/processing.json", "processing")

    @functools.cached_property
    def models(self) -> list[str]:
        """Model IDs that have a configuration."""
        return self._names("config/models")

    def every_model(self) -> list[str]:
        """Model IDs, each of a sound configuration. Raises ConfigError, also when there is none."""
        if not self.models:
            raise ConfigError(
                f"{self.root.absolute() / 'config/models'} holds no model; run snakemake in a project folder or name "
                f"it with -d (`quasi init FOLDER` lays one){misplaced_files(self.root)}"
            )
        return [name for name in self.models if self.model(name)]

    @functools.cached_property
    def campaigns(self) -> list[str]:
        """Campaigns of made flights that have a configuration."""
        return self._names("config/synthesis")

    @functools.cached_property
    def simulations(self) -> list[str]:
        """Names of the simulations that have a configuration."""
        return self._names("config/simulations")

    def _names(self, folder: str) -> list[str]:
        # systems and editors leave files with a leading dot
        return sorted(p.stem for p in self._here(folder).glob("*.json") if not p.name.startswith("."))

    @functools.cache  # noqa: B019 - a Folder lives as long as the run
    def model(self, name: str) -> dict[str, Any]:
        """config/models/<name>.json, checked, with defaults. Raises ConfigError."""
        path = f"config/models/{name}.json"
        if name not in self.models:
            raise ConfigError(f"{path} does not exist{nearest(name, self.models)}{misplaced_files(self.root)}")
        if not NAME.fullmatch(name):
            raise ConfigError(f"{path}: a model ID may hold letters, digits and . _ + - only; rename the file")
        config = self._read(path, "model")
        given = config.get("saving models", {}).get("model ID", name)
        if given != name:
            raise ConfigError(f"{path}: 'model ID' is '{given}', but the file's name says '{name}'; make them equal")
        axes = [a for a in AXES if config["identification parameters"][f"identify {a.lower()}"]]
        if not axes:
            raise ConfigError(f"{path}: every 'identify ...' is false; switch at least one on")
        for section in ("standalone", "matlab"):  # the stages that read them run after the whole identification
            u = config[section].get("DiffSys u", config["standalone"].get("DiffSys u"))
            if u or (u is not None and config[section]["make moment DiffSys"]):
                check_system_inputs(u, f"{path}, '{section}' / 'DiffSys u'")
        return config

    @functools.cache  # noqa: B019
    def campaign(self, name: str) -> dict[str, Any]:
        """config/synthesis/<name>.json, checked, with defaults. Raises ConfigError."""
        if name not in self.campaigns:
            raise ConfigError(f"config/synthesis/{name}.json does not exist{nearest(name, self.campaigns)}")
        return self._read(f"config/synthesis/{name}.json", "synthesis")

    @functools.cache  # noqa: B019
    def simulation_settings(self, name: str) -> dict[str, Any]:
        """config/simulations/<name>.json, checked, with defaults. Raises ConfigError."""
        path = f"config/simulations/{name}.json"
        if name not in self.simulations:
            raise ConfigError(f"{path} does not exist{nearest(name, self.simulations)}{misplaced_files(self.root)}")
        return self._read(path, "simulation")

    def made_flight(self, campaign: str, flight: str) -> dict[str, Any]:
        """Settings of one made flight: the campaign's, and its own entry alone."""
        config = dict(self.campaign(campaign))
        flights = {f.get("key"): f for f in config.get("flights", [])}
        if flight not in flights:
            raise ConfigError(
                f"config/synthesis/{campaign}.json: no flight has the key '{flight}'"
                f"{nearest(flight, filter(None, flights))}"
            )
        config["flights"] = [flights[flight]]
        return {"campaign": campaign, "flight": flight, "settings": config}

    # logbooks and flights

    def logbook(self, directory: str, filename: str, where: str) -> dict[int, Row]:
        """Rows of a logbook by number; `where` is the configuration that names it, for messages."""
        path = self._settled(self._logbook_path(directory, filename))
        if not is_file(self._here(path)):
            known = [p.name for p in self._here(path.parent).glob("*.csv")] if len(str(path)) < 1000 else []
            raise ConfigError(
                f"{where}: logbook {path} does not exist{self._nor(path)}{nearest(path.name, known)}; "
                "correct 'directory' or 'filename' in 'logging file', or save the logbook there as CSV"
            )
        return self._rows_of(path)

    @functools.cache  # noqa: B019
    def _rows_of(self, path: Path) -> dict[int, Row]:
        try:
            return read_logbook(self._here(path))
        except QuasiError as error:
            raise type(error)(str(error).replace(str(self._here(path)), str(path))) from None

    @staticmethod
    def _logbook_path(directory: str, filename: str) -> Path:
        return with_suffix(Path(directory.replace("\\", "/")) / filename, ".csv")

    def _rows(self, section: Mapping[str, Any], key: str, where: str) -> list[Row]:
        directory, filename = section["directory"], section["filename"]
        book = self.logbook(directory, filename, where)
        return pick(book, section[key], f"{where}, '{key}'", str(self._logbook_path(directory, filename)))

    @functools.cached_property
    def flights(self) -> dict[tuple[str, str], Row]:
        """{(quadrotor, flight key): row} over every logbook that a configuration of the folder names."""
        books: dict[tuple[str, str], dict[int, Row]] = {}
        asked = (
            [("processing", "")]
            + [("models", m) for m in self.models]
            + [("gaps", g) for g in self._names("config/gaps")]
        )
        for kind, name in asked:
            where = f"config/{kind}/{name}.json" if name else "config/processing.json"
            try:
                section = self._section(kind, name)
                chosen = (section["directory"], section["filename"])
                books[chosen] = self.logbook(*chosen, where)
            except QuasiError:
                if not name and is_file(self._here(where)):
                    raise
                continue  # a broken model stops those who ask for it, not the others
        found: dict[tuple[str, str], Row] = {}
        for book in books.values():
            for row in book.values():
                other = found.setdefault((row.quadrotor, row.key), row)
                if other.logbook != row.logbook and other.cells != row.cells:
                    raise LogbookError(
                        f"{other.logbook} row {other.number} and {row.logbook} row {row.number} both mean flight "
                        f"'{row.key}' of {row.quadrotor}; {apart(row, other)}"
                    )
        return found

    def _section(self, kind: str, name: str) -> Mapping[str, Any]:
        """The part of a configuration that names logbook and rows."""
        if kind == "gaps":
            return self._read(f"config/gaps/{name}.json", "gap")["logging file"]
        return (self.model(name) if kind == "models" else self.processing)["logging file"]

    def processing_flights(self) -> list[Row]:
        """The flights that config/processing.json selects (all of the logbook when it selects none)."""
        section = self.processing["logging file"]
        if "rows of flights to use (all)" in section:
            return self._rows(section, "rows of flights to use (all)", "config/processing.json")
        rows = list(self.logbook(section["directory"], section["filename"], "config/processing.json").values())
        if not rows:
            path = self._logbook_path(section["directory"], section["filename"])
            raise LogbookError(f"{path} holds no flights yet; add one row per flight below its first line")
        return rows

    def row(self, quadrotor: str, flight: str) -> Row:
        """The logbook row of a flight. Raises LogbookError naming the near ones."""
        found = self.flights.get((quadrotor, flight))
        if found is None:
            names = [f"{q}/{f}" for q, f in self.flights]
            raise LogbookError(
                f"no logbook row means flight {quadrotor}/{flight}{nearest(f'{quadrotor}/{flight}', names)}"
            )
        return found

    @functools.cache  # noqa: B019
    def model_flights(self, name: str, role: str = "all") -> list[Row]:
        """Rows of a model's flights: "all", "training" or "validation". Raises LogbookError or ConfigError."""
        where = f"config/models/{name}.json"
        section = self.model(name)["logging file"]
        everything = self._rows(section, "rows of flights to use (all)", where)
        held = []
        if section["rows of flights for validation"]:
            held = self._rows(section, "rows of flights for validation", where)
        numbers = {r.number for r in everything}
        for row in held:
            if row.number not in numbers:
                raise ConfigError(
                    f"{where}: validation row {row.number} is not among 'rows of flights to use (all)'; add it there"
                )
        out = {r.number for r in held}
        training = [r for r in everything if r.number not in out]
        if not training:
            raise ConfigError(f"{where}: every row is held out for validation; leave at least one for training")
        # a row that names no quadrotor fails in its own jobs
        quadrotors = {r.quadrotor for r in everything if not r.problem}
        if len(quadrotors) > 1:
            raise ConfigError(
                f"{where}: the rows mean several quadrotors ({', '.join(sorted(quadrotors))}); select one"
            )
        return {"all": everything, "training": training, "validation": held}[role]

    def gravity(self, name: str) -> str:
        """withGravity or noGravity, by the last part of the model's 'filtered data save directory'."""
        text = self.model(name)["filtered data save directory"].replace("\\", "/").rstrip("/").rsplit("/", 1)[-1]
        if text not in ("withGravity", "noGravity"):
            raise ConfigError(
                f"config/models/{name}.json: 'filtered data save directory' ends in '{text}', "
                "expected withGravity or noGravity"
            )
        return text
