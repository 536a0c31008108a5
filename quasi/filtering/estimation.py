"""States and biases of one flight: by the filter and smoother, or as imported."""

from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import pandas as pd

from quasi import attitude
from quasi.errors import DataError, add_caution
from quasi.filtering import bias as biases
from quasi.filtering import capture_doubt, ekf, measurements, noise
from quasi.filtering.filter_inputs import (
    SENSORS,
    Material,
    NoiseLevels,
    make_inputs,
    noise_levels,
    since_take_off,
    without_accelerometer_bias,
)
from quasi.filtering.smoother import smooth
from quasi.sensor_limits import runs_of

DRIFT_SIGMAS = 4.0  # rest and flight that disagree by more are reported
UNSURE_ATTITUDE, UNSURE_VELOCITY = np.radians(3.0), 0.3  # rad, m/s: states with a larger standard error are not valid

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
        f"{kind}_nis": ("1", "", f"normalised innovation squared of {kind}, 3 degrees of freedom")
        for kind in ekf.MEASUREMENT_KINDS
    },
}


@dataclass
class Run:
    """States of a flight from the filter or from the import, on the grid."""

    quaternion: np.ndarray
    velocity: np.ndarray
    position: np.ndarray
    bias: np.ndarray  # (N, 6) applied
    unsure: np.ndarray
    report: dict[str, Any]
    convergence: pd.DataFrame | None


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


