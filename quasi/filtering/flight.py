"""Filter one imported flight: states, biases, forces and moments."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi import attitude
from quasi.airframe import Airframe
from quasi.errors import DataError, add_caution, cautions
from quasi.filtering import band as bands
from quasi.filtering import bias as biases
from quasi.filtering import ekf, estimation, forces, harmonics, measurements
from quasi.filtering.contact import find_contacts
from quasi.filtering.filter_inputs import Material
from quasi.filtering.rotor_speeds import commands_to_keep
from quasi.filtering.verdict import judge_flight
from quasi.project import configuration
from quasi.sensor_limits import check_measured_motion, describe_impossible_inertia
from quasi.tables import COLUMNS
from quasi.terms.rotor_map import RAW

COURSE_RATE = 50.0  # Hz, of the filter's course where it is not asked for whole
NONE_VALID = "no row of this flight is valid for identification"
REPORTED_SHARE = 0.05  # share of a flight from which a reason for its invalid rows is named


class _Logged(NamedTuple):
    """Columns of the import that hold rotor speeds, and commands."""

    rotors: list[str]
    commands: list[str]


@dataclass(frozen=True)
class Filtered:
    """A filtered flight.

    with_gravity, no_gravity   the same states with forces as mass x specific force, and as net force
    metadata                   plain data, schema "quasi.filtered/1"
    convergence                the filter over time (units: estimation.CONVERGENCE_UNITS), None when no filter was run
    """

    with_gravity: pd.DataFrame
    no_gravity: pd.DataFrame
    metadata: dict[str, Any]
    convergence: pd.DataFrame | None


def course(result: Filtered, whole: bool) -> pd.DataFrame:
    """The filter over time as it is kept: every row if `whole`, else as many as COURSE_RATE asks for.

    Without a filter a table of no rows. Innovations of rows between are lost; their statistics are in the metadata.
    """
    if result.convergence is None:
        return pd.DataFrame({"t": np.zeros(0)})
    every = 1 if whole else max(1, round(result.metadata["sampling"]["rate"] / COURSE_RATE))
    return result.convergence.iloc[::every].reset_index(drop=True)


def _filled(frame: pd.DataFrame, names: list[str], notes: list[str]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Columns with their gaps bridged, and True (N,) where one was; empty columns are left out with a note."""
    found: dict[str, np.ndarray] = {}
    lost = np.zeros(len(frame), bool)
    for name in names:
        values = frame[name].to_numpy(float)
        bad = ~np.isfinite(values)
        if bad.all():
            notes.append(f"column '{name}' holds no value at all and is left out")
            continue
        if bad.any():
            notes.append(
                f"column '{name}' is missing in {int(bad.sum())} samples, first at t = "
                f"{frame['t'].iloc[int(np.argmax(bad))]:.3f} s; they are bridged by straight lines and marked invalid"
            )
            lost |= bad
        elif np.ptp(values) == 0.0 and name[0] == "w" and name[1:2].isdigit():
            notes.append(
                f"column '{name}' is constant ({values[0]:g}) all through the flight; check the sensor and its mapping"
            )
        found[name] = measurements.fill(values)
    return found, lost


