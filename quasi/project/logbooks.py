"""The logbooks of a project folder, and the flights that a selection of rows means."""

import functools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from quasi.errors import ConfigError, LogbookError, QuasiError, nearest
from quasi.project.configurations import Configurations
from quasi.project.folder import Places, is_file, with_suffix
from quasi.project.logbook import Row, apart, pick, read_logbook

KEY_OF_ROWS = "rows of flights to use (all)"


def name_row(row: Row) -> str:
    """A row as messages name it."""
    return f"row {row.number} of {row.logbook}"


def require_one_quadrotor(rows: Iterable[Row], where: str) -> set[str]:
    """The name of the quadrotor of some rows, none where no row can be used. Raises ConfigError for several."""
    quadrotors = {r.quadrotor for r in rows if not r.problem}  # a row that names no quadrotor fails in its own jobs
    if len(quadrotors) > 1:
        raise ConfigError(f"{where}: the rows mean several quadrotors ({', '.join(sorted(quadrotors))}); select one")
    return quadrotors


class Logbooks:
    """Rows of the logbooks that the configurations name."""

    def __init__(self, places: Places, configuration: Configurations) -> None:
        self.places = places
        self.configuration = configuration

    def logbook(self, directory: str, filename: str, where: str) -> dict[int, Row]:
        """Rows of a logbook by number; `where` is the configuration that names it, for messages."""
        path = self.places.settled(self._logbook_path(directory, filename))
        if not is_file(self.places.here(path)):
            known = [p.name for p in self.places.here(path.parent).glob("*.csv")] if len(str(path)) < 1000 else []
            raise ConfigError(
                f"{where}: logbook {path} does not exist{self.places.describe_other_place(path)}"
                f"{nearest(path.name, known)}; correct 'directory' or 'filename' in 'logging file', or "
                "save the logbook there as CSV"
            )
        return self._rows_of(path)

    @functools.cache  # noqa: B019
    def _rows_of(self, path: Path) -> dict[int, Row]:
        notices: list[str] = []
        try:
            rows = read_logbook(self.places.here(path), notices)
        except QuasiError as error:
            raise type(error)(str(error).replace(str(self.places.here(path)), str(path))) from None
        self.places.notices += [n.replace(str(self.places.here(path)), str(path)) for n in notices]
        return rows

    @staticmethod
    def _logbook_path(directory: str, filename: str) -> Path:
        return with_suffix(Path(directory.replace("\\", "/")) / filename, ".csv")

    def select(self, section: Mapping[str, Any], key: str, where: str) -> list[Row]:
        """Rows that one key of a section 'logging file' selects. where  the configuration, for messages"""
        directory, filename = section["directory"], section["filename"]
        book = self.logbook(directory, filename, where)
        return pick(book, section[key], f"{where}, '{key}'", str(self._logbook_path(directory, filename)))

    @functools.cached_property
    def flights(self) -> dict[tuple[str, str], Row]:
        """{(quadrotor, flight key): row} over every logbook that a configuration of the folder names."""
        books: dict[tuple[str, str], dict[int, Row]] = {}
        asked = (
            [("processing", "")]
            + [("models", m) for m in self.configuration.models]
            + [("gaps", g) for g in self.places.names("config/gaps")]
        )
        for kind, name in asked:
            where = f"config/{kind}/{name}.json" if name else "config/processing.json"
            try:
                section = self._section(kind, name)
                chosen = (section["directory"], section["filename"])
                books[chosen] = self.logbook(*chosen, where)
            except QuasiError:
                if not name and is_file(self.places.here(where)):
                    raise
                continue  # a broken model stops those who ask for it, not the others
        found: dict[tuple[str, str], Row] = {}
        for book in books.values():
            for row in book.values():
                other = found.setdefault((row.quadrotor, row.key), row)
                if other.logbook != row.logbook and other.read_cells() != row.read_cells():
                    raise LogbookError(
                        f"{other.logbook} row {other.number} and {row.logbook} row {row.number} both mean flight "
                        f"'{row.key}' of {row.quadrotor}; {apart(row, other)}"
                    )
        return found

    def row_names(self) -> dict[str, str]:
        """{"quadrotor/flight": its row as messages name it}; no setting of a job, for a moved row changes nothing."""
        return {row.flight: name_row(row) for row in self.flights.values()}

    def _section(self, kind: str, name: str) -> Mapping[str, Any]:
        """The part of a configuration that names logbook and rows."""
        if kind == "gaps":
            return self.places.read(f"config/gaps/{name}.json", "gap")["logging file"]
        return (self.configuration.model(name) if kind == "models" else self.configuration.processing)["logging file"]

    def processing_flights(self) -> list[Row]:
        """The flights that config/processing.json selects (all of the logbook when it selects none)."""
        section, key, where = self.configuration.processing["logging file"], KEY_OF_ROWS, "config/processing.json"
        every = self.logbook(section["directory"], section["filename"], where)
        return self.select({key: list(every), **section}, key, where)

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
        section = self.configuration.model(name)["logging file"]
        everything = self.select(section, KEY_OF_ROWS, where)
        held = []
        if section["rows of flights for validation"]:
            held = self.select(section, "rows of flights for validation", where)
        numbers = {r.number for r in everything}
        for row in held:
            if row.number not in numbers:
                raise ConfigError(f"{where}: validation row {row.number} is not among '{KEY_OF_ROWS}'; add it there")
        out = {r.number for r in held}
        training = [r for r in everything if r.number not in out]
        if not training:
            raise ConfigError(f"{where}: every row is held out for validation; leave at least one for training")
        require_one_quadrotor(everything, where)
        return {"all": everything, "training": training, "validation": held}[role]