def copy(flight: Material) -> Run:
    """States as imported; biases from the rest before take-off, or none."""
    frame, found, notes = flight.frame, flight.found, flight.notes
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
    made = flight.metadata.get("reconstructed") or {}
    if "gyro" in made or found.rest is None:  # what is made from an attitude has no bias of its own
        value, std, policy = np.zeros(6), np.full(6, np.nan), "none"
        notes.append("no bias correction is made")
    else:
        value, std = _at_rest(frame, found.rest)
        policy = "rest"
    return Run(
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
            "captured point": None,
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


def estimate(flight: Material, watch: ekf.Watch | None = None) -> Run:
    """States and biases by the filter, smoothed when asked. watch  see `filterpy_engine.forward`."""
    frame, metadata, airframe, chosen, imu, found, folded, dt, notes = flight
    t, flying = frame["t"].to_numpy(float), ~found.on_ground
    still, noise_notes, origin = measurements.sensor_noise(
        airframe.noise, bool(chosen["use noise statistics in drone config"])
    )
    measured = measurements.collect(frame, metadata, airframe.noise, found.on_ground, dt)
    notes += noise_notes + measured.notes
    levels = noise_levels(flight, still, origin)
    inputs = make_inputs(flight, measured, levels)
    if "accelerometer" in (metadata.get("reconstructed") or {}):
        inputs = without_accelerometer_bias(inputs)
        notes.append("the specific force was made from other signals; its bias is taken as 0")
    factors = np.ones(noise.FACTORS)
    if chosen["re-estimate noise"]:
        share = levels.lowest / levels.moving
        floor = np.array([share[:3].max(), share[3:].max()])
        factors = noise.estimate_levels(inputs, flying, floor, folded)
        inputs = noise.with_levels(inputs, factors, since_take_off(found.on_ground) & ~imu.lost, folded)
    engine, forward = _forward(chosen["engine"], inputs, watch)
    final = smooth(inputs, forward) if chosen["smoother"] else forward
    lever = None
    if measured.source["position"].startswith("capture"):
        late, lever = capture_doubt.clock_uncertainty(metadata, t), capture_doubt.find_lever(inputs, forward)
        forward, final = (_doubted(run, inputs, late, lever) for run in (forward, final))
    deviation, early = ekf.deviations(final.covariance), ekf.deviations(forward.covariance)

    independent = all(measured.source[k].startswith("capture") for k in ("attitude", "position"))
    applied, bias_report = _apply(flight, independent, final, deviation, forward, early)
    nis = _consistency(forward, notes)
    limit = round(float(chosen["capture gap limit s"]) / dt)
    unsure = _unsure(deviation, flying, notes) | _uncaptured(flight, measured, forward, limit)
    aligned = chosen["estimate attitude alignment"] and measured.source["attitude"] != "none"
    report = {
        "engine": engine,
        "smoother": bool(chosen["smoother"]),
        "noise": _noise_report(
            levels, inputs, factors, measured, flying & ~imu.lost, bool(chosen["re-estimate noise"])
        ),
        "NIS": nis,
        "consistent": all(entry.get("consistent", False) for entry in nis.values()) if nis else None,
        "biases": bias_report,
        "attitude alignment": {
            axis: {"value": float(final.state[-1, 12 + i]), "std": float(deviation[-1, 15 + i]), "unit": "rad"}
            for i, axis in enumerate(("roll", "pitch", "yaw"))
        }
        if aligned
        else None,
        "captured point": lever
        and {a: {"value": float(v), "std": float(s), "unit": "m"} for a, v, s in zip("xyz", *lever)},
    }
    return Run(
        final.quaternion,
        final.state[:, :3],
        final.state[:, 3:6],
        applied,
        unsure,
        report,
        _course(t, forward, early, final, deviation),
    )


def _doubted(
    run: ekf.FilterResult, inputs: ekf.Inputs, late: np.ndarray, lever: tuple[np.ndarray, np.ndarray] | None
) -> ekf.FilterResult:
    """A pass with what is not known of the capture's clock and of its point in the covariance."""
    shifts = [capture_doubt.clock_shift(run, inputs, late)]
    if lever is not None:
        shifts.append(capture_doubt.lever_shift(run, inputs, lever[0]))
    return capture_doubt.widen(run, shifts)


def _consistency(forward: ekf.FilterResult, notes: list[str]) -> dict[str, dict[str, Any]]:
    """Normalised innovations squared of each kind of measurement, with a note where they are not those expected."""
    nis = noise.consistency(forward)
    for kind, entry in nis.items():
        if excesses := noise.beyond(entry):
            add_caution(notes, f"the filter is not consistent in {kind}: {'; '.join(excesses)}")
    return nis


def _unsure(deviation: np.ndarray, flying: np.ndarray, notes: list[str]) -> np.ndarray:
    """True (N,) where attitude or velocity is too little known. deviation  (N, 18) standard errors of the states"""
    unsure = (deviation[:, :3].max(axis=1) > UNSURE_ATTITUDE) | (deviation[:, 3:6].max(axis=1) > UNSURE_VELOCITY)
    if (unsure & flying).any():
        notes.append(
            f"attitude or velocity is known to no better than {np.degrees(UNSURE_ATTITUDE):.0f} deg or "
            f"{UNSURE_VELOCITY:g} m/s in {100 * (unsure & flying).mean():.3g} % of the flight, which is marked invalid"
        )
    return unsure


def _uncaptured(
    flight: Material, measured: measurements.Measurements, forward: ekf.FilterResult, limit: int
) -> np.ndarray:
    """True (N,) where the capture gives nothing for more than `limit` samples."""
    t = flight.frame["t"].to_numpy(float)
    unseen = np.zeros(len(t), bool)
    for i, kind in enumerate(ekf.MEASUREMENT_KINDS):
        if not measured.source[kind].startswith("capture"):
            continue
        gap = _gaps(forward.outcome[:, i] > 0, limit)
        for a, b in runs_of(gap & ~flight.found.on_ground):
            flight.notes.append(
                f"the capture gives no {kind} from t = {t[a]:.2f} s to {t[b - 1]:.2f} s; the states are bridged by "
                "the IMU and marked invalid"
            )
        unseen |= gap
    return unseen


def _noise_report(
    levels: NoiseLevels,
    inputs: ekf.Inputs,
    factors: np.ndarray,
    measured: measurements.Measurements,
    trusted: np.ndarray,
    again: bool,
) -> dict[str, Any]:
    """Noise levels that the filter used. trusted  (N,) in flight, nothing lost; again  whether they were asked anew"""
    in_flight = np.median(inputs.noise[trusted], axis=0) if trusted.any() else levels.still
    return {
        "sensors": levels.origin,
        "at rest": dict(zip(SENSORS, levels.still.tolist())),
        "in flight": dict(zip(SENSORS, in_flight.tolist())),
        "re-estimated": again,
        "measurements": {
            kind: {
                "std": inputs.std[i].tolist(),
                "unit": unit,
                "source": measured.source[kind],
                "factor": float(factors[2 + i]),
            }
            for i, (kind, unit) in enumerate(zip(ekf.MEASUREMENT_KINDS, ("rad", "m", "m/s")))
            if measured.source[kind] != "none"
        },
        "bias random walk": dict(zip(SENSORS, levels.bias_random_walk.tolist())),
    }


def _forward(name: str, inputs: ekf.Inputs, watch: ekf.Watch | None) -> tuple[str, ekf.FilterResult]:
    """The forward pass by an engine, and the engine's name with what it ran on."""
    if name == "compiled":  # done in a tenth of a second, so that there is nothing to watch
        return name, ekf.forward(inputs)
    from quasi.filtering import filterpy_engine

    return f"filterpy {version('filterpy')}", filterpy_engine.forward(inputs, watch)


def _apply(
    flight: Material,
    independent: bool,
    final: ekf.FilterResult,
    deviation: np.ndarray,
    forward: ekf.FilterResult,
    early: np.ndarray,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Biases (N, 6) to take off the measurements (corrected = measured - bias), and what to say of them."""
    policy, found, notes = flight.chosen["bias policy"], flight.found, flight.notes
    flying = ~found.on_ground
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
            add_caution(
                notes,
                f"the bias of {SENSORS[i]} differs between the rest ({rest[i]:.4g}) and the whole flight "
                f"({whole[i]:.4g}) by "
                f"{apart[i]:.1f} standard errors: it drifts, or something unmodelled is taken for it",
            )
    if policy == "time varying":
        return final.state[:, 6:12].copy(), _bias_report(policy, whole, whole_std, evidence=evidence)
    if policy == "automatic":
        # at rest the accelerometer's bias is hidden by the tilt of the attitude source, in flight it is not; without a
        # capture, in flight everything unmodelled goes into the biases
        policy = "whole flight" if independent or found.rest is None else "rest"
        evidence["chosen"] = "automatic"
    if policy == "rest" and found.rest is None:
        notes.append("the biases are estimated over the whole flight instead")
        policy = "whole flight"
    if policy == "rest":
        value, std = rest, rest_std
    else:
        value, std = whole, whole_std
    return np.tile(value, (n, 1)), _bias_report(policy, value, std, evidence=evidence)


def _course(
    t: np.ndarray, forward: ekf.FilterResult, early: np.ndarray, final: ekf.FilterResult, deviation: np.ndarray
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
    for i, kind in enumerate(ekf.MEASUREMENT_KINDS):
        table[f"{kind}_nis"] = np.sum(forward.whitened[:, i] ** 2, axis=1)
    return pd.DataFrame(table)
