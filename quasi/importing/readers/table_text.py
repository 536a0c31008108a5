"""Tables as they come: Parquet, and CSV with the separators, decimal commas and encodings that spreadsheets write.

One file is written in one manner: what separates cells and what marks decimals is found from the file or refused.
"""

import io
import re
import warnings
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from quasi.errors import ReadError, quoted
from quasi.project.recognition import refuse_other_formats
from quasi.tables import read_table, read_table_text, read_unpacked

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
MARKS = {",": "comma", ".": "point"}
COARSE = 0.1  # of the usual step of a clock: coarser stamps are refused, their digits do not distinguish them
REPEATED = 0.2  # share of rows that repeat a stamp, beyond which its digits may have been cut
_ENTRY = re.compile(r"(.+)\[([0-9]+)\]")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
# cells that are numbers: the mark separates decimals, may separate thousands, or does separate them
_CELL = re.compile(
    r"[+-]?(?:"
    r"(?P<either_point>[1-9][0-9]{0,2}[.][0-9]{3})|(?P<either_comma>[1-9][0-9]{0,2},[0-9]{3})"
    r"|(?P<decimal_point>[0-9]*[.][0-9]*(?:[eE][+-]?[0-9]+)?)|(?P<decimal_comma>[0-9]*,[0-9]*(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<whole>[0-9]+(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<grouped>[1-9][0-9]{0,2}"
    r"(?:(?:,[0-9]{3}){2,}|(?:[.][0-9]{3}){2,}|(?:[.][0-9]{3})+,[0-9]*|(?:,[0-9]{3})+[.][0-9]*)))"
)
_EMPTY = re.compile(r'[\s;,"]*')
_HINT = re.compile(r'"?sep=(.)"?[;,\t]*', re.IGNORECASE)
_NUMBER_FIRST = re.compile(r'[\s"]*[+-]?[0-9]*[.,]?[0-9]+(?:[eE][+-]?[0-9]+)?[\s"]*(?:[,;\t]|$)')


def from_header(text: str) -> tuple[str, int]:
    """A table's text from its header on, line ends \\n, and how many lines stand above: `sep=`, comments, empty ones.

    Comments begin with # or %. One that stands right above the numbers names the columns, as numpy and ROS write them.
    """
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    at = skipped = 0
    comment: int | None = None
    while at < len(text):
        end = text.find("\n", at)
        line = text[at : len(text) if end < 0 else end]
        if line.lstrip('" ').startswith(("#", "%")):
            comment = at
        elif not _EMPTY.fullmatch(line) and not (skipped == 0 and _HINT.fullmatch(line)):
            break
        if end < 0:
            break
        at, skipped = end + 1, skipped + 1
    if comment is not None and _NUMBER_FIRST.match(text, at):
        return text[comment:], skipped - text.count("\n", comment, at)
    return text[at:], skipped


def separator_of(head: str, path: Path | str) -> str:
    """What separates the names in a table's header. Raises ReadError where two separators are as likely."""
    bare = re.sub(r'"[^"]*"', "", head)
    first, second = sorted(SEPARATORS, key=bare.count, reverse=True)[:2]
    if bare.count(first) == bare.count(second) > 0:
        raise ReadError(
            f"{path}: the line of column names ({head[:60]!r}) holds as many {SEPARATORS[first]} as "
            f"{SEPARATORS[second]}, expected one of them between columns; rename the columns that hold the other, or "
            "export it anew"
        )
    return first


def refuse_nameless(text: str, separator: str, path: Path | str) -> None:
    """Raise ReadError where blanks separate the columns of a table, or where its first line holds no names."""
    head, _, below = text.partition("\n")
    words, numbers = head.replace(separator, " ").split(), below.partition("\n")[0].split()
    if separator not in head and len(words) == len(numbers) > 1 and all(map(_NUMBER.fullmatch, numbers)):
        raise ReadError(
            f"{path}: blanks separate its columns ({quoted(head, 60)}), expected commas, semicolons or tabs; export it "
            "anew, with names in the first line"
        )
    counted = words == [str(k) for k in range(len(words))]  # as pandas names the columns of an array
    if words and not counted and all(map(_NUMBER.fullmatch, words)):
        raise ReadError(
            f"{path}: its first line holds numbers ({quoted(head, 60)}), expected the names of its columns; write them "
            "in a line above"
        )


