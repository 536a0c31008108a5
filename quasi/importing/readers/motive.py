"""OptiTrack Motive exports (CSV, format versions 1.2x): one rigid body on the capture's own clock.

The header is found by content: type, name, id, parent, quantity and axis rows may stand on other lines, with or without
blank lines and labels between them. Motive writes commas and decimal points, of which a spreadsheet may have made
semicolons or tabs and decimal commas. Time comes from the frame number and the export rate, for the printed times are
rounded. Motive's axes are right-handed with y up; earth axes here: x_E = z_G, y_E = -x_G, z_E = -y_G, and the attitude
is turned by the same change of basis on both sides, so that a body made while aligned with the room has zero attitude.
"""

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from quasi.errors import ReadError, add_caution
from quasi.importing.readers.captured_body import (
    LARGEST,
    LENGTHS,
    Body,
    capture_reader,
    captured_recording,
    choose_body,
)
from quasi.importing.readers.reader import TEXT
from quasi.importing.readers.table_text import SEPARATORS, decimal_points, from_header, through_a_spreadsheet
from quasi.importing.series import Recording
from quasi.project.recognition import refuse_other_formats
from quasi.tables import read_table_text, read_unpacked

ROOM_TO_EARTH = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
TYPES = {
    "rigid body",
    "rigid body marker",
    "marker",
    "bone",
    "bone marker",
    "skeleton",
    "force plate",
    "device",
    "camera",
}
QUANTITIES = {"rotation", "position", "mean marker error", "error per marker", "marker quality", "marker error"}


@dataclass(frozen=True)
class _Header:
    """What the header says. columns  {(quantity, axis): column} of the rigid body; first  line of the first frame."""

    separator: str
    facts: dict[str, str]
    columns: dict[tuple[str, str], int]
    name: str
    bodies: list[str]
    first: int


def read_motive(
    path: str | Path, rigid_body: str | None, marker_offset: np.ndarray | None = None, remove_outliers: bool = True
) -> Recording:
    """Read one rigid body of a Motive export.

    rigid_body       its name in Motive; None takes the only one
    marker_offset    (3,) m, of the marker centroid from the cg, body axes (marker = cg + R offset)
    remove_outliers  whether frames that no vehicle can fly (marker swaps, reflections) become gaps
    Returns          Recording with series "capture": x y z (m, earth NED, of the cg) and qw qx qy qz (body to earth);
                     t in s from frame 0 by the capture's clock; frames without the body, and such as hold an older pose
                     while it moves, are NaN
    Raises           ReadError when the file is no Motive export or has no such rigid body
    """
    path = Path(path)
    refuse_other_formats(path, read_unpacked(path), ("motive",), "a motion-capture export of Motive (CSV)")
    text, _ = from_header(read_table_text(path))
    header = _read_header(text, path, rigid_body)
    notes: list[str] = []
    frame, clock, values = _read_frames(text, header, path, notes)
    t, clock_facts = _times(frame, clock, header, path, notes)
    scale = _length_scale(header, path)
    position = scale * np.stack([values["position", axis] for axis in "xyz"], axis=-1) @ ROOM_TO_EARTH.T
    quaternion, rotation = _attitude(header, values, path)
    facts = {
        "format": "OptiTrack Motive",
        "format version": header.facts.get("format version", ""),
        "rigid bodies": header.bodies,
        "take": header.facts.get("take name", ""),
        "capture start": header.facts.get("capture start time", ""),
        **clock_facts,
        "rotation": rotation,
        "length unit": header.facts.get("length units", "Meters"),
    }
    written = np.stack(list(values.values()), axis=-1)
    body = Body(header.name, t, position, quaternion, written, facts)
    return captured_recording(path, body, marker_offset, remove_outliers, notes)


