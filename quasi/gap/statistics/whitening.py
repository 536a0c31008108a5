"""Whitening of residuals, and the cross-products that everything after works on.

Residuals of a flight remember: gusts last a second, filters a few samples. An autoregression per channel, fitted to
what no column explains, turns them white, so that least squares after it is generalised least squares and its
covariances are honest. Sources: Box, Jenkins & Reinsel, Time Series Analysis, 3rd ed., 1994, section 7.3 (Yule-Walker);
Harvey, The Econometric Analysis of Time Series, 2nd ed., 1990, section 6.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import solve_toeplitz
from scipy.signal import firwin

LOOP_LENGTH = 512  # values, about as many as the fastest memory holds with those of all orders
WHITENING_RIDGE = 1e-6  # of the variance, so that a silent band does not make the recursion singular


class Whitener(NamedTuple):
    """coefficients (C, order + 1) with leading 1, scale (C,): the innovations' standard deviation."""

    coefficients: np.ndarray
    scale: np.ndarray


def stretches(breaks: np.ndarray) -> list[slice]:
    """Runs of rows between gaps. breaks (n,) bool, True where a run begins."""
    starts = np.flatnonzero(breaks)
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(breaks)])]


class Thinned(NamedTuple):
    """Columns (m, C, P) in a lower band, breaks (m,) bool, and the rows (m,) that they stand at."""

    columns: np.ndarray
    breaks: np.ndarray
    rows: np.ndarray


def thin(columns: np.ndarray, breaks: np.ndarray, t: np.ndarray, band: float, least: int) -> Thinned:
    """Low-pass all columns (n, C, P) alike with zero phase and keep every sample that the band (Hz) needs.

    A linear relation between columns stays what it is. Stretches that leave fewer than `least` samples are left out.
    Above the band the model's errors of timing would outweigh all else.
    """
    rate = 1.0 / float(np.median(np.diff(t)))
    every = max(int(rate / (2.8 * band)), 1)
    half = round(rate / band)
    weights = firwin(2 * half + 1, band, fs=rate, window=("kaiser", 5.0))
    flat = np.ascontiguousarray(columns.reshape(len(columns), -1))
    parts, starts, rows = [], [], []
    for part in stretches(breaks):
        if part.stop - part.start < 2 * half + every * least:
            continue
        # a sum for each sample that is kept; a transform of all samples takes ten times as long
        windows = sliding_window_view(flat[part], len(weights), axis=0)[::every].transpose(0, 2, 1)
        parts.append((weights @ windows).reshape(-1, *columns.shape[1:]))
        starts.append(np.arange(len(parts[-1])) == 0)
        rows.append(np.arange(part.start + half, part.stop - half)[::every])
    if not parts:
        return Thinned(np.empty((0, *columns.shape[1:])), np.empty(0, bool), np.empty(0, int))
    return Thinned(np.concatenate(parts), np.concatenate(starts), np.concatenate(rows))


def autoregression(residuals: Sequence[np.ndarray], breaks: Sequence[np.ndarray], order: int) -> Whitener:
    """One autoregression per channel for all flights. residuals (n, C) per flight, breaks (n,) bool per flight."""
    channels = residuals[0].shape[1]
    coefficients, scale = np.tile(np.eye(1, order + 1), (channels, 1)), np.ones(channels)
    for c in range(channels):
        covariance, rows = np.zeros(order + 1), 0
        for residual, gaps in zip(residuals, breaks):
            for part in stretches(gaps):
                x = residual[part, c]
                rows += len(x)
                for lag in range(min(order + 1, len(x))):
                    covariance[lag] += x[lag:] @ x[: len(x) - lag]
        covariance[0] *= 1.0 + WHITENING_RIDGE
        if covariance[0] <= 0.0:
            continue  # a channel without residual: nothing to whiten
        weights = solve_toeplitz(covariance[:-1], covariance[1:])
        coefficients[c, 1:] = -weights
        scale[c] = np.sqrt((covariance[0] - weights @ covariance[1:]) / rows)
    return Whitener(coefficients, scale)


@njit(cache=True)
def _filter(columns, weights, row, out):
    """Flat rows out of flat rows of columns, `row` values each: of each row and those before it, latest first.

    weights (order + 1, L)  for L values in a row, a whole number of rows, so that the loop over them is a long one
    """
    order, length = weights.shape[0] - 1, weights.shape[1]
    for start in range(0, len(out), length):
        stop = min(start + length, len(out))
        for k in range(order + 1):
            at = start + (order - k) * row
            own, seen = out[start:stop], columns[at : at + stop - start]
            for q in range(len(own)):
                own[q] += weights[k, q] * seen[q]


def whiten(columns: np.ndarray, breaks: np.ndarray, whitener: Whitener) -> tuple[np.ndarray, np.ndarray]:
    """Whitened columns (m, C, P) of (n, C, P), and the rows (m,) that they belong to.

    The first `order` rows after each gap only fill the filter and are left out.
    """
    order = whitener.coefficients.shape[1] - 1
    parts, rows = [], []
    row = columns[:1].size
    weights = np.repeat((whitener.coefficients / whitener.scale[:, None]).T, columns.shape[2], axis=1)
    weights = np.tile(weights, max(LOOP_LENGTH // max(row, 1), 1))
    for part in stretches(breaks):
        if part.stop - part.start <= order:
            continue
        filtered = np.zeros((part.stop - part.start - order, *columns.shape[1:]))
        _filter(np.ascontiguousarray(columns[part], float).ravel(), weights, row, filtered.ravel())
        parts.append(filtered)
        rows.append(np.arange(part.start + order, part.stop))
    if not parts:
        return np.empty((0, *columns.shape[1:])), np.empty(0, int)
    return (parts[0], rows[0]) if len(parts) == 1 else (np.concatenate(parts), np.concatenate(rows))


def channel_grams(
    columns: np.ndarray, breaks: np.ndarray, whitener: Whitener, t: np.ndarray, seconds: float
) -> np.ndarray:
    """Cross-products (B, C, P, P) of the whitened columns, one for each block of `seconds` and channel."""
    white, rows = whiten(columns, breaks, whitener)
    if not len(rows):
        return np.zeros((0, *columns.shape[1:], columns.shape[2]))
    number = ((t[rows] - t[rows[0]]) / seconds).astype(int)
    white = white.transpose(1, 0, 2)
    blocks = (white[:, number == n] for n in np.unique(number))
    return np.array([w.transpose(0, 2, 1) @ w for w in blocks])


def block_grams(
    columns: np.ndarray, breaks: np.ndarray, whitener: Whitener, t: np.ndarray, seconds: float
) -> np.ndarray:
    """Cross-products (B, P, P) of the whitened columns, one for each block of `seconds`, all channels together."""
    return channel_grams(columns, breaks, whitener, t, seconds).sum(axis=1)
