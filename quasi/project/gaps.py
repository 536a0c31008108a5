"""The gaps of a project folder: a model, the flights it is compared with, the name it is extended under."""

import functools
import re
from collections.abc import Mapping, Sequence
from typing import Any

from quasi.errors import ConfigError, QuasiError, nearest, quoted
from quasi.input_limits import MAX_NAME_CHARACTERS
from quasi.project.configurations import AXES, Configurations, check_model_file
from quasi.project.folder import Places, given_model_path, is_file
from quasi.project.logbook import Row
from quasi.project.logbooks import Logbooks, require_one_quadrotor
from quasi.tables import read_json, read_text

HELD, COMPARED, REFERENCE = "held out", "compared", "reference"

FEWEST_REFERENCES = 4  # training flights that stand for reference flights


def describe_run_code(asked: Mapping[str, Any]) -> str | None:
    """Notice that names the effect files of a gap, which run as code; None without any. asked  of `Folder.gap`"""
    if not asked["effect files"]:
        return None
    files = ", ".join(quoted(path, MAX_NAME_CHARACTERS) for path in asked["effect files"])
    return f"{asked['file']} runs Python code: effect files {files}; name only files that you trust"


def describe_change(
    subject: str, role: str, now: Sequence[str], before: Sequence[str] | None, since: str, anew: str
) -> str | None:
    """Sentence where the selected rows mean other flights than before; None where they are the same or not known.

    now, before  flight keys, None where not known; since, anew  what was done with those before, what will be again
    """
    if before is None or set(before) == set(now):
        return None
    listed, earlier = (", ".join(keys) or "none" for keys in (now, before))
    return (
        f"{subject}: the selected rows now mean the {role} flights {listed}; it {since} {earlier} and will be "
        f"{anew} anew"
    )