def filter_flight(
    imported: pd.DataFrame,
    imported_metadata: Mapping[str, Any],
    airframe: Airframe,
    options: Mapping[str, Any],
    watch: ekf.Watch | None = None,
) -> Filtered:
    """Estimate states and biases of one flight and derive its forces and moments.

    imported   standard columns on a uniform grid, with attitude_sample, position_sample, velocity_sample and
               onboard_valid as 0 or 1; imported_metadata  its metadata (sources, rate, "logged to rad/s")
    airframe   mass and inertia must be known; options  the section "data filtering" of the processing configuration
    watch      reports the progress of a slow engine (`joblog.progress`); the compiled one is done at once
    Returns    Filtered; every row of the import is kept, column `valid` is 1 where a row may be used for identification
    Raises     DataError where the flight cannot be filtered, ConfigError for an impossible option
    """
    chosen, _ = configuration.check(dict(options), "processing", "data filtering", "properties", "data filtering")
    bands.check(chosen)
    if airframe.mass is None:
        raise DataError(
            f"{airframe.name}: no mass is known; give 'Mass' in the logbook or 'mass' in the quadrotor configuration"
        )
    notes: list[str] = []
    if fault := describe_impossible_inertia(np.asarray(airframe.inertia, float)):
        add_caution(notes, f"{airframe.name}: {fault}")
    t = imported["t"].to_numpy(float)
    dt = measurements.time_step(t)
    rate = 1.0 / dt
    imu = measurements.read_imu(imported, measurements.resolution(imported_metadata))
    notes += imu.notes
    logged = _Logged(
        [c for c in imported if c[0] == "w" and c[1:].isdigit()],
        [c for c in imported if c.startswith("command") or c.endswith("_CMD")],
    )
    actuators, actuators_lost = _filled(imported, [*logged.rotors, *logged.commands], notes)
    rotors = [c for c in logged.rotors if c in actuators]
    speeds = np.stack([actuators[c] for c in rotors], axis=1) if rotors else None
    factor = airframe.logged_to_rad_s or imported_metadata.get("logged to rad/s")
    estimated = commands_to_keep(actuators)
    turning = speeds if speeds is not None else _commanded(actuators, logged)
    if estimated:
        notes.append("rotor speeds are not measured: a model that uses this flight estimates them from its commands")
    if turning is not None and speeds is None:
        notes.append("no rotor speeds: take-off, ground and rest are found from the commands")
    found = _phases(
        imported, imported_metadata, airframe, imu, turning, factor if turning is speeds else None, dt, notes
    )
    stuck, stuck_notes = measurements.frozen(imu, found.on_ground, t, dt)
    imu.lost |= stuck
    notes += stuck_notes

    made = imported_metadata.get("reconstructed") or {}
    if chosen["run extended kalman filter"] and "gyro" in made:
        notes.append(
            f"body rates were made from {made['gyro']['from']}, so that no filter can compare them; states are those "
            "of the import"
        )
    use_filter = chosen["run extended kalman filter"] and "gyro" not in made
    find = partial(estimation.estimate, watch=watch) if use_filter else estimation.copy
    log_rate = ((imported_metadata.get("streams") or {}).get("gyro") or {}).get("rate")
    folded = np.zeros(len(t)) if speeds is None else harmonics.near_zero(speeds, float(log_rate or rate), rate)
    run = find(Material(imported, imported_metadata, airframe, chosen, imu, found, folded, dt, notes))

    in_flight = ~found.on_ground
    band = bands.choose(chosen, speeds, np.hstack([imu.gyro, imu.accel]), in_flight, log_rate, rate, notes)
    reach = band.reach
    rates, rates_dot = band.both(imu.gyro - run.bias[:, :3])
    specific = band.low_pass(imu.accel - run.bias[:, 3:])
    body = attitude.rotate_inverse(run.quaternion, run.velocity)

    edge = np.zeros(len(t), bool)
    edge[:reach] = edge[-reach:] = True
    lost = forces.spread(imu.lost | actuators_lost, reach) | edge
    touched = np.zeros(len(t), bool)
    if check_measured_motion({**run.report, "imported": imported_metadata})[1]:
        contacts = find_contacts(-run.position[:, 2], imu.accel, in_flight, dt)
        touched = forces.spread(contacts, reach)
        if contacts.any():
            notes.append(
                f"the vehicle is as low as it stands for {contacts.sum() * dt:.2g} s with turning rotors, and the "
                "floor's force is not its own; these rows are marked invalid"
            )
    spoiling = {
        _unsure_words(imported_metadata): run.unsure,
        "it is not in flight": ~in_flight,
        "it touches the floor": touched,
        "sensors or rotor speeds are lost": lost,
    }
    if turning is not None:  # a jolt of the IMU while no rotor turns is no flight
        spoiling["no rotor turns"] = ~(turning > 0.0).any(axis=1)
    air, windless = _through_air(imported, body, run.quaternion)
    if windless.any():
        notes.append(
            f"the wind is unknown in {100 * windless.mean():.3g} % of the flight; these rows are marked invalid"
        )
        spoiling["the wind is unknown"] = windless
    valid = ~np.logical_or.reduce(list(spoiling.values()))

    table: dict[str, np.ndarray] = {"t": t, **_actuators(actuators, speeds, logged, band)}
    table |= {f"{name}{RAW}": values for name, values in estimated.items()}
    if estimated:  # before the low-pass: what the rotor speeds are identified on
        clean = np.hstack([imu.gyro - run.bias[:, :3], imu.accel - run.bias[:, 3:]])
        table |= {f"{name}{RAW}": clean[:, i] for i, name in enumerate(("p", "q", "r", "ax", "ay", "az"))}
    table |= _states(specific, rates, rates_dot, run, body, air)
    table |= dict(zip(("Fx", "Fy", "Fz"), forces.forces(specific, airframe.mass).T))
    table |= dict(zip(("Mx", "My", "Mz"), forces.moments(rates, rates_dot, np.asarray(airframe.inertia)).T))
    if chosen["add induced velocity"]:
        table["v_in"] = _induced(body if air is None else air, airframe, notes)
    extra = [c for c in imported if c in COLUMNS and c not in table and c not in ("vx", "vy", "vz") and "_air" not in c]
    known = ("onboard_valid", "imu_clipped", *logged.rotors, *logged.commands)
    extra = [c for c in extra if not c.endswith("_sample") and c not in known]
    table |= _filled(imported, extra, notes)[0]
    table["in_flight"], table["valid"] = in_flight.astype(float), valid.astype(float)
    _refuse_broken(table)
    if not valid.any():
        notes.insert(0, f"{NONE_VALID}: {_spoilt(spoiling)}")  # what makes the others matter less
    with_gravity = pd.DataFrame(table)
    net = forces.net_forces(specific, run.quaternion, airframe.mass)
    no_gravity = with_gravity.assign(**dict(zip(("Fx", "Fy", "Fz"), net.T)))
    metadata = {
        "schema": "quasi.filtered/1",
        "flight": imported_metadata.get("flight"),
        "quadrotor": imported_metadata.get("quadrotor"),
        "mass": airframe.mass,
        "logged to rad/s": factor,
        "inertia": np.asarray(airframe.inertia).tolist(),
        "sampling": {"rate": rate, "samples": len(t)},
        "gravity": {
            "withGravity": "force = mass x specific force",
            "noGravity": "net force",
            "ax ay az": "specific force in both tables; the net acceleration is force / mass of the noGravity table",
            "value": attitude.GRAVITY,
        },
        **run.report,
        "filters": {**band.metadata, "half length samples": reach},
        "phases": {
            "take-off": None if found.take_off is None or found.take_off >= len(t) else float(t[found.take_off]),
            "rest": None if found.rest is None else [float(t[found.rest.first]), float(t[found.rest.last - 1])],
            "in flight share": float(in_flight.mean()),
            "valid share": float(valid.mean()),
            "none valid because": None if valid.any() else _spoilt(spoiling),
        },
        "imported": dict(imported_metadata),
        "options": chosen,
        "notes": notes,
        "doubts": cautions(notes),
    }
    metadata |= judge_flight(imported, imported_metadata, metadata, found.rest)
    return Filtered(with_gravity, no_gravity, metadata, run.convergence)


