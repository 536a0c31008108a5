"""The recorded flights of a project folder: raw files, quadrotor, mass, and settings of their two stages."""

import functools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quasi.airframe import read_airframe
from quasi.errors import ConfigError, LogbookError, QuasiError, nearest, quoted
from quasi.project.configurations import Configurations
from quasi.project.folder import Places, braced, is_file, with_suffix
from quasi.project.logbook import Row
from quasi.project.logbooks import Logbooks
from quasi.project.recognition import CONTROLLERS, HEAD_SIZE, recognise
from quasi.tables import read_head

CAPTURE_SUFFIXES = (".csv", ".CSV", ".tsv", ".TSV", ".c3d", ".csv.gz")

WIND_SUFFIXES = (".lvm", ".LVM", ".txt", ".csv")

# What of a quadrotor configuration each stage reads: a change elsewhere in the file reruns nothing.
GEOMETRY = (
    "rotor config",
    "rotor1 rotation direction",
    "rotor radius",
    "b",
    "moment of inertia",
    "rotor hub height",
    "rotor positions",
    "rotor rotation directions",
)

IMPORTING = (
    *GEOMETRY,
    "optitrack marker cg offset",
    "motor poles",
    "imu position",
    "sensor calibration",
    "idle RPM",
    "max RPM",
    "table columns",
    "log topics",
    "betaflight raw acceleration correction factor",
    "command map",
    "logged body axes",
    "held heading",
)

FILTERING = (*GEOMETRY, "motor poles", "idle RPM", "max RPM", "(estimated) imu sensor noise statistics")

IDENTIFICATION = (*GEOMETRY, "motor poles", "idle RPM", "max RPM", "command map", "hover speed", "thrust factor")

# the comparison of sensors turns the markers about the cg
GAP_KEYS = (*IDENTIFICATION, "optitrack marker cg offset")

LIGHTEST, HEAVIEST = 0.005, 100.0  # kg: outside lies a slip of unit, not a quadrotor

# flag: the column that names the file which is read where the flag says yes
FLAGGED = {"Has OT data": "Raw OptiTrack Name", "Has OJF data": "OJF name"}


