"""The capture's clock against the on-board clock, from the motion that both saw.

t = tau + lag + rate (tau - reference): t on-board time, tau capture time. `rate` is positive when the on-board clock
runs fast. The sharpest evidence is the gyro against the body rates of the captured attitude; to it come the signals
that the configuration names. Without a captured attitude the earth-frame acceleration of the captured position stands
against the accelerometer, turned by the on-board attitude.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from quasi.attitude import GRAVITY, body_rates, continuous, interpolate, rotate, rotate_inverse, to_euler
from quasi.errors import DataError, add_caution
from quasi.importing.clocks.clock_fit import ClockFit, Pair, Uniform, correlation, fit, peaks, uniform
from quasi.sensor_limits import AXES_ANGLE, RATE_GAIN

SIGNALS = ("roll", "pitch", "yaw", "p", "q", "r", "ax", "ay", "az")
GRID = 200.0  # Hz, of the signals compared
MOTION_BAND = 15.0  # Hz, to which both sides are band-limited: less is motion, more is noise and vibration
SLOW_BAND = 8.0  # Hz, for twice differentiated positions
COARSE_RATE = 50.0  # Hz
LARGEST_CLOCK_RATE = 0.005  # s/s; crystals of data sheets err by 1e-4, ours ran apart by 3e-5
LARGEST_TURN = 0.5  # of the mix from what it must be, weighted by how much each axis moves

# share of the variance that a fit of one motion explains, by whether the capture holds an attitude
LEAST_FIT_EXPLAINED = {True: 0.3, False: 0.4}


@dataclass(frozen=True)
class Motion:
    """One side of the comparison, on its own clock.

    t (n,) s; rates (n, 3) rad/s and specific_force (n, 3) m/s2, body FRD, or None; quaternion (n, 4) body to earth or
    None; position (n, 3) m earth NED or None; NaN where missing. gyro_doubt, accelerometer_doubt: s, standard errors of
    what was taken off the times of these signals for the on-board filters; they enter that of the lag.
    """

    t: np.ndarray
    rates: np.ndarray | None = None
    specific_force: np.ndarray | None = None
    quaternion: np.ndarray | None = None
    position: np.ndarray | None = None
    gyro_doubt: float = 0.0
    accelerometer_doubt: float = 0.0


@dataclass(frozen=True)
class Synchronisation:
    """The clock fit, how it was found, and what to add to the on-board heading.

    moved       s, lag minus that of the two records laid side by side from their beginnings
    yaw_offset  rad at on-board time yaw_reference s, changing by yaw_drift rad/s.
    """

    fit: ClockFit
    method: str
    signals: list[str]
    correlation: float
    yaw_offset: float
    yaw_drift: float
    yaw_reference: float
    moved: float
    notes: list[str] = field(default_factory=list)

    def to_onboard(self, tau: np.ndarray) -> np.ndarray:
        """On-board times of capture times, s."""
        return self.fit.to_first(tau)

    def metadata(self) -> dict[str, Any]:
        """Plain data for the flight's metadata."""
        f = self.fit
        return {
            "method": self.method,
            "signals": self.signals,
            "lag": {"value": f.lag, "std": f.lag_std, "unit": "s", "at capture time": f.reference},
            "clock rate": {"value": f.rate, "std": f.rate_std, "unit": "s/s"},
            "moved from beginnings": {"value": self.moved, "unit": "s"},
            "correlation": self.correlation,
            "explained variance": f.by_pair,
            "common span": {"value": f.seconds, "unit": "s"},
            "yaw offset": {"value": self.yaw_offset, "unit": "rad"},
            "yaw drift": {"value": self.yaw_drift, "unit": "rad/s", "from": self.yaw_reference},
        }


