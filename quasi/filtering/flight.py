"""Filter one imported flight: states, biases, forces and moments."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from quasi import attitude
from quasi.airframe import Airframe
from quasi.errors import ConfigError, DataError
from quasi.filtering import bias as biases
from quasi.filtering import ekf, forces, measurements, noise
from quasi.filtering.smoother import smooth
from quasi.tables import COLUMNS

DEFAULTS: dict[str, Any] = {
    "use noise statistics in drone config": True,
    "run extended kalman filter": True,
    "add induced velocity": False,
    "smoother": True,
    "bias policy": "rest",
    "low-pass cutoff Hz": 40.0,
    "re-estimate noise": True,
    "estimate attitude alignment": True,
    "gyro bias random walk": 1e-5,
    "accelerometer bias random walk": 1e-4,
    "capture gap limit s": 1.0,
}
POLICIES = ("rest", "whole flight", "time varying")
DRIFTING = np.array([3e-4] * 3 + [3e-3] * 3)  # random walk of time-varying biases, per square root of a second
DRIFT_SIGMAS = 4.0  # rest and flight that disagree by more are reported
UNSURE_ATTITUDE, UNSURE_VELOCITY = np.radians(3.0), 0.3  # rad, m/s: states with a larger standard error are not valid
SENSORS = ("p", "q", "r", "ax", "ay", "az")

CONVERGENCE_UNITS: dict[str, tuple[str, str, str]] = {
    "filter_roll": ("rad", "body to earth, 3-2-1", "roll angle of the forward filter"),
    "filter_pitch": ("rad", "body to earth, 3-2-1", "pitch angle of the forward filter"),
    "filter_yaw": ("rad", "body to earth, 3-2-1", "yaw angle of the forward filter"),
    **{f"filter_v{a}": ("m/s", "earth NED", f"velocity along {a} of the forward filter") for a in "xyz"},
    **{f"filter_{a}": ("m", "earth NED", f"position along {a} of the forward filter") for a in "xyz"},
    **{
        f"{kind}_std_{a}": (unit, frame, f"standard error of {kind} along {a}")
        for kind, unit, frame in (
            ("attitude", "rad", "body FRD"),
            ("velocity", "m/s", "earth NED"),
            ("position", "m", "earth NED"),
        )
        for a in "xyz"
    },
    **{
        f"{name}_{s}": ("rad/s" if s in "pqr" else "m/s2", "body FRD", f"{meaning} of {s}")
        for s in SENSORS
        for name, meaning in (
            ("filter_bias", "bias by the forward filter"),
            ("filter_bias_std", "its standard error by the forward filter"),
            ("bias", "bias"),
            ("bias_std", "standard error of the bias"),
        )
    },
    **{
        f"{kind}_nis": ("1", "", f"normalised innovation squared of {kind}, 3 degrees of freedom") for kind in ekf.KINDS
    },
}


@dataclass(frozen=True)
class Filtered:
    """A filtered flight.

    with_gravity, no_gravity   the same states with forces as mass x specific force, and as net force
    metadata                   plain data, schema "quasi.filtered/1"
    convergence                the filter's course over time (units: CONVERGENCE_UNITS), None when no filter was run
    """

    with_gravity: pd.DataFrame
    no_gravity: pd.DataFrame
    metadata: dict[str, Any]
    convergence: pd.DataFrame | None


def _options(options: Mapping[str, Any]) -> dict[str, Any]:
    chosen = {**DEFAULTS, **options}
    if chosen["bias policy"] not in POLICIES:
        raise ConfigError(f"'bias policy' is {chosen['bias policy']!r}, expected one of {', '.join(POLICIES)}")
    for key in ("low-pass cutoff Hz", "capture gap limit s"):
        if not float(chosen[key]) > 0.0:
            raise ConfigError(f"'{key}' is {chosen[key]!r}, expected a positive number")
    return chosen


def _check(airframe: Airframe) -> None:
    if airframe.mass is None:
        raise DataError(
            f"{airframe.name}: no mass is known; give 'Mass' in the logbook or 'mass' in the quadrotor configuration"
        )
    inertia = np.asarray(airframe.inertia, float)
    if not np.all(np.isfinite(inertia)) or np.min(np.linalg.eigvalsh(0.5 * (inertia + inertia.T))) <= 0:
        raise DataError(
            f"{airframe.name}: 'moment of inertia' is not positive definite; check its entries and units (kg m2)"
        )


def _filled(frame: pd.DataFrame, names: list[str], notes: list[str]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Columns with their gaps bridged, and True (N,) where one was; columns without any value are left out with a note."""
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
                f"column '{name}' is missing in {int(bad.sum())} samples, first at t = {frame['t'].iloc[int(np.argmax(bad))]:.3f} s; "
                "they are bridged by straight lines and marked invalid"
            )
            lost |= bad
        elif np.ptp(values) == 0.0 and name[0] == "w":
            notes.append(
                f"column '{name}' is constant ({values[0]:g}) all through the flight; check the sensor and its mapping"
            )
        found[name] = measurements.fill(values)
    return found, lost


