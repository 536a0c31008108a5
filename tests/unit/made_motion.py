"""A tumbling, travelling body with known truth, as a gyro and a capture system would see it."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

G = 9.81


class Body(NamedTuple):
    """t (n,) s; position (n, 3) m NED; quaternion (n, 4) wxyz; rates (n, 3); force (n, 3) specific force, body FRD."""

    t: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    rates: np.ndarray
    force: np.ndarray


def body(seconds: float = 40.0, rate: float = 1000.0, seed: int = 1, rest: float = 0.0) -> Body:
    """Euler angles and position as random sums of sines; rates and specific force by fine central differences."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate

    def sum_of_sines(size: float, low: float, high: float, at: np.ndarray) -> np.ndarray:
        f, phase, a = rng.uniform(low, high, 9), rng.uniform(0, 2 * np.pi, 9), rng.normal(size=9)
        start = 1 / (1 + np.exp(-(at - rest - 1.0) * 6)) if rest else np.ones_like(at)
        return start * size * sum(ai * np.sin(2 * np.pi * fi * at + pi) for ai, fi, pi in zip(a, f, phase)) / 3

    h = 1e-4
    state = rng.bit_generator.state

    def pose(at: np.ndarray) -> tuple[Rotation, np.ndarray]:
        rng.bit_generator.state = state
        angles = [sum_of_sines(s, 0.1, 1.6, at) for s in (0.5, 0.5, 0.8)]
        place = np.stack([sum_of_sines(0.8, 0.05, 0.5, at) for _ in range(3)], axis=-1)
        return Rotation.from_euler("ZYX", np.stack(angles[::-1], axis=-1)), place

    now, place = pose(t)
    before, place_before = pose(t - h)
    after, place_after = pose(t + h)
    rates = (before.inv() * after).as_rotvec() / (2 * h)
    acceleration = (place_after - 2 * place + place_before) / h**2
    force = now.inv().apply(acceleration - np.array([0, 0, G]))
    return Body(t, place, now.as_quat(scalar_first=True), rates, force)


def at_times(truth: Body, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and quaternion of the truth at other times, by scipy's own interpolation."""
    turn = Slerp(truth.t, Rotation.from_quat(truth.quaternion, scalar_first=True))
    t = np.clip(t, truth.t[0], truth.t[-1])
    return (
        np.stack([np.interp(t, truth.t, p) for p in truth.position.T], axis=-1),
        turn(t).as_quat(scalar_first=True, canonical=False),
    )


def motive_text(
    frame: np.ndarray,
    time: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray | None,
    name: str = "Quad",
    rate: float = 120.0,
    **style: object,
) -> str:
    """A Motive export of a body whose earth NED pose is given; written column by column, by Motive's own axes.

    style: blank (second line blank), labels, parent, unit, angles ("XYZ"), other (a second body's name), digits of time
    """
    unit = {"Meters": 1.0, "Centimeters": 100.0, "Millimeters": 1000.0}[style.get("unit", "Meters")]
    # Motive's axes: its z is our x, minus its x our y, minus its y our z
    room = np.stack([-position[:, 1], -position[:, 2], position[:, 0]], axis=-1) * unit
    turns, axes = [], []
    if quaternion is not None:
        w, x, y, z = quaternion.T
        in_room = np.stack([-y, -z, x, w], axis=-1)
        if style.get("angles"):
            good = np.isfinite(in_room).all(axis=1)
            turns = np.full((len(frame), 3), np.nan)
            turns[good] = Rotation.from_quat(in_room[good]).as_euler(style["angles"], degrees=True)
            order = style["angles"]
            turns = turns[:, [order.index(c) for c in "XYZ"]]
            axes = list("XYZ")
        else:
            turns, axes = in_room, list("XYZW")
    body_axes = [("Rotation", a) for a in axes] + [("Position", a) for a in "XYZ"] + [("Mean Marker Error", "")]
    values = np.column_stack(([turns] if len(axes) else []) + [room, np.full(len(frame), 1e-4)])
    blocks = [("Marker", f"{name}", [("Position", a) for a in "XYZ"], room + 7.0)]
    if style.get("other"):
        blocks.append(("Rigid Body", style["other"], body_axes, values + 1.0))
    blocks.append(("Rigid Body", name, body_axes, values))
    marker_axes = [("Position", a) for a in "XYZ"] + [("Marker Quality", "")]
    blocks.append(("Rigid Body Marker", name, marker_axes, np.c_[room, room[:, 0]] - 3))
    blocks.append(("Bone", name, body_axes, values - 2.0))
    label = style.get("labels", False)
    rows = {
        "Type": [k for k, _, c, _ in blocks for _ in c],
        "Name": [n for _, n, c, _ in blocks for _ in c],
        "ID": [f'"{i:X}"' for i, (_, _, c, _) in enumerate(blocks) for _ in c],
    }
    if style.get("parent"):
        rows["Parent"] = ['"0"' for v in rows["ID"]]
    head = (
        f"Format Version,1.23,Take Name,Take 1,Take Notes,,Capture Frame Rate,{rate:.6f},Export Frame Rate,{rate:.6f},"
        f"Capture Start Time,2024-03-01 02.11.08.123 下午,Rotation Type,{style.get('angles', 'Quaternion')},"
        f"Length Units,{style.get('unit', 'Meters')},Coordinate Space,Global"
    )
    lines = [head] + ([""] if style.get("blank", True) else [])
    lines += [",".join(["", key if label else "", *row]) for key, row in rows.items()]
    lines.append(",".join(["", "", *[q for _, _, c, _ in blocks for q, _ in c]]))
    lines.append(",".join(["Frame", "Time (Seconds)", *[a for _, _, c, _ in blocks for _, a in c]]))
    table = np.column_stack([v for _, _, _, v in blocks])
    digits = style.get("digits", 3)
    for f, t, row in zip(frame, time, table):
        cells = ["" if not np.isfinite(v) else f"{v:.6f}" for v in row]
        lines.append(",".join([str(int(f)), f"{t:.{digits}f}", *cells]))
    return "\n".join(lines) + "\n"
