"""Betaflight and INDIflight blackbox files (.bbl, .bfl): which logs they hold, and one of them as a Recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from quasi.errors import ReadError, add_caution
from quasi.importing.readers import blackbox_kernel as kernel
from quasi.importing.readers.blackbox_header import Log, find_logs, hex_float, plain_header
from quasi.importing.readers.blackbox_units import WANTED, debug_mode, other_firmware_note, resolve
from quasi.importing.readers.external import external_series
from quasi.importing.series import Recording, Series
from quasi.project.recognition import refuse_other_formats
from quasi.tables import read_bytes

MOST_SPANS = 2000
MOST_EVENTS = 2000
MOST_CHANGES = 2000
CHOOSE = " (another: 'Log number' in the logbook, `--log-number` of `quasi noise`)"
BLACKBOX_GAP = 1.5  # times the usual step: a longer one is a gap
EVENT_NAMES = {
    0: "beep",
    13: "adjustment",
    14: "logging resumed",
    15: "disarmed",
    30: "flight mode",
    40: "IMU failure",
    255: "end of log",
}


@dataclass(frozen=True)
class Frames:
    """The frames of one log, as logged.

    time     (n,) us since the controller's start, int64, rollovers undone
    values   {main field: (n,) float64}, whole numbers as logged
    counts   good frames per kind, and what was dropped
    spans    (m, 4) int64: first damaged byte, byte behind, time before, time of the next good frame (-1 = none)
    events   (m, 4) int64: code, time, and its two numbers
    slow     (changes, fields) of the S frames that differ from the one before, with slow_time
    ended    the log closes with its end-of-log event
    """

    time: np.ndarray
    values: dict[str, np.ndarray]
    counts: dict[str, int]
    spans: np.ndarray
    events: np.ndarray
    slow: np.ndarray
    slow_time: np.ndarray
    ended: bool


def decode(data: bytes, log: Log, fields: set[str] | None = None) -> Frames:
    """Decode one log; `fields` limits the main fields that are stored (None = all). The log must be without fault."""
    layout, sizes, header = log.layout, log.sizes, log.header
    names = log.names["I"]
    keep = [i for i, name in enumerate(names) if fields is None or name in fields]
    size = log.end - log.data
    capacity = size // log.shortest + 1
    if 8 * len(keep) * capacity > 16 * size + 100_000:
        # fields that take no bytes make the upper bound useless: count first
        capacity = len(decode(data, log, set()).time) + 2
    # otherwise untouched pages of the upper bound cost no memory
    main, time = np.empty((len(keep), capacity)), np.empty(capacity, np.int64)
    slow = np.zeros((MOST_CHANGES, max(1, sizes[2])), np.int64)
    slow_time = np.zeros(MOST_CHANGES, np.int64)
    spans, events = np.zeros((MOST_SPANS, 4), np.int64), np.zeros((MOST_EVENTS, 4), np.int64)
    constants = np.zeros(4, np.int64)
    constants[kernel.MIN_THROTTLE] = _whole(header.get("minthrottle"))
    constants[kernel.BATTERY_REFERENCE] = _whole(header.get("vbatref"))
    constants[kernel.MIN_MOTOR] = _whole(header.get("motorOutput", "").split(",")[0])
    clock = np.array([names.index("time"), names.index("loopIteration") if "loopIteration" in names else -1])
    tally = kernel.decode_frames(
        np.frombuffer(data, np.uint8),
        log.data,
        log.end,
        layout,
        sizes,
        clock,
        constants,
        log.skips,
        np.array(keep, np.int64),
        main,
        time,
        slow,
        slow_time,
        spans,
        events,
    )
    n = int(tally[kernel.MAIN])
    counts = {letter: int(tally[k]) for k, letter in enumerate(kernel.FRAME_KINDS)}
    counts["P after damage"] = int(tally[kernel.DROPPED_P])
    counts["rejected"] = int(tally[kernel.REJECTED])
    counts["unknown events"] = int(tally[kernel.UNKNOWN_EVENTS])
    return Frames(
        time=time[:n],
        values={names[i]: main[k, :n] for k, i in enumerate(keep)},
        counts=counts,
        spans=spans[: tally[kernel.SPANS]],
        events=events[: tally[kernel.EVENTS]],
        slow=slow[: tally[kernel.SLOW]],
        slow_time=slow_time[: tally[kernel.SLOW]],
        ended=bool(tally[kernel.ENDED]),
    )


def _whole(text: str | None) -> int:
    number = hex_float(text or None)
    return int(number) if number is not None and abs(number) < 2**31 else 0


def _longest(about: list[dict[str, Any]]) -> int:
    return max(about, key=lambda one: (one["duration"], one["frames"], -one["number"]))["number"]


def _about_log(data: bytes, log: Log, frames: Frames | None = None) -> dict[str, Any]:
    count, duration = 0, 0.0
    if not log.fault:
        frames = frames if frames is not None else decode(data, log, set())
        count = len(frames.time)
        duration = float(frames.time[-1] - frames.time[0]) * 1e-6 if count else 0.0
    return {
        "number": log.number,
        "duration": duration,
        "frames": count,
        "bytes": log.end - log.start,
        "firmware": log.header.get("Firmware revision", ""),
        "fault": log.fault,
    }


def _choose(data: bytes, path: str, log_number: int | None) -> tuple[Log, Frames, list[dict[str, Any]]]:
    """The log asked for, or the longest; decoded, with the list of all."""
    logs = find_logs(data, path)
    if log_number is not None and not 1 <= log_number <= len(logs):
        raise ReadError(
            f"{path} holds {len(logs)} logs, but log number {log_number} is asked for; choose 1 to {len(logs)}"
        )
    if len(logs) == 1:
        log = logs[0]
        frames = None if log.fault else decode(data, log, WANTED)
        about = [_about_log(data, log, frames)]
    else:
        about = [_about_log(data, log) for log in logs]
        number = log_number or _longest(about)
        log = logs[number - 1]
        frames = None if log.fault or not about[number - 1]["frames"] else decode(data, log, WANTED)
    if log.fault:
        raise ReadError(f"{path}, log {log.number}, cannot be decoded: {log.fault}; copy it from the controller again")
    if frames is None or not len(frames.time):
        if log_number is None and len(logs) > 1:
            raise ReadError(f"{path} holds {len(logs)} logs, none with a readable frame; it was written without flying")
        raise ReadError(f"{path}, log {log.number}, holds a header but no readable frame; choose another log or file")
    return log, frames, about


def read_blackbox(path: str | Path, log_number: int | None = None, poles: int | None = None) -> Recording:
    """Read one log of a blackbox file as the series "onboard".

    log_number  1-based place in the file; None takes the longest
    poles       number of motor magnets from the quadrotor configuration; None takes the header's, else 14

    Quantities, as far as logged: p q r, ax ay az, w1.., command1.., setpoint_p/q/r, throttle, battery_voltage,
    battery_current, qw qx qy qz, x y z, vx vy vz; the captured motion that INDIflight was sent is the series "capture".
    Time is the controller's own clock, s. Damage is skipped and stands in the metadata.
    Raises ReadError when there is nothing to read.
    """
    path = str(path)
    data = read_bytes(path)
    refuse_other_formats(path, data, ("blackbox",), "a blackbox log (.bbl, .bfl)")
    log, frames, logs = _choose(data, path, log_number)
    notes: list[str] = []
    raw, time = frames.values, frames.time
    fresh = np.append(True, np.diff(time) > 0)
    if not fresh.all():
        notes.append(f"{int((~fresh).sum())} frames repeat the time of the frame before and were dropped")
        raw, time = {name: values[fresh] for name, values in raw.items()}, time[fresh]
    t = time * 1e-6
    mode = debug_mode(log.header)
    if mode is None or mode["name"] != "DSHOT_RPM_TELEMETRY":
        raw = {name: values for name, values in raw.items() if not name.startswith("debug[")}
    if other := other_firmware_note(log.header):
        add_caution(notes, other)
    for line in sorted(set(log.absent.values())):
        left_out = [name for name, of in log.absent.items() if of == line and name in raw]
        if left_out:
            add_caution(
                notes,
                f"the header line '{line}' is absent, from which {', '.join(left_out)} are predicted; they were left "
                "out. Copy the log from the controller again if its header was cut",
            )
    raw = {name: values for name, values in raw.items() if name not in log.absent}
    resolved = resolve(raw, log.header, poles)
    spans, gaps, lost_notes = _losses(frames, t, log)
    metadata = {
        "reader": "blackbox",
        "path": path,
        "log": log.number,
        "logs": logs,
        "firmware": {
            "type": log.header.get("Firmware type", ""),
            "revision": log.header.get("Firmware revision", ""),
            "date": log.header.get("Firmware date", ""),
            "board": log.header.get("Board information", ""),
            "craft": log.header.get("Craft name", ""),
        },
        "header": plain_header(log.header),
        "header lines lost": log.damage,
        "fields": log.names["I"],
        "frames": frames.counts,
        "start": float(t[0]),
        "duration": float(t[-1] - t[0]),
        "rate": float(1.0 / np.median(np.diff(t))) if len(t) > 1 else None,
        "corrupt spans": spans,
        "time gaps": gaps,
        "ended": frames.ended,
        "events": _events(frames),
        "flight modes": _flight_modes(frames, log),
        **resolved.about,
    }
    series = {"onboard": Series(t=t, values=resolved.values)}
    series |= external_series(t, resolved.external, metadata, notes)
    notes = [*lost_notes, *notes, *log.notes, *resolved.notes]
    if log_number is None and len(logs) > 1:
        notes.append(f"the file holds {len(logs)} logs; the longest, number {log.number}, was taken{CHOOSE}")
    return Recording(series=series, metadata=metadata, notes=notes)


def _losses(frames: Frames, t: np.ndarray, log: Log) -> tuple[list[dict], list[dict], list[str]]:
    """Corrupt spans, time gaps and the sentences about them."""
    first, final = float(t[0]), float(t[-1])
    spans = [
        {
            "start": before * 1e-6 if before >= 0 else first,
            "end": after * 1e-6 if after >= 0 else final,
            "bytes": int(stop - start),
            "offset": int(start),
        }
        for start, stop, before, after in frames.spans.tolist()
    ]
    notes = []
    if spans:
        lost = sum(span["end"] - span["start"] for span in spans)
        notes.append(
            f"{len(spans)} damaged stretches of {sum(span['bytes'] for span in spans)} bytes were skipped; "
            f"{lost:.3f} s of {final - first:.3f} s are lost, first at {spans[0]['start']:.3f} s"
        )
    if not frames.ended:
        notes.append("the log has no end-of-log event: power was cut in flight, or the file is cut short")
    if log.damage:
        add_caution(notes, f"{log.damage} header lines are unreadable; what they set is taken as unknown")
    if frames.counts["unknown events"]:
        notes.append(f"{frames.counts['unknown events']} events of unknown kind were skipped")
    resumed = frames.events[frames.events[:, 0] == 14, 3] * 1e-6
    gaps = time_gaps(t, spans, resumed)
    if gaps:
        notes.append(gaps_note(gaps))
    return spans, gaps, notes


def time_gaps(t: np.ndarray, spans: list[dict], resumed: np.ndarray) -> list[dict[str, Any]]:
    """Steps of t (n,) longer than 1.5 usual ones: start and end (s) and cause.

    spans    damaged stretches with start and end (s); resumed  times (s) at which logging went on after a pause
    """
    step = np.diff(t)
    if not len(step):
        return []
    places = np.flatnonzero(step > BLACKBOX_GAP * np.median(step))
    starts, ends = t[places], t[places + 1]
    causes = np.full(len(places), "not logged", object)
    paused = np.searchsorted(np.sort(resumed), ends, "right") > np.searchsorted(np.sort(resumed), starts, "right")
    causes[paused] = "logging paused"
    for span in spans:
        causes[(starts < span["end"]) & (ends > span["start"])] = "damage"
    return [
        {"start": float(start), "end": float(end), "cause": str(cause)}
        for start, end, cause in zip(starts, ends, causes)
    ]


def gaps_note(gaps: list[dict[str, Any]]) -> str:
    """One sentence about the gaps of `time_gaps`."""
    longest = max(gaps, key=lambda gap: gap["end"] - gap["start"])
    length = longest["end"] - longest["start"]
    return f"{len(gaps)} gaps in time, the longest {length:.4f} s at {longest['start']:.3f} s ({longest['cause']})"


def _events(frames: Frames) -> list[dict[str, Any]]:
    return [
        {
            "time": time * 1e-6 if time >= 0 else None,
            "event": EVENT_NAMES.get(code, f"unknown {code}"),
            "numbers": [a, b],
        }
        for code, time, a, b in frames.events.tolist()
    ]


def _flight_modes(frames: Frames, log: Log) -> list[dict[str, Any]]:
    """Changes of the S frames' flightModeFlags: time (s, None before the first main frame) and the raw flags."""
    names = log.names.get("S", [])
    if "flightModeFlags" not in names or not len(frames.slow):
        return []
    flags = frames.slow[:, names.index("flightModeFlags")]
    changed = np.flatnonzero(np.append(True, np.diff(flags) != 0))
    return [
        {"time": float(frames.slow_time[i]) * 1e-6 if frames.slow_time[i] >= 0 else None, "flags": int(flags[i])}
        for i in changed
    ]
