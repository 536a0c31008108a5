"""Inertial sensors against motion capture, in weak form: residuals and how each cause would show in them.

Both sides are averaged over a smooth window of about a tenth of a second; derivatives of the captured motion fall on
the window, never on the noisy samples. Channels: the gyro minus the captured body rates (rad/s, body axes), and the
specific force turned to earth axes, plus gravity, minus the captured acceleration (m/s2). No mass and no rotor speed
enters.

With R the captured attitude, f and w the measured specific force and rates, residuals are linear in small faults:
    scale s (per axis)        s_i w_i           R s_i f_i
    misalignment d (vector)   d x w             R (d x f)         marker axes minus sensor axes
    room tilt e (earth axes)                    e x g
    lever arm r                                 d2/dt2 (R r)      since R (wdot x r + w x (w x r)) is just that
    late rotation h           h wdot            -h R (w x f)      and the cg, found from markers by that rotation
    late capture c            c wdot            c R fdot          a clock
    early accelerometer c                       c R fdot          filtered less than stated
    fast clock k              k w               2 k (R f + g)     and a capture that comes ever earlier
Sources: Titterton & Weston, Strapdown Inertial Navigation Technology, 2nd ed., 2004, chapters 3 and 12 (error models);
Preisig & Rippin, Theory and application of the modulating function method, Computers Chem. Eng. 17, 1993 (weak form).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.signal import fftconvolve, lfilter, welch

from quasi import attitude
from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.gap.flights.level import Flown
from quasi.importing.calibration import true_inertial, true_pose
from quasi.importing.resampling import GAP
from quasi.model.columns import ROTORS

SIGMA = 0.05  # s, standard deviation of the window
KEPT_RATE = 20.0  # Hz at which the averaged residuals are kept
WINDOW_LAG = 6.0 * SIGMA  # s: two averages this far apart share exp(-9) of their noise
ABOVE_MOTION = 20.0  # Hz: above what a vehicle turns with
LAGGED = 1.0  # s, time constant with which an on-board attitude is taken to lean after the apparent vertical
SENSED_CHANNELS = ("p", "q", "r", "north", "east", "down")
XYZ, EULER_ANGLES = ("x", "y", "z"), ("roll", "pitch", "yaw")
FEWEST_KEPT = 60  # rows
SLOPE_OF = "slope_"  # columns of nuisances, see `identify`


class Weak(NamedTuple):
    """t (n,) s, breaks (n,) bool as in `Evidence`; columns (n, 6, P), the residual first; names of all columns.

    turning  False where the attitude is not captured: then the rate channels are left out (zero)
    feeling  False where the accelerometer is none of its own: then the others are
    """

    key: str
    t: np.ndarray
    breaks: np.ndarray
    columns: np.ndarray
    names: list[str]
    turning: bool
    feeling: bool = True


def in_common(flights: Sequence[Weak]) -> list[Weak]:
    """The flights with the columns that all of them have: those with an on-board attitude have more."""
    names = [n for n in flights[0].names if all(n in w.names for w in flights)]
    return [w._replace(columns=w.columns[:, :, [w.names.index(n) for n in names]], names=names) for w in flights]


def windows(width: float, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A Gaussian window and its first two derivatives as convolution kernels (k,) for samples at `rate` Hz.

    Sums are exact on the grid: the window keeps a constant, the derivatives give 1 on t and on t^2 / 2.
    """
    n = int(np.ceil(4.0 * width * rate))
    t = np.arange(-n, n + 1) / rate
    window = np.exp(-0.5 * (t / width) ** 2)
    window /= window.sum()
    slope = -t * window
    slope /= -(slope * t).sum()
    bend = (t * t / width**2 - 1.0) * window
    bend -= window * bend.sum()
    bend /= 0.5 * (bend * t * t).sum()
    return window, slope, bend


