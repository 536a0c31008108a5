"""Figures of an imported flight: did the capture and the on-board log fall on each other?"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from quasi.attitude import GRAVITY, body_rates, from_euler, rotate

ONBOARD_COLOUR, CAPTURE_COLOUR, UNALIGNED_COLOUR = "tab:blue", "tab:red", "0.7"
CLOSE = 8.0  # s
NEAR_SAMPLE = 0.05  # s
MOST_POINTS = 8000  # a line drawn denser shows nothing more


def alignment_figure(frame: pd.DataFrame, metadata: Mapping[str, Any]) -> Figure:
    """Attitude, body rates and earth-frame accelerations without gravity, on board and captured, as aligned.

    frame, metadata  of `import_flight`. Returns a figure of three rows and three columns; nothing is drawn for what the
    flight has no capture of.
    """
    return _draw(frame, metadata, None)


def close_up(frame: pd.DataFrame, metadata: Mapping[str, Any]) -> Figure | None:
    """The same over the CLOSE seconds that turn most, with the capture as before the alignment; None without one.

    Before the alignment: both records laid side by side from their beginnings.
    """
    if not metadata.get("synchronisation"):
        return None
    t, turning = frame["t"].to_numpy(), np.sum(frame[["p", "q", "r"]].to_numpy() ** 2, axis=1)
    seen = frame["position_sample"].to_numpy() > 0
    step = t[1] - t[0]
    width = min(len(t), max(2, round(CLOSE / step)))
    window = np.ones(width)
    # capped, so that one hard knock does not choose the window; and rather where the capture saw all of it
    total = np.convolve(np.minimum(turning, 4 * np.quantile(turning, 0.9)), window, "valid")
    total *= np.convolve(_near(t, seen), window, "valid") ** 8
    first = int(np.argmax(total))
    return _draw(frame, metadata, (t[first], t[first + width - 1]))


def _draw(frame: pd.DataFrame, metadata: Mapping[str, Any], window: tuple[float, float] | None) -> Figure:
    figure = Figure(figsize=(13, 8.5), layout="constrained")
    axes = figure.subplots(3, 3, sharex=True)
    t = frame["t"].to_numpy()
    sync = metadata.get("synchronisation")
    captured = metadata["attitude source"] == "capture"

    def panel(axis: Any, lines: list[tuple[np.ndarray, str, str]], label: str) -> None:
        before = float(sync["moved from beginnings"]["value"]) if sync and window else 0.0
        _panel(axis, t, lines, before, window or (t[0], t[-1]), label)

    onboard = frame[["onboard_roll", "onboard_pitch", "onboard_yaw"]].to_numpy()
    chosen = frame[["roll", "pitch", "yaw"]].to_numpy()
    seen = frame["attitude_sample"].to_numpy() > 0
    hidden = ~_near(t, seen)
    for i, name in enumerate(("roll", "pitch", "yaw")):
        lines = [(np.degrees(np.unwrap(onboard[:, i])), ONBOARD_COLOUR, "on board")]
        if captured:
            angle = np.degrees(np.unwrap(chosen[:, i]))
            angle += 360.0 * np.round(np.median(lines[0][0] - angle) / 360.0)
            angle[hidden] = np.nan
            lines.append((angle, CAPTURE_COLOUR, "capture"))
        panel(axes[0, i], lines, f"{name}, deg")

    gyro = frame[["p", "q", "r"]].to_numpy()
    turned = _rates(t, chosen, seen) if captured else None
    for i, name in enumerate(("roll rate p", "pitch rate q", "yaw rate r")):
        lines = [(gyro[:, i], ONBOARD_COLOUR, "on board")]
        if turned is not None:
            lines.append((turned[:, i], CAPTURE_COLOUR, "capture"))
        panel(axes[1, i], lines, f"{name}, rad/s")

    force = frame[["ax", "ay", "az"]].to_numpy()
    attitude = from_euler(*chosen.T)
    sensed = rotate(attitude, force) + np.array([0.0, 0.0, GRAVITY])
    moved = _accelerations(t, frame, attitude) if metadata["velocity source"] == "capture position" else None
    # next to a gap the velocity jumps from what was bridged to what was seen
    reach = np.ones(2 * round(2 * NEAR_SAMPLE / (t[1] - t[0])) + 1)
    bridged = np.convolve(~_near(t, frame["velocity_sample"].to_numpy() > 0), reach, "same") > 0.5
    for i, name in enumerate(("north", "east", "down")):
        lines = [(_smooth(t, sensed[:, i]), ONBOARD_COLOUR, "on board")]
        if moved is not None:
            moved[bridged, i] = np.nan
            lines.append((moved[:, i], CAPTURE_COLOUR, "capture"))
        panel(axes[2, i], lines, f"acceleration {name}, m/s²")
        axes[2, i].set_xlabel("time, s")
    fullest = max(axes.flat, key=lambda axis: len(axis.lines))
    lines, names = fullest.get_legend_handles_labels()
    figure.legend(lines, names, loc="outside upper right", ncols=len(names))
    figure.suptitle(_title(metadata, sync), x=0.01, ha="left")
    return figure


def _near(t: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Rows within NEAR s of a row where something was seen."""
    at = t[seen]
    if not len(at):
        return np.zeros(len(t), bool)
    i = np.clip(np.searchsorted(at, t), 1, max(len(at) - 1, 1))
    return np.minimum(np.abs(t - at[i - 1]), np.abs(t - at[np.minimum(i, len(at) - 1)])) < NEAR_SAMPLE


