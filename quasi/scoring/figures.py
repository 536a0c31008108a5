"""Figures of model scores. Functions return a figure; nothing is shown or saved here."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from quasi.scoring.score import AxisComparison
from quasi.sensor_limits import runs_of
from quasi.tables import ANY_PREFIX, TELEMETRY_AGE_REMOVED

MEASURED_COLOUR, MODEL_COLOUR, SHADE_COLOUR = "0.25", "tab:red", "tab:blue"
ROLE_LINE_COLOURS = {"training": "0.35", "test": "tab:orange", "validation": "tab:blue"}
BAND_COLOURS = ("#fde8e6", "#eef5ec", "#e6effa")
MAX_FIGURE_POINTS = 60_000  # per figure; more are not visible


def _mark_flight_end(panels: Sequence[Axes], start: float, end: float, key: str, held_out: bool) -> None:
    for panel in panels:
        panel.axvline(end, color="0.6", lw=0.8)
        if held_out:
            panel.axvspan(start, end, color=SHADE_COLOUR, alpha=0.12, lw=0)
    panels[0].text(
        (start + end) / 2, 1.01, key + (" (validation)" if held_out else ""), ha="center", va="bottom",
        transform=panels[0].get_xaxis_transform(), fontsize=8,
    )  # fmt: skip


def draw_comparison(found: AxisComparison, axis: str, unit: str, validation: Iterable[str] = ()) -> Figure:
    """Draw measured and predicted force or moment of one axis over time, flight after flight, with intervals.

    found  of `compare_with_measurements`; validation  flights that are shaded. Vertical lines delimit the flights.
    """
    validation = set(validation)
    figure = Figure(figsize=(11, 5), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    start = 0.0
    for number, key in enumerate(found.keys):
        rows = np.flatnonzero(found.flight == number)[:: max(len(found.t) // MAX_FIGURE_POINTS, 1)]
        if not len(rows):
            continue
        t = found.t[rows] - found.t[rows[0]] + start
        # unused rows leave gaps in time; lines must not bridge them
        breaks = np.flatnonzero(np.diff(t) > 10 * np.median(np.diff(t))) + 1 if len(t) > 2 else []
        t, measured, predicted, lower, upper = (
            np.insert(x, breaks, np.nan)
            for x in (t, found.measured[rows], found.predicted[rows], found.lower[rows], found.upper[rows])
        )
        first = start == 0.0
        top.plot(t, measured, color=MEASURED_COLOUR, lw=0.6, label="measured" if first else None)
        top.plot(t, predicted, color=MODEL_COLOUR, lw=0.8, label="model" if first else None)
        top.fill_between(
            t, lower, upper, color=MODEL_COLOUR, alpha=0.2, lw=0, label="prediction interval" if first else None
        )
        bottom.plot(t, measured - predicted, color=MEASURED_COLOUR, lw=0.6)
        end = float(np.nanmax(t))
        _mark_flight_end((top, bottom), start, end, key, key in validation)
        start = end
    bottom.axhline(0.0, color="0.6", lw=0.8)
    top.margins(x=0)
    top.set_ylabel(f"{axis}, {unit}")
    bottom.set_ylabel(f"residual, {unit}")
    bottom.set_xlabel("time, flights one after another, s")
    if found.keys and len(found.t):
        top.legend(loc="lower right", fontsize=8, ncols=3)
    return figure


def draw_closeup(
    comparisons: Mapping[str, AxisComparison], key: str, units: Mapping[str, str], seconds: float = 4.0
) -> Figure:
    """Draw measured and predicted forces and moments of one flight, each axis where it varies most.

    comparisons  of `compare_with_measurements`; units {axis: unit}; seconds  shown time span
    """
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    panels = figure.subplots(2, 3)
    for panel, axis in zip(panels.flat, ("Fx", "Fy", "Fz", "Mx", "My", "Mz")):
        if axis not in comparisons:
            panel.set_visible(False)
            continue
        found = comparisons[axis]
        here = found.flight == found.keys.index(key)
        t, measured, predicted = found.t[here], found.measured[here], found.predicted[here]
        if len(t) < 2:
            panel.set_visible(False)
            continue
        rows = min(max(round(seconds / float(np.median(np.diff(t)))), 1), len(t))
        moved = np.nan_to_num(np.square(measured - np.nanmean(measured)))
        power = np.convolve(moved, np.ones(rows), "valid")
        # unused rows leave gaps in time; a window must not contain one
        power[t[rows - 1 :] - t[: len(power)] > 1.05 * seconds] = -1.0 if len(power) > 1 else power[0]
        first = int(np.argmax(power))
        part = slice(first, first + rows)
        panel.plot(t[part], measured[part], color=MEASURED_COLOUR, lw=1.2, label="measured")
        panel.plot(t[part], predicted[part], color=MODEL_COLOUR, lw=1.0, label="model")
        panel.set_ylabel(f"{axis}, {units[axis]}")
        panel.margins(x=0)
    for panel in panels[1]:
        panel.set_xlabel("time, s")
    for panel in [p for p in panels.flat if p.get_visible()][:1]:
        panel.legend(loc="best", fontsize=9)
    figure.suptitle(f"Measured and modelled on {key}", fontsize=11)
    return figure


def draw_quartiles(found: AxisComparison, axis: str, facts: Mapping[str, Any]) -> Figure:
    """Draw RMSE per quartile of the measured range and the distribution of the rows of each role.

    found  of `compare_with_measurements`; facts  the axis's diagnostics ("quartiles", "histogram", "unit")
    """
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2.2, 1))
    unit, bands, spread = facts["unit"], facts["quartiles"], facts["histogram"]
    rows = np.flatnonzero(found.role > 0)
    rows = rows[:: max(len(rows) // MAX_FIGURE_POINTS, 1)]
    left.plot(found.measured[rows], color=MEASURED_COLOUR, lw=0.5, label="measured")
    left.plot(found.predicted[rows], color=MODEL_COLOUR, lw=0.5, alpha=0.8, label="model")
    left.set_xlabel("rows, flights one after another")
    left.set_xticks([])
    left.margins(x=0)
    edges = np.array(spread["edges"])
    for role, density in spread["density"].items():
        right.stairs(density, edges, orientation="horizontal", color=ROLE_LINE_COLOURS[role], label=role, lw=1.2)
    if len(edges):
        low, high = float(edges[0]), float(edges[-1])
        margin = 0.08 * (high - low)
        left.set_ylim(low - margin, high + margin)
    bottom, top = left.get_ylim()
    for k, (band, colour) in enumerate(zip(bands, BAND_COLOURS)):
        for panel in (left, right):
            panel.axhspan(
                bottom if k == 0 else band["from"], top if k == len(bands) - 1 else band["to"], color=colour, zorder=0
            )
    left.set_ylim(bottom, top)
    lines = [f"{'RMSE, ' + unit:<13}" + "".join(f"{b['band']:>14}" for b in bands)]
    lines += [
        f"{role:<13}" + "".join(f"{b['rmse'][role]:>14.4g}" if role in b["rmse"] else f"{'-':>14}" for b in bands)
        for role in spread["density"]
    ]
    left.set_title("\n".join(lines), fontsize=8, family="monospace", loc="left")
    left.set_ylabel(f"{axis}, {unit}")
    left.legend(loc="lower right", fontsize=8, ncols=2)
    right.set_xlabel(f"share of rows per {unit}")
    right.legend(fontsize=8)
    right.set_xscale("log")
    return figure


def draw_coverage(coverage: pd.DataFrame) -> Figure | None:
    """Draw the range of each variable in training and validation rows; None without any.

    coverage  of `diagnostics.compute_coverage`; every range is drawn in units of the training rows' own, 0 to 1
    """
    lines = coverage[~coverage["variable"].str.startswith(ANY_PREFIX)] if len(coverage) else coverage
    lines = lines[lines["training_max"] > lines["training_min"]] if len(lines) else lines
    if not len(lines):
        return None
    figure = Figure(figsize=(9, 1.2 + 0.27 * len(lines)), layout="constrained")
    panel = figure.subplots()
    low, span = lines["training_min"], lines["training_max"] - lines["training_min"]
    at = np.arange(len(lines))[::-1]

    def scaled(name: str) -> np.ndarray:
        return ((lines[name] - low) / span).to_numpy()

    panel.barh(at, 1.0, 0.62, 0.0, color="0.88", label="training, all")
    first = scaled("training_p1")
    panel.barh(at, scaled("training_p99") - first, 0.62, first, color="0.7", label="training, 1 to 99 %")
    panel.hlines(at, scaled("min"), scaled("max"), color=SHADE_COLOUR, lw=1.2, label="validation, all")
    panel.hlines(at, scaled("p1"), scaled("p99"), color=SHADE_COLOUR, lw=4.5, label="validation, 1 to 99 %")
    beyond = (lines["below"] + lines["above"]).to_numpy()
    for y, share in zip(at, beyond):
        if share > 5e-4:
            panel.text(1.01, y, f"{100 * share:.1f} % beyond", va="center", fontsize=8, color=MODEL_COLOUR,
                       transform=panel.get_yaxis_transform())  # fmt: skip
    panel.set_yticks(at, lines["variable"], fontsize=8)
    panel.set_ylim(-0.7, len(lines) - 0.3)
    panel.set_xlabel("range of the training rows, least 0 to largest 1")
    figure.legend(loc="outside upper center", fontsize=8, ncols=4)
    return figure


def draw_isolation(
    flights: Mapping[str, pd.DataFrame], regions: Mapping[str, np.ndarray], axis: str, unit: str
) -> Figure:
    """Draw the parts of the training flights that train an axis: measured values with the regions shaded.

    flights  {key: used rows with t and the axis}; regions {key: (n,) bool}
    """
    figure = Figure(figsize=(11, 3.2), layout="constrained")
    panel = figure.subplots()
    start, kept, total = 0.0, 0, 0
    for key, flight in flights.items():
        if not len(flight):
            continue
        t = flight["t"].to_numpy() - float(flight["t"].iloc[0]) + start
        inside = np.asarray(regions[key], bool)
        every = max(len(t) * len(flights) // MAX_FIGURE_POINTS, 1)
        panel.plot(t[::every], flight[axis].to_numpy()[::every], color=MEASURED_COLOUR, lw=0.6)
        for a, b in runs_of(inside):
            panel.axvspan(t[a], t[b - 1], color="tab:green", alpha=0.2, lw=0)
        kept, total = kept + int(inside.sum()), total + len(inside)
        _mark_flight_end((panel,), start, float(t[-1]), key, False)
        start = float(t[-1])
    panel.margins(x=0)
    panel.set_ylabel(f"{axis}, {unit}")
    share = 100 * kept / max(total, 1)
    panel.set_xlabel(f"time, training flights one after another, s; shaded: {share:.0f} % of the rows")
    return figure


def draw_actuators(actuators: Mapping[str, Any] | None) -> Figure | None:
    """Draw time constants and delay of each rotor over the flights, as boxes and points; None where none are known.

    actuators  of the model's document
    """
    flights = (actuators or {}).get("flights")
    if not flights:
        return None
    figure = Figure(figsize=(10, 3.4), layout="constrained")
    titles = {"time constants up": "time constant up", "time constants down": "time constant down", "delay": "delay"}
    aged = np.array([flight["delay"].get(TELEMETRY_AGE_REMOVED) is False for flight in flights.values()])
    for panel, (name, title) in zip(figure.subplots(1, 3), titles.items()):
        values = 1e3 * np.array([flight[name]["value"] for flight in flights.values()])
        errors = 1e3 * np.array([flight[name]["std"] for flight in flights.values()])
        # delays that include the telemetry delay are drawn separately, outside the median of the rotor delays
        with_telemetry = aged if name == "delay" and not aged.all() else np.zeros(len(values), bool)
        panel.boxplot(
            values[~with_telemetry],
            positions=range(1, 5),
            widths=0.5,
            showfliers=False,
            medianprops={"color": MODEL_COLOUR},
        )
        places = np.arange(1, 5) + np.linspace(-0.15, 0.15, len(values))[:, None]
        for rows, colour, text in (
            (~with_telemetry, MEASURED_COLOUR, "without telemetry delay"),
            (with_telemetry, "0.6", "with telemetry delay"),
        ):
            if rows.any():
                panel.errorbar(places[rows].ravel(), values[rows].ravel(), errors[rows].ravel(), fmt=".", ms=4, lw=0.8,
                               color=colour, label=text)  # fmt: skip
        if with_telemetry.any():
            panel.legend(fontsize=7)
        panel.set_xticks(range(1, 5))
        panel.set_xlabel("rotor")
        panel.set_ylabel(f"{title}, ms")
    figure.suptitle(f"How the rotors follow their commands, {len(flights)} flights", fontsize=10)
    return figure
