"""What the on-board log holds, gathered from its series: gyro, accelerometer, attitude, motion estimates, the rest."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from quasi.airframe import number, read_poles
from quasi.attitude import interpolate
from quasi.errors import DataError, add_caution
from quasi.importing.captured_sensors import POSITION_COLUMNS, QUATERNION, Captured
from quasi.importing.checks import check_recording
from quasi.importing.clocks.filter_delays import header_delays
from quasi.importing.clocks.synchronisation import Motion
from quasi.importing.clocks.telemetry import AGES
from quasi.importing.contradictions import rates_explained, refuse_wrong_rates, velocity_explained
from quasi.importing.onboard_attitude import estimate_attitude
from quasi.importing.path_errors import find_jumps
from quasi.importing.readers.reader import Request
from quasi.importing.readers.registry import read_log
from quasi.importing.reconstruction import Completed, complete_sensors
from quasi.importing.resampling import covered
from quasi.importing.series import Recording, Series, Track, interpolate_columns

LEAST_LOG_EXPLAINED = 0.3  # share of the variance that a log of the same motion explains, a late one too
LEAST_SAMPLES = 20
HELD_HEADING = "held heading"  # deg, of the quadrotor configuration
BANDWIDTH = 10.0  # Hz of made sensors, as of velocities from captured positions
MADE_COLUMN = "reconstructed"
RATES, FORCE = ("p", "q", "r"), ("ax", "ay", "az")
VELOCITY_COLUMNS, BODY_VELOCITY = ("vx", "vy", "vz"), ("u", "v", "w")
LINEAR = ("linear_ax", "linear_ay", "linear_az")
_KNOWN_COLUMNS = {
    *(*RATES, *FORCE, *QUATERNION, *POSITION_COLUMNS, *VELOCITY_COLUMNS, *BODY_VELOCITY, *LINEAR),
    *("roll", "pitch", "yaw"),
}


@dataclass
class Onboard:
    """The on-board side of a flight, times in s since the gyro's first sample.

    attitude_source  "onboard" (logged), "estimated on board" or "reconstructed"
    delays           of gyro and accelerometer by the controller's own filters, s, taken off their times; with their
                     standard errors and whether they are known (see `filter_delays.header_delays`)
    invalid          spans {"begin", "end", "reason"} whose rows cannot be used, see `checks.check_recording`
    others           {quantity: Track (n, 1)} of everything that is not motion
    made             what was made from other signals, see `reconstruction.complete_sensors`
    zero             the gyro's first sample on the log's clock, s
    """

    gyro: Track
    force: Track
    attitude: Track
    attitude_source: str
    rest_seconds: float
    position: Track | None
    velocity: Track | None
    body_velocity: Track | None
    others: dict[str, Track]
    rotors: Track | None
    delays: dict[str, Any] = field(default_factory=dict)
    invalid: list[dict[str, Any]] = field(default_factory=list)
    made: dict[str, dict[str, Any]] = field(default_factory=dict)
    zero: float = 0.0

    def motion(self) -> Motion:
        """For the alignment: everything at the gyro's times."""
        t = self.gyro.t
        force = interpolate_columns(t, self.force.t, self.force.values)
        fine = np.isfinite(self.attitude.values).all(axis=1)
        q = interpolate(self.attitude.values[fine], self.attitude.t[fine], t)
        return Motion(
            t,
            self.gyro.values,
            force,
            q,
            gyro_doubt=self.delays["gyro"]["std"],
            accelerometer_doubt=self.delays["accelerometer"]["std"],
        )


def read_onboard(flight: Mapping[str, Any], quadrotor: Mapping[str, Any]) -> Recording:
    """Read the on-board file by the flight controller it is of, and by what it holds.

    Raises ReadError for a controller that is not supported, or a file that is not what the logbook says.
    """
    request = Request(
        Path(flight["onboard"]),
        str(flight["flight controller"]).strip().lower(),
        quadrotor,
        read_poles(quadrotor, str(flight["onboard"])),
        flight.get("log number"),
    )
    return check_recording(_with_held_heading(read_log(request), quadrotor, str(request.path)), str(request.path))


def _with_held_heading(recording: Recording, quadrotor: Mapping[str, Any], where: str) -> Recording:
    """The recording with the yaw that the configuration states for logs without one; as it is where one is logged."""
    heading = number(quadrotor, HELD_HEADING, "quadrotor configuration")
    onboard = {name: one for name, one in recording.series.items() if name.startswith("onboard")}
    if heading is None or any("yaw" in one.values or "qw" in one.values for one in onboard.values()):
        return recording
    added = {n: Series(s.t, s.values | {"yaw": np.full(len(s.t), np.radians(heading))}) for n, s in onboard.items()}
    notes = list(recording.notes)
    add_caution(notes, f"{where}: the log holds no yaw; it was taken as {heading:g} deg all through, by the quadrotor "
                       f"configuration's '{HELD_HEADING}'")  # fmt: skip
    about = {**recording.metadata, HELD_HEADING: heading}
    return replace(recording, series=recording.series | added, metadata=about, notes=notes)


