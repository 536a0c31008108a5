"""How old the telemetry of one on-board source is against another's: both saw one motion, each stamps it its own way.

Between sources with clocks of their own, tens of milliseconds are at stake, and two rough relations that hold whatever
the airframe give them: roll and pitch acceleration are a mix of the squared rotor speeds and of roll and pitch rate,
which damp; and the derivative of an estimated velocity is the measured acceleration in world axes. Rates of change of
the rotor speeds stay out of that mix: with them any delay could be explained away. Without the damping, speeds look
late by damping over the square of the motion's frequency: 15 to 40 ms for slow turns of a large vehicle.

The age of the rotor telemetry within one log is a few milliseconds, and there roll and pitch deceive: thrust leads the
rotor speed while the inflow builds up, by as much. Yaw does not. Its acceleration is made
of the rotors' aerodynamic torque and the reaction to their own acceleration, nothing faster, and the strong reaction
makes the timing sharp: a delay would need the rotors' second derivative, which is not in the mix.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from quasi.importing.clocks.clock_fit import ClockFit, Pair, Uniform, fit, uniform

GRID = 200.0  # Hz
TELEMETRY_BAND = 12.0  # Hz
LONGEST_TELEMETRY_AGE = 0.15  # s
AGE_GRID, AGE_BAND = 250.0, 30.0  # Hz
YAW_EXPLAINED = 0.96  # share of yaw that an age explains; where less is, the best age can be centiseconds wrong
AGES, AGE_STEP = (-0.010, 0.040), 0.001  # s, tried ages of the rotor telemetry, and their step at most
NOISE_SHARE = 0.9  # of a combination of columns up to which motion is left: noise itself is known to some percent
BLOCKS = 12  # pieces of a flight, for the standard error
LEAST_FLYING = 5.0  # s
LEAST_CHANGES = 13 * BLOCKS  # samples that differ from the one before: as many as the fit has columns in each piece


class Age(NamedTuple):
    """Age of the rotor telemetry, s (positive: logged late), its standard error, and how much of yaw it explains."""

    value: float
    std: float
    explained: float


def rotor_age(t_rotor: np.ndarray, speeds: np.ndarray, t_gyro: np.ndarray, rates: np.ndarray) -> Age | None:
    """How late rotor speeds are logged against the gyro, from yaw.

    t_rotor (n,) s with speeds (n, 4) rad/s; t_gyro (m,) s with rates (m, 3) rad/s, both on one clock, filter delays
    taken off. Yaw acceleration is fitted by the squares and the accelerations of all rotors, the body rates and a
    constant, all in one band, at every age within AGES; the best age is that of the least residual. Every other sample
    of the speeds makes a half. What halves differ by is noise, whose products are taken off (Fuller, Measurement Error
    Models, 1987, section 2.2); combinations of columns that are nearly all noise are left out.
    Standard error by leaving out each of BLOCKS pieces of the flight in turn (jackknife).
    None where the flight is too short or shows none.
    """
    known = np.isfinite(speeds).all(axis=1)
    t_rotor, speeds = t_rotor[known], speeds[known]
    # a logger that is faster than the telemetry repeats each value, with its noise
    fresh = np.flatnonzero(np.any(np.diff(speeds, axis=0, prepend=np.nan) != 0.0, axis=1))
    if len(fresh) < LEAST_CHANGES:
        return None
    if round(np.median(np.diff(t_rotor[fresh])) / np.median(np.diff(t_rotor))) > 1:
        t_rotor, speeds = t_rotor[fresh], speeds[fresh]
    begin, end = max(t_rotor[0], t_gyro[0]), min(t_rotor[-1], t_gyro[-1])
    rate = min(AGE_GRID, 1.0 / float(np.median(np.diff(t_gyro))), 1.0 / float(np.median(np.diff(t_rotor))))
    margin = AGES[1] + 0.1
    if not end - begin > LEAST_FLYING + 2 * margin:
        return None
    t = np.arange(begin, end, 1.0 / rate)
    halved = 0.5 / float(np.median(np.diff(t_rotor)))
    band = min(AGE_BAND, 0.2 * rate, 0.2 * halved)
    low = butter(4, band, fs=rate, output="sos")

    def smooth(times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        fine = np.isfinite(values).all(axis=1)
        columns = np.column_stack([np.interp(t, times[fine], v) for v in values[fine].T])
        apart = np.interp(t, times[fine][1:], np.diff(times[fine]))
        return sosfiltfilt(low, columns, axis=0), apart > 3.0 / rate + 0.005

    turning, lost = smooth(t_gyro, rates)
    halves = [smooth(t_rotor[k::2], speeds[k::2]) for k in (0, 1)]
    # speeds and accelerations of the halves on a grid as fine as the ages
    per = int(np.ceil(1.0 / (rate * AGE_STEP) - 1e-6))
    fine = t[0] + np.arange(len(t) * per) / (rate * per)
    ages = np.arange(round(AGES[0] * rate * per), round(AGES[1] * rate * per) + 1)  # steps of that grid
    curves = [CubicSpline(t, spinning) for spinning, _ in halves]
    spun = [(curve(fine), curve.derivative()(fine)) for curve in curves]
    yaw = np.gradient(turning[:, 2], t)
    middle = np.mean([spinning for spinning, _ in halves], axis=0)
    flying = middle.min(axis=1) > 0.35 * np.percentile(middle.mean(axis=1), 90)
    lost = lost | halves[0][1] | halves[1][1]
    use = flying & ~lost & (t > t[0] + margin) & (t < t[-1] - margin)
    # filters and differences reach a little beyond a gap
    reach = max(round(0.1 * rate), 1)
    use = np.convolve(use, np.ones(2 * reach + 1), "same") > 2 * reach + 0.5
    rows = np.flatnonzero(use)
    if len(rows) < LEAST_FLYING * rate:
        return None
    rows = rows[:: max(int(rate / band / 4.0), 1)]  # products of two signals have twice their band
    scale = float(np.mean(middle[rows]))
    motors = [np.column_stack([(w / scale) ** 2, w_dot / scale / 10.0]) for w, w_dot in spun]
    motor, apart = 0.5 * (motors[0] + motors[1]), 0.5 * (motors[0] - motors[1])
    others = np.column_stack([np.ones(len(rows)), turning[rows], yaw[rows]])
    pieces = [slice(piece[0], piece[-1] + 1) for piece in np.array_split(np.arange(len(rows)), BLOCKS)]

    def products(age: int) -> np.ndarray:
        """Cross-products (pieces, 2, C, C) of all columns and yaw by the mean of the halves, and by half their
        difference."""
        columns = np.column_stack([motor[rows * per + age], others])
        noise = np.column_stack([apart[rows * per + age], np.zeros_like(others)])
        return np.array([[x[piece].T @ x[piece] for x in (columns, noise)] for piece in pieces])

    grams = np.array([products(age) for age in ages])  # (ages, pieces, 2, C, C)
    kept = _shown(*grams.sum(axis=(0, 1)))

    def left(chosen: np.ndarray) -> np.ndarray:
        whole, noise = grams[:, chosen].sum(axis=1).swapaxes(0, 1)
        return _residuals(whole - noise, kept)

    def best(chosen: np.ndarray) -> float:
        near = left(chosen)
        i = int(np.clip(np.argmin(near), 1, len(ages) - 2))
        bend = near[i - 1] - 2 * near[i] + near[i + 1]
        step = 0.5 * (near[i - 1] - near[i + 1]) / bend if bend > 0 else 0.0
        return float((ages[i] + np.clip(step, -1.0, 1.0)) / (rate * per))

    every = np.arange(BLOCKS)
    value = best(every)
    without = np.array([best(np.delete(every, k)) for k in every])
    over = left(every)
    std = float(np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((without - without.mean()) ** 2)))
    if np.argmin(over) in (0, len(ages) - 1):  # the best one may lie beyond
        std = AGES[1] - AGES[0]
    first = grams[0, :, 0].sum(axis=0)
    spread = first[-1, -1] - first[8, -1] ** 2 / first[8, 8]
    explained = 1.0 - over.min() / spread if spread > 0 else 0.0
    return Age(value, std, float(explained))


def _shown(whole: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Combinations (C, K) of the columns, without the last one, of whose square noise makes less than NOISE_SHARE."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(whole), 1e-300))[:-1]
    total, apart = (scale[:, None] * m[:-1, :-1] * scale for m in (whole, noise))
    size, vectors = np.linalg.eigh(total)
    white = vectors[:, size > 1e-12 * size[-1]] / np.sqrt(size[size > 1e-12 * size[-1]])
    share, turn = np.linalg.eigh(white.T @ apart @ white)
    return scale[:, None] * (white @ turn[:, share < NOISE_SHARE])


def _residuals(grams: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Least sums of squares (n,) of the last column on combinations of the others, from cross-products (n, C, C)."""
    a, b = kept.T @ grams[:, :-1, :-1] @ kept, grams[:, -1, :-1] @ kept
    return grams[:, -1, -1] - np.einsum("ni,nij,nj->n", b, np.linalg.pinv(a, rcond=1e-12, hermitian=True), b)


