"""Vicon exports (CSV of Tracker, Nexus and Shogun): one object on the capture's own clock.

The first line names the kind of data (Objects, Segments, Global ...), the second its rate. Then follow the names of
the objects, the quantities (RX RY RZ, with RW for a quaternion, TX TY TZ) and their units. Axes: world z up; body x
forward, y left, z up for an object that was made while aligned with the room.
Three rotations are written as a rotation vector ("helical") or as angles about X, Y and Z, which the file does not
state. A vector is never longer than half a turn, and a middle angle never beyond a quarter.
"""

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from quasi.attitude import HALF_TURN
from quasi.errors import ReadError, add_caution
from quasi.importing.readers.captured_body import (
    LENGTHS,
    Body,
    capture_reader,
    captured_recording,
    choose_body,
    number_in,
)
from quasi.importing.readers.table_text import SEPARATORS, from_header
from quasi.importing.series import Recording
from quasi.tables import read_table_text

ANGLES = {"deg": np.pi / 180, "rad": 1.0}
LEAST_TURN = 0.1  # rad, of a rotation below which vector and angles agree to 0.3 deg


@dataclass(frozen=True)
class _Table:
    """names, quantities, units  of each column; cells (n, columns), NaN where empty; rate Hz."""

    kind: str
    rate: float
    names: list[str]
    quantities: list[str]
    units: list[str]
    cells: np.ndarray


def read_vicon(
    path: str | Path, rigid_body: str | None, marker_offset: np.ndarray | None = None, remove_outliers: bool = True
) -> Recording:
    """Read one object of a Vicon export; parameters, result and errors as `motive.read_motive`."""
    path, notes = Path(path), []
    table = _read_table(path)
    columns, name, bodies = _columns(table, path, rigid_body)
    t = (table.cells[:, 0] + _subframes(table)) / table.rate
    t -= t[0]
    places = np.stack([table.cells[:, columns[f"T{a}"]] for a in "XYZ"], axis=1)
    unit = table.units[columns["TX"]].lower() or "mm"
    if unit not in LENGTHS:
        raise ReadError(f"{path} gives lengths in '{unit}', expected mm, cm or m; export it anew")
    turned = [q for q in ("RX", "RY", "RZ", "RW") if q in columns] if {"RX", "RY", "RZ"} <= set(columns) else []
    turns = [table.cells[:, columns[q]] for q in turned]
    written = np.column_stack([places, *turns])
    unseen = ~np.isfinite(written).all(axis=1) | (places == 0.0).all(axis=1)  # an occluded object is written as 0 0 0
    quaternion, how = None, "absent"
    if turns:
        scale = ANGLES.get(table.units[columns["RX"]].lower(), 1.0)
        quaternion, how = _attitude(np.column_stack(turns), scale, ~unseen, path, notes)
        quaternion[unseen] = np.nan
    position = LENGTHS[unit] * places * HALF_TURN
    position[unseen] = np.nan
    facts = {"format": f"Vicon {table.kind}", "rigid bodies": bodies, "frame rate": table.rate,
             "export rate": table.rate, "rotation": how, "length unit": unit}  # fmt: skip
    body = Body(name, t, position, quaternion, written, facts)
    return captured_recording(path, body, marker_offset, remove_outliers, notes)


