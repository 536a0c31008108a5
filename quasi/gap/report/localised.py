"""Where errors are greatest, along the places of the tables sensors_where to rollouts_where: a table of the page."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from quasi.gap.report.wording import CHANNELS, listed, ranges_of
from quasi.pages import frame as report

FAR = 1.5  # times the root mean square elsewhere: a place that is told
ALSO = 2  # further places of an error
LEVELS = ("sensors", "drive", "forces", "rollouts")
NAMES = {"t": "time", "volts": "battery voltage"}  # of places; the others are called as their column
NORMS = ("position", "velocity", "attitude", "rate")


class Greatest(NamedTuple):
    """An error where it is greatest along a place: the column's name, its range there, root mean squares there and
    elsewhere in the channel's unit."""

    place: str
    low: float
    high: float
    there: float
    elsewhere: float

    @property
    def times(self) -> float:
        """How many times the error elsewhere it is."""
        return self.there / max(self.elsewhere, 1e-300)


def greatest(table: pd.DataFrame) -> list[Greatest]:
    """The bin of each place where the error of one channel before the extension is greatest, the furthest out first.

    table  the rows of one channel of a table of `residual_tables.where`; places with a single bin tell nothing
    """
    found = []
    for place, part in table.groupby("where"):
        rows, square = part["rows"].to_numpy(float), part["rows"].to_numpy(float) * part["rms_before"].to_numpy() ** 2
        if len(part) < 2:
            continue
        there, elsewhere = square / rows, (square.sum() - square) / (rows.sum() - rows)
        k = int(np.argmax(there / np.maximum(elsewhere, 1e-300)))
        low, high = (float(part[name].iloc[k]) for name in ("low", "high"))
        found.append(Greatest(str(place), low, high, float(np.sqrt(there[k])), float(np.sqrt(elsewhere[k]))))
    return sorted(found, key=lambda g: -g.times)


def table_of(where: Mapping[str, pd.DataFrame], horizon: float) -> str:
    """The table of the page: errors that are far greater somewhere, and where; a sentence where none is.

    where  {level: its table of places}; horizon  s, of the simulations of roll-outs nearest to
    """
    lines, alike = [], []
    for name, after, part in _channels(where, horizon):
        far = [g for g in greatest(part) if g.times >= FAR]
        if not far:
            alike.append(name)
            continue
        name += f", {part['unit'].iloc[0]}{after}"
        sizes = [report.format_number(far[0].elsewhere), report.format_number(far[0].there)]
        lines.append([name, *sizes, _told(far[0]), "; ".join(map(_told, far[1 : 1 + ALSO])) or "–"])
    if not lines:
        return (
            report.render_paragraph(f"No error is {FAR:g} times as large in one place as elsewhere.") if alike else ""
        )
    head = ["root mean square before the extension", "elsewhere", "there", "greatest at", f"{FAR:g} times or more at"]
    rest = f" Nowhere that much greater: {listed(dict.fromkeys(alike))}." if alike else ""
    return report.render_table(head, lines, words=(3, 4)) + report.render_paragraph(
        "Each place is cut into bins of equally many rows, and the worst one is set beside the others. Places go "
        "together (a fresh battery and the take-off, say): a place that is told is where to look, not what does it."
        + rest
    )


def _channels(where: Mapping[str, pd.DataFrame], horizon: float) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """What an error is called, after how long a simulation, and its rows, level by level."""
    for level in LEVELS:
        table = where.get(level)
        if table is None or not len(table):
            continue
        after = ""
        if level == "rollouts":
            table = table[(table["driven"] == "rollouts") & table["channel"].isin(NORMS)]
            if not len(table):
                continue
            nearest = min(table["horizon"].unique(), key=lambda h: abs(h - horizon))
            table, after = table[table["horizon"] == nearest], f", simulated for {nearest:g} s"
        for channel, part in table.groupby("channel", sort=False):
            yield CHANNELS.get(str(channel), str(channel)), after, part


def _told(found: Greatest) -> str:
    name = NAMES.get(found.place, found.place.replace("_", " "))
    where = "time" if found.place == "t" else found.place.replace("_", " ")
    return f"{name} {ranges_of(where, [[found.low, found.high]]).removeprefix('at ')}"
