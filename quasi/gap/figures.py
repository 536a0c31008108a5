"""Figures of a diagnosis, from its tables. Functions return a figure, or None where its table has nothing to show."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from quasi.gap.places import UNITS as UNITS_AT

BEFORE, AFTER, FLOOR, MEASURED = "tab:red", "tab:blue", "0.6", "0.15"
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
PLACES = {
    "speed": "speed, m/s", "height": "height, m", "heading": "heading, rad", "room_x": "room x, m",
    "room_y": "room y, m", "t": "time, s", "volts": "battery, V", "rotor_speed": "mean rotor speed, rad/s",
    "descent_ratio": "descent / induced speed",
}  # fmt: skip
UNITS = {"position": "m", "velocity": "m/s", "attitude": "rad", "rate": "rad/s"}
STATES = {"u": "m/s", "v": "m/s", "w": "m/s", "roll": "rad", "pitch": "rad", "z": "m"}


def figures(tables: Mapping[str, pd.DataFrame]) -> dict[str, Figure]:
    """{name: figure} of what the tables hold."""
    drawn = {
        "unexplained": unexplained_figure(tables.get("W_unexplained")),
        "where": where_figure(tables.get("W_where")),
        "spectra": spectra_figure(tables.get("W_spectra")),
        "horizons": horizons_figure(tables.get("R_errors")),
        "overlays": overlays_figure(tables.get("R_overlays")),
    }
    return {name: figure for name, figure in drawn.items() if figure is not None}


def where_figure(table: pd.DataFrame | None) -> Figure | None:
    """Mean residual of each channel along each place, before and after, on compared and held-out flights."""
    if table is None or not len(table):
        return None
    places = [p for p in PLACES if (table["where"] == p).any()]
    figure = Figure(figsize=(2.1 * len(places) + 0.6, 10.5), layout="constrained")
    panels = figure.subplots(len(AXES), len(places), sharey="row", squeeze=False)
    for row, axis in zip(panels, AXES):
        for panel, place in zip(row, places):
            part = table[(table["channel"] == axis) & (table["where"] == place)]
            panel.axhline(0.0, color="0.8", lw=0.8)
            for word, colour in (("before", BEFORE), ("after", AFTER)):
                panel.plot(part["middle"], part[f"mean_{word}"], ".-", color=colour, lw=1.2, ms=4, label=word)
            panel.tick_params(labelsize=7)
            panel.ticklabel_format(axis="y", scilimits=(-3, 3))
            if axis == AXES[-1]:
                panel.set_xlabel(PLACES[place], fontsize=8)
        row[0].set_ylabel(f"{axis}, {'N' if axis[0] == 'F' else 'N m'}", fontsize=8)
    panels[0, 0].legend(fontsize=7, frameon=False)
    return figure


def unexplained_figure(table: pd.DataFrame | None) -> Figure | None:
    """What no cause explains, along the place where it lives: mean errors with their standard errors, and the fit."""
    if table is None or not len(table):
        return None
    kinds = list(table[["channel", "where"]].drop_duplicates().itertuples(index=False))
    figure = Figure(figsize=(3.6 * len(kinds), 3.0), layout="constrained")
    for panel, (channel, where) in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds):
        part = table[(table["channel"] == channel) & (table["where"] == where)].sort_values("middle")
        panel.axhline(0.0, color="0.8", lw=0.8)
        panel.errorbar(part["middle"], part["mean"], part["std"], fmt=".", color=MEASURED, lw=1.0, label="error")
        panel.plot(part["middle"], part["fit"], color=BEFORE, lw=1.2, label="smooth")
        unit = UNITS_AT.get(where, "")
        label = "distance from the place in the room" if where == "room place" else where
        panel.set_xlabel(f"{label}, {unit}" if unit else label, fontsize=8)
        panel.set_ylabel(f"{channel}, {'N' if channel[0] == 'F' else 'N m'}", fontsize=8)
        panel.ticklabel_format(axis="y", scilimits=(-3, 3))
        panel.tick_params(labelsize=7)
    figure.axes[0].legend(fontsize=7, frameon=False)
    return figure


def spectra_figure(table: pd.DataFrame | None) -> Figure | None:
    """Power density of the residuals of the held-out flights, or of the compared ones."""
    if table is None or not len(table):
        return None
    role = "held out" if (table["role"] == "held out").any() else "compared"
    figure = Figure(figsize=(10.5, 5.2), layout="constrained")
    for k, (panel, axis) in enumerate(zip(figure.subplots(2, 3, sharex=True).flat, AXES)):
        part = table[(table["role"] == role) & (table["channel"] == axis) & (table["frequency"] > 0)]
        for word, colour in (("before", BEFORE), ("after", AFTER)):
            panel.loglog(part["frequency"], part[f"density_{word}"], color=colour, lw=1.0, label=word)
        panel.set_title(axis, fontsize=9)
        panel.tick_params(labelsize=7)
        panel.set_ylabel("N²/Hz" if k < 3 else "(N m)²/Hz", fontsize=8)
        if k >= 3:
            panel.set_xlabel("Hz", fontsize=8)
    figure.axes[0].legend(fontsize=8, frameon=False)
    return figure


def horizons_figure(table: pd.DataFrame | None) -> Figure | None:
    """Root mean square errors at the end of roll-outs over their length: norms, and along the axes with trim."""
    if table is None or not len(table):
        return None
    figure = Figure(figsize=(10.5, 6.6), layout="constrained")
    panels = figure.subplots(3, 4)
    styles = {"R": "-", "R with trim": ":", "R commands": "--"}
    said = {"R with trim": ", trim", "R commands": ", commands"}
    for panel, (quantity, unit) in zip(panels[0], UNITS.items()):
        for driven, style in styles.items():
            _horizons(panel, table[table["driven"] == driven], quantity, unit, style, said.get(driven, ""))
    along = [(f"{q} {a}", UNITS[q]) for q in ("velocity", "rate") for a in "xyz"]
    line = "R with trim" if (table["driven"] == "R with trim").any() else "R"
    for panel, (quantity, unit) in zip(panels[1:, :3].flat, along):
        _horizons(panel, table[table["driven"] == line], quantity, unit, styles[line], said.get(line, ""))
    for panel in panels[1:, 3]:
        panel.axis("off")
    panels[1, 3].legend(*panels[0, 0].get_legend_handles_labels(), fontsize=8, frameon=False, loc="upper left")
    return figure


def _horizons(panel: Axes, table: pd.DataFrame, quantity: str, unit: str, style: str, said: str) -> None:
    """Before, after and floor of one quantity; the floor is not above what was reached."""
    reached = None
    for word, colour in (("before", BEFORE), ("after", AFTER), ("noise_floor", FLOOR)):
        part = table[table["model"] == word]
        if quantity not in part or not len(part):
            continue
        found = part.groupby("horizon")[quantity].apply(lambda v: np.sqrt(np.nanmean(np.square(v))))
        if word == "noise_floor" and reached is not None:
            found = np.minimum(found, reached)
        reached = found
        order = 1 if word == "noise_floor" else 2  # what was reached is seen where it is the floor
        label = word.replace("_", " ") + said
        panel.plot(found.index, found.to_numpy(), style, marker=".", color=colour, label=label, zorder=order)
    panel.set(yscale="log")
    panel.set_xlabel("horizon, s", fontsize=8)
    panel.set_title(f"{quantity}, {unit}", fontsize=9)
    panel.tick_params(labelsize=7, which="both")


def overlays_figure(table: pd.DataFrame | None) -> Figure | None:
    """A few windows: what was flown, and what the model and the extended model make of the same rotor speeds."""
    if table is None or not len(table):
        return None
    numbers = sorted(table["window"].unique())
    figure = Figure(figsize=(3.5 * len(numbers), 8.5), layout="constrained")
    panels = figure.subplots(len(STATES), len(numbers), sharex="col", squeeze=False)
    for column, number in enumerate(numbers):
        part = table[table["window"] == number]
        for row, (state, unit) in enumerate(STATES.items()):
            panel = panels[row, column]
            for word, colour in (("measured", MEASURED), ("before", BEFORE), ("after", AFTER)):
                panel.plot(part["t"], part[f"{state}_{word}"], color=colour, lw=1.3, label=word)
            panel.tick_params(labelsize=7)
            panel.set_ylabel(f"{state}, {unit}", fontsize=8)
        panels[0, column].set_title(f"{part['flight'].iloc[0]}: {part['why'].iloc[0]}", fontsize=9)
        panels[-1, column].set_xlabel("s", fontsize=8)
    panels[0, 0].legend(fontsize=7, frameon=False)
    return figure