def _read_header(text: str, path: Path, rigid_body: str | None) -> _Header:
    """Find the header rows by what they hold."""
    lines = text.split("\n", 40)[:40]
    for separator in SEPARATORS:
        try:
            rows = [[c.strip() for c in row] for row in csv.reader(lines, delimiter=separator)]
        except csv.Error as error:
            raise ReadError(f"{path} is not a CSV file ({error}); export it from Motive again") from None
        axis_row = next((i for i, r in enumerate(rows) if len(r) > 1 and r[0].lower() == "frame"), None)
        if axis_row is not None:
            break
    else:
        raise ReadError(
            f"{path} is not a Motive export: none of its first {len(lines)} lines begins with 'Frame'; "
            "export the take as CSV with header information"
        )
    facts: dict[str, str] = {}
    for row in rows[:axis_row]:
        if row and row[0].lower().endswith("version"):
            facts = {key.lower(): value for key, value in zip(row[::2], row[1::2]) if key}
    above = [r for r in rows[:axis_row] if any(r) and not (r[0].lower().endswith("version"))]
    type_row = next((i for i, r in enumerate(above) if _holds(r, TYPES)), None)
    quantity_row = next((i for i in range(len(above) - 1, -1, -1) if _holds(above[i], QUANTITIES)), None)
    if type_row is None or quantity_row is None or quantity_row < type_row + 2:
        raise ReadError(
            f"{path} has no header rows that say which columns are rigid bodies; export it from Motive with "
            "'Header information' and 'Rigid Bodies' switched on"
        )
    names = next(
        (r for r in above[type_row + 1 : quantity_row] if len(r) > 1 and r[1].lower() == "name"), above[type_row + 1]
    )
    types, quantities, axes = above[type_row], above[quantity_row], rows[axis_row]
    blocks: dict[str, dict[tuple[str, str], int]] = {}
    for column in range(2, min(len(types), len(names), len(quantities))):
        if types[column].lower() == "rigid body" and names[column]:
            axis = axes[column].lower() if column < len(axes) else ""
            blocks.setdefault(names[column], {}).setdefault((quantities[column].lower(), axis), column)
    bodies = list(blocks)
    chosen = choose_body(bodies, rigid_body, path)
    columns = blocks[chosen]
    missing = [axis for axis in "xyz" if ("position", axis) not in columns]
    if missing:
        raise ReadError(
            f"{path} holds no position {missing[0].upper()} of rigid body '{chosen}'; export it with positions"
        )
    # csv.reader joins lines inside quotes; header lines hold none, so rows and lines agree
    return _Header(separator, facts, columns, chosen, bodies, axis_row + 1)


def _holds(row: list[str], known: set[str]) -> bool:
    return any(cell.lower() in known for cell in row[2:])


def _read_frames(
    text: str, header: _Header, path: Path, notes: list[str]
) -> tuple[np.ndarray, np.ndarray, dict[tuple[str, str], np.ndarray]]:
    """Frame numbers, printed times and the body's columns, text cells counted and emptied."""
    wanted = {key: column for key, column in header.columns.items() if key[0] in ("position", "rotation")}
    names = {column: f"{quantity} {axis}".title() for (quantity, axis), column in wanted.items()}
    names |= {0: "Frame", 1: "Time"}
    use = sorted(names)
    frames = text.split("\n", header.first)[header.first :]
    spread = header.separator != ","
    # cells as written, where a comma may be a decimal mark and a point stand between thousands
    written = spread or '"' in "".join(frames)
    try:
        table = pd.read_csv(
            io.StringIO("".join(frames)), sep=header.separator, header=None, usecols=use, names=range(use[-1] + 1),
            index_col=False, skip_blank_lines=True, on_bad_lines="skip", low_memory=False,
            dtype=str if written else None,
        ).rename(columns=names)  # fmt: skip
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError) as error:
        raise ReadError(f"{path} cannot be read below its header ({error}); export it from Motive again") from None
    if table.empty:
        raise ReadError(f"{path} holds a header but no frames; export the take from Motive again")
    if written:
        turned, marked = decimal_points(table, path)
        if spread and not marked.difference(("Frame", "Time")) and table.iloc[:, 2:].notna().any(axis=None):
            raise ReadError(
                f"{path}: positions and rotations of '{header.name}' have no decimals; a spreadsheet took their points "
                "for thousands separators: give the file as Motive wrote it"
            )
        if spread or turned:
            add_caution(notes, through_a_spreadsheet(path, bool(turned), "as Motive wrote it"))
    strange = 0
    for name in table.columns:
        if not pd.api.types.is_numeric_dtype(table[name]):
            numbers = pd.to_numeric(table[name], errors="coerce")
            strange += int((numbers.isna() & table[name].notna()).sum())
            table[name] = numbers
    if strange:
        notes.append(f"{path}: {strange} cells hold text where numbers belong; they count as not seen")
    cells = table.to_numpy(float)
    # numbers that no frame counter, clock or room holds count as missing too
    cells[~(np.abs(cells) < LARGEST)] = np.nan
    cells = cells[np.isfinite(cells[:, 0])]
    frame = cells[:, 0]
    order = np.concatenate([[True], frame[1:] > np.maximum.accumulate(frame)[:-1]]) if len(frame) else np.zeros(0, bool)
    if len(frame) < 2 or np.count_nonzero(order) < 2:
        raise ReadError(f"{path} holds fewer than two frames in order; export the take from Motive again")
    if not order.all():
        notes.append(f"{path}: {int((~order).sum())} frames out of order were left out")
    cells = cells[order]
    return cells[:, 0], cells[:, 1], {key: cells[:, use.index(column)].copy() for key, column in wanted.items()}