def _average(values: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    flat = values.reshape(len(values), -1)
    return fftconvolve(flat, kernel[:, None], mode="same", axes=0).reshape(values.shape)


def lean(specific: np.ndarray, rate: float) -> np.ndarray:
    """Rotation (n, 3), earth axes, of an attitude that follows the apparent vertical slowly, per s of gain.

    specific (n, 3) m/s2, acceleration in earth axes. The apparent vertical leans by z x a / g; the estimate follows it
    with the time constant LAGGED.
    """
    pull = np.stack([-specific[:, 1], specific[:, 0], np.zeros(len(specific))], axis=1) / GRAVITY
    keep = np.exp(-1.0 / (rate * LAGGED))
    return lfilter([1.0 - keep], [1.0, -keep], pull, axis=0) / LAGGED


def noise_free(
    values: np.ndarray, shifted: Sequence[np.ndarray], more: Sequence[np.ndarray], good: np.ndarray, lag: int
) -> np.ndarray:
    """What instruments predict of a measured vector (n, 3): a column whose noise the residual does not hold.

    values   windowed averages of one sensor; they hold noise that the residual holds too, and a column made of them
             would be estimated too large by noise over signal power
    shifted  signals (n, 3) that are instruments `lag` samples before and after, where the noise is another: the values,
             the same quantity by the other source
    more     instruments (n,) with noise of their own (rotor speeds); good (n,) rows that may be used; lag  samples
    What they predict of a stretch of `lag` is learnt without it and its neighbours, whose noise it shares: twenty
    weights of two hundred independent averages hold a tenth of the noise, which is a large part of a small signal.
    Sources: Wooldridge, Econometric Analysis of Cross Section and Panel Data, 2nd ed., 2010, chapter 5 (two-stage least
    squares); Angrist, Imbens & Krueger, Jackknife instrumental variables estimation, J. Appl. Econometrics 14, 1999.
    """
    rows = np.arange(len(values))
    usable = good & np.roll(good, lag) & np.roll(good, -lag)
    edge = 2 * lag  # instruments from nearer the ends of the log are averages of less than a window
    usable[:edge] = usable[max(len(usable) - edge, 0) :] = False
    if np.count_nonzero(usable) < FEWEST_KEPT:
        return values
    before, after = np.maximum(rows - lag, 0), np.minimum(rows + lag, len(rows) - 1)
    around = [signal[place] for signal in shifted for place in (before, after)]
    instruments = np.column_stack([np.ones(len(rows)), *around, *more])
    instruments /= np.maximum(np.sqrt(np.mean(instruments[usable] ** 2, axis=0)), 1e-12)
    used, target = instruments * usable[:, None], values * usable[:, None]
    predicted = instruments @ np.linalg.lstsq(instruments[usable], values[usable], rcond=1e-9)[0]
    predicted[:edge] = predicted[max(len(rows) - edge, 0) :] = values[usable].mean(axis=0)
    whole = used.T @ used, used.T @ target
    for start in range(0, len(rows), lag):
        near = slice(max(start - lag, 0), start + 2 * lag)
        inner, right = (total - used[near].T @ of[near] for total, of in zip(whole, (used, target)))
        own = start + np.flatnonzero(usable[start : start + lag])
        predicted[own] = instruments[own] @ np.linalg.lstsq(inner, right, rcond=1e-12)[0]
    # weights that were learnt elsewhere predict too much: by the values' slope on it, for their noises are apart. Where
    # less than half of what they predict is signal, that slope is noise
    from_mean = predicted - predicted[usable].mean(axis=0)
    power = np.sum(from_mean[usable] ** 2, axis=0)
    slope = np.sum(from_mean[usable] * (values[usable] - values[usable].mean(axis=0)), axis=0)
    return predicted + np.where(slope > 0.5 * power, slope / np.maximum(power, 1e-300) - 1.0, 0.0) * from_mean


def least_noise(raw: np.ndarray, rates: np.ndarray, other: np.ndarray, good: np.ndarray, rate: float) -> np.ndarray:
    """The mean (n, 3) of two measurements, weighted by the noise of each: its noise is not that of their difference.

    raw  gyro (n, 3), rad/s, at `rate` Hz; rates  its windowed averages; other  the captured ones; good (n,) usable rows
    With weights in inverse proportion to the variances, cov(mean, difference) = 0. The gyro's variance is at least that
    of white noise whose density is the median above the motion, where vibration is a few lines. Vibration that a slow
    log folds into the motion, or that resampling took from above it, adds to that. A scale of 1 is then compatible with
    any weight of the capture from there to 1, and the one is taken that leaves least to a scale: the true one lies
    between the regressions on either measurement (Frisch, Statistical Confluence Analysis, 1934; Klepper & Leamer,
    Econometrica 52, 1984).
    """
    if np.count_nonzero(good) < FEWEST_KEPT:
        return rates
    frequency, density = welch(raw, rate, nperseg=min(1024, len(raw)), axis=0)
    quiet = (frequency > ABOVE_MOTION) & (frequency < 0.4 * rate)
    if not quiet.any():
        return rates
    own = np.median(density[quiet], axis=0) / (4.0 * np.sqrt(np.pi) * SIGMA)  # one-sided density through the window
    apart = (rates - other)[good]
    both = np.maximum(apart.var(axis=0), 1e-300)
    least = np.clip(own / both, 0.0, 1.0)
    with_rates = np.mean((rates[good] - rates[good].mean(axis=0)) * (apart - apart.mean(axis=0)), axis=0)
    share = np.clip(with_rates / both, least, 1.0)
    return (1.0 - share) * rates + share * other


def calibrated(measured: np.ndarray, predicted: np.ndarray, other: np.ndarray, good: np.ndarray) -> np.ndarray:
    """What is expected of a quantity (n, 3) whose measurement is noisy: a column that a delay is estimated with.

    measured  with noise; predicted  as by `noise_free`: without noise, and without some of the motion; other  the same
    quantity by the other source, with noise of its own; good (n,) rows whose windows hold nothing else
    With the measured one a delay would be too small, by noise over signal power. Of its difference from the predicted
    one, the share that is motion is the one that the other source shows as well.
    Source: Carroll, Ruppert, Stefanski & Crainiceanu, Measurement Error in Nonlinear Models, 2nd ed., 2006, chapter 4
    (regression calibration).
    """
    if np.count_nonzero(good) < FEWEST_KEPT:
        return measured
    apart, shown = ((of - predicted)[good] for of in (measured, other))
    share = np.mean(apart * shown, axis=0) / np.maximum(np.mean(apart**2, axis=0), 1e-300)
    return predicted + np.clip(share, 0.0, 1.0) * (measured - predicted)


def straightened(flown: Flown, calibration: Mapping[str, Mapping[str, np.ndarray]], late: float) -> Flown:
    """The flight with turned axes, scales, the room and a late rotation set right, as far as they were found.

    Columns are first-order in such faults; a second look at a flight that shows little of them is exact.
    late  s, of the captured position on the log's clock (clocks are tied by rotation: minus the rotation's delay)
    """
    frame = flown.imported.copy()
    gyro, force = true_inertial(frame[list("pqr")].to_numpy(float), frame[["ax", "ay", "az"]].to_numpy(float),
                                calibration["imu"])  # fmt: skip
    t, place = frame["t"].to_numpy(float), frame[list(XYZ)].to_numpy(float)
    q = attitude.from_euler(*frame[list(EULER_ANGLES)].to_numpy(float).T)
    arm = np.asarray(flown.airframe.marker_offset, float)
    if late:
        offset = attitude.rotate(q, arm)
        place = CubicSpline(t, place + offset)(np.clip(t + late, t[0], t[-1])) - offset
    turn = late + float(calibration["capture"]["rotation delay"][0])
    if turn:
        marker = place + attitude.rotate(q, arm)
        q = attitude.interpolate(q, t, t + turn)
        place = marker - attitude.rotate(q, arm)
    capture = {**calibration["capture"], "rotation delay": np.zeros(1)}
    place, turned = true_pose(t, place, q, arm, capture)
    frame[list("pqr")], frame[["ax", "ay", "az"]], frame[list(XYZ)] = gyro, force, place
    frame[list(EULER_ANGLES)] = attitude.to_euler(turned)
    return replace(flown, imported=frame)


def known(flown: Flown) -> np.ndarray:
    """(n,) bool: rows in flight with everything measured, none bridged."""
    frame = flown.imported
    good = frame["onboard_valid"].to_numpy() > 0.5
    if "imu_clipped" in frame:
        good &= frame["imu_clipped"].to_numpy() < 0.5
    if "in_flight" in flown.filtered and len(flown.filtered) == len(frame):
        good &= flown.filtered["in_flight"].to_numpy() > 0.5
    flags = ["position_sample"] + (["attitude_sample"] if flown.metadata["attitude source"] == "capture" else [])
    for flag in flags:
        at = np.flatnonzero(frame[flag].to_numpy() > 0.5)
        if len(at) < FEWEST_KEPT:
            return np.zeros(len(frame), bool)
        wide = np.flatnonzero(np.diff(at) > GAP * np.median(np.diff(at)))
        for i in wide:
            good[at[i] : at[i + 1] + 1] = False
        good[: at[0]] = good[at[-1] :] = False
    return good


def weak_form(flown: Flown) -> Weak:
    """Residual and columns of one flight. Raises DataError when it lacks what is needed or too little of it is left."""
    needed = ["t", *"pqr", "ax", "ay", "az", *EULER_ANGLES, *XYZ, "position_sample", "attitude_sample", "onboard_valid"]
    missing = [c for c in needed if c not in flown.imported]
    if missing or flown.metadata.get("position source") != "capture":
        raise DataError(f"flight {flown.key} has no motion capture, which the comparison with inertial sensors needs")
    turning = flown.metadata["attitude source"] == "capture"
    made = flown.metadata.get("reconstructed") or {}
    if made and not (turning and set(made) == {"accelerometer"}):
        raise DataError(
            f"flight {flown.key} has no {' and no '.join(made)} of its own: what import made of other signals cannot "
            "be compared with a capture"
        )
    frame = flown.imported
    t = frame["t"].to_numpy(float)
    dt = float(np.median(np.diff(t)))
    good = known(flown) & np.isfinite(frame[needed].to_numpy(float)).all(axis=1)
    w, f, x = (np.nan_to_num(frame[list(c)].to_numpy(float)) for c in ("pqr", ("ax", "ay", "az"), XYZ))
    q = attitude.continuous(attitude.from_euler(*np.nan_to_num(frame[list(EULER_ANGLES)].to_numpy(float)).T))
    turn = attitude.matrix(q)
    window, slope, bend = windows(SIGMA, 1.0 / dt)
    spacing = np.median(np.diff(np.flatnonzero(frame["attitude_sample"].to_numpy() > 0.5))) if turning else 1
    reach = max(round(float(spacing)), 1)

    # Both sides over the same steps, from one captured attitude to the next but one. Turns do not commute: a vehicle
    # that shakes about two axes turns about the third by what the mere sum of rates does not hold.
    small = attitude.exponential(0.5 * (w[1:] + w[:-1]) * dt)
    step = small[: len(small) - 2 * reach + 1]
    for k in range(1, 2 * reach):
        step = attitude.multiply(step, small[k : k + len(step)])
    seen, sensed = np.zeros_like(w), np.zeros_like(w)
    sensed[reach:-reach] = attitude.logarithm(step) / (2 * reach * dt)
    step = attitude.multiply(attitude.conjugate(q[: -2 * reach]), q[2 * reach :])
    seen[reach:-reach] = attitude.logarithm(step) / (2 * reach * dt)

    def earth(v: np.ndarray) -> np.ndarray:
        return np.einsum("nij,nj->ni", turn, np.broadcast_to(v, f.shape))

    down = np.array([0.0, 0.0, GRAVITY])
    unit, nothing = np.eye(3), np.zeros(3)
    names: list[str] = []
    columns: list[np.ndarray] = []

    def add(name: str, rates: np.ndarray, acceleration: np.ndarray) -> None:
        names.append(name)
        shown = (rates if turning else nothing, nothing if made else acceleration)
        both = [np.broadcast_to(part, f.shape) for part in shown]
        columns.append(np.hstack(both))

    force = earth(f)
    rates, growth = _average(sensed, window), _average(sensed, slope)
    lag, thrusts = round(WINDOW_LAG / dt), _thrusts(frame, window)
    captured = np.einsum("nji,nj->ni", turn, _average(x - x.mean(0), bend) - down)
    f_free = noise_free(_average(f, window), [_average(f, window), captured], thrusts, good, lag)
    rates_free = least_noise(w, rates, _average(seen, window), good, 1.0 / dt)
    add("residual", _average(sensed - seen, window), _average(force, window) + down - _average(x - x.mean(0), bend))
    axes = _average(turn, window)
    swing = _average(turn - turn.mean(axis=0), bend)
    coriolis = _average(earth(np.cross(w, f)), window)
    spoiled = ~good
    far = len(window) // 2 + reach
    fine = np.convolve(spoiled.astype(float), np.ones(2 * far + 1), "same") < 0.5
    fine[:far] = fine[-far:] = False
    slopes = _average(force + down, slope), np.gradient(_average(x - x.mean(0), bend), dt, axis=0)
    felt_slope, seen_slope = (np.einsum("nji,nj->ni", turn, of) for of in slopes)
    known_slopes = [*np.cross(_average(seen, window), f_free).T, *_thrusts(frame, slope)]
    slope_free = noise_free(felt_slope, [seen_slope], known_slopes, good, lag)
    jerk = earth(calibrated(felt_slope, slope_free, seen_slope, fine)) - coriolis
    for i, axis in enumerate(XYZ):
        add(f"gyro_bias.{axis}", unit[i], nothing)
        add(f"gyro_scale.{axis}", rates_free * unit[i], nothing)
        add(f"accelerometer_bias.{axis}", nothing, axes[:, :, i])
        felt = _average(turn[:, :, i] * f_free[:, i : i + 1], window)
        add(f"accelerometer_scale.{axis}", nothing, felt)
        usual = f_free[good, i].mean() if good.any() else 0.0
        add(f"{SLOPE_OF}{axis}.slope", nothing, felt - usual * axes[:, :, i])  # all of a scale but its mean, a bias
        add(f"imu_lever_arm.{axis}", nothing, swing[:, :, i])
    arm = np.asarray(flown.airframe.marker_offset, float)
    for i, axis in enumerate(EULER_ANGLES):
        askew = _average(earth(np.cross(unit[i], f_free)), window)
        add(f"imu_misalignment.{axis}", -np.cross(unit[i], rates_free), -askew)
        # turned markers displace the tracked point as well
        moved = swing @ np.cross(unit[i], arm)
        add(f"mocap_misalignment.{axis}", np.cross(unit[i], rates_free), askew + moved)
    for i, axis in enumerate(EULER_ANGLES[:2]):
        add(f"room_tilt.{axis}", nothing, np.cross(unit[i], down))
    add("mocap_delay.delay", growth, -coriolis - _average(earth(np.cross(w, arm)), bend))
    add("clock.offset", growth, jerk)
    add("filters.delay", nothing, jerk if turning else nothing)  # of the accelerometer alone, which no header states
    since = (t - t.mean())[:, None]
    add("drawn.clock", -since * growth, -since * jerk)
    add("clock_drift.rate", rates - since * growth, 2.0 * (_average(force, window) + down) - since * jerk)
    if not turning:
        leaning = lean(force + down, 1.0 / dt)
        add("attitude_error.gain", nothing, _average(np.cross(leaning, force), window))

    every = max(round(1.0 / (KEPT_RATE * dt)), 1)
    rows = np.arange(0, len(t), every)
    rows = rows[fine[rows]]
    if len(rows) < FEWEST_KEPT:
        raise DataError(
            f"flight {flown.key} has {len(rows) / KEPT_RATE:.1f} s in the air that sensors and capture saw without "
            f"gaps, expected at least {FEWEST_KEPT / KEPT_RATE:.0f} s"
        )
    breaks = np.concatenate([[True], np.diff(rows) > every])
    stacked = np.stack([c[rows] for c in columns], axis=2)
    return Weak(flown.key, t[rows], breaks, stacked, names, turning, not made)


def _thrusts(frame: pd.DataFrame, window: np.ndarray) -> list[np.ndarray]:
    """Windowed sum of squared rotor speeds (n,), and that times the velocity by the capture; none without telemetry."""
    if not all(n in frame for n in ROTORS):
        return []
    squares = np.nan_to_num(frame[list(ROTORS)].to_numpy(float) ** 2).sum(axis=1)
    moving = [np.nan_to_num(frame[n].to_numpy(float)) for n in "uvw" if n in frame]
    return [_average(column, window) for column in (squares, *(np.sqrt(squares) * m for m in moving), *moving)]


def corrected_already(flown: Flown, names: list[str]) -> np.ndarray:
    """(P,) values of the columns that import estimated and took off this flight: evidence, to be added again."""
    values = np.zeros(len(names))
    sync = flown.metadata.get("synchronisation") or {}
    # the lag was made to follow the clock, the lengths of its seconds stayed
    values[names.index("drawn.clock")] = float((sync.get("clock rate") or {}).get("value") or 0.0)
    arm = (flown.metadata.get("corrections") or {}).get("imu position") or {}
    if arm.get("applied") and arm.get("source") == "hover":
        for axis, value in zip(XYZ, arm["value"]):
            values[names.index(f"imu_lever_arm.{axis}")] = value
    return values
