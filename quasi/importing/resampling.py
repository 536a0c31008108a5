"""From each source's own samples to one uniform grid, without aliasing, and with what is known of every grid point."""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from quasi.attitude import continuous, interpolate, normalise
from quasi.importing.series import interpolate_columns

GAP = 3.1  # sampling intervals without a sample make a gap
LONGEST_BRIDGE = 0.1  # s of missing positions across which a velocity is still trusted


class Resampled(NamedTuple):
    """values (m, k) on the grid; sample (m,) true where a measurement lies within half a step; covered (m,) no gap."""

    values: np.ndarray
    sample: np.ndarray
    covered: np.ndarray


def grid(begin: float, end: float, rate: float) -> np.ndarray:
    """Times begin, begin + 1/rate, ... up to end, s."""
    return begin + np.arange(int(np.floor((end - begin) * rate + 1e-9)) + 1) / rate


def fresh(t: np.ndarray, at: np.ndarray) -> np.ndarray:
    """True for grid points `at` (m,) with one of the times t (n,) within half a grid step."""
    if len(t) == 0 or len(at) < 2:
        return np.zeros(len(at), bool)
    half = 0.5 * (at[1] - at[0]) * (1 + 1e-9)
    right = np.clip(np.searchsorted(t, at), 0, len(t) - 1)
    left = np.maximum(right - 1, 0)
    return np.minimum(np.abs(t[right] - at), np.abs(t[left] - at)) <= half


def covered(t: np.ndarray, at: np.ndarray, longest: float | None = None) -> np.ndarray:
    """True for grid points between two samples no farther apart than `longest` s (default: GAP usual intervals)."""
    if len(t) < 2:
        return np.zeros(len(at), bool)
    if longest is None:
        longest = max(GAP * float(np.median(np.diff(t))), 1.01 * (at[1] - at[0]) if len(at) > 1 else 0.0)
    i = np.searchsorted(t, at, side="right")
    inside = (at >= t[0]) & (at <= t[-1])
    i = np.clip(i, 1, len(t) - 1)
    return inside & (t[i] - t[i - 1] <= longest)


def resample(t: np.ndarray, values: np.ndarray, at: np.ndarray, smooth: bool = True) -> Resampled:
    """Bring samples to the grid.

    t       (n,) s, increasing; values (n, k), rows with NaN are left out; at (m,) s, uniform
    smooth  piecewise cubic between samples for signals that are; linear for steps (commands) and telemetry
    A record denser than the grid is low-passed first, zero phase, at 0.4 of the grid's rate.
    """
    values = np.asarray(values, float)
    fine = np.isfinite(values).all(axis=1)
    t, values = t[fine], values[fine]
    if len(t) < 2:
        empty = np.full((len(at), values.shape[1]), np.nan)
        return Resampled(empty, np.zeros(len(at), bool), np.zeros(len(at), bool))
    usual = float(np.median(np.diff(t)))
    step = float(at[1] - at[0]) if len(at) > 1 else np.inf
    known = covered(t, at)
    filtered = anti_alias(t, values, usual, step) if usual < 0.75 * step else values
    out = interpolate_columns(at, t, filtered)
    if smooth:
        _curve(out, t, filtered, at, max(GAP * usual, 1.01 * step))
    return Resampled(out, fresh(t, at), known)


def _curve(out: np.ndarray, t: np.ndarray, values: np.ndarray, at: np.ndarray, longest: float) -> None:
    """Put a cubic through the samples into `out`, only where both neighbours are near: a spline swings across gaps and
    between crowded samples."""
    if len(t) > 4 and regular(t):
        for a, b in _pieces(t, longest):
            if b - a > 4:
                here = (at >= t[a]) & (at <= t[b - 1])
                out[here] = CubicSpline(t[a:b], values[a:b], axis=0)(at[here])


def regular(t: np.ndarray) -> bool:
    """True when few samples crowd: fewer than 1 % follow the one before within half the usual interval."""
    spacing = np.diff(t)
    return bool(np.mean(spacing < 0.5 * np.median(spacing)) < 0.01)


def _pieces(t: np.ndarray, longest: float) -> list[tuple[int, int]]:
    """Ranges [a, b) of samples without a gap longer than `longest`."""
    edges = np.flatnonzero(np.diff(t) > longest) + 1
    return list(zip(np.concatenate([[0], edges]), np.concatenate([edges, [len(t)]])))


