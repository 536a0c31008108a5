"""What repeats in time: peaks of the residual's spectrum above its own background, common to the compared flights.

Each flight's residual is whitened by its autoregression, so that its spectrum is nearly flat. A peak's power over the
mean of its neighbours is then a ratio of two independent estimates of the same variance, F distributed where nothing
repeats. Flights' ratios are pooled; phases are each flight's own. Forces are looked at along the body's axes and along
the room's, for what pulls from outside keeps its direction in the room.
Sources: Percival & Walden, Spectral Analysis for Physical Applications, 1993, sections 6.6 and 10.9.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import f as f_distribution

from quasi import attitude
from quasi.gap.levels.forces.design import ORDER
from quasi.gap.statistics.whitening import autoregression, whiten
from quasi.model.model import AXES

HIGHEST_FREQUENCY = 8.0  # Hz, where the band of the analysis ends
WIDTHS = (1, 5)  # bins: what keeps time, and what rings
AROUND = 8  # bins of background on each side, for each bin of width
GUARD = 1  # bins between, for each bin of width
EACH = 0.05  # probability of nothing that two flights must pass each by itself
OUTSIDE = 0.5  # of what the model's own terms do at a frequency: less may be an error of these
MOST_PEAKS = 4
VIEWS = (*AXES, "north", "east", "down")


class Signal(NamedTuple):
    """A flight's residual (m, 6) in the band of the analysis, breaks (m,), times (m,) s, body to earth (m, 4).

    modelled (m, 6, S): what each term of the model does
    """

    values: np.ndarray
    breaks: np.ndarray
    t: np.ndarray
    quaternion: np.ndarray
    modelled: np.ndarray

    def views(self, wrench: np.ndarray) -> np.ndarray:
        """(m, 9) of a wrench (m, 6) in body axes: itself, then the force in earth axes."""
        return np.hstack([wrench, attitude.rotate(self.quaternion, wrench[:, :3])])


class Line(NamedTuple):
    """A peak: view, from and to (Hz), middle (Hz), probability of nothing, "changed" or "always"."""

    view: str
    low: float
    high: float
    middle: float
    p: float
    since: str


def search(signals: Sequence[Signal], compared: Sequence[bool], rate: float) -> list[Line]:
    """Peaks that the compared flights have in common, the least probable first; family-wise false alarm rate `rate`."""
    own = [s for s, flag in zip(signals, compared) if flag]
    others = [s for s, flag in zip(signals, compared) if not flag]
    if not own:
        return []
    views = [s.views(s.values) for s in signals]
    whitener = autoregression(views, [s.breaks for s in signals], ORDER)
    white = [_whitened(v, s, whitener) for v, s in zip(views, signals)]
    longest = max(t[-1] - t[0] for _, t in white)
    grid = _grid(longest)
    spans = [t[-1] - t[0] for _, t in white]
    powers = [_power(values, t, _grid(span)) for (values, t), span in zip(white, spans)]
    flags = np.asarray(compared, bool)
    level = rate / (len(VIEWS) * len(WIDTHS) * len(grid))
    found: list[Line] = []
    peaks = []
    for width in WIDTHS:
        # bins of a flight are independent on its own grid alone
        ratios = np.array([_ratio(p, width)[_nearest(grid, span, len(p))] for p, span in zip(powers, spans)])
        back = 2 * AROUND * width
        mine = ratios[flags]
        p = f_distribution.sf(mine.mean(axis=0), 2 * width * len(own), 2 * back * len(own))
        each = f_distribution.sf(mine, 2 * width, 2 * back)
        p = np.where((each < EACH).sum(axis=0) >= min(2, len(own)), p, 1.0)
        edge = width // 2 + 1 + (GUARD + AROUND // 2) * width
        p[:edge] = p[-edge:] = 1.0  # too little background on one side
        for g, v in zip(*np.nonzero(p < level)):
            since = "always"
            if others:
                alike = f_distribution.sf(ratios[~flags].mean(axis=0)[g, v], 2 * width * len(others),
                                          2 * back * len(others))  # fmt: skip
                since = "always" if alike < EACH else "changed"
            half = float(0.5 * width / longest)
            middle = float(grid[g])
            peaks.append(Line(VIEWS[v], middle - half, middle + half, middle, float(p[g, v]), since))
    for peak in sorted(peaks, key=lambda line: line.p):
        # one peak spills into its neighbours, and from the room's axes into the body's
        if len(found) < MOST_PEAKS and not any(_same(peak, other) for other in found) and _outside(peak, own):
            found.append(peak)
    return found


def _grid(span: float) -> np.ndarray:
    """Frequencies (G,), Hz, of the independent bins of `span` seconds."""
    return np.arange(1, int(HIGHEST_FREQUENCY * span) + 1) / span


def _nearest(grid: np.ndarray, span: float, count: int) -> np.ndarray:
    """The bin of a flight of `span` seconds with `count` bins that is nearest to each frequency."""
    return np.clip(np.round(grid * span).astype(int) - 1, 0, count - 1)


def _outside(line: Line, signals: Sequence[Signal]) -> bool:
    """Whether a peak is too large to be an error of the model's own terms: what a manoeuvre repeats, they repeat."""
    view, rest, own = VIEWS.index(line.view), 0.0, 0.0
    for signal in signals:
        rest += float(_excess(line, signal.t, signal.views(signal.values)[:, [view]])[0])
        terms = [signal.views(signal.modelled[:, :, k])[:, view] for k in range(signal.modelled.shape[2])]
        own = own + _excess(line, signal.t, np.stack(terms, axis=1))
    return rest > OUTSIDE**2 * float(np.maximum(own, 0.0).sum())


