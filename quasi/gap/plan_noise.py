"""What a simulation's forces and moments are expected to be off by before anything has flown.

Three parts: slow unrest of the air, the band-limited noise of measured forces and moments, and errors of the model
itself, whose terms hold a little differently in every manoeuvre. The defaults are those of made flights of a 0.43 kg
quadrotor with gusts of 0.1-0.4 m/s, motion capture and on-board filters, against a model identified from six other
such flights, as shares of the weight and of weight times arm.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.linalg import solve_toeplitz
from scipy.signal import firwin, freqz

from quasi.errors import DataError
from quasi.gap.effect import Vehicle
from quasi.gap.study import BAND, ORDER
from quasi.gap.whitening import RIDGE, Whitener, autoregression, thin
from quasi.standalone.model import AXES, Model

# one-sided power densities of the residual, shares squared per Hz: slow / (1 + (f / corner)^2)^1.5 + white
SLOW = np.array([2.1e-4, 2.1e-4, 1.0e-4, 7.5e-6, 7.5e-6, 0.0])
CORNER = np.array([0.6, 0.6, 1.2, 0.7, 0.7, 1.0])  # Hz
WHITE = np.array([9e-7, 9e-7, 2e-6, 7e-7, 7e-7, 6e-8])
# shares by which the model's terms differ from stretch to stretch: of forces, of moments, and of the rotors' reaction
# to being accelerated, which hangs on the timing of the rotor telemetry
FORCES, MOMENTS, SLOPES = 0.002, 0.02, 0.1
DRAWS = 8  # residuals that a plan is judged by
GRID = 2048  # frequencies of the integral


def units(vehicle: Vehicle) -> np.ndarray:
    """(6,) N and N m that the shares are of."""
    return vehicle.weight * np.array([1.0, 1.0, 1.0, *[vehicle.arm] * 3])


def usual(vehicle: Vehicle, rate: float) -> Whitener:
    """Whitener of the default noise for a flight at `rate` Hz, in the band of the analysis."""
    half = round(rate / BAND)
    weights = firwin(2 * half + 1, BAND, fs=rate, window=("kaiser", 5.0))
    every = max(int(rate / (2.8 * BAND)), 1)
    f, gain = freqz(weights, worN=GRID, fs=rate)
    lags = np.cos(2.0 * np.pi * np.outer(np.arange(ORDER + 1) * every / rate, f))
    coefficients, scale = np.ones((6, ORDER + 1)), np.ones(6)
    for c, unit in enumerate(units(vehicle)):
        density = (SLOW[c] / (1.0 + (f / CORNER[c]) ** 2) ** 1.5 + WHITE[c]) * unit**2 * np.abs(gain) ** 2
        covariance = lags @ density * (f[1] - f[0])
        covariance[0] *= 1.0 + RIDGE
        own = solve_toeplitz(covariance[:-1], covariance[1:])
        coefficients[c, 1:] = -own
        scale[c] = np.sqrt(covariance[0] - own @ covariance[1:])
    return Whitener(coefficients, scale)


def of_residuals(table: pd.DataFrame, where: str) -> Whitener:
    """Whitener of what a gap left of forces and moments: its table W_residuals. Raises DataError for another table."""
    names = [f"{axis}_after" for axis in AXES]
    missing = [n for n in ("t", "flight", *names) if n not in table]
    if missing:
        raise DataError(f"{where} has no column '{missing[0]}'; make the gap anew")
    parts = []
    for _, flight in table.groupby("flight", sort=False):
        t = flight["t"].to_numpy(float)
        steps = np.diff(t)
        breaks = np.concatenate([[True], steps > 1.5 * np.median(steps)])
        parts.append(thin(flight[names].to_numpy(float)[:, :, None], breaks, t, BAND, 2 * ORDER))
    parts = [p for p in parts if len(p.rows)]
    if not parts:
        raise DataError(f"{where} holds no second of residuals without a gap; leave the gap out of the plan")
    return autoregression([p.columns[:, :, 0] for p in parts], [p.breaks for p in parts], ORDER)


def drawn(
    gram: np.ndarray, rows: int, shared: Sequence[int], doubt: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Cross-products (P + DRAWS - 1, ...) of one stretch with residuals drawn in place of column 0 and at the end.

    gram  (P, P) of whitened columns; rows  numbers in each of them; shared  the model's own terms; doubt  how
    much their coefficients are off in a stretch, standard deviations
    """
    size = len(gram)
    known = gram[1:, 1:]
    unit = np.sqrt(np.maximum(np.diag(known), 1e-300))
    values, vectors = np.linalg.eigh(known / np.outer(unit, unit))
    root = unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    result = np.zeros((size + DRAWS - 1,) * 2)
    result[1:size, 1:size] = known
    own = np.array(shared) - 1
    for place in targets(size):
        noise = rng.standard_normal(size - 1)
        off = np.zeros(size - 1)
        off[own] = doubt * rng.standard_normal(len(own))
        cross = known @ off + root @ noise
        result[place, 1:size] = result[1:size, place] = cross
        beyond = max(rows - (size - 1), 0)
        result[place, place] = noise @ noise + beyond + off @ known @ off + 2.0 * off @ root @ noise
    return result


def repeated(gram: np.ndarray) -> np.ndarray:
    """Cross-products of a stretch whose residual was measured, laid out as those of `drawn`."""
    place = [*range(len(gram)), *[0] * (DRAWS - 1)]
    return gram[np.ix_(place, place)]


def targets(size: int) -> list[int]:
    """Places of the residuals among the columns of `drawn`. size  P, of the columns that there are"""
    return [0, *range(size, size + DRAWS - 1)]


def doubts(model: Model) -> np.ndarray:
    """(S,) standard deviations of the coefficients of a model's own terms from stretch to stretch."""
    shares = []
    for k, axis in enumerate(AXES):
        for term in model.document["axes"].get(axis, {"terms": []})["terms"]:
            share = SLOPES if axis == "Mz" and "_dot" in term["expression"] else FORCES if k < 3 else MOMENTS
            shares.append(share * abs(term["coefficient"]))
    return np.array(shares)
