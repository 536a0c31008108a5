"""Where along a place a smooth function is large: ranges that a pilot can go and look at."""

from collections.abc import Sequence

import numpy as np

from quasi.gap.evidence import Evidence
from quasi.gap.places import HEADING, ROOM, Basis, Choice, places

CELLS = 24  # along a place
MOSTLY = 0.7  # of the largest value
VISITED = 0.005  # share of the time in a cell below which it counts as not visited


def whereabouts(
    basis: Basis, choice: Choice, value: np.ndarray, flights: Sequence[Evidence], compared: Sequence[bool]
) -> list[list[float]]:
    """Ranges [low, high] of the place where the function is mostly at work; of the room, the middle [x, y] of it.

    value  of the function's parameters. The function counts from its mean, for a constant is a flight's own affair.
    """
    use = [f for f, flag in zip(flights, compared) if flag] or list(flights)
    function = np.concatenate([basis.functions(f)[:, list(choice.which)] @ value for f in use])
    function = np.abs(function - function.mean())
    known = [places(f) for f in use]
    if choice.where == ROOM and len(choice.which) == 1:
        return [list(basis.spots[choice.which[0] - basis.first_spot][:2])]
    if choice.where == ROOM:
        x, y = (np.concatenate([k[f"room {a}"] for k in known]) for a in "xy")
        top = function >= np.quantile(function, 0.95)
        return [[float(np.median(x[top])), float(np.median(y[top]))]]
    x = np.concatenate([k[choice.where] for k in known])
    low, high = (-np.pi, np.pi) if choice.where == HEADING else basis.scales[choice.where]
    if choice.where == HEADING:
        x = np.angle(np.exp(1j * x))
    cell = np.clip(((x - low) / (high - low) * CELLS).astype(int), 0, CELLS - 1)
    count = np.bincount(cell, minlength=CELLS)
    mean = np.bincount(cell, function, CELLS) / np.maximum(count, 1)
    mean[count < VISITED * len(x)] = 0.0
    large = mean >= MOSTLY * mean.max()
    edges = np.linspace(low, high, CELLS + 1)
    ranges: list[list[float]] = []
    for k in np.flatnonzero(large):
        if ranges and np.isclose(ranges[-1][1], edges[k]):
            ranges[-1][1] = float(edges[k + 1])
        else:
            ranges.append([float(edges[k]), float(edges[k + 1])])
    if choice.where == HEADING and len(ranges) > 1 and large[0] and large[-1]:
        ranges[0][0] = ranges.pop()[0] - 2.0 * np.pi  # one range across the south
    return ranges
