"""Tables as they come: Parquet, and CSV with the separators, decimal commas and encodings that spreadsheets write."""

import codecs
import io
import re
import warnings
from pathlib import Path

import pandas as pd

from quasi.errors import ReadError
from quasi.tables import read_bytes, read_table, read_text

THOUSANDS = r"[+-]?[1-9][0-9]{0,2}(?:,[0-9]{3})+"
DECIMAL_COMMA = r"[+-]?[0-9]*(?:,[0-9]*)?(?:[eE][+-]?[0-9]+)?"


def open_table(path: Path, notes: list[str]) -> pd.DataFrame:
    """The columns of a CSV (commas, semicolons or tabs) or Parquet file; what was left out or turned goes to the notes.

    Raises ReadError when it is no readable table.
    """
    data = read_bytes(path)
    if data[:4] == b"PAR1":
        return read_table(path)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = read_text(path).encode()
    # a spreadsheet may name the separator in a line of its own
    if hint := re.match(rb"(?:\xef\xbb\xbf)?sep=.\r?\n", data):
        data = data[hint.end() :]
    head = data[:65536].split(b"\n", 1)[0]
    separator = max((b",", b";", b"\t"), key=head.count).decode()
    try:
        with warnings.catch_warnings():
            # a comma at the end of each line is no column
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            table = pd.read_csv(
                io.BytesIO(data), sep=separator, skipinitialspace=True, encoding="utf-8-sig",
                encoding_errors="replace", on_bad_lines="skip", low_memory=False, index_col=False,
            ).rename(columns=lambda c: str(c).strip())  # fmt: skip
        if separator != ",":
            _decimal_points(table, path, notes)
        lines = sum(1 for line in data.splitlines() if line.strip()) - 1
        if lines > len(table) and b'"' not in data:
            notes.append(
                f"{path}: {lines - len(table)} lines have more cells than there are columns; they were left out"
            )
        return table
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError) as error:
        raise ReadError(f"{path} is not a readable table ({error}); export it again as CSV or Parquet") from None


def _decimal_points(table: pd.DataFrame, path: Path, notes: list[str]) -> None:
    """Turn columns of numbers with decimal commas, as spreadsheets of many countries write them, into numbers."""
    turned = []
    for place, name in enumerate(table.columns):
        column = table.iloc[:, place]
        if pd.api.types.is_numeric_dtype(column):
            continue
        text = column.dropna().astype(str).str.strip()
        number = text.str.fullmatch(DECIMAL_COMMA)
        # a column of whole numbers and text has none; single cells of text are told as such later
        commas = text[text.str.contains(",")]
        if len(commas) and commas.str.fullmatch(THOUSANDS).all() and text.str.contains(r",.*,|[.]|^[0-9]{1,3}$").any():
            raise ReadError(
                f"{path}: the commas of column '{name}' (such as {commas.iloc[0]}) may be decimal commas or stand "
                "between thousands; export it without thousands separators"
            )
        if number.mean() > 0.5 and text[number].str.contains(",").any():
            table.isetitem(place, column.astype("string").str.strip().str.replace(",", ".", n=1).astype(object))
            turned.append(str(name))
    if turned:
        notes.append(f"{path}: the numbers of {len(turned)} columns have decimal commas (first '{turned[0]}')")