@dataclass
class _Run:
    """States of a flight from the filter or from the import, on the grid."""

    quaternion: np.ndarray
    velocity: np.ndarray
    position: np.ndarray
    bias: np.ndarray  # (N, 6) applied
    unsure: np.ndarray
    report: dict[str, Any]
    convergence: pd.DataFrame | None


def filter_flight(
    imported: pd.DataFrame, imported_metadata: Mapping[str, Any], airframe: Airframe, options: Mapping[str, Any]
) -> Filtered:
    """Estimate states and biases of one flight and derive its forces and moments.

    imported   columns of design.md section 3 on a uniform grid, with attitude_sample, position_sample, velocity_sample and
               onboard_valid as 0 or 1; imported_metadata  its metadata (sources, rate, "logged to rad/s")
    airframe   mass and inertia must be known; options  the section "data filtering" of the processing configuration
    Returns    Filtered; every row of the import is kept, column `valid` is 1 where a row may be used for identification
    Raises     DataError where the flight cannot be filtered, ConfigError for an impossible option
    """
    chosen = _options(options)
    _check(airframe)
    t = imported["t"].to_numpy(float)
    dt = measurements.time_step(t)
    rate = 1.0 / dt
    notes: list[str] = []
    imu = measurements.read_imu(imported)
    notes += imu.notes
    rotors = [c for c in imported if c[0] == "w" and c[1:].isdigit()]
    driven = [c for c in imported if c.startswith("command") or c.endswith("_CMD")]
    actuators, actuators_lost = _filled(imported, [*rotors, *driven], notes)
    rotors = [c for c in rotors if c in actuators]

    speeds = np.stack([actuators[c] for c in rotors], axis=1) if rotors else None
    position = imported[["x", "y", "z"]].to_numpy(float) if {"x", "y", "z"} <= set(imported) else None
    factor = imported_metadata.get("logged to rad/s") or airframe.logged_to_rad_s
    idle = airframe.idle_rpm * factor if airframe.idle_rpm and factor else None
    found = biases.phases(imu.gyro, imu.accel, imu.lost, speeds, position, idle, dt)
    notes += found.notes

    estimate = _estimate if chosen["run extended kalman filter"] else _copy
    run = estimate(imported, imported_metadata, airframe, chosen, imu, found, dt, notes)

    cutoff = float(chosen["low-pass cutoff Hz"])
    if cutoff > forces.HIGHEST * rate:
        notes.append(
            f"the low-pass cut-off of {cutoff:g} Hz is too high for a grid of {rate:g} Hz; {forces.HIGHEST * rate:g} Hz is used"
        )
        cutoff = forces.HIGHEST * rate
    reach = forces.half_length(cutoff, rate)
    gyro = imu.gyro - run.bias[:, :3]
    rates, rates_dot = forces.low_pass(gyro, cutoff, rate), forces.derivative(gyro, cutoff, rate)
    specific = forces.low_pass(imu.accel - run.bias[:, 3:], cutoff, rate)
    body = attitude.rotate_inverse(run.quaternion, run.velocity)

    in_flight = ~found.on_ground
    edge = np.zeros(len(t), bool)
    edge[:reach] = edge[-reach:] = True
    lost = forces.spread(imu.lost | actuators_lost, reach) | edge
    valid = in_flight & ~lost & ~run.unsure

    table: dict[str, np.ndarray] = {"t": t}
    for name in rotors:
        table[name] = forces.low_pass(actuators[name], cutoff, rate)
        table[f"{name}_dot"] = forces.derivative(actuators[name], cutoff, rate)
    for name in driven:
        if name in actuators:
            table[name] = forces.low_pass(actuators[name], cutoff, rate)
    for i, name in enumerate("xyz"):
        table[f"a{name}"] = specific[:, i]
    for i, name in enumerate("pqr"):
        table[name] = rates[:, i]
        table[f"{name}_dot"] = rates_dot[:, i]
    table |= dict(zip(("roll", "pitch", "yaw"), attitude.to_euler(run.quaternion).T))
    table |= dict(zip("xyz", run.position.T))
    table |= dict(zip("uvw", body.T))
    air = _through_air(imported, body, run.quaternion)
    if air is not None:
        table |= dict(zip(("u_air", "v_air", "w_air"), air.T))
    force = forces.forces(specific, airframe.mass)
    table |= dict(zip(("Fx", "Fy", "Fz"), force.T))
    table |= dict(zip(("Mx", "My", "Mz"), forces.moments(rates, rates_dot, np.asarray(airframe.inertia)).T))
    if chosen["add induced velocity"]:
        table["v_in"] = forces.induced_velocity(body if air is None else air, airframe.mass, airframe.radius)
        sinking = ~np.isfinite(table["v_in"])
        if sinking.any():
            notes.append(
                f"the induced velocity is not defined in {100 * sinking.mean():.2g} % of the flight (descent); v_in is empty there"
            )
    extra = [c for c in imported if c in COLUMNS and c not in table and c not in ("vx", "vy", "vz") and "_air" not in c]
    extra = [c for c in extra if not c.endswith("_sample") and c != "onboard_valid" and c not in driven]
    table |= _filled(imported, extra, notes)[0]
    table["in_flight"], table["valid"] = in_flight.astype(float), valid.astype(float)

    if not valid.any():
        notes.append("no row of this flight is valid for identification; see the other notes")
    with_gravity = pd.DataFrame(table)
    net = forces.net_forces(specific, run.quaternion, airframe.mass)
    no_gravity = with_gravity.assign(**dict(zip(("Fx", "Fy", "Fz"), net.T)))
    metadata = {
        "schema": "quasi.filtered/1",
        "flight": imported_metadata.get("flight"),
        "quadrotor": imported_metadata.get("quadrotor"),
        "mass": airframe.mass,
        "inertia": np.asarray(airframe.inertia).tolist(),
        "sampling": {"rate": rate, "samples": len(t)},
        "gravity": {
            "withGravity": "force = mass x specific force",
            "noGravity": "net force",
            "value": attitude.GRAVITY,
        },
        **run.report,
        "filters": {
            "kind": "zero-phase Kaiser-windowed sinc, the same for rates, accelerations, rotor speeds and commands",
            "low-pass cutoff Hz": cutoff,
            "half length samples": reach,
        },
        "phases": {
            "take-off": None if found.take_off is None or found.take_off >= len(t) else float(t[found.take_off]),
            "rest": None if found.rest is None else [float(t[found.rest.first]), float(t[found.rest.last - 1])],
            "in flight share": float(in_flight.mean()),
            "valid share": float(valid.mean()),
        },
        "imported": dict(imported_metadata),
        "options": chosen,
        "notes": notes,
    }
    return Filtered(with_gravity, no_gravity, metadata, run.convergence)


