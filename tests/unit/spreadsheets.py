"""What a spreadsheet of the Netherlands or Germany makes of a CSV that it opened right and saved."""

import csv
import io
import re


def saved_anew(text: str, separator: str = ";", decimal: str = ",") -> str:
    """The table with another separator and decimal mark, every line filled up to the longest, line ends of Windows."""
    rows = [[cell.strip() for cell in row] for row in csv.reader(text.splitlines(), skipinitialspace=True)]
    width = max(map(len, rows))
    out = io.StringIO()
    writer = csv.writer(out, delimiter=separator)
    for row in rows:
        cells = [re.sub(r"^([+-]?[0-9]+)[.]([0-9]+(?:e[+-][0-9]+)?)$", rf"\1{decimal}\2", cell) for cell in row]
        writer.writerow(cells + [""] * (width - len(row)))
    return out.getvalue()


FORMS = [  # first line, separator, decimal mark, encoding
    ("", ";", ",", "utf-8"),
    ("", "\t", ",", "utf-16"),
    ("sep=;\n", ";", ",", "utf-8-sig"),
    ("", ",", ",", "utf-8"),
    ("", ";", ".", "utf-8"),
    ("# our lab; run 3, windy\n\n% battery 2\n", ";", ",", "utf-8"),
]
