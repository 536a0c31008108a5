"""The configuration files of a project folder, checked, with defaults."""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quasi.errors import ConfigError, nearest, quoted
from quasi.project.folder import Places, braced, is_file
from quasi.project.logbook import NAME_RULE, VALID_NAME
from quasi.project.misplaced_files import misplaced_files
from quasi.tables import read_json, read_text
from quasi.terms.variables import check_expression, check_system_inputs, check_terms

AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


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


class Configurations:
    """Configurations of processing, models, campaigns of made flights, simulations and gaps."""

    def __init__(self, places: Places) -> None:
        self.places = places

    @functools.cached_property
    def processing(self) -> dict[str, Any]:
        """config/processing.json, checked, with defaults."""
        return self.places.read("config/processing.json", "processing")

    @functools.cached_property
    def models(self) -> list[str]:
        """Model IDs that have a configuration."""
        return self.places.names("config/models")

    def every_model(self) -> list[str]:
        """Model IDs, each of a sound configuration. Raises ConfigError, also when there is none."""
        if not self.models:
            raise ConfigError(
                f"{self.places.root.absolute() / 'config/models'} holds no model; run snakemake in a project "
                f"folder or name it with -d (`quasi init FOLDER` lays one){misplaced_files(self.places.root)}"
            )
        return [name for name in self.models if self.model(name)]

    @functools.cached_property
    def campaigns(self) -> list[str]:
        """Campaigns of made flights that have a configuration."""
        return self.places.names("config/synthesis")

    @functools.cached_property
    def simulations(self) -> list[str]:
        """Names of the simulations that have a configuration."""
        return self.places.names("config/simulations")

    @functools.cached_property
    def gaps(self) -> list[str]:
        """Names of the gaps that have a configuration."""
        return self.places.names("config/gaps")

    @functools.cache  # noqa: B019 - a Folder lives as long as the run
    def model(self, name: str) -> dict[str, Any]:
        """config/models/<name>.json, checked, with defaults. Raises ConfigError."""
        path = f"config/models/{name}.json"
        if name not in self.models:
            raise ConfigError(f"{path} does not exist{nearest(name, self.models)}{misplaced_files(self.places.root)}")
        if not VALID_NAME.fullmatch(name):
            raise ConfigError(f"{path}: a model ID may hold {NAME_RULE}; rename the file")
        config = self.places.read(path, "model")
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
            raise ConfigError(
                f"config/synthesis/{name}.json does not exist{nearest(name, self.campaigns)}; put it back, or move its "
                f"flights from results/synthesis/{name} into data/ and correct the paths in the logbook"
            )
        return self.places.read(f"config/synthesis/{name}.json", "synthesis")

    @functools.cache  # noqa: B019
    def simulation(self, name: str) -> dict[str, Any]:
        """config/simulations/<name>.json, checked, with defaults. Raises ConfigError."""
        path = f"config/simulations/{name}.json"
        if name not in self.simulations:
            raise ConfigError(
                f"{path} does not exist{nearest(name, self.simulations)}{misplaced_files(self.places.root)}"
            )
        return self.places.read(path, "simulation")

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

    def gravity(self, name: str) -> str:
        """withGravity or noGravity, by the last part of the model's 'filtered data save directory'."""
        text = self.model(name)["filtered data save directory"].replace("\\", "/").rstrip("/").rsplit("/", 1)[-1]
        if text not in ("withGravity", "noGravity"):
            raise ConfigError(
                f"config/models/{name}.json: 'filtered data save directory' ends in '{text}', "
                "expected withGravity or noGravity"
            )
        return text

    @functools.cache  # noqa: B019 - a Folder lives as long as the run
    def gap(self, name: str) -> dict[str, Any]:
        """config/gaps/<name>.json, checked, with defaults. Raises ConfigError."""
        path = f"config/gaps/{name}.json"
        if name not in self.gaps:
            raise ConfigError(f"{path} does not exist{nearest(name, self.gaps)}")
        if not VALID_NAME.fullmatch(name):
            raise ConfigError(f"{path}: the name of a gap may hold {NAME_RULE}; rename the file")
        settings = self.places.read(path, "gap")
        if settings["extended model ID"] is None:
            settings["extended model ID"] = f"{settings['model']}-{name}"
        ident = settings["extended model ID"]
        if not VALID_NAME.fullmatch(ident):
            raise ConfigError(f"{path}: 'extended model ID' is {quoted(ident)}; use {NAME_RULE}")
        if ident in self.models:
            raise ConfigError(
                f"{path}: 'extended model ID' is '{ident}', but config/models/{ident}.json makes a model of that name; "
                "choose another"
            )
        for side, walls in (settings["room"] or {}).items():
            if side != "height" and not walls[0] < walls[1]:
                raise ConfigError(
                    f"{path}: 'room' / '{side}' goes from {walls[0]} to {walls[1]} m, expected [low, high]; "
                    "measure the walls from the origin of the motion capture"
                )
        self._refuse_effects(settings, path)
        return settings

    def _refuse_effects(self, settings: Mapping[str, Any], path: str) -> None:
        """Raises ConfigError for causes that do not exist, as far as that shows without running a user's files."""
        wanted, own = settings["effects"], settings["effect files"]
        for file in own:
            if fault := braced(self.places.place(file)):
                raise ConfigError(f"{path}, 'effect files': {fault}")
            if not is_file(self.places.here(self.places.place(file))):
                found = "is a folder" if Path(self.places.here(self.places.place(file))).is_dir() else "does not exist"
                raise ConfigError(
                    f"{path}: effect file {self.places.place(file)} {found}; correct 'effect files', or put the "
                    "file there"
                )
        if isinstance(wanted, str) and wanted != "all":
            raise ConfigError(
                f"{path}: 'effects' is '{wanted}', expected \"all\" or a list of ids like [\"ground_effect\"]"
            )
        if "all" in wanted and wanted != "all":
            raise ConfigError(f"{path}: 'effects' lists 'all'; write \"effects\": \"all\", or the ids without it")
        # each file is called by its id
        known = {p.stem for p in (Path(__file__).parents[1] / "gap/causes").glob("*.py")} - {"__init__"}
        for name in [] if own or wanted == "all" else wanted:
            if name not in known:
                raise ConfigError(f"{path}: effect '{name}' is not in the catalogue{nearest(name, known)}")

    def is_as_laid(self, path: str) -> bool:
        """Whether a configuration is the one that `quasi init` lays, unchanged."""
        laid = self.places.library / "config/template" / path
        return (
            is_file(laid) and is_file(self.places.here(path)) and read_text(laid) == read_text(self.places.here(path))
        )