def rotor_lag(t_rotor: np.ndarray, speeds: np.ndarray, t_motion: np.ndarray, rates: np.ndarray) -> ClockFit | None:
    """Lag of the motion's stamps behind the rotors' (t_motion = t_rotor + lag): how much later the gyro is stamped.

    t_rotor (n,) s with speeds (n, k) rad/s; t_motion (m,) s with rates (m, 3) rad/s. The age of the rotor telemetry
    against the gyro is minus the lag. None where the motion is too poor.
    """
    moving, squares = (
        uniform(t_motion, rates[:, :2], GRID, TELEMETRY_BAND),
        uniform(t_rotor, speeds**2 / 1e6, GRID, TELEMETRY_BAND),
    )
    if moving is None or squares is None:
        return None
    first = Uniform(moving.start, moving.step, np.gradient(moving.values, moving.step, axis=0), moving.good)
    return best_fit([Pair("roll and pitch acceleration", first, squares, moving.values)])


def acceleration_lag(
    t_force: np.ndarray, acceleration: np.ndarray, t_state: np.ndarray, velocity: np.ndarray
) -> ClockFit | None:
    """Lag of the velocity's stamps behind the acceleration's (t_state = t_force + lag).

    acceleration (n, 3) m/s2 and velocity (m, 3) m/s in the same world axes. None where the motion is too poor.
    """
    moving, pushed = (
        uniform(t_state, velocity, GRID, TELEMETRY_BAND),
        uniform(t_force, acceleration, GRID, TELEMETRY_BAND),
    )
    if moving is None or pushed is None:
        return None
    first = Uniform(moving.start, moving.step, np.gradient(moving.values, moving.step, axis=0), moving.good)
    return best_fit([Pair("velocity derivative", first, pushed)])


def best_fit(pairs: Sequence[Pair]) -> ClockFit | None:
    """The best constant lag within LONGEST_TELEMETRY_AGE, from several starts: the mix may fit at a wrong one."""
    reference = pairs[0].other.start + 0.5 * pairs[0].other.step * len(pairs[0].other.values)
    fits = [fit(pairs, start, 0.0, reference, fit_rate=False) for start in (-0.06, -0.02, 0.02, 0.06)]
    fits = [f for f in fits if f is not None and abs(f.lag) < LONGEST_TELEMETRY_AGE]
    return max(fits, key=lambda f: f.explained, default=None)