class Gaps:
    """Models that gaps compare and make, and the flights of each gap by role."""

    def __init__(self, places: Places, configuration: Configurations, logbooks: Logbooks) -> None:
        self.places = places
        self.configuration = configuration
        self.logbooks = logbooks

    @functools.cached_property
    def extensions(self) -> tuple[dict[str, str], dict[str, QuasiError]]:
        """{gap: extended model ID} of sound configurations, {gap: fault} of the others."""
        idents, faults = {}, {}
        for gap in self.configuration.gaps:
            try:
                idents[gap] = self.configuration.gap(gap)["extended model ID"]
            except QuasiError as fault:
                faults[gap] = fault  # it stops those who ask for the gap, or for its model
        return idents, faults

    @functools.cache  # noqa: B019
    def maker_of(self, model: str) -> str | None:
        """The gap that makes a model, or None. Raises ConfigError where several would make it, and the fault of the
        configuration that stands to make it."""
        idents, faults = self.extensions
        makers = [gap for gap, ident in idents.items() if ident == model]
        if len(makers) > 1:
            raise ConfigError(
                f"config/gaps/{makers[0]}.json and config/gaps/{makers[1]}.json both make the model '{model}'; "
                "give one another 'extended model ID'"
            )
        if not makers and model not in self.configuration.models:
            for gap, fault in faults.items():
                if self._would_make(gap, model):
                    raise fault
        return makers[0] if makers else None

    def _would_make(self, gap: str, model: str) -> bool:
        """Whether a gap with a faulty configuration stands to make a model, as far as that shows."""
        path = self.places.here(f"models/{model}/standalone/model.json")
        try:
            if is_file(path):  # else it was put there, whatever a gap says
                return read_json(path)["provenance"]["by"] == f"gap {gap}"
            given = read_text(self.places.here(f"config/gaps/{gap}.json"))  # which may be no JSON at all
            named = re.search(rf'"(?!model")[^"]*"\s*:\s*"{re.escape(model)}"', given)
            return model.endswith(f"-{gap}") or named is not None
        except (QuasiError, KeyError, TypeError):
            return False

    @functools.cache  # noqa: B019
    def flights(self, name: str) -> dict[str, list[Row]]:
        """Rows by role: "compared" (to learn from), "held out", "reference". Raises LogbookError or ConfigError."""
        where = f"config/gaps/{name}.json"
        section = self.configuration.gap(name)["logging file"]
        everything = self.logbooks.select(section, "rows of flights to compare (all)", where)
        numbers = {r.number for r in everything}
        held, reference = (
            self.logbooks.select(section, key, where) if section[key] else []
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
        quadrotors = require_one_quadrotor((*everything, *reference), where)
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
        """Select training flights that are not compared: as many as those, at least FEWEST_REFERENCES, evenly spaced.

        An effect that they show too is one that the model always lacked.
        """
        try:
            trained = self.trained(name)
        except QuasiError:
            return []  # who makes the model says what is wrong with it
        keys = {r.key for r in compared}
        unused = {r.key: r for r in trained if not r.problem and r.quadrotor in quadrotors and r.key not in keys}
        rows, most = list(unused.values()), max(len(compared), FEWEST_REFERENCES)
        if len(rows) <= most:
            return rows
        return [rows[round(k * (len(rows) - 1) / (most - 1))] for k in range(most)]

    def references(self, name: str) -> str:
        """Where reference flights come from: "given", "training" or "none"."""
        if self.configuration.gap(name)["logging file"]["rows of reference flights"]:
            return "given"
        return "training" if self.flights(name)[REFERENCE] else "none"

    def roles(self, name: str) -> dict[str, str]:
        """{flight key: role}, reference flights first."""
        flights = self.flights(name)
        return {r.key: role for role in (REFERENCE, COMPARED, HELD) for r in flights[role]}

    def changed_selection(self, name: str) -> list[str]:
        """Sentences where an existing diagnosis was made from other flights than the rows of the gap now mean."""
        try:
            before = dict(read_json(self.places.here(f"results/gaps/{name}/diagnosis.json"))["flights"])
        except (QuasiError, OSError, KeyError, TypeError, ValueError):
            return []
        roles, found = self.roles(name), []
        for role, shown in ((REFERENCE, REFERENCE), (COMPARED, COMPARED), (HELD, "held-out")):
            now, earlier = ([key for key, its in each.items() if its == role] for each in (roles, before))
            found.append(describe_change(f"gap {name}", shown, now, earlier, "was made from", "made"))
        return [sentence for sentence in found if sentence]

    def rows(self, name: str) -> list[Row]:
        """All rows of a gap, reference flights first."""
        flights = self.flights(name)
        return [r for role in (REFERENCE, COMPARED, HELD) for r in flights[role]]

    def model_path(self, name: str) -> str:
        """Path of the model that a gap looks at. Raises ConfigError where nothing makes it."""
        model, ident = (self.configuration.gap(name)[key] for key in ("model", "extended model ID"))
        path = f"models/{model}/standalone/model.json"
        if model == ident:
            raise ConfigError(f"config/gaps/{name}.json: the extended model would be the model itself; rename it")
        self.maker_of(ident)  # another gap must not make it as well
        self._refuse_overwriting(name, ident)
        if model in self.configuration.models or self.maker_of(model):
            self._refuse_half_models(name, self.lineage(model)[-1])
            return path
        if is_file(self.places.here(path)):
            check_model_file(self.places.here(path), path)
            return given_model_path(model)
        others = [made for gap, made in self.extensions[0].items() if gap != name]
        raise ConfigError(
            f"config/gaps/{name}.json: 'model' is '{model}', but neither config/models/{model}.json nor {path} exists"
            f"{nearest(model, [*self.configuration.models, *others])}"
        )

    def _refuse_half_models(self, name: str, root: str) -> None:
        """Raises ConfigError for a model without some of the six axes, before anything is computed for it."""
        chosen = (
            self.configuration.model(root)["identification parameters"] if root in self.configuration.models else {}
        )
        lacking = [a for a in AXES if not chosen.get(f"identify {a.lower()}", True)]
        if lacking:
            raise ConfigError(
                f"config/gaps/{name}.json: model '{root}' does not identify {', '.join(lacking)}, but a comparison "
                f"with flights needs all six axes; switch 'identify {lacking[0].lower()}' on in "
                f"config/models/{root}.json"
            )
        if root in self.configuration.models and self.configuration.model(root)["data normalization"]["normalize data"]:
            raise ConfigError(
                f"config/gaps/{name}.json: model '{root}' is normalised; a comparison with flights needs one that was "
                f"identified with 'normalize data' false in config/models/{root}.json"
            )

    def _refuse_overwriting(self, name: str, ident: str) -> None:
        """Raises ConfigError where a model that no gap made stands under the extended model's name."""
        path = f"models/{ident}/standalone/model.json"
        if not is_file(self.places.here(path)):
            return
        try:
            made = "extended from" in read_json(self.places.here(path)).get("provenance", {})
        except (QuasiError, AttributeError, TypeError):
            made = False
        if not made:
            raise ConfigError(
                f"config/gaps/{name}.json: 'extended model ID' is '{ident}', but {path} holds a model that no gap "
                "made; choose another, or remove that folder"
            )

    def lineage(self, model: str) -> list[str]:
        """A model and those that it extends, itself first. Raises ConfigError for a circle."""
        line = [model]
        while (gap := self.maker_of(line[-1])) is not None:
            line.append(self.configuration.gap(gap)["model"])
            if line[-1] in line[:-1]:
                raise ConfigError(
                    f"config/gaps/{gap}.json: the models {', '.join(line)} extend each other in a circle; "
                    "change one 'extended model ID'"
                )
        return line

    def gravity(self, name: str) -> str:
        """withGravity or noGravity: the forces that a gap's model predicts."""
        root = self.lineage(self.configuration.gap(name)["model"])[-1]
        if root in self.configuration.models:
            return self.configuration.gravity(root)
        try:
            return str(read_json(self.places.here(f"models/{root}/standalone/model.json"))["gravity"])
        except (QuasiError, KeyError, TypeError):
            return "withGravity"  # the job that reads the model says what is wrong with it

    def trained(self, name: str) -> list[Row]:
        """Rows that trained the model, or chose and fitted what it was extended by."""
        rows: list[Row] = []
        for model in self.lineage(self.configuration.gap(name)["model"]):
            gap = self.maker_of(model)
            if gap is not None:
                flights = self.flights(gap)
                rows += flights[COMPARED] + flights[REFERENCE]
            elif model in self.configuration.models:
                rows += self.logbooks.model_flights(model, "training")
        return rows
