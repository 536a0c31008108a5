"""Figures that compare a model with measurements. Functions return a figure; nothing is shown or saved here."""

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from quasi.errors import DataError
from quasi.standalone.model import Model

MEASURED, MODEL, SHADE = "0.25", "tab:red", "tab:blue"
MOST_POINTS = 20_000  # per flight; more cannot be seen


def comparison(
    model: Model,
    flights: Mapping[str, pd.DataFrame],
    axis: str,
    validation: Iterable[str] = (),
    level: float | None = None,
) -> Figure:
    """Measured and predicted force or moment of one axis over time, flight after flight.

    validation  flights that are shaded; level  of the prediction interval, None for the model's own
    Vertical lines delimit the flights. Raises DataError for an axis that is not there.
    """
    if axis not in model.axes:
        raise DataError(f"model {model.id} has no axis '{axis}'; choose one of {', '.join(model.axes)}")
    validation = set(validation)
    figure = Figure(figsize=(11, 5), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    start = 0.0
    unit = model.document["axes"][axis]["unit"]
    for key, flight in flights.items():
        if axis not in flight:
            raise DataError(f"flight {key} has no column '{axis}' to compare with; filter it anew")
        flight = flight.iloc[:: max(len(flight) // MOST_POINTS, 1)]
        t = flight["t"].to_numpy() - float(flight["t"].iloc[0]) + start
        bands = model.interval(flight, level)
        first = start == 0.0
        top.plot(t, flight[axis], color=MEASURED, lw=0.6, label="measured" if first else None)
        top.plot(t, bands[axis], color=MODEL, lw=0.8, label="model" if first else None)
        top.fill_between(
            t, bands[f"{axis}_lower"], bands[f"{axis}_upper"], color=MODEL, alpha=0.2, lw=0,
            label="prediction interval" if first else None,
        )  # fmt: skip
        bottom.plot(t, flight[axis].to_numpy() - bands[axis].to_numpy(), color=MEASURED, lw=0.6)
        end = float(t[-1])
        for panel in (top, bottom):
            panel.axvline(end, color="0.6", lw=0.8)
            if key in validation:
                panel.axvspan(start, end, color=SHADE, alpha=0.12, lw=0)
        top.text(
            (start + end) / 2, 1.01, key + (" (validation)" if key in validation else ""), ha="center", va="bottom",
            transform=top.get_xaxis_transform(), fontsize=8,
        )  # fmt: skip
        start = end
    bottom.axhline(0.0, color="0.6", lw=0.8)
    top.set_ylabel(f"{axis}, {unit}")
    bottom.set_ylabel(f"measured - model, {unit}")
    bottom.set_xlabel("time, flights one after another, s")
    top.legend(loc="lower right", fontsize=8, ncols=3)
    return figure


def closeup(model: Model, flight: pd.DataFrame, key: str, seconds: float = 4.0) -> Figure:
    """Measured and predicted forces and moments of one flight, each axis where it moves most.

    flight  rows that are used, with t (s); seconds  length of what is shown
    """
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    panels = figure.subplots(2, 3)
    t = flight["t"].to_numpy()
    rows = max(round(seconds / float(np.median(np.diff(t)))), 1)
    predicted = model.predict_columns(flight)
    for panel, axis in zip(panels.flat, ("Fx", "Fy", "Fz", "Mx", "My", "Mz")):
        if axis not in model.axes:
            panel.set_visible(False)
            continue
        measured = flight[axis].to_numpy()
        power = np.convolve(np.square(measured - np.mean(measured)), np.ones(min(rows, len(t))), "valid")
        # rows that are not used leave gaps in time: a window must not reach across one
        power[t[rows - 1 :] - t[: len(power)] > 1.05 * seconds] = -1.0 if len(power) > 1 else power[0]
        first = int(np.argmax(power))
        part = slice(first, first + rows)
        panel.plot(t[part], measured[part], color=MEASURED, lw=1.2, label="measured")
        panel.plot(t[part], predicted[axis].to_numpy()[part], color=MODEL, lw=1.0, label="model")
        panel.set_ylabel(f"{axis}, {model.document['axes'][axis]['unit']}")
        panel.margins(x=0)
    for panel in panels[1]:
        panel.set_xlabel("time, s")
    panels[0, 0].legend(loc="best", fontsize=9)
    figure.suptitle(f"Model {model.id} on {key}", fontsize=11)
    return figure


def scatter(model: Model, flights: Mapping[str, pd.DataFrame], axis: str) -> Figure:
    """Predicted over measured values of one axis; a perfect model lies on the diagonal."""
    figure = Figure(figsize=(5, 5), layout="constrained")
    panel = figure.subplots()
    unit = model.document["axes"][axis]["unit"]
    low, high = np.inf, -np.inf
    for key, flight in flights.items():
        flight = flight.iloc[:: max(len(flight) // MOST_POINTS, 1)]
        predicted = model.predict_columns(flight)[axis]
        panel.plot(flight[axis], predicted, ".", ms=1, alpha=0.4, label=key)
        low, high = min(low, flight[axis].min()), max(high, flight[axis].max())
    panel.plot([low, high], [low, high], color="0.6", lw=0.8)
    panel.set_xlabel(f"measured {axis}, {unit}")
    panel.set_ylabel(f"predicted {axis}, {unit}")
    panel.legend(fontsize=8, markerscale=6)
    return figure