def synchronise(
    onboard: Motion, capture: Motion, using: Sequence[str], longest_lag: float, where: str, same_clock: bool = False
) -> Synchronisation:
    """Find the on-board clock's reading for every capture time.

    onboard      needs rates and specific_force; quaternion (logged or estimated) for angles and accelerations
    capture      needs position, quaternion if there is one
    using        the signals to align with, of SIGNALS
    longest_lag  s, largest difference between the beginnings of the two records
    where        names the flight in messages
    same_clock   both were stamped by one clock: only a lag is sought
    Raises       DataError when nothing moves, nothing overlaps, nothing matches, or two lags match alike
    """
    notes: list[str] = []
    wrong = [s for s in using if s not in SIGNALS]
    if wrong:
        raise DataError(f"{where}: cannot align with '{wrong[0]}'; choose from {', '.join(SIGNALS)}")
    _refuse_still(onboard, capture, where)
    coarse, pairs, method = _signals(onboard, capture, using, notes, where)
    shortest = min(np.ptp(onboard.t), np.ptp(capture.t))
    least = min(max(2.0, 0.25 * shortest), 0.9 * shortest)
    lags, height = correlation([(a, b) for _, a, b in coarse], least)
    # the search limit counts from the beginnings of the records, as of two records started by hand
    centre = 0.0 if same_clock else onboard.t[0] - capture.t[0]
    beyond = _describe_match_beyond(lags, height, centre, longest_lag)
    height[np.abs(lags - centre) > longest_lag] = np.nan
    found = peaks(lags, height, apart=0.4)
    if not found and np.isfinite(height).any():
        raise DataError(
            f"{where}: capture and on-board log correlate at no lag within {longest_lag:g} s; {beyond}check that both "
            "files are of the same flight, and the signs, units and axes of both"
        )
    if not found:
        raise DataError(
            f"{where}: capture and on-board log do not overlap by {least:.1f} s at any lag within {longest_lag:g} s; "
            "check that both files are of the same flight, or raise 'max permitted lag for optitrack'"
        )
    good = [(lag, r) for lag, r in found if r >= 0.75 * found[0][1]]
    refined = [(r, f) for lag, r in good if (f := _refine(pairs, coarse, lag, same_clock)) is not None]
    spread = pairs[0].first.values[pairs[0].first.good].std(axis=0)
    turned = capture.quaternion is not None
    fits = [(r, f) for r, f in refined if _plausible(f, spread, turned)]
    if not fits:
        whatever_axes = _fit_whatever_axes(pairs, coarse, least, centre, longest_lag, same_clock)
        turning, scaled = (
            _describe_mix(some, pairs[0].name, spread, turned) for some in (whatever_axes, [f for _, f in refined])
        )
        raise DataError(
            f"{where}: the capture's motion is nowhere like the on-board log's (best correlation {found[0][1]:.2f} at "
            f"{found[0][0]:+.2f} s); {turning or beyond or scaled}check that both files are of the same "
            "flight and the rigid body is the right one"
        )
    fits.sort(key=lambda item: -item[1].explained)
    r, best = fits[0]
    for _, other in fits[1:]:
        far = abs(float(other.to_first(best.reference) - best.to_first(best.reference)))
        if far > 0.3 and 1 - other.explained <= 1.25 * (1 - best.explained):
            raise DataError(
                f"{where}: capture and on-board log match alike at lags of {best.lag:+.2f} s and {other.lag:+.2f} s "
                f"(unexplained {100 * (1 - best.explained):.0f} % and {100 * (1 - other.explained):.0f} %); lower 'max "
                "permitted lag for optitrack', align with other signals, or fly something that does not repeat"
            )
    if best.lag_std > 0.01:
        notes.append(f"{where}: the lag of the capture is known to {1e3 * best.lag_std:.0f} ms only (standard error)")
    if best.explained < 0.5:
        notes.append(
            f"{where}: the aligned signals explain only {100 * best.explained:.0f} % of each other; "
            f"{beyond}look at the alignment figure"
        )
    if abs(best.lag - centre) > longest_lag - 0.05:
        notes.append(
            f"{where}: the lag lies at the limit of {longest_lag:g} s; raise 'max permitted lag for optitrack'"
        )
    if abs(best.rate) > LARGEST_CLOCK_RATE:
        add_caution(
            notes,
            f"{where}: the clocks of capture and log run apart by {100 * abs(best.rate):.1f} %, far more than two "
            "clocks do; look for a jump of time stamps, or another frame rate than the export states",
        )
    # the fit's own error, and that of the delay which was taken off the on-board signals
    doubt = onboard.gyro_doubt if capture.quaternion is not None else onboard.accelerometer_doubt
    best = replace(best, lag_std=float(np.hypot(best.lag_std, doubt)))
    offset, drift, when = (
        _heading(onboard, capture, best) if capture.quaternion is not None else _course(pairs[0], best)
    )
    names = [name for name, _, _ in coarse]
    return Synchronisation(best, method, names, r, offset, drift, when, best.lag - centre, notes)