def _through_air(imported: pd.DataFrame, body: np.ndarray, quaternion: np.ndarray) -> np.ndarray | None:
    """Velocity through the air (N, 3), body axes, where the import knew the wind; None where it did not."""
    names = ["u_air", "v_air", "w_air"]
    if not set(names) <= set(imported) or not {"u", "v", "w", "roll"} <= set(imported):
        return None
    ground, through = imported[["u", "v", "w"]].to_numpy(float), imported[names].to_numpy(float)
    turned = attitude.from_euler(*imported[["roll", "pitch", "yaw"]].to_numpy(float).T)
    wind = attitude.rotate(turned, ground - through)
    if not np.isfinite(wind).any():
        return None
    wind = np.stack([measurements.fill(c) for c in wind.T], axis=1)
    return body - attitude.rotate_inverse(quaternion, wind)


def _at_rest(frame: pd.DataFrame, rest: biases.Rest) -> tuple[np.ndarray, np.ndarray]:
    """Biases (6,) and standard errors from a rest alone; the attitude then is the imported one, or level."""
    part = slice(rest.first, rest.last)
    expected = np.array([0.0, 0.0, -attitude.GRAVITY])
    if {"roll", "pitch", "yaw"} <= set(frame):
        euler = frame[["roll", "pitch", "yaw"]].to_numpy(float)[part]
        euler = euler[np.isfinite(euler).all(axis=1)]
        if len(euler):
            down = attitude.rotate_inverse(attitude.from_euler(*euler.T), expected)
            expected = down.mean(axis=0)
    tilt = np.radians(0.5) * attitude.GRAVITY * np.array([1.0, 1.0, 0.0])  # an attitude source is not set up better
    return (
        np.concatenate([rest.gyro, rest.accel - expected]),
        np.concatenate([rest.gyro_std, np.hypot(rest.accel_std, tilt)]),
    )


