"""The figures of a filtered flight: states, forces, moments, gyro and accelerometer bias, vibration."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import welch

from quasi.filtering import harmonics
from quasi.filtering.measurements import fill

BEFORE_COLOUR, AFTER_COLOUR, BAND_COLOUR, UNUSED_COLOUR = "C1", "C0", "C0", "0.6"
MOST_POINTS = 8000  # a line drawn denser shows nothing more


def _stride(n: int) -> slice:
    return slice(None, None, max(1, n // MOST_POINTS))


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """Degrees, with a gap in the line where the angle wraps round."""
    shown = np.degrees((angle + np.pi) % (2 * np.pi) - np.pi)
    shown[1:][np.abs(np.diff(shown)) > 180.0] = np.nan
    return shown


def _three(title: str, labels: list[str]) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    axes = list(figure.subplots(3, 1, sharex=True))
    figure.suptitle(title, x=0.01, ha="left", fontsize="large")
    for axis, label in zip(axes, labels):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        axis.margins(x=0)
    axes[-1].set_xlabel("time, s")
    return figure, axes


def _legend(figure: Figure, axes: list[Axes]) -> None:
    """One legend for all panels, above them, so that it hides nothing."""
    named: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels()):
            named.setdefault(label, handle)
    figure.legend(named.values(), named.keys(), loc="outside upper right", ncols=len(named), fontsize="small")


def _rest(axes: list[Axes], metadata: Mapping[str, Any]) -> None:
    rest = (metadata.get("phases") or {}).get("rest")
    for axis in axes:
        if rest:
            axis.axvline(rest[1], color="k", linestyle="--", linewidth=1, label="end of rest")


def _states(
    title: str,
    names: list[str],
    labels: list[str],
    imported: pd.DataFrame,
    filtered: pd.DataFrame,
    std: np.ndarray | None,
    metadata: Mapping[str, Any],
    angle: bool = False,
) -> Figure:
    figure, axes = _three(title, labels)
    thin = _stride(len(filtered))
    show = _wrapped if angle else np.asarray
    t = filtered["t"].to_numpy()[thin]
    for i, (axis, name) in enumerate(zip(axes, names)):
        after = show(filtered[name].to_numpy(float)[thin])
        if name in imported and np.isfinite(imported[name].to_numpy(float)).any():
            before, when = show(imported[name].to_numpy(float)[thin].copy()), imported["t"].to_numpy()[thin]
            axis.plot(when, before, color=BEFORE_COLOUR, linestyle="--", linewidth=0.9, label="imported", zorder=3)
        axis.plot(t, after, color=AFTER_COLOUR, linewidth=1.4, label="filtered")
        if std is not None:
            half = 2.0 * (np.degrees(std[thin, i]) if angle else std[thin, i])
            axis.fill_between(
                t, after - half, after + half, color=BAND_COLOUR, alpha=0.25, linewidth=0, label="± 2 standard errors"
            )
    _rest(axes, metadata)
    _legend(figure, axes)
    return figure


def _bias(
    title: str, key: str, sensors: list[str], unit: str, convergence: pd.DataFrame, metadata: Mapping[str, Any]
) -> Figure:
    figure, axes = _three(title, [f"bias of {s}, {unit}" for s in sensors])
    thin = _stride(len(convergence))
    t = convergence["t"].to_numpy()[thin]
    applied = metadata["biases"][key]
    for i, (axis, sensor) in enumerate(zip(axes, sensors)):
        value, std = (convergence[f"filter_{k}_{sensor}"].to_numpy()[thin] for k in ("bias", "bias_std"))
        axis.plot(t, value, color=AFTER_COLOUR, linewidth=1, label="forward filter")
        for sign in (-2.0, 2.0):
            label = "± 2 standard errors" if sign > 0 else None
            axis.plot(t, value + sign * std, color=BAND_COLOUR, alpha=0.5, linestyle="--", linewidth=1, label=label)
        if metadata["biases"]["policy"] == "time varying":
            axis.plot(t, convergence[f"bias_{sensor}"].to_numpy()[thin], color="C3", linewidth=1, label="taken off")
        else:
            axis.axhline(applied["value"][i], color="C3", linewidth=1, label="taken off")
        # the first instants, before anything is known, would hide the rest
        late = slice(len(value) // 50, None)
        low, high = np.min((value - 3 * std)[late]), np.max((value + 3 * std)[late])
        axis.set_ylim(min(low, applied["value"][i]), max(high, applied["value"][i]))
    _rest(axes, metadata)
    _legend(figure, axes)
    return figure


def _wrench(title: str, names: list[str], unit: str, filtered: pd.DataFrame, metadata: Mapping[str, Any]) -> Figure:
    figure, axes = _three(title, [f"{n}, {unit}" for n in names])
    thin = _stride(len(filtered))
    t, valid = filtered["t"].to_numpy()[thin], filtered["valid"].to_numpy()[thin] > 0
    for axis, name in zip(axes, names):
        values = filtered[name].to_numpy(float)[thin]
        axis.plot(
            t, np.where(valid, np.nan, values), color=UNUSED_COLOUR, linewidth=0.8, label="not valid for identification"
        )
        axis.plot(t, np.where(valid, values, np.nan), color=AFTER_COLOUR, linewidth=0.8, label="valid")
    _rest(axes, metadata)
    _legend(figure, axes)
    return figure


def _density(frame: pd.DataFrame, names: Sequence[str], flying: np.ndarray, rate: float) -> tuple[np.ndarray, ...]:
    """Frequencies (Hz) and amplitude density of some columns together, in flight, per square root of a Hz."""
    power = 0.0
    for name in names:
        values = fill(frame[name].to_numpy(float))[flying]
        frequency, each = welch(values, rate, nperseg=min(len(values), round(4.0 * rate)))
        power = power + each
    return frequency[1:], np.sqrt(np.asarray(power)[1:])


def _vibration(imported: pd.DataFrame, filtered: pd.DataFrame, metadata: Mapping[str, Any]) -> Figure | None:
    """Spectra of gyro and accelerometer before and after the band's filters, and where the rotors' lines stand."""
    flying = filtered["in_flight"].to_numpy() > 0
    sensors = (("pqr", "gyro, rad/s/√Hz"), (("ax", "ay", "az"), "accelerometer, m/s²/√Hz"))
    if flying.sum() < 100 or any(imported[name].isna().all() for names, _ in sensors for name in names):
        return None
    rate = float(metadata["sampling"]["rate"])
    gyro = ((metadata.get("imported") or {}).get("streams") or {}).get("gyro") or {}
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = list(figure.subplots(2, 1, sharex=True))
    figure.suptitle(f"{metadata.get('flight') or 'flight'}: vibration", x=0.01, ha="left", fontsize="large")
    rotors = [c for c in filtered if c[0] == "w" and c[1:].isdigit()]
    turning = filtered[rotors].to_numpy()[flying] / (2.0 * np.pi)
    for axis, (names, label) in zip(axes, sensors):
        axis.semilogy(*_density(imported, names, flying, rate), color=BEFORE_COLOUR, linewidth=0.9, label="imported")
        frequency, after = _density(filtered, names, flying, rate)
        axis.semilogy(frequency, after, color=AFTER_COLOUR, linewidth=1.4, label="filtered")
        for order in range(1, harmonics.LOOKED_FOR + 1):
            stands, there = harmonics.on_grid(order * turning, float(gyro.get("rate") or rate), rate)
            if there.sum() > 0.2 * max(there.size, 1):
                low, high = np.quantile(stands[there], [0.1, 0.9])
                axis.axvspan(low, high, color=f"C{1 + order}", alpha=0.12, label=f"harmonic {order}")
        axis.axvline(metadata["filters"]["low-pass cutoff Hz"], color="k", linestyle=":", linewidth=1, label="cut-off")
        axis.set_ylabel(label)
        axis.set_ylim(max(1e-4 * after.max(), 1e-12))  # what the filters leave far beyond the cut-off is rounding
        axis.grid(alpha=0.3)
        axis.margins(x=0)
    axes[-1].set_xlabel("frequency, Hz")
    _legend(figure, axes)
    return figure


def figures(
    imported: pd.DataFrame, filtered: pd.DataFrame, metadata: Mapping[str, Any], convergence: pd.DataFrame | None
) -> dict[str, Figure]:
    """The figures of one flight by name: attitude, velocity, position, forces, moments, gyro_bias and
    accelerometer_bias if a filter ran, and vibration if the flight is long enough for a spectrum.

    imported   the flight before; filtered  after (either kind of force); metadata  of the filtered flight
    convergence  the filter's course, whole or thinned; None leaves out the error bands and the biases
    """
    flight = metadata.get("flight") or "flight"
    kinds: list[tuple[str, list[str], list[str], bool]] = [
        ("attitude", ["roll", "pitch", "yaw"], ["roll, deg", "pitch, deg", "yaw, deg"], True),
        ("velocity", ["u", "v", "w"], ["u forward, m/s", "v right, m/s", "w down, m/s"], False),
        ("position", ["x", "y", "z"], ["x north, m", "y east, m", "z down, m"], False),
    ]
    result: dict[str, Figure] = {}
    t = filtered["t"].to_numpy()
    for kind, names, labels, angle in kinds:
        std = None
        if convergence is not None and kind == "position":
            kept = convergence["t"].to_numpy()
            std = np.stack([np.interp(t, kept, convergence[f"position_std_{a}"].to_numpy()) for a in "xyz"], axis=1)
        result[kind] = _states(f"{flight}: {kind}", names, labels, imported, filtered, std, metadata, angle)
    with_gravity = metadata.get("forces", "withGravity") == "withGravity"
    kind = "mass times specific force" if with_gravity else "net force"
    result["forces"] = _wrench(f"{flight}: forces ({kind})", ["Fx", "Fy", "Fz"], "N", filtered, metadata)
    result["moments"] = _wrench(f"{flight}: moments", ["Mx", "My", "Mz"], "N m", filtered, metadata)
    if convergence is not None:
        for key, sensors, unit in (("gyro", ["p", "q", "r"], "rad/s"), ("accelerometer", ["ax", "ay", "az"], "m/s²")):
            result[f"{key}_bias"] = _bias(f"{flight}: {key} bias", key, sensors, unit, convergence, metadata)
    vibration = _vibration(imported, filtered, metadata)
    if vibration is not None:
        result["vibration"] = vibration
    return result