def open_table(
    path: Path, notes: list[str], use: Collection[str] | None = None, clocks: Collection[str] = ()
) -> pd.DataFrame:
    """The columns of a CSV (commas, semicolons or tabs) or Parquet file; what was left out or turned goes to the notes.

    use      names of the columns whose decimal marks have to be known; None for all
    clocks   names of the columns of time, which have to be whole
    Raises   ReadError when it is no readable table, when separator or decimal mark are ambiguous, or when a clock has
             lost its digits
    """
    data = read_unpacked(path)
    refuse_other_formats(path, data, ("parquet", "motive"), "a table (CSV, Parquet, MAT or npz)")
    if data[:4] == b"PAR1":
        return split_lists(read_table(path), use)
    text, skipped = from_header(read_table_text(path))
    separator = separator_of(text.partition("\n")[0], path)
    refuse_nameless(text, separator, path)
    # cells as written, where a comma may be a decimal mark and a point stand between thousands
    written = separator != "," or '"' in text
    try:
        with warnings.catch_warnings():
            # a comma at the end of each line is no column
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            table = pd.read_csv(
                io.StringIO(text), sep=separator, skipinitialspace=True, on_bad_lines="skip", low_memory=False,
                index_col=False, dtype=str if written else dict.fromkeys(clocks, str),
            ).rename(columns=lambda c: str(c).strip())  # fmt: skip
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError) as error:
        raise ReadError(f"{path} is not a readable table ({error}); export it again as CSV or Parquet") from None
    if skipped:
        notes.append(f"{path}: {skipped} lines above the header were skipped; rows are counted from the header")
    if written:
        turned = [str(name) for name in decimal_points(table, path, use)[0]]
        if turned:
            notes.append(f"{path}: the numbers of {len(turned)} columns have decimal commas (first '{turned[0]}')")
    for place, name in enumerate(table.columns):
        column = table.iloc[:, place]
        if name in clocks:
            refuse_rounded_stamps(column, name, path)
        if written or name in clocks:
            numbers = pd.to_numeric(column, errors="coerce")
            if not (numbers.isna() & column.notna()).any():
                table.isetitem(place, numbers)
    lines = sum(1 for line in text.split("\n") if line.strip()) - 1
    if lines > len(table) and '"' not in text:
        notes.append(f"{path}: {lines - len(table)} lines have more cells than there are columns; they were left out")
    return split_lists(table, use)


def split_lists(table: pd.DataFrame, use: Collection[str] | None) -> pd.DataFrame:
    """The table with the columns "gyro[0]", "gyro[1]" that are asked for, where it has "gyro" with a list in each cell.

    use  names of columns, None for no more than the table has
    """
    parsed: dict[str, list[np.ndarray]] = {}
    added: dict[str, np.ndarray] = {}
    for name in use or ():
        entry = _ENTRY.fullmatch(name)
        if entry is None or name in table.columns or entry[1] not in table.columns:
            continue
        cells = parsed.setdefault(entry[1], []) or parsed[entry[1]]
        if not cells:
            cells += [numbers_of(cell) for cell in table[entry[1]]]
        place = int(entry[2])
        added[name] = np.array([cell[place] if place < len(cell) else np.nan for cell in cells])
    return table.assign(**added) if added else table


def numbers_of(cell: object) -> np.ndarray:
    """The numbers of a cell that holds a list: "[0.1, -2e-3]", "0.1 -0.002", or a list of a Parquet file."""
    if isinstance(cell, str):
        cell = [float(number) for number in _NUMBER.findall(cell)]
    try:
        return np.asarray(cell, float).ravel()
    except (TypeError, ValueError):
        return np.zeros(0)


def _classify_cells(cells: Sequence[str]) -> tuple[Counter[str], dict[str, str]]:
    """How many cells are of each group of _CELL, "" for no numbers, and the first cell of each."""
    kinds = [match.lastgroup or "" if match else "" for match in map(_CELL.fullmatch, cells)]
    counts = Counter(kinds)
    return counts, {kind: cells[kinds.index(kind)] for kind in counts}


