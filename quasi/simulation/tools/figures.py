"""Figures of a simulation from its table: states, rotor speeds, forces and moments, tracking, trajectory."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from quasi.airframe import Airframe
from quasi.attitude import conjugate, from_euler, logarithm, multiply, rotate_inverse
from quasi.errors import DataError
from quasi.pages.drawing import make_motion, trajectories
from quasi.pages.drone import draw_path_line, get_limits, make_axes

STATE_COLOUR, REFERENCE_COLOUR, LIMIT_COLOUR, FAULT_COLOUR = "C0", "k", "0.5", "C3"
ANGLE_JUMP = 120.0  # deg between rows: more is a wrap by 360, or a turn by 180 with the nose through the vertical
MAX_LINE_POINTS = 8000  # per line; more are not visible
POSITION_PANELS = (("x", "north x, m"), ("y", "east y, m"), ("z", "down z, m"))
VELOCITY_PANELS = (("u", "forward u, m/s"), ("v", "right v, m/s"), ("w", "down w, m/s"))
ATTITUDE_PANELS = (("roll", "roll, deg"), ("pitch", "pitch, deg"), ("yaw", "yaw, deg"))
RATE_PANELS = (("p", "roll rate p, deg/s"), ("q", "pitch rate q, deg/s"), ("r", "yaw rate r, deg/s"))
LOAD_PANELS = (
    *(("Fx", "Fx, N"), ("Fy", "Fy, N"), ("Fz", "Fz, N")),
    *(("Mx", "Mx, N m"), ("My", "My, N m"), ("Mz", "Mz, N m")),
)


def draw_simulation(table: pd.DataFrame, airframe: Airframe, about: Mapping[str, Any]) -> dict[str, Figure]:
    """Draw figures by name: overview, states, rotor_speeds, forces_and_moments, trajectory; tracking_error with a
    reference.

    table  t; x y z; roll pitch yaw; u v w; p q r; w1..w4; Fx..Mz (SI, rad); where present w1_CMD..w4_CMD and references
           <name>_ref of any of these, vx_ref vy_ref vz_ref (m/s, earth) among them; NaN without a reference
    about  "name" for the titles; "speed limits" [lowest, highest] rad/s, else the airframe's; "fault time" s or None;
           "ended" a sentence when the simulation ended early. Each may be absent.
    Raises DataError naming a column that is absent.
    """
    needed = [
        "t",
        *(name for name, _ in (*POSITION_PANELS, *VELOCITY_PANELS, *ATTITUDE_PANELS, *RATE_PANELS, *LOAD_PANELS)),
        *_name_rotors(),
    ]
    missing = [name for name in needed if name not in table]
    if missing:
        raise DataError(f"the simulation's table has no column '{missing[0]}'; run the simulation again")
    if not len(table):
        raise DataError("the simulation's table has no rows; let the simulation run for at least one step")
    columns = {name: table[name].to_numpy(float) for name in table.columns if table[name].dtype.kind in "fiub"}
    columns |= _rotate_velocity_reference(columns)
    columns = {name: values[_thin_rows(len(table))] for name, values in columns.items()}
    figures = {
        "overview": _draw_overview(table, columns, airframe, about),
        "states": _draw_states(columns, about),
        "rotor_speeds": _draw_rotor_speeds(columns, airframe, about),
        "forces_and_moments": _draw_loads(columns, about),
        "trajectory": _draw_trajectory(table, airframe, about),
    }
    if any(np.isfinite(v).any() for name, v in columns.items() if name.endswith("_ref")):
        figures["tracking_error"] = _draw_tracking(columns, about)
    return figures


def _name_rotors() -> list[str]:
    return [f"w{i}" for i in range(1, 5)]


def _thin_rows(n: int) -> slice:
    return slice(None, None, max(1, n // MAX_LINE_POINTS))


def _make_title(what: str, about: Mapping[str, Any]) -> str:
    name = about.get("name")
    ended = about.get("ended")
    return (f"{name}: {what}" if name else what) + (f" ({ended})" if ended else "")


def _rotate_velocity_reference(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """u_ref, v_ref, w_ref from a velocity reference in earth axes, by the simulated attitude."""
    earth = ("vx_ref", "vy_ref", "vz_ref")
    if not set(earth) <= set(columns) or "u_ref" in columns:
        return {}
    turned = rotate_inverse(
        from_euler(columns["roll"], columns["pitch"], columns["yaw"]), np.stack([columns[n] for n in earth], axis=-1)
    )
    return dict(zip(("u_ref", "v_ref", "w_ref"), turned.T))


def _convert_to_degrees(name: str, values: np.ndarray) -> np.ndarray:
    """Convert angles and rates to degrees, with a gap where an angle jumps (see ANGLE_JUMP)."""
    base = name.removesuffix("_ref")
    if base in ("p", "q", "r"):
        return np.degrees(values)
    if base not in ("roll", "pitch", "yaw"):
        return values
    shown = np.degrees((values + np.pi) % (2 * np.pi) - np.pi)
    shown[1:][np.abs(np.diff(shown)) > ANGLE_JUMP] = np.nan
    return shown


def _limit_axis(axis: Axes, values: np.ndarray) -> None:
    """Limit the axis where a few last values of a diverging simulation would stretch it."""
    values = values[np.isfinite(values)]
    if not len(values):
        return
    low, high = np.percentile(values, [1.0, 99.0])
    span = max(high - low, 1e-9)
    if values.min() < low - 10.0 * span or values.max() > high + 10.0 * span:
        axis.set_ylim(low - span, high + span)


def _mark_axis(axis: Axes, about: Mapping[str, Any]) -> None:
    axis.grid(alpha=0.3)
    axis.margins(x=0)
    axis.tick_params(labelsize=8)
    if about.get("fault time") is not None:
        axis.axvline(about["fault time"], color=FAULT_COLOUR, linestyle=":", linewidth=1.2, label="fault")


def _add_legend(figure: Figure, axes: list[Axes]) -> None:
    """Add one legend for all panels above them."""
    named: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels()):
            named.setdefault(label, handle)
    if len(named) > 1 or "fault" in named:
        figure.legend(named.values(), named.keys(), loc="outside upper right", ncols=len(named), fontsize="small")


def _make_panels(title: str, rows: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=size, layout="constrained")
    axes = list(figure.subplots(rows, 3, sharex=True).flat)
    figure.suptitle(title, x=0.01, ha="left", fontsize="large")
    for axis in axes[-3:]:
        axis.set_xlabel("time, s", fontsize=9)
    return figure, axes


def _draw_states(columns: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> Figure:
    figure, axes = _make_panels(_make_title("states", about), 4, (12, 8.5))
    for axis, (name, label) in zip(axes, (*POSITION_PANELS, *VELOCITY_PANELS, *ATTITUDE_PANELS, *RATE_PANELS)):
        values = _convert_to_degrees(name, columns[name])
        axis.plot(columns["t"], values, color=STATE_COLOUR, linewidth=1.2, label="simulated")
        wanted = columns.get(f"{name}_ref")
        if wanted is not None and np.isfinite(wanted).any():
            aim = _convert_to_degrees(name, wanted)
            axis.plot(columns["t"], aim, color=REFERENCE_COLOUR, linewidth=0.9, linestyle="--", label="reference")
            values = np.concatenate([values, aim])
        _limit_axis(axis, values)
        axis.set_ylabel(label, fontsize=9)
        _mark_axis(axis, about)
        if name == "z":
            axis.invert_yaxis()  # up is up
    _add_legend(figure, axes)
    return figure


def _draw_rotor_speeds(columns: Mapping[str, np.ndarray], airframe: Airframe, about: Mapping[str, Any]) -> Figure:
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    axes = list(figure.subplots(4, 1, sharex=True, sharey=True))
    figure.suptitle(_make_title("rotor speeds", about), x=0.01, ha="left", fontsize="large")
    places = {number: place for place, number in airframe.positions.items()}
    for number, (axis, name) in enumerate(zip(axes, _name_rotors()), 1):
        command = columns.get(f"{name}_CMD")
        if command is not None:
            axis.plot(columns["t"], command, color="C1", linewidth=0.7, alpha=0.8, label="command")
        axis.plot(columns["t"], columns[name], color=STATE_COLOUR, linewidth=1.2, label="rotor")
        for limit in _find_speed_limits(airframe, about):
            axis.axhline(limit, color=LIMIT_COLOUR, linestyle="--", linewidth=0.9, label="limits")
        place = f" ({places[number]})" if number in places else ""
        axis.set_ylabel(f"rotor {number}{place},\nrad/s", fontsize=9)
        _mark_axis(axis, about)
    axes[-1].set_xlabel("time, s")
    _add_legend(figure, axes)
    return figure


def _find_speed_limits(airframe: Airframe, about: Mapping[str, Any]) -> list[float]:
    given = about.get("speed limits")
    if given is None:
        factor = airframe.logged_to_rad_s
        given = [v * factor if v is not None and factor else None for v in (airframe.idle_rpm, airframe.max_rpm)]
    return [float(v) for v in given if v is not None and np.isfinite(v)]


def _draw_loads(columns: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> Figure:
    figure, axes = _make_panels(_make_title("forces and moments, body axes", about), 2, (12, 5.5))
    for axis, (name, label) in zip(axes, LOAD_PANELS):
        axis.plot(columns["t"], columns[name], color=STATE_COLOUR, linewidth=0.9)
        _limit_axis(axis, columns[name])
        axis.set_ylabel(label, fontsize=9)
        _mark_axis(axis, about)
    _add_legend(figure, axes)
    return figure


def _draw_tracking(columns: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> Figure:
    groups = [
        (group, names, unit)
        for group, names, unit in (
            ("position", POSITION_PANELS, "m"),
            ("velocity", VELOCITY_PANELS, "m/s"),
            ("attitude", ATTITUDE_PANELS, "deg"),
            ("body rate", RATE_PANELS, "deg/s"),
        )
        if any(np.isfinite(columns.get(f"{n}_ref", np.array([np.nan]))).any() for n, _ in names)
    ]
    figure = Figure(figsize=(9, 1.2 + 2.1 * len(groups)), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(len(groups), 1, sharex=True)))
    figure.suptitle(_make_title("reference minus simulated", about), x=0.01, ha="left", fontsize="large")
    turned = _compute_attitude_error(columns)
    for axis, (group, names, unit) in zip(axes, groups):
        every = []
        for colour, (name, _) in zip(("C0", "C1", "C2"), names):
            wanted = columns.get(f"{name}_ref")
            if wanted is None or not np.isfinite(wanted).any():
                continue
            error = turned[name] if name in turned else _wrap_error(name, wanted - columns[name])
            rms = float(np.sqrt(np.nanmean(error**2)))
            if unit == "deg":
                error[1:][np.abs(np.diff(error)) > ANGLE_JUMP] = np.nan
            axis.plot(columns["t"], error, color=colour, linewidth=1, label=f"{name}, rms {rms:.3g} {unit}")
            every.append(error)
        _limit_axis(axis, np.concatenate(every))
        axis.set_ylabel(f"{group}, {unit}", fontsize=9)
        _mark_axis(axis, about)
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), fontsize=8, ncols=4, frameon=False)
    axes[-1].set_xlabel("time, s")
    return figure


def _compute_attitude_error(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Rotation from the simulated to the reference attitude about the body axes, deg, where all three angles have one.

    Differences of Euler angles are meaningless with the nose near the vertical.
    """
    wanted = [columns.get(f"{name}_ref") for name, _ in ATTITUDE_PANELS]
    if any(angle is None for angle in wanted):
        return {}
    simulated = from_euler(*(columns[name] for name, _ in ATTITUDE_PANELS))
    turn = np.degrees(logarithm(multiply(conjugate(simulated), from_euler(*wanted))))
    return {name: turn[:, k].copy() for k, (name, _) in enumerate(ATTITUDE_PANELS)}


