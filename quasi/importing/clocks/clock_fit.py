"""Two records of the same motion on two clocks: what one clock reads when the other reads a given time.

Model: t = tau + lag + rate (tau - reference), with tau the time of the second ("other") record and t that of the first.
A coarse lag comes from normalised cross-correlation; lag and rate then from least squares on the signals themselves,
the first record's regressed on the second's, so that small turns of the axes, scales and offsets between the two do not
matter. The noisier record should be the first: noise of the regressors passes for motion, which blurs the fit and makes
it look surer than it is.

Standard errors: residuals are far from white, and often a few bursts of motion carry all information. The spread of
the score is found twice: from the residuals' autocovariance over the whole record, which does not rest on these few
bursts; and from blocks, which sees errors that grow with the motion or hit all signals at once. The larger one counts.

Source: Golub & Pereyra, Separable nonlinear least squares: the variable projection method, Inverse Problems 19, 2003;
Huber, Robust Statistics, 1981, ch. 7; Newey & West, Econometrica 55(3), 1987 (taper of the autocovariance); Cameron,
Gelbach & Miller (block-robust errors), J. Human Resources 50(2), 2015.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from quasi.importing.series import interpolate_columns

RESIDUAL_BLOCK = 1.0  # s, longer than what correlates the residuals
MOST_PEAKS = 4  # of a correlation, that a lag may be at


@dataclass(frozen=True)
class Uniform:
    """Signals (n, k) on a uniform grid from `start` with `step`, s; `good` (n,) false where there was nothing near."""

    start: float
    step: float
    values: np.ndarray
    good: np.ndarray

    @property
    def t(self) -> np.ndarray:
        """Times (n,), s."""
        return self.start + self.step * np.arange(len(self.values))


@dataclass(frozen=True)
class Pair:
    """The same quantities in both records: `first` (n, k) is a linear mix of `other` (m, j) at the right time.

    aside  (n, i) what else is in the mix, on the clock and grid of `first`; None where nothing is
    """

    name: str
    first: Uniform
    other: Uniform
    aside: np.ndarray | None = None


@dataclass(frozen=True)
class ClockFit:
    """lag s and rate s/s with standard errors.

    explained, by_pair  share of the first record's variance that the other explains; seconds  of it that were used
    mix                 (k, j) of the first pair: first = mix other + offset
    """

    lag: float
    rate: float
    reference: float
    lag_std: float
    rate_std: float
    explained: float
    by_pair: dict[str, float]
    seconds: float
    mix: np.ndarray

    def inverted(self) -> "ClockFit":
        """The inverse relation: t and tau change places. `mix` stays as it was fitted."""
        return replace(
            self,
            lag=-self.lag,
            rate=-self.rate / (1 + self.rate),
            reference=self.reference + self.lag,
            rate_std=self.rate_std / (1 + self.rate) ** 2,
        )

    def to_first(self, tau: np.ndarray) -> np.ndarray:
        """Times of the first clock for times of the other."""
        tau = np.asarray(tau, float)
        return tau + self.lag + self.rate * (tau - self.reference)

    def to_other(self, t: np.ndarray) -> np.ndarray:
        """Times of the other clock for times of the first."""
        return (np.asarray(t, float) - self.lag + self.rate * self.reference) / (1 + self.rate)


def uniform(t: np.ndarray, values: np.ndarray, rate: float, cutoff: float) -> Uniform | None:
    """Band-limit a record for comparison: interpolation to a uniform grid, zero-phase low-pass.

    t       (n,) s, increasing; values (n,) or (n, k), NaN where missing; rate, cutoff  Hz
    Returns None when less than half a second is usable; `good` is false near gaps longer than two grid steps or three
            sampling intervals, for the filter smears what was interpolated there
    """
    values = np.asarray(values, float)
    values = values[:, None] if values.ndim == 1 else values
    fine = np.isfinite(values).all(axis=1) & np.isfinite(t)
    if np.count_nonzero(fine) < 8:
        return None
    t, values = t[fine], values[fine]
    step = 1.0 / rate
    grid = np.arange(t[0], t[-1], step)
    if len(grid) < max(16, int(0.5 * rate)):
        return None
    spacing = np.diff(t)
    usual = float(np.median(spacing))
    if usual < 0.7 * step and cutoff < 0.5 / step:
        # denser than the grid: filter on the source's own spacing first
        dense = np.arange(t[0], t[-1], usual)
        inner = interpolate_columns(dense, t, values)
        inner = _low_pass(inner, 1 / usual, cutoff)
        out = interpolate_columns(grid, dense, inner)
    else:
        # straight lines between samples as coarse as these would weaken the faster motion
        out = _low_pass(CubicSpline(t, values, axis=0)(grid), rate, cutoff)
    good = np.ones(len(grid), bool)
    for i in np.flatnonzero(spacing > max(2 * step, 3.1 * usual)):
        margin = 0.5 / cutoff
        good[(grid > t[i] - margin) & (grid < t[i + 1] + margin)] = False
    return Uniform(float(grid[0]), step, out, good)


def _low_pass(values: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    if cutoff >= 0.45 * rate:
        return values
    sos = butter(2, cutoff / (0.5 * rate), output="sos")
    return sosfiltfilt(sos, values, axis=0, padlen=min(len(values) - 2, int(2 * rate / cutoff)))


def correlation(pairs: Sequence[tuple[Uniform, Uniform]], least_overlap: float) -> tuple[np.ndarray, np.ndarray]:
    """Normalised, mean-removed cross-correlation over lags of either sign; one step for all, one column each.

    pairs          (first, other) of one signal each
    least_overlap  s of common good samples below which a lag is not considered
    Returns        lags (L,) in s (t = tau + lag), and the mean correlation (L,), -1..1, NaN where the overlap is short
    """
    total, count, lags = None, None, None
    for first, other in pairs:
        step = first.step
        x, y = first.values[:, 0], other.values[:, 0]
        mx, my = first.good.astype(float), other.good.astype(float)
        x = np.where(first.good, x - x[first.good].mean() if first.good.any() else 0.0, 0.0)
        y = np.where(other.good, y - y[other.good].mean() if other.good.any() else 0.0, 0.0)
        size = next_fast_len(len(x) + len(y), real=True)

        def cross(a: np.ndarray, b: np.ndarray, size: int = size) -> np.ndarray:
            """sum over i of a[i + s] b[i] for shifts s = -(len b - 1) .. len a - 1."""
            c = irfft(rfft(a, size) * np.conj(rfft(b, size)), size)
            return np.concatenate([c[size - len(b) + 1 :], c[: len(a)]])

        n = np.rint(cross(mx, my))
        sx, sy, sxx, syy, sxy = cross(x, my), cross(mx, y), cross(x * x, my), cross(mx, y * y), cross(x, y)
        m = np.maximum(n, 1)
        top = sxy - sx * sy / m
        vx, vy = sxx - sx * sx / m, syy - sy * sy / m
        # a stretch with next to no motion correlates by chance; measure it against the whole record's
        vx = np.maximum(vx, 0.05 * m * np.mean(x * x))
        vy = np.maximum(vy, 0.05 * m * np.mean(y * y))
        with np.errstate(invalid="ignore", divide="ignore"):
            r = np.where((n * step >= least_overlap) & (vx * vy > 0), top / np.sqrt(vx * vy), np.nan)
        shifts = np.arange(-(len(y) - 1), len(x)) * step
        here = shifts + first.start - other.start
        if total is None:
            total, count, lags = np.nan_to_num(r), np.isfinite(r).astype(float), here
        else:
            moved = np.interp(lags, here, r, left=np.nan, right=np.nan)
            total += np.nan_to_num(moved)
            count += np.isfinite(moved)
    return lags, np.where(count == len(pairs), total / np.maximum(count, 1), np.nan)


def peaks(lags: np.ndarray, height: np.ndarray, apart: float) -> list[tuple[float, float]]:
    """The highest (lag, correlation), highest first, each at least `apart` s from those before it."""
    left = np.nan_to_num(height, nan=-np.inf).copy()
    found: list[tuple[float, float]] = []
    while len(found) < MOST_PEAKS and np.max(left, initial=-np.inf) > 0:
        i = int(np.argmax(left))
        inner = 0 < i < len(left) - 1
        if (inner and left[i] >= max(height[i - 1], height[i + 1])) or not inner:
            found.append((float(lags[i]), float(left[i])))
            left[np.abs(lags - lags[i]) < apart] = -np.inf
        else:
            left[i] = -np.inf
    return found


def fit(
    pairs: Sequence[Pair], lag: float, rate: float, reference: float, fit_rate: bool = True, rounds: int = 12
) -> ClockFit | None:
    """Lag and rate by robust separable least squares, beginning from values within about half a period.

    Returns None when fewer than two seconds overlap or the signals show no lag.
    """
    splines = [CubicSpline(p.other.t, p.other.values, axis=0) for p in pairs]
    start = lag
    result = None
    for turn in range(rounds):
        normal, right = np.zeros((2, 2)), np.zeros(2)
        scores: list[tuple[np.ndarray, np.ndarray]] = []
        spread = np.zeros((2, 2))
        seconds, by_pair, shares, first_mix = 0.0, {}, [], np.zeros((0, 0))
        for pair, spline in zip(pairs, splines):
            t = pair.first.t
            tau = (t - lag + rate * reference) / (1 + rate)
            index = np.rint((tau - pair.other.start) / pair.other.step)
            use = (index >= 1) & (index < len(pair.other.good) - 1) & pair.first.good
            use[use] &= pair.other.good[index[use].astype(int)]
            if np.count_nonzero(use) * pair.first.step < 2.0:
                continue
            t, tau, y = t[use], tau[use], pair.first.values[use]
            c, slope = spline(tau), spline(tau, 1)
            aside = np.zeros((len(c), 0)) if pair.aside is None else pair.aside[use]
            basis = np.concatenate([c, aside, np.ones((len(c), 1))], axis=1)
            weight = np.ones(y.shape)
            for _ in range(2):
                mix = np.empty((basis.shape[1], y.shape[1]))
                for k in range(y.shape[1]):
                    root = np.sqrt(weight[:, k : k + 1])
                    mix[:, k] = np.linalg.lstsq(root * basis, root[:, 0] * y[:, k], rcond=None)[0]
                residual = y - basis @ mix
                scale = 1.4826 * np.median(np.abs(residual), axis=0) + 1e-9 * (np.std(y, axis=0) + 1e-12)
                weight = 1.0 / np.maximum(1.0, np.abs(residual) / (2.0 * scale))
            variance = np.maximum(scale**2, 1e-300)
            gradient = -(slope @ mix[: c.shape[1]]) / (1 + rate)
            for k in range(y.shape[1]):
                w = weight[:, k] / variance[k]
                g = np.stack([gradient[:, k], gradient[:, k] * (tau - reference)], axis=1)
                root = np.sqrt(w)[:, None]
                # what the mix and the offset could take up says nothing about time
                g = g - basis @ np.linalg.lstsq(root * basis, root * g, rcond=None)[0]
                normal += g.T @ (w[:, None] * g)
                score = w[:, None] * g * residual[:, k : k + 1]
                right += score.sum(axis=0)
                scores.append((t, score))
                cell = np.rint((t - pair.first.start) / pair.first.step).astype(int)
                spread += _stationary_spread(cell, w[:, None] * g, residual[:, k], scale[k], pair.first.step)
            moving = np.count_nonzero(np.ptp(y, axis=0) > 0)
            share = 1.0 - np.sum(weight * residual**2) / max(np.sum(weight * (y - y.mean(axis=0)) ** 2), 1e-300)
            by_pair[pair.name] = float(share)
            first_mix = mix[: c.shape[1]].T if not first_mix.size else first_mix
            shares.append((float(share), float(moving) * len(y)))
            seconds = max(seconds, len(y) * pair.first.step)
        if not scores:
            return None
        active = 2 if fit_rate else 1
        part = normal[:active, :active]
        if not np.all(np.isfinite(part)) or np.linalg.cond(part) > 1e14 or part[0, 0] <= 0:
            return None
        step = np.zeros(2)
        step[:active] = np.linalg.solve(part, right[:active])
        inverse = np.linalg.inv(part)
        both = [np.diag(inverse @ s @ inverse) for s in (spread[:active, :active], _block_spread(scores, active))]
        std = np.sqrt(np.maximum(*both))
        result = ClockFit(
            lag, rate, reference,
            float(std[0]), float(std[1]) if fit_rate else 0.0,
            float(np.average([s for s, _ in shares], weights=[w for _, w in shares])), by_pair, seconds, first_mix,
        )  # fmt: skip
        if abs(step[0]) < 1e-7 and abs(step[1]) < 1e-10:
            break
        if turn == rounds - 1:
            return result if abs(step[0]) < max(2e-4, result.lag_std) else None
        lag += float(np.clip(step[0], -0.05, 0.05))
        rate += float(np.clip(step[1], -2e-3, 2e-3))
        if abs(lag - start) > 1.5 or abs(rate) > 0.2:
            return None
    return result


def _stationary_spread(
    cell: np.ndarray, weighted: np.ndarray, residual: np.ndarray, scale: float, step: float
) -> np.ndarray:
    """Spread (2, 2) of sum(weighted x residual) for residuals whose autocovariance is the same all along.

    cell (n,) places on the grid of `step` s; weighted (n, 2); residual (n,), taken to within 4 `scale`.
    """
    cell = cell - cell[0]
    reach, count = int(RESIDUAL_BLOCK / step), int(cell[-1]) + 1
    size = next_fast_len(count + reach + 1, real=True)
    lined = np.zeros((3, count))
    lined[0, cell], lined[1:, cell] = np.clip(residual, -4 * scale, 4 * scale), weighted.T
    r, *x = rfft(lined, size)
    power = irfft(np.abs(r) ** 2, size)[: reach + 1] / len(cell) * (1 - np.arange(reach + 1) / (reach + 1))
    power[1:] *= 2  # both signs of the lag
    out = np.empty((2, 2))
    for i in range(2):
        for j in range(2):
            out[i, j] = irfft(np.real(x[i] * np.conj(x[j])), size)[: reach + 1] @ power
    return out


def _block_spread(scores: Sequence[tuple[np.ndarray, np.ndarray]], active: int) -> np.ndarray:
    """Sum over blocks of the outer product of the block's score: the spread of the right-hand side."""
    start = min(t[0] for t, _ in scores)
    blocks = np.zeros((int((max(t[-1] for t, _ in scores) - start) / RESIDUAL_BLOCK) + 1, active))
    for t, score in scores:
        which = ((t - start) / RESIDUAL_BLOCK).astype(int)
        for c in range(active):
            blocks[:, c] += np.bincount(which, weights=score[:, c], minlength=len(blocks))[: len(blocks)]
    used = np.count_nonzero(np.any(blocks != 0, axis=1))
    blocks = blocks - blocks.sum(axis=0) / max(used, 1) * np.any(blocks != 0, axis=1, keepdims=True)
    return blocks.T @ blocks * used / max(used - active, 1)