def _plausible(clock: ClockFit, spread: np.ndarray, turned: bool) -> bool:
    """Whether the fit is of one motion seen twice: the mix near no turn (rates) or a turn about the vertical alone.

    Records of different flights can be laid on each other somewhere, but only by a mix that no sensor has.
    spread  standard deviation of each on-board signal: the mix of an axis that hardly moves is noise and does not count
    """
    expected = np.eye(3)
    if not turned:
        m = clock.mix
        yaw = np.arctan2(m[1, 0] - m[0, 1], m[0, 0] + m[1, 1])
        expected = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    away = np.abs(clock.mix - expected) * spread
    return np.max(away) < LARGEST_TURN * np.max(spread) and clock.explained > LEAST_FIT_EXPLAINED[turned]


def _describe_mix(clocks: Sequence[ClockFit], signals: str, spread: np.ndarray, turned: bool) -> str:
    """How the log's signals have to be scaled and turned to go with the capture, where they then do; else ""."""
    best = max(clocks, key=lambda clock: clock.explained, default=None)
    if best is None or best.explained <= LEAST_FIT_EXPLAINED[turned]:
        return ""
    u, _, vt = np.linalg.svd(best.mix * spread)
    size = np.linalg.norm(best.mix * spread) / np.linalg.norm(spread)
    away = np.abs(best.mix / size - u @ vt) * spread
    if np.max(away) >= LARGEST_TURN * np.max(spread):  # no turn: records of different flights
        return ""
    angle = float(np.arccos(np.clip((np.trace(u @ vt) - 1.0) / 2.0, -1.0, 1.0)))
    # noise of the capture makes the size too small, at most by the share that is explained
    if size / best.explained >= RATE_GAIN[0] and size <= RATE_GAIN[1] and angle <= AXES_ANGLE:
        return ""
    return (
        f"they would go together ({100 * best.explained:.0f} % explained) if {signals} of the log were {size:.2g} "
        f"times as large and turned by {np.degrees(angle):.0f} deg: check units and axes of both, or "
    )


def _refuse_still(onboard: Motion, capture: Motion, where: str) -> None:
    for side, motion in (("the capture", capture), ("the on-board log", onboard)):
        if len(motion.t) < 20 or np.ptp(motion.t) < 2.0:
            raise DataError(
                f"{where}: {side} is shorter than 2 s, too short to tie the two clocks; "
                "check that the file is whole, or leave the flight out"
            )
    moved = np.nanmax(np.nanstd(capture.position, axis=0)) if capture.position is not None else 0.0
    turned = 0.0
    if capture.quaternion is not None:
        q = capture.quaternion[np.isfinite(capture.quaternion).all(axis=1)]
        turned = float(np.degrees(np.std(np.linalg.norm(continuous(q) - q[0], axis=1)) * 2)) if len(q) else 0.0
    if moved < 0.005 and turned < 0.5:
        raise DataError(
            f"{where}: the capture shows no motion in its {np.ptp(capture.t):.1f} s (position within "
            f"{1e3 * moved:.1f} mm, attitude within {turned:.2f} deg), while the log lasts {np.ptp(onboard.t):.1f} s; "
            "check that the export is whole, the rigid body's name, and that the take is of this flight"
        )


