"""What the rules need to know of a project folder: models, flights, raw files, and the settings of each job.

Everything here returns plain data (Snakemake compares it to decide what is stale) and is small per job: a flight's
stage gets its own row, its own files and the part of the configuration that it reads, never the whole logbook.
"""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quasi import configuration
from quasi.errors import ConfigError, LogbookError, QuasiError, nearest
from quasi.logbook import NAME, Row, pick, read_logbook
from quasi.tables import read_json

BINARY = (".bbl", ".BBL", ".bfl", ".BFL")
TEXT = (".csv", ".CSV")
WIND = (".lvm", ".LVM", ".txt", ".csv")
TABLE = (".csv", ".CSV", ".parquet", ".Parquet")
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")

# What of a quadrotor configuration each stage reads: a change elsewhere in the file reruns nothing.
GEOMETRY = (
    "rotor config",
    "rotor1 rotation direction",
    "rotor radius",
    "b",
    "moment of inertia",
    "rotor positions",
    "rotor rotation directions",
)
IMPORTING = (
    *GEOMETRY,
    "optitrack marker cg offset",
    "motor poles",
    "imu position",
    "idle RPM",
    "max RPM",
    "table columns",
    "betaflight raw acceleration correction factor",
)
FILTERING = (*GEOMETRY, "motor poles", "idle RPM", "max RPM", "(estimated) imu sensor noise statistics")
IDENTIFICATION = (*GEOMETRY, "motor poles", "idle RPM", "max RPM")


