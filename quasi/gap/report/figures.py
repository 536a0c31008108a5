"""Figures of a diagnosis, from its tables. Functions return a figure, or None where its table has nothing to show."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from quasi.gap.flights.covariates import UNITS_AT as UNITS_AT
from quasi.gap.levels.rollouts.open_loop import ERROR_UNITS, TYPICAL
from quasi.gap.report.wording import CHANNEL_NAMES
from quasi.model.model import AXES

FIGURE_WIDTH = 10.5  # in, which the page shows at its own size: smaller figures would be blown up, larger ones shrunk
FONT_SIZE = 9  # pt, of all that is to be read
RED, BLUE, LIGHT_GREY, DARK_GREY = "tab:red", "tab:blue", "0.6", "0.15"
PLACE_LABELS = {
    "speed": "speed, m/s", "height": "height, m", "heading": "heading, rad", "room_x": "room x, m",
    "room_y": "room y, m", "t": "time, s", "volts": "battery, V", "rotor_speed": "mean rotor speed, rad/s",
    "descent_ratio": "descent / induced speed",
}  # fmt: skip
# "before" is broad and pale, "after" thin and above it: both are seen where they are the same
DRAWN: dict[str, dict[str, Any]] = {
    "before": {"color": RED, "lw": 3.2, "alpha": 0.45, "zorder": 2},
    "after": {"color": BLUE, "lw": 1.2, "zorder": 3},
}
PANELS, PANEL_COLUMNS = 9, 3  # of the figure of places
MOST_CHANGED_PANELS = 6  # for places where before and after differ, if the error stands out elsewhere too
LEAST_PANELS = 3  # of its panels that are drawn in any case
VISIBLE = 0.05  # of the largest error of a panel: a difference that is seen
OUT_T = 4.0  # standard errors by which an error stands out
PIECE, PIECES = 2.0, 6  # s, duration of segments with nearly independent means; fewest for a standard error
STATE_UNITS = {"u": "m/s", "v": "m/s", "w": "m/s", "roll": "rad", "pitch": "rad", "z": "m"}
STATE_WORDS = {
    "u": "forward velocity u", "v": "sideward velocity v", "w": "downward velocity w", "roll": "roll", "pitch": "pitch",
    "z": "z (down)",
}  # fmt: skip
ERROR_SCALES = {"u": 1.0, "v": 1.0, "w": 1.0, "roll": 0.2, "pitch": 0.2, "z": 0.5}  # errors that are about as bad


def figures(tables: Mapping[str, pd.DataFrame], trim: Mapping[str, Any] | None = None) -> dict[str, Figure]:
    """{name: figure} of what the tables and the trim hold; what is not finite is not drawn.

    trim  "hover trim" of diagnosis.json
    """
    tables = {name: table.replace([np.inf, -np.inf], np.nan) for name, table in tables.items()}
    where = tables.get("forces_where")
    where = with_errors(where, tables.get("forces_residuals")) if where is not None and len(where) else None
    drawn = {
        "glance": glance_figure(where, tables.get("rollouts_overlays")),
        "trim": trim_figure(trim or {}),
        "unexplained": unexplained_figure(tables.get("forces_unexplained")),
        "where": where_figure(where),
        "spectra": spectra_figure(tables.get("forces_spectra")),
        "horizons": horizons_figure(tables.get("rollouts_errors")),
        "overlays": overlays_figure(tables.get("rollouts_overlays")),
    }
    return {name: figure for name, figure in drawn.items() if figure is not None}


def glance_figure(where: pd.DataFrame | None, overlays: pd.DataFrame | None) -> Figure | None:
    """What the extension changes, at a glance: the error along the place where it falls most surely, and the simulated
    state that comes nearest to the flight, in a typical window, see `overlays`. where  of `with_errors`"""
    kind = surest(where) if where is not None else None
    falls = overlays[overlays["why"] == TYPICAL] if overlays is not None and len(overlays) else None
    state = nearest(falls) if falls is not None and len(falls) else None
    if kind is None or state is None:
        return None
    figure = Figure(figsize=(FIGURE_WIDTH, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    _place(left, where, *kind)
    place = PLACE_LABELS[kind[1]].split(",")[0]
    left.set_title(f"error of the {CHANNEL_NAMES[kind[0]]} by {place}", fontsize=FONT_SIZE)
    _window(right, falls, state)
    _labelled(right, "time, s", f"{STATE_WORDS[state]}, {STATE_UNITS[state]}")
    right.set_title(f"simulated from one measured state, {falls['flight'].iloc[0]}", fontsize=FONT_SIZE)
    for panel in (left, right):
        panel.legend(fontsize=FONT_SIZE, frameon=False)
    return figure


def trim_figure(trim: Mapping[str, Any]) -> Figure | None:
    """What each rotor is asked for in steady flight, flight by flight, and the change with its 95 % interval; None
    where the trim shows no change. trim  "hover trim" of diagnosis.json"""
    if trim.get("word") not in ("named", "tied", "changed"):
        return None
    figure = Figure(figsize=(FIGURE_WIDTH, 3.0), layout="constrained")
    panel = figure.subplots()
    change, std = (np.array(trim["change"][k]) for k in ("value", "std"))
    rotors = np.arange(1, len(change) + 1)
    low, high = (100.0 * np.expm1(change + side * 1.96 * std) for side in (-1.0, 1.0))
    middle = 100.0 * np.expm1(change)
    drawn = {"fmt": "_", "ms": 18, "capsize": 6, "color": DARK_GREY, "zorder": 3}
    panel.errorbar(rotors, middle, [middle - low, high - middle], label="change, 95 % interval", **drawn)
    for role, color, side in (("reference", LIGHT_GREY, -0.15), ("compared", RED, 0.15)):
        asked = [100.0 * np.array(f["asked"]) for f in trim["flights"].values() if f["role"] == role]
        at = np.tile(rotors + side, len(asked))
        panel.plot(at, np.ravel(asked), "o", ms=5, color=color, label=f"{role} flights")
    panel.axhline(0.0, color=LIGHT_GREY, lw=0.8, zorder=1)
    panel.set_xticks(rotors, [f"rotor {i}" for i in rotors])
    _labelled(panel, "", "thrust asked for, change in %")
    panel.legend(fontsize=FONT_SIZE, frameon=False)
    return figure


def surest(table: pd.DataFrame) -> tuple[str, str] | None:
    """Channel and place along which mean errors fall by most, in their standard errors, squared, in sum over the bins;
    None where no sum exceeds OUT_T squared. A constant error that stays makes no fall. table  of `with_errors`"""
    best, most = None, OUT_T**2
    for kind, part in table[table["where"].isin(PLACE_LABELS)].groupby(["channel", "where"]):
        smaller = np.sign(part["mean_before"].abs() - part["mean_after"].abs())
        fall = smaller * ((part["mean_before"] - part["mean_after"]) / part["std_before"]) ** 2
        if fall.sum() > most:
            best, most = kind, float(fall.sum())
    return best


def nearest(window: pd.DataFrame) -> str | None:
    """The state whose error falls most, in steps that are worth as much; None where none falls."""
    fall = {}
    for state, step in ERROR_SCALES.items():
        old, new = (np.sqrt(np.mean((window[f"{state}_{word}"] - window[f"{state}_measured"]) ** 2)) for word in DRAWN)
        fall[state] = (old - new) / step
    best = max(fall, key=fall.get)
    return best if fall[best] > 0.0 else None


def where_figure(table: pd.DataFrame | None) -> Figure | None:
    """Mean residual of channels along places, before and after, on compared and held-out flights, where it matters.

    table  as returned by `with_errors`
    Drawn are the panels where before and after differ visibly and those where what is left stands out, PANELS at most.
    """
    if table is None:
        return None
    kinds = select_panels(table)
    figure, panels = _grid(len(kinds))
    for panel, (axis, place) in zip(panels, kinds):
        _place(panel, table, axis, place)
        panel.set_title(f"{CHANNEL_NAMES[axis]} by {PLACE_LABELS[place].split(',')[0]}", fontsize=FONT_SIZE)
    panels[0].legend(fontsize=FONT_SIZE, frameon=False)
    return figure


def _place(panel: Axes, table: pd.DataFrame, axis: str, place: str) -> None:
    """Mean errors of a channel along a place, before and after."""
    part = table[(table["channel"] == axis) & (table["where"] == place)].sort_values("middle")
    panel.axhline(0.0, color="0.8", lw=0.8)
    for word in ("before", "after"):
        look = DRAWN[word] | {"label": word, "elinewidth": DRAWN[word]["lw"] / 1.5, "ms": 2 * DRAWN[word]["lw"]}
        panel.errorbar(part["middle"], part[f"mean_{word}"], part[f"std_{word}"], fmt=".-", **look)
    _labelled(panel, PLACE_LABELS[place], f"{axis}, {_unit(axis)}")
    panel.ticklabel_format(axis="y", scilimits=(-3, 3))


def _window(panel: Axes, part: pd.DataFrame, state: str) -> None:
    """One state of one window: flown, and simulated before and after."""
    measured: dict[str, dict[str, Any]] = {"measured": {"color": DARK_GREY, "lw": 1.4, "zorder": 2.5}}
    for word, look in (measured | DRAWN).items():
        values = part[f"{state}_{word}"].to_numpy(float).copy()
        if STATE_UNITS[state] == "rad":  # no line across the panel where a vehicle that tumbles passes half a turn
            values[1:][np.abs(np.diff(values)) > np.pi] = np.nan
        panel.plot(part["t"], values, label=word, **look)


def with_errors(table: pd.DataFrame, rows: pd.DataFrame | None) -> pd.DataFrame:
    """Bins with "std_before" and "std_after", standard errors of their means; NaN with fewer than PIECES segments.

    Neighbouring rows err alike, so each flight's pieces of PIECE seconds count as one draw, weighed by their rows.
    """
    table = table.assign(std_before=np.nan, std_after=np.nan)
    if rows is None or not len(rows):
        return table
    rows = rows[rows["role"] != "reference"]
    pieces = pd.factorize(rows["flight"].astype(str) + " " + np.floor(rows["t"] / PIECE).astype(str))[0]
    bins = table[table["where"].isin([c for c in rows if c in PLACE_LABELS])]
    for (where, low, high), part in bins.groupby(["where", "low", "high"]):
        inside = rows[where].between(low, high).to_numpy()
        count = np.bincount(pieces[inside])
        if np.count_nonzero(count) < PIECES:
            continue
        share = np.count_nonzero(count) / (np.count_nonzero(count) - 1)
        for index, axis in part["channel"].items():
            for word in ("before", "after"):
                values = rows[f"{axis}_{word}"].to_numpy()[inside]
                away = np.bincount(pieces[inside], values - values.mean())
                table.loc[index, f"std_{word}"] = np.sqrt(share * float(away @ away)) / count.sum()
    return table


def select_panels(table: pd.DataFrame) -> list[tuple[str, str]]:
    """Channels and places worth a panel, in the order of channels and places.

    First where before and after differ most, then where the error that is left stands out most from its standard error;
    the strongest LEAST_PANELS in any case.
    """
    found = []
    for (axis, place), part in table[table["where"].isin(PLACE_LABELS)].groupby(["channel", "where"]):
        both = part[["mean_before", "mean_after"]].abs().to_numpy()
        scale = max(float(np.sqrt(np.mean(part["rms_before"] ** 2))), 1e-300)
        differs = float((part["mean_before"] - part["mean_after"]).abs().max())
        out = float((part["mean_after"].abs() / part["std_after"]).max())
        seen = differs > VISIBLE * max(float(both.max()), 1e-300) and differs > VISIBLE * scale
        found.append(((axis, place), differs / scale if seen else 0.0, out if out > OUT_T else 0.0, both.max() / scale))
    differ = [k for k, d, _, _ in sorted(found, key=lambda f: -f[1]) if d > 0.0]
    stands = [k for k, _, o, _ in sorted(found, key=lambda f: -f[2]) if o > 0.0]
    first = differ[: max(MOST_CHANGED_PANELS, PANELS - len([k for k in stands if k not in differ]))]
    chosen = list(dict.fromkeys([*first, *stands, *differ]))[:PANELS]
    if len(chosen) < LEAST_PANELS:
        chosen = list(dict.fromkeys([*chosen, *(k for k, *_ in sorted(found, key=lambda f: -f[3]))]))[:LEAST_PANELS]
    order = list(PLACE_LABELS)
    return sorted(chosen, key=lambda k: (AXES.index(k[0]), order.index(k[1])))


def _grid(count: int, height: float = 2.6) -> tuple[Figure, list[Axes]]:
    """A figure of the page's width with so many panels, PANEL_COLUMNS in a row."""
    columns = min(count, PANEL_COLUMNS)
    lines = -(-count // columns)
    figure = Figure(figsize=(FIGURE_WIDTH, height * lines + 0.3), layout="constrained")
    panels = list(figure.subplots(lines, columns, squeeze=False).flat)
    for panel in panels[count:]:
        panel.axis("off")
    return figure, panels[:count]


def _labelled(panel: Axes, across: str, up: str) -> None:
    """Labels and ticks that can be read at the page's width."""
    panel.set_xlabel(across, fontsize=FONT_SIZE)
    panel.set_ylabel(up, fontsize=FONT_SIZE)
    panel.tick_params(labelsize=FONT_SIZE, which="both")
    panel.yaxis.get_offset_text().set_fontsize(FONT_SIZE)


def _unit(axis: str) -> str:
    return "N" if axis[0] == "F" else "N m"


def unexplained_figure(table: pd.DataFrame | None) -> Figure | None:
    """What no cause explains, along the place where it lives: mean errors with their standard errors, and the fit."""
    if table is None or not len(table):
        return None
    kinds = list(table[["channel", "where"]].drop_duplicates().itertuples(index=False))
    figure, panels = _grid(len(kinds), 3.0)
    for panel, (channel, where) in zip(panels, kinds):
        part = table[(table["channel"] == channel) & (table["where"] == where)].sort_values("middle")
        panel.axhline(0.0, color="0.8", lw=0.8)
        panel.errorbar(part["middle"], part["mean"], part["std"], fmt=".", color=DARK_GREY, lw=1.0, label="error")
        panel.plot(part["middle"], part["fit"], color=RED, lw=1.2, label="smooth")
        unit = UNITS_AT.get(where, "")
        label = "distance from the place in the room" if where == "room place" else where
        _labelled(panel, f"{label}, {unit}" if unit else label, f"{channel}, {_unit(channel)}")
        panel.ticklabel_format(axis="y", scilimits=(-3, 3))
    panels[0].legend(fontsize=FONT_SIZE, frameon=False)
    return figure


def spectra_figure(table: pd.DataFrame | None) -> Figure | None:
    """Power density of the residuals of the held-out flights, or of the compared ones."""
    if table is None or not len(table):
        return None
    role = "held out" if (table["role"] == "held out").any() else "compared"
    figure = Figure(figsize=(FIGURE_WIDTH, 5.4), layout="constrained")
    for k, (panel, axis) in enumerate(zip(figure.subplots(2, 3, sharex=True).flat, AXES)):
        part = table[(table["role"] == role) & (table["channel"] == axis) & (table["frequency"] > 0)]
        for word, look in DRAWN.items():
            panel.loglog(part["frequency"], part[f"density_{word}"], label=word, **look)
        panel.set_title(f"{CHANNEL_NAMES[axis]} ({axis})", fontsize=FONT_SIZE)
        _labelled(panel, "frequency, Hz" if k >= 3 else "", "N²/Hz" if k < 3 else "(N m)²/Hz")
    figure.axes[0].legend(fontsize=FONT_SIZE, frameon=False)
    return figure


def horizons_figure(table: pd.DataFrame | None) -> Figure | None:
    """Root mean square errors at the end of roll-outs over their length: norms, and along the axes with trim."""
    if table is None or not len(table):
        return None
    figure = Figure(figsize=(FIGURE_WIDTH, 9.6), layout="constrained")
    panels = figure.subplots(4, 3)
    norms = [*panels[0], panels[1, 0]]
    for panel, (quantity, unit) in zip(norms, ERROR_UNITS.items()):
        for driven, style in (("rollouts", "-"), ("rollouts from commands", "--")):
            _horizons(panel, table[table["driven"] == driven], quantity, style, driven == "rollouts from commands")
        _framed(panel, f"error of {CHANNEL_NAMES[quantity]}", unit)
    line = "rollouts with trim" if (table["driven"] == "rollouts with trim").any() else "rollouts"
    for panel, quantity in zip(panels[2:].flat, [f"{q} {a}" for q in ("velocity", "rate") for a in "xyz"]):
        _horizons(panel, table[table["driven"] == line], quantity, "-", False)
        tail = ", trim taken up" if line == "rollouts with trim" else ""
        _framed(panel, f"error of {CHANNEL_NAMES[quantity]}{tail}", ERROR_UNITS[quantity.split()[0]])
    for panel in panels[1, 1:]:
        panel.axis("off")
    panels[1, 1].legend(*panels[0, 0].get_legend_handles_labels(), fontsize=FONT_SIZE, frameon=False, loc="upper left")
    return figure


def _horizons(panel: Axes, table: pd.DataFrame, quantity: str, style: str, commands: bool) -> None:
    """Before, after and floor of one quantity; the floor is not above what was reached."""
    reached = None
    floor = {"color": LIGHT_GREY, "lw": 1.2, "zorder": 1}  # what was reached is seen where it is the floor
    for word, look in (*DRAWN.items(), ("noise_floor", floor)):
        part = table[table["model"] == word]
        if quantity not in part or not len(part):
            continue
        found = part.groupby("horizon")[quantity].apply(lambda v: float(np.sqrt(v.pow(2).mean())))
        if word == "noise_floor" and reached is not None:
            found = np.minimum(found, reached)
        reached = found
        label = word.replace("_", " ") if not commands else "the same, with commands" if word == "after" else None
        panel.plot(found.index, found.to_numpy(), style, marker=".", label=label, **look)


def _framed(panel: Axes, title: str, unit: str) -> None:
    """Axes that begin at nothing, so that a small gain looks small."""
    panel.set_title(title, fontsize=FONT_SIZE)
    _labelled(panel, "time simulated, s", f"error, {unit}")
    tops = [np.nanmax(line.get_ydata()) for line in panel.get_lines() if np.isfinite(line.get_ydata()).any()]
    panel.set_xlim(left=0.0)
    panel.set_ylim(0.0, 1.08 * max(tops) if tops and max(tops) > 0.0 else None)


def overlays_figure(table: pd.DataFrame | None) -> Figure | None:
    """A few windows: what was flown, and what the model and the extended model make of the same rotor speeds."""
    if table is None or not len(table):
        return None
    numbers = sorted(table["window"].unique())
    figure = Figure(figsize=(FIGURE_WIDTH, 9.5), layout="constrained")
    panels = figure.subplots(len(STATE_UNITS), len(numbers), sharex="col", squeeze=False)
    for column, number in enumerate(numbers):
        part = table[table["window"] == number]
        for row, (state, unit) in enumerate(STATE_UNITS.items()):
            panel = panels[row, column]
            _window(panel, part, state)
            _labelled(panel, "time, s" if state == [*STATE_UNITS][-1] else "", f"{state}, {unit}")
        panels[0, column].set_title(f"{part['flight'].iloc[0]}: {part['why'].iloc[0]}", fontsize=FONT_SIZE)
    panels[0, 0].legend(fontsize=FONT_SIZE, frameon=False)
    return figure
