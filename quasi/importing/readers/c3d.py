"""C3D files of any motion capture, by ezc3d: a rigid body from its labelled markers.

A C3D file holds markers, not bodies. Those labelled with the body's name ("Quad:1", "Quad_2", "QuadFront") belong to
it. The position is their mean. The attitude is the turn since the first frames in which all were seen, by the best fit
of their shape (Kabsch, Acta Cryst. A32, 1976): the vehicle is to stand level then, its nose along the room's x.
Axes: those of the file, whose vertical axis the parameters POINT:X_SCREEN and Y_SCREEN may name; else z up.
"""

import io
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from quasi.attitude import HALF_TURN, from_matrix
from quasi.errors import ReadError, add_caution, nearest
from quasi.importing.readers.captured_body import LARGEST, LENGTHS, Body, capture_reader, captured_recording
from quasi.importing.readers.reader import needs_extra
from quasi.importing.series import Recording
from quasi.tables import read_bytes

Y_UP = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # y up (forward z, left x) to z up
FIRST = 100  # frames with all markers whose mean is the shape of the body, those before take-off
LEAST_MARKERS = 3
LONGEST_READING = 60.0  # s; an hour of ten markers at 100 Hz takes a few


def read_c3d(
    path: str | Path, rigid_body: str | None, marker_offset: np.ndarray | None = None, remove_outliers: bool = True
) -> Recording:
    """Read one body of a C3D file; parameters, result and errors as `motive.read_motive`."""
    path, notes = Path(path), []
    labels, points, rate, unit, y_up = _markers(path)
    name, rows, bodies = _body(labels, rigid_body, path)
    markers = points[:, rows] * LENGTHS[unit]  # frames, markers, axes
    markers = markers @ Y_UP.T if y_up else markers
    t = np.arange(len(markers)) / rate
    complete = np.isfinite(markers).all(axis=(1, 2))
    position = np.full((len(markers), 3), np.nan)
    position[complete] = markers[complete].mean(axis=1) * HALF_TURN
    quaternion = None
    if len(rows) >= LEAST_MARKERS and np.count_nonzero(complete) > FIRST:
        quaternion = np.full((len(markers), 4), np.nan)
        axes = np.diag(HALF_TURN)
        quaternion[complete] = from_matrix(axes @ turns_of(markers[complete]) @ axes)
        add_caution(
            notes,
            f"{path} holds markers alone: the attitude of '{name}' is its turn since the first {FIRST} frames, in "
            "which it has to stand level with its nose along the room's x",
        )
    facts = {"format": "C3D", "rigid bodies": bodies, "markers": [labels[i] for i in rows], "frame rate": rate,
             "export rate": rate, "length unit": unit,
             "rotation": "markers" if quaternion is not None else "absent"}  # fmt: skip
    body = Body(name, t, position, quaternion, markers.reshape(len(markers), -1), facts)
    return captured_recording(path, body, marker_offset, remove_outliers, notes)


def turns_of(markers: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) that turn the first shape of markers (n, k, 3) into each later one."""
    centred = markers - markers.mean(axis=1, keepdims=True)
    shape = centred[:FIRST].mean(axis=0)
    u, _, vt = np.linalg.svd(np.einsum("nki,kj->nij", centred, shape))
    sign = np.sign(np.linalg.det(u @ vt))
    u[:, :, 2] *= sign[:, None]
    return u @ vt


def _markers(path: Path) -> tuple[list[str], np.ndarray, float, str, bool]:
    """Labels, points (frames, markers, 3) with NaN where not seen, rate Hz, unit of length, and whether y is up."""
    with needs_extra("c3d", path, "a C3D file"):
        import ezc3d  # noqa: F401
    read_bytes(path)  # absent and empty files are named
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "markers.npz"
        command = [sys.executable, "-c", _WORKER, str(path), str(out)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_READING)
            reason = " ".join(done.stderr.split()[-20:])[:120] or "damaged"
        except subprocess.TimeoutExpired:
            reason = f"it was not read within {LONGEST_READING:g} s"
        if not out.is_file():
            raise ReadError(f"{path} is no readable C3D file ({reason}); export it again")
        found = np.load(io.BytesIO(read_bytes(out)), allow_pickle=False)
        points, labels = found["points"], [str(label) for label in found["labels"]]
        rate, unit, up = float(found["rate"]), str(found["unit"]) or "mm", str(found["up"])
    if not labels or not len(points) or points.shape[1] < len(labels) or not rate > 0:
        raise ReadError(f"{path} holds {len(labels)} labelled markers at {rate:g} Hz; label them and export it again")
    if unit not in LENGTHS:
        raise ReadError(f"{path} gives lengths in '{unit}', expected mm, cm or m; export it again")
    points[~(np.abs(points) < LARGEST).all(axis=2)] = np.nan
    points[(points == 0.0).all(axis=2)] = np.nan  # a marker without a residual is written as zeros by some programs
    return labels, points[:, : len(labels)], rate, unit, up in ("+Y", "Y")


# run by a process of its own, because the C++ library hangs or crashes on some damaged files
_WORKER = """
import sys
import ezc3d
import numpy as np

file = ezc3d.c3d(sys.argv[1])
point = file["parameters"]["POINT"]

def first(key, default):
    values = list(point[key]["value"]) if key in point else []
    return values[0] if values else default

np.savez(
    sys.argv[2],
    points=np.asarray(file["data"]["points"], float)[:3].transpose(2, 1, 0),
    labels=np.array([str(label).strip() for label in (point["LABELS"]["value"] if "LABELS" in point else [])], str),
    rate=float(first("RATE", 0.0)),
    unit=str(first("UNITS", "mm")).strip().lower(),
    up=str(first("Y_SCREEN", "")).strip().upper(),
)
"""


def _body(labels: list[str], wanted: str | None, path: Path) -> tuple[str, list[int], list[str]]:
    """Name of the body, indices of its markers, and the names of all bodies."""
    groups: dict[str, list[int]] = {}
    for i, label in enumerate(labels):
        groups.setdefault(re.split(r"[:_]|(?<=\D)\d+$", label)[0], []).append(i)
    bodies = [name for name, rows in groups.items() if len(rows) >= LEAST_MARKERS]
    if wanted is None:
        if len(bodies) != 1:
            raise ReadError(
                f"{path} holds the markers {', '.join(labels[:12])}; give the name with which the vehicle's begin"
            )
        return bodies[0], groups[bodies[0]], bodies
    rows = [i for i, label in enumerate(labels) if label.lower().startswith(wanted.lower())] if wanted else []
    if not rows:
        raise ReadError(
            f"{path} holds no marker whose label begins with '{wanted}'{nearest(wanted, bodies or labels)}; correct "
            "'Rigid Body Name' in the logbook"
        )
    return wanted, rows, bodies


READER = capture_reader("a C3D file", ("c3d",), read_c3d)
