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
from quasi.gap.levels.forces.design import BAND, LIGHT, ORDER
from quasi.gap.statistics.mixed import marginal
from quasi.gap.statistics.whitening import WHITENING_RIDGE, Whitener, autoregression, thin
from quasi.model.model import AXES, Model

# one-sided power densities of the residual, shares squared per Hz: slow / (1 + (f / corner)^2)^1.5 + white
SLOW_PSD = np.array([2.1e-4, 2.1e-4, 1.0e-4, 7.5e-6, 7.5e-6, 0.0])
CORNER_HZ = np.array([0.6, 0.6, 1.2, 0.7, 0.7, 1.0])  # Hz
WHITE_PSD = np.array([9e-7, 9e-7, 2e-6, 7e-7, 7e-7, 6e-8])
# shares by which the model's terms differ from stretch to stretch: of forces, of moments, and of the rotors' reaction
# to being accelerated, which hangs on the timing of the rotor telemetry
FORCE_DOUBT, MOMENT, REACTION = 0.005, 0.03, 0.05
NOISE_DRAWS = 4  # residuals that a plan is judged by
FREQUENCIES = 2048  # frequencies of the integral


def units(vehicle: Vehicle) -> np.ndarray:
    """(6,) N and N m that the shares are of."""
    return vehicle.weight * np.array([1.0, 1.0, 1.0, *[vehicle.arm] * 3])


def usual(vehicle: Vehicle, rate: float) -> Whitener:
    """Whitener of the default noise for a flight at `rate` Hz, in the band of the analysis."""
    half = round(rate / BAND)
    weights = firwin(2 * half + 1, BAND, fs=rate, window=("kaiser", 5.0))
    every = max(int(rate / (2.8 * BAND)), 1)
    f, gain = freqz(weights, worN=FREQUENCIES, fs=rate)
    lags = np.cos(2.0 * np.pi * np.outer(np.arange(ORDER + 1) * every / rate, f))
    coefficients, scale = np.ones((6, ORDER + 1)), np.ones(6)
    for c, unit in enumerate(units(vehicle)):
        density = (SLOW_PSD[c] / (1.0 + (f / CORNER_HZ[c]) ** 2) ** 1.5 + WHITE_PSD[c]) * unit**2 * np.abs(gain) ** 2
        covariance = lags @ density * (f[1] - f[0])
        covariance[0] *= 1.0 + WHITENING_RIDGE
        own = solve_toeplitz(covariance[:-1], covariance[1:])
        coefficients[c, 1:] = -own
        scale[c] = np.sqrt(covariance[0] - own @ covariance[1:])
    return Whitener(coefficients, scale)


def of_residuals(table: pd.DataFrame, where: str) -> Whitener:
    """Whitener of the residuals of forces and moments of a gap, its table forces_residuals.

    Raises DataError for another table.
    """
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
    gram: np.ndarray, rows: int, shared: Sequence[int], doubt: np.ndarray, number: int, rng: np.random.Generator
) -> np.ndarray:
    """Cross-products (P + number, ...) of one stretch with residuals drawn and put behind the columns.

    gram  (P, P) of whitened columns; rows  numbers in each of them; shared  the model's own terms; doubt  how
    much their coefficients are off in a stretch, standard deviations
    """
    size = len(gram)
    known = gram[1:, 1:]
    unit = np.sqrt(np.maximum(np.diag(known), 1e-300))
    values, vectors = np.linalg.eigh(known / np.outer(unit, unit))
    root = unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    noise = rng.standard_normal((size - 1, number))
    off = np.zeros((size - 1, number))
    off[np.array(shared) - 1] = doubt[:, None] * rng.standard_normal((len(shared), number))
    beyond = max(rows - (size - 1), 0)
    squares = (noise**2).sum(axis=0) + beyond + (off * (known @ off)).sum(axis=0) + 2.0 * (off * (root @ noise)).sum(0)
    return _behind(gram, known @ off + root @ noise, squares)


def repeated(
    grams: np.ndarray, shared: Sequence[int], nuisance: Sequence[int], spread: np.ndarray, number: int,
    rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """Cross-products (K, P + number, ...) of a flight's stretches with its own residual for other flights put behind.

    What the model's terms and the flight's nuisances, fitted to it, leave is taken with a sign drawn for each stretch:
    other flights err as much, not alike. Source of the signs: Wu, Jackknife, bootstrap and other resampling methods,
    Annals of Statistics 14, 1986, section 7.
    """
    total = marginal(grams.sum(axis=0), nuisance, spread)
    scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
    base = list(shared)
    inner = (total / np.outer(scale, scale))[np.ix_(base, base)] + LIGHT * np.eye(len(base))
    change = np.eye(len(total))
    change[base, 0] = -np.linalg.solve(inner, total[base, 0] / scale[base]) / scale[base]
    result = []
    for gram in grams:
        left = change.T @ gram @ change
        signs = rng.choice([-1.0, 1.0], number)
        result.append(_behind(gram, np.outer(left[1:, 0], signs), np.full(number, left[0, 0])))
    return np.array(result)


def _behind(gram: np.ndarray, cross: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Cross-products with N residuals behind the columns: cross (P - 1, N) with the others, squares (N,)."""
    size, number = len(gram), len(squares)
    result = np.zeros((size + number,) * 2)
    result[1:size, 1:size] = gram[1:, 1:]
    result[1:size, size:] = cross
    result[size:, 1:size] = cross.T
    # different residuals are never combined
    result[range(size, size + number), range(size, size + number)] = squares
    return result


def doubts(model: Model) -> np.ndarray:
    """(S,) standard deviations of the coefficients of a model's own terms from stretch to stretch."""
    shares = []
    for k, axis in enumerate(AXES):
        for term in model.document["axes"].get(axis, {"terms": []})["terms"]:
            share = REACTION if axis == "Mz" and "_dot" in term["expression"] else FORCE_DOUBT if k < 3 else MOMENT
            shares.append(share * abs(term["coefficient"]))
    return np.array(shares)