def _times(
    frame: np.ndarray, clock: np.ndarray, header: _Header, path: Path, notes: list[str]
) -> tuple[np.ndarray, dict[str, float]]:
    """Time of each frame, s: frame number over the rate that the printed times show it counts in."""
    rates = {}
    for key in ("export frame rate", "capture frame rate"):
        try:
            rates[key] = float(header.facts.get(key, "nan").replace(",", "."))
        except ValueError:
            rates[key] = np.nan
    rates = {k: v for k, v in rates.items() if np.isfinite(v) and v > 0}
    good = np.isfinite(clock)
    slope = np.nan
    if np.count_nonzero(good) > 1 and np.ptp(clock[good]) > 0:
        slope = np.ptp(frame[good]) / np.ptp(clock[good])
    if rates:
        key = min(rates, key=lambda k: abs(rates[k] - slope)) if np.isfinite(slope) else next(iter(rates))
        rate = rates[key]
        # the printed times are rounded to a millisecond or better, so over n frames they show the rate to 1e-3/duration
        if np.isfinite(slope) and abs(rate - slope) > 0.01 * slope + 2e-3 * slope**2 / max(1.0, np.ptp(frame)):
            notes.append(
                f"{path}: the header says {rate:g} frames/s but the printed times run at {slope:.3f}; "
                "the times are believed"
            )
            rate = float(slope)
    elif np.isfinite(slope):
        rate = float(slope)
        notes.append(f"{path}: the header gives no frame rate; {rate:.3f} frames/s follows from the printed times")
    else:
        raise ReadError(f"{path} gives neither a frame rate nor times; export it from Motive with header information")
    step = float(np.median(np.diff(frame)))
    return frame / rate, {"frame rate": rate, "export rate": rate / step}


def _length_scale(header: _Header, path: Path) -> float:
    unit = header.facts.get("length units", "Meters")
    if unit.lower() not in LENGTHS:
        raise ReadError(
            f"{path} gives lengths in '{unit}', expected Meters, Centimeters or Millimeters; export it anew"
        )
    return LENGTHS[unit.lower()]


def _attitude(header: _Header, values: dict[tuple[str, str], np.ndarray], path: Path) -> tuple[np.ndarray | None, str]:
    """Body-to-earth quaternions (n, 4) and how the file wrote the rotation; None when it holds none."""
    axes = [axis for axis in "xyzw" if ("rotation", axis) in values]
    if len(axes) < 3 or axes[:3] != ["x", "y", "z"]:
        return None, "absent"
    if "w" in axes:
        v = np.stack([values["rotation", axis] for axis in "xyz"], axis=-1) @ ROOM_TO_EARTH.T
        q = np.concatenate([values["rotation", "w"][:, None], v], axis=-1)
        length = np.linalg.norm(q, axis=-1, keepdims=True)
        # an unseen body is written as zeros by some versions
        return np.where(length > 0.5, q / np.where(length > 0.5, length, 1.0), np.nan), "quaternion"
    order = header.facts.get("rotation type", "XYZ").upper()
    if sorted(order) != ["X", "Y", "Z"]:
        raise ReadError(f"{path} gives rotations as '{order}', expected Quaternion or an order of angles such as XYZ")
    angles = np.column_stack([values["rotation", letter.lower()] for letter in order])
    q = np.full((len(angles), 4), np.nan)
    good = np.isfinite(angles).all(axis=1)
    # turns about the body's own axes, in the order named
    q[good] = Rotation.from_euler(order, angles[good], degrees=True).as_quat(scalar_first=True)
    q[:, 1:] @= ROOM_TO_EARTH.T
    return q, f"{order} angles"


READER = capture_reader("a motion-capture export of Motive (CSV)", ("motive", TEXT, "gzip"), read_motive)