def _bias_report(policy: str, value: np.ndarray, std: np.ndarray, **more: Any) -> dict[str, Any]:
    parts = {
        sensor: {"value": value[s].tolist(), "std": std[s].tolist(), "unit": unit}
        for sensor, s, unit in (("gyro", slice(0, 3), "rad/s"), ("accelerometer", slice(3, 6), "m/s2"))
    }
    return {"policy": policy, **parts, **more}


def _copy(
    frame: pd.DataFrame,
    metadata: Mapping[str, Any],
    airframe: Airframe,
    chosen: Mapping[str, Any],
    imu: measurements.Imu,
    found: biases.Phases,
    dt: float,
    notes: list[str],
) -> _Run:
    """States as imported; biases from the rest before take-off, or none."""
    n = len(frame)
    needed = {"attitude": ("roll", "pitch", "yaw"), "position": ("x", "y", "z"), "velocity": ("u", "v", "w")}
    states: dict[str, np.ndarray] = {}
    unsure = np.zeros(n, bool)
    for kind, names in needed.items():
        values = frame[list(names)].to_numpy(float) if set(names) <= set(frame) else np.full((n, 3), np.nan)
        bad = ~np.isfinite(values).all(axis=1)
        if bad.all() and kind == "attitude":
            raise DataError(
                "the imported flight has no attitude; set 'run extended kalman filter' to true to have it estimated"
            )
        if bad.all():
            notes.append(f"the imported flight has no {kind}; it stands as zero")
            values = np.zeros((n, 3))
        elif bad.any():
            notes.append(f"{kind} is missing in {int(bad.sum())} samples, which are bridged and marked invalid")
            values = np.stack([measurements.fill(c) for c in values.T], axis=1)
            unsure |= bad
        states[kind] = values
    quaternion = attitude.from_euler(*states["attitude"].T)
    notes.append("the Kalman filter was not run: states are those imported")
    if found.rest is None:
        value, std, policy = np.zeros(6), np.full(6, np.nan), "none"
        notes.append("no bias correction is made")
    else:
        value, std = _at_rest(frame, found.rest)
        policy = "rest"
    return _Run(
        quaternion,
        attitude.rotate(quaternion, states["velocity"]),
        states["position"],
        np.tile(value, (n, 1)),
        unsure,
        {
            "engine": None,
            "biases": _bias_report(policy, value, std),
            "NIS": {},
            "consistent": None,
            "attitude alignment": None,
        },
        None,
    )


def _gaps(used: np.ndarray, limit: int) -> np.ndarray:
    """True (N,) inside gaps between measurements that are longer than `limit` samples."""
    at = np.flatnonzero(used)
    inside = np.zeros(len(used), bool)
    for a, b in zip(np.concatenate([[-1], at]), np.concatenate([at, [len(used)]])):
        if b - a > limit:
            inside[a + 1 : b] = True
    return inside


