"""Choice of structure by flights that were left out, and how often resampled data choose the same terms.

Both work on the products of the few dozen columns that came near being chosen, kept per cell: another set of flights,
or a resample of stretches, is another weight of the cells, and no row is read again.

Source: Hastie, Tibshirani & Friedman, The Elements of Statistical Learning, 2009, sections 7.10 (one standard error
rule), 7.11; Künsch, Annals of Statistics 17(3), 1989 (block bootstrap); Sauerbrei & Schumacher, Statistics in Medicine
11(16), 1992 (inclusion frequencies).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from quasi.errors import DataError
from quasi.identification.evidence import Totals
from quasi.identification.offsets import TARGET_ROUNDING
from quasi.identification.products import Products
from quasi.identification.stepwise import Options, select, start

WHOLE_FLIGHTS = 8  # from so many flights on, flights are resampled rather than stretches


def leave_one_flight_out(products: Products, cap: int, describe: Sequence[str], constant: bool) -> dict[str, Any]:
    """Number of forward steps that predicts left-out flights best.

    For each flight the terms are chosen and fitted on the others and judged on it, step by step. The fewest steps are
    taken whose error is not larger than the smallest by more than one standard error of the difference over flights.
    Returns {"steps", "smallest at", "RMSE": [of steps 0, 1, ...]}; raises DataError with fewer than two flights.
    """
    flights = np.unique(products.flight)
    if len(flights) < 2:
        raise DataError(
            "the structure is to be chosen by leaving one flight out, but there is one training flight; "
            "name more, or set 'structure choice' to 'entry test'"
        )
    errors = np.array([_errors(products, products.flight == f, cap, describe, constant) for f in flights])
    whole = errors.sum(axis=0)
    best = int(np.argmin(whole))
    worse = errors - errors[:, [best]]
    doubt = np.sqrt(len(flights)) * worse.std(axis=0, ddof=1)
    steps = int(np.flatnonzero(worse.sum(axis=0) <= doubt)[0])
    rmse = np.sqrt(whole / products.rows.sum())
    return {"steps": steps, "smallest at": best, "RMSE": rmse.tolist()}


def _errors(products: Products, held: np.ndarray, cap: int, describe: Sequence[str], constant: bool) -> np.ndarray:
    # squared error on the held-out cells after 0 .. cap steps on the others
    train, test = Totals(products, ~held), Totals(products, held)
    state = start(train, {}, describe, constant)
    errors = []
    for number in range(cap + 1):
        if number:
            gain = state.gain()
            pick = int(np.argmax(gain))
            if gain[pick] <= 0.0:
                errors += [errors[-1]] * (cap + 1 - number)
                break
            state.add(pick)
        theta = train.inverse(state.columns) @ train.target[state.columns]
        fitted = theta @ test.gram(state.columns) @ theta - 2.0 * theta @ test.target[state.columns]
        left = test.target_square + fitted
        errors.append(left if left > TARGET_ROUNDING * test.target_square else 0.0)
    return np.array(errors)


def inclusion(
    products: Products,
    options: Options,
    describe: Sequence[str],
    constant: bool,
    resamples: int,
    bandwidth: int,
) -> dict[str, Any]:
    """Share of resamples in which each column is chosen.

    products   all products among the columns that matter, per cell
    bandwidth  cells over which the residuals resemble each other; a resampled stretch is at least so long
    Returns {"resamples", "of": "flights" or "stretches", "units", "share": (m,), "together": (resamples, m) bool}.
    A resample in which a fixed regressor cannot be separated from the others counts as one that chose nothing.
    """
    flights = np.unique(products.flight)
    blocks = products.merged(_blocks(products.flight, bandwidth))
    by_flight = len(flights) >= WHOLE_FLIGHTS
    unit = np.searchsorted(flights, blocks.flight) if by_flight else np.arange(len(blocks.rows))
    count = int(unit.max()) + 1
    options = replace(options, pool=options.pool or products.size - products.fixed)
    generator = np.random.default_rng(0)
    chosen = np.zeros((resamples, products.size), bool)
    for row in chosen:
        weights = np.bincount(generator.integers(0, count, count), minlength=count)[unit]
        try:
            row[select(blocks, options, describe, weights=weights, constant=constant).chosen] = True
        except DataError:
            continue
    return {
        "resamples": resamples,
        "of": "flights" if by_flight else "stretches",
        "units": count,
        "share": chosen.mean(axis=0),
        "together": chosen,
    }


def _blocks(flight: np.ndarray, length: int) -> np.ndarray:
    """Number of the stretch of each cell: `length` neighbouring cells of one flight, the last one may be longer."""
    numbers, following = np.zeros(len(flight), int), 0
    for f in np.unique(flight):
        cells = np.flatnonzero(flight == f)
        count = max(len(cells) // length, 1)
        numbers[cells] = following + np.minimum(np.arange(len(cells)) // length, count - 1)
        following += count
    return numbers
