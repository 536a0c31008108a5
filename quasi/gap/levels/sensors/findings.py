"""Stated faults of a recording that are no cause with parameters: torn time stamps, vibration."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.signal import butter, sosfiltfilt

from quasi.gap.flights.evidence import GAP_SAMPLES
from quasi.gap.flights.level import Flown
from quasi.gap.flights.residual_tables import FAR_LAG
from quasi.gap.statistics.log_ratio import BY_EFFORT, LEAST_FLIGHTS, PRIOR_FLIGHTS, beyond_references, larger
from quasi.gap.statistics.memory import MEMORY_S, lagged_products

LOST_ON_BOARD = 0.0  # s a log may lose unmentioned
LOST_CAPTURE = 0.10  # share of a flight the capture may miss unmentioned
UNEVEN_INTERVALS = 0.15  # jitter of on-board intervals as a share of the interval
SHAKE_BAND = 30.0  # Hz, above any motion worth the name
NO_CAUSE = "sensor_error"  # of a channel that no cause explains
RATES = ("p", "q", "r")
MORE_MEMORY = 0.05  # largest p with which a larger share of the errors comes back than in the reference flights
SECONDS = 0.5  # s, of the pieces whose median is the flight's level
LOUD = 1.0  # m/s2 above which vibration is stated whatever other flights show
LOUDER_VIBRATION = 1.3  # times the reference flights'
VIBRATION_SPREAD = 0.15  # natural log, spread of the level between healthy flights


def torn(flown: Flown) -> list[dict[str, Any]]:
    """Gaps and uneven stamps of one compared flight's sources, from its import."""
    if not flown.compared:
        return []
    streams = flown.metadata.get("streams") or {}
    clauses, evidence = [], {}
    board = streams.get("gyro") or {}
    if board.get("gap count") and board.get("lost", 0.0) > LOST_ON_BOARD:
        first = f", the first at {board['gaps'][0][0]:.2f} s" if board.get("gaps") else ""
        count = board["gap count"]
        clauses.append(f"the on-board log lost {board['lost']:.2f} s in {count} gap{'s' * (count > 1)}{first}")
        evidence |= {"on-board gaps": count, "on-board lost": board["lost"]}
    interval = 1.0 / board["rate"] if board.get("rate") else 0.0
    if interval and board.get("jitter", 0.0) > UNEVEN_INTERVALS * interval:
        clauses.append(f"its stamps jitter by {1e3 * board['jitter']:.2f} ms at intervals of {1e3 * interval:.2f} ms")
        evidence["on-board jitter"] = board["jitter"]
    seen = streams.get("capture") or {}
    span = (seen.get("last") or 0.0) - (seen.get("first") or 0.0)
    if span > 0 and seen.get("lost", 0.0) > LOST_CAPTURE * span:
        clauses.append(f"the capture missed {seen['lost']:.1f} s of {span:.0f} s")
        evidence["capture lost"] = seen["lost"]
    if not clauses:
        return []
    return [{"id": "timestamp_fault", "text": f"flight {flown.key}: {'; '.join(clauses)}", "evidence": evidence}]


