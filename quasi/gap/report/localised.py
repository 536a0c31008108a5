"""Where errors are greatest, along the places of the tables sensors_where to rollouts_where: a table of the page."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from quasi.gap.report.names import listed
from quasi.gap.report.wording import CHANNEL_NAMES, ranges_of
from quasi.pages import frame as report

RATIO = 1.5  # times the root mean square elsewhere, from which a place is listed
FURTHER = 2  # further places of an error
LEVELS_WITH_PLACES = ("sensors", "drive", "forces", "rollouts")
PLACE_NAMES = {"t": "time", "volts": "battery voltage"}  # of places; the others are called as their column
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

    table  the rows of one channel of a table of `residual_tables.where`; places with a single bin are left out
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
        far = [g for g in greatest(part) if g.times >= RATIO]
        if not far:
            alike.append(name)
            continue
        name += f", {part['unit'].iloc[0]}{after}"
        sizes = [report.format_number(far[0].elsewhere), report.format_number(far[0].there)]
        lines.append([name, *sizes, _place_text(far[0]), "; ".join(map(_place_text, far[1 : 1 + FURTHER])) or "–"])
    if not lines:
        return (
            report.render_paragraph(f"No error is {RATIO:g} times as large in one place as elsewhere.") if alike else ""
        )
    head = ["root mean square before the extension", "elsewhere", "there", "greatest at", f"{RATIO:g} times or more at"]
    rest = f" Nowhere that much greater: {listed(dict.fromkeys(alike))}." if alike else ""
    return report.render_table(head, lines, words=(3, 4)) + report.render_paragraph(
        "Each place is cut into bins of equally many rows, and the worst one is compared with the others. Places go "
        "together, such as a fresh battery and the take-off: a listed place is where to look, not the cause." + rest
    )


def _channels(where: Mapping[str, pd.DataFrame], horizon: float) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """What an error is called, after how long a simulation, and its rows, level by level."""
    for level in LEVELS_WITH_PLACES:
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
            yield CHANNEL_NAMES.get(str(channel), str(channel)), after, part


def _place_text(found: Greatest) -> str:
    name = PLACE_NAMES.get(found.place, found.place.replace("_", " "))
    where = "time" if found.place == "t" else found.place.replace("_", " ")
    return f"{name} {ranges_of(where, [[found.low, found.high]]).removeprefix('at ')}"
