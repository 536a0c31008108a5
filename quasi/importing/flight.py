"""Import one flight: read its sources, tie their clocks, fuse them on one grid, say how far it can be trusted."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.airframe import DEFAULT_POLES, erpm100_to_rad_s, read_poles, read_triple
from quasi.attitude import exponential, interpolate, multiply, rotate, rotate_inverse, to_euler
from quasi.errors import DataError, add_caution
from quasi.importing import limits
from quasi.importing.artefacts import flyable
from quasi.importing.calibration import calibrated_capture, calibrated_onboard
from quasi.importing.captured_sensors import Captured
from quasi.importing.checks import rows_in_spans
from quasi.importing.clocks.synchronisation import Motion, Synchronisation, synchronise
from quasi.importing.command_map import add_commanded_speeds
from quasi.importing.contradictions import refuse_wrong_lengths, refuse_wrong_rates
from quasi.importing.cross_checks import cross_check
from quasi.importing.frozen_capture import remove_frozen_poses
from quasi.importing.imu_and_telemetry import lever_arm_term, remove_telemetry_age
from quasi.importing.onboard_log import POSITION_COLUMNS, QUATERNION, Onboard, gather, read_onboard
from quasi.importing.path_errors import SAME_CLOCK_LAG
from quasi.importing.readers.captured_body import refuse_beyond_rooms
from quasi.importing.readers.reader import Request
from quasi.importing.readers.registry import read_capture
from quasi.importing.resampling import covered, fresh, grid, resample, resample_attitude, velocity
from quasi.importing.series import Recording, Series
from quasi.importing.streams import stream
from quasi.importing.verdict import verdict
from quasi.importing.wind import add_wind
from quasi.project import configuration
from quasi.sensor_limits import to_plain
from quasi.tables import sha256_of

SCHEMA = "quasi.imported/1"


def import_flight(
    flight: Mapping[str, Any],
    quadrotor: Mapping[str, Any],
    options: Mapping[str, Any],
    calibration: Mapping[str, Any] | None = None,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """One flight on a uniform grid, and how it was made.

    flight     "flight" (key), "quadrotor", "flight controller", "rigid body", "onboard" (path), "capture" (path or
               None), "log number" (or None), "wind" (see `wind.add_wind`; absent in still air), "unread" (sentences
               on files that the logbook names in vain; absent without)
    quadrotor  its configuration (the manual's listing 1 and our keys)
    options    "data importing" of the processing configuration
    calibration  of the sensors, applied to the raw streams (see `quasi.importing.calibration`); None for none
    Returns    columns of quasi.tables.COLUMNS (SI, earth NED, body FRD) from t = 0 at the first fused sample; flags
               attitude_sample, position_sample, velocity_sample, onboard_valid, and imu_clipped where a sensor left
               its range, as 0 or 1; and the metadata
    Raises     ReadError, DataError or ConfigError: a sentence that names the file and the remedy
    """
    chosen, _ = configuration.check(dict(options), "processing", "data importing", "properties", "data importing")
    rate = float(chosen["resampling rate"])
    where = str(flight["flight"])
    notes: list[str] = []
    for sentence in flight.get("unread", ()):
        add_caution(notes, sentence)
    poles = read_poles(quadrotor, where)
    recording = read_onboard(flight, quadrotor)
    recording.metadata["sha256"] = sha256_of(flight["onboard"])
    marker = _marker(quadrotor)
    moved = ((calibration or {}).get("capture") or {}).get("marker offset")
    if moved is not None:
        marker = np.asarray(moved, float) + (np.zeros(3) if marker is None else marker)
        quadrotor = {**quadrotor, "optitrack marker cg offset": marker.tolist()}
    capture, captured = _read_capture(flight, quadrotor, chosen, recording, notes)
    seen = None if capture is None else Captured(capture, captured is None, _longest_lag(chosen, captured))
    board = gather(recording, where, notes, float(chosen["optitrack velocity Hz cutoff"]), seen)
    if capture is not None and captured is None:
        capture = _on_board_time(capture, quadrotor, board)
    _refuse_more_rotors(board, where)
    ends = limits.clipped_ends(board, recording.metadata.get("units") or {})
    known = quadrotor.get("sensor calibration")
    for document in (known, calibration):  # the second was found in flights that the first had corrected
        if document:
            board, capture = calibrated_onboard(board, document), calibrated_capture(capture, marker, document)
    if ((calibration or {}).get("imu") or {}).get("lever arm") and "imu position" not in quadrotor:
        chosen["do onboard c.g. correction"] = False  # what hover would give is in the calibration
    motion = board.motion()
    try:
        sync = _align(board, motion, capture, captured, chosen, where, notes)
    except DataError as error:
        if any(end.sensor == "gyro" for end in ends):
            raise DataError(f"{error}; the gyro was clipped at the end of its range, which may be why") from None
        raise
    if capture is not None:
        capture = remove_frozen_poses(capture, board.gyro, sync, where, notes)
    contradictory = cross_check(board, motion, capture, sync)
    board, telemetry = remove_telemetry_age(board, where, notes)
    frame, facts = _fuse(board, capture, sync, quadrotor, chosen, where, notes)
    at = frame["t"].to_numpy() + facts["start"]["value"]
    frame["onboard_valid"] *= ~rows_in_spans(board.invalid, at)
    facts["saturation"] = limits.facts(ends, at, where, notes)
    if ends:
        frame["imu_clipped"] = limits.spoiled(ends, at).astype(float)
    if flight.get("wind"):
        tau = None
        if captured is not None and sync is not None:
            tau = np.interp(at, sync.to_onboard(capture.t), capture.t)
        frame, facts["wind"] = add_wind(frame, flight["wind"], captured, tau, where, notes)
    frame, facts["commanded speeds"] = add_commanded_speeds(frame, quadrotor.get("command map"), where, notes)
    magnets = recording.metadata.get("motor poles") or {
        "value": poles or DEFAULT_POLES,
        "source": "configuration" if poles else "default",
    }
    metadata = {
        "schema": SCHEMA,
        "flight": flight["flight"],
        "quadrotor": flight["quadrotor"],
        "sources": {"onboard": recording.metadata} | ({"capture": captured.metadata} if captured else {}),
        "sampling": {"rate": rate, "samples": len(frame), "duration": float(frame["t"].iloc[-1])},
        **facts,
        "reconstructed": board.made,
        "contradictions": to_plain(contradictory),
        "streams": _streams(board, capture, sync, facts["start"]["value"]),
        "synchronisation": sync.metadata() if sync else None,
        "motor poles": magnets,
        "logged to rad/s": erpm100_to_rad_s(int(magnets["value"])) if magnets.get("value") else None,
        "rotor telemetry": telemetry,
        "options": chosen,
        "calibration": calibration,
        "sensor calibration": known,
        "notes": [*(captured.notes if captured else []), *recording.notes, *(sync.notes if sync else []), *notes],
    }
    metadata |= verdict(frame, board, metadata)
    return frame, metadata


def _streams(
    board: Onboard, capture: Series | None, sync: Synchronisation | None, zero: float
) -> dict[str, dict[str, Any]]:
    """Sampling of each source, in times of the fused flight."""
    times = {"gyro": board.gyro.t, "accelerometer": board.force.t}
    times = {name: t for name, t in times.items() if name not in board.made}
    if board.rotors is not None:
        times["rotor speeds"] = board.rotors.t[np.isfinite(board.rotors.values).all(axis=1)]
    if board.attitude_source == "onboard":
        times["on-board attitude"] = board.attitude.t[np.isfinite(board.attitude.values).all(axis=1)]
    if capture is not None:
        there = sync.to_onboard(capture.t) if sync else capture.t
        times["capture"] = there[np.isfinite(capture.values["x"])]
    return {name: found for name, t in times.items() if (found := stream(t, zero)) is not None}


def _refuse_more_rotors(board: Onboard, where: str) -> None:
    turning = [n for n in ("w5", "w6", "w7", "w8") if n in board.others and np.nanmax(board.others[n].values) > 0.0]
    if turning:
        raise DataError(
            f"{where}: the log has {4 + len(turning)} turning rotors, expected the four of a quadrotor; such a vehicle "
            "cannot be modelled here"
        )


def _longest_lag(chosen: Mapping[str, Any], captured: Recording | None) -> float:
    """How far the clocks of log and capture may lie apart, s; captured is None where the log stamps both."""
    longest = float(chosen["max permitted lag for optitrack"])
    return longest if captured is not None else min(SAME_CLOCK_LAG, longest)


def _read_capture(
    flight: Mapping[str, Any],
    quadrotor: Mapping[str, Any],
    chosen: Mapping[str, Any],
    recording: Recording,
    notes: list[str],
) -> tuple[Series | None, Recording | None]:
    """The capture's series, on a clock of its own or on the log's, and the capture file as read, None without one."""
    offset = _marker(quadrotor)
    if flight.get("capture"):
        captured = read_capture(Request.of_capture(flight, offset, bool(chosen["filter optitrack outliers"])))
        return captured.series["capture"], captured
    if "capture" not in recording.series:
        return None, None
    series = recording.series["capture"]
    values = {name: column.copy() for name, column in series.values.items()}
    q = series.matrix(QUATERNION)
    held = [series.matrix(POSITION_COLUMNS), *([] if q is None else [q])]
    seen = np.isfinite(np.hstack(held)).all(axis=1)
    if seen.any():
        refuse_beyond_rooms(
            series.matrix(POSITION_COLUMNS)[seen], f"{flight['onboard']}: the captured position",
            "the unit that 'table columns' states", "correct the unit there",
        )  # fmt: skip
    if chosen["filter optitrack outliers"]:
        turned = q[seen] if q is not None else None
        bad = np.flatnonzero(seen)[~flyable(series.t[seen], series.matrix(POSITION_COLUMNS)[seen], turned)]
        for column in values.values():
            column[bad] = np.nan
        if len(bad):
            notes.append(f"{flight['flight']}: {len(bad)} captured samples were removed as impossible to fly")
    series = Series(series.t, values)
    return series if q is None else _at_cg(series, offset, q), None


def _marker(quadrotor: Mapping[str, Any]) -> np.ndarray | None:
    return read_triple(quadrotor.get("optitrack marker cg offset"), "optitrack marker cg offset")


def _at_cg(series: Series, offset: np.ndarray | None, q: np.ndarray) -> Series:
    """A capture of markers at `offset` (3,) m, body FRD, brought to the cg by the attitude q (n, 4); NaN without it."""
    if offset is None or not np.any(offset):
        return series
    moved = series.matrix(POSITION_COLUMNS) - rotate(np.nan_to_num(q, nan=0.5), offset)
    moved[~np.isfinite(q).all(axis=1)] = np.nan
    return Series(series.t, series.values | {n: moved[:, i] for i, n in enumerate(POSITION_COLUMNS)})


def _on_board_time(series: Series, quadrotor: Mapping[str, Any], board: Onboard) -> Series:
    """A capture of the log's own table, in time since the gyro's first sample; at the cg without its attitude too."""
    series = Series(series.t - board.zero, series.values)
    if "qw" in series.values:
        return series
    fine = np.isfinite(board.attitude.values).all(axis=1)
    q = interpolate(board.attitude.values[fine], board.attitude.t[fine], series.t)
    return _at_cg(series, _marker(quadrotor), q)


def _align(
    board: Onboard, motion: Motion, capture: Series | None, captured: Recording | None, chosen: Mapping[str, Any],
    where: str, notes: list[str],
) -> Synchronisation | None:  # fmt: skip
    """Tie the capture's clock to the on-board clock. A capture of the same table may stay where it is."""
    if capture is None:
        notes.append(
            f"{where}: there is no motion capture; position and velocity come from the on-board log, if it has them"
        )
        return None
    seen = Motion(capture.t, quaternion=capture.matrix(QUATERNION), position=capture.matrix(POSITION_COLUMNS))
    using = list(chosen["align with optitrack using"])
    if captured is not None:
        sync = synchronise(motion, seen, using, _longest_lag(chosen, captured), where)
        unit = captured.metadata["length unit"]
        refuse_wrong_lengths(motion, sync.to_onboard(capture.t), seen.position, unit, where)
    else:
        try:
            sync = synchronise(motion, seen, using, _longest_lag(chosen, captured), where, same_clock=True)
        except DataError as error:
            add_caution(
                notes, f"{where}: the capture stays on the log's own clock, lag 0: none could be found ({error})"
            )
            sync = None
    if seen.quaternion is not None:
        there = sync.to_onboard(capture.t) if sync else capture.t
        scaled = refuse_wrong_rates(
            board.gyro.t, board.gyro.values, there, seen.quaternion, "the captured attitude", where
        )
        if scaled:
            add_caution(notes, scaled)
    return sync


def _fuse(
    board: Onboard, capture: Series | None, sync: Synchronisation | None, quadrotor: Mapping[str, Any],
    chosen: Mapping[str, Any], where: str, notes: list[str],
) -> tuple[pd.DataFrame, dict[str, Any]]:  # fmt: skip
    """Everything on one grid over the common span; and what became of each source."""
    rate = float(chosen["resampling rate"])
    spans = {"gyro": board.gyro.t, "accelerometer": board.force.t}
    if board.rotors is not None:
        spans["rotor telemetry"] = board.rotors.t
    if capture is not None:
        there = sync.to_onboard(capture.t) if sync else capture.t
        spans["capture"] = there[np.isfinite(capture.values["x"])]
    latest, earliest = max(spans, key=lambda n: spans[n][0]), min(spans, key=lambda n: spans[n][-1])
    begin, end = spans[latest][0], spans[earliest][-1]
    if end - begin < 1.0:
        raise DataError(
            f"{where}: its sources ({', '.join(f'{n} {t[0]:.1f} to {t[-1]:.1f} s' for n, t in spans.items())}) have "
            f"{max(0.0, end - begin):.1f} s in common, at least 1 s is needed; check that they are of the same flight"
        )
    logged = board.gyro.t[-1] - board.gyro.t[0]
    cut = [(latest, "begins", begin - board.gyro.t[0]), (earliest, "ends", board.gyro.t[-1] - end)]
    # a capture is started and stopped by hand; what is logged on board ought to be there all along
    if logged - (end - begin) > max(1.0, 0.1 * logged) or any(s > 1.0 for name, _, s in cut if name != "capture"):
        left_out = " and ".join(
            f"{s:.1f} s {'before' if does == 'begins' else 'after'} the {name} {does}"
            for name, does, s in cut
            if s >= 0.05
        )
        notes.append(
            f"{where}: the sources share {end - begin:.1f} s of the {logged:.1f} s that were logged on board; left out "
            f"are {left_out}"
        )
    at = grid(begin, end, rate)
    columns: dict[str, np.ndarray] = {"t": at - at[0]}

    gyro, force = resample(board.gyro.t, board.gyro.values, at), resample(board.force.t, board.force.values, at)
    valid = gyro.covered & force.covered
    for name in sorted(board.others):
        track = board.others[name]
        columns[name] = resample(track.t, track.values, at, smooth=False).values[:, 0]
    if board.rotors is not None:
        valid &= covered(board.rotors.t[np.isfinite(board.rotors.values).all(axis=1)], at)
    acceleration = force.values
    correction = lever_arm_term(gyro.values, acceleration, at, columns, quadrotor, chosen, where, notes)
    if correction is not None:
        acceleration = acceleration - correction["term"]
    columns |= {n: acceleration[:, i] for i, n in enumerate(("ax", "ay", "az"))}
    columns |= {n: gyro.values[:, i] for i, n in enumerate("pqr")}

    onboard = resample_attitude(board.attitude.t, _tied(board, sync), at)
    seen = None
    if capture is not None and "qw" in capture.values:
        seen = resample_attitude(there, capture.matrix(QUATERNION), at)
    use_board = bool(chosen["use onboard attitude"]) or seen is None
    attitude = onboard if use_board else seen
    euler = to_euler(attitude.values)
    columns |= {n: euler[:, i] for i, n in enumerate(("roll", "pitch", "yaw"))}
    columns |= {f"onboard_{n}": a for n, a in zip(("roll", "pitch", "yaw"), to_euler(onboard.values).T)}

    place, moving, sources = _motion(board, capture, there if capture is not None else None, at, chosen)
    zeros = np.zeros(len(at), bool)
    position_sample = velocity_sample = zeros
    if place is not None:
        columns |= {n: place.values[:, i] for i, n in enumerate(POSITION_COLUMNS)}
        position_sample = place.sample & place.covered
    if moving is not None:
        in_body = moving[0]
        if sources["velocity source"] != "onboard, body axes":
            # the capture's own attitude turns its velocity best, whichever attitude is handed on
            in_body = rotate_inverse((seen or onboard).values, in_body)
        columns |= {n: in_body[:, i] for i, n in enumerate(("u", "v", "w"))}
        velocity_sample = moving[1]
    columns |= {
        "attitude_sample": (attitude.sample & attitude.covered).astype(float),
        "position_sample": position_sample.astype(float),
        "velocity_sample": velocity_sample.astype(float),
        "onboard_valid": valid.astype(float),
    }
    facts = {
        "attitude source": board.attitude_source if use_board else "capture",
        "position source": sources["position source"],
        "velocity source": sources["velocity source"].split(",")[0],
        "start": {"value": float(at[0]), "unit": "s", "clock": "on board, since its first gyro sample"},
        "rest before take-off": {"value": _rest_kept(board, begin, end), "unit": "s"},
        "corrections": {
            f"{what} filter delay": {**board.delays[what], "applied": board.delays[what]["value"] > 0}
            for what in ("gyro", "accelerometer")
        }
        | {"imu position": correction["about"] if correction else None},
        "velocity bandwidth": {"value": float(chosen["optitrack velocity Hz cutoff"]), "unit": "Hz"},
    }
    order = sorted(columns, key=lambda name: (_ORDER.index(name) if name in _ORDER else len(_ORDER), name))
    return pd.DataFrame({name: columns[name] for name in order}), facts


def _rest_kept(board: Onboard, begin: float, end: float) -> float:
    """Seconds of the rest at the log's start that lie between begin and end, s on the on-board clock."""
    start = float(board.gyro.t[0])
    return max(0.0, min(start + board.rest_seconds, end) - max(start, begin))


def _tied(board: Onboard, sync: Synchronisation | None) -> np.ndarray:
    """On-board attitude (n, 4) whose heading agrees with the capture's; an estimated one loses its drift too."""
    if sync is None:
        return board.attitude.values
    t = board.attitude.t
    drift = sync.yaw_drift if board.attitude_source == "estimated on board" else 0.0
    yaw = sync.yaw_offset + drift * (t - sync.yaw_reference)
    return multiply(exponential(np.stack([0 * t, 0 * t, yaw], axis=-1)), board.attitude.values)


_ORDER = [
    "t", *[f"w{i}" for i in range(1, 9)], *[f"command{i}" for i in range(1, 9)], *[f"w{i}_CMD" for i in range(1, 9)],
    "ax", "ay", "az", "p", "q", "r", "roll", "pitch", "yaw", "x", "y", "z", "u", "v", "w",
    "attitude_sample", "position_sample", "velocity_sample", "onboard_valid",
]  # fmt: skip


def _motion(
    board: Onboard, capture: Series | None, there: np.ndarray | None, at: np.ndarray, chosen: Mapping[str, Any]
) -> tuple[Any, tuple[np.ndarray, np.ndarray] | None, dict[str, str]]:
    """Position on the grid, velocity (earth axes; body axes if logged so) with its flags, and their sources."""
    if capture is not None:
        position = capture.matrix(POSITION_COLUMNS)
        place = resample(there, position, at)
        speed, trusted = velocity(there, position, at, float(chosen["optitrack velocity Hz cutoff"]))
        measured = fresh(there[np.isfinite(position).all(axis=1)], at)
        return place, (speed, trusted & measured), {"position source": "capture", "velocity source": "capture position"}
    place = resample(board.position.t, board.position.values, at) if board.position is not None else None
    sources = {"position source": "onboard" if place else "none", "velocity source": "none"}
    for track, name in ((board.velocity, "onboard"), (board.body_velocity, "onboard, body axes")):
        if track is not None:
            moving = resample(track.t, track.values, at)
            return place, (moving.values, moving.sample & moving.covered), sources | {"velocity source": name}
    return place, None, sources
