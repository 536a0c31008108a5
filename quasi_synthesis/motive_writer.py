"""Write a Motive CSV export (format version 1.23) of one rigid body with its markers.

Motive's axes: y up; x_E = z_G, y_E = -x_G, z_E = -y_G between the capture frame G and earth E, so that a rotation about
G's z is roll, about -x pitch, about -y yaw. Quaternions are written X Y Z W, lengths in metres.
"""

import numpy as np

from quasi_synthesis.sensors import SEEN_MARKERS, Capture

# rows: the axes of G in earth coordinates
EARTH_TO_MOTIVE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def to_motive(vectors: np.ndarray) -> np.ndarray:
    """Earth NED vectors (..., 3) in Motive's axes."""
    return np.asarray(vectors, float) @ EARTH_TO_MOTIVE.T


def quaternion_to_motive(quaternion: np.ndarray) -> np.ndarray:
    """Attitudes (..., 4), w x y z body to earth, as Motive's X Y Z W: a change of basis turns the vector part alone."""
    quaternion = np.asarray(quaternion, float)
    return np.concatenate([to_motive(quaternion[..., 1:]), quaternion[..., :1]], axis=-1)


def motive_csv(take: Capture, body: str, name: str, started: str) -> str:
    """The text of the export.

    take  what the system saw; body  name of the rigid body; name  of the take; started  capture start as Motive prints
    it, "2026-03-14 10.21.33.412 AM". Frames in which the body was not seen have empty cells.
    """
    n, count = take.markers.shape[:2]
    labels = [f"{body}:Marker{k + 1}" for k in range(count)]
    loose = [f"{body}_{k + 1}" for k in range(count)]
    kinds = ["Rigid Body"] * 8 + ["Rigid Body Marker"] * 4 * count + ["Marker"] * 3 * count
    names = [body] * 8 + [s for s in labels for _ in range(4)] + [s for s in loose for _ in range(3)]
    ids = ["1"] * 8 + [f"1.{k + 1}" for k in range(count) for _ in range(4)]
    ids += [f"{2001 + k}" for k in range(count) for _ in range(3)]
    what = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
    what += (["Position"] * 3 + ["Marker Quality"]) * count + ["Position"] * 3 * count
    axes = ["X", "Y", "Z", "W", "X", "Y", "Z", ""] + ["X", "Y", "Z", ""] * count + ["X", "Y", "Z"] * count
    pairs = {
        "Format Version": "1.23",
        "Take Name": name,
        "Take Notes": "",
        "Capture Frame Rate": f"{take.rate:.6f}",
        "Export Frame Rate": f"{take.rate:.6f}",
        "Capture Start Time": started,
        "Capture Start Frame": "0",
        "Total Frames in Take": str(n),
        "Total Exported Frames": str(n),
        "Rotation Type": "Quaternion",
        "Length Units": "Meters",
        "Coordinate Space": "Global",
    }
    lines = [",".join(f"{k},{v}" for k, v in pairs.items()), ""]
    for label, row in (("Type", kinds), ("Name", [f'"{s}"' for s in names]), ("ID", [f'"{s}"' for s in ids])):
        lines.append(",".join(["", label, *row]))
    lines.append(",".join(["", "", *what]))
    lines.append(",".join(["Frame", "Time (Seconds)", *axes]))

    position, rotation = to_motive(take.position), quaternion_to_motive(take.quaternion)
    seen = np.isfinite(take.error)
    # the rigid body's own markers are where its pose puts them
    solved = position[:, None, :] + _turned(take)
    quality = np.where(np.isfinite(take.markers[:, :, :1]), 1.0, 0.0)
    blocks = np.concatenate([np.where(seen[:, None, None], solved, np.nan), quality], axis=2).reshape(n, -1)
    table = np.column_stack([rotation, position, take.error, blocks, to_motive(take.markers).reshape(n, -1)])
    row_form = ",".join(["%.6f"] * table.shape[1])
    bad = ~np.isfinite(table).all(axis=1)
    for frame, time, row, incomplete in zip(take.frame.tolist(), take.time.tolist(), table.tolist(), bad.tolist()):
        text = row_form % tuple(row)
        lines.append(f"{frame},{time:.6f},{text.replace('nan', '') if incomplete else text}")
    return "\n".join(lines) + "\n"


def _turned(take: Capture) -> np.ndarray:
    """Markers about their centroid (N, K, 3), turned by the pose, in Motive's axes."""
    w, v = take.quaternion[:, :1], take.quaternion[:, 1:]
    out = np.empty((len(w), len(SEEN_MARKERS), 3))
    for k, marker in enumerate(SEEN_MARKERS):
        t = 2.0 * np.cross(v, marker[None, :])
        out[:, k] = to_motive(marker[None, :] + w * t + np.cross(v, t))
    return out
