"""Errors that come back within a second: flight makes these, noise of instruments does not."""

from collections.abc import Sequence

import numpy as np

from quasi.filtering.forces import half_length
from quasi.gap.statistics.whitening import stretches

MEMORY_S = 1.0  # s: what errors of a model that come from flight, and not from instruments, repeat within


def lags_of_flight(cutoffs: Sequence[float | None], rate: float) -> tuple[int, int] | None:
    """First and one past the last lag, samples, of errors that flight makes: beyond what a low-pass mixes.

    cutoffs  Hz of each flight's low-pass, rate  Hz. None where one is unknown or mixes more than a quarter of MEMORY_S
    """
    if not cutoffs or None in cutoffs:
        return None
    mixed, memory = 2 * half_length(min(cutoffs), rate) + 1, round(MEMORY_S * rate)
    return None if 4 * mixed > memory else (mixed, memory)


def lagged_products(values: np.ndarray, breaks: np.ndarray, first: int, last: int) -> np.ndarray:
    """Sums (last - first, C) of products of values (n, C), without their mean, at lags from `first` to before `last`.

    breaks (n,) bool, True where a run without gaps begins
    """
    centred, products = values - values.mean(axis=0), np.zeros((last - first, values.shape[1]))
    for part in stretches(breaks):
        x = centred[part]
        for lag in range(first, last):
            products[lag - first] += np.sum(x[lag:] * x[: max(len(x) - lag, 0)], axis=0)
    return products
