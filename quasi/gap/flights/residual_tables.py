"""Residuals by the state of flight in which they occur, and by frequency."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import welch

from quasi.gap.flights.covariates import HEADING, UNITS_AT, along
from quasi.gap.flights.evidence import induced_in_hover
from quasi.gap.flights.level import Flown
from quasi.gap.statistics.whitening import stretches

WHERE = ("t", "speed", "height", "heading", "room_x", "room_y", "volts", "rotor_speed", "descent_ratio")
BINS = 8  # along a place
LEAST_BIN_ROWS = 20  # rows of a bin
# s: filters and averages of no level remember as long (the windows of sensors are 0.4 s), so that white noise shows
# nothing, and the rates of all levels hold whole steps of it
FAR_LAG = 0.4
SEGMENT = 4.0  # s, of a spectrum: its resolution is a quarter of a hertz


class Residuals(NamedTuple):
    """Residuals of one flight: series {word: (n, C)}, t (n,) s, breaks (n,) bool, True where a stretch begins."""

    series: Mapping[str, np.ndarray]
    t: np.ndarray
    breaks: np.ndarray


def level_tables(
    flights: Sequence[Flown], residuals: Sequence[Residuals], units: Mapping[str, str], parameters: pd.DataFrame
) -> tuple[dict[str, pd.DataFrame], dict[str, float]]:
    """Tables "residuals" (rows), "channels" (rms, whiteness), "where", "parameters", "spectra"; rms of "floor".

    units  of the channels, in the order of the residuals' columns; parameters  of the flights
    """
    rows, channels = [], []
    for flown, one in zip(flights, residuals):
        memory = whiteness(*one)
        table = pd.DataFrame({"t": one.t, "flight": flown.key, **places_at(flown, one.t)})
        for c, (channel, unit) in enumerate(units.items()):
            rms = {word: float(np.sqrt(np.mean(values[:, c] ** 2))) for word, values in one.series.items()}
            for word, values in one.series.items():
                table[f"{channel}_{word}"] = values[:, c]
            channels.append(
                {"flight": flown.key, "compared": flown.compared, "channel": channel, "unit": unit, **rms, **memory[c]}
            )
        rows.append(table)
    whole = pd.concat(rows, ignore_index=True)
    compared = whole[whole["flight"].isin([f.key for f in flights if f.compared])]
    floor = np.sqrt(np.mean([(one.series["floor"] ** 2).mean(axis=0) for one in residuals], axis=0))
    found = {
        "residuals": whole,
        "channels": pd.DataFrame(channels),
        "where": where(compared, units, list(residuals[0].series)),
        "parameters": parameters,
        "spectra": spectra(rows, [one.breaks for one in residuals]),
    }
    return found, dict(zip(units, map(float, floor)))


def places_at(flown: Flown, t: np.ndarray) -> dict[str, np.ndarray]:
    """Where a flight is at times t (n,), as far as it knows, see `located`."""
    frame = flown.filtered if {"t", "u", "v", "w", "z", "yaw"} <= set(flown.filtered) else flown.imported
    hover = induced_in_hover(flown.airframe.mass, flown.airframe.radius)
    return located(along(frame, hover), frame["t"].to_numpy(float), t)


def located(known: Mapping[str, np.ndarray], at: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of WHERE but the time at times t (n,) from places known at times `at`; see `places.along`."""
    found = {}
    for column in WHERE[1:]:
        name = column.replace("_", " ")
        if name == HEADING and name in known:  # circular mean
            found[column] = np.angle(np.interp(t, at, np.exp(1j * known[name])))
        elif name in known:
            found[column] = np.interp(t, at, known[name])
    return found