def _wrap_error(name: str, error: np.ndarray) -> np.ndarray:
    if name in ("roll", "pitch", "yaw"):
        return np.degrees((error + np.pi) % (2 * np.pi) - np.pi)
    return np.degrees(error) if name in ("p", "q", "r") else error


def _draw_overview(
    table: pd.DataFrame, columns: Mapping[str, np.ndarray], airframe: Airframe, about: Mapping[str, Any]
) -> Figure:
    """Draw the path, and position, attitude and rotor speeds over time."""
    figure = Figure(figsize=(12, 5.2))
    _draw_trajectory(table, airframe, about, make_axes(figure, (1, 2, 1)))
    figure.axes[0].set_position((0.01, -0.02, 0.54, 1.02))
    groups = (
        ([name for name, _ in POSITION_PANELS], "position, m"),
        ([name for name, _ in ATTITUDE_PANELS], "attitude, deg"),
        (_name_rotors(), "rotor speed, rad/s"),
    )
    for k, (names, label) in enumerate(groups):
        axis = figure.add_axes((0.6, 0.7 - 0.295 * k, 0.33, 0.255))
        every = []
        for colour, name in zip(("C0", "C1", "C2", "C4"), names):
            every.append(_convert_to_degrees(name, columns[name].copy()))
            axis.plot(columns["t"], every[-1], color=colour, linewidth=1.2, label=name)
            wanted = columns.get(f"{name}_ref")
            if wanted is not None and np.isfinite(wanted).any():
                axis.plot(
                    columns["t"],
                    _convert_to_degrees(name, wanted.copy()),
                    color=REFERENCE_COLOUR,
                    linewidth=0.8,
                    linestyle="--",
                )
        _limit_axis(axis, np.concatenate(every))
        axis.set_ylabel(label, fontsize=9)
        _mark_axis(axis, about)
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
        if k < 2:
            axis.set_xticklabels([])
    axis.set_xlabel("time, s", fontsize=9)
    return figure


