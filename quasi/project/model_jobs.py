"""Settings of the jobs that make a model and its exports.

Everything here returns plain data (Snakemake compares it to decide what is stale) and is small per job.
"""

import functools
import math
from pathlib import Path
from typing import Any

from quasi.airframe import read_airframe
from quasi.errors import ConfigError, QuasiError, nearest
from quasi.project.configurations import AXES, Configurations, check_model_file, check_specification
from quasi.project.flights import GEOMETRY, IDENTIFICATION, Recordings
from quasi.project.folder import Places, given_model_path, is_file, with_suffix
from quasi.project.gaps import HELD, Gaps, describe_change
from quasi.project.logbook import Row
from quasi.project.logbooks import Logbooks, name_row
from quasi.project.same_recordings import recorded_twice
from quasi.tables import read_json
from quasi.terms.normalisation import make_normalisation

STILLS = {"number of drone stills": 5, "show animation": False, "animation speed up factor": 1}


class ModelJobs:
    """Identification, assembly, exports and figures of models."""

    def __init__(
        self, places: Places, configuration: Configurations, logbooks: Logbooks, recordings: Recordings, gaps: Gaps
    ) -> None:
        self.places = places
        self.configuration = configuration
        self.logbooks = logbooks
        self.recordings = recordings
        self.gaps = gaps

    def identification(self, name: str) -> dict[str, Any]:
        """Settings that all axes of a model share."""
        training, everything = self.logbooks.model_flights(name, "training"), self.logbooks.model_flights(name)
        # a row whose configuration is absent or faulty fails in its own jobs, with its own sentence
        sound = [r for r in everything if self.recordings.quadrotor(r)[1] is None]
        files = {str(self.recordings.quadrotor_path(r)) for r in sound}
        if len(files) > 1:
            raise ConfigError(
                f"config/models/{name}.json: the rows name several quadrotor configurations "
                f"({', '.join(sorted(files))}); a model needs one"
            )
        self._refuse_one_recording(name, everything)
        part = self.recordings.quadrotor_part(next((r for r in training if r in sound), training[0]), IDENTIFICATION)
        self._refuse_missing_scales(name, training[0])
        batteries = self._batteries(name, training)  # a flight that is held out mixes nothing
        masses = [m for m, _ in map(self.recordings.mass, training) if m]
        return {
            "model": name,
            "quadrotor": part["quadrotor"],
            "mass": sum(masses) / len(masses) if masses else None,
            "flights": [r.key for r in training],
            "gravity": self.configuration.gravity(name),
            "data partitioning": self.partitioning(name),
            "isolation": self.isolation(name),
            "mixed batteries": batteries,
            "use unusable flights": name in self.configuration.models
            and self.configuration.model(name)["logging file"]["use unusable flights"],
            "problem": part["problem"],
        }

    def _refuse_missing_scales(self, name: str, row: Row) -> None:
        """Raises ConfigError where a normalised model's quadrotor lacks what its forces and moments are divided by."""
        config, problem = self.recordings.quadrotor(row)
        if (
            problem
            or name not in self.configuration.models
            or not self.configuration.model(name)["data normalization"]["normalize data"]
        ):
            return
        path, where = self.recordings.quadrotor_path(row), f"config/models/{name}.json"
        airframe = read_airframe(config, str(path), mass=math.nan)
        scales = {"idle RPM": airframe.idle_rpm, "max RPM": airframe.max_rpm, "motor poles": airframe.poles}
        if lacking := [f"'{key}'" for key, value in scales.items() if not value]:
            raise ConfigError(
                f"{where}: 'normalize data' needs {' and '.join(lacking)}, which {path} lacks; add what is missing, or "
                "set 'normalize data' to false"
            )
        make_normalisation(airframe, None, where)

    def _refuse_one_recording(self, name: str, rows: list[Row]) -> None:
        """Raises ConfigError for a flight that would train twice, or be judged by what it trained."""
        logs = {
            name_row(r): [str(self.places.here(log[0])), log[1]] for r in rows if (log := self.recordings.log_of(r))
        }
        if twice := recorded_twice(logs):
            raise ConfigError(
                f"config/models/{name}.json: {twice[0]} and {twice[1]} have the same recording, but each flight counts "
                "once, and trains or is held out; leave one out, or give each its own 'Log number' if the file holds "
                "several logs"
            )

    def partitioning(self, name: str) -> dict[str, Any]:
        """How the rows of a model's flights are drawn."""
        if self.gaps.maker_of(name):
            return {"random partition": False}
        return self.configuration.model(name)["data partitioning"]

    def isolation(self, name: str) -> dict[str, Any] | None:
        """Settings of the isolation of manoeuvres; None where it is off."""
        chosen = self.configuration.model(name)["manoeuvre excitations"]
        if not chosen["isolate to regions of excitation"]:
            return None
        return {k: chosen[k] for k in ("excitation threshold", "spread")}

    def _batteries(self, name: str, rows: list[Row]) -> list[str]:
        """Battery types of a model's training rows where they differ and may. Raises ConfigError where they may not."""
        kinds = sorted({r.cells.get("Batteries", "") for r in rows} - {""})
        if len(kinds) > 1 and not self.configuration.model(name)["logging file"]["allow mixed batteries"]:
            raise ConfigError(
                f"config/models/{name}.json: the training flights were flown with different 'Batteries' "
                f"({', '.join(kinds)}); select flights with one battery type, hold the others out for validation, or "
                "set 'allow mixed batteries' in 'logging file' to true"
            )
        return kinds if len(kinds) > 1 else []

    def trajectories(self, name: str) -> dict[str, Any]:
        """Settings of the trajectory figures of a model."""
        gap = self.gaps.maker_of(name)
        row = self.gaps.rows(gap)[0] if gap else self.logbooks.model_flights(name, "training")[0]
        chosen = (self.configured(name) or {"plotting": STILLS})["plotting"]
        return {**self._drawing(row, chosen), "animate": chosen["show animation"]}

    def flight_trajectory(self, quadrotor: str, flight: str) -> dict[str, Any]:
        """Settings of the trajectory figure and the animation of one flight, which no model needs to name."""
        row = self.logbooks.row(quadrotor, flight)
        return {**self._drawing(row, self.configuration.processing["plotting"]), "flight": flight}

    def _drawing(self, row: Row, chosen: dict[str, Any]) -> dict[str, Any]:
        """Quadrotor, mass, stills and speed of a drawn trajectory. chosen  the section 'plotting'"""
        return {
            **self.recordings.quadrotor_part(row, GEOMETRY),
            "mass": self.recordings.mass(row)[0],
            "stills": chosen["number of drone stills"],
            "speed up": chosen["animation speed up factor"],
        }

    def configured(self, name: str) -> dict[str, Any] | None:
        """Configuration of a model, or of the one that it extends; None where that was put there."""
        root = self.gaps.lineage(name)[-1]
        return (
            self.configuration.model(root)
            if root in self.configuration.models or not self.gaps.maker_of(name)
            else None
        )

    def roles(self, name: str) -> dict[str, list[str]]:
        """Keys of a model's training and validation flights."""
        if gap := self.gaps.maker_of(name):
            roles = self.gaps.roles(gap)
            return {
                "training": [k for k, role in roles.items() if role != HELD],
                "validation": [k for k, role in roles.items() if role == HELD],
            }
        return {role: [r.key for r in self.logbooks.model_flights(name, role)] for role in ("training", "validation")}

    def standalone(self, name: str) -> dict[str, Any]:
        """Settings of the assembly of a model."""
        config = self.configured(name)
        if config is None:
            return {"file": None, "u": None}
        chosen = config["standalone"]
        return {
            "file": f"config/models/{self.gaps.lineage(name)[-1]}.json",
            "u": chosen["DiffSys u"] if chosen["make moment DiffSys"] else None,
        }

    def portable(self, name: str) -> str:
        """Path of a model's model.json, which rules make or a user has put there."""
        path = Path("models") / name / "standalone" / "model.json"
        if name in self.configuration.models or self.gaps.maker_of(name):
            return path.as_posix()
        if not is_file(self.places.here(path)):
            raise ConfigError(
                f"neither config/models/{name}.json nor {path} exists{nearest(name, self.configuration.models)}; make "
                "the model first"
            )
        check_model_file(self.places.here(path), str(path))
        return given_model_path(name)

    def matlab(self, name: str) -> dict[str, Any]:
        """Settings of the MATLAB export: inputs "u" of the differential form or None, and the "file" that says so.

        Without a file, for a model that was put there or extends one, "u" is taken where the model names no inputs.
        """
        root = self.gaps.lineage(name)[-1]
        if root not in self.configuration.models:
            return {"file": None, "u": ["U_p", "U_q", "U_r"]}
        config = self.configuration.model(root)
        chosen = config["matlab"]
        u = chosen.get("DiffSys u", config["standalone"]["DiffSys u"])
        return {"file": f"config/models/{root}.json", "u": u if chosen["make moment DiffSys"] else None}

    def axes(self, name: str) -> list[str]:
        """Axes that a model identifies."""
        parameters = self.configuration.model(name)["identification parameters"]
        return [a for a in AXES if parameters[f"identify {a.lower()}"]]

    def axis(self, name: str, axis: str) -> dict[str, Any]:
        """Settings of the identification of one axis: its own candidates and switches only."""
        parameters = self.configuration.model(name)["identification parameters"]
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
            "normalise": self.configuration.model(name)["data normalization"]["normalize data"],
            "model file": f"config/models/{name}.json",
        }

    @functools.cache  # noqa: B019
    def specification(self, name: str) -> tuple[Path, dict[str, Any]]:
        """Path and content of a model's polynomial specification file, the project's own before the standard ones."""
        given = self.configuration.model(name)["identification parameters"]["polynomial specification file"]
        base = self.places.place(given)
        base = with_suffix(base, ".json")
        folders = (
            self.places.root,
            self.places.root / "config/polynomials",
            self.places.library / "config/polynomials",
        )
        for folder in folders:
            if is_file(folder / base):
                path = folder / base
                shown = path.relative_to(self.places.root) if path.is_relative_to(self.places.root) else path
                document = self.places.read(path.resolve() if folder is self.places.library else shown, "polynomials")
                check_specification(
                    document, str(shown), self.configuration.model(name)["data normalization"]["normalize data"]
                )
                return shown, document
        # the manual's own paths lead through its library; the standard file of that name is meant
        standard = self.places.library / "config/polynomials" / base.name
        if is_file(standard):
            return standard, self.places.read(standard.resolve(), "polynomials")
        known = [p.name for folder in folders[1:] for p in folder.glob("*.json")]
        raise ConfigError(
            f"config/models/{name}.json: polynomial specification file '{given}' does not exist"
            f"{nearest(base.name, known)}"
        )

    def changed_selection(self, name: str) -> list[str]:
        """Sentences where an existing model's rows now mean other flights than those it was made from or judged by."""
        roles = self.roles(name)
        trained = self._made(f"results/identified/{name}/shared.json")
        before = trained.get("selected")
        if before is None:  # an older file lists no flight that was unusable
            before = trained.get("training")
            before = None if before and set(before) < set(roles["training"]) else before
        judged = self._made(f"results/parts/standalone/{name}/model.json").get("validation")
        found = (
            describe_change(f"model {name}", "training", roles["training"], before, "was made from", "identified"),
            describe_change(f"model {name}", "validation", roles["validation"], judged, "was judged by", "judged"),
        )
        return [sentence for sentence in found if sentence]

    def _made(self, path: str) -> dict[str, list[str]]:
        """The flights by role of a file that a job made; {} where it is absent or unreadable."""
        try:
            flights = dict(read_json(self.places.here(path))["flights"]).items()
        except (QuasiError, OSError, KeyError, TypeError, ValueError):
            return {}
        return {
            role: keys for role, keys in flights if isinstance(keys, list) and all(isinstance(k, str) for k in keys)
        }