def _estimate(
    frame: pd.DataFrame,
    metadata: Mapping[str, Any],
    airframe: Airframe,
    chosen: Mapping[str, Any],
    imu: measurements.Imu,
    found: biases.Phases,
    dt: float,
    notes: list[str],
) -> _Run:
    """States and biases by the filter, smoothed when asked."""
    n = len(frame)
    t = frame["t"].to_numpy(float)
    still, noise_notes, origin = measurements.sensor_noise(
        airframe.noise, bool(chosen["use noise statistics in drone config"])
    )
    if found.rest is not None:
        still = np.maximum(still, found.rest.noise)  # what the rest itself shows, coloured noise included
    measured = measurements.collect(frame, metadata, airframe.noise, found.on_ground, dt)
    notes += noise_notes + measured.notes
    flying = ~found.on_ground
    level = np.tile(still, (n, 1))
    rough = np.array([measurements.FLIGHT_STD[s] for s in SENSORS])
    moving = np.maximum(still, rough) if chosen["re-estimate noise"] else still
    level[flying] = moving
    level[imu.lost] = np.maximum(level[imu.lost], measurements.LOST_STD)
    walk = np.array(
        [float(chosen["gyro bias random walk"])] * 3 + [float(chosen["accelerometer bias random walk"])] * 3
    )
    if chosen["bias policy"] == "time varying":
        walk = np.maximum(walk, DRIFTING)
    quaternion, state, covariance = measurements.start(
        frame, measured, imu, dt, bool(found.on_ground[0]), bool(chosen["estimate attitude alignment"])
    )
    per_second = measured.used.sum(axis=0) / (n * dt)
    inputs = ekf.Inputs(
        dt,
        imu.gyro,
        imu.accel,
        level,
        walk,
        measured.used,
        measured.attitude,
        np.ascontiguousarray(np.nan_to_num(measured.position)),
        np.ascontiguousarray(np.nan_to_num(measured.velocity)),
        measured.body,
        measured.std,
        noise.GATE,
        np.maximum(3, per_second.astype(np.int64)),  # a second of rejections in a row
        quaternion,
        state,
        covariance,
    )
    if measured.source["attitude"] == "none":
        inputs = _headings(inputs)
    factors = np.ones(5)
    if chosen["re-estimate noise"]:
        factors = noise.estimate_levels(
            inputs, flying, np.array([np.max((still / moving)[:3]), np.max((still / moving)[3:])])
        )
        inputs = noise.with_levels(inputs, factors, flying & ~imu.lost)
    forward = ekf.forward(inputs)
    final = smooth(inputs, forward) if chosen["smoother"] else forward
    deviation = ekf.deviations(final.covariance)
    early = ekf.deviations(forward.covariance)

    applied, report = _apply(chosen["bias policy"], found, final, deviation, forward, early, flying, notes)
    nis = noise.consistency(forward)
    consistent = all(entry.get("consistent", False) for entry in nis.values()) if nis else None
    for kind, entry in nis.items():
        if not entry.get("consistent", True):
            notes.append(
                f"the filter is not consistent in {kind}: mean normalised innovation squared {entry['mean']:.2f} "
                f"(1 expected), {100 * entry['gated']:.2g} % rejected, correlation of neighbours {entry['whiteness']:.2f}"
            )
    unsure = (deviation[:, :3].max(axis=1) > UNSURE_ATTITUDE) | (deviation[:, 3:6].max(axis=1) > UNSURE_VELOCITY)
    if (unsure & flying).any():
        notes.append(
            f"attitude or velocity is known to no better than {np.degrees(UNSURE_ATTITUDE):.0f} deg or {UNSURE_VELOCITY:g} m/s "
            f"in {100 * (unsure & flying).mean():.2g} % of the flight, which is marked invalid"
        )
    limit = round(float(chosen["capture gap limit s"]) / dt)
    for i, kind in enumerate(ekf.KINDS):
        if measured.source[kind].startswith("capture"):
            gap = _gaps(forward.outcome[:, i] > 0, limit)
            for a, b in measurements.spans(gap & flying):
                notes.append(
                    f"the capture gives no {kind} from t = {t[a]:.2f} s to {t[b - 1]:.2f} s; the states are bridged by the IMU "
                    "and marked invalid"
                )
            unsure |= gap
    levels = np.median(inputs.noise[flying & ~imu.lost], axis=0) if (flying & ~imu.lost).any() else still
    used = {
        kind: {
            "std": inputs.std[i].tolist(),
            "unit": unit,
            "source": measured.source[kind],
            "factor": float(factors[2 + i]),
        }
        for i, (kind, unit) in enumerate(zip(ekf.KINDS, ("rad", "m", "m/s")))
        if measured.source[kind] != "none"
    }
    report = {
        "engine": "compiled",
        "smoother": bool(chosen["smoother"]),
        "noise": {
            "sensors": origin,
            "at rest": dict(zip(SENSORS, still.tolist())),
            "in flight": dict(zip(SENSORS, levels.tolist())),
            "re-estimated": bool(chosen["re-estimate noise"]),
            "measurements": used,
            "bias random walk": dict(zip(SENSORS, walk.tolist())),
        },
        "NIS": nis,
        "consistent": consistent,
        "biases": report,
        "attitude alignment": {
            axis: {"value": float(final.state[-1, 12 + i]), "std": float(deviation[-1, 15 + i]), "unit": "rad"}
            for i, axis in enumerate(("roll", "pitch", "yaw"))
        }
        if chosen["estimate attitude alignment"] and measured.source["attitude"] != "none"
        else None,
    }
    return _Run(
        final.quaternion,
        final.state[:, :3],
        final.state[:, 3:6],
        applied,
        unsure,
        report,
        _course(t, forward, early, final, deviation),
    )