def level_of(flown: Flown) -> float:
    """Vibration of the accelerometer in flight above SHAKE_BAND, m/s2 rms over the axes; NaN where it is unknown.

    The median over pieces of SECONDS, so that a knock at landing is none.
    """
    frame = flown.imported
    if not {"ax", "ay", "az", "t"} <= set(frame):
        return float("nan")
    rate = 1.0 / float(np.median(np.diff(frame["t"].to_numpy(float))))
    if rate < 4.0 * SHAKE_BAND:
        return float("nan")
    force = np.nan_to_num(frame[["ax", "ay", "az"]].to_numpy(float))
    high = sosfiltfilt(butter(4, SHAKE_BAND, "high", fs=rate, output="sos"), force, axis=0)
    if "in_flight" in flown.filtered and len(flown.filtered) == len(frame):
        high = high[flown.filtered["in_flight"].to_numpy() > 0.5]
    size = round(SECONDS * rate)
    if len(high) < 4 * size:
        return float("nan")
    pieces = high[: len(high) // size * size].reshape(-1, size, 3)
    return float(np.sqrt(np.median((pieces**2).sum(axis=2).mean(axis=1))))


def shaken(flights: Sequence[Flown], alarm: float = 0.001) -> list[dict[str, Any]]:
    """Vibration of the compared flights: loud by itself, or louder than the reference flights by more than they vary.

    alarm  probability of a false finding. The level's logarithm is compared; its spread is at least VIBRATION_SPREAD.
    """
    levels = {True: [], False: []}
    for flown in flights:
        value = level_of(flown)
        if value > 0:
            levels[flown.compared].append(value)
    now, before = (np.array(levels[group]) for group in (True, False))
    if not len(now):
        return []
    typical = float(np.exp(np.mean(np.log(now))))
    evidence = {"level": typical, "unit": "m/s2", "above": SHAKE_BAND}
    if len(before):
        gain, p = larger(now, before, VIBRATION_SPREAD, PRIOR_FLIGHTS)
        if p < alarm and gain > np.log(LOUDER_VIBRATION):
            evidence |= {"times the reference flights": float(np.exp(gain)), "p": p}
            return [
                {
                    "id": "vibration",
                    "text": f"the accelerometer vibrates {np.exp(gain):.1f} times as much as in the reference flights "
                    f"({typical:.3f} m/s2 rms above {SHAKE_BAND:g} Hz)",
                    "evidence": evidence,
                }
            ]
    if typical > LOUD:
        return [
            {
                "id": "vibration",
                "text": f"the accelerometer vibrates with {typical:.2f} m/s2 rms above {SHAKE_BAND:g} Hz; its mean "
                "may be shifted by that",
                "evidence": evidence,
            }
        ]
    return []


def errors_beyond_references(
    flights: Sequence[Flown], residuals: pd.DataFrame, units: Mapping[str, str], alarm: float
) -> list[dict[str, Any]]:
    """Channels whose errors are larger than those of the reference flights, though all causes are taken off.

    residuals  table of the level; units  {channel: unit}; alarm  family-wise false alarm rate over the channels
    Noise does not come back between FAR_LAG and MEMORY_S. Where it alone grew, the share of the errors that comes back
    is no larger than before. Flights that were flown harder have larger errors: scaled down in proportion these must be
    larger as well.
    """
    groups = [[f for f in flights if f.compared is flag] for flag in (True, False)]
    if min(map(len, groups)) < LEAST_FLIGHTS:
        return []
    rows = dict(list(residuals.groupby("flight", sort=False)))
    found = []
    for channel, unit in units.items():
        powers = [np.array([_powers(rows[f.key], f"{channel}_after") for f in group]) for group in groups]
        effort = [np.array([_effort(f, channel) for f in group]) for group in groups]
        if min(values.min() for values in (*(p[:, 0] for p in powers), *effort)) <= 0.0:
            continue
        harder = np.maximum(effort[0] / np.exp(np.log(effort[1]).mean()), 1.0)
        gain, p, by_effort = beyond_references(powers[0][:, 0], powers[1][:, 0], harder)
        remembered = larger(*(values[:, 1] / values[:, 0] for values in powers))[1]
        if p < alarm / len(units) and by_effort < BY_EFFORT and remembered < MORE_MEMORY:
            times, size = float(np.exp(0.5 * gain)), float(np.sqrt(powers[0][:, 0].mean() - powers[1][:, 0].mean()))
            found.append({
                "id": NO_CAUSE,
                "text": f"{channel} of IMU and capture differ by {size:.2g} {unit} rms beyond the reference flights "
                f"({times:.1f} times as much), and no cause explains it",
                "evidence": {"channel": channel, "size": size, "p": p, "times the reference flights": times},
            })  # fmt: skip
    return found


def _powers(rows: pd.DataFrame, column: str) -> tuple[float, float]:
    """Mean square of an error about its mean, and what of it comes back between FAR_LAG and MEMORY_S."""
    t, values = rows["t"].to_numpy(), rows[[column]].to_numpy()
    step = float(np.median(np.diff(t))) if len(t) > 1 else FAR_LAG
    breaks = np.concatenate([[True], np.diff(t) > GAP_SAMPLES * step])
    products = lagged_products(values, breaks, max(round(FAR_LAG / step), 1), round(MEMORY_S / step) + 1)
    return float(np.var(values)), float(np.abs(products).max()) / len(values)


def _effort(flown: Flown, channel: str) -> float:
    """Mean square of what the channel's sensor reads in flight, about its mean."""
    names = [n for n in (RATES if channel in RATES else ("ax", "ay", "az")) if n in flown.filtered]
    frame = flown.filtered[names]
    if "in_flight" in flown.filtered:
        frame = frame[flown.filtered["in_flight"] > 0.5]
    return float(np.nansum(np.nanvar(frame.to_numpy(float), axis=0))) if len(frame) and names else 0.0
