"""The experiment file log: one row per flight (the manual's Table 1), row selection (its 9.1), flight keys."""

import csv
import difflib
import io
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from quasi.errors import LogbookError, nearest, quoted
from quasi.input_limits import MAX_CELL_CHARACTERS, MAX_LOGBOOK_BYTES, MAX_NAME_CHARACTERS
from quasi.project.recognition import CONTROLLERS
from quasi.tables import read_text

NEEDED = ("Quadrotor", "Onboard Name", "OB Path", "Flight controller", "Drone Config File", "Drone Config Path")
OPTIONAL = (
    "Flight ID",
    "Rigid Body Name",
    "Has OT data",
    "OptiTrack time offset (s)",
    "Raw OptiTrack Name",
    "Raw OT Path",
    "OB row skip",
    "OB num columns",
    "Has OJF data",
    "OJF path",
    "OJF name",
    "Static wind (m/s)",
    "Wind towards (deg)",
    "Indoor or Outdoor",
    "Batteries",
    "Mode",
    "Mass",
    "Video",
    "Video Path",
    "Comments",
    "Flight key",
    "Log number",
    "Session",
)
# columns of the manual that are kept, but that no stage reads
_UNREAD = ("Flight ID", "OB row skip", "OB num columns", "Indoor or Outdoor", "Mode", "Video", "Video Path", "Comments")
_READ = tuple(c for c in (*NEEDED, *OPTIONAL) if c not in _UNREAD)
VALID_NAME = re.compile(rf"[A-Za-z0-9_+-][A-Za-z0-9._+-]{{0,{MAX_NAME_CHARACTERS - 1}}}")
_ROWS = re.compile(r"\s*([0-9]{1,9})\s*(?:-\s*([0-9]{1,9})\s*)?")  # digits enough for any logbook
_SEPARATOR_LINE = re.compile(r'"?sep=.?"?[ ,;\t]*\r?\n', re.IGNORECASE)  # for spreadsheets alone
NAME_RULE = f"at most {MAX_NAME_CHARACTERS} letters, digits and . _ + -, not a dot first"


def _plain(column: str) -> str:
    return re.sub(r"[\W_]+", "", column).lower()


# columns are known however their letters, spaces and signs are written, with and without a unit
LOGBOOK_COLUMNS = {_plain(form): c for c in (*NEEDED, *OPTIONAL) for form in (c, c.partition(" (")[0])}
LOGBOOK_COLUMNS |= dict.fromkeys(("massg", "massgram", "massgrams"), "Mass")
YES, NO = ("y", "yes", "true", "1", "x"), ("", "n", "no", "false", "0", "-", "none", "nan")


@dataclass(frozen=True)
class Row:
    """One flight of a logbook.

    number  row as a spreadsheet shows it (header = 1); key, quadrotor  its names in folders and targets;
    cells   {column: text}; problem  a sentence when the row cannot be used, else None.
    """

    logbook: str
    number: int
    key: str
    quadrotor: str
    cells: dict[str, str] = field(repr=False)
    problem: str | None = None

    @property
    def flight(self) -> str:
        """ "quadrotor/key", which names a flight among those of all logbooks."""
        return f"{self.quadrotor}/{self.key}"

    def has(self, column: str) -> bool:
        """The cell says yes."""
        return self.cells.get(column, "").strip().lower() in YES

    def read_cells(self) -> dict[str, str]:
        """The cells that stages read, those that are filled."""
        return {c: text for c in _READ if (text := self.cells.get(c, ""))}

    def number_in(self, column: str) -> float | None:
        """The cell as a number; None when empty. Raises LogbookError when it is text."""
        text = self.cells.get(column, "").strip()
        if not text:
            return None
        try:
            value = float(text.replace(",", ".")) if text.count(",") == 1 and "." not in text else float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise LogbookError(
                f"{self.logbook} row {self.number}: '{column}' is {quoted(text)}, expected a number; correct the cell"
            )
        return value


