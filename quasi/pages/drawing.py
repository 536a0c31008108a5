"""Flights in 3-D figures: trajectories with stills, snapshots, several drones. Nothing is shown or saved here."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from quasi.airframe import Airframe
from quasi.attitude import from_euler
from quasi.errors import DataError, ShapeError
from quasi.pages.drone import Drone, Look, draw_path_line, get_limits, make_axes, make_shape, set_limits, write_caption
from quasi.sensor_limits import check_measured_motion

MIN_STILL_OPACITY = 0.2  # opacity of the oldest still
ENLARGED_SPAN_SHARE = 0.13  # span of an enlarged drone over the largest extent of the figure
# columns of a trajectory as a table: time, position, Euler angles, body velocity, rotor speeds
TRAJECTORY_COLUMNS = ("t", "x", "y", "z", "roll", "pitch", "yaw", "u", "v", "w", "w1", "w2", "w3", "w4")
MAX_DRAWN_POINTS = 4000  # per path; more are not visible


@dataclass(frozen=True)
class Motion:
    """One drone's motion: t (N,) s; position (N, 3) m, earth NED; quaternion (N, 4) wxyz, body to earth;
    rotor_speeds (N, 4) mechanical rad/s, or None; fastest rad/s that is drawn opaque, None for the airframe's limit or
    else the fastest there is; changes  other looks, each from a time (s) on, in the order of their times.
    Rows that are not finite are not drawn. Raises ShapeError or DataError.
    """

    airframe: Airframe
    t: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    rotor_speeds: np.ndarray | None = None
    name: str = ""
    look: Look = field(default_factory=Look)
    fastest: float | None = None
    changes: Sequence[tuple[float, Look]] = ()

    def __post_init__(self) -> None:
        who = f"motion of {self.name}" if self.name else "motion"
        t = np.asarray(self.t, float)
        if t.ndim != 1 or not len(t):
            raise ShapeError(f"{who}: t must be (N,) with N > 0, got {t.shape}")
        object.__setattr__(self, "t", t)
        for name, width in (("position", 3), ("quaternion", 4), ("rotor_speeds", 4)):
            values = getattr(self, name)
            if values is None and name == "rotor_speeds":
                continue
            values = np.asarray(values, float)
            if values.shape != (len(t), width):
                raise ShapeError(f"{who}: {name} must be ({len(t)}, {width}) like t, got {values.shape}")
            object.__setattr__(self, name, values)
        if not self.drawable.any():
            raise DataError(
                f"{who} has no row with finite time, position and attitude; draw a flight whose position was measured"
            )
        if np.any(np.diff(t[np.isfinite(t)]) < 0):
            raise DataError(f"{who}: time steps back; sort the rows by time")

    @property
    def drawable(self) -> np.ndarray:
        """Whether each row can be drawn, (N,)."""
        attitude = np.linalg.norm(self.quaternion, axis=1)
        return np.isfinite(self.t) & np.isfinite(self.position).all(axis=1) & np.isfinite(attitude) & (attitude > 0)

    def row_at(self, time: float) -> int:
        """Find the drawable row nearest to a time, s."""
        rows = np.flatnonzero(self.drawable)
        return int(rows[np.argmin(np.abs(self.t[rows] - time))])

    def choose_look(self, time: float) -> Look:
        """Choose the look at a time, s."""
        return next((look for since, look in reversed(self.changes) if time >= since), self.look)

    def opacity(self, rows: np.ndarray) -> np.ndarray:
        """Compute the opacity (M, 4) of the rotor discs at rows (M,)."""
        if self.rotor_speeds is None or not self.look.rotor_opacity:
            return np.full((len(rows), 4), 0.35)
        return np.clip(np.nan_to_num(self.rotor_speeds[rows]) / self.brightest_speed, 0.0, 1.0)

    @property
    def brightest_speed(self) -> float:
        """Rotor speed drawn opaque, rad/s."""
        if self.fastest:
            return self.fastest
        if self.airframe.max_rpm and self.airframe.logged_to_rad_s:
            return self.airframe.max_rpm * self.airframe.logged_to_rad_s
        speeds = self.rotor_speeds[np.isfinite(self.rotor_speeds)] if self.rotor_speeds is not None else np.zeros(0)
        return float(speeds.max(initial=0.0)) or 1.0


def make_motion(table: pd.DataFrame, airframe: Airframe, name: str = "", look: Look | None = None) -> Motion:
    """Make the motion of a table with columns t, x, y, z, roll, pitch, yaw and, where present, w1 .. w4.

    Raises DataError naming the column that is absent.
    """
    for column in ("t", "x", "y", "z", "roll", "pitch", "yaw"):
        if column not in table:
            raise DataError(
                f"{name or 'the table'} has no column '{column}', which a trajectory needs; make the table again"
            )
    wrapped = table[["roll", "pitch", "yaw"]].to_numpy(float)
    rotors = [f"w{i}" for i in range(1, 5)]
    speeds = table[rotors].to_numpy(float) if set(rotors) <= set(table.columns) else None
    where = table[["x", "y", "z"]].to_numpy(float)
    return Motion(airframe, table["t"].to_numpy(float), where, from_euler(*wrapped.T), speeds, name, look or Look())


def select_flown_rows(table: pd.DataFrame) -> pd.DataFrame:
    """Select the rows of a filtered flight in the air; all rows without an "in_flight" column."""
    return table[table["in_flight"] > 0.5] if "in_flight" in table else table


def make_flown_motion(flying: pd.DataFrame, metadata: Mapping[str, Any], airframe: Airframe, key: str) -> Motion:
    """Make the motion of a filtered flight. metadata  of its filtered table

    Raises DataError, with the flight's name, where no source measured the position or no row can be drawn.
    """
    if not check_measured_motion(metadata)[1] or not {"x", "y", "z"} <= set(flying):
        raise DataError(
            f"flight {key} has no trajectory: no source measured its position (x, y, z), and the integrated "
            "accelerometer drifts; fly it with motion capture, or log a position"
        )
    if not len(flying):
        raise DataError(f"flight {key} has no trajectory: no row is in flight; its page shows why")
    try:
        return make_motion(flying, airframe, key)
    except DataError as error:
        raise DataError(f"flight {key} has no trajectory: {error}") from None


def assign_colours(motions: Sequence[Motion]) -> list[Motion]:
    """Assign a colour to each of several drones with the default look."""
    if len(motions) < 2 or any(m.look != Look() or m.changes for m in motions):
        return list(motions)
    colours = [f"C{k % 10}" for k in range(len(motions))]
    return [replace(m, look=Look(frame=c, rotors=c, nose="black", history=c)) for m, c in zip(motions, colours)]


def choose_enlargement(motions: Sequence[Motion], share: float = ENLARGED_SPAN_SHARE) -> float:
    """Choose the enlargement at which drones are visible: 1 or more, with two digits."""
    low, high = find_extent(motions)
    span = min(make_shape(m.airframe).span for m in motions)
    factor = share * float((high - low).max()) / span
    if factor <= 1.0:
        return 1.0
    digits = 1 - math.floor(math.log10(factor))
    return max(round(factor, digits), 1.0)


def find_extent(motions: Sequence[Motion]) -> tuple[np.ndarray, np.ndarray]:
    """Find least and greatest position (3,), (3,) of all motions, m, earth NED."""
    where = np.concatenate([m.position[m.drawable] for m in motions])
    return where.min(axis=0), where.max(axis=0)


def thin_path(motion: Motion) -> np.ndarray:
    """Thin the path (M, 3) to a visible density; NaN where it cannot be drawn."""
    path = np.where(motion.drawable[:, None], motion.position, np.nan)
    return path[:: max(1, len(path) // MAX_DRAWN_POINTS)]


def trajectories(
    motions: Sequence[Motion],
    stills: int = 5,
    axes: Axes3D | None = None,
    times: Sequence[float] | None = None,
    scale: float | None = None,
    limits: tuple[np.ndarray, np.ndarray] | None = None,
    title: str = "",
    labels: bool = True,
    shadow: bool = True,
) -> Figure:
    """Draw paths of one or several drones with stills; older stills are fainter.

    stills  drones drawn along each path, evenly in time; times  s, take their place where given
    axes    3-D axes to draw in, None for a figure of its own; a second call widens the limits to hold both
    scale   by which the drones are enlarged; None: so that they can be seen, and the figure says by how much
    limits  low (3,) and high (3,), m, NED; None for all that is drawn
    labels  the time, s, at each still; of overlapping stills only the last
    shadow  the path as seen from above, grey on the floor of the box
    Raises DataError when there is nothing to draw.
    """
    if not motions:
        raise DataError("there is no motion to draw; give at least one")
    motions = assign_colours(motions)
    if axes is None:
        axes = make_axes(Figure(figsize=(8, 6.4)))
    scale = choose_enlargement(motions) if scale is None else scale
    filled = axes.has_data()
    for motion in motions:
        shape = make_shape(motion.airframe, scale)
        draw_path_line(axes, thin_path(motion), motion.look.history, label=motion.name or None)
        rows = _choose_still_rows(motion, stills, times)
        if len(rows):
            first, last = motion.t[motion.drawable][[0, -1]]
            age = MIN_STILL_OPACITY + (1 - MIN_STILL_OPACITY) * (motion.t[rows] - first) / max(last - first, 1e-9)
            looks = [motion.choose_look(t) for t in motion.t[rows]]
            for look in dict.fromkeys(looks):
                alike = np.array([other == look for other in looks])
                of = rows[alike]
                Drone(axes, shape, look).pose(
                    motion.position[of], motion.quaternion[of], motion.opacity(of), age[alike]
                )
        if labels and len(rows) <= 12:
            for k, row in enumerate(rows):
                later = np.linalg.norm(motion.position[rows[k + 1 :]] - motion.position[row], axis=1)
                if np.any(later < 0.5 * shape.span):
                    continue  # labels would overlap; the later one has the time
                where = motion.position[row] - [0.0, 0.0, 0.55 * shape.span]
                axes.text(*where, f"{motion.t[row]:.1f} s", fontsize=7, color="0.35", ha="center", va="bottom")
    if limits is None:
        low, high = find_extent(motions)
        room = 0.5 * max(make_shape(m.airframe, scale).span for m in motions)
        low, high = low - room, high + room
        if filled:
            before = get_limits(axes)
            low, high = np.minimum(low, before[0]), np.maximum(high, before[1])
    else:
        low, high = limits
    set_limits(axes, low, high)
    if shadow:
        _draw_shadows(axes, motions)
    if len([m for m in motions if m.name]) > 1:
        axes.legend(fontsize=8, loc="upper right")
    write_caption(axes, title, scale)
    return axes.figure


def _draw_shadows(axes: Axes3D, motions: Sequence[Motion]) -> None:
    """Draw the paths on the floor of the box, after the limits; again where a later call moved the floor."""
    floor = get_limits(axes)[1][2]
    for line in axes.lines:
        if line.get_gid() == "shadow":
            x, y, z = line.get_data_3d()
            line.set_data_3d(x, y, np.full_like(z, floor))
    for motion in motions:
        path = thin_path(motion)
        path[:, 2] = np.where(np.isnan(path[:, 2]), np.nan, floor)
        draw_path_line(axes, path, "0.8", 0.9, gid="shadow")


def trajectory(
    axes: Axes3D | None,
    airframe: Airframe,
    t: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray,
    rotor_speeds: np.ndarray | None = None,
    stills: int = 5,
    look: Look | None = None,
    scale: float | None = None,
    title: str = "",
    name: str = "",
) -> Figure:
    """Draw the path of one drone with stills; older stills and slower rotors are fainter.

    axes  3-D axes of `make_axes`, or None; t (N,) s; position (N, 3) m, earth NED; quaternion (N, 4) wxyz, body to
    earth; rotor_speeds (N, 4) mechanical rad/s, or None. Others as `trajectories`. Raises ShapeError, DataError.
    """
    motion = Motion(airframe, t, position, quaternion, rotor_speeds, name, look or Look())
    return trajectories([motion], stills, axes, scale=scale, title=title)


def snapshots(motions: Sequence[Motion], times: Sequence[float], scale: float | None = None, title: str = "") -> Figure:
    """Draw one panel per time, s, with the drones and their paths until then; all limits are equal.

    Raises DataError when a time lies outside every motion.
    """
    if not motions or not len(times):
        raise DataError("snapshots need at least one motion and one time; give both")
    motions = assign_colours(motions)
    first, last = min(float(m.t[m.drawable][0]) for m in motions), max(float(m.t[m.drawable][-1]) for m in motions)
    for time in times:
        if not first <= time <= last:
            raise DataError(f"there is nothing to draw at {time:g} s; choose times from {first:g} to {last:g} s")
    columns = min(len(times), 3)
    rows = math.ceil(len(times) / columns)
    figure = Figure(figsize=(4.8 * columns, 4.2 * rows + 0.3))
    figure.subplots_adjust(0.05, 0.02, 0.98, 0.93, wspace=0.16, hspace=0.02)
    scale = choose_enlargement(motions, 1.4 * ENLARGED_SPAN_SHARE) if scale is None else scale
    low, high = find_extent(motions)
    room = 0.5 * max(make_shape(m.airframe, scale).span for m in motions)
    for number, time in enumerate(times, 1):
        axes = make_axes(figure, (rows, columns, number))
        until = [_cut_motion(m, time) for m in motions]
        box = (low - room, high + room)
        trajectories([m for m in until if m is not None], 0, axes, [time], scale, box, labels=False)
        write_caption(axes, f"{time:g} s", 1.0)
    lines = [title] if title else []
    if scale > 1.0:
        lines.append(f"drones drawn {scale:g} times their size")
    figure.suptitle(", ".join(lines), fontsize=10, x=0.01, ha="left")
    return figure


def _cut_motion(motion: Motion, time: float) -> Motion | None:
    keep = motion.t <= time
    if not (keep & motion.drawable).any():
        return None
    speeds = motion.rotor_speeds[keep] if motion.rotor_speeds is not None else None
    return replace(
        motion,
        t=motion.t[keep],
        position=motion.position[keep],
        quaternion=motion.quaternion[keep],
        rotor_speeds=speeds,
        fastest=motion.brightest_speed,
    )


def _choose_still_rows(motion: Motion, stills: int, times: Sequence[float] | None) -> np.ndarray:
    if times is None:
        first, last = motion.t[motion.drawable][[0, -1]]
        times = np.linspace(first, last, stills) if stills > 1 else [last][:stills]
    return np.array(sorted({motion.row_at(time) for time in times}), int)
