"""Result of a simulation: its table with units, and a summary as plain data."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from quasi import attitude
from quasi.errors import ConfigError
from quasi.simulation.control.outer_loop import (
    ATTITUDE_SETPOINT,
    POSITION_SETPOINT,
    RATES_SETPOINT,
    SETPOINT_ANGLES,
    SETPOINT_KIND,
    SETPOINT_POSITION,
    SETPOINT_RATES,
    SETPOINT_THRUST,
    SETPOINT_VELOCITY,
    SETPOINT_YAW_RATE,
    VELOCITY_SETPOINT,
)
from quasi.simulation.loop.closed_loop import (
    FULL_LOG_SIZE,
    LOG_COMMANDS,
    LOG_LOADS,
    LOG_MEASUREMENT,
    LOG_ROTOR_ACCELERATIONS,
    LOG_ROTOR_SPEEDS,
    LOG_SETPOINT,
    LOG_STATE,
    LOG_VOLTAGE,
    LOG_WIND,
)
from quasi.simulation.loop.divergence import explain_end
from quasi.simulation.loop.setup import STATE_NAMES, Setup
from quasi.simulation.vehicle.layout import LOAD_LENGTH, LOAD_MASS
from quasi.tables import COLUMNS

SIMULATION_SCHEMA = "quasi.simulation/1"
_LIMIT_TOLERANCE = 1e-6  # relative distance from a limit within which a command counts as saturated
COLUMN_UNITS: dict[str, tuple[str, str, str]] = {
    **{
        f"{n}_ref": (COLUMNS[n][0], COLUMNS[n][1], f"reference of {n}")
        for n in ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw", "p", "q", "r")
    },
    "yaw_rate_ref": ("rad/s", "earth NED", "reference of the rate about the vertical"),
    "thrust_ref": ("N", "body FRD", "reference of the thrust, upwards in the body"),
    **{
        f"{n}_measured": (COLUMNS[n][0], COLUMNS[n][1], f"{n} measured by the controller")
        for n in ("x", "y", "z", "u", "v", "w", "roll", "pitch", "yaw", "p", "q", "r", "ax", "ay", "az", "w1", "w2",
                  "w3", "w4")
    },
    **{f"q{c}": ("1", "body to earth, Hamilton", f"attitude quaternion, {c}") for c in "wxyz"},
    **{f"load_{a}": ("m", "earth NED", f"{a} of the slung payload") for a in "xyz"},
    "distance": ("1", "", "distance outside the region of the model's data, in units of the covered range"),
}  # fmt: skip


@dataclass(frozen=True)
class Result:
    """Result of a simulation.

    table    one row per logged step: t; position, attitude, velocity, rates; rotor speeds, commands; forces, moments;
             references, where they exist; measurements; wind
    status   STATUS_FINE, or the reason of the end; stopped: a sentence with the reason, else None
    steps    number of steps; setup: the simulated closed loop
    """

    setup: Setup
    table: pd.DataFrame
    status: int
    steps: int
    stopped: str | None

    @property
    def units(self) -> dict[str, tuple[str, str, str]]:
        """{column: (unit, frame, meaning)} of the columns that `tables.COLUMNS` does not know."""
        return {name: COLUMN_UNITS[name] for name in self.table if name in COLUMN_UNITS}

    def summary(self) -> dict[str, Any]:
        """Summarise tracking errors, saturation and time outside the region of the model's data as plain data."""
        setup, table = self.setup, self.table
        loop_parameters = setup.loop_parameters
        notes = list(setup.notes)
        flown = float(table["t"].iloc[-1]) if len(table) else 0.0
        summary = {
            "schema": SIMULATION_SCHEMA,
            "simulation": setup.name,
            "model": setup.model.id,
            "ended": self.stopped,
            "duration": {
                "asked": setup.steps * loop_parameters.dt,
                "simulated": self.steps * loop_parameters.dt,
                "unit": "s",
            },
            "steps": self.steps,
            "tracking": compute_tracking_errors(table),
            "saturation": self._saturation(),
            "outside the model's region": self._outside(notes),
            "rotor limits": {
                "lowest": loop_parameters.drive.low,
                "highest": loop_parameters.drive.high,
                "unit": "rad/s",
            },
            "fault time": float(loop_parameters.fault[0]) if np.isfinite(loop_parameters.fault[0]) else None,
            "settings": setup.settings,
            "notes": notes,
        }
        if loop_parameters.battery.start > 0.0 and len(table):
            summary["battery"] = {"lowest voltage": float(table["battery_voltage"].min()), "unit": "V", "at": flown}
        return summary

    def _saturation(self) -> dict[str, Any]:
        drive, fault = self.setup.loop_parameters.drive, self.setup.loop_parameters.fault
        failed = self.table["t"].to_numpy() >= fault[0] - 1e-9
        shares = {}
        for i in range(1, 5):
            command = self.table[f"w{i}_CMD"].to_numpy()
            # a failed rotor reaches at most its cap
            top = np.where(failed, np.minimum(drive.high, fault[4 + i]), drive.high)
            high = float(np.mean(command >= top * (1.0 - _LIMIT_TOLERANCE))) if len(command) else 0.0
            low = float(np.mean(command <= drive.low * (1.0 + _LIMIT_TOLERANCE))) if len(command) else 0.0
            shares[f"rotor {i}"] = {"share of time at highest": high, "share of time at lowest": low}
        return shares

    def _outside(self, notes: list[str]) -> dict[str, Any] | None:
        """Share of time with a variable outside the range of the training flights."""
        table, model = self.table, self.setup.model
        finite = np.isfinite(table[list(STATE_NAMES)].to_numpy()).all(axis=1)
        used = table[finite]
        try:
            found = model.distance_columns(use_air_velocity(used))
        except ConfigError as error:
            notes.append(str(error))
            return None
        distance = found["distance"].to_numpy()
        outside = distance > 0.0
        worst = found["worst"][outside].value_counts()
        return {
            "share of time": float(outside.mean()) if len(outside) else 0.0,
            "greatest distance": float(distance.max()) if len(distance) else 0.0,
            "where": {str(name): float(count / len(used)) for name, count in worst.items()},
        }