def _unsure_words(metadata: Mapping[str, Any]) -> str:
    words = "attitude or velocity is not known well enough"
    if metadata.get("position source") == "none" and metadata.get("velocity source") == "none":
        return f"{words}, for neither position nor velocity was measured"
    return words


def _spoilt(spoiling: Mapping[str, np.ndarray]) -> str:
    """What makes the rows of a flight invalid, and how many, the greatest first. spoiling  {words: (N,) bool}"""
    shares = sorted(((float(rows.mean()), words) for words, rows in spoiling.items()), reverse=True)
    reported = [(share, words) for share, words in shares if share >= REPORTED_SHARE] or shares[:1]
    return "; ".join(f"{words} ({100 * share:.0f} % of the flight)" for share, words in reported)


def _commanded(actuators: Mapping[str, np.ndarray], logged: _Logged) -> np.ndarray | None:
    """Commands of four rotors (N, 4), shares; None where one is not logged or none ever rises above 0."""
    names = [f"command{i}" for i in range(1, 5)]
    if not all(name in logged.commands and name in actuators for name in names):
        return None
    commands = np.maximum(np.stack([actuators[name] for name in names], axis=1), 0.0)
    return commands if commands.max() > 0.0 else None


def _phases(
    imported: pd.DataFrame,
    metadata: Mapping[str, Any],
    airframe: Airframe,
    imu: measurements.Imu,
    speeds: np.ndarray | None,
    factor: float | None,
    dt: float,
    notes: list[str],
) -> biases.Phases:
    """Rest, take-off and flight.

    speeds  (N, rotors) rad/s, or commands, or None; factor  from logged units to rad/s, None for commands
    """
    position = imported[["x", "y", "z"]].to_numpy(float) if {"x", "y", "z"} <= set(imported) else None
    idle = airframe.idle_rpm * factor if airframe.idle_rpm and factor else None
    if airframe.idle_rpm and idle is None and any(c[0] == "w" and c[1:].isdigit() for c in imported):
        notes.append(
            "'idle RPM' is in eRPM/100 and the quadrotor's 'motor poles' are unknown: rest is found without it"
        )
    found = biases.phases(imu.gyro, imu.accel, imu.lost, measurements.resolution(metadata), speeds, position, idle, dt)
    notes += found.notes
    return found


