"""Limits of what files may hold, checked before the content costs time or memory. Each has its reason.

A file beyond a limit is refused by its size, its footer or its first bytes, so that no input takes minutes or the
memory of the machine. Limits lie far above what flights and configurations need.
"""

import csv

from quasi.errors import ReadError

# bytes: read whole; 30 minutes of blackbox log are 0.3 GB, and machines of students have 8 GB
MAX_FILE_BYTES = 4_000_000_000
# bytes after unpacking (gzip, Parquet, MAT, npz): one hour at 1 kHz of 50 columns of 8 bytes is 1.44 GB
MAX_UNPACKED_BYTES = 1_500_000_000
# bytes: JSON costs 0.2 s and 10 MB of memory per MB (benchmarks/fuzz_readers.py); diagnoses have below 2 MB
MAX_JSON_BYTES = 16_000_000
# bytes: a logbook of 100,000 flights has 15 MB
MAX_LOGBOOK_BYTES = 32_000_000
# bytes: PyYAML costs 10 s per MB; config.yaml holds one line
MAX_YAML_BYTES = 100_000
# bytes of one line of text: a capture of 1,000 markers has lines of 40 kB
MAX_LINE_BYTES = 1_000_000
# characters of one cell of a logbook: comments are the longest, and 10,000 are four printed pages
MAX_CELL_CHARACTERS = 10_000
# characters of a flight, quadrotor, model, gap or simulation: file systems allow 255 bytes, endings are added
MAX_NAME_CHARACTERS = 100
# digits of a number: a double has 17, and Python refuses to convert above 4,300
MAX_DIGITS = 400
# characters of an expression: effects of the catalogue make up to 5,000; 100,000 take 0.3 s
MAX_EXPRESSION_CHARACTERS = 100_000
# terms of one expression with its brackets expanded: 20,000 cost 0.1 s to compare, a product of 40 sums never ends
MAX_EXPANDED_TERMS = 20_000
# the csv module's own limit of a cell (131,072 characters) raises an error for the whole file
csv.field_size_limit(MAX_LOGBOOK_BYTES)


def check_size(path: object, size: int, limit: int, what: str, remedy: str) -> None:
    """Raise ReadError where `size` (bytes) exceeds `limit`.

    what  that has the size, such as "the file"; remedy  the end of the sentence
    """
    if size > limit:
        raise ReadError(f"{path}: {what} has {size / 1e6:,.1f} MB, expected at most {limit / 1e6:,.1f} MB; {remedy}")


def check_lines(path: object, data: bytes) -> None:
    """Raise ReadError where a line is longer than MAX_LINE_BYTES; lines end with \\n, \\r or both."""
    at = line = 0
    while at + MAX_LINE_BYTES < len(data):
        # the last line end within the limit: a few steps per file, not one per line
        window = at, at + MAX_LINE_BYTES + 1
        end = max(data.rfind(b"\n", *window), data.rfind(b"\r", *window))
        if end < 0:
            line = data.count(b"\n", 0, at) + 1
            raise ReadError(
                f"{path}: line {line} has more than {MAX_LINE_BYTES:,} bytes, expected a table with one row per line; "
                "export it again"
            )
        at = end + 1
