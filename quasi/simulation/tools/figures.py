"""The figures of a simulation, from its table alone: states, rotor speeds, forces and moments, tracking, trajectory."""

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
from quasi.pages.drawing import motion_of, trajectories
from quasi.pages.drone import get_limits, new_axes, path_line

STATE, REFERENCE, LIMIT, FAULT = "C0", "k", "0.5", "C3"
JUMP = 120.0  # deg between rows: an angle that wraps by 360, or turns by 180 as the nose passes the vertical
MOST_POINTS = 8000  # a line drawn denser shows nothing more
POSITION = (("x", "north x, m"), ("y", "east y, m"), ("z", "down z, m"))
VELOCITY = (("u", "forward u, m/s"), ("v", "right v, m/s"), ("w", "down w, m/s"))
ATTITUDE = (("roll", "roll, deg"), ("pitch", "pitch, deg"), ("yaw", "yaw, deg"))
RATES = (("p", "roll rate p, deg/s"), ("q", "pitch rate q, deg/s"), ("r", "yaw rate r, deg/s"))
LOADS = (
    *(("Fx", "Fx, N"), ("Fy", "Fy, N"), ("Fz", "Fz, N")),
    *(("Mx", "Mx, N m"), ("My", "My, N m"), ("Mz", "Mz, N m")),
)


def simulation_figures(table: pd.DataFrame, airframe: Airframe, about: Mapping[str, Any]) -> dict[str, Figure]:
    """Figures by name: overview, states, rotor_speeds, forces_and_moments, trajectory; tracking_error with a reference.

    table  t; x y z; roll pitch yaw; u v w; p q r; w1..w4; Fx..Mz (SI, rad); where present w1_CMD..w4_CMD and references
           <name>_ref of any of these, vx_ref vy_ref vz_ref (m/s, earth) among them; NaN where nothing is referred to
    about  "name" for the titles; "speed limits" [lowest, highest] rad/s, else the airframe's; "fault time" s or None;
           "ended" a sentence when the simulation ended before its time. Each may be absent.
    Raises DataError naming a column that is absent.
    """
    needed = ["t", *(name for name, _ in (*POSITION, *VELOCITY, *ATTITUDE, *RATES, *LOADS)), *_rotors()]
    missing = [name for name in needed if name not in table]
    if missing:
        raise DataError(f"the simulation's table has no column '{missing[0]}'; run the simulation again")
    if not len(table):
        raise DataError("the simulation's table has no rows; let the simulation run for at least one step")
    columns = {name: table[name].to_numpy(float) for name in table.columns if table[name].dtype.kind in "fiub"}
    columns |= _body_velocity_reference(columns)
    columns = {name: values[_stride(len(table))] for name, values in columns.items()}
    figures = {
        "overview": _overview(table, columns, airframe, about),
        "states": _states(columns, about),
        "rotor_speeds": _rotor_speeds(columns, airframe, about),
        "forces_and_moments": _loads(columns, about),
        "trajectory": _trajectory(table, airframe, about),
    }
    if any(np.isfinite(v).any() for name, v in columns.items() if name.endswith("_ref")):
        figures["tracking_error"] = _tracking(columns, about)
    return figures


def _rotors() -> list[str]:
    return [f"w{i}" for i in range(1, 5)]