def _same(a: Line, b: Line) -> bool:
    near = abs(a.middle - b.middle) < max(2.0 * max(a.high - a.low, b.high - b.low), 0.15)
    return near and ((a.view[0] == "M") == (b.view[0] == "M"))


def _whitened(views: np.ndarray, signal: Signal, whitener) -> tuple[np.ndarray, np.ndarray]:
    values, rows = whiten(views[:, :, None], signal.breaks, whitener)
    return values[:, :, 0], signal.t[rows]


def _power(values: np.ndarray, t: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Power (G, C) at equally spaced frequencies, of times with gaps."""
    # an exponential of a sum is a product: of G only some 2 sqrt(G) are computed
    few, angle = int(np.ceil(np.sqrt(len(grid)))), -2j * np.pi * (t - t[0])
    coarse = np.exp(np.outer(grid[::few], angle))
    fine = np.exp(np.outer(grid[:few] - grid[0], angle)).T
    centred = values - values.mean(axis=0)
    turned = np.stack([((coarse * column) @ fine).ravel()[: len(grid)] for column in centred.T], axis=1)
    return np.abs(turned) ** 2 / len(t)


def _ratio(power: np.ndarray, width: int) -> np.ndarray:
    """Mean power in `width` bins over the mean of the background around (G, C)."""
    sums = np.vstack([np.zeros((1, power.shape[1])), np.cumsum(power, axis=0)])
    count = len(power)

    def mean(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        low, high = np.clip(low, 0, count), np.clip(high, 0, count)
        return sums[high] - sums[low], (high - low)[:, None]

    at = np.arange(count)
    half = width // 2
    peak, bins = mean(at - half, at + half + 1)
    guard, far = half + 1 + GUARD * width, half + 1 + GUARD * width + AROUND * width
    left, n_left = mean(at - far + 1, at - guard + 1)
    right, n_right = mean(at + guard, at + far)
    # a background that slopes: the larger of both sides
    sides = np.maximum(left / np.maximum(n_left, 1), right / np.maximum(n_right, 1))
    both = (left + right) / np.maximum(n_left + n_right, 1)
    return (peak / bins) / np.maximum(np.maximum(sides, both), 1e-300)


def amplitudes(line: Line, signal: Signal) -> np.ndarray:
    """Mean squares (6,) that the peak adds to a flight's residual in body axes: above the background around it."""
    excess = np.maximum(_excess(line, signal.t, signal.views(signal.values)), 0.0)
    if line.view in AXES:
        return np.where(np.arange(6) == AXES.index(line.view), excess[:6], 0.0)
    axis = VIEWS.index(line.view) - 6
    turned = attitude.rotate_inverse(signal.quaternion, np.eye(3)[axis])
    shares = np.mean(turned**2, axis=0)
    return np.concatenate([excess[6 + axis] * shares, np.zeros(3)])


def _excess(line: Line, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Mean square (C,) of a peak above the background around it, of values (m, C)."""
    span = t[-1] - t[0]
    grid = np.arange(1, int(HIGHEST_FREQUENCY * span) + 1) / span
    power = _power(values, t, grid)
    away = np.abs(grid - line.middle) * span  # bins
    half = 0.5 * max((line.high - line.low) * span, 1.0) + 0.5
    around = (away > half + GUARD) & (away < half + GUARD + AROUND)
    inside = away <= half
    # an exponential's mean is its median over ln 2
    background = np.median(power[around], axis=0) / np.log(2.0)
    return 2.0 * (power[inside].sum(axis=0) - inside.sum() * background) / len(t)