def where(table: pd.DataFrame, units: Mapping[str, str], words: Sequence[str]) -> pd.DataFrame:
    """Mean and rms of residuals in bins of equal count along each place of WHERE that the table has.

    units  of the channels; words  what there is of each: columns <channel>_<word>
    Returns channel, unit, where, where_unit, low, high, middle, rows, mean_<word> and rms_<word>.
    """
    values = table[[f"{c}_{w}" for c in units for w in words]].to_numpy(float).reshape(len(table), len(units), -1)
    rows = []
    for place in [c for c in table if c in WHERE]:
        at = table[place].to_numpy(float)
        known = at[np.isfinite(at)]
        bins = min(BINS, len(known) // LEAST_BIN_ROWS)
        edges = np.unique(np.quantile(known, np.linspace(0, 1, bins + 1))) if bins else []
        unit = UNITS_AT["time" if place == "t" else place.replace("_", " ")]
        for low, high in pairwise(edges):
            inside = (at >= low) & (at <= high)
            if inside.sum() < LEAST_BIN_ROWS:
                continue
            mean, square = values[inside].mean(axis=0), (values[inside] ** 2).mean(axis=0)
            about = {"where": place, "where_unit": unit, "low": low, "high": high,
                     "middle": float(np.median(at[inside])), "rows": int(inside.sum())}  # fmt: skip
            rows += [
                {"channel": channel, "unit": units[channel], **about,
                 **{f"mean_{w}": mean[c, k] for k, w in enumerate(words)},
                 **{f"rms_{w}": np.sqrt(square[c, k]) for k, w in enumerate(words)}}
                for c, channel in enumerate(units)
            ]  # fmt: skip
    return pd.DataFrame(rows, columns=None if rows else ["channel", "where"])


def whiteness(series: Mapping[str, np.ndarray], t: np.ndarray, breaks: np.ndarray) -> list[dict[str, float]]:
    """{"whiteness_<word>": correlation of the residual with itself FAR_LAG later}; 0 for white noise.

    series  {word: (n, C)}, t (n,) s, breaks (n,) bool, True where a stretch begins: no pair reaches over one
    About the mean of all rows; NaN where no stretch is long enough or nothing varies.
    """
    step = max(round(FAR_LAG / float(np.median(np.diff(t)))), 1) if len(t) > 1 else 1
    first = np.concatenate([np.arange(p.start, p.stop - step) for p in stretches(breaks)] or [[]]).astype(int)
    found: list[dict[str, float]] = [{} for _ in range(next(iter(series.values())).shape[1])]
    for word, values in series.items():
        values = values - values.mean(axis=0)
        now, later = values[first], values[first + step]
        size = np.sqrt((now**2).sum(axis=0) * (later**2).sum(axis=0))
        product = (now * later).sum(axis=0)
        for channel, p, s in zip(found, product, size):
            channel[f"whiteness_{word}"] = float(p / s) if s > 0.0 else float("nan")
    return found


def spectra(tables: Sequence[pd.DataFrame], breaks: Sequence[np.ndarray]) -> pd.DataFrame:
    """Power densities of all columns named <channel>_<what>, over all stretches without gaps.

    tables  one per flight, with its uniform times t; breaks (n,) bool, True where a stretch begins
    Returns frequency (Hz), channel, and one column for each <what>, in squared units per Hz; empty where every stretch
            is shorter than SEGMENT. Segments are alike in seconds: flights of several rates share their lowest
            frequencies. Source: Welch, IEEE Trans. Audio Electroacoustics 15, 1967.
    """
    names = [c for c in tables[0] if c.endswith(("_before", "_after", "_floor"))]
    found: list[tuple[np.ndarray, np.ndarray, float]] = []
    for table, begins in zip(tables, breaks):
        rate = 1.0 / float(np.median(np.diff(table["t"]))) if len(table) > 1 else 0.0
        length = round(SEGMENT * rate)
        for part in stretches(begins):
            if length and part.stop - part.start >= length:
                values = table[names].to_numpy()[part]
                frequency, power = welch(values, rate, nperseg=length, axis=0, detrend="constant")
                found.append((frequency, power, (part.stop - part.start) / rate))
    if not found:
        return pd.DataFrame(columns=["frequency", "channel"])
    common = min((frequency for frequency, *_ in found), key=len)
    mean = np.average([power[: len(common)] for _, power, _ in found], axis=0, weights=[s for *_, s in found])
    rows = []
    for channel in dict.fromkeys(n.rsplit("_", 1)[0] for n in names):
        own = {n.rsplit("_", 1)[1]: mean[:, i] for i, n in enumerate(names) if n.rsplit("_", 1)[0] == channel}
        rows.append(pd.DataFrame({"frequency": common, "channel": channel, **own}))
    return pd.concat(rows, ignore_index=True)
