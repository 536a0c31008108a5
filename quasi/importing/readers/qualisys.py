"""Qualisys exports (TSV with 6DOF data): one rigid body on the capture's own clock.

Lines of a key and its values come first (NO_OF_FRAMES, FREQUENCY, BODY_NAMES, DATA_INCLUDED 6D), then a line of column
names: each body has X Y Z in mm, three angles in degrees, a residual, and its rotation matrix column by column
(Rot[0] to Rot[8]), which turns body axes into the room's. Axes: world z up; body x forward, y left, z up for a body
that was defined while aligned with the room. A body that was not seen has zeros. Source: QTM user manual, "TSV file
formats".
"""

import csv
import re
from pathlib import Path

import numpy as np

from quasi.attitude import HALF_TURN, from_matrix
from quasi.errors import ReadError
from quasi.importing.readers.captured_body import Body, capture_reader, captured_recording, choose_body, number_in
from quasi.importing.readers.table_text import SEPARATORS, from_header
from quasi.importing.series import Recording
from quasi.tables import read_table_text

MILLI = 1e-3  # m; QTM writes TSV files in mm


def read_qualisys(
    path: str | Path, rigid_body: str | None, marker_offset: np.ndarray | None = None, remove_outliers: bool = True
) -> Recording:
    """Read one rigid body of a Qualisys export; parameters, result and errors as `motive.read_motive`."""
    path, notes = Path(path), []
    facts, header, cells = _read_table(path)
    bodies = facts.get("BODY_NAMES", [])
    name, first = _body(bodies, header, rigid_body, path)
    places = cells[:, first : first + 3]
    names = header[first + 3 : first + 16]
    matrix = [first + 3 + i for i, name in enumerate(names) if re.fullmatch(r"Rot\[\d\]", name)]
    rate = _rate(facts, path)
    numbered = header[0].lower() == "frame"
    t = (cells[:, 0] - cells[0, 0]) / rate if numbered else np.arange(len(cells)) / rate
    turned = cells[:, matrix[:9]].reshape(-1, 3, 3).transpose(0, 2, 1) if len(matrix) >= 9 else None
    unseen = ~np.isfinite(places).all(axis=1) | (places == 0.0).all(axis=1)
    quaternion = None
    if turned is not None:
        unseen |= ~np.isfinite(turned).all(axis=(1, 2))
        turned[unseen] = 0.0
        unseen |= np.linalg.det(turned) <= 0.0  # written as zeros, or no rotation
        quaternion = np.full((len(cells), 4), np.nan)
        axes = np.diag(HALF_TURN)
        quaternion[~unseen] = from_matrix(axes @ turned[~unseen] @ axes)
    position = MILLI * places * HALF_TURN
    position[unseen] = np.nan
    about = {
        "format": "Qualisys TSV", "rigid bodies": bodies, "frame rate": rate, "export rate": rate,
        "capture start": " ".join(facts.get("TIME_STAMP", [])[:1]), "length unit": "mm",
        "rotation": "matrix" if quaternion is not None else "absent",
    }  # fmt: skip
    written = np.column_stack([places, cells[:, matrix]]) if matrix else places
    body = Body(name, t, position, quaternion, written, about)
    return captured_recording(path, body, marker_offset, remove_outliers, notes)


def _read_table(path: Path) -> tuple[dict[str, list[str]], list[str], np.ndarray]:
    """{key: values} above the line of names, that line, and the numbers below (n, columns)."""
    lines = from_header(read_table_text(path))[0].splitlines()
    separator = max(SEPARATORS, key=lines[0].count)
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
    facts: dict[str, list[str]] = {}
    at = 0
    while at < len(rows) and rows[at] and re.fullmatch(r"[A-Z][A-Z_0-9]+", rows[at][0]):
        facts[rows[at][0]] = [cell for cell in rows[at][1:] if cell]
        at += 1
    if "6D" not in facts.get("DATA_INCLUDED", []):
        raise ReadError(
            f"{path} holds {' '.join(facts.get('DATA_INCLUDED', ['no data']))}, expected 6D; define the vehicle as a "
            "rigid body in QTM and export 6DOF data"
        )
    if at >= len(rows):
        raise ReadError(f"{path} holds a header but no frames; export the measurement again")
    header, count = rows[at], len(rows[at])
    cells = [[number_in(c) for c in row[:count]] + [np.nan] * (count - len(row)) for row in rows[at + 1 :] if any(row)]
    if len(cells) < 2:
        raise ReadError(f"{path} holds fewer than two frames; export the measurement again")
    return facts, header, np.array(cells, float)


def _rate(facts: dict[str, list[str]], path: Path) -> float:
    try:
        rate = float(facts["FREQUENCY"][0])
    except (KeyError, IndexError, ValueError):
        rate = 0.0
    if not rate > 0:
        raise ReadError(f"{path} gives no FREQUENCY above 0; export it from QTM with its header")
    return rate


def _body(bodies: list[str], header: list[str], wanted: str | None, path: Path) -> tuple[str, int]:
    """Name of the body, and the column of its X."""
    starts = [i for i in range(len(header) - 2) if header[i : i + 3] == ["X", "Y", "Z"]]
    name = choose_body(bodies, wanted, path)
    if bodies.index(name) >= len(starts):
        raise ReadError(f"{path} names {len(bodies)} rigid bodies but holds {len(starts)}; export it from QTM again")
    return name, starts[bodies.index(name)]


READER = capture_reader("a Qualisys export (TSV)", ("qualisys",), read_qualisys)