def _draw_trajectory(
    table: pd.DataFrame, airframe: Airframe, about: Mapping[str, Any], axes: Axes3D | None = None
) -> Figure:
    motion = make_motion(cut_runaway_rows(table), airframe)
    figure = trajectories(
        [motion], about.get("stills", 6), axes, title=_make_title("path" if axes is None else "flight", about)
    )
    wanted = [f"{axis}_ref" for axis in "xyz"]
    if set(wanted) <= set(table.columns):
        aim = table[wanted].to_numpy(float)[_thin_rows(len(table))].copy()
        low, high = get_limits(figure.axes[0])
        aim[~((aim >= low) & (aim <= high)).all(axis=1)] = np.nan  # a step to a position that the drone has not reached
        if np.isfinite(aim).all(axis=1).any():
            draw_path_line(figure.axes[0], aim, REFERENCE_COLOUR, 0.8, linestyle="--", label="reference")
            figure.axes[0].legend(fontsize=8, loc="upper right")
    return figure


def cut_runaway_rows(table: pd.DataFrame) -> pd.DataFrame:
    """Cut the last rows of a diverging simulation whose positions would hide all others."""
    where = table[["x", "y", "z"]].to_numpy(float)
    away = np.linalg.norm(where - np.nanmedian(where, axis=0), axis=1)
    far = ~(away <= 20.0 * max(float(np.nanpercentile(away, 95.0)), 0.05))
    return table.iloc[: int(np.argmax(far))] if far.any() and not far[0] else table