def compute_tracking_errors(table: pd.DataFrame) -> dict[str, Any]:
    """Compute root mean square and greatest error of the references; position and velocity as vectors."""
    result: dict[str, Any] = {}
    q = table[["qw", "qx", "qy", "qz"]].to_numpy() if len(table) else np.zeros((0, 4))
    for what, names, unit in (
        ("position", ("x", "y", "z"), "m"),
        ("velocity", ("vx", "vy", "vz"), "m/s"),
        ("attitude", ("roll", "pitch", "yaw"), "rad"),
        ("rates", ("p", "q", "r"), "rad/s"),
    ):
        wanted = [f"{n}_ref" for n in names]
        if not set(wanted) <= set(table):
            continue
        reference = table[wanted].to_numpy()
        rows = np.isfinite(reference).all(axis=1) & np.isfinite(q).all(axis=1)
        if what == "velocity":
            rows &= ~np.isfinite(table["x_ref"].to_numpy()) if "x_ref" in table else True
            actual = attitude.rotate(q, table[["u", "v", "w"]].to_numpy())
        else:
            actual = table[list(names)].to_numpy()
        if not rows.any():
            continue
        if what == "attitude":
            cosine = np.abs(np.sum(attitude.from_euler(*reference[rows].T) * q[rows], axis=1))
            size = 2.0 * np.arccos(np.minimum(cosine, 1.0))
        else:
            size = np.linalg.norm(actual[rows] - reference[rows], axis=1)
        result[what] = {"rms": float(np.sqrt(np.mean(size**2))), "greatest": float(size.max()), "unit": unit}
    return result


def use_air_velocity(table: pd.DataFrame) -> pd.DataFrame:
    """Replace u v w by the velocity through the air where it is known, as the model's variables require."""
    if "u_air" not in table:
        return table
    return table.assign(**{n: table[f"{n}_air"] for n in "uvw"})


def make_result(
    setup: Setup,
    log: np.ndarray,
    status: int,
    steps: int,
    last: np.ndarray | None = None,
    after: np.ndarray | None = None,
) -> Result:
    """Make a result from the rows of a full log (see `loop.log_row`); last, after  see `divergence.explain_end`."""
    columns: dict[str, np.ndarray] = {"t": log[:, 0]}
    x, measurement, setpoint = (
        log[:, LOG_STATE : LOG_STATE + 17],
        log[:, LOG_MEASUREMENT : LOG_MEASUREMENT + 20],
        log[:, LOG_SETPOINT : LOG_SETPOINT + 20],
    )
    columns |= {name: x[:, 10 + k] for k, name in enumerate("xyz")}
    columns |= dict(zip(("roll", "pitch", "yaw"), attitude.to_euler(x[:, :4]).T))
    columns |= {name: x[:, k] for k, name in enumerate(STATE_NAMES[:10])}
    columns |= {f"w{i + 1}": log[:, LOG_ROTOR_SPEEDS + i] for i in range(4)}
    columns |= {f"w{i + 1}_CMD": log[:, LOG_COMMANDS + i] for i in range(4)}
    columns |= {f"w{i + 1}_dot": log[:, LOG_ROTOR_ACCELERATIONS + i] for i in range(4)}
    columns |= {name: log[:, LOG_LOADS + k] for k, name in enumerate(("Fx", "Fy", "Fz", "Mx", "My", "Mz"))}
    air = log[:, LOG_WIND : LOG_WIND + 3]
    if np.any(air != 0.0):
        columns |= dict(zip(("wind_north", "wind_east", "wind_down"), air.T))
        columns |= dict(zip(("u_air", "v_air", "w_air"), (x[:, 4:7] - attitude.rotate_inverse(x[:, :4], air)).T))
    if setup.loop_parameters.battery.start > 0.0:
        columns["battery_voltage"] = log[:, LOG_VOLTAGE]
    body = setup.loop_parameters.body
    if body[LOAD_MASS] > 0.0:
        first = FULL_LOG_SIZE + setup.extra_states - 6  # the load's direction from the cg, earth axes
        below = x[:, 10:13] + body[LOAD_LENGTH] * log[:, first : first + 3]
        columns |= {f"load_{name}": below[:, k] for k, name in enumerate("xyz")}
    columns |= _make_reference_columns(setpoint)
    columns |= {f"{n}_measured": measurement[:, 10 + k] for k, n in enumerate("xyz")}
    columns |= dict(zip(("roll_measured", "pitch_measured", "yaw_measured"), attitude.to_euler(measurement[:, :4]).T))
    names = (*STATE_NAMES[4:10], *STATE_NAMES[13:], "ax", "ay", "az")
    places = (*range(4, 10), *range(13, 20))
    columns |= {f"{name}_measured": measurement[:, place] for name, place in zip(names, places)}
    table = pd.DataFrame(columns)
    return Result(setup, table, status, steps, explain_end(setup, status, steps, table, last, after))


