"""Measurements and predictions, thinned for a page."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from quasi.scoring.score import AxisComparison

MAX_PAGE_ROWS = 24_000  # rows; half of them are the held-out flights'
MAX_PAGE_RATE = 125.0  # Hz


def thin_rows(comparisons: Mapping[str, AxisComparison], validation: Sequence[str]) -> pd.DataFrame:
    """Thin the rows of all axes for the page.

    comparisons  of `compare_with_measurements`; validation  held-out flights, which get half of the rows
    Returns columns flight, t (s), start (1 after a gap), held (1 on held-out flights), and per axis its measurement
    under its name, <axis>_model, and <axis>_half, half the width of its interval.
    """
    some = next(iter(comparisons.values()))
    of_flight = [np.flatnonzero(some.flight == k) for k in range(len(some.keys))]
    held = [key in validation for key in some.keys]
    counts = {h: sum(len(rows) for rows, is_held in zip(of_flight, held) if is_held == h) for h in (True, False)}
    most = MAX_PAGE_ROWS // 2 if counts[True] and counts[False] else MAX_PAGE_ROWS
    picked, start = [np.zeros(0, int)], [np.zeros(0, bool)]
    for rows, is_held in zip(of_flight, held):
        if len(rows) < 2:
            continue
        step = float(np.median(np.diff(some.t[rows])))
        every = max(-(-counts[is_held] // most), round(1.0 / (MAX_PAGE_RATE * step)), 1)
        picked.append(rows[::every])
        start.append(np.concatenate([[True], np.diff(some.t[picked[-1]]) > 8 * every * step]))
    chosen, starts = np.concatenate(picked), np.concatenate(start)
    number = some.flight[chosen]
    table: dict[str, Any] = {
        "flight": np.array(some.keys, object)[number],
        "t": some.t[chosen],
        "start": starts.astype(float),
        "held": np.array(held, float)[number],
    }
    for axis, found in comparisons.items():
        table[axis] = found.measured[chosen]
        table[f"{axis}_model"] = found.predicted[chosen]
        table[f"{axis}_half"] = 0.5 * (found.upper - found.lower)[chosen]
    return pd.DataFrame(table)


def list_thinned_units(axes: Sequence[str]) -> dict[str, tuple[str, str, str]]:
    """Units of the columns of `thin_rows`."""
    return {
        "flight": ("", "", "flight key"),
        "start": ("1", "", "1 on the first row after a gap"),
        "held": ("1", "", "1 on held-out flights"),
    } | {
        f"{axis}_{what}": ("N" if axis[0] == "F" else "N m", "body FRD", text)
        for axis in axes
        for what, text in (("model", "prediction"), ("half", "half the width of the prediction interval"))
    }