def _read_table(path: Path) -> _Table:
    text, _ = from_header(read_table_text(path))
    head = text.split("\n", 5)
    separator = max(SEPARATORS, key=(head[3] if len(head) > 3 else "").count)
    rows = [[cell.strip() for cell in row] for row in csv.reader(text.splitlines(), delimiter=separator)]
    frame = next((i for i, row in enumerate(rows[:10]) if row and row[0].lower() == "frame"), None)
    if frame is None or frame < 3 or frame + 1 >= len(rows):
        raise ReadError(
            f"{path} has no line that begins with 'Frame' below the names of objects; export it anew as CSV"
        )
    try:
        rate = float(rows[1][0])
    except (ValueError, IndexError):
        raise ReadError(f"{path}: the second line holds no frame rate but {rows[1][:1]}; export it anew") from None
    if not rate > 0:
        raise ReadError(f"{path}: the frame rate is {rate:g} Hz, expected more than 0; export it anew")
    quantities = rows[frame]
    count = len(quantities)
    names, last = [], ""
    for cell in [*rows[frame - 1], *[""] * count][:count]:
        last = cell or last
        names.append(last)
    units = [re.sub(r"[^a-z]", "", u.lower()) for u in [*rows[frame + 1], *[""] * count][:count]]
    cells = []
    for row in rows[frame + 2 :]:
        if not row or not re.fullmatch(r"\d+", row[0]):
            break  # a blank line ends a section; another kind of data may follow
        numbers = [number_in(cell) for cell in row[:count]]
        cells.append(numbers + [np.nan] * (count - len(numbers)))
    if len(cells) < 2:
        raise ReadError(f"{path} holds fewer than two frames; export the trial again")
    return _Table(rows[0][0], rate, names, quantities, units, np.array(cells, float))


def _subframes(table: _Table) -> np.ndarray:
    """Sub-frames as shares of a frame; 0 where there are none."""
    place = next((i for i, q in enumerate(table.quantities) if q.lower().replace(" ", "") == "subframe"), None)
    if place is None or not np.nanmax(table.cells[:, place]) > 0:
        return np.zeros(len(table.cells))
    return table.cells[:, place] / (np.nanmax(table.cells[:, place]) + 1)


def _columns(table: _Table, path: Path, wanted: str | None) -> tuple[dict[str, int], str, list[str]]:
    """{quantity: column} of an object, its name, and the names of all."""
    blocks: dict[str, dict[str, int]] = {}
    for i, (name, quantity) in enumerate(zip(table.names, table.quantities)):
        if re.fullmatch(r"T[XYZ]|R[XYZW]", quantity.upper()):
            # Tracker repeats the name: "Quad:Quad" is object and segment, "Global Angle Quad:Quad" its kind as well
            short = re.sub(r"^Global \w+ ", "", name)
            short = short.partition(":")[2] if len(set(short.split(":"))) == 1 and ":" in short else short
            blocks.setdefault(short, {}).setdefault(quantity.upper(), i)
    bodies = [name for name, block in blocks.items() if {"TX", "TY", "TZ"} <= set(block)]
    name = choose_body(bodies, wanted, path)
    return blocks[name], name, bodies


def _attitude(
    turns: np.ndarray, scale: float, seen: np.ndarray, path: Path, notes: list[str]
) -> tuple[np.ndarray, str]:
    """Body-to-earth quaternions (n, 4) from three rotations or a quaternion x y z w, and how they were written."""
    known = seen & np.isfinite(turns).all(axis=1)
    q = np.full((len(turns), 4), np.nan)
    if turns.shape[1] == 4:
        known &= np.linalg.norm(turns, axis=1) > 0.5
        rotation, how = Rotation.from_quat(turns[known]), "quaternion"
    else:
        angles = scale * turns[known]
        length = np.linalg.norm(angles, axis=1)
        if np.max(length, initial=0.0) > np.pi + 0.01:
            rotation, how = Rotation.from_euler("XYZ", angles), "XYZ angles"
        else:
            rotation, how = Rotation.from_rotvec(angles), "rotation vector"
            if np.max(length, initial=0.0) > LEAST_TURN and np.max(np.abs(angles[:, 1]), initial=0.0) < np.pi / 2:
                add_caution(
                    notes,
                    f"{path} does not state whether RX, RY and RZ are a rotation vector or angles; they are taken as a "
                    "rotation vector: export a quaternion (RW)",
                )
    # half a turn about x on either side: FLU in a z-up room becomes FRD in NED
    q[known] = rotation.as_quat(scalar_first=True) * np.array([1.0, 1.0, -1.0, -1.0])
    return q, how


READER = capture_reader("a Vicon export (CSV)", ("vicon",), read_vicon)
