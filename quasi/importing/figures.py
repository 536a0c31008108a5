"""Figures of an imported flight: did the capture and the on-board log fall on each other?"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from quasi.attitude import GRAVITY, body_rates, from_euler, rotate

ONBOARD, CAPTURE, BEFORE = "tab:blue", "tab:red", "0.7"


def alignment_figure(frame: pd.DataFrame, metadata: Mapping[str, Any]) -> Figure:
    """Attitude, body rates and earth-frame accelerations: on board, captured, and captured as before the alignment.

    frame, metadata  of `import_flight`. Before the alignment: both records side by side from their beginnings.
    Returns a figure of three rows and three columns; nothing is drawn for what the flight has no capture of.
    """
    figure = Figure(figsize=(13, 8.5), layout="constrained")
    axes = figure.subplots(3, 3, sharex=True)
    t = frame["t"].to_numpy()
    sync = metadata.get("synchronisation")
    shift = _shift(metadata) if sync else 0.0
    captured = metadata["attitude source"] == "capture"

    onboard = frame[["onboard_roll", "onboard_pitch", "onboard_yaw"]].to_numpy()
    chosen = frame[["roll", "pitch", "yaw"]].to_numpy()
    seen = frame["attitude_sample"].to_numpy() > 0
    for i, name in enumerate(("roll", "pitch", "yaw")):
        lines = [(np.degrees(np.unwrap(onboard[:, i])), ONBOARD, "on board")]
        if captured:
            angle = np.degrees(np.unwrap(chosen[:, i]))
            angle += 360.0 * np.round(np.median(lines[0][0] - angle) / 360.0)
            lines.append((angle, CAPTURE, "capture"))
        _panel(axes[0, i], t, lines, shift, f"{name}, deg")

    gyro = frame[["p", "q", "r"]].to_numpy()
    turned = _rates(t, chosen, seen) if captured else None
    for i, name in enumerate("pqr"):
        lines = [(gyro[:, i], ONBOARD, "gyro")]
        if turned is not None:
            lines.append((turned[:, i], CAPTURE, "capture"))
        _panel(axes[1, i], t, lines, shift, f"{name}, rad/s")

    force = frame[["ax", "ay", "az"]].to_numpy()
    attitude = from_euler(*chosen.T)
    sensed = rotate(attitude, force) + np.array([0.0, 0.0, GRAVITY])
    moved = _accelerations(t, frame, attitude) if metadata["velocity source"] == "capture position" else None
    for i, name in enumerate(("north", "east", "down")):
        lines = [(_smooth(t, sensed[:, i]), ONBOARD, "accelerometer, gravity removed")]
        if moved is not None:
            lines.append((moved[:, i], CAPTURE, "capture"))
        _panel(axes[2, i], t, lines, shift, f"acceleration {name}, m/s$^2$")
        axes[2, i].set_xlabel("time, s")
    figure.suptitle(_title(metadata, sync))
    return figure


def _title(metadata: Mapping[str, Any], sync: Mapping[str, Any] | None) -> str:
    title = f"{metadata['quadrotor']}, {metadata['flight']}: {metadata['verdict']}"
    if not sync:
        return f"{title}\nno capture was aligned"
    lag, rate = sync["lag"], sync["clock rate"]
    return (
        f"{title}\nlag {lag['value']:.4f} s (standard error {1e3 * lag['std']:.2f} ms), clock rate "
        f"{1e6 * rate['value']:+.1f} ppm ({1e6 * rate['std']:.1f}), by {sync['method']}"
    )


def _shift(metadata: Mapping[str, Any]) -> float:
    """How far the alignment moved the capture, s, against both records laid side by side from their beginnings."""
    return float(metadata["synchronisation"]["moved from beginnings"]["value"])


def _panel(axis: Any, t: np.ndarray, lines: list[tuple[np.ndarray, str, str]], shift: float, label: str) -> None:
    if len(lines) > 1 and abs(shift) > 1e-3:
        axis.plot(t - shift, lines[1][0], color=BEFORE, linewidth=0.7, label="capture before alignment")
        axis.set_xlim(t[0], t[-1])
    for values, colour, name in lines:
        axis.plot(t, values, color=colour, linewidth=0.8, label=name)
    axis.set_ylabel(label)
    axis.grid(alpha=0.3)
    axis.legend(loc="upper right", fontsize=7)


def _rates(t: np.ndarray, euler: np.ndarray, seen: np.ndarray) -> np.ndarray | None:
    """Body rates of the captured attitude, smoothed over 50 ms, drawn only where it was seen."""
    if np.count_nonzero(seen) < 10:
        return None
    rates = body_rates(from_euler(*euler[seen].T), t[seen])
    rates = np.stack([_smooth(t, np.interp(t, t[seen], r)) for r in rates.T], axis=-1)
    near = np.interp(t, t[seen], np.arange(np.count_nonzero(seen)))
    spacing = np.diff(t[seen], append=t[seen][-1])[near.astype(int)]
    rates[spacing > 0.1] = np.nan
    return rates


def _accelerations(t: np.ndarray, frame: pd.DataFrame, attitude: np.ndarray) -> np.ndarray:
    """Earth-frame acceleration from the captured velocity, smoothed over 50 ms."""
    velocity = rotate(attitude, frame[["u", "v", "w"]].to_numpy())
    return np.stack([_smooth(t, np.gradient(v, t)) for v in velocity.T], axis=-1)


def _smooth(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    width = max(1, round(0.05 / (t[1] - t[0])))
    padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    return np.convolve(padded, np.ones(width) / width, mode="valid")