def _stride(n: int) -> slice:
    return slice(None, None, max(1, n // MOST_POINTS))


def _title(what: str, about: Mapping[str, Any]) -> str:
    name = about.get("name")
    ended = about.get("ended")
    return (f"{name}: {what}" if name else what) + (f" ({ended})" if ended else "")


def _body_velocity_reference(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """u_ref, v_ref, w_ref from a velocity reference in earth axes, turned by the simulated attitude."""
    earth = ("vx_ref", "vy_ref", "vz_ref")
    if not set(earth) <= set(columns) or "u_ref" in columns:
        return {}
    turned = rotate_inverse(
        from_euler(columns["roll"], columns["pitch"], columns["yaw"]), np.stack([columns[n] for n in earth], axis=-1)
    )
    return dict(zip(("u_ref", "v_ref", "w_ref"), turned.T))


def _shown(name: str, values: np.ndarray) -> np.ndarray:
    """Degrees for angles and rates, with a gap in the line where an angle jumps (see JUMP)."""
    base = name.removesuffix("_ref")
    if base in ("p", "q", "r"):
        return np.degrees(values)
    if base not in ("roll", "pitch", "yaw"):
        return values
    shown = np.degrees((values + np.pi) % (2 * np.pi) - np.pi)
    shown[1:][np.abs(np.diff(shown)) > JUMP] = np.nan
    return shown


def _keep_in_sight(axis: Axes, values: np.ndarray) -> None:
    """Limits that a few last values of a simulation out of control do not blow up."""
    values = values[np.isfinite(values)]
    if not len(values):
        return
    low, high = np.percentile(values, [1.0, 99.0])
    span = max(high - low, 1e-9)
    if values.min() < low - 10.0 * span or values.max() > high + 10.0 * span:
        axis.set_ylim(low - span, high + span)


def _marks(axis: Axes, about: Mapping[str, Any]) -> None:
    axis.grid(alpha=0.3)
    axis.margins(x=0)
    axis.tick_params(labelsize=8)
    if about.get("fault time") is not None:
        axis.axvline(about["fault time"], color=FAULT, linestyle=":", linewidth=1.2, label="fault")


def _legend(figure: Figure, axes: list[Axes]) -> None:
    """One legend for all panels, above them, so that it hides nothing."""
    named: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels()):
            named.setdefault(label, handle)
    if len(named) > 1 or "fault" in named:
        figure.legend(named.values(), named.keys(), loc="outside upper right", ncols=len(named), fontsize="small")


def _panels(title: str, rows: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=size, layout="constrained")
    axes = list(figure.subplots(rows, 3, sharex=True).flat)
    figure.suptitle(title, x=0.01, ha="left", fontsize="large")
    for axis in axes[-3:]:
        axis.set_xlabel("time, s", fontsize=9)
    return figure, axes


def _states(columns: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> Figure:
    figure, axes = _panels(_title("states", about), 4, (12, 8.5))
    for axis, (name, label) in zip(axes, (*POSITION, *VELOCITY, *ATTITUDE, *RATES)):
        values = _shown(name, columns[name])
        axis.plot(columns["t"], values, color=STATE, linewidth=1.2, label="simulated")
        wanted = columns.get(f"{name}_ref")
        if wanted is not None and np.isfinite(wanted).any():
            aim = _shown(name, wanted)
            axis.plot(columns["t"], aim, color=REFERENCE, linewidth=0.9, linestyle="--", label="reference")
            values = np.concatenate([values, aim])
        _keep_in_sight(axis, values)
        axis.set_ylabel(label, fontsize=9)
        _marks(axis, about)
        if name == "z":
            axis.invert_yaxis()  # up is up
    _legend(figure, axes)
    return figure


def _rotor_speeds(columns: Mapping[str, np.ndarray], airframe: Airframe, about: Mapping[str, Any]) -> Figure:
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    axes = list(figure.subplots(4, 1, sharex=True, sharey=True))
    figure.suptitle(_title("rotor speeds", about), x=0.01, ha="left", fontsize="large")
    places = {number: place for place, number in airframe.positions.items()}
    for number, (axis, name) in enumerate(zip(axes, _rotors()), 1):
        command = columns.get(f"{name}_CMD")
        if command is not None:
            axis.plot(columns["t"], command, color="C1", linewidth=0.7, alpha=0.8, label="command")
        axis.plot(columns["t"], columns[name], color=STATE, linewidth=1.2, label="rotor")
        for limit in _limits(airframe, about):
            axis.axhline(limit, color=LIMIT, linestyle="--", linewidth=0.9, label="limits")
        place = f" ({places[number]})" if number in places else ""
        axis.set_ylabel(f"rotor {number}{place},\nrad/s", fontsize=9)
        _marks(axis, about)
    axes[-1].set_xlabel("time, s")
    _legend(figure, axes)
    return figure


def _limits(airframe: Airframe, about: Mapping[str, Any]) -> list[float]:
    given = about.get("speed limits")
    if given is None:
        factor = airframe.logged_to_rad_s
        given = [v * factor if v is not None and factor else None for v in (airframe.idle_rpm, airframe.max_rpm)]
    return [float(v) for v in given if v is not None and np.isfinite(v)]


def _loads(columns: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> Figure:
    figure, axes = _panels(_title("forces and moments, body axes", about), 2, (12, 5.5))
    for axis, (name, label) in zip(axes, LOADS):
        axis.plot(columns["t"], columns[name], color=STATE, linewidth=0.9)
        _keep_in_sight(axis, columns[name])
        axis.set_ylabel(label, fontsize=9)
        _marks(axis, about)
    _legend(figure, axes)
    return figure


def _tracking(columns: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> Figure:
    groups = [
        (group, names, unit)
        for group, names, unit in (
            ("position", POSITION, "m"),
            ("velocity", VELOCITY, "m/s"),
            ("attitude", ATTITUDE, "deg"),
            ("body rate", RATES, "deg/s"),
        )
        if any(np.isfinite(columns.get(f"{n}_ref", np.array([np.nan]))).any() for n, _ in names)
    ]
    figure = Figure(figsize=(9, 1.2 + 2.1 * len(groups)), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(len(groups), 1, sharex=True)))
    figure.suptitle(_title("reference less simulated", about), x=0.01, ha="left", fontsize="large")
    turned = _attitude_error(columns)
    for axis, (group, names, unit) in zip(axes, groups):
        every = []
        for colour, (name, _) in zip(("C0", "C1", "C2"), names):
            wanted = columns.get(f"{name}_ref")
            if wanted is None or not np.isfinite(wanted).any():
                continue
            error = turned[name] if name in turned else _error(name, wanted - columns[name])
            rms = float(np.sqrt(np.nanmean(error**2)))
            if unit == "deg":
                error[1:][np.abs(np.diff(error)) > JUMP] = np.nan
            axis.plot(columns["t"], error, color=colour, linewidth=1, label=f"{name}, rms {rms:.3g} {unit}")
            every.append(error)
        _keep_in_sight(axis, np.concatenate(every))
        axis.set_ylabel(f"{group}, {unit}", fontsize=9)
        _marks(axis, about)
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), fontsize=8, ncols=4, frameon=False)
    axes[-1].set_xlabel("time, s")
    return figure


def _attitude_error(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Turn from the simulated to the wanted attitude about the body axes, deg, where all three angles are wanted.

    Differences of Euler angles would mean nothing with the nose near the vertical.
    """
    wanted = [columns.get(f"{name}_ref") for name, _ in ATTITUDE]
    if any(angle is None for angle in wanted):
        return {}
    simulated = from_euler(*(columns[name] for name, _ in ATTITUDE))
    turn = np.degrees(logarithm(multiply(conjugate(simulated), from_euler(*wanted))))
    return {name: turn[:, k].copy() for k, (name, _) in enumerate(ATTITUDE)}


def _error(name: str, error: np.ndarray) -> np.ndarray:
    if name in ("roll", "pitch", "yaw"):
        return np.degrees((error + np.pi) % (2 * np.pi) - np.pi)
    return np.degrees(error) if name in ("p", "q", "r") else error


def _overview(
    table: pd.DataFrame, columns: Mapping[str, np.ndarray], airframe: Airframe, about: Mapping[str, Any]
) -> Figure:
    """The path, and beside it position, attitude and rotor speeds over time."""
    figure = Figure(figsize=(12, 5.2))
    _trajectory(table, airframe, about, new_axes(figure, (1, 2, 1)))
    figure.axes[0].set_position((0.01, -0.02, 0.54, 1.02))
    groups = (
        ([name for name, _ in POSITION], "position, m"),
        ([name for name, _ in ATTITUDE], "attitude, deg"),
        (_rotors(), "rotor speed, rad/s"),
    )
    for k, (names, label) in enumerate(groups):
        axis = figure.add_axes((0.6, 0.7 - 0.295 * k, 0.33, 0.255))
        every = []
        for colour, name in zip(("C0", "C1", "C2", "C4"), names):
            every.append(_shown(name, columns[name].copy()))
            axis.plot(columns["t"], every[-1], color=colour, linewidth=1.2, label=name)
            wanted = columns.get(f"{name}_ref")
            if wanted is not None and np.isfinite(wanted).any():
                axis.plot(columns["t"], _shown(name, wanted.copy()), color=REFERENCE, linewidth=0.8, linestyle="--")
        _keep_in_sight(axis, np.concatenate(every))
        axis.set_ylabel(label, fontsize=9)
        _marks(axis, about)
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
        if k < 2:
            axis.set_xticklabels([])
    axis.set_xlabel("time, s", fontsize=9)
    return figure


def _trajectory(
    table: pd.DataFrame, airframe: Airframe, about: Mapping[str, Any], axes: Axes3D | None = None
) -> Figure:
    motion = motion_of(in_sight(table), airframe)
    figure = trajectories(
        [motion], about.get("stills", 6), axes, title=_title("path" if axes is None else "flight", about)
    )
    wanted = [f"{axis}_ref" for axis in "xyz"]
    if set(wanted) <= set(table.columns):
        aim = table[wanted].to_numpy(float)[_stride(len(table))].copy()
        low, high = get_limits(figure.axes[0])
        aim[~((aim >= low) & (aim <= high)).all(axis=1)] = np.nan  # a step to where the drone has not come yet
        if np.isfinite(aim).all(axis=1).any():
            path_line(figure.axes[0], aim, REFERENCE, 0.8, linestyle="--", label="reference")
            figure.axes[0].legend(fontsize=8, loc="upper right")
    return figure


def in_sight(table: pd.DataFrame) -> pd.DataFrame:
    """Without the last rows of a simulation that flew off to where nothing else could be seen."""
    where = table[["x", "y", "z"]].to_numpy(float)
    away = np.linalg.norm(where - np.nanmedian(where, axis=0), axis=1)
    far = ~(away <= 20.0 * max(float(np.nanpercentile(away, 95.0)), 0.05))
    return table.iloc[: int(np.argmax(far))] if far.any() and not far[0] else table