def describe_row(path: str | Path, quadrotor: str, key: str) -> dict[str, Any]:
    """{"path", "row" (header = 1), "cells" {column: text}} of a flight as its logbook reads now.

    Raises LogbookError where no row means the flight any more, and as `read_logbook`.
    """
    for row in read_logbook(path).values():
        if (row.quadrotor, row.key) == (quadrotor, key):
            return {"path": str(path), "row": row.number, "cells": dict(row.cells)}
    raise LogbookError(
        f"{path}: no row means flight {quadrotor}/{key} any more; the logbook changed during the run, start it again"
    )


def read_logbook(path: str | Path, notices: list[str] | None = None) -> dict[int, Row]:
    """Rows of a logbook by their number (header = row 1); rows without an Onboard Name are left out.

    notices  gets a sentence on those that are left out although they look like flights

    Raises LogbookError for a missing column or two rows that mean the same flight key of one quadrotor.
    """
    text = read_text(path, MAX_LOGBOOK_BYTES)
    if text.startswith("PK"):
        raise LogbookError(f"{path} is a spreadsheet file, not text; save the logbook as CSV from the spreadsheet")
    if _SEPARATOR_LINE.match(text):
        text = text.partition("\n")[2]  # a spreadsheet does not show this line, so the header stays row 1
    if not text.partition("\n")[0].strip(" ,;\t\r"):
        raise LogbookError(f"{path}: the first line is empty; it must hold the names of the columns")
    separator = _separator(text)
    # strict: a quote that nothing closes would swallow the rows below it
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    lines: list[list[str]] = []
    try:
        for line in reader:
            lines.append(line)
    except csv.Error as error:
        raise LogbookError(
            f"{path} row {len(lines) + 1} is not CSV ({error}); close or remove a quote there, or save the logbook as "
            "comma-separated text from the spreadsheet"
        ) from None
    header = _known_columns(lines[0])
    for column in NEEDED:
        if column not in header:
            raise LogbookError(
                f"{path} has no column '{column}'{nearest(column, header)}; add it to the first line of the logbook"
            )
    _refuse_near_columns(header, str(path))
    doubled = {c for c in header if c and header.count(c) > 1}
    if doubled:
        raise LogbookError(f"{path} has the column '{sorted(doubled)[0]}' twice; rename or remove one")
    rows: dict[int, Row] = {}
    nameless = []
    for index, line in enumerate(lines[1:], start=2):
        cells = {c: v.strip() for c, v in zip(header, line + [""] * len(header)) if c}
        if cells["Onboard Name"]:
            rows[index] = _row(str(path), index, cells)
            if any(beyond := [c.strip() for c in line[len(header) :]]):
                problem = (
                    f"{path} row {index} has {len(line)} cells, but the first line names {len(header)} columns; put a "
                    f"cell that holds {separator!r} in quotes, or remove what stands beyond ({' '.join(beyond)[:40]!r})"
                )
                rows[index] = replace(rows[index], problem=problem)
        elif any(cells[c] for c in NEEDED):
            nameless.append(index)
    if nameless and notices is not None:
        one = len(nameless) == 1
        notices.append(
            f"{path}: row{'' if one else 's'} {_ranges(nameless)} {'has' if one else 'have'} no 'Onboard Name' and "
            f"{'is' if one else 'are'} left out; fill it in for a flight (merged cells fill their first row alone)"
        )
    rows = _with_names_apart(rows)
    _refuse_clashes(rows.values())
    return rows


def _known_columns(header: Iterable[str]) -> list[str]:
    """The columns of a first line, those that are known by their usual names."""
    return [LOGBOOK_COLUMNS.get(_plain(c), c) for c in (c.strip() for c in header)]


def _separator(text: str) -> str:
    """The separator by which the first line holds most of the needed columns, else one that stands in it."""
    first = text.partition("\n")[0]

    def rank(separator: str) -> tuple[int, bool]:
        try:
            header = next(csv.reader(io.StringIO(text, newline=""), delimiter=separator), [])
        except csv.Error:  # an open quote; the reading of the rows says so
            header = []
        return len({*NEEDED} & {*_known_columns(header)}), separator in first

    return max((",", ";", "\t"), key=rank)


