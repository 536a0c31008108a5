"""What a folder says of its gaps: a model, the flights it is compared with, the name it is extended under."""

import functools
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from quasi.errors import ConfigError, QuasiError, nearest
from quasi.project.folder import AXES, Project, check_model_file, is_file
from quasi.project.logbook import NAME, Row
from quasi.tables import read_json, read_text, sha256_of

HELD, COMPARED, REFERENCE = "held out", "compared", "reference"
FEWEST = 4  # training flights that stand for reference flights


class Comparisons(Project):
    """A project folder that compares models with flights."""

    @functools.cached_property
    def gaps(self) -> list[str]:
        """Names of the gaps that have a configuration."""
        return self._names("config/gaps")

    @functools.cache  # noqa: B019 - a Folder lives as long as the run
    def gap_settings(self, name: str) -> dict[str, Any]:
        """config/gaps/<name>.json, checked, with defaults. Raises ConfigError."""
        path = f"config/gaps/{name}.json"
        if name not in self.gaps:
            raise ConfigError(f"{path} does not exist{nearest(name, self.gaps)}")
        if not NAME.fullmatch(name):
            raise ConfigError(f"{path}: the name of a gap may hold letters, digits and . _ + - only; rename the file")
        settings = self._read(path, "gap")
        if settings["extended model ID"] is None:
            settings["extended model ID"] = f"{settings['model']}-{name}"
        ident = settings["extended model ID"]
        if not NAME.fullmatch(ident):
            raise ConfigError(f"{path}: 'extended model ID' is {ident!r}; use letters, digits and . _ + - only")
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
            if not is_file(self._here(self.place(file))):
                found = "is a folder" if Path(self._here(self.place(file))).is_dir() else "does not exist"
                raise ConfigError(
                    f"{path}: effect file {self.place(file)} {found}; correct 'effect files', or put the file there"
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

    @functools.cached_property
    def _extensions(self) -> tuple[dict[str, str], dict[str, QuasiError]]:
        """{gap: extended model ID} of sound configurations, {gap: fault} of the others."""
        idents, faults = {}, {}
        for gap in self.gaps:
            try:
                idents[gap] = self.gap_settings(gap)["extended model ID"]
            except QuasiError as fault:
                faults[gap] = fault  # it stops those who ask for the gap, or for its model
        return idents, faults

    @functools.cache  # noqa: B019
    def extended(self, model: str) -> str | None:
        """The gap that makes a model, or None. Raises ConfigError where several would make it, and the fault of the
        configuration that stands to make it."""
        idents, faults = self._extensions
        makers = [gap for gap, ident in idents.items() if ident == model]
        if len(makers) > 1:
            raise ConfigError(
                f"config/gaps/{makers[0]}.json and config/gaps/{makers[1]}.json both make the model '{model}'; "
                "give one another 'extended model ID'"
            )
        if not makers and model not in self.models:
            for gap, fault in faults.items():
                if self._would_make(gap, model):
                    raise fault
        return makers[0] if makers else None

    def _would_make(self, gap: str, model: str) -> bool:
        """Whether a gap with a faulty configuration stands to make a model, as far as that shows."""
        path = self._here(f"models/{model}/standalone/model.json")
        try:
            if is_file(path):  # else it was put there, whatever a gap says
                return read_json(path)["provenance"]["by"] == f"gap {gap}"
            given = read_text(self._here(f"config/gaps/{gap}.json"))  # which may be no JSON at all
            named = re.search(rf'"(?!model")[^"]*"\s*:\s*"{re.escape(model)}"', given)
            return model.endswith(f"-{gap}") or named is not None
        except (QuasiError, KeyError, TypeError):
            return False

    @functools.cache  # noqa: B019
    def gap_flights(self, name: str) -> dict[str, list[Row]]:
        """Rows by role: "compared" (to learn from), "held out", "reference". Raises LogbookError or ConfigError."""
        where = f"config/gaps/{name}.json"
        section = self.gap_settings(name)["logging file"]
        everything = self._rows(section, "rows of flights to compare (all)", where)
        numbers = {r.number for r in everything}
        held, reference = (
            self._rows(section, key, where) if section[key] else []
            for key in ("rows of flights held out", "rows of reference flights")
        )
        for row in held:
            if row.number not in numbers:
                raise ConfigError(
                    f"{where}: held-out row {row.number} is not among 'rows of flights to compare (all)'; add it there"
                )
        for row in reference:
            if row.number in numbers:
                raise ConfigError(
                    f"{where}: row {row.number} is compared and a reference flight; a flight can be one of both only"
                )
        out = {r.number for r in held}
        quadrotors = {r.quadrotor for r in (*everything, *reference) if not r.problem}
        if len(quadrotors) > 1:
            raise ConfigError(
                f"{where}: the rows mean several quadrotors ({', '.join(sorted(quadrotors))}); select one"
            )
        learning = [r for r in everything if r.number not in out]
        if not learning:
            raise ConfigError(
                f"{where}: every compared row is held out; leave some to learn from (two or more, that forces and "
                "moments can be asked)"
            )
        if not reference and section["training flights as reference"]:
            reference = self._select_unused_training(name, everything, quadrotors)
        return {COMPARED: learning, HELD: held, REFERENCE: reference}

    def _select_unused_training(self, name: str, compared: Sequence[Row], quadrotors: set[str]) -> list[Row]:
        """Select training flights that are not compared: as many as those, at least FEWEST, evenly spaced.

        An effect that they show too is one that the model always lacked.
        """
        try:
            trained = self.gap_trained(name)
        except QuasiError:
            return []  # who makes the model says what is wrong with it
        keys = {r.key for r in compared}
        unused = {r.key: r for r in trained if not r.problem and r.quadrotor in quadrotors and r.key not in keys}
        rows, most = list(unused.values()), max(len(compared), FEWEST)
        if len(rows) <= most:
            return rows
        return [rows[round(k * (len(rows) - 1) / (most - 1))] for k in range(most)]

    def gap_references(self, name: str) -> str:
        """Where reference flights come from: "given", "training" or "none"."""
        if self.gap_settings(name)["logging file"]["rows of reference flights"]:
            return "given"
        return "training" if self.gap_flights(name)[REFERENCE] else "none"

    def gap_roles(self, name: str) -> dict[str, str]:
        """{flight key: role}, reference flights first."""
        flights = self.gap_flights(name)
        return {r.key: role for role in (REFERENCE, COMPARED, HELD) for r in flights[role]}

    def gap_rows(self, name: str) -> list[Row]:
        """All rows of a gap, reference flights first."""
        flights = self.gap_flights(name)
        return [r for role in (REFERENCE, COMPARED, HELD) for r in flights[role]]

    def gap_model(self, name: str) -> str:
        """Path of the model that a gap looks at. Raises ConfigError where nothing makes it."""
        model, ident = (self.gap_settings(name)[key] for key in ("model", "extended model ID"))
        path = f"models/{model}/standalone/model.json"
        if model == ident:
            raise ConfigError(f"config/gaps/{name}.json: the extended model would be the model itself; rename it")
        self.extended(ident)  # another gap must not make it as well
        self._refuse_overwriting(name, ident)
        if model in self.models or self.extended(model):
            self._refuse_half_models(name, self._lineage(model)[-1])
            return path
        if is_file(self._here(path)):
            check_model_file(self._here(path), path)
            return self._here(path).absolute().as_posix()  # it was put there: no rule makes it
        raise ConfigError(
            f"config/gaps/{name}.json: 'model' is '{model}', but neither config/models/{model}.json nor {path} exists"
            f"{nearest(model, [*self.models, *self._extensions[0].values()])}"
        )

    def _refuse_half_models(self, name: str, root: str) -> None:
        """Raises ConfigError for a model without some of the six axes, before anything is computed for it."""
        chosen = self.model(root)["identification parameters"] if root in self.models else {}
        lacking = [a for a in AXES if not chosen.get(f"identify {a.lower()}", True)]
        if lacking:
            raise ConfigError(
                f"config/gaps/{name}.json: model '{root}' does not identify {', '.join(lacking)}, but a comparison "
                f"with flights needs all six axes; switch 'identify {lacking[0].lower()}' on in "
                f"config/models/{root}.json"
            )
        if root in self.models and self.model(root)["data normalization"]["normalize data"]:
            raise ConfigError(
                f"config/gaps/{name}.json: model '{root}' is normalised; a comparison with flights needs one that was "
                f"identified with 'normalize data' false in config/models/{root}.json"
            )

    def _refuse_overwriting(self, name: str, ident: str) -> None:
        """Raises ConfigError where a model that no gap made stands under the extended model's name."""
        path = f"models/{ident}/standalone/model.json"
        if not is_file(self._here(path)):
            return
        try:
            made = "extended from" in read_json(self._here(path)).get("provenance", {})
        except (QuasiError, AttributeError, TypeError):
            made = False
        if not made:
            raise ConfigError(
                f"config/gaps/{name}.json: 'extended model ID' is '{ident}', but {path} holds a model that no gap "
                "made; choose another, or remove that folder"
            )

    def _lineage(self, model: str) -> list[str]:
        """A model and those that it extends, itself first. Raises ConfigError for a circle."""
        line = [model]
        while (gap := self.extended(line[-1])) is not None:
            line.append(self.gap_settings(gap)["model"])
            if line[-1] in line[:-1]:
                raise ConfigError(
                    f"config/gaps/{gap}.json: the models {', '.join(line)} extend each other in a circle; "
                    "change one 'extended model ID'"
                )
        return line

    def gap_gravity(self, name: str) -> str:
        """withGravity or noGravity: the forces that a gap's model predicts."""
        root = self._lineage(self.gap_settings(name)["model"])[-1]
        if root in self.models:
            return self.gravity(root)
        try:
            return str(read_json(self._here(f"models/{root}/standalone/model.json"))["gravity"])
        except (QuasiError, KeyError, TypeError):
            return "withGravity"  # the job that reads the model says what is wrong with it

    def gap_trained(self, name: str) -> list[Row]:
        """Rows that trained the model, or chose and fitted what it was extended by."""
        rows: list[Row] = []
        for model in self._lineage(self.gap_settings(name)["model"]):
            gap = self.extended(model)
            if gap is not None:
                flights = self.gap_flights(gap)
                rows += flights[COMPARED] + flights[REFERENCE]
            elif model in self.models:
                rows += self.model_flights(model, "training")
        return rows


def same_recordings(held: Mapping[str, list[str]], trained: Mapping[str, list[str]]) -> tuple[str, str] | None:
    """The first held-out row whose recording also trained, by content, and that row; None where there is none.

    held, trained  {row: [path of its on-board log, number of the log in it]}
    """
    return _first_alike(held, {row: _content(*log) for row, log in trained.items()})


def refuse_trained(asked: Mapping[str, Any], document: Mapping[str, Any]) -> None:
    """Raise ConfigError where a held-out recording trained the model.

    asked  of `Folder.gap`; document  the model's
    Recordings are compared by content. An older model without recordings is compared by flight keys, where the
    quadrotor's configuration has the same name. For a model of this folder the rows are known (`same_recordings`).
    """
    recordings = list_model_recordings(document)
    known = {key: (about["sha256"], str(about.get("log") or ""), "") for key, about in recordings.items()}
    head = f"{asked['file']}: held-out"
    if twice := _first_alike(asked["held"], known):
        raise ConfigError(
            f"{head} {twice[0]} has the recording of flight {twice[1]}, which trained model {document['id']} by its "
            "model.json; hold out a flight that the model has never seen"
        )
    if not asked["put there"] or (document.get("airframe") or {}).get("name") != asked["quadrotor"]["file"]:
        return
    without_recording = set(_trained(document)) - set(recordings)
    for row, key in asked["held keys"].items():
        if key in without_recording:
            raise ConfigError(
                f"{head} {row} is flight {key}, and a flight of that name trained model {document['id']}, whose "
                "model.json does not list recordings; hold out another one, or, if it is not that flight, give it a "
                "name of its own in the logbook's column 'Flight key'"
            )


def unchecked(asked: Mapping[str, Any], document: Mapping[str, Any]) -> list[str]:
    """A note where it cannot be known by content whether a held-out flight trained the model. Arguments as above."""
    trained, recordings = _trained(document), list_model_recordings(document)
    if not asked["put there"] or not asked["held"] or (trained and set(trained) <= set(recordings)):
        return []
    return [
        f"whether a held-out flight trained model {document['id']} could not be checked by content: its model.json "
        "does not list the recordings of all training flights; build it again where possible"
    ]


def _trained(document: Mapping[str, Any]) -> list[str]:
    """Keys of the training flights that a model.json names, as far as they can be used."""
    given = document.get("flights")
    named = given.get("training") if isinstance(given, Mapping) else None
    return [k for k in named if isinstance(k, str)] if isinstance(named, Sequence) else []


def list_model_recordings(document: Mapping[str, Any]) -> dict[str, Mapping[str, str]]:
    """List the usable flights and recordings of a model.json, which may come from anybody."""
    given = document.get("recordings")
    given = given if isinstance(given, Mapping) else {}
    return {k: about for k, about in given.items() if isinstance(about, Mapping) and about.get("sha256")}


def _first_alike(held: Mapping[str, list[str]], known: Mapping[str, tuple[str, ...]]) -> tuple[str, str] | None:
    for row, log in held.items():
        content = _content(*log)
        for other, its in known.items():
            if _alike(content, its):
                return row, other
    return None


def recorded_twice(rows: Mapping[str, list[str]]) -> tuple[str, str] | None:
    """The first two rows that have one recording, by content; None where all differ. rows  as above

    A file that is absent, to be made or empty is known by its path.
    """
    sizes = {path: _size(path) for path, _ in rows.values()}
    often = Counter(sizes.values())
    # files of unlike sizes differ: only the others are read
    contents = {
        row: _content(path, number) if sizes[path] and often[sizes[path]] > 1 else (path, number, path)
        for row, (path, number) in rows.items()
    }
    return next((pair for pair in combinations(contents, 2) if _alike(*(contents[row] for row in pair))), None)


def repeated_recordings(asked: Mapping[str, Any]) -> list[str]:
    """Sentences on recordings that have two roles, by content, or that cannot be read.

    asked  "name", and of a gap "held", "trained" and "recordings", each {row: [path of its on-board log, number of the
           log in it]}
    """
    try:
        trained = same_recordings(asked.get("held", {}), asked.get("trained", {}))
        twice = recorded_twice(asked.get("recordings", {}))
    except QuasiError as fault:
        return [str(fault)]
    sentences = []
    if trained:
        sentences.append(
            f"{asked['name']}: held-out {trained[0]} has the recording of {trained[1]}, which trained its model; hold "
            "out a flight that the model has never seen"
        )
    if twice:
        sentences.append(
            f"{asked['name']}: {twice[0]} and {twice[1]} have the same recording, but each flight counts once and has "
            "one role; leave one out, or give each its own 'Log number' if the file holds several logs"
        )
    return sentences


def _size(path: str) -> int:
    return Path(path).stat().st_size if is_file(Path(path)) else 0


def _content(path: str, number: str) -> tuple[str, str, str]:
    return sha256_of(path), number, path


def _alike(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
    """Whether two logs (content, number, path) may be one; without a number it is the longest of its file."""
    return one[0] == other[0] and (one[1] == other[1] or "" in (one[1], other[1]))
