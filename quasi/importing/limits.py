"""Spans in which the gyro or the accelerometer sits at the end of its range, from the log's own samples."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from quasi.importing.onboard_log import Onboard
from quasi.sensor_limits import find_clipping

CHANNELS = {"gyro": ("p", "q", "r"), "accelerometer": ("ax", "ay", "az")}
CLIPPING_UNITS = {"gyro": ("rad/s", np.degrees(1.0), "deg/s"), "accelerometer": ("m/s2", 1.0 / 9.81, "g")}
SPOILED_STEPS = 2  # grid steps on either side that a clipped sample spoils, by the filters of the resampling
LONGEST_JOINED_TOP = 0.05  # s, flat tops nearer than this count as one
MOST_CLIPPED_LISTED = 20


class End(NamedTuple):
    """One end of one channel at which it is clipped: times t (n,), s, on the on-board clock, of the samples there."""

    sensor: str
    channel: str
    level: float
    full_scale: float | None
    t: np.ndarray
    interval: float


def clipped_ends(board: Onboard, units: Mapping[str, Any]) -> list[End]:
    """The ends at which gyro and accelerometer are clipped.

    units  of the log: "gyro" and "accelerometer" with their "factor", the step of a logged number
    """
    found = []
    for sensor, track in (("gyro", board.gyro), ("accelerometer", board.force)):
        if sensor in board.made:
            continue  # no sensor, no range
        step = abs(float((units.get(sensor) or {}).get("factor") or 0.0))
        interval = float(np.median(np.diff(track.t)))
        for channel, values in zip(CHANNELS[sensor], track.values.T):
            for end in find_clipping(values, sensor, step):
                found.append(End(sensor, channel, end.level, end.full_scale, track.t[end.where], interval))
    return found


def spoiled(ends: list[End], at: np.ndarray) -> np.ndarray:
    """True (m,) at the grid's times at (m,), s, on the on-board clock, that a clipped sample reaches."""
    half = (SPOILED_STEPS + 0.5) * float(at[1] - at[0])
    inside = np.zeros(len(at) + 1, np.int64)
    for end in ends:
        for places, sign in ((np.searchsorted(at, end.t - half), 1), (np.searchsorted(at, end.t + half), -1)):
            inside += sign * np.bincount(places, minlength=len(at) + 1)
    return np.cumsum(inside)[: len(at)] > 0


def facts(ends: list[End], at: np.ndarray, where: str, notes: list[str]) -> dict[str, Any]:
    """What is clipped within the grid's times at (m,), by channel and end ("p +"); notes gets a sentence for each.

    Each has its level, full scale (None where it is not a usual one), samples, seconds, span count and spans (s since
    the grid's beginning, the first MOST_CLIPPED_LISTED).
    """
    result: dict[str, Any] = {}
    for end in ends:
        unit, scale, familiar = CLIPPING_UNITS[end.sensor]
        t = end.t[(end.t >= at[0]) & (end.t <= at[-1])] - at[0]
        if not len(t):
            continue
        cut = np.flatnonzero(np.diff(t) > LONGEST_JOINED_TOP)
        begin, finish = t[np.concatenate([[0], cut + 1])], t[np.concatenate([cut, [-1]])]
        seconds = len(t) * end.interval
        result[f"{end.channel} {'+' if end.level > 0 else '-'}"] = {
            "level": {"value": end.level, "unit": unit},
            "full scale": None if end.full_scale is None else {"value": end.full_scale, "unit": unit},
            "samples": len(t),
            "seconds": seconds,
            "span count": len(begin),
            "spans": np.stack([begin, finish], axis=1)[:MOST_CLIPPED_LISTED].tolist(),
        }
        known = f", its full scale of {end.full_scale * scale:.0f} {familiar}," if end.full_scale else ""
        places = ", ".join(f"{a:.2f} to {b:.2f} s" for a, b in zip(begin[:3], finish[:3]))
        notes.append(
            f"{where}: {end.sensor} channel '{end.channel}' is clipped at {end.level * scale:.4g} {familiar}{known} "
            f"for {seconds:.3g} s (at {places}{' and later' if len(begin) > 3 else ''}); what lies beyond was never "
            "measured: set the sensor to a greater range, or fly more gently"
        )
    return result


def describe_clipping(facts: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Reasons for care, in words, of the result of `facts`: one for each sensor that was clipped."""
    reasons = []
    for sensor, names in CHANNELS.items():
        found = {key: one for key, one in facts.items() if key.split(" ")[0] in names}
        if found:
            seconds = sum(one["seconds"] for one in found.values())
            axes = ", ".join(dict.fromkeys(key.split(" ")[0] for key in found))
            reasons.append(f"the {sensor} ({axes}) was clipped at the end of its range for {seconds:.2g} s")
    return reasons