def _refuse_near_columns(header: list[str], path: str) -> None:
    """Raises LogbookError for a column whose content would be lost by a slip of spelling."""
    known = {*NEEDED, *OPTIONAL}
    absent = {plain: c for plain, c in LOGBOOK_COLUMNS.items() if c not in header}
    for column in header:
        if column in known or not column:
            continue
        if _plain(column).startswith("mass") and "mass" in absent:
            raise LogbookError(f"{path}: the column '{column}' is not read; name it 'Mass' and write grams in it")
        close = difflib.get_close_matches(_plain(column), absent, n=1, cutoff=0.85)
        if close:
            raise LogbookError(
                f"{path}: the column '{column}' is not known; did you mean '{absent[close[0]]}'? rename it"
            )


def key_of(file_name: str) -> str:
    """The flight key of a log without one of its own: one file is one flight, with its ending written or not.

    >>> key_of("LOG00012.TXT")
    'LOG00012'
    """
    endings = "bbl|bfl|csv|csv.gz|parquet|txt|ulg|bin|bag|mcap|db3|mat|npz".replace(".", r"\.")
    return re.sub(rf"(?<=.)\.({endings})$", "", file_name, flags=re.IGNORECASE)


def _meant_key(cells: Mapping[str, str]) -> str:
    return cells.get("Flight key") or key_of(cells["Onboard Name"])


def _row(path: str, number: int, cells: dict[str, str]) -> Row:
    key = _meant_key(cells)
    problem = None
    log_number = cells.get("Log number", "")
    if log_number:
        if not re.fullmatch(r"[0-9]{1,9}", log_number) or int(log_number) < 1:
            problem = f"{path} row {number}: 'Log number' is {quoted(log_number)}, expected 1, 2, ...; correct the cell"
        elif not cells.get("Flight key"):
            key = f"{key}-{log_number}"
    quadrotor = cells["Quadrotor"]
    named = "Flight key" if cells.get("Flight key") else "Onboard Name"
    if not VALID_NAME.fullmatch(key):
        problem = (
            f"{path} row {number}: {named} {quoted(key)} cannot name a flight; use {NAME_RULE} "
            "(the optional column 'Flight key' gives a flight another name than its file)"
        )
        key = _possible(key, number)
    if not VALID_NAME.fullmatch(quadrotor):
        what = f"{quoted(quadrotor)} cannot name one" if quadrotor else "is empty"
        problem = f"{path} row {number}: 'Quadrotor' {what}; write a name of {NAME_RULE}"
        quadrotor = _possible(quadrotor, number)
    controller = cells["Flight controller"].lower()
    controller = {"cleanflight": "betaflight"}.get(controller, controller)
    if controller and controller not in CONTROLLERS:
        problem = (
            f"{path} row {number}: 'Flight controller' is {quoted(cells['Flight controller'])}"
            f"{nearest(controller, CONTROLLERS)}; correct the cell"
        )
    for column in ("Has OT data", "Has OJF data"):
        if cells.get(column, "").lower() not in (*YES, *NO):
            problem = f"{path} row {number}: '{column}' is {quoted(cells[column])}, expected Y or N; correct the cell"
    for column, text in cells.items():
        if len(text) > MAX_CELL_CHARACTERS:
            problem = (
                f"{path} row {number}: {quoted(column)} has {len(text):,} characters, expected at most "
                f"{MAX_CELL_CHARACTERS:,}; shorten the cell"
            )
            cells[column] = text[:MAX_NAME_CHARACTERS]
    return Row(path, number, key, quadrotor, cells, problem)


def _possible(name: str, number: int) -> str:
    """A name that a target can have, so that the row fails in jobs of its own and the others go on."""
    possible = re.sub(r"[^A-Za-z0-9._+-]+", "_", name[:MAX_CELL_CHARACTERS]).lstrip(".")
    if len(possible) > MAX_NAME_CHARACTERS:
        possible = _of_row(possible, number)  # two long names may begin alike
    return possible or f"row-{number}"