def _title(metadata: Mapping[str, Any], sync: Mapping[str, Any] | None) -> str:
    title = f"{metadata['quadrotor']}, {metadata['flight']}"
    if not sync:
        return f"{title}: no capture was aligned"
    lag, rate = sync["lag"], sync["clock rate"]
    title = f"{title}: lag {1e3 * lag['value']:.2f} ms ± {1e3 * lag['std']:.2f}"
    if rate["std"]:
        title += f", clock rate {1e6 * rate['value']:+.1f} ppm ± {1e6 * rate['std']:.1f}"
    return title


def _panel(
    axis: Any, t: np.ndarray, lines: list[tuple[np.ndarray, str, str]], shift: float, window: tuple[float, float],
    label: str,
) -> None:  # fmt: skip
    """Lines within the window; the second of them, the capture's, also `shift` s earlier, as before the alignment."""
    drawn = [(t, *line) for line in lines]
    if len(lines) > 1 and abs(shift) > 1e-3:
        drawn.insert(0, (t - shift, lines[1][0], UNALIGNED_COLOUR, "capture before alignment"))
    for when, values, colour, name in drawn:
        inside = (when >= window[0]) & (when <= window[1])
        thin = slice(None, None, max(1, np.count_nonzero(inside) // MOST_POINTS))
        axis.plot(when[inside][thin], values[inside][thin], color=colour, linewidth=0.9, label=name)
    axis.set_xlim(*window)
    axis.set_ylabel(label)
    axis.grid(alpha=0.3)


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


def trajectory_figure(frame: pd.DataFrame, metadata: Mapping[str, Any]) -> Figure | None:
    """The flight from above and from the side, coloured by time; None where no position is known.

    frame, metadata  of `import_flight`; what was not seen is left out.
    """
    if "x" not in frame:
        return None
    place = frame[["x", "y", "z"]].to_numpy(float)
    seen = np.isfinite(place).all(axis=1)
    if np.count_nonzero(seen & (frame["position_sample"].to_numpy() > 0)) < 3:
        return None
    t = frame["t"].to_numpy()
    seen &= _near(t, frame["position_sample"].to_numpy() > 0)
    thin = np.flatnonzero(seen)[:: max(1, np.count_nonzero(seen) // 5000)]
    t, (x, y, z) = t[thin], place[thin].T
    whole = np.diff(t) < max(0.2, 3 * np.median(np.diff(t)))
    figure = Figure(figsize=(11, 5), layout="constrained")
    above, side = figure.subplots(1, 2)
    for axis, across, up, labels in (
        (above, y, x, ("y east, m", "x north, m")),
        (side, x, -z, ("x north, m", "height, m")),
    ):
        ends = np.stack([across, up], axis=1)
        pieces = LineCollection(np.stack([ends[:-1], ends[1:]], axis=1)[whole], cmap="viridis", linewidths=1.6)
        pieces.set_array(t[:-1][whole])
        axis.add_collection(pieces)
        axis.plot(across[0], up[0], "o", color="k", markersize=7, markerfacecolor="w", label="first seen")
        axis.plot(across[-1], up[-1], "s", color="k", markersize=5, markerfacecolor="C1", label="last seen")
        axis.set_aspect("equal", adjustable="datalim")
        axis.autoscale_view()
        axis.set_xlabel(labels[0])
        axis.set_ylabel(labels[1])
        axis.grid(alpha=0.3)
    above.set_title("from above", fontsize="medium")
    side.set_title("from the side", fontsize="medium")
    figure.legend(*above.get_legend_handles_labels(), loc="outside upper right", ncols=2, fontsize="small")
    figure.colorbar(pieces, ax=[above, side], label="time, s", pad=0.01)
    figure.suptitle(f"{metadata['flight']}: position from {metadata['position source']}", x=0.01, ha="left")
    return figure
