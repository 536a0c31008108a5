"""Filter one imported flight: states, biases, forces and moments."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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


class _Actuators(NamedTuple):
    """What the import holds of rotors.

    rotors, commands  names of columns; values {name: (N,)} without gaps; lost (N,) bool, True where one was bridged
    speeds     (N, rotors) as logged, None where they are not measured; factor  from logged units to rad/s, or None
    turning    speeds, or commands of four rotors, None without either
    estimated  {command: (N,)} of flights whose speeds are estimated from them
    """

    rotors: list[str]
    commands: list[str]
    values: dict[str, np.ndarray]
    lost: np.ndarray
    speeds: np.ndarray | None
    factor: float | None
    turning: np.ndarray | None
    estimated: Mapping[str, np.ndarray]


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
    rotors = _read_actuators(imported, imported_metadata, airframe, notes)
    found = _phases(imported, imported_metadata, airframe, imu, rotors, dt, notes)
    stuck, stuck_notes = measurements.frozen(imu, found.on_ground, t, dt)
    imu.lost |= stuck
    notes += stuck_notes

    log_rate = ((imported_metadata.get("streams") or {}).get("gyro") or {}).get("rate")
    folded = np.zeros(len(t))
    if rotors.speeds is not None:
        folded = harmonics.near_zero(rotors.speeds, float(log_rate or rate), rate)
    material = Material(imported, imported_metadata, airframe, chosen, imu, found, folded, dt, notes)
    run = _find_states(material, watch)
    in_flight = ~found.on_ground
    band = bands.choose(chosen, rotors.speeds, np.hstack([imu.gyro, imu.accel]), in_flight, log_rate, rate, notes)
    specific = band.low_pass(imu.accel - run.bias[:, 3:])
    body = attitude.rotate_inverse(run.quaternion, run.velocity)
    air, windless = _through_air(imported, body, run.quaternion)
    spoiling = _spoiling(material, run, rotors, band.reach, windless)
    valid = ~np.logical_or.reduce(list(spoiling.values()))

    table = {"t": t, **_actuators(rotors, band), **_before_low_pass(rotors, imu, run)}
    table |= _states(specific, *band.both(imu.gyro - run.bias[:, :3]), run, body, air)
    table |= _loads(specific, table, airframe)
    if chosen["add induced velocity"]:
        table["v_in"] = _induced(body if air is None else air, airframe, notes)
    table |= _filled(imported, _passed_on(imported, table, rotors), notes)[0]
    table["in_flight"], table["valid"] = in_flight.astype(float), valid.astype(float)
    _refuse_broken(table)
    if not valid.any():
        notes.insert(0, f"{NONE_VALID}: {_spoilt(spoiling)}")  # what makes the others matter less
    with_gravity = pd.DataFrame(table)
    net = forces.net_forces(specific, run.quaternion, airframe.mass)
    no_gravity = with_gravity.assign(**dict(zip(("Fx", "Fy", "Fz"), net.T)))
    return Filtered(with_gravity, no_gravity, _metadata(material, run, band, rotors, valid, spoiling), run.convergence)


def _read_actuators(
    imported: pd.DataFrame, metadata: Mapping[str, Any], airframe: Airframe, notes: list[str]
) -> _Actuators:
    """Rotor speeds and commands of a flight; what is missing is noted."""
    names = [c for c in imported if c[0] == "w" and c[1:].isdigit()]
    commands = [c for c in imported if c.startswith("command") or c.endswith("_CMD")]
    values, lost = _filled(imported, [*names, *commands], notes)
    rotors = [c for c in names if c in values]
    speeds = np.stack([values[c] for c in rotors], axis=1) if rotors else None
    estimated = commands_to_keep(values)
    turning = speeds if speeds is not None else _commanded(values, commands)
    if estimated:
        notes.append("rotor speeds are not measured: a model that uses this flight estimates them from its commands")
    if turning is not None and speeds is None:
        notes.append("no rotor speeds: take-off, ground and rest are found from the commands")
    factor = airframe.logged_to_rad_s or metadata.get("logged to rad/s")
    return _Actuators(names, commands, values, lost, speeds, factor, turning, estimated)


def _find_states(material: Material, watch: ekf.Watch | None) -> estimation.Run:
    """States and biases: of the filter, or of the import where that is chosen or no gyro was logged."""
    is_asked = material.chosen["run extended kalman filter"]
    made = material.metadata.get("reconstructed") or {}
    if is_asked and "gyro" in made:
        material.notes.append(
            f"body rates were made from {made['gyro']['from']}, so that no filter can compare them; states are those "
            "of the import"
        )
    return estimation.estimate(material, watch=watch) if is_asked and "gyro" not in made else estimation.copy(material)


def _spoiling(
    material: Material, run: estimation.Run, rotors: _Actuators, reach: int, windless: np.ndarray
) -> dict[str, np.ndarray]:
    """{what makes rows invalid: (N,) bool}. reach  of the low-pass, rows; windless (N,)  where the wind is unknown"""
    imu, dt, notes, count = material.imu, material.dt, material.notes, len(material.frame)
    in_flight = ~material.found.on_ground
    edge = np.zeros(count, bool)
    edge[:reach] = edge[-reach:] = True
    touched = np.zeros(count, bool)
    if check_measured_motion({**run.report, "imported": material.metadata})[1]:
        contacts = find_contacts(-run.position[:, 2], imu.accel, in_flight, dt)
        touched = forces.spread(contacts, reach)
        if contacts.any():
            notes.append(
                f"the vehicle is as low as it stands for {contacts.sum() * dt:.2g} s with turning rotors, and the "
                "floor's force is not its own; these rows are marked invalid"
            )
    spoiling = {
        _unsure_words(material.metadata): run.unsure,
        "it is not in flight": ~in_flight,
        "it touches the floor": touched,
        "sensors or rotor speeds are lost": forces.spread(imu.lost | rotors.lost, reach) | edge,
    }
    if rotors.turning is not None:  # a jolt of the IMU while no rotor turns is no flight
        spoiling["no rotor turns"] = ~(rotors.turning > 0.0).any(axis=1)
    if windless.any():
        notes.append(
            f"the wind is unknown in {100 * windless.mean():.3g} % of the flight; these rows are marked invalid"
        )
        spoiling["the wind is unknown"] = windless
    return spoiling


def _before_low_pass(rotors: _Actuators, imu: measurements.Imu, run: estimation.Run) -> dict[str, np.ndarray]:
    """Columns that rotor speeds are identified on, of flights that do not measure them."""
    if not rotors.estimated:
        return {}
    clean = np.hstack([imu.gyro - run.bias[:, :3], imu.accel - run.bias[:, 3:]])
    columns = {f"{name}{RAW}": values for name, values in rotors.estimated.items()}
    return columns | {f"{name}{RAW}": clean[:, i] for i, name in enumerate(("p", "q", "r", "ax", "ay", "az"))}


def _loads(specific: np.ndarray, states: Mapping[str, np.ndarray], airframe: Airframe) -> dict[str, np.ndarray]:
    """Columns of forces and moments. specific (N, 3) m/s2; states  with body rates and their slopes"""
    rates, slopes = (np.stack([states[f"{n}{tail}"] for n in "pqr"], axis=1) for tail in ("", "_dot"))
    moments = forces.moments(rates, slopes, np.asarray(airframe.inertia))
    return dict(zip(("Fx", "Fy", "Fz"), forces.forces(specific, airframe.mass).T)) | dict(
        zip(("Mx", "My", "Mz"), moments.T)
    )


def _passed_on(imported: pd.DataFrame, table: Mapping[str, Any], rotors: _Actuators) -> list[str]:
    """Standard columns of the import that the filtered table takes over as they are."""
    extra = [c for c in imported if c in COLUMNS and c not in table and c not in ("vx", "vy", "vz") and "_air" not in c]
    known = ("onboard_valid", "imu_clipped", *rotors.rotors, *rotors.commands)
    return [c for c in extra if not c.endswith("_sample") and c not in known]


def _metadata(
    material: Material, run: estimation.Run, band: bands.Band, rotors: _Actuators, valid: np.ndarray,
    spoiling: Mapping[str, np.ndarray],
) -> dict[str, Any]:  # fmt: skip
    """Plain data, schema "quasi.filtered/1"."""
    t, found, imported = material.frame["t"].to_numpy(float), material.found, material.metadata
    metadata = {
        "schema": "quasi.filtered/1",
        "flight": imported.get("flight"),
        "quadrotor": imported.get("quadrotor"),
        "mass": material.airframe.mass,
        "logged to rad/s": rotors.factor,
        "inertia": np.asarray(material.airframe.inertia).tolist(),
        "sampling": {"rate": 1.0 / material.dt, "samples": len(t)},
        "gravity": {
            "withGravity": "force = mass x specific force",
            "noGravity": "net force",
            "ax ay az": "specific force in both tables; the net acceleration is force / mass of the noGravity table",
            "value": attitude.GRAVITY,
        },
        **run.report,
        "filters": {**band.metadata, "half length samples": band.reach},
        "phases": {
            "take-off": None if found.take_off is None or found.take_off >= len(t) else float(t[found.take_off]),
            "rest": None if found.rest is None else [float(t[found.rest.first]), float(t[found.rest.last - 1])],
            "in flight share": float((~found.on_ground).mean()),
            "valid share": float(valid.mean()),
            "none valid because": None if valid.any() else _spoilt(spoiling),
        },
        "imported": dict(imported),
        "options": material.chosen,
        "notes": material.notes,
        "doubts": cautions(material.notes),
    }
    return metadata | judge_flight(material.frame, imported, metadata, found.rest)


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


def _commanded(values: Mapping[str, np.ndarray], logged: Sequence[str]) -> np.ndarray | None:
    """Commands of four rotors (N, 4), shares; None where one is not logged or none ever rises above 0."""
    names = [f"command{i}" for i in range(1, 5)]
    if not all(name in logged and name in values for name in names):
        return None
    commands = np.maximum(np.stack([values[name] for name in names], axis=1), 0.0)
    return commands if commands.max() > 0.0 else None


def _phases(
    imported: pd.DataFrame, metadata: Mapping[str, Any], airframe: Airframe, imu: measurements.Imu, rotors: _Actuators,
    dt: float, notes: list[str],
) -> biases.Phases:  # fmt: skip
    """Rest, take-off and flight."""
    position = imported[["x", "y", "z"]].to_numpy(float) if {"x", "y", "z"} <= set(imported) else None
    is_measured = rotors.turning is rotors.speeds  # commands have no rotor speed at idle
    idle = airframe.idle_rpm * rotors.factor if airframe.idle_rpm and rotors.factor and is_measured else None
    if airframe.idle_rpm and idle is None and rotors.rotors:
        notes.append(
            "'idle RPM' is in eRPM/100 and the quadrotor's 'motor poles' are unknown: rest is found without it"
        )
    resolution, speeds = measurements.resolution(metadata), rotors.turning
    found = biases.phases(imu.gyro, imu.accel, imu.lost, resolution, speeds, position, idle, dt)
    notes += found.notes
    return found


def _actuators(rotors: _Actuators, band: bands.Band) -> dict[str, np.ndarray]:
    """Rotor speeds with their slopes, and commands, through the same low-pass as forces and moments."""
    table: dict[str, np.ndarray] = {}
    if rotors.speeds is not None:
        smooth, slope = band.both(rotors.speeds)
        for i, name in enumerate(c for c in rotors.rotors if c in rotors.values):
            table[name], table[f"{name}_dot"] = smooth[:, i], slope[:, i]
    commands = [c for c in rotors.commands if c in rotors.values]
    if commands:
        table |= dict(zip(commands, band.low_pass(np.stack([rotors.values[c] for c in commands], axis=1)).T))
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