def _signals(
    onboard: Motion, capture: Motion, using: Sequence[str], notes: list[str], where: str
) -> tuple[list[tuple[str, Uniform, Uniform]], list[Pair], str]:
    """Signals for the coarse search (name, on board, capture) and groups for the fit."""
    band = MOTION_BAND
    spacing = float(np.median(np.diff(capture.t)))
    band = min(band, 0.2 / spacing)
    coarse: list[tuple[str, Uniform, Uniform]] = []
    pairs: list[Pair] = []

    def add(name: str, t_on: np.ndarray, on: np.ndarray, t_cap: np.ndarray, cap: np.ndarray, cutoff: float) -> None:
        a, b = uniform(t_on, on, GRID, cutoff), uniform(t_cap, cap, GRID, cutoff)
        if a is not None and b is not None:
            pairs.append(Pair(name, a, b))

    def search(name: str, t_on: np.ndarray, on: np.ndarray, t_cap: np.ndarray, cap: np.ndarray) -> None:
        cutoff = min(SLOW_BAND, band)
        a, b = uniform(t_on, on, COARSE_RATE, cutoff), uniform(t_cap, cap, COARSE_RATE, cutoff)
        if a is not None and b is not None and np.std(b.values[b.good]) > 0 and np.std(a.values[a.good]) > 0:
            coarse.append((name, a, b))

    acceleration = _captured_acceleration(capture, min(SLOW_BAND, band))
    if capture.quaternion is not None:
        fine = np.isfinite(capture.quaternion).all(axis=1)
        t_cap, q_cap = capture.t[fine], continuous(capture.quaternion[fine])
        rates = _with_gaps(t_cap, body_rates(q_cap, t_cap))
        add("body rates", onboard.t, _turned_between(onboard.t, onboard.rates, spacing), t_cap, rates, band)
        for i, name in enumerate("pqr"):
            search(name, onboard.t, onboard.rates[:, i], t_cap, rates[:, i])
        if onboard.quaternion is not None:
            on_angles = np.unwrap(to_euler(continuous(onboard.quaternion)), axis=0)
            cap_angles = np.unwrap(to_euler(q_cap), axis=0)
            for i, name in enumerate(("roll", "pitch", "yaw")):
                if name in using:
                    search(name, onboard.t, on_angles[:, i], t_cap, cap_angles[:, i])
        if acceleration is not None and any(s in using for s in ("ax", "ay", "az")):
            t_acc, a_earth = acceleration
            q_there = interpolate(q_cap, t_cap, t_acc)
            force = rotate_inverse(q_there, a_earth - np.array([0.0, 0.0, GRAVITY]))
            add("specific force", onboard.t, onboard.specific_force, t_acc, force, min(SLOW_BAND, band))
            for i, name in enumerate(("ax", "ay", "az")):
                if name in using:
                    search(name, onboard.t, onboard.specific_force[:, i], t_acc, force[:, i])
        method = "body rates" + "".join(f", {s}" for s in using)
    else:
        if acceleration is None or onboard.quaternion is None:
            raise DataError(f"{where}: the capture holds neither attitude nor enough positions to align with")
        notes.append(
            f"{where}: the capture holds no attitude; clocks are aligned by accelerations instead of {', '.join(using)}"
        )
        t_acc, a_earth = acceleration
        sensed = rotate(onboard.quaternion, onboard.specific_force) + np.array([0.0, 0.0, GRAVITY])
        add("earth acceleration", onboard.t, sensed, t_acc, a_earth, min(SLOW_BAND, band))
        # heading may differ, so the search uses what does not depend on it
        search("vertical acceleration", onboard.t, sensed[:, 2], t_acc, a_earth[:, 2])
        search(
            "horizontal acceleration", onboard.t, np.hypot(sensed[:, 0], sensed[:, 1]),
            t_acc, np.hypot(a_earth[:, 0], a_earth[:, 1]),
        )  # fmt: skip
        method = "earth-frame accelerations"
    if not coarse or not pairs:
        raise DataError(f"{where}: capture and on-board log have no signal in common to align with; check both files")
    return coarse, pairs, method