class Recordings:
    """Where each row's raw files lie, and the settings of import and filter."""

    def __init__(self, places: Places, configuration: Configurations, logbooks: Logbooks) -> None:
        self.places = places
        self.configuration = configuration
        self.logbooks = logbooks
        self._raw: dict[tuple[str, int], dict[str, Any]] = {}  # by logbook and row: each is asked for several times

    def raw(self, row: Row) -> dict[str, Any]:
        """Paths of the "onboard" and "capture" files, found or to be made, or None, and a "problem" or None."""
        key = row.logbook, row.number
        if key not in self._raw:
            self._raw[key] = self._find_raw(row)
        return self._raw[key]

    def _find_raw(self, row: Row) -> dict[str, Any]:
        controller = self.controller(row)
        suffixes = CONTROLLERS.get(controller, CONTROLLERS["betaflight"])
        onboard, problem = self._find(row, "OB Path", "Onboard Name", suffixes)
        at, capture = f"{row.logbook} row {row.number}, flight {row.key}", None
        problem = problem and f"{at}: {problem}"
        if row.has("Has OT data"):
            if not row.cells.get("Raw OptiTrack Name"):
                problem = problem or (
                    f"{row.logbook} row {row.number}: 'Has OT data' is yes but 'Raw OptiTrack Name' is empty; "
                    "fill it in"
                )
            else:
                capture, missing = self._find(row, "Raw OT Path", "Raw OptiTrack Name", CAPTURE_SUFFIXES)
                problem = problem or (missing and f"{at}: {missing}")
        return {"onboard": onboard, "capture": capture, "problem": row.problem or problem}

    def _unread_files(self, row: Row) -> list[str]:
        """A sentence on each file that a row names while the flag by which it is read is empty."""
        return [
            f"{row.key}: {row.logbook} row {row.number} names {quoted(row.cells[name])} in '{name}', which is not read "
            f"because '{flag}' is empty; write Y there, or N to leave it out"
            for flag, name in FLAGGED.items()
            if row.cells.get(name) and not row.cells.get(flag)
        ]

    def controller(self, row: Row) -> str:
        """A flight controller of `recognition.CONTROLLERS`: the logbook's cell, else the quadrotor configuration's."""
        name = row.cells["Flight controller"].lower()
        if not name:
            config, _ = self.quadrotor(row)
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
        except LogbookError as error:
            return None, str(error)
        if row.has("Has OJF data") and row.cells.get("OJF name"):
            # no row number: a moved row would import the flight anew although a static wind stands in
            wind["file"], wind["file problem"] = self._find(row, "OJF path", "OJF name", WIND_SUFFIXES)
            if wind["file problem"] and static is None:
                return wind, f"{row.logbook} row {row.number}, flight {row.key}: {wind['file problem']}"
        elif static is None:
            return None, (
                f"{row.logbook} row {row.number}: 'Has OJF data' is yes, but neither 'OJF name' nor "
                "'Static wind (m/s)' is given; fill in one"
            )
        return wind, None

    def _find(self, row: Row, folder: str, name: str, suffixes: tuple[str, ...]) -> tuple[str | None, str | None]:
        """Path of a raw file, or None and what is wrong, which names neither logbook nor row."""
        base = self.places.place(row.cells.get(folder, "")) / row.cells[name]
        if fault := braced(base):
            return None, f"{row.logbook} row {row.number}, '{folder}' and '{name}': {fault}"
        if base.suffix in suffixes:
            candidates = [base]
        else:
            # the name as it is written serves, too: what a file holds decides how it is read, not its extension
            candidates = [*(Path(f"{base}{s}") for s in suffixes), base]
        for path in candidates:
            if is_file(self.places.here(path)) or self.is_made(path):
                return str(path), None
        if inside := self._files_in(base):
            return None, (
                f"{base} is a folder; write '{row.cells[name]}' into "
                f"'{folder}' of the logbook and one file of it into '{name}': {', '.join(inside[:3])}"
            )
        expected = str(candidates[0]) if len(candidates) == 1 else f"{base}[{'|'.join(dict.fromkeys(suffixes))}]"
        near = self._near_files(base)
        remedy = (
            f"{' and '.join(near[:3])} {'lies' if len(near) == 1 else 'lie'} there: write the whole file name into "
            f"'{name}' of the logbook if it is the flight"
            if near
            else f"correct '{name}' or '{folder}' in the logbook, or copy the file there{self._data_hint(base)}"
        )
        return None, f"raw file {expected} does not exist; {remedy}"

    def _files_in(self, folder: Path) -> list[str]:
        """The names of the bag files in a folder that was named in place of one."""
        try:
            files = sorted(p for p in self.places.here(folder).iterdir() if p.suffix in CONTROLLERS["rosbag"])
        except OSError:
            return []
        return [p.name for p in files]

    def _near_files(self, base: Path) -> list[str]:
        """Files of the same name but for extension and case, each with what it holds: "LOG1.TXT (a blackbox log)"."""
        folder = self.places.here(base.parent)
        stems = {base.name.lower(), base.stem.lower()}
        try:
            files = sorted(p for p in folder.iterdir() if {p.name.lower(), p.stem.lower()} & stems and is_file(p))
        except OSError:
            return []
        kinds = [recognise(read_head(p, HEAD_SIZE)) for p in files]
        return [f"{p.name}{f' ({kind.name})' if kind else ''}" for p, kind in zip(files, kinds)]

    def _data_hint(self, path: Path) -> str:
        """How to say where recordings lie, for a raw file that was sought in the folder's own data/."""
        if self.places.data or path.parts[:1] != ("data",):
            return ""
        return "; where recordings lie elsewhere, `--config data=PATH` sets the place of data/"

    def is_made(self, path: Path) -> bool:
        """Whether the synthesis stage makes this raw file."""
        parts = path.parts
        if len(parts) != 5 or parts[:2] != ("results", "synthesis") or parts[2] not in self.configuration.campaigns:
            return False
        kind = {"onboard": ".bbl", "optitrack": ".csv"}.get(parts[3])
        keys = [f.get("key") for f in self.configuration.campaign(parts[2]).get("flights", [])]
        return path.suffix == kind and path.stem in keys

    def to_be_made(self, settings: Mapping[str, Any]) -> bool:
        """Whether a raw file of a flight, of whose import these are the settings, is absent and a rule makes it."""
        files = [settings["flight"][k] for k in ("onboard", "capture")]
        return any(f and self.is_made(Path(f)) and not is_file(self.places.here(f)) for f in files)

    def log_of(self, row: Row) -> list[str] | None:
        """On-board file of a row and the number of the log in it; None where the file is absent."""
        path = self.raw(row)["onboard"]
        return [path, row.cells.get("Log number", "")] if path else None

    def quadrotor(self, row: Row) -> tuple[dict[str, Any], str | None]:
        """Quadrotor configuration of a row, {} where it cannot be read, and a sentence on what is wrong or None."""
        if not row.cells["Drone Config File"]:
            empty = "'Drone Config File' is empty; fill in the name of the quadrotor's JSON"
            return {}, f"{row.logbook} row {row.number}, flight {row.key}: {empty}"
        config, problem = self._quadrotor_file(self.quadrotor_path(row))
        if problem and not config:
            problem = f"{row.logbook} row {row.number}, flight {row.key}: {problem}"
        return config, problem

    def quadrotor_path(self, row: Row) -> Path:
        """Path of the quadrotor configuration that a row names."""
        return self._quadrotor_path(row.cells["Drone Config Path"], row.cells["Drone Config File"])

    @functools.cache  # noqa: B019
    def _quadrotor_path(self, folder: str, name: str) -> Path:
        return self.places.settled(with_suffix(Path(folder.replace("\\", "/")) / name, ".json"))

    @functools.cache  # noqa: B019
    def _quadrotor_file(self, path: Path) -> tuple[dict[str, Any], str | None]:
        if not is_file(self.places.here(path)):
            known = [p.name for p in self.places.here(path.parent).glob("*.json")]
            return {}, (
                f"quadrotor configuration {path} does not exist{self.places.describe_other_place(path)}"
                f"{nearest(path.name, known)}; correct 'Drone Config File' or 'Drone Config Path'"
            )
        try:
            config = self.places.read(path, "quadrotor")
            # checks beyond the schema: rotor numbers, inertia, poles; `_find_unlike_mass` has the mass
            read_airframe(config, str(path), mass=math.nan)
        except QuasiError as error:
            return {}, str(error)
        return config, None

    def quadrotor_part(self, row: Row, keys: tuple[str, ...]) -> dict[str, Any]:
        """The keys of a quadrotor configuration that a stage reads, and what is wrong with the file or None."""
        config, problem = self.quadrotor(row)
        part = {k: config[k] for k in keys if k in config}
        part["file"] = self.quadrotor_path(row).stem
        return {"quadrotor": part, "problem": problem}

    @functools.cache  # noqa: B019 - rules ask four times for each flight
    def importing(self, quadrotor: str, flight: str) -> dict[str, Any]:
        """Settings of one import job."""
        row = self.logbooks.row(quadrotor, flight)
        raw, part = self.raw(row), self.quadrotor_part(row, IMPORTING)
        log_number = row.cells.get("Log number", "")
        wind, wind_problem = self.wind(row)
        unread = self._unread_files(row)
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
            | ({"wind": wind} if wind else {})
            | ({"unread": unread} if unread else {}),
            "quadrotor": part["quadrotor"],
            "options": self.configuration.processing["data importing"],
            "problem": part["problem"] or raw["problem"] or wind_problem,
        }

    def filtering(self, quadrotor: str, flight: str) -> dict[str, Any]:
        """Settings of one filter job."""
        row = self.logbooks.row(quadrotor, flight)
        part = self.quadrotor_part(row, FILTERING)
        mass, problem = self.mass(row)
        if mass is not None and not part["problem"]:
            problem = problem or self._find_unlike_mass(self.quadrotor_path(row), mass)
        return {
            "mass": mass,
            "quadrotor": part["quadrotor"],
            "options": self.configuration.processing["data filtering"],
            "problem": part["problem"] or problem,
        }

    @functools.cache  # noqa: B019
    def _find_unlike_mass(self, path: Path, mass: float) -> str | None:
        """A sentence where a quadrotor configuration cannot be that of a vehicle of this mass, kg."""
        try:
            read_airframe(self._quadrotor_file(path)[0], str(path), mass)
        except ConfigError as error:
            return str(error)
        return None

    def mass(self, row: Row) -> tuple[float | None, str | None]:
        """Mass in kg (the logbook's grams, else the quadrotor's), and a sentence when it cannot be used."""
        flight = f"{row.logbook} row {row.number}, flight {row.key}"
        try:
            grams = row.number_in("Mass")
        except LogbookError as error:
            return None, str(error)
        if grams is not None:
            if LIGHTEST <= grams * 1e-3 <= HEAVIEST:
                return grams * 1e-3, None
            return None, f"{flight}: 'Mass' is {grams:g} grams, which no quadrotor weighs; the column holds grams"
        config, problem = self.quadrotor(row)
        given = config.get("mass", "")
        if given == "":
            return None, problem or (
                f"{flight}: no mass; fill in 'Mass' (grams) in the logbook "
                "or 'mass' (kg) in the quadrotor configuration"
            )
        try:
            mass = float(given)
        except ValueError:
            mass = float("nan")
        if LIGHTEST <= mass <= HEAVIEST:
            return mass, None
        return None, (
            f"{flight}: 'mass' is {str(given)[:40]!r} in {row.cells['Drone Config File']}, expected kg "
            f"from {LIGHTEST:g} to {HEAVIEST:g}; correct it, or fill in 'Mass' (grams) in the logbook"
        )
