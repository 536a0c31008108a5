"""Where residuals live: beside the state they were found in, and over frequency."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.signal import welch

from quasi.gap.level import Flown
from quasi.gap.whitening import stretches

SEGMENT = 4.0  # s, of a spectrum: its resolution is a quarter of a hertz


def beside(flown: Flown, t: np.ndarray) -> dict[str, np.ndarray]:
    """Speed over ground (m/s), height (m), heading (rad) and battery voltage (V) at times t (n,), as far as known."""
    frame = flown.filtered if {"t", "u", "v", "w", "z", "yaw"} <= set(flown.filtered) else flown.imported
    at = frame["t"].to_numpy(float)
    found: dict[str, np.ndarray] = {}
    if {"u", "v", "w"} <= set(frame):
        found["speed"] = np.interp(t, at, np.linalg.norm(frame[["u", "v", "w"]].to_numpy(float), axis=1))
    if "z" in frame:
        found["height"] = np.interp(t, at, -frame["z"].to_numpy(float))
    if "yaw" in frame:
        yaw = np.unwrap(np.nan_to_num(frame["yaw"].to_numpy(float)))
        found["heading"] = np.angle(np.exp(1j * np.interp(t, at, yaw)))
    if "battery_voltage" in frame:
        found["voltage"] = np.interp(t, at, frame["battery_voltage"].to_numpy(float))
    return found


def spectra(tables: Sequence[pd.DataFrame], breaks: Sequence[np.ndarray], rate: float) -> pd.DataFrame:
    """Power densities of all columns named <channel>_<what>, over all stretches without gaps.

    tables  one per flight, sampled at `rate` Hz; breaks (n,) bool, True where a stretch begins
    Returns frequency (Hz), channel, and one column for each <what>, in squared units per Hz; empty where every stretch
            is shorter than SEGMENT. Source: Welch, IEEE Trans. Audio Electroacoustics 15, 1967.
    """
    length = round(SEGMENT * rate)
    names = [c for c in tables[0] if c.endswith(("_before", "_after", "_floor"))]
    total: dict[str, np.ndarray] = {}
    weight, frequency = 0.0, None
    for table, begins in zip(tables, breaks):
        for part in stretches(begins):
            if part.stop - part.start < length:
                continue
            frequency, power = welch(table[names].to_numpy()[part], rate, nperseg=length, axis=0, detrend="constant")
            share = float(part.stop - part.start)
            weight += share
            for i, name in enumerate(names):
                total[name] = total.get(name, 0.0) + share * power[:, i]
    if frequency is None:
        return pd.DataFrame(columns=["frequency", "channel"])
    rows = []
    for channel in dict.fromkeys(n.rsplit("_", 1)[0] for n in names):
        columns = {n.rsplit("_", 1)[1]: total[n] / weight for n in names if n.rsplit("_", 1)[0] == channel}
        rows.append(pd.DataFrame({"frequency": frequency, "channel": channel, **columns}))
    return pd.concat(rows, ignore_index=True)
