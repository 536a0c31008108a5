"""Traces over one common time axis: zoom and cursor act on every panel of the page.

uPlot (vendor/, MIT licence) draws them. It is copied into the page, which therefore needs no network. Values are stored
as 16-bit steps of their range; 65535 stands for an unknown value.
"""

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from quasi.errors import ShapeError
from quasi.pages import frame
from quasi.pages.chart_script import CHART_SCRIPT, CHART_STYLE
from quasi.tables import read_text

VENDOR_FOLDER = Path(__file__).parent / "vendor"
UNKNOWN_CODE = 65535  # largest 16-bit number
MAX_PANEL_ROWS = 8_000  # of a panel: 8 per pixel of a wide screen; 16 panels of a flight are 1.3 MB
SPAN_KINDS = {
    "lost": ("#f6c6c2", "lost on board"),
    "uncaptured": ("#fbe3b5", "not seen by the capture"),
    "idle": ("#eceff1", "not in flight"),
    "held": ("#e3eefa", "held-out flight"),
}


@dataclass(frozen=True)
class Trace:
    """One line: values (N,) at the times of its panel, NaN where unknown; dash  lengths of line and gap, px."""

    name: str
    values: np.ndarray
    colour: str
    width: float = 1.0
    dash: Sequence[int] = ()


@dataclass(frozen=True)
class Panel:
    """Traces with one ordinate. label  its quantity and unit; t (N,) s, increasing; height  px;
    bands  (upper, lower, colour): indices of two traces between which the area is filled. Raises ShapeError."""

    label: str
    t: np.ndarray
    traces: Sequence[Trace]
    height: int = 130
    bands: Sequence[tuple[int, int, str]] = ()

    def __post_init__(self) -> None:
        for trace in self.traces:
            if np.shape(trace.values) != np.shape(self.t):
                raise ShapeError(
                    f"trace {trace.name} of {self.label}: expected {np.shape(self.t)} values like its times, got "
                    f"{np.shape(trace.values)}"
                )


@dataclass(frozen=True)
class Chart:
    """All panels of a page.

    spans  (from, to, kind), s, kind of SPAN_KINDS; views  (name, from, to, held out), s, one button each
    first  (from, to) shown at first, s, None for everything; marks  times of vertical lines, s
    """

    panels: Sequence[Panel]
    spans: Sequence[tuple[float, float, str]] = ()
    views: Sequence[tuple[str, float, float, bool]] = ()
    first: tuple[float, float] | None = None
    marks: Sequence[float] = field(default=())

    def place(self, numbers: Sequence[int], columns: int = 1) -> str:
        """Render the element for some of the panels, by number."""
        kind = ' class="panels two"' if columns == 2 else ' class="panels"'
        places = "".join(f'<div data-panel="{int(k)}"></div>' for k in numbers)
        return f"<div{kind}>{places}</div>"

    def bar(self) -> str:
        """Render buttons, the key of the shades, and how to zoom."""
        held = {True: ' class="held"', False: ""}
        buttons = "".join(
            f'<button data-view="{k}"{held[bool(view[3])]}>{frame.escape(view[0])}</button>'
            for k, view in enumerate(self.views)
        )
        kinds = [kind for kind in SPAN_KINDS if any(span[2] == kind for span in self.spans)]
        keys = "".join(
            f'<span><span class="key" style="background:{SPAN_KINDS[kind][0]}"></span>'
            f"{frame.escape(SPAN_KINDS[kind][1])}</span>"
            for kind in kinds
        )
        return (
            f'<div class="bar"><button data-view="-1">show all</button>{buttons}{keys}'
            "<span>Drag to zoom, double click to show all, Shift + wheel to zoom at the cursor.</span></div>"
            "<noscript>The traces need a browser that runs the page's script.</noscript>"
        )

    def script(self) -> str:
        """Render numbers, uPlot and script; once, after the elements of all panels."""
        ends = [float(end) for p in self.panels for end in p.t[np.isfinite(p.t)][[0, -1]]] if self.panels else []
        low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)
        data = {
            "from": low,
            "to": high if high > low else low + 1.0,
            "first": dict(zip(("from", "to"), map(float, self.first))) if self.first else None,
            "panels": [pack_panel(p) for p in self.panels],
            "spans": [{"from": float(a), "to": float(b), "colour": SPAN_KINDS[k][0]} for a, b, k in self.spans],
            "views": [{"from": float(a), "to": float(b)} for _, a, b, _ in self.views],
            "marks": [{"at": float(t)} for t in self.marks],
        }
        text = json.dumps(data, separators=(",", ":"), allow_nan=False)
        # without its first line, a web address
        library = read_text(VENDOR_FOLDER / "uPlot.iife.min.js").partition("\n")[2]
        licence = read_text(VENDOR_FOLDER / "LICENSE.uPlot").replace("*/", "")
        return (
            f'<script type="application/json" id="traces">{escape_json(text)}</script>'
            f"<script>/* uPlot 1.6.32\n{licence}*/\n{library}</script><script>{CHART_SCRIPT}</script>"
        )


