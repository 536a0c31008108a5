"""Spectrum of the gyro against rotor speed or throttle: resonances of the airframe and rotor vibrations."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

SEGMENT_LENGTH = 0.4  # s; lines 2.5 Hz apart
ABSCISSA_BINS = 24  # of the abscissa
MIN_SEGMENTS = 8  # with fewer segments no spectrum is drawn
TWO_PI = 2.0 * np.pi


def draw_gyro_spectrum(imported: pd.DataFrame, flying: np.ndarray) -> Figure | None:
    """Draw the mean power spectral density of p, q and r by mean rotor speed, else throttle, else motor command.

    imported  columns t (s, uniform), p, q, r (rad/s) and w1 .. or throttle or command1 ..; flying (n,) bool
    Segments of SEGMENT_LENGTH overlap by half (Welch, 1967), with a Hann window. None for a flight that is too short or
    has no abscissa.
    """
    if not {"t", "p", "q", "r"} <= set(imported) or len(imported) < 3:
        return None
    t = imported["t"].to_numpy(float)
    step = float(np.median(np.diff(t)))
    found = _choose_abscissa(imported)
    size = round(SEGMENT_LENGTH / step) if np.isfinite(step) and step > 0 else 0
    if found is None or size < 8 or len(t) < 2 * size:
        return None
    label, level = found
    gyro = np.degrees(imported[["p", "q", "r"]].to_numpy(float))
    window = np.hanning(size)
    places, powers = [], []
    for begin in range(0, len(t) - size + 1, size // 2):
        part = slice(begin, begin + size)
        if not flying[part].all() or not np.isfinite(gyro[part]).all() or not np.isfinite(level[part]).all():
            continue
        moving = (gyro[part] - gyro[part].mean(axis=0)) * window[:, None]
        powers.append(np.sum(np.abs(np.fft.rfft(moving, axis=0)) ** 2, axis=1) * 2 * step / np.sum(window**2))
        places.append(float(np.mean(level[part])))
    if len(powers) < MIN_SEGMENTS or not np.ptp(places) > 0:
        return None
    edges = np.linspace(min(places), max(places), ABSCISSA_BINS + 1)
    bins = np.clip(np.digitize(places, edges) - 1, 0, ABSCISSA_BINS - 1)
    table = np.full((size // 2 + 1, ABSCISSA_BINS), np.nan)
    for k in np.unique(bins):
        table[:, k] = np.mean([p for p, b in zip(powers, bins) if b == k], axis=0)
    return _draw(np.fft.rfftfreq(size, step), edges, table, label)


def _choose_abscissa(imported: pd.DataFrame) -> tuple[str, np.ndarray] | None:
    """Choose label and values (n,) of the abscissa."""
    for label, columns in (
        ("mean rotor speed, rad/s", [c for c in imported if c[0] == "w" and c[1:].isdigit()]),
        ("throttle", [c for c in imported if c == "throttle"]),
        ("mean motor command", [c for c in imported if c.startswith("command")]),
    ):
        values = imported[columns].to_numpy(float)
        if len(columns) and np.isfinite(values).all(axis=1).any() and np.nanmax(values) > np.nanmin(values):
            return label, values.mean(axis=1)
    return None


def _draw(frequency: np.ndarray, edges: np.ndarray, table: np.ndarray, label: str) -> Figure:
    figure = Figure(figsize=(5.2, 5.2), layout="constrained")
    axes = figure.subplots()
    rows = frequency > 2.0  # Hz; slower motion is manoeuvring, not vibration
    shown = 10.0 * np.log10(np.maximum(table[rows], 1e-12))
    finite = shown[np.isfinite(shown)]
    top = float(np.max(finite)) if len(finite) else 0.0
    mesh = axes.pcolormesh(edges, _compute_edges(frequency[rows]), shown, vmin=top - 50.0, vmax=top, cmap="magma")
    figure.colorbar(mesh, ax=axes, label="gyro, dB (deg/s)²/Hz")
    if label.startswith("mean rotor"):
        for harmonic in (1, 2):
            axes.plot(edges, harmonic * edges / TWO_PI, "w--", lw=0.8)
    axes.set_ylim(frequency[rows][0], frequency[-1])
    axes.set_xlabel(label)
    axes.set_ylabel("frequency, Hz")
    return figure


def _compute_edges(middles: np.ndarray) -> np.ndarray:
    """Compute edges (n + 1,) of bins with evenly spaced middles (n,)."""
    half = 0.5 * (middles[1] - middles[0])
    return np.append(middles - half, middles[-1] + half)
