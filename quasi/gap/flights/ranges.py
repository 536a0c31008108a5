"""Where along a place a smooth function is large: ranges that a pilot can go and look at, and a figure's numbers."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pandas as pd

from quasi.gap.flights.covariates import EVERYWHERE, HEADING, ROOM_PLACE, Basis, Choice, places
from quasi.gap.flights.evidence import Evidence

RANGE_CELLS = 24  # along a place
MOSTLY = 0.7  # of the largest value
VISITED_CELL = 0.005  # share of the time in a cell below which it counts as not visited


def find_ranges(
    basis: Basis, choice: Choice, value: np.ndarray, flights: Sequence[Evidence], compared: Sequence[bool]
) -> list[list[float]]:
    """Ranges [low, high] of the place where the function is mostly at work; of the room, the middle [x, y] of it.

    value  of the function's parameters. The function counts from its mean, for a constant is a flight's own affair.
    """
    if choice.where == EVERYWHERE:
        return []
    use = [f for f, flag in zip(flights, compared) if flag] or list(flights)
    function = np.concatenate([basis.functions(f, choice.which) @ value for f in use])
    function = np.abs(function - function.mean())
    known = [places(f) for f in use]
    if choice.where == ROOM_PLACE and choice.at:
        return [list(choice.at)]
    if choice.at:
        return [[choice.at[0], max(float(f.t[-1]) for f in use)]]
    if choice.where == ROOM_PLACE:
        x, y = (np.concatenate([k[f"room {a}"] for k in known]) for a in "xy")
        top = function >= np.quantile(function, 0.95)
        return [[float(np.median(x[top])), float(np.median(y[top]))]]
    x = np.concatenate([k[choice.where] for k in known])
    low, high = (-np.pi, np.pi) if choice.where == HEADING else basis.scales[choice.where]
    if choice.where == HEADING:
        x = np.angle(np.exp(1j * x))
    cell = np.clip(((x - low) / (high - low) * RANGE_CELLS).astype(int), 0, RANGE_CELLS - 1)
    count = np.bincount(cell, minlength=RANGE_CELLS)
    mean = np.bincount(cell, function, RANGE_CELLS) / np.maximum(count, 1)
    mean[count < VISITED_CELL * len(x)] = 0.0
    large = mean >= MOSTLY * mean.max()
    edges = np.linspace(low, high, RANGE_CELLS + 1)
    ranges: list[list[float]] = []
    for k in np.flatnonzero(large):
        if ranges and np.isclose(ranges[-1][1], edges[k]):
            ranges[-1][1] = float(edges[k + 1])
        else:
            ranges.append([float(edges[k]), float(edges[k + 1])])
    if choice.where == HEADING and len(ranges) > 1 and large[0] and large[-1]:
        ranges[0][0] = ranges.pop()[0] - 2.0 * np.pi  # one range across the south
    return ranges


def profile(
    basis: Basis, choice: Choice, value: np.ndarray, flights: Sequence[Evidence], left: Sequence[np.ndarray]
) -> pd.DataFrame:
    """Mean of a residual and of the function that stands for it in cells along a place: middle, mean, std, fit.

    left (n,) of each flight: what everything but this function leaves of the channel. Both count from each flight's
    mean. std  of the mean, from that of the flights' parts in the cell. Of a place in the room: over the distance.
    """
    parts = []
    middle = find_ranges(basis, choice, value, flights, [True] * len(flights))
    for number, (flight, rest) in enumerate(zip(flights, left)):
        known = places(flight)
        if choice.where == ROOM_PLACE:
            [[x, y]] = middle
            along = np.hypot(known["room x"] - x, known["room y"] - y)
        else:
            along = known[choice.where]
        along = np.angle(np.exp(1j * along)) if choice.where == HEADING else along
        function = basis.functions(flight, choice.which) @ value
        block = number * 10_000 + ((flight.t - flight.t[0]) / 5.0).astype(int)
        parts.append(
            pd.DataFrame({"at": along, "mean": rest - rest.mean(), "fit": function - function.mean(), "block": block})
        )
    table = pd.concat(parts, ignore_index=True)
    edges = np.unique(np.quantile(table["at"], np.linspace(0.0, 1.0, RANGE_CELLS // 2 + 1)))
    rows = []
    for low, high in pairwise(edges):
        cell = table[(table["at"] >= low) & (table["at"] <= high)]
        blocks = cell.groupby("block")["mean"].mean()
        spread = float(blocks.std() / np.sqrt(len(blocks))) if len(blocks) > 1 else float("nan")
        rows.append({"middle": float(cell["at"].median()), "mean": float(cell["mean"].mean()), "std": spread,
                     "fit": float(cell["fit"].mean()), "rows": len(cell)})  # fmt: skip
    return pd.DataFrame(rows)