class Folder:
    """A project folder: config/ and data/ in, results/ and models/ out.

    root  the folder; data  what replaces the prefix `data/` of raw paths (`--config data=PATH`), or None;
    library  the folder that holds quasi's own config/polynomials.
    """

    def __init__(self, root: str | Path = ".", data: str | Path | None = None, library: str | Path | None = None):
        self.root = Path(root)
        self.data = str(data) if data else None
        self.library = Path(library) if library else Path(__file__).parent.parent
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
        """Path of a logbook or quadrotor configuration: the folder's own file first, else with `data/` replaced."""
        return Path(path) if self._here(path).is_file() else self.place(str(path))

    def _read(self, path: str | Path, kind: str) -> dict[str, Any]:
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
        return sorted(p.stem for p in self._here("config/models").glob("*.json"))

    @functools.cached_property
    def campaigns(self) -> list[str]:
        """Campaigns of made flights that have a configuration."""
        return sorted(p.stem for p in self._here("config/synthesis").glob("*.json"))

    @functools.cache  # noqa: B019 - a Folder lives as long as the run
    def model(self, name: str) -> dict[str, Any]:
        """config/models/<name>.json, checked, with defaults. Raises ConfigError."""
        path = f"config/models/{name}.json"
        if name not in self.models:
            raise ConfigError(f"{path} does not exist{nearest(name, self.models)}")
        if not NAME.fullmatch(name):
            raise ConfigError(f"{path}: a model ID may hold letters, digits and . _ + - only; rename the file")
        config = self._read(path, "model")
        given = config.get("saving models", {}).get("model ID", name)
        if given != name:
            raise ConfigError(f"{path}: 'model ID' is '{given}', but the file's name says '{name}'; make them equal")
        if config["data normalization"]["normalize data"]:
            raise ConfigError(f"{path}: 'normalize data' true is not offered by this version; set it to false")
        if config["manoeuvre excitations"]["isolate to regions of excitation"]:
            raise ConfigError(
                f"{path}: 'isolate to regions of excitation' true is not offered by this version; set it to false"
            )
        axes = [a for a in AXES if config["identification parameters"][f"identify {a.lower()}"]]
        if not axes:
            raise ConfigError(f"{path}: every 'identify ...' is false; switch at least one on")
        return config

    @functools.cache  # noqa: B019
    def campaign(self, name: str) -> dict[str, Any]:
        """config/synthesis/<name>.json, checked, with defaults. Raises ConfigError."""
        if name not in self.campaigns:
            raise ConfigError(f"config/synthesis/{name}.json does not exist{nearest(name, self.campaigns)}")
        return self._read(f"config/synthesis/{name}.json", "synthesis")

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

    @functools.cache  # noqa: B019
    def logbook(self, directory: str, filename: str) -> dict[int, Row]:
        """Rows of a logbook by number."""
        path = self._settled(self._logbook_path(directory, filename))
        try:
            return read_logbook(self._here(path))
        except QuasiError as error:
            raise type(error)(str(error).replace(str(self._here(path)), str(path))) from None

    @staticmethod
    def _logbook_path(directory: str, filename: str) -> Path:
        path = Path(directory.replace("\\", "/")) / filename
        return path if path.suffix.lower() == ".csv" else path.with_name(path.name + ".csv")

    def _rows(self, section: Mapping[str, Any], key: str, where: str) -> list[Row]:
        directory, filename = section["directory"], section["filename"]
        book = self.logbook(directory, filename)
        return pick(book, section[key], f"{where}, '{key}'", str(self._logbook_path(directory, filename)))

    @functools.cached_property
    def flights(self) -> dict[tuple[str, str], Row]:
        """{(quadrotor, flight key): row} over every logbook that a configuration of the folder names."""
        sections = []
        if self._here("config/processing.json").is_file():
            sections.append(self.processing["logging file"])
        for name in self.models:
            try:
                sections.append(self.model(name)["logging file"])
            except ConfigError:
                continue  # a broken model stops those who ask for it, not the others
        found: dict[tuple[str, str], Row] = {}
        for directory, filename in dict.fromkeys((s["directory"], s["filename"]) for s in sections):
            for row in self.logbook(directory, filename).values():
                other = found.setdefault((row.quadrotor, row.key), row)
                if other.logbook != row.logbook and other.cells != row.cells:
                    raise LogbookError(
                        f"{other.logbook} row {other.number} and {row.logbook} row {row.number} both mean flight "
                        f"'{row.key}' of {row.quadrotor}; give one another name in the optional column 'Flight key'"
                    )
        return found

    def processing_flights(self) -> list[Row]:
        """The flights that config/processing.json selects (all of the logbook when it selects none)."""
        section = self.processing["logging file"]
        if "rows of flights to use (all)" in section:
            return self._rows(section, "rows of flights to use (all)", "config/processing.json")
        return list(self.logbook(section["directory"], section["filename"]).values())

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
        quadrotors = {r.quadrotor for r in everything}
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

    # raw files of one flight

    def raw(self, row: Row) -> dict[str, Any]:
        """Paths of the "onboard" and "capture" files, found or to be made, or None, and a "problem" or None."""
        controller = self.controller(row)
        suffixes = TABLE if controller == "table" else (*BINARY, *TEXT)
        onboard, problem = self._find(row, "OB Path", "Onboard Name", suffixes)
        capture = None
        if row.has("Has OT data"):
            if not row.cells.get("Raw OptiTrack Name"):
                problem = problem or (
                    f"{row.logbook} row {row.number}: 'Has OT data' is yes but 'Raw OptiTrack Name' is empty; "
                    "fill it in"
                )
            else:
                capture, missing = self._find(row, "Raw OT Path", "Raw OptiTrack Name", TEXT)
                problem = problem or missing
        return {"onboard": onboard, "capture": capture, "problem": row.problem or problem}

    def controller(self, row: Row) -> str:
        """betaflight, indiflight or table: the logbook's cell, else the quadrotor configuration's."""
        name = row.cells["Flight controller"].lower()
        if not name:
            config, _ = self._quadrotor(row)
            name = str(config.get("flight controller", "")).lower()
        return {"cleanflight": "betaflight"}.get(name, name)

    def wind(self, row: Row) -> tuple[dict[str, Any] | None, str | None]:
        """Wind of a flight: its record, static speed (m/s), clock offset (s) and direction; None in still air.

        A static wind other than 0 counts even where 'Has OJF data' is no, for it needs no record. The second part is a
        sentence when a cell cannot be read, or the record is absent and no static wind stands in.
        """
        try:
            static = row.number_in("Static wind (m/s)")
            if not row.has("Has OJF data") and not static:
                return None, None
            wind: dict[str, Any] = {
                "file": None,
                "file problem": None,
                "static": static,
                "time offset": row.number_in("OptiTrack time offset (s)") or 0.0,
                "towards": row.number_in("Wind towards (deg)") or 0.0,
            }
            for column in ("Static wind (m/s)", "OptiTrack time offset (s)", "Wind towards (deg)"):
                if not abs(row.number_in(column) or 0.0) < 1e6:
                    raise LogbookError(f"{row.logbook} row {row.number}: '{column}' is not finite; correct the cell")
        except LogbookError as error:
            return None, str(error)
        if row.has("Has OJF data") and row.cells.get("OJF name"):
            wind["file"], wind["file problem"] = self._find(row, "OJF path", "OJF name", WIND)
        elif static is None:
            return None, (
                f"{row.logbook} row {row.number}: 'Has OJF data' is yes, but neither 'OJF name' nor "
                "'Static wind (m/s)' is given; fill in one"
            )
        return wind, wind["file problem"] if static is None else None

    def _find(self, row: Row, folder: str, name: str, suffixes: tuple[str, ...]) -> tuple[str | None, str | None]:
        base = self.place(row.cells.get(folder, "")) / row.cells[name]
        if base.suffix in suffixes:
            candidates = [base]
        else:
            candidates = [base.with_name(base.name + s) for s in suffixes]
        for path in candidates:
            if self._here(path).is_file() or self._made(path):
                return str(path), None
        expected = str(candidates[0]) if len(candidates) == 1 else f"{base}[{'|'.join(dict.fromkeys(suffixes))}]"
        return None, (
            f"{row.logbook} row {row.number}, flight {row.key}: raw file {expected} does not exist; "
            f"correct '{name}' or '{folder}' in the logbook, or copy the file there"
        )

    def _made(self, path: Path) -> bool:
        """Whether the synthesis stage makes this raw file."""
        parts = path.parts
        if len(parts) != 5 or parts[:2] != ("results", "synthesis") or parts[2] not in self.campaigns:
            return False
        kind = {"onboard": ".bbl", "optitrack": ".csv"}.get(parts[3])
        keys = [f.get("key") for f in self.campaign(parts[2]).get("flights", [])]
        return path.suffix == kind and path.stem in keys

    # settings of the jobs

    def _quadrotor(self, row: Row) -> tuple[dict[str, Any], str | None]:
        config, problem = self._quadrotor_file(row.cells["Drone Config Path"], row.cells["Drone Config File"])
        if problem and not config:
            problem = f"{row.logbook} row {row.number}, flight {row.key}: {problem}"
        return config, problem

    @functools.cache  # noqa: B019
    def _quadrotor_file(self, directory: str, name: str) -> tuple[dict[str, Any], str | None]:
        path = Path(directory.replace("\\", "/")) / name
        path = self._settled(path if path.suffix.lower() == ".json" else path.with_name(path.name + ".json"))
        if not self._here(path).is_file():
            known = [p.name for p in self._here(path.parent).glob("*.json")]
            return {}, (
                f"quadrotor configuration {path} does not exist"
                f"{nearest(path.name, known)}; correct 'Drone Config File' or 'Drone Config Path'"
            )
        try:
            return self._read(path, "quadrotor"), None
        except QuasiError as error:
            return {}, str(error)

    def _part(self, row: Row, keys: tuple[str, ...]) -> dict[str, Any]:
        config, problem = self._quadrotor(row)
        part = {k: config[k] for k in keys if k in config}
        part["file"] = row.cells["Drone Config File"]
        return {"quadrotor": part, "problem": problem}

    def importing(self, quadrotor: str, flight: str) -> dict[str, Any]:
        """Settings of one import job."""
        row = self.row(quadrotor, flight)
        raw, part = self.raw(row), self._part(row, IMPORTING)
        log_number = row.cells.get("Log number", "")
        wind, wind_problem = self.wind(row)
        return {
            "flight": {
                "flight": row.key,
                "quadrotor": row.quadrotor,
                "flight controller": self.controller(row),
                "rigid body": row.cells.get("Rigid Body Name", ""),
                "onboard": raw["onboard"],
                "capture": raw["capture"],
                "log number": int(log_number) if log_number.isdigit() else None,
            }
            | ({"wind": wind} if wind else {}),
            "quadrotor": part["quadrotor"],
            "options": self.processing["data importing"],
            "problem": part["problem"] or raw["problem"] or wind_problem,
        }

    def filtering(self, quadrotor: str, flight: str) -> dict[str, Any]:
        """Settings of one filter job."""
        row = self.row(quadrotor, flight)
        part = self._part(row, FILTERING)
        mass, problem = self.mass(row)
        return {
            "mass": mass,
            "quadrotor": part["quadrotor"],
            "options": self.processing["data filtering"],
            "problem": part["problem"] or problem,
        }

    def mass(self, row: Row) -> tuple[float | None, str | None]:
        """Mass in kg (the logbook's grams, else the quadrotor configuration's) and a sentence when there is none."""
        try:
            grams = row.number_in("Mass")
        except LogbookError as error:
            return None, str(error)
        if grams is not None and grams > 0:
            return grams * 1e-3, None
        config, problem = self._quadrotor(row)
        try:
            mass = float(config.get("mass") or "nan")
        except ValueError:
            mass = float("nan")
        if not mass > 0:
            return None, problem or (
                f"{row.logbook} row {row.number}, flight {row.key}: no mass; fill in 'Mass' (grams) in the logbook "
                "or 'mass' (kg) in the quadrotor configuration"
            )
        return mass, None

    def identification(self, name: str) -> dict[str, Any]:
        """Settings that all axes of a model share."""
        config = self.model(name)
        training, everything = self.model_flights(name, "training"), self.model_flights(name)
        # a row whose configuration is absent or faulty fails in its own jobs, with its own sentence
        sound = [r for r in everything if self._quadrotor(r)[1] is None]
        files = {r.cells["Drone Config File"] for r in sound}
        if len(files) > 1:
            raise ConfigError(
                f"config/models/{name}.json: the rows name several quadrotor configurations "
                f"({', '.join(sorted(files))}); a model needs one"
            )
        part = self._part(next((r for r in training if r in sound), training[0]), IDENTIFICATION)
        self._refuse_mixed_batteries(name, everything)
        masses = [m for m, _ in map(self.mass, training) if m]
        return {
            "model": name,
            "quadrotor name": training[0].quadrotor,
            "quadrotor": part["quadrotor"],
            "mass": sum(masses) / len(masses) if masses else None,
            "flights": [r.key for r in training],
            "gravity": self.gravity(name),
            "data partitioning": config["data partitioning"],
            "problem": part["problem"],
        }

    def _refuse_mixed_batteries(self, name: str, rows: list[Row]) -> None:
        kinds = sorted({r.cells.get("Batteries", "") for r in rows} - {""})
        if len(kinds) > 1:
            raise ConfigError(
                f"config/models/{name}.json: the flights were flown with different 'Batteries' ({', '.join(kinds)}); "
                "select flights with one battery type"
            )

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
        }

    @functools.cache  # noqa: B019
    def specification(self, name: str) -> tuple[Path, dict[str, Any]]:
        """Path and content of a model's polynomial specification file, the project's own before the standard ones."""
        given = self.model(name)["identification parameters"]["polynomial specification file"]
        base = self.place(given)
        base = base if base.suffix.lower() == ".json" else base.with_name(base.name + ".json")
        folders = (self.root, self.root / "config/polynomials", self.library / "config/polynomials")
        for folder in folders:
            if (folder / base).is_file():
                path = folder / base
                shown = path.relative_to(self.root) if path.is_relative_to(self.root) else path
                return shown, self._read(path.resolve() if folder is self.library else shown, "polynomials")
        # the manual's own paths lead through its library; the standard file of that name is meant
        standard = self.library / "config/polynomials" / base.name
        if standard.is_file():
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