def _make_reference_columns(setpoint: np.ndarray) -> dict[str, np.ndarray]:
    """Make columns of the references in use; NaN in rows without them."""
    kind = setpoint[:, SETPOINT_KIND]
    position, velocity = kind == POSITION_SETPOINT, kind == VELOCITY_SETPOINT
    angles, rates = kind == ATTITUDE_SETPOINT, kind == RATES_SETPOINT
    parts = [
        (("x_ref", "y_ref", "z_ref"), SETPOINT_POSITION, position),
        (("vx_ref", "vy_ref", "vz_ref"), SETPOINT_VELOCITY, position | velocity),
        (("roll_ref", "pitch_ref"), SETPOINT_ANGLES, angles),
        (("yaw_ref",), SETPOINT_ANGLES + 2, position | velocity | angles),
        (("yaw_rate_ref",), SETPOINT_YAW_RATE, position | velocity | angles),
        (("p_ref", "q_ref", "r_ref"), SETPOINT_RATES, rates),
        (("thrust_ref",), SETPOINT_THRUST, angles | rates),
    ]
    if angles.any():  # pitch within 90 degrees, as the simulated attitude has it
        setpoint = setpoint.copy()
        setpoint[angles, SETPOINT_ANGLES : SETPOINT_ANGLES + 3] = attitude.to_euler(
            attitude.from_euler(*setpoint[angles, SETPOINT_ANGLES : SETPOINT_ANGLES + 3].T)
        )
    columns = {}
    for names, first, rows in parts:
        if rows.any():
            columns |= {n: np.where(rows, setpoint[:, first + k], np.nan) for k, n in enumerate(names)}
    if "yaw_ref" in columns:
        columns["yaw_ref"] = np.arctan2(np.sin(columns["yaw_ref"]), np.cos(columns["yaw_ref"]))
    return columns


def _describe_settings(settings: Mapping[str, Any]) -> str:
    """Describe the main settings in one line, as the manual's simulator does (7.4.1)."""
    noise = f"noise with seed {settings['noise']['seed']}" if settings["noise"]["add"] else "no noise"
    corrected = "corrected" if settings["model"]["correct for moment asymmetries"] else "not corrected"
    time = settings["simulation"]
    return (
        f"controller {settings['controller']['controller']}, actuator {settings['actuator']['actuator']}, {noise}, "
        f"moment asymmetries {corrected}, {time['integrator']} with steps of {time['time step']:g} s"
    )


def format_report(summary: Mapping[str, Any]) -> str:
    """Format a summary as a few lines of text."""
    duration = summary["duration"]
    lines = [
        f"Simulation {summary['simulation']}: model {summary['model']}, {duration['simulated']:g} s of "
        f"{duration['asked']:g} s simulated"
    ]
    lines.append(f"  {_describe_settings(summary['settings'])}")
    if summary["ended"]:
        lines.append(f"  ended early: {summary['ended']}")
    for what, error in summary["tracking"].items():
        lines.append(f"  {what} error {error['rms']:.3g} {error['unit']} rms, {error['greatest']:.3g} at most")
    shares = {rotor: max(part.values()) for rotor, part in summary["saturation"].items()}
    worst = max(shares, key=lambda rotor: shares[rotor])
    if shares[worst]:
        lines.append(f"  {worst}'s command at or beyond its limit {100 * shares[worst]:.1f} % of the time")
    outside = summary["outside the model's region"]
    if outside:
        worst = next(iter(outside["where"]), None)
        where = f", mostly by {worst}" if worst else ""
        lines.append(f"  outside the region of the model's data {100 * outside['share of time']:.1f} % of time{where}")
    lines += [f"  note: {note}" for note in summary["notes"]]
    return "\n".join(lines)