def _find(series: Mapping[str, Series], names: tuple[str, ...]) -> Track | None:
    """The first on-board series that holds all of these."""
    for name, one in series.items():
        if name.startswith("onboard") and all(n in one.values for n in names):
            return Track(one.t, one.matrix(names))
    return None


def _find_measured(series: Mapping[str, Series], names: tuple[str, ...], where: str, notes: list[str]) -> Track | None:
    """As `_find`, None where fewer than LEAST_SAMPLES rows are known: a damaged record is no path."""
    track = _find(series, names)
    known = 0 if track is None else np.count_nonzero(np.isfinite(track.values).all(axis=1))
    if track is None or known >= LEAST_SAMPLES:
        return track
    notes.append(
        f"{where}: {', '.join(names)} on board have {known} samples, at least {LEAST_SAMPLES} are needed; left out"
    )
    return None


def require_motion(
    recording: Recording,
    where: str,
    notes: list[str],
    bandwidth: float = BANDWIDTH,
    captured: Captured | None = None,
) -> Completed:
    """Gyro and accelerometer of a recording, logged or made from other signals (see `reconstruction`).

    bandwidth  Hz, of what is made from derivatives; captured  the motion capture that the log stamps or comes with
    Raises DataError when neither can be had, or too few of their samples are readable.
    """
    return complete_sensors(recording.series, bandwidth, where, notes, _damage(recording), captured)


def gather(
    recording: Recording,
    where: str,
    notes: list[str],
    bandwidth: float = BANDWIDTH,
    captured: Captured | None = None,
) -> Onboard:
    """Sort the series of a recording; estimate the attitude on board data alone where the log has none.

    bandwidth  Hz, of sensors that are made from derivatives of other signals
    captured   the motion capture, for sensors that nothing else in the log can replace
    Raises DataError when the log holds no gyro or accelerometer and nothing to make them from.
    """
    series = recording.series
    delays = _delays(recording)
    if captured is not None:
        captured = replace(captured, gyro_delay=delays["gyro"]["value"])
    sensors = require_motion(recording, where, notes, bandwidth, captured)
    gyro, force = sensors.gyro, sensors.force
    for name in {"gyro", "accelerometer"} & set(sensors.made):
        delays[name] |= {"value": 0.0, "std": 0.0, "known": True}  # it passed none of the controller's filters
    _report_unknown_delays(delays, recording, where, notes)
    attitude, source, rest = _find(series, QUATERNION), "onboard", 0.0
    if attitude is None and sensors.attitude is not None:
        attitude, source = sensors.attitude, MADE_COLUMN
    at_gyro = interpolate_columns(gyro.t, force.t, force.values)
    try:
        estimate = estimate_attitude(gyro.t, gyro.values, at_gyro)
    except DataError as error:
        raise DataError(f"{where}: the on-board log is too short: {error}") from None
    rest = estimate.rest_seconds
    if attitude is None or np.count_nonzero(np.isfinite(attitude.values).all(axis=1)) < LEAST_SAMPLES:
        attitude, source = Track(gyro.t, estimate.quaternion), "estimated on board"
        notes.append(
            f"{where}: the log holds no attitude; it was estimated from gyro and accelerometer, levelled "
            + (
                f"over {rest:.1f} s at rest"
                if estimate.levelled == "at rest"
                else "over the flight, which begins in the air"
            )
        )
    elif not sensors.made:
        of_both = (gyro.t, gyro.values, attitude.t, attitude.values)
        scaled, explained = refuse_wrong_rates(*of_both, "the on-board attitude", where), rates_explained(*of_both)
        if scaled:
            add_caution(notes, scaled)
        elif explained is not None and explained < LEAST_LOG_EXPLAINED:
            add_caution(
                notes,
                f"{where}: the on-board attitude turns unlike the gyro (it explains {100 * max(0.0, explained):.0f} % "
                "of the body rates); check the unit, order and axes of both",
            )
    position, velocity, body_velocity = (
        _find_measured(series, names, where, notes) for names in (POSITION_COLUMNS, VELOCITY_COLUMNS, BODY_VELOCITY)
    )
    if position is not None and velocity is not None:
        explained = velocity_explained(velocity.t, velocity.values, position.t, position.values)
        if explained is not None and explained < LEAST_LOG_EXPLAINED:
            add_caution(
                notes,
                f"{where}: the on-board velocity is not that of the on-board position (which explains "
                f"{100 * max(0.0, explained):.0f} % of it); check the unit and axes of both",
            )
    zero = gyro.t[0]
    jumps = find_jumps(position, velocity) if captured is None and position is not None and velocity is not None else []
    if jumps:
        when, size = max(jumps, key=lambda jump: jump[1])
        add_caution(
            notes,
            f"{where}: the on-board position jumps by {size:.2g} m at {when - zero:.1f} s, which its velocity does not "
            f"({len(jumps)} such steps); look for a reset of the estimate",
        )

    def moved(track: Track | None, delay: float = 0.0) -> Track | None:
        return None if track is None else Track(track.t - zero - delay, track.values)

    others: dict[str, Track] = {}
    for name, one in series.items():
        if name.startswith("onboard"):
            for quantity, values in one.values.items():
                if quantity == "battery_voltage":  # without a sensor 0 is logged, or where it drops out
                    values = np.where(values > 0.0, values, np.nan)
                if quantity not in _KNOWN_COLUMNS and np.isfinite(values).any():
                    others.setdefault(quantity, Track(one.t - zero, values[:, None]))
    names = tuple(f"w{i}" for i in range(1, 9) if f"w{i}" in others)
    rotors = moved(_find(series, names)) if names else None
    if names and rotors is None:
        rotors = _together([others[name] for name in names])
    late_gyro, late_force = delays["gyro"]["value"], delays["accelerometer"]["value"]
    attitude = moved(attitude, late_gyro if source == "estimated on board" else 0.0)
    return Onboard(
        gyro=moved(gyro, late_gyro),
        force=moved(force, late_force),
        attitude=attitude,
        attitude_source=source,
        rest_seconds=rest,
        position=moved(position),
        velocity=moved(velocity),
        body_velocity=moved(body_velocity),
        others=others,
        rotors=rotors,
        delays=delays,
        zero=float(zero),
        made=sensors.made,
        # rotor telemetry may be as old as AGES, and filter delays move the gyro by less
        invalid=[
            {**span, "begin": span["begin"] - zero - AGES[-1], "end": span["end"] - zero - AGES[0]}
            for span in recording.metadata.get("invalid spans", [])
        ],
    )


