"""A log and a capture of one flight, tied without a project: lag, clock rate, lever arm and yaw."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from quasi.attitude import body_rates, continuous, interpolate, to_euler
from quasi.importing.clocks.synchronisation import Motion, Synchronisation, synchronise
from quasi.importing.lever_arm_fit import ArmFit, fit_arm
from quasi.importing.onboard_log import POSITION_COLUMNS, QUATERNION, gather, read_onboard
from quasi.importing.readers.reader import Request
from quasi.importing.readers.registry import controller_of, read_capture

SCHEMA = "quasi.sync/1"
USING = ("pitch", "yaw")  # the signals of 'align with optitrack using' where a project says nothing
LONGEST_LAG = 25.0  # s, that of 'max permitted lag for optitrack' where a project says nothing
YAW_BLOCK = 5.0  # s, over which the yaw difference is averaged before its spread is taken
LEAST_SYNC_BLOCKS = 3
DRAWN_WINDOW = 8.0  # s drawn, those that turn most


@dataclass(frozen=True)
class Yaw:
    """What to add to the on-board yaw, rad, at on-board time `reference` s; drift rad/s; standard errors or NaN."""

    offset: float
    offset_std: float
    drift: float
    drift_std: float
    reference: float


@dataclass(frozen=True)
class Alignment:
    """A log and a capture on one clock."""

    log: str
    capture: str
    onboard: Motion
    seen: Motion
    clocks: Synchronisation
    arm: ArmFit | None
    yaw: Yaw | None
    notes: tuple[str, ...]


def align_files(
    log: Path,
    capture: Path,
    quadrotor: Mapping[str, Any] | None = None,
    rigid_body: str | None = None,
    log_number: int | None = None,
    longest_lag: float = LONGEST_LAG,
) -> Alignment:
    """Tie the clock of a capture to that of a log.

    quadrotor   its configuration, needed for tables ("table columns")
    rigid_body  its name in the capture; None takes the only one
    log_number  which log of a file that holds several; longest_lag  s, between the beginnings of both records
    Raises ReadError, DataError or ConfigError: a sentence that names the file and the remedy.
    """
    settings, notes = dict(quadrotor or {}), []
    flight = {
        "onboard": str(log),
        "flight controller": controller_of(log, settings),
        "log number": log_number,
    }
    recording = read_onboard(flight, settings)
    board = gather(recording, log.name, notes)
    captured = read_capture(Request(capture, rigid_body=rigid_body))
    series = captured.series["capture"]
    seen = Motion(series.t, quaternion=series.matrix(QUATERNION), position=series.matrix(POSITION_COLUMNS))
    onboard = board.motion()
    clocks = synchronise(onboard, seen, USING, longest_lag, log.name)
    all_notes = (*captured.notes, *recording.notes, *clocks.notes, *notes)
    return Alignment(
        str(log), str(capture), onboard, seen, clocks, fit_arm(onboard, seen, clocks),
        yaw_difference(onboard, seen, clocks), all_notes,
    )  # fmt: skip


def yaw_difference(onboard: Motion, capture: Motion, clocks: Synchronisation) -> Yaw | None:
    """Captured less on-board yaw as a line over time, by means of blocks; None without both attitudes.

    The standard errors come from the spread of the blocks about the line: within a block the difference is correlated.
    """
    found = yaw_samples(onboard, capture, clocks)
    if found is None:
        return None
    t, difference = found
    block = np.floor((t - t[0]) / YAW_BLOCK).astype(int)
    labels = np.unique(block)
    times = np.array([t[block == b].mean() for b in labels])
    means = np.array([difference[block == b].mean() for b in labels])
    reference = float(times.mean())
    if len(labels) < LEAST_SYNC_BLOCKS:
        return Yaw(_wrapped(float(means.mean())), math.nan, 0.0, math.nan, reference)
    slope, offset = np.polyfit(times - reference, means, 1)
    variance = float(np.sum((means - offset - slope * (times - reference)) ** 2)) / (len(labels) - 2)
    spread = float(np.sum((times - reference) ** 2))
    return Yaw(
        _wrapped(float(offset)), math.sqrt(variance / len(labels)), float(slope), math.sqrt(variance / spread),
        reference,
    )  # fmt: skip


def yaw_samples(onboard: Motion, capture: Motion, clocks: Synchronisation) -> tuple[np.ndarray, np.ndarray] | None:
    """On-board times (n,), s, and captured less on-board yaw (n,), rad, unwrapped, where neither is near upright."""
    if capture.quaternion is None or onboard.quaternion is None:
        return None
    fine = np.isfinite(capture.quaternion).all(axis=1)
    t = clocks.to_onboard(capture.t[fine])
    inside = (t >= onboard.t[0]) & (t <= onboard.t[-1])
    captured = to_euler(capture.quaternion[fine][inside])
    sensed = to_euler(interpolate(onboard.quaternion, onboard.t, t[inside]))
    level = (np.abs(captured[:, :2]) < 1.2).all(axis=1)  # rad: beyond, yaw and roll turn about nearly the same axis
    if np.count_nonzero(level) < 10:
        return None
    return t[inside][level], np.unwrap((captured - sensed)[level, 2])


def alignment_plain(found: Alignment) -> dict[str, Any]:
    """What was found as plain data ("quasi.sync/1"); what could not be estimated is null."""
    fit, arm, yaw = found.clocks.fit, found.arm, found.yaw

    def value(number: float, std: float, unit: str) -> dict[str, Any]:
        return {"value": float(number), "std": float(std) if math.isfinite(std) and std > 0.0 else None, "unit": unit}

    return {
        "schema": SCHEMA,
        "log": found.log,
        "capture": found.capture,
        "lag": value(fit.lag, fit.lag_std, "s") | {"at capture time": float(fit.reference)},
        "clock rate": value(fit.rate, fit.rate_std, "s/s"),
        "lever arm": None if arm is None else {
            "value": arm.position.tolist(), "std": arm.std.tolist(), "unit": "m", "explained": arm.explained
        },
        "yaw": None if yaw is None else value(yaw.offset, yaw.offset_std, "rad")
        | {"at on-board time": yaw.reference, "drift": value(yaw.drift, yaw.drift_std, "rad/s")},
        "explained": float(fit.explained),
        "common span": {"value": float(fit.seconds), "unit": "s"},
        "notes": list(found.notes),
    }  # fmt: skip


def alignment_text(found: Alignment) -> str:
    """What was found, as text."""
    fit, arm, yaw = found.clocks.fit, found.arm, found.yaw
    lines = [
        f"{Path(found.log).name} and {Path(found.capture).name}: {fit.seconds:.1f} s in common, the signals explain "
        f"{100 * fit.explained:.0f} % of each other",
        f"{'lag':<12}{fit.lag:+.5f} s  ± {1e3 * fit.lag_std:.2f} ms   on-board time less capture time, at capture time "
        f"{fit.reference:.2f} s",
    ]
    rate = f"{1e6 * fit.rate:+.1f} ppm  ± {1e6 * fit.rate_std:.1f}" if fit.rate_std else "not estimated: too short"
    lines.append(f"{'clock rate':<12}{rate}   positive: the on-board clock runs fast")
    if arm is None:
        lines.append(f"{'lever arm':<12}not estimated: it takes a captured attitude and 10 s in common")
    else:
        place = ", ".join(f"{a} {1e3 * v:+.1f} ± {1e3 * s:.1f}" for a, v, s in zip("xyz", arm.position, arm.std))
        lines.append(f"{'lever arm':<12}{place} mm   IMU from the captured point; x forward, y right, z down")
    if yaw is None:
        turn = f"{math.degrees(found.clocks.yaw_offset):+.2f} deg, standard error unknown (no captured attitude)"
        lines.append(f"{'yaw':<12}{turn}   to be added to the on-board yaw")
    else:
        spread = f"± {math.degrees(yaw.offset_std):.2f}" if math.isfinite(yaw.offset_std) else "standard error unknown"
        lines.append(
            f"{'yaw':<12}{math.degrees(yaw.offset):+.2f} deg  {spread}   to be added to the on-board yaw, at "
            f"{yaw.reference:.1f} s"
        )
        if math.isfinite(yaw.drift_std):
            drift, error = 60.0 * math.degrees(yaw.drift), 60.0 * math.degrees(yaw.drift_std)
            lines.append(f"{'yaw drift':<12}{drift:+.2f} deg/min  ± {error:.2f}")
    return "\n".join([*lines, *(f"note: {note}" for note in found.notes)])


def alignment_picture(found: Alignment) -> Figure:
    """Body rates of both sides where they turn most, and the yaw difference over the flight."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots(4, 1)
    onboard, capture, clocks = found.onboard, found.seen, found.clocks
    begin, end = _window(onboard, clocks.to_onboard(capture.t))
    fine = np.isfinite(capture.quaternion).all(axis=1) if capture.quaternion is not None else None
    rates = None
    if fine is not None:
        t_cap = capture.t[fine]
        rates = body_rates(continuous(capture.quaternion[fine]), t_cap)
    for k, name in enumerate(("roll rate p", "pitch rate q", "yaw rate r")):
        inside = (onboard.t >= begin) & (onboard.t <= end)
        axes[k].plot(onboard.t[inside], onboard.rates[inside, k], color="tab:blue", linewidth=0.9, label="on board")
        if rates is not None:
            for times, colour, label in (
                (clocks.to_onboard(t_cap) - clocks.moved, "0.7", "capture, records side by side"),
                (clocks.to_onboard(t_cap), "tab:red", "capture, aligned"),
            ):
                part = (times >= begin) & (times <= end)
                axes[k].plot(times[part], rates[part, k], color=colour, linewidth=0.9, label=label)
        axes[k].set_ylabel(f"{name}, rad/s")
        axes[k].set_xlim(begin, end)
        axes[k].grid(alpha=0.3)
    axes[0].legend(loc="upper right", fontsize="small", ncols=3)
    samples = yaw_samples(onboard, capture, clocks)
    if samples is not None and found.yaw is not None:
        t, difference = samples
        shift = 2.0 * math.pi * round((found.yaw.offset - float(np.median(difference))) / (2.0 * math.pi))
        thin = slice(None, None, max(1, len(t) // 4000))
        axes[3].plot(t[thin], np.degrees(difference[thin] + shift), ".", markersize=2, color="tab:red")
        line = found.yaw.offset + found.yaw.drift * (t - found.yaw.reference)
        axes[3].plot(t[thin], np.degrees(line[thin]), color="k", linewidth=1.0)
    axes[3].set_ylabel("yaw difference, deg")
    axes[3].set_xlabel("on-board time, s")
    axes[3].grid(alpha=0.3)
    fit = clocks.fit
    figure.suptitle(
        f"{Path(found.log).name}, {Path(found.capture).name}: lag {fit.lag:+.5f} s ± {1e3 * fit.lag_std:.2f} ms",
        x=0.01,
        ha="left",
    )
    return figure


def _window(onboard: Motion, seen: np.ndarray) -> tuple[float, float]:
    """Begin and end, s, of the DRAWN_WINDOW in the common span that turns most."""
    low, high = max(onboard.t[0], seen[0]), min(onboard.t[-1], seen[-1])
    starts = np.arange(low, max(high - DRAWN_WINDOW, low) + 1e-9, 1.0)
    power = np.concatenate([[0.0], np.cumsum(np.nan_to_num(np.sum(onboard.rates**2, axis=1)))])
    sums = [power[np.searchsorted(onboard.t, s + DRAWN_WINDOW)] - power[np.searchsorted(onboard.t, s)] for s in starts]
    begin = float(starts[int(np.argmax(sums))])
    return begin, min(begin + DRAWN_WINDOW, high)


def _wrapped(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)