def _actuators(
    actuators: Mapping[str, np.ndarray], speeds: np.ndarray | None, logged: _Logged, band: bands.Band
) -> dict[str, np.ndarray]:
    """Rotor speeds with their slopes, and commands, through the same low-pass as forces and moments."""
    table: dict[str, np.ndarray] = {}
    if speeds is not None:
        smooth, slope = band.both(speeds)
        for i, name in enumerate(c for c in logged.rotors if c in actuators):
            table[name], table[f"{name}_dot"] = smooth[:, i], slope[:, i]
    commands = [c for c in logged.commands if c in actuators]
    if commands:
        table |= dict(zip(commands, band.low_pass(np.stack([actuators[c] for c in commands], axis=1)).T))
    return table


def _states(
    specific: np.ndarray,
    rates: np.ndarray,
    rates_dot: np.ndarray,
    run: estimation.Run,
    body: np.ndarray,
    air: np.ndarray | None,
) -> dict[str, np.ndarray]:
    """Columns of the states; body, air  velocity (N, 3) over ground and, where a wind is known, through the air."""
    table = {f"a{name}": specific[:, i] for i, name in enumerate("xyz")}
    for i, name in enumerate("pqr"):
        table[name], table[f"{name}_dot"] = rates[:, i], rates_dot[:, i]
    table |= dict(zip(("roll", "pitch", "yaw"), attitude.to_euler(run.quaternion).T))
    table |= dict(zip("xyz", run.position.T))
    table |= dict(zip("uvw", body.T))
    if air is not None:
        table |= dict(zip(("u_air", "v_air", "w_air"), air.T))
    return table


def _induced(through_air: np.ndarray, airframe: Airframe, notes: list[str]) -> np.ndarray:
    """Induced velocity (N,), NaN where momentum theory gives none."""
    induced = forces.induced_velocity(through_air, airframe.mass, airframe.radius)
    sinking = ~np.isfinite(induced)
    if sinking.any():
        notes.append(
            f"the induced velocity is not defined in {100 * sinking.mean():.3g} % of the flight (descent); "
            "v_in is empty there"
        )
    return induced


def _refuse_broken(table: Mapping[str, np.ndarray]) -> None:
    """Raise DataError where a column holds what is no number."""
    for name, values in table.items():
        broken = ~np.isfinite(values)
        if broken.any() and name != "v_in":
            raise DataError(
                f"the filter broke down: '{name}' is no number in {int(broken.sum())} samples, first at t = "
                f"{table['t'][int(np.argmax(broken))]:.3f} s; look for impossible values in the imported flight there"
            )


def _through_air(
    imported: pd.DataFrame, body: np.ndarray, quaternion: np.ndarray
) -> tuple[np.ndarray | None, np.ndarray]:
    """Velocity through the air (N, 3), body axes, None without any wind; and True (N,) where a wind is not known."""
    names = ["wind_north", "wind_east", "wind_down"]
    wind = imported[names].to_numpy(float) if set(names) <= set(imported) else np.full((len(imported), 3), np.nan)
    unknown = ~np.isfinite(wind).all(axis=1)
    if unknown.all():
        return None, np.zeros(len(imported), bool)
    wind = np.stack([measurements.fill(c) for c in wind.T], axis=1)
    return body - attitude.rotate_inverse(quaternion, wind), unknown