def _of_row(name: str, number: int) -> str:
    return f"{name[: MAX_NAME_CHARACTERS // 2]}-row-{number}"


def _with_names_apart(rows: Mapping[int, Row]) -> dict[int, Row]:
    """The rows; names that were altered into the name of another flight get the number of their row."""
    count = Counter((row.quadrotor, row.key) for row in rows.values())
    apart_now = {}
    for number, row in rows.items():
        if count[row.quadrotor, row.key] > 1:
            if not VALID_NAME.fullmatch(_meant_key(row.cells)):
                row = replace(row, key=_of_row(row.key, number))
            elif not VALID_NAME.fullmatch(row.cells["Quadrotor"]):
                row = replace(row, quadrotor=_of_row(row.quadrotor, number))
        apart_now[number] = row
    return apart_now


def _refuse_clashes(rows: Iterable[Row]) -> None:
    seen: dict[tuple[str, str], Row] = {}
    for row in rows:
        other = seen.setdefault((row.quadrotor, row.key), row)
        if other is not row:
            raise LogbookError(
                f"{row.logbook} rows {other.number} and {row.number} both mean flight '{row.key}' of {row.quadrotor}; "
                f"{apart(row, other)}"
            )


def apart(row: Row, other: Row) -> str:
    """What sets two rows of one flight apart, for messages."""
    name = "give one of them another name in the optional column 'Flight key'"
    if row.cells["Onboard Name"] and row.cells["Onboard Name"] == other.cells["Onboard Name"]:
        return f"if the file holds several logs, give each its own in the optional column 'Log number', else {name}"
    return name


def select_rows(selection: Iterable[Any], where: str) -> list[int]:
    """Row numbers of a selection such as [2, "4-6", "9"], in order, each once.

    Raises LogbookError for what is not a row number or a range "a-b" with a <= b.

    >>> select_rows([2, "4-6", "5"], "config")
    [2, 4, 5, 6]
    """
    numbers: list[int] = []
    for entry in selection:
        match = None if isinstance(entry, bool) else _ROWS.fullmatch(str(entry))
        if not match:
            raise LogbookError(f'{where}: {quoted(entry)} is not a row; write numbers like 2 or ranges like "2-6"')
        first, last = int(match[1]), int(match[2] or match[1])
        if first < 2 or last < first:
            raise LogbookError(
                f"{where}: {entry!r} is not a range of flights; row 1 is the header, ranges count upwards"
            )
        if last - first > 100_000:
            raise LogbookError(f"{where}: {entry!r} selects {last - first + 1} rows; no logbook is that long")
        numbers.extend(range(first, last + 1))
    return list(dict.fromkeys(numbers))


def pick(rows: Mapping[int, Row], selection: Iterable[Any], where: str, logbook: str) -> list[Row]:
    """The rows that a selection means. Raises LogbookError for a row outside the logbook or an empty selection."""
    numbers = select_rows(selection, where)
    if not rows:
        raise LogbookError(f"{logbook} holds no flights yet; add one row per flight below its first line")
    if not numbers:
        raise LogbookError(f'{where}: no rows are selected; name at least one, like 2 or "2-6"')
    last = max(rows)
    for number in numbers:
        if number not in rows:
            raise LogbookError(
                f"{where}: row {number} is selected, but {logbook} has flights in rows {_ranges(rows)} (header = row "
                f"1, last row {last}; a row without 'Onboard Name' holds none); correct the selection, or add the row"
            )
    return [rows[n] for n in numbers]


def _ranges(numbers: Iterable[int]) -> str:
    spans: list[list[int]] = []
    for n in sorted(numbers):
        if spans and n == spans[-1][1] + 1:
            spans[-1][1] = n
        else:
            spans.append([n, n])
    return ", ".join(f"{a}-{b}" if b > a else f"{a}" for a, b in spans)
