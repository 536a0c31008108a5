"""What the rules need to know of a project folder: models, simulations, gaps, and the settings of each job.

Everything here returns plain data (Snakemake compares it to decide what is stale) and is small per job: a flight's
stage gets its own row, its own files and the part of the configuration that it reads, never the whole logbook.
"""

import functools
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from quasi.errors import ConfigError, QuasiError, nearest
from quasi.project.configurations import Configurations
from quasi.project.flights import GAP_KEYS, Recordings
from quasi.project.folder import Places, braced, given_model_path, is_file
from quasi.project.gaps import HELD, Gaps
from quasi.project.logbook import Row
from quasi.project.logbooks import Logbooks
from quasi.project.model_jobs import ModelJobs

MADE_MODEL = re.compile(r"models/[^/]+/standalone/model\.json")  # as rules name it, unlike `given_model_path`


class Folder:
    """A project folder as the rules ask it, put together of its parts.

    places  paths; configuration  files of config/; logbooks  rows; recordings  raw files and settings of flights;
    gaps  comparisons of models with flights; model_jobs  settings of the jobs of models
    """

    def __init__(self, root: str | Path = ".", data: str | Path | None = None, library: str | Path | None = None):
        self.places = Places(root, data, library)
        self.configuration = Configurations(self.places)
        self.logbooks = Logbooks(self.places, self.configuration)
        self.recordings = Recordings(self.places, self.configuration, self.logbooks)
        self.gaps = Gaps(self.places, self.configuration, self.logbooks)
        self.model_jobs = ModelJobs(self.places, self.configuration, self.logbooks, self.recordings, self.gaps)

    def targets(self) -> list[str]:
        """What of this folder is usually asked for."""
        made = [f"models/{m}/standalone" for m in self.configuration.models]
        made += [f"results/simulations/{s}" for s in self.configuration.simulations] + [
            f"results/gaps/{g}" for g in self.configuration.gaps
        ]
        return [*made, "processing"]

    def given(self, paths: Iterable[str]) -> list[str]:
        """Those of the files that a user has put there: no rule makes them."""
        return [p for p in paths if not (self.recordings.is_made(Path(p)) or MADE_MODEL.fullmatch(str(p)))]

    def simulation(self, name: str) -> dict[str, Any]:
        """Settings of one simulation, and the paths of its model and tables ("wind", "reference", or None)."""
        settings = {k: v for k, v in self.configuration.simulation(name).items() if k != "animation"}
        chosen, where = settings["model"], f"config/simulations/{name}.json"
        model = chosen["model ID"]
        folder = self.places.place(chosen["model path"]) / model
        path, given = folder / "standalone" / "model.json", None
        if fault := braced(path):
            raise ConfigError(f"{where}, 'model path': {fault}")
        if is_file(self.places.here(folder / "model.json")):
            path = folder / "model.json"
        elif (
            folder.parts[:-1] == ("models",)
            and model not in self.configuration.models
            and not self.gaps.maker_of(model)
        ):
            if not is_file(self.places.here(path)):
                known = {
                    *self.configuration.models,
                    *(p.parts[-3] for p in self.places.root.glob("models/*/standalone/model.json")),
                }
                raise ConfigError(
                    f"{where}: 'model ID' is '{model}', but neither config/models/{model}.json nor {path} exists"
                    f"{nearest(model, known)}"
                )
            given = given_model_path(model)
        elif folder.parts[:-1] == ("models",):
            pass  # the model is made when it is not there
        elif not is_file(self.places.here(path)):
            raise ConfigError(f"{where}: {path} does not exist; correct 'model path' or 'model ID'")
        tables = {"wind": settings["wind"]["file"], "reference": settings["references"].get("file")}
        found = {kind: str(self.places.place(file)) if file else None for kind, file in tables.items()}
        for kind, file in found.items():
            if file and (fault := braced(file)):
                raise ConfigError(f"{where}, the {kind}'s 'file': {fault}")
            if file and not is_file(self.places.here(file)):
                raise ConfigError(f"{where}: the {kind}'s table {file} does not exist; correct 'file', or put it there")
        return {"name": name, "settings": settings, "model": given or path.as_posix(), **found}

    def animation(self, name: str) -> dict[str, Any]:
        """Settings of the animation of a simulation."""
        return self.configuration.simulation(name)["animation"]

    def gap(self, name: str) -> dict[str, Any]:
        """Settings of a gap's jobs: its own, its flights by role, the airframe and its on-board logs."""
        settings = {k: v for k, v in self.configuration.gap(name).items() if k != "logging file"}
        self.gaps.model_path(name)
        rows, trained = self.gaps.rows(name), self.gaps.trained(name)
        part = self.recordings.quadrotor_part(rows[0], GAP_KEYS)
        held = self.gaps.flights(name)[HELD]
        return {
            "name": name,
            "file": f"config/gaps/{name}.json",
            "settings": settings,
            "effect files": [str(self.places.place(p)) for p in settings["effect files"]],
            "roles": self.gaps.roles(name),
            "references": self.gaps.references(name),
            "gravity": self.gaps.gravity(name),
            "quadrotor": part["quadrotor"],
            "masses": {r.key: self.recordings.mass(r)[0] for r in rows},
            "sessions": {r.key: r.cells.get("Session", "") for r in rows},
            "recordings": self._logs(rows),
            "held": self._logs(held),
            "trained": self._logs(trained),
            "held keys": {r.flight: r.key for r in held},
            "put there": self.gaps.lineage(settings["model"])[-1] not in self.configuration.models,
            "problem": part["problem"],
        }

    def _logs(self, rows: Iterable[Row]) -> dict[str, list[str]]:
        """{"quadrotor/flight": [path of its on-board log, number of the log in it]} of the rows that have one."""
        return {r.flight: log for r in rows if (log := self.recordings.log_of(r))}

    @functools.cache  # noqa: B019
    def inspection(self, kind: str, name: str) -> dict[str, Any]:
        """What is asked of the raw files of a model ("models"), a gap ("gaps"), or of all flights ("processing").

        Returns "name" for messages, "identifies", "flights" {"quadrotor/flight": {"role", "problem" of what the filter
        needs, "settings" of the import}}, and of a gap the recordings that must differ: held, trained, recordings; and
        "trained flights", {"quadrotor/flight": "settings"} of those that trained its model.
        """
        if kind == "gaps":
            rows, roles = self.gaps.rows(name), self.gaps.roles(name)
        elif kind == "models":
            rows, roles = (
                self.logbooks.model_flights(name),
                {r.key: "training" for r in self.logbooks.model_flights(name, "training")},
            )
        else:
            rows, roles = self.logbooks.processing_flights(), {}
        flights = {
            row.flight: {
                "role": roles.get(row.key, "validation"),
                "problem": self.recordings.filtering(row.quadrotor, row.key)["problem"],
                "settings": self._reading(row),
            }
            for row in rows
        }
        asked = {"models": f"model {name}", "gaps": f"gap {name}"}.get(kind, "processing")
        found = {"name": asked, "identifies": kind != "processing", "flights": flights}
        if kind == "gaps":
            settings = self.gap(name)
            found |= {k: settings[k] for k in ("held", "trained", "recordings")}
            trained = [r for r in self.gaps.trained(name) if not r.problem]
            found["trained flights"] = {r.flight: self._reading(r) for r in trained}
        return found

    def _reading(self, row: Row) -> dict[str, Any]:
        """Settings of the import of a row's raw files, as far as reading them needs these."""
        settings = self.recordings.importing(row.quadrotor, row.key)
        return {k: settings[k] for k in ("flight", "quadrotor", "problem")}

    def configured_work(self) -> tuple[dict[str, dict[str, Any]], dict[str, str], list[str]]:
        """{"processing", "model m", ...: its inspection} of what is configured, {name: fault} of the others, and the
        names of those whose files are as `quasi init` laid them and fit no flights yet."""
        asked, faults, untouched = {}, {}, []
        works = [("processing", "flights", "processing")]
        works += [("models", m, f"model {m}") for m in self.configuration.models] + [
            ("gaps", g, f"gap {g}") for g in self.configuration.gaps
        ]
        for kind, name, title in works:
            try:
                if kind == "models":
                    self.model_jobs.identification(name)
                    for axis in self.model_jobs.axes(name):
                        self.model_jobs.axis(name, axis)
                asked[title] = self.inspection(kind, name)
            except QuasiError as fault:
                if self.configuration.is_as_laid(f"config/{kind}/{name}.json"):
                    untouched.append(title)
                else:
                    faults[title] = str(fault)
        for name in self.configuration.simulations:
            try:
                self.simulation(name)
            except QuasiError as fault:
                faults[f"simulation {name}"] = str(fault)
        return asked, faults, untouched