def _turned_between(t: np.ndarray, rates: np.ndarray, spacing: float) -> np.ndarray:
    """Mean of the rates (n, 3) over `spacing` s to either side, as central differences of a captured attitude have it.

    Compared with the rates as they are, every turn would look slower in the capture, and the sharper ones most.
    """
    angle = np.zeros_like(rates)
    angle[1:] = np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(t)[:, None], axis=0)
    after, before = np.minimum(t + spacing, t[-1]), np.maximum(t - spacing, t[0])
    turned = [np.interp(after, t, a) - np.interp(before, t, a) for a in angle.T]
    return np.stack(turned, axis=-1) / (after - before)[:, None]


def _with_gaps(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """NaN next to gaps, where a difference spans what was not seen."""
    wide = np.flatnonzero(np.diff(t) > 3.1 * np.median(np.diff(t)))
    values = values.copy()
    values[wide] = np.nan
    values[np.minimum(wide + 1, len(values) - 1)] = np.nan
    return values


def _captured_acceleration(capture: Motion, cutoff: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Times (n,) and earth-frame acceleration (n, 3), m/s2, of the captured position, band-limited; NaN at gaps."""
    if capture.position is None:
        return None
    smooth = uniform(capture.t, capture.position, GRID, cutoff)
    if smooth is None:
        return None
    acceleration = np.gradient(np.gradient(smooth.values, smooth.step, axis=0), smooth.step, axis=0)
    acceleration[~smooth.good] = np.nan
    acceleration[:3] = acceleration[-3:] = np.nan
    return smooth.t, acceleration


def _refine(
    pairs: Sequence[Pair], coarse: Sequence[tuple[str, Uniform, Uniform]], lag: float, same_clock: bool
) -> ClockFit | None:
    """Least squares from a coarse lag; where clocks differ by more than it can bridge, from lags of windows first."""
    first, other = pairs[0].first, pairs[0].other
    begin = max(first.start, other.start + lag)
    end = min(first.t[-1], other.t[-1] + lag)
    reference = 0.5 * (begin + end) - lag
    result = _fit(pairs, lag, 0.0, reference, fit_rate=end - begin > 10.0 and not same_clock)
    if same_clock or (result is not None and result.explained > 0.8):
        return result
    # lags of windows of ten seconds, each searched near the coarse one, and a robust line through them
    centres, offsets = [], []
    for centre in np.arange(begin + 5.0, end - 4.99, 5.0):
        pieces = [(_window(a, centre - 5.0, centre + 5.0), b) for _, a, b in coarse]
        lags, height = correlation(pieces, 5.0)
        near = np.abs(lags - lag) < 0.3 + 0.03 * (end - begin) / 2
        if near.any() and np.nanmax(np.where(near, height, np.nan), initial=-1) > 0.5:
            offsets.append(lags[near][np.nanargmax(height[near])])
            centres.append(centre)
    if len(centres) >= 3:
        c, o = np.array(centres), np.array(offsets)
        i, j = np.triu_indices(len(c), 1)
        slope = float(np.median((o[j] - o[i]) / (c[j] - c[i])))
        middle = float(np.median(o - slope * (c - reference - lag)))
        second = _fit(pairs, middle, slope, reference)
        if second is not None and (result is None or second.explained > result.explained):
            result = second
    return result


def _fit_whatever_axes(
    pairs: Sequence[Pair], coarse: Sequence[tuple[str, Uniform, Uniform]], least: float, centre: float,
    longest_lag: float, same_clock: bool,
) -> list[ClockFit]:  # fmt: skip
    """The fit at the lag at which both turn equally fast, if both have body rates: axes of the room that are not what
    the reader takes them for exchange the body's axes, so that none of them matches."""
    rates = [(a, b) for name, a, b in coarse if name in ("p", "q", "r")]
    if len(rates) < 3:
        return []
    first, other = (
        replace(side[0], values=np.sqrt(sum(u.values**2 for u in side)), good=np.all([u.good for u in side], axis=0))
        for side in zip(*rates)
    )
    lags, height = correlation([(first, other)], least)
    if not np.isfinite(height).any():
        return []
    lag = float(lags[np.nanargmax(height)])
    found = _refine(pairs, [("size", first, other)], lag, same_clock) if abs(lag - centre) <= longest_lag else None
    return [] if found is None else [found]


def _describe_match_beyond(lags: np.ndarray, height: np.ndarray, centre: float, longest_lag: float) -> str:
    """What to do where the records match better at a lag beyond the limit; "" where they do not."""
    permitted = np.abs(lags - centre) <= longest_lag
    inside, outside = (np.where(mask & np.isfinite(height), height, -np.inf) for mask in (permitted, ~permitted))
    best = int(np.argmax(outside)) if len(outside) else 0
    if not len(outside) or not np.isfinite(outside[best]) or outside[best] <= inside.max():
        return ""
    return (
        f"beyond the limit of {longest_lag:g} s they correlate by {outside[best]:.2f} at {lags[best] - centre:+.2f} s "
        "from the beginnings of the records: raise 'max permitted lag for optitrack', or "
    )


def _fit(pairs: Sequence[Pair], lag: float, rate: float, reference: float, fit_rate: bool = True) -> ClockFit | None:
    """The clock fit with the captured signals regressed on the on-board ones.

    A capture's noise grows with differentiation; as regressor it would pass for motion and blur the fit.
    """
    turned = [Pair(p.name, p.other, p.first) for p in pairs]
    found = fit(turned, -lag, -rate / (1 + rate), reference + lag, fit_rate)
    return None if found is None else found.inverted()


def _window(signal: Uniform, begin: float, end: float) -> Uniform:
    i, j = np.searchsorted(signal.t, [begin, end])
    return Uniform(float(signal.t[i]), signal.step, signal.values[i:j], signal.good[i:j])


def _heading(onboard: Motion, capture: Motion, clock: ClockFit) -> tuple[float, float, float]:
    """What to add to the on-board heading, rad; how fast that drifts, rad/s; and the on-board time of the former, s."""
    if onboard.quaternion is None:
        return 0.0, 0.0, 0.0
    fine = np.isfinite(capture.quaternion).all(axis=1)
    t = clock.to_first(capture.t[fine])
    inside = (t >= onboard.t[0]) & (t <= onboard.t[-1])
    if np.count_nonzero(inside) < 10:
        return 0.0, 0.0, 0.0
    captured = to_euler(capture.quaternion[fine][inside])
    sensed = to_euler(interpolate(onboard.quaternion, onboard.t, t[inside]))
    upright = (np.abs(captured[:, 1]) < 1.2) & (np.abs(captured[:, 0]) < 1.2)
    if np.count_nonzero(upright) < 10:
        upright[:] = True
    difference = (captured - sensed)[upright, 2]
    offset = float(np.angle(np.mean(np.exp(1j * difference))))
    rest = np.angle(np.exp(1j * (difference - offset)))
    when = t[inside][upright]
    drift = float(np.polyfit(when - when.mean(), rest, 1)[0]) if np.ptp(when) > 1 else 0.0
    return offset, drift, float(when.mean())


def _course(pair: Pair, clock: ClockFit) -> tuple[float, float, float]:
    """The same without a captured attitude: the turn that lays horizontal accelerations (earth axes) on each other."""
    tau = clock.to_other(pair.first.t)
    index = np.rint((tau - pair.other.start) / pair.other.step).astype(int)
    use = (index >= 0) & (index < len(pair.other.good)) & pair.first.good
    use[use] &= pair.other.good[index[use]]
    sensed = pair.first.values[use, 0] + 1j * pair.first.values[use, 1]
    captured = pair.other.values[index[use], 0] + 1j * pair.other.values[index[use], 1]
    sensed, captured = sensed - sensed.mean(), captured - captured.mean()
    product = np.sum(captured * np.conj(sensed))
    alike = abs(product) / max(np.linalg.norm(sensed) * np.linalg.norm(captured), 1e-12)
    return (float(np.angle(product)) if alike > 0.5 else 0.0), 0.0, 0.0
