"""What is done with every captured rigid body alike: frames not seen, held or impossible, and the marker offset."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from quasi.attitude import continuous, rotate
from quasi.errors import ReadError, nearest
from quasi.importing.artefacts import flyable, stalled
from quasi.importing.readers.reader import Reader
from quasi.importing.series import Recording, Series
from quasi.sensor_limits import runs_of

LARGEST_ROOM = 150.0  # m
LARGEST = 1e10  # mm, frames or s: beyond any room, counter and clock
LENGTHS = {
    "meters": 1.0, "metres": 1.0, "m": 1.0,
    "centimeters": 0.01, "centimetres": 0.01, "cm": 0.01,
    "millimeters": 0.001, "millimetres": 0.001, "mm": 0.001,
}  # fmt: skip


def number_in(cell: str) -> float:
    """The number in a cell; NaN where there is none, or one that no room, counter or clock holds."""
    try:
        number = float(cell)
    except ValueError:
        return np.nan
    return number if abs(number) < LARGEST else np.nan


def choose_body(bodies: list[str], wanted: str | None, path: Path) -> str:
    """The name of the vehicle among those in a capture, whatever its case and blanks; None wants the only one.

    Raises ReadError where it is absent, or where several could be meant.
    """
    if wanted is None and len(bodies) > 1:
        raise ReadError(f"{path} holds the rigid bodies {', '.join(bodies)}; name the vehicle's")
    alike = bodies if wanted is None else [b for b in bodies if _plain(b) == _plain(wanted)]
    if wanted in bodies or len(alike) == 1:
        return wanted if wanted in bodies else alike[0]
    what = f"no rigid body '{wanted}'{nearest(str(wanted), bodies)}" if bodies else "no rigid body at all"
    raise ReadError(f"{path} holds {what}; correct 'Rigid Body Name' in the logbook, or export rigid bodies")


def _plain(name: str) -> str:
    return " ".join(name.replace("_", " ").lower().split())


def capture_reader(name: str, kinds: tuple[str, ...], read: Callable[..., Recording]) -> Reader:
    """A format of captures. read  (path, rigid body, marker offset, whether to remove outliers)"""
    return Reader(name, kinds, lambda r: read(r.path, r.rigid_body, r.marker_offset, r.remove_outliers))


@dataclass(frozen=True)
class Body:
    """One rigid body as exported.

    t           (n,) s, by the capture's clock
    position    (n, 3) m, earth NED, of the markers' centroid; NaN where it was not seen
    quaternion  (n, 4) body FRD to earth NED, or None without rotation
    written     (n, k) the numbers as in the file, by which held frames are found
    facts       for the metadata; "length unit" among them
    """

    name: str
    t: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray | None
    written: np.ndarray
    facts: dict[str, Any] = field(default_factory=dict)


def refuse_beyond_rooms(position: np.ndarray, what: str, unit: str, remedy: str) -> None:
    """Raise ReadError where a captured position (n, 3), m, finite, moves farther than any room is wide.

    what  moves; unit  that is stated; remedy  for the message
    """
    low, high = np.quantile(position, [0.02, 0.98], axis=0)
    if np.max(high - low) > LARGEST_ROOM:
        raise ReadError(
            f"{what} moves through {np.max(high - low):.0f} m if lengths are in {unit}, more than any room; {remedy}"
        )


def captured_recording(
    path: Path, body: Body, marker_offset: np.ndarray | None, remove_outliers: bool, notes: list[str]
) -> Recording:
    """The series "capture" of a body.

    marker_offset    (3,) m, of the marker centroid from the cg, body axes (marker = cg + R offset), or None
    remove_outliers  whether frames that no vehicle can fly (marker swaps, reflections) become gaps
    Raises           ReadError where the body was never seen, or moves farther than any room is wide
    """
    body = _in_order(path, body, notes)
    t, position = body.t, body.position.copy()
    quaternion = None if body.quaternion is None else body.quaternion.copy()
    unit = str(body.facts.get("length unit", "Meters"))
    seen = np.isfinite(position).all(axis=-1)
    if quaternion is not None:
        seen &= np.isfinite(quaternion).all(axis=-1)
    else:
        notes.append(f"{path}: the export holds no rotation of '{body.name}'; its attitude has to come from on board")
    if not seen.any():
        raise ReadError(
            f"{path} never saw rigid body '{body.name}' ({len(t)} frames, all empty); check its name and export"
        )

    refuse_beyond_rooms(
        position[seen],
        f"{path}: '{body.name}'",
        f"{unit} as the header says",
        "correct 'Length Units', or export it anew",
    )
    lost = int(np.count_nonzero(~seen))
    held = stalled(t, body.written, position, quaternion)
    seen &= ~held
    removed = np.zeros(len(t), bool)
    flips = 0
    index = np.flatnonzero(seen)
    if quaternion is not None:
        flips = int(np.count_nonzero(np.sum(quaternion[index][1:] * quaternion[index][:-1], axis=-1) < 0))
        quaternion[index] = continuous(quaternion[index])
    if remove_outliers:
        removed[index] = ~flyable(t[index], position[index], quaternion[index] if quaternion is not None else None)
    bad = ~seen | removed
    if quaternion is not None:
        index = np.flatnonzero(~bad)
        quaternion[index] = continuous(quaternion[index])
    if lost:
        notes.append(f"{path}: '{body.name}' was not seen in {lost} of {len(t)} frames ({100 * lost / len(t):.1f} %)")
    if held.any():
        notes.append(f"{path}: {_describe_held(held, t, body.name)}")
    if removed.any():
        notes.append(
            f"{path}: {int(removed.sum())} of {len(t)} frames were removed as impossible to fly (marker swaps or "
            f"reflections), the first at {t[np.argmax(removed)]:.3f} s of the capture"
        )

    offset = np.zeros(3) if marker_offset is None else np.asarray(marker_offset, float)
    if np.any(offset):
        if quaternion is None:
            notes.append(
                f"{path}: the marker offset could not be taken off the position, for the export has no rotation"
            )
        else:
            position = position - rotate(np.nan_to_num(quaternion, nan=0.5), offset)
    position[bad] = np.nan
    series = {"x": position[:, 0], "y": position[:, 1], "z": position[:, 2]}
    if quaternion is not None:
        quaternion[bad] = np.nan
        series |= {name: quaternion[:, i] for i, name in enumerate(("qw", "qx", "qy", "qz"))}
    metadata: dict[str, Any] = {
        "file": str(path),
        "rigid body": body.name,
        **body.facts,
        "frames": len(t),
        "duration": float(t[-1] - t[0]),
        "marker offset": offset.tolist(),
        "frames lost": lost,
        "frames held": int(held.sum()),
        "frames removed": int(removed.sum()),
        "quaternion sign flips": flips,
    }
    return Recording({"capture": Series(t, series)}, metadata, notes)


def _in_order(path: Path, body: Body, notes: list[str]) -> Body:
    """The body without frames whose time is unknown, or no later than that of one before."""
    known = np.where(np.isfinite(body.t), body.t, -np.inf)
    before = np.concatenate([[-np.inf], np.maximum.accumulate(known)[:-1]])
    order = known > before
    if order.all():
        return body
    if np.count_nonzero(order) < 2:
        raise ReadError(f"{path} holds fewer than two frames in order; export it again")
    notes.append(f"{path}: {int((~order).sum())} frames out of order were left out")
    quaternion = None if body.quaternion is None else body.quaternion[order]
    return replace(
        body, t=body.t[order], position=body.position[order], quaternion=quaternion, written=body.written[order]
    )


def _describe_held(held: np.ndarray, t: np.ndarray, name: str) -> str:
    """What was found of frames (n,) that hold an older pose, t (n,) s."""
    starts = runs_of(held)[:, 0]
    step = float(np.median(np.diff(t)))
    when = ", ".join(f"{t[i]:.3f}" for i in starts[:5]) + (", ..." if len(starts) > 5 else "")
    return (
        f"'{name}' keeps one pose to the last digit in {np.count_nonzero(held)} of {len(t)} frames "
        f"({np.count_nonzero(held) * step:.2f} s, in {len(starts)} stretches, from {when} s of the capture) though it "
        "moves: the stream stalled or tracking was lost; they count as not seen"
    )