def render_style() -> str:
    """Render the style sheets of uPlot and of the panels."""
    return f"<style>{read_text(VENDOR_FOLDER / 'uPlot.min.css')}{CHART_STYLE}</style>"


def escape_json(text: str) -> str:
    """Escape JSON so that it cannot end its script element."""
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def pack_panel(panel: Panel) -> dict[str, Any]:
    """Pack a panel as plain data, decimated to MAX_PANEL_ROWS."""
    known = np.flatnonzero(np.isfinite(panel.t))
    t = np.asarray(panel.t, float)[known]
    values = [np.asarray(trace.values, float)[known] for trace in panel.traces]
    rows = decimate(values, len(t), MAX_PANEL_ROWS)
    begins = float(t[0]) if len(t) else 0.0
    return {
        "label": panel.label,
        "height": panel.height,
        "begins": begins,
        "t": base64.b64encode((t[rows] - begins).astype("<f4").tobytes()).decode("ascii"),
        "series": [
            {
                "name": trace.name,
                "colour": trace.colour,
                "width": trace.width,
                "dash": list(trace.dash),
                **pack_values(v[rows]),
            }
            for trace, v in zip(panel.traces, values)
        ],
        "bands": [{"upper": a, "lower": b, "colour": colour} for a, b, colour in panel.bands],
    }


def pack_values(values: np.ndarray) -> dict[str, Any]:
    """Pack values (N,) as "low", "step" and base-64 16-bit "steps" above low; a value that is not finite is
    UNKNOWN_CODE.
    """
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    step = high / (UNKNOWN_CODE - 1) - low / (UNKNOWN_CODE - 1) or 1.0  # the difference of large numbers may overflow
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = np.clip(np.round(values / step - low / step), 0, UNKNOWN_CODE - 1)
    steps = np.where(np.isfinite(values), np.nan_to_num(scaled), UNKNOWN_CODE)
    return {"low": low, "step": step, "steps": base64.b64encode(steps.astype("<u2").tobytes()).decode("ascii")}


def decimate(values: Sequence[np.ndarray], rows: int, limit: int) -> np.ndarray:
    """Choose rows (M,) of traces with `rows` rows: the least and greatest value of each trace in every bucket.

    The first and last row stay, and one unknown row of every bucket in which a trace has one, so that its line breaks
    there. values  traces (rows,); limit  about the largest M. Kept rows hold measured values at their true times.
    """
    if rows <= limit or not values:
        return np.arange(rows)
    size = -(-rows // max(limit // (2 * len(values)), 1))
    buckets = -(-rows // size)
    keep = {0, rows - 1}
    starts = np.arange(buckets) * size
    for trace in values:
        padded = np.full(buckets * size, np.nan)
        padded[:rows] = trace
        table = padded.reshape(buckets, size)
        unknown = ~np.isfinite(table)
        some = ~unknown.all(axis=1)
        keep.update((starts + np.where(unknown, np.inf, table).argmin(axis=1))[some].tolist())
        keep.update((starts + np.where(unknown, -np.inf, table).argmax(axis=1))[some].tolist())
        own = unknown & (np.arange(buckets * size).reshape(buckets, size) < rows)
        keep.update((starts + own.argmax(axis=1))[own.any(axis=1)].tolist())
    return np.array(sorted(keep), int)