def anti_alias(t: np.ndarray, values: np.ndarray, usual: float, step: float) -> np.ndarray:
    """Zero-phase low-pass at 0.4 of the grid's rate, each piece between gaps by itself. Shapes as `resample`."""
    sos = butter(4, min(0.4 / step * 2 * usual, 0.95), output="sos")
    out = values.copy()
    for a, b in _pieces(t, GAP * usual):
        if b - a < 30:
            continue
        even = np.arange(t[a], t[b - 1] + 0.5 * usual, usual)
        dense = interpolate_columns(even, t[a:b], values[a:b])
        dense = sosfiltfilt(sos, dense, axis=0, padlen=min(len(dense) - 2, 60))
        out[a:b] = interpolate_columns(t[a:b], even, dense)
    return out


def resample_attitude(t: np.ndarray, q: np.ndarray, at: np.ndarray) -> Resampled:
    """Attitude (n, 4) to the grid; rows with NaN are left out.

    Along a cubic as `resample` has it; across gaps along the shortest turn. The shortest turn between samples alone
    would cut every corner of a motion that swings: 2 % of a swing of 8 Hz between samples 8 ms apart.
    """
    fine = np.isfinite(q).all(axis=1)
    t, q = t[fine], q[fine]
    if len(t) < 2:
        return Resampled(np.full((len(at), 4), np.nan), np.zeros(len(at), bool), np.zeros(len(at), bool))
    q = continuous(q)
    out = interpolate(q, t, at)
    step = float(at[1] - at[0]) if len(at) > 1 else np.inf
    _curve(out, t, q, at, max(GAP * float(np.median(np.diff(t))), 1.01 * step))
    return Resampled(continuous(normalise(out)), fresh(t, at), covered(t, at))


def velocity(t: np.ndarray, position: np.ndarray, at: np.ndarray, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """Velocity from positions by a zero-phase differentiator, and where it can be trusted.

    t (n,) s; position (n, 3) m, NaN where missing; at (m,) s; cutoff Hz, the frequency at which the gain has fallen to
    0.71 (-3 dB) of a perfect differentiator's; below half of it the gain is within 1 %.
    Returns velocity (m, 3) m/s, in the axes of the position, and (m,) bool: no gap longer than LONGEST_BRIDGE near.
    """
    fine = np.isfinite(position).all(axis=1)
    t, position = t[fine], position[fine]
    out, trusted = np.full((len(at), 3), np.nan), np.zeros(len(at), bool)
    if len(t) < 2:
        return out, trusted
    usual, even_spacing = float(np.median(np.diff(t))), regular(t)
    for a, b in _pieces(t, max(LONGEST_BRIDGE, GAP * usual)):
        if b - a < 8 or t[b - 1] - t[a] < 1.0 / cutoff:
            continue
        even = np.arange(t[a], t[b - 1] + 0.5 * usual, usual)
        # fill between samples along the motion, not along the chord
        if even_spacing:
            path = CubicSpline(t[a:b], position[a:b], axis=0)(even)
        else:
            path = interpolate_columns(even, t[a:b], position[a:b])
        smoothed = low_pass(path, 1 / usual, cutoff)
        # at a torn end the filter has only one side to lean on
        torn = 0.25 / cutoff
        here = (at >= t[a] + (torn if a > 0 else 0.0)) & (at <= t[b - 1] - (torn if b < len(t) else 0.0))
        out[here] = CubicSpline(even, smoothed, axis=0)(at[here], 1)
        trusted[here] = True
    for c in range(3):
        known = np.isfinite(out[:, c])
        if known.any():
            out[:, c] = np.interp(at, at[known], out[known, c])
    return out, trusted


def low_pass(values: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Zero-phase Butterworth low-pass (4th order, run both ways) with -3 dB at `cutoff` in total. values (n, k).

    Source: Winter, Biomechanics and Motor Control of Human Movement, 4th ed., 2009, section 2.2.4.4 (two passes).
    """
    if cutoff >= 0.45 * rate or len(values) < 12:
        return values
    warped = np.tan(np.pi * cutoff / rate) / (np.sqrt(2.0) - 1.0) ** (1.0 / 8.0)
    sos = butter(4, min(2 / np.pi * np.arctan(warped), 0.95), output="sos")
    return sosfiltfilt(sos, values, axis=0, padlen=min(len(values) - 2, int(3 * rate / cutoff)))


def angular_acceleration(at: np.ndarray, rates: np.ndarray, cutoff: float = 40.0) -> np.ndarray:
    """Time derivative (m, 3), rad/s2, of body rates (m, 3) on a uniform grid, zero phase, -3 dB at `cutoff` Hz."""
    step = float(at[1] - at[0])
    return np.gradient(low_pass(rates, 1 / step, cutoff), step, axis=0)