def decimal_points(
    table: pd.DataFrame, path: Path | str, use: Collection[str] | None = None
) -> tuple[list[str], set[str]]:
    """Turn decimal commas, as spreadsheets of many countries write them, into points, in place.

    table    cells as written; columns that are mostly no numbers are left alone, and those not in `use`
    Returns  names of the columns that were turned, and of those with any decimal mark
    Raises   ReadError where a comma or a point may be a decimal mark or stand between thousands, or where the file
             has both marks
    """
    commas: list[int] = []
    found: dict[tuple[str, bool], tuple[str, str]] = {}  # (mark, is it clear): column and cell that show it
    marked: set[str] = set()
    for place, name in enumerate(table.columns):
        if use is not None and str(name) not in use:
            continue
        cells = table.iloc[:, place].dropna().astype(str).str.strip().tolist()
        counts, first = _classify_cells(cells)
        if sum(counts.values()) - counts[""] <= 0.5 * len(cells):
            continue
        if "grouped" in first:
            raise ReadError(
                f"{path}: column '{name}' holds {first['grouped']}, whose thousands are separated, expected a "
                "plain number; export it without thousands separators"
            )
        for m, word in MARKS.items():
            for clear, kind in ((True, f"decimal_{word}"), (False, f"either_{word}")):
                if kind in first:
                    found.setdefault((m, clear), (str(name), first[kind]))
                    marked.add(str(name))
        if counts["decimal_comma"] or counts["either_comma"]:
            commas.append(place)
    clear = [m for m in MARKS if (m, True) in found]
    if len(clear) == 2:
        (a, comma), (b, point) = found[",", True], found[".", True]
        raise ReadError(
            f"{path}: column '{a}' has decimal commas (such as {comma}) and column '{b}' decimal points (such as "
            f"{point}), expected one of them throughout; export it again, with one setting for all columns"
        )
    for m, word in MARKS.items():
        if (m, False) in found and clear != [m]:
            name, cell = found[m, False]
            other = f", for decimals of column '{found[clear[0], True][0]}' have a {MARKS[clear[0]]}" if clear else ""
            raise ReadError(
                f"{path}: the {word}s of column '{name}' (such as {cell}) may be decimal {word}s or stand between "
                f"thousands{other}; export it without thousands separators, all with one decimal mark"
            )
    if clear != [","]:
        return [], marked
    for place in commas:
        cells = table.iloc[:, place].astype("string").str.strip()
        table.isetitem(place, cells.str.replace(",", ".", n=1, regex=False).astype(object))
    return [str(table.columns[place]) for place in commas], marked


def through_a_spreadsheet(path: Path | str, commas: bool, as_it_was: str) -> str:
    """A note on a file of a program that writes commas between cells and decimal points, but that has others."""
    seen = "decimal commas" if commas else "semicolons or tabs between cells"
    return (
        f"{path} has been through a spreadsheet ({seen}), which may have rounded its numbers to what it showed; give "
        f"the file {as_it_was}"
    )


def refuse_rounded_stamps(written: pd.Series, column: str, path: Path | str, rounded: bool = False) -> None:
    """Raise ReadError where stamps were cut to fewer digits than distinguish them.

    A spreadsheet shows, and saves, 1234567890 as 1.23E+09 and 1.2345 as 1.23 where the column is narrow.
    written  as in the file, with decimal points
    rounded  whether a stamp that many rows repeat, and that is written no finer than it steps, is one that was cut
    """
    text = written.dropna().astype(str).str.strip()
    parts = text.str.extract(r"^[+-]?[0-9]*(?:[.]([0-9]*))?(?:[eE]([+-]?[0-9]{1,2}))?$").fillna({0: "", 1: "0"})
    power = parts[1].astype(int)
    # of one power of ten the longest shows to what step, for zeros at the end may be left out
    step = 10.0 ** (power - parts[0].str.len().groupby(power).transform("max")).to_numpy(float)
    stamps = pd.to_numeric(text, errors="coerce").to_numpy(float)
    ahead = np.diff(stamps[np.isfinite(stamps)])
    usual = float(np.median(ahead[ahead > 0])) if (ahead > 0).any() else 0.0
    cut = (power != 0).to_numpy() & (step > COARSE * usual)
    if rounded and np.count_nonzero(ahead == 0) > REPEATED * len(text):
        cut |= step > 0.5 * usual
    if np.count_nonzero(cut) > 0.01 * len(text):
        raise ReadError(
            f"{path}: the time stamps of column '{column}' have lost their digits in {np.count_nonzero(cut)} of "
            f"{len(text)} rows (such as {text.iloc[int(np.argmax(cut))]}), as spreadsheets shorten long numbers; give "
            "the file as it was recorded, or export it with all digits of this column"
        )