def _damage(recording: Recording) -> str:
    spans = recording.metadata.get("corrupt spans") or []
    lost = sum(span["bytes"] for span in spans if "bytes" in span)
    return f" ({lost} bytes of the log are damaged)" if lost else ""


def _together(tracks: list[Track]) -> Track:
    """Rotors of several sources (n, rotors) at the times of the first, NaN where one has a gap or nothing."""
    at = tracks[0].t
    values = np.full((len(at), len(tracks)), np.nan)
    for i, track in enumerate(tracks):
        fine = np.isfinite(track.values[:, 0])
        t = track.t[fine]
        known = covered(t, at)
        values[known, i] = np.interp(at[known], t, track.values[fine, 0])
    return Track(at, values)


def _delays(recording: Recording) -> dict[str, Any]:
    """How late the controller's filters make gyro and accelerometer, s; a table comes as its columns are."""
    if (known := recording.metadata.get("filter delays")) is not None:
        return {quantity: dict(about) for quantity, about in known.items()}
    header = recording.metadata.get("header")
    delays = header_delays(header or {}, complete=not recording.metadata.get("header lines lost"))
    for quantity, about in delays.items():
        field_used = recording.metadata.get("units", {}).get(quantity, {}).get("field", "")
        if field_used.endswith("afterRpm"):
            # taken before the low-pass filters
            about |= {"value": 0.0, "filters": []}
        if header is None or (field_used.endswith("afterRpm") and not about["known"]):
            about |= {"std": 0.0, "known": True}
    return delays


def _report_unknown_delays(delays: dict[str, Any], recording: Recording, where: str, notes: list[str]) -> None:
    unknown = {quantity: about for quantity, about in delays.items() if not about["known"]}
    if unknown:
        add_caution(
            notes,
            f"{where}: the log does not say for sure how {' and '.join(unknown)} were filtered on board; the delay is "
            + " and ".join(f"{1e3 * about['value']:.3g} +- {1e3 * about['std']:.3g} ms" for about in unknown.values())
            + (
                ". Give the .bbl as the controller wrote it, or a CSV with its header, to have it taken off"
                if recording.metadata.get("format") in ("viewer export", "blackbox_decode")
                else ""
            ),
        )
