"""What the rules need to know of a project folder: models, simulations, gaps, and the settings of each job.

Everything here returns plain data (Snakemake compares it to decide what is stale) and is small per job: a flight's
stage gets its own row, its own files and the part of the configuration that it reads, never the whole logbook.
"""

import functools
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from quasi.airframe import read_airframe
from quasi.errors import ConfigError, QuasiError, nearest
from quasi.project.flights import GEOMETRY, IDENTIFICATION, Recordings
from quasi.project.folder import AXES, check_model_file, check_specification, is_file, with_suffix
from quasi.project.gaps import HELD, recorded_twice
from quasi.project.logbook import Row
from quasi.tables import read_json, read_text
from quasi.terms.normalisation import make_normalisation

MADE_MODEL = re.compile(r"models/[^/]+/standalone/model\.json")  # as rules name it; one that was put there is absolute
STILLS = {"number of drone stills": 5, "show animation": False, "animation speed up factor": 1}


def _named(row: Row) -> str:
    return f"row {row.number} of {Path(row.logbook).name}"


class Folder(Recordings):
    """A project folder as the rules ask it: its flights, and the settings of each job of its models and simulations."""

    def targets(self) -> list[str]:
        """What of this folder is usually asked for."""
        made = [f"models/{m}/standalone" for m in self.models]
        made += [f"results/simulations/{s}" for s in self.simulations] + [f"results/gaps/{g}" for g in self.gaps]
        return [*made, "processing"]

    def given(self, paths: Iterable[str]) -> list[str]:
        """Those of the files that a user has put there: no rule makes them."""
        return [p for p in paths if not (self._made(Path(p)) or MADE_MODEL.fullmatch(str(p)))]

    def identification(self, name: str) -> dict[str, Any]:
        """Settings that all axes of a model share."""
        training, everything = self.model_flights(name, "training"), self.model_flights(name)
        # a row whose configuration is absent or faulty fails in its own jobs, with its own sentence
        sound = [r for r in everything if self._quadrotor(r)[1] is None]
        files = {str(self._quadrotor_path(r)) for r in sound}
        if len(files) > 1:
            raise ConfigError(
                f"config/models/{name}.json: the rows name several quadrotor configurations "
                f"({', '.join(sorted(files))}); a model needs one"
            )
        self._refuse_one_recording(name, everything)
        part = self._part(next((r for r in training if r in sound), training[0]), IDENTIFICATION)
        self._refuse_missing_scales(name, training[0])
        batteries = self._batteries(name, training)  # a flight that is held out mixes nothing
        masses = [m for m, _ in map(self.mass, training) if m]
        return {
            "model": name,
            "quadrotor name": training[0].quadrotor,
            "quadrotor": part["quadrotor"],
            "mass": sum(masses) / len(masses) if masses else None,
            "flights": [r.key for r in training],
            "gravity": self.gravity(name),
            "data partitioning": self.partitioning(name),
            "isolation": self.isolation(name),
            "mixed batteries": batteries,
            "use unusable flights": name in self.models and self.model(name)["logging file"]["use unusable flights"],
            "problem": part["problem"],
        }

    def _refuse_missing_scales(self, name: str, row: Row) -> None:
        """Raises ConfigError where a normalised model's quadrotor lacks what its forces and moments are divided by."""
        config, problem = self._quadrotor(row)
        if problem or name not in self.models or not self.model(name)["data normalization"]["normalize data"]:
            return
        path, where = self._quadrotor_path(row), f"config/models/{name}.json"
        airframe = read_airframe(config, str(path), mass=1.0)
        scales = {"idle RPM": airframe.idle_rpm, "max RPM": airframe.max_rpm, "motor poles": airframe.poles}
        if lacking := [f"'{key}'" for key, value in scales.items() if not value]:
            raise ConfigError(
                f"{where}: 'normalize data' needs {' and '.join(lacking)}, which {path} lacks; add what is missing, or "
                "set 'normalize data' to false"
            )
        make_normalisation(airframe, None, where)

    def _refuse_one_recording(self, name: str, rows: list[Row]) -> None:
        """Raises ConfigError for a flight that would train twice, or be judged by what it trained."""
        logs = {_named(r): [str(self._here(log[0])), log[1]] for r in rows if (log := self._log_of(r))}
        if twice := recorded_twice(logs):
            raise ConfigError(
                f"config/models/{name}.json: {twice[0]} and {twice[1]} have the same recording, but each flight counts "
                "once, and trains or is held out; leave one out, or give each its own 'Log number' if the file holds "
                "several logs"
            )

    def partitioning(self, name: str) -> dict[str, Any]:
        """How the rows of a model's flights are drawn."""
        if self.extended(name):
            return {"random partition": False}
        return self.model(name)["data partitioning"]

    def isolation(self, name: str) -> dict[str, Any] | None:
        """Settings of the isolation of manoeuvres; None where it is off."""
        chosen = self.model(name)["manoeuvre excitations"]
        if not chosen["isolate to regions of excitation"]:
            return None
        return {k: chosen[k] for k in ("excitation threshold", "spread")}

    def _batteries(self, name: str, rows: list[Row]) -> list[str]:
        """Battery types of a model's training rows where they differ and may. Raises ConfigError where they may not."""
        kinds = sorted({r.cells.get("Batteries", "") for r in rows} - {""})
        if len(kinds) > 1 and not self.model(name)["logging file"]["allow mixed batteries"]:
            raise ConfigError(
                f"config/models/{name}.json: the training flights were flown with different 'Batteries' "
                f"({', '.join(kinds)}); select flights with one battery type, hold the others out for validation, or "
                "set 'allow mixed batteries' in 'logging file' to true"
            )
        return kinds if len(kinds) > 1 else []

    def trajectories(self, name: str) -> dict[str, Any]:
        """Settings of the trajectory figures of a model."""
        gap = self.extended(name)
        row = self.gap_rows(gap)[0] if gap else self.model_flights(name, "training")[0]
        part = self._part(row, GEOMETRY)
        chosen = (self.configured(name) or {"plotting": STILLS})["plotting"]
        return {
            "quadrotor": part["quadrotor"],
            "problem": part["problem"],
            "mass": self.mass(row)[0],
            "stills": chosen["number of drone stills"],
            "animate": chosen["show animation"],
            "speed up": chosen["animation speed up factor"],
        }

    def flight_trajectory(self, quadrotor: str, flight: str) -> dict[str, Any]:
        """Settings of the trajectory figure and the animation of one flight, which no model needs to name."""
        row = self.row(quadrotor, flight)
        part = self._part(row, GEOMETRY)
        chosen = self.processing["plotting"]
        return {
            "flight": flight,
            "quadrotor": part["quadrotor"],
            "problem": part["problem"],
            "mass": self.mass(row)[0],
            "stills": chosen["number of drone stills"],
            "speed up": chosen["animation speed up factor"],
        }

    def configured(self, name: str) -> dict[str, Any] | None:
        """Configuration of a model, or of the one that it extends; None where that was put there."""
        root = self._lineage(name)[-1]
        return self.model(root) if root in self.models or not self.extended(name) else None

    def roles(self, name: str) -> dict[str, list[str]]:
        """Keys of a model's training and validation flights."""
        if gap := self.extended(name):
            roles = self.gap_roles(gap)
            return {
                "training": [k for k, role in roles.items() if role != HELD],
                "validation": [k for k, role in roles.items() if role == HELD],
            }
        return {role: [r.key for r in self.model_flights(name, role)] for role in ("training", "validation")}

    def standalone(self, name: str) -> dict[str, Any]:
        """Settings of the assembly of a model."""
        config = self.configured(name)
        if config is None:
            return {"file": None, "u": None}
        chosen = config["standalone"]
        return {
            "file": f"config/models/{self._lineage(name)[-1]}.json",
            "u": chosen["DiffSys u"] if chosen["make moment DiffSys"] else None,
        }

    def portable(self, name: str) -> str:
        """Path of a model's model.json, which rules make or a user has put there."""
        path = Path("models") / name / "standalone" / "model.json"
        if name in self.models or self.extended(name):
            return path.as_posix()
        if not is_file(self._here(path)):
            raise ConfigError(
                f"neither config/models/{name}.json nor {path} exists{nearest(name, self.models)}; make the model first"
            )
        check_model_file(self._here(path), str(path))
        return self._here(path).absolute().as_posix()  # no rule makes it

    def matlab(self, name: str) -> dict[str, Any]:
        """Settings of the MATLAB export: inputs "u" of the differential form or None, and the "file" that says so.

        Without a file, for a model that was put there or extends one, "u" is taken where the model names no inputs.
        """
        root = self._lineage(name)[-1]
        if root not in self.models:
            return {"file": None, "u": ["U_p", "U_q", "U_r"]}
        config = self.model(root)
        chosen = config["matlab"]
        u = chosen.get("DiffSys u", config["standalone"]["DiffSys u"])
        return {"file": f"config/models/{root}.json", "u": u if chosen["make moment DiffSys"] else None}

    def axes(self, name: str) -> list[str]:
        """Axes that a model identifies."""
        parameters = self.model(name)["identification parameters"]
        return [a for a in AXES if parameters[f"identify {a.lower()}"]]

    def axis(self, name: str, axis: str) -> dict[str, Any]:
        """Settings of the identification of one axis: its own candidates and switches only."""
        parameters = self.model(name)["identification parameters"]
        path, specification = self.specification(name)
        if axis not in specification:
            raise ConfigError(f"{path} holds no section '{axis}', but config/models/{name}.json identifies it; add one")
        return {
            "axis": axis,
            "bias": parameters[f"add bias term {axis.lower()}"],
            **parameters["polynomial"],
            "confidence level": parameters["prediction interval confidence level"],
            "specification": specification[axis],
            "specification file": path.name,
            "normalise": self.model(name)["data normalization"]["normalize data"],
            "model file": f"config/models/{name}.json",
        }

    def simulation(self, name: str) -> dict[str, Any]:
        """Settings of one simulation, and the paths of its model and tables ("wind", "reference", or None)."""
        settings = {k: v for k, v in self.simulation_settings(name).items() if k != "animation"}
        chosen, where = settings["model"], f"config/simulations/{name}.json"
        model = chosen["model ID"]
        folder = self.place(chosen["model path"]) / model
        path = folder / "standalone" / "model.json"
        if is_file(self._here(folder / "model.json")):
            path = folder / "model.json"
        elif folder.parts[:-1] == ("models",) and model not in self.models and not self.extended(model):
            if not is_file(self._here(path)):
                known = {*self.models, *(p.parts[-3] for p in self.root.glob("models/*/standalone/model.json"))}
                raise ConfigError(
                    f"{where}: 'model ID' is '{model}', but neither config/models/{model}.json nor {path} exists"
                    f"{nearest(model, known)}"
                )
            path = self._here(path).absolute()  # it was put there: no rule makes it
        elif folder.parts[:-1] == ("models",):
            pass  # the model is made when it is not there
        elif not is_file(self._here(path)):
            raise ConfigError(f"{where}: {path} does not exist; correct 'model path' or 'model ID'")
        tables = {"wind": settings["wind"]["file"], "reference": settings["references"].get("file")}
        found = {kind: str(self.place(file)) if file else None for kind, file in tables.items()}
        for kind, file in found.items():
            if file and not is_file(self._here(file)):
                raise ConfigError(f"{where}: the {kind}'s table {file} does not exist; correct 'file', or put it there")
        return {"name": name, "settings": settings, "model": path.as_posix(), **found}

    def animation(self, name: str) -> dict[str, Any]:
        """Settings of the animation of a simulation."""
        return self.simulation_settings(name)["animation"]

    def gap(self, name: str) -> dict[str, Any]:
        """Settings of a gap's jobs: its own, its flights by role, the airframe and its on-board logs."""
        settings = {k: v for k, v in self.gap_settings(name).items() if k != "logging file"}
        self.gap_model(name)
        rows, trained = self.gap_rows(name), self.gap_trained(name)
        part = self._part(rows[0], IDENTIFICATION)
        held = self.gap_flights(name)[HELD]
        return {
            "name": name,
            "file": f"config/gaps/{name}.json",
            "settings": settings,
            "effect files": [str(self.place(p)) for p in settings["effect files"]],
            "roles": self.gap_roles(name),
            "references": self.gap_references(name),
            "gravity": self.gap_gravity(name),
            "quadrotor": part["quadrotor"],
            "masses": {r.key: self.mass(r)[0] for r in rows},
            "sessions": {r.key: r.cells.get("Session", "") for r in rows},
            "recordings": {_named(r): log for r in rows if (log := self._log_of(r))},
            "held": {_named(r): log for r in held if (log := self._log_of(r))},
            "trained": {_named(r): log for r in trained if (log := self._log_of(r))},
            "held keys": {_named(r): r.key for r in held},
            "put there": self._lineage(settings["model"])[-1] not in self.models,
            "problem": part["problem"],
        }

    @functools.cache  # noqa: B019
    def inspection(self, kind: str, name: str) -> dict[str, Any]:
        """What is asked of the raw files of a model ("models"), a gap ("gaps"), or of all flights ("processing").

        Returns "name" for messages, "identifies", "flights" {"quadrotor/flight": {"role", "problem" of what the filter
        needs, "settings" of the import}}, and of a gap the recordings that must differ: held, trained, recordings.
        """
        if kind == "gaps":
            rows, roles = self.gap_rows(name), self.gap_roles(name)
        elif kind == "models":
            rows, roles = self.model_flights(name), {r.key: "training" for r in self.model_flights(name, "training")}
        else:
            rows, roles = self.processing_flights(), {}
        flights = {}
        for row in rows:
            settings = self.importing(row.quadrotor, row.key)
            flights[f"{row.quadrotor}/{row.key}"] = {
                "role": roles.get(row.key, "validation"),
                "problem": self.filtering(row.quadrotor, row.key)["problem"],
                "settings": {k: settings[k] for k in ("flight", "quadrotor", "problem")},
            }
        asked = {"models": f"model {name}", "gaps": f"gap {name}"}.get(kind, "processing")
        found = {"name": asked, "identifies": kind != "processing", "flights": flights}
        if kind == "gaps":
            settings = self.gap(name)
            found |= {k: settings[k] for k in ("held", "trained", "recordings")}
        return found

    def configured_work(self) -> tuple[dict[str, dict[str, Any]], dict[str, str], list[str]]:
        """{"processing", "model m", ...: its inspection} of what is configured, {name: fault} of the others, and the
        names of those whose files are as `quasi init` laid them and fit no flights yet."""
        asked, faults, untouched = {}, {}, []
        works = [("processing", "flights", "processing")]
        works += [("models", m, f"model {m}") for m in self.models] + [("gaps", g, f"gap {g}") for g in self.gaps]
        for kind, name, title in works:
            try:
                if kind == "models":
                    self.identification(name)
                    for axis in self.axes(name):
                        self.axis(name, axis)
                asked[title] = self.inspection(kind, name)
            except QuasiError as fault:
                if self._as_laid(f"config/{kind}/{name}.json"):
                    untouched.append(title)
                else:
                    faults[title] = str(fault)
        for name in self.simulations:
            try:
                self.simulation(name)
            except QuasiError as fault:
                faults[f"simulation {name}"] = str(fault)
        return asked, faults, untouched

    def _as_laid(self, path: str) -> bool:
        """Whether a configuration is the one that `quasi init` lays, unchanged."""
        laid = self.library / "config/template" / path
        return is_file(laid) and is_file(self._here(path)) and read_text(laid) == read_text(self._here(path))

    def to_be_made(self, settings: Mapping[str, Any]) -> bool:
        """Whether a raw file of a flight, of whose import these are the settings, is absent and a rule makes it."""
        files = [settings["flight"][k] for k in ("onboard", "capture")]
        return any(f and self._made(Path(f)) and not is_file(self._here(f)) for f in files)

    def _log_of(self, row: Row) -> list[str] | None:
        """On-board file of a row and the number of the log in it; None where the file is absent."""
        path = self.raw(row)["onboard"]
        return [path, row.cells.get("Log number", "")] if path else None

    @functools.cache  # noqa: B019
    def specification(self, name: str) -> tuple[Path, dict[str, Any]]:
        """Path and content of a model's polynomial specification file, the project's own before the standard ones."""
        given = self.model(name)["identification parameters"]["polynomial specification file"]
        base = self.place(given)
        base = with_suffix(base, ".json")
        folders = (self.root, self.root / "config/polynomials", self.library / "config/polynomials")
        for folder in folders:
            if is_file(folder / base):
                path = folder / base
                shown = path.relative_to(self.root) if path.is_relative_to(self.root) else path
                document = self._read(path.resolve() if folder is self.library else shown, "polynomials")
                check_specification(document, str(shown), self.model(name)["data normalization"]["normalize data"])
                return shown, document
        # the manual's own paths lead through its library; the standard file of that name is meant
        standard = self.library / "config/polynomials" / base.name
        if is_file(standard):
            return standard, self._read(standard.resolve(), "polynomials")
        known = [p.name for folder in folders[1:] for p in folder.glob("*.json")]
        raise ConfigError(
            f"config/models/{name}.json: polynomial specification file '{given}' does not exist"
            f"{nearest(base.name, known)}"
        )

    def changed_selection(self, name: str) -> str | None:
        """A sentence when an existing model's rows now mean other flights than those it was made from, else None."""
        path = self._here(f"results/identified/{name}/shared.json")
        if not path.is_file():
            return None
        try:
            before = list(read_json(path)["flights"]["training"])
        except (QuasiError, KeyError, TypeError):
            return None
        now = [r.key for r in self.model_flights(name, "training")]
        if set(before) == set(now):
            return None
        return (
            f"model {name}: the selected rows now mean the training flights {', '.join(now)}; it was made from "
            f"{', '.join(before)} and will be identified anew"
        )
