"""Errors of a model over the measured range, and the coverage of the validation flights by the training flights."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.pages import frame
from quasi.pages.terms import describe_variable
from quasi.tables import ANY_PREFIX
from quasi.terms.variables import plain_name

ROLE_COLOURS = {"training": "#59636b", "test": "#d97706", "validation": "#1d6fb8"}
BAND_COLOURS = ("#fde8e6", "#eef5ec", "#e6effa")


def show_quartiles(diagnosis: Mapping[str, Any]) -> str:
    rows, pictures, roles = [], [], []
    for axis, facts in diagnosis["axes"].items():
        roles = list(facts["histogram"]["density"]) or roles
        for band in facts["quartiles"]:
            bounds = f"{frame.format_number(band['from'])} to {frame.format_number(band['to'])} {facts['unit']}"
            ratios = [f"{band[k]:.2f}" if band[k] is not None else "–" for k in ("X/T", "V/T") if "test" in roles]
            rows.append(
                (f"{axis}, {band['band']}", bounds, *(frame.format_number(band["rmse"].get(r)) for r in roles), *ratios)
            )
        pictures.append(draw_histogram(axis, facts))
    text = (
        "Distribution of the measured values of each kind of row (logarithmic). Colours mark the lower 25 %, middle "
        "50 % and upper 25 %."
    )
    head = ["RMSE by quartile", "measured", *roles]
    head += ["training/test", "validation/test"] if "test" in roles else []
    return frame.render_table(head, rows) + f"<figure>{''.join(pictures)}<figcaption>{text}</figcaption></figure>"


def draw_histogram(axis: str, facts: Mapping[str, Any]) -> str:
    """Draw the distribution of the rows of each role over the measured range, logarithmic, quartiles in colour."""
    edges, density = np.array(facts["histogram"]["edges"]), facts["histogram"]["density"]
    top = max((max(d) for d in density.values()), default=0.0)
    if not len(edges) or top <= 0:
        return ""
    least = top * 1e-4
    width, height = 1000, 88
    low, span = edges[0], edges[-1] - edges[0]

    def x(value: float) -> float:
        return float(np.clip((value - low) / span, 0, 1)) * width

    def y(value: float) -> float:
        return height - 17 - (np.log(max(value, least) / least) / np.log(top / least)) * (height - 24)

    parts = []
    for k, (band, colour) in enumerate(zip(facts["quartiles"], BAND_COLOURS)):
        a, b = x(band["from"]) if k else 0.0, x(band["to"]) if k < 2 else float(width)
        parts.append(f'<rect x="{a:.1f}" y="0" width="{max(b - a, 0.5):.1f}" height="{height - 17}" fill="{colour}"/>')
    for role, values in density.items():
        steps = " ".join(f"{x(edges[k + side]):.1f},{y(v):.1f}" for k, v in enumerate(values) for side in (0, 1))
        parts.append(f'<polyline points="{steps}" fill="none" stroke="{ROLE_COLOURS[role]}" stroke-width="1.5"/>')
    for place, anchor in ((low, "start"), (edges[-1], "end")):
        parts.append(
            f'<text x="{x(place):.0f}" y="{height - 5}" font-size="12" fill="#5b6770" text-anchor="{anchor}">'
            f"{frame.format_number(float(place))} {frame.escape(facts['unit'])}</text>"
        )
    parts.append(f'<text x="6" y="15" font-size="13" fill="#1c2329">{frame.escape(axis)}</text>')
    key = " · ".join(f'<tspan fill="{ROLE_COLOURS[r]}">{r}</tspan>' for r in density)
    parts.append(f'<text x="{width / 2}" y="{height - 5}" font-size="12" text-anchor="middle">{key}</text>')
    return f'<svg viewBox="0 0 {width} {height}" width="100%" role="img">{"".join(parts)}</svg>'


def show_coverage(coverage: pd.DataFrame) -> str:
    """Draw ranges of each variable in the validation and training rows as bars, with numbers and units."""
    if not len(coverage):
        return frame.render_paragraph("No validation flights.")
    beyond = [
        f"{line.variable.removeprefix(ANY_PREFIX)} {frame.format_share(line.above)}"
        for line in coverage.itertuples()
        if line.variable.startswith(ANY_PREFIX)
    ]
    lines = [line for line in coverage.itertuples() if not line.variable.startswith(ANY_PREFIX)]
    lines = [line for line in lines if 0 < line.training_max - line.training_min < np.inf]
    bars = "".join(_draw_bar(line, k) for k, line in enumerate(lines))
    drawn = f'<svg viewBox="0 0 1000 {BAR_HEIGHT * len(lines) + 22}" width="100%" role="img">{_BAR_HEAD}{bars}</svg>'
    caption = (
        "Grey: range of the training rows, dark its 1 to 99 %. Blue: validation rows, thick their 1 to 99 %. "
        "Validation rows with some variable beyond the training rows' 0.01 to 99.99 %: " + ", ".join(beyond) + "."
    )
    return f"<figure>{drawn}<figcaption>{frame.escape(caption)}</figcaption></figure>"


MIN_SHOWN_SHARE = 5e-4  # of the rows beyond the training range; smaller shares are not shown
BAR_HEIGHT, BAR_LEFT, BAR_RIGHT = 24, 150, 560  # px: height of a bar, its ends
_BAR_HEAD = "".join(
    f'<text x="{x}" y="14" font-size="12" fill="#5b6770">{text}</text>'
    for x, text in ((BAR_RIGHT + 14, "training"), (BAR_RIGHT + 185, "validation"), (BAR_RIGHT + 370, "beyond"))
)


def _draw_bar(line: Any, number: int) -> str:
    """Draw the ranges of one variable; line  a row of `compute_coverage`."""
    top = number * BAR_HEIGHT + 22

    def x(value: float) -> float:
        share = (value - line.training_min) / (line.training_max - line.training_min)
        return BAR_LEFT + float(np.nan_to_num(np.clip(0.1 + 0.8 * share, 0, 1))) * (BAR_RIGHT - BAR_LEFT)

    parts = [
        f'<rect x="{x(a):.1f}" y="{top + y}" width="{max(x(b) - x(a), 1):.1f}" height="{tall}" fill="{colour}"/>'
        for a, b, y, tall, colour in (
            (line.training_min, line.training_max, 4, 16, "#e7eaed"),
            (line.training_p1, line.training_p99, 4, 16, "#c3cad0"),
            (line.min, line.max, 11, 2, ROLE_COLOURS["validation"]),
            (line.p1, line.p99, 9, 6, ROLE_COLOURS["validation"]),
        )
    ]
    unit = describe_variable(plain_name(line.variable))[0]
    name = f"{line.variable}, {unit}" if unit else line.variable
    share = line.below + line.above
    beyond = share > MIN_SHOWN_SHARE
    texts = (
        (BAR_LEFT - 8, name, 13, "#1c2329", "end"),
        (BAR_RIGHT + 14, _format_range(line.training_min, line.training_max), 12, "#1c2329", "start"),
        (BAR_RIGHT + 185, _format_range(line.min, line.max), 12, ROLE_COLOURS["validation"], "start"),
        (
            BAR_RIGHT + 370,
            frame.format_share(share) if beyond else "none",
            12,
            "#b3261e" if beyond else "#5b6770",
            "start",
        ),
    )
    parts += [
        f'<text x="{x}" y="{top + 16}" font-size="{size}" fill="{colour}" text-anchor="{anchor}">'
        f"{frame.escape(text)}</text>"
        for x, text, size, colour, anchor in texts
    ]
    return "".join(parts)


def _format_range(low: float, high: float) -> str:
    """Format two numbers with three digits, without powers of ten below 100,000."""
    texts = (f"{v:.0f}" if 100 <= abs(v) < 1e5 else f"{v:.3g}" for v in (low, high))
    return " to ".join(texts).replace("-", "−").replace("e+0", "e")