def _headings(inputs: ekf.Inputs) -> ekf.Inputs:
    """Start from the heading, of eight tried, that explains the measurements best: none is measured."""
    best: tuple[float, np.ndarray] | None = None
    for yaw in np.arange(8) * np.pi / 4:
        turned = attitude.multiply(attitude.exponential(np.array([0.0, 0.0, yaw])), inputs.quaternion)
        value = ekf.cost(inputs._replace(quaternion=turned, gate=noise.LOOSE_GATE))
        if np.isfinite(value) and (best is None or value < best[0]):
            best = (value, turned)
    return inputs if best is None else inputs._replace(quaternion=best[1])


def _apply(
    policy: str,
    found: biases.Phases,
    final: ekf.Pass,
    deviation: np.ndarray,
    forward: ekf.Pass,
    early: np.ndarray,
    flying: np.ndarray,
    notes: list[str],
) -> tuple[np.ndarray, dict[str, Any]]:
    """Biases (N, 6) to take off the measurements (corrected = measured - bias), and what to say of them."""
    n = len(flying)
    part = flying if flying.any() else np.ones(n, bool)
    whole, whole_std = final.state[part, 6:12].mean(axis=0), np.sqrt((deviation[part, 9:15] ** 2).mean(axis=0))
    evidence: dict[str, Any] = {"whole flight": {"value": whole.tolist(), "std": whole_std.tolist()}}
    if found.rest is not None:
        end = found.rest.last - 1
        rest, rest_std = forward.state[end, 6:12], early[end, 9:15]
        evidence["rest"] = {
            "value": rest.tolist(),
            "std": rest_std.tolist(),
            "mean gyro": found.rest.gyro.tolist(),
            "mean gyro std": found.rest.gyro_std.tolist(),
        }
        apart = np.abs(rest - whole) / np.hypot(rest_std, whole_std)
        for i in np.flatnonzero(apart > DRIFT_SIGMAS):
            notes.append(
                f"the bias of {SENSORS[i]} differs between the rest ({rest[i]:.4g}) and the whole flight ({whole[i]:.4g}) by "
                f"{apart[i]:.1f} standard errors: it drifts, or something unmodelled is taken for it"
            )
    if policy == "time varying":
        return final.state[:, 6:12].copy(), _bias_report(policy, whole, whole_std, evidence=evidence)
    if policy == "rest" and found.rest is None:
        notes.append("the biases are constants estimated over the whole flight, since there is no rest before take-off")
        policy = "whole flight"
    if policy == "rest":
        value, std = rest, rest_std
    else:
        value, std = whole, whole_std
    return np.tile(value, (n, 1)), _bias_report(policy, value, std, evidence=evidence)


def _course(
    t: np.ndarray, forward: ekf.Pass, early: np.ndarray, final: ekf.Pass, deviation: np.ndarray
) -> pd.DataFrame:
    table: dict[str, np.ndarray] = {"t": t}
    table |= dict(zip(("filter_roll", "filter_pitch", "filter_yaw"), attitude.to_euler(forward.quaternion).T))
    table |= dict(zip(("filter_vx", "filter_vy", "filter_vz"), forward.state[:, :3].T))
    table |= dict(zip(("filter_x", "filter_y", "filter_z"), forward.state[:, 3:6].T))
    for i, kind in enumerate(("attitude", "velocity", "position")):
        for j, axis in enumerate("xyz"):
            table[f"{kind}_std_{axis}"] = deviation[:, 3 * i + j]
    for i, name in enumerate(SENSORS):
        table[f"filter_bias_{name}"], table[f"filter_bias_std_{name}"] = forward.state[:, 6 + i], early[:, 9 + i]
        table[f"bias_{name}"], table[f"bias_std_{name}"] = final.state[:, 6 + i], deviation[:, 9 + i]
    for i, kind in enumerate(ekf.KINDS):
        table[f"{kind}_nis"] = np.sum(forward.whitened[:, i] ** 2, axis=1)
    return pd.DataFrame(table)
