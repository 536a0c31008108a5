"""Traces of a flight, its path, and the time spans without a source."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from quasi.pages import frame
from quasi.pages.chart import Panel, Trace
from quasi.sensor_limits import runs_of

TRACE_COLOURS = ("#1d6fb8", "#d97706", "#1e7d46", "#8e44ad", "#b3261e", "#5b6770", "#0f8b8d", "#c2185b")
MEASURED_TRACE_COLOUR, SETPOINT_COLOUR = "#3b444b", "#f0a0a0"
CAPTURE_STREAMS = ("capture", "position", "attitude", "velocity")  # streams of the pose
MAX_SPANS = 200  # the longest; narrower ones are not visible
MAX_PATH_POINTS = 1500  # of the drawn path
DEGREES_PER_RADIAN = 180.0 / np.pi
# label, unit factor, columns (name, column), table; the first screen shows the first three available ones
PANEL_ROWS: tuple[tuple[str, float, tuple[tuple[str, str], ...], str], ...] = (
    ("height, m", -1.0, (("height", "z"),), "position"),
    ("velocity, m/s", 1.0, (("forward", "u"), ("right", "v"), ("down", "w")), "velocity"),
    ("roll rate, deg/s", DEGREES_PER_RADIAN, (("set-point", "setpoint_p"), ("gyro", "p")), "imported"),
    ("motor commands", 1.0, tuple((str(i), f"command{i}") for i in range(1, 9)), "imported"),
    ("rotor speeds, rad/s", 1.0, tuple((str(i), f"w{i}") for i in range(1, 9)), "imported"),
    ("pitch rate, deg/s", DEGREES_PER_RADIAN, (("set-point", "setpoint_q"), ("gyro", "q")), "imported"),
    ("yaw rate, deg/s", DEGREES_PER_RADIAN, (("set-point", "setpoint_r"), ("gyro", "r")), "imported"),
    ("throttle stick", 1.0, (("throttle", "throttle"),), "imported"),
    ("battery, V", 1.0, (("voltage", "battery_voltage"),), "imported"),
    ("battery, A", 1.0, (("current", "battery_current"),), "imported"),
    ("attitude, deg", DEGREES_PER_RADIAN, (("roll", "roll"), ("pitch", "pitch")), "filtered"),
    ("heading, deg", DEGREES_PER_RADIAN, (("yaw", "yaw"),), "filtered"),
    ("specific force, m/s²", 1.0, (("x", "ax"), ("y", "ay"), ("z", "az")), "imported"),
    ("position, m", 1.0, (("north", "x"), ("east", "y")), "position"),
    ("forces, N", 1.0, (("Fx", "Fx"), ("Fy", "Fy"), ("Fz", "Fz")), "filtered"),
    ("moments, N m", 1.0, (("Mx", "Mx"), ("My", "My"), ("Mz", "Mz")), "filtered"),
)


def make_panels(imported: pd.DataFrame, filtered: pd.DataFrame, measured: Sequence[str]) -> list[Panel]:
    """Make the panels of a flight, the most informative traces first; traces without finite values are omitted.

    measured  the measured ones of "position" and "velocity"; the others are omitted
    """
    panels = []
    for label, factor, columns, source in PANEL_ROWS:
        if source in ("position", "velocity") and source not in measured:
            continue
        table = imported if source == "imported" else filtered
        found = [(name, table[c].to_numpy(float)) for name, c in columns if c in table]
        found = [(name, factor * values) for name, values in found if np.isfinite(values).any()]
        if not found or {name for name, _ in found} == {"set-point"}:
            continue
        pair = "set-point" in dict(columns)
        colours = (
            {"gyro": MEASURED_TRACE_COLOUR, "set-point": SETPOINT_COLOUR}
            if pair
            else dict(zip([n for n, _ in found], TRACE_COLOURS))
        )
        traces = [Trace(name, values, colours[name], 2.0 if name == "set-point" else 1.0) for name, values in found]
        panels.append(Panel(label, table["t"].to_numpy(float), traces, 120))
    return panels


def find_spans(
    imported: pd.DataFrame, filtered: pd.DataFrame, metadata: Mapping[str, Any]
) -> list[tuple[float, float, str]]:
    """Find (from, to, kind), s: on the ground, not captured, lost on board; the longest MAX_SPANS of each."""
    spans: list[tuple[float, float, str]] = []
    if "in_flight" in filtered:
        spans += [(a, b, "idle") for a, b in _find_runs(filtered, filtered["in_flight"].to_numpy(float) <= 0)]
    gaps = {
        tuple(gap)
        for name, stream in (metadata.get("streams") or {}).items()
        if stream and str(name).startswith(CAPTURE_STREAMS)
        for gap in stream.get("gaps") or ()
    }
    spans += [(float(a), float(b), "uncaptured") for a, b in sorted(gaps, key=lambda g: g[0] - g[1])[:MAX_SPANS]]
    if "onboard_valid" in imported:
        spans += [(a, b, "lost") for a, b in _find_runs(imported, imported["onboard_valid"].to_numpy(float) <= 0)]
    return [span for span in spans if np.isfinite(span[:2]).all()]


def _find_runs(table: pd.DataFrame, mask: np.ndarray) -> list[tuple[float, float]]:
    """Find begin and end, s, of the longest runs of True."""
    t = table["t"].to_numpy(float)
    found = [(float(t[a]), float(t[min(b, len(t) - 1)])) for a, b in runs_of(mask)]
    return sorted(found, key=lambda run: run[0] - run[1])[:MAX_SPANS]


def draw_path(filtered: pd.DataFrame, spans: Sequence[tuple[float, float, str]]) -> str:
    """Draw the path from above as SVG: blue where measured, red where a source was lost; "" without a position.

    filtered  with columns t, x (north, upwards in the picture), y (east, to the right), m
    """
    if not {"t", "x", "y"} <= set(filtered):
        return ""
    t, north, east = (filtered[c].to_numpy(float) for c in ("t", "x", "y"))
    rows = np.flatnonzero(np.isfinite(t) & np.isfinite(north) & np.isfinite(east))
    if len(rows) < 2:
        return ""
    rows = rows[:: max(1, len(rows) // MAX_PATH_POINTS)]
    t, north, east = t[rows], north[rows], east[rows]
    size, edge = 380.0, 26.0
    reach = max(float(np.ptp(north)), float(np.ptp(east)), 1e-3)
    x = edge + (size - 2 * edge) * (0.5 + (east - (east.max() + east.min()) / 2) / reach)
    y = edge + (size - 2 * edge) * (0.5 - (north - (north.max() + north.min()) / 2) / reach)
    lost = np.zeros(len(t), bool)
    for begin, end, kind in spans:
        if kind != "idle":
            lost |= (t >= begin) & (t <= end)
    parts = [_draw_line(x, y, "#1d6fb8", 1.2)]
    for a, b in runs_of(lost):
        around = slice(max(a - 1, 0), b + 1)
        parts.append(_draw_line(x[around], y[around], "#d62728", 2.6))
    for k, colour, name, up in ((0, "#1e7d46", "begin", -6), (-1, "#1c2329", "end", 14)):
        parts.append(
            f'<circle cx="{x[k]:.1f}" cy="{y[k]:.1f}" r="4" fill="{colour}"/>'
            f'<text x="{x[k] + 6:.1f}" y="{y[k] + up:.1f}" font-size="12" fill="{colour}">{name}</text>'
        )
    metre = 10.0 ** np.floor(np.log10(reach / 2))
    bar = (size - 2 * edge) * metre / reach
    parts.append(
        f'<path d="M{edge} {size - 8} h{bar:.1f}" stroke="#1c2329" stroke-width="2"/>'
        f'<text x="{edge + bar + 6:.1f}" y="{size - 4}" font-size="12">{metre:g} m</text>'
        f'<text x="{size / 2}" y="14" font-size="12" text-anchor="middle" fill="#5b6770">north ↑</text>'
    )
    caption = "Path from above" + ("; red where a source was lost." if lost.any() else "; no source was lost.")
    return (
        f'<figure><svg viewBox="0 0 {size:g} {size:g}" width="100%" role="img">{"".join(parts)}</svg>'
        f"<figcaption>{frame.escape(caption)}</figcaption></figure>"
    )


def _draw_line(x: np.ndarray, y: np.ndarray, colour: str, width: float) -> str:
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y))
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}"/>'
