"""Output error: parameters of causes from simulations, not from forces and moments.

Short windows are simulated from measured states with measured rotor speeds. What the measurement deviates by after
half of a window and at its end,

    e = S_theta (theta - theta_0) + S_beta beta + S_nu nu_f + r,

theta the causes' parameters, beta corrections of the model's own terms, nu_f what flight f differs by anyway, N(0, s^2)
with the spreads of `nuisance`, r ~ N(0, R) what one window differs by: gusts, a wrong start. R, the covariance within a
window, is that of the learning flights' windows, so that a start error or a force that lasts for the window costs what
it costs there: velocity errors that only follow from errors of attitude weigh nothing. Minimising the squared errors
weighed by R^-1, nu integrated out, is Gauss-Newton:

    (S' R^-1 S) dtheta = S' R^-1 e(theta),   theta <- theta + dtheta

with e(theta) from the full simulation every time and S from the equations of motion linearised about the measured path:

    dtheta/dt = w - W x theta,  dv/dt = F_v v + F_w w + f/m + g x theta - W x v + V x w,
    I dw/dt = M_v v + M_w w + mu - w x (I W) - W x (I w)

(theta, v, w small deviations of attitude, velocity and rate in body axes; V, W the measured ones; f, mu a column of
forces and moments). A slope S that is a little off slows the steps down and does not move the place where they end.
Standard errors come from how the estimate varies from stretch to stretch of the flights (`mixed`).
Sources: Jategaonkar, Flight Vehicle System Identification, 2nd ed., AIAA 2015, sections 4.4 to 4.6; Klein & Morelli,
Aircraft System Identification, AIAA 2006, section 6.2; Maine & Iliff, NASA RP-1138, 1985.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numba import njit

from quasi.attitude import GRAVITY, conjugate, from_euler, multiply, rotate, rotate_inverse
from quasi.errors import DataError
from quasi.gap.evidence import Evidence
from quasi.gap.mixed import Columns, Mixed
from quasi.gap.rollouts import Flight, flight_of, simulated
from quasi.gap.study import BLOCK, Study, in_stretches
from quasi.gap.whitening import Thinned, stretches
from quasi.gap.wrench import Cause
from quasi.standalone.model import Model

WINDOW = 0.4  # s; at this length the start is not forgotten and the response still about linear
PARTS = 2  # of a window: its middle and its end are compared
OUTPUTS = 9  # velocity, attitude, rate
SHRUNK = 0.1  # share of the covariance within a window that is drawn to its diagonal
STEPS = 5  # of Gauss-Newton, at most
SMALL = 0.1  # standard errors: a smaller step ends it
APART = 4.0  # standard errors between the two estimates of one parameter that count as disagreement
LEAST = 8  # windows of all flights

Values = dict[str, float]


class Course(NamedTuple):
    """The measured path of a flight that windows start from.

    starts (S,) rows of `flight`; first (S,) rows of the arrays below; lags, places (PARTS,) rows after them where
    a window is compared, in both; rates, velocity (m, 3) over ground, down (m, 3) in body axes, slopes (m, 6, 6) of the
    model's wrench by u v w p q r; step s
    """

    flight: Flight
    starts: np.ndarray
    first: np.ndarray
    lags: np.ndarray
    places: np.ndarray
    rates: np.ndarray
    velocity: np.ndarray
    down: np.ndarray
    slopes: np.ndarray
    step: float
    mass: float
    inertia: np.ndarray

    @property
    def blocks(self) -> np.ndarray:
        """(S,) number of the block of BLOCK seconds that a window lies in."""
        t = self.flight.t[self.starts]
        return ((t - t[0]) / BLOCK).astype(int) if len(t) else np.zeros(0, int)


def course_of(evidence: Evidence, table: pd.DataFrame, thinned: Thinned, window: float = WINDOW) -> Course:
    """Windows one after another through the valid stretches of a flight.

    table  the filtered flight that `evidence` was gathered from; thinned  its columns, whose rows the windows start at
    """
    flight = flight_of(evidence.key, table)
    rows, t = thinned.rows, evidence.t[thinned.rows]
    steps = np.diff(t)
    step = float(np.median(steps)) if len(steps) else window
    places = np.maximum(np.round(window * np.arange(1, PARTS + 1) / PARTS / step).astype(int), np.arange(1, PARTS + 1))
    sampling = float(np.median(np.diff(flight.t)))
    lags = np.round(places * step / sampling).astype(int)
    bad = np.concatenate([[0], np.cumsum(~flight.valid)])
    starts, first = [], []
    for part in stretches(thinned.breaks):
        for k in range(part.start, part.stop - places[-1], places[-1]):
            row = int(np.argmin(np.abs(flight.t - t[k])))
            end = row + lags[-1] + 1
            if end < len(flight.t) and bad[end] == bad[row]:
                starts.append(row)
                first.append(k)
    slopes = evidence.gradient("u", "v", "w", "p", "q", "r")[rows]
    velocity = evidence.take("u", "v", "w")[rows]
    return Course(
        flight, np.array(starts, int), np.array(first, int), lags, places, evidence.rates[rows], velocity,
        evidence.down[rows], np.ascontiguousarray(slopes), step, evidence.mass, evidence.inertia,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _slope(x, i, rates, velocity, down, slopes, columns, mass, inertia, inverse, wrench, out):
    """Derivative of the deviations x (9, C): velocity, attitude, rate; wrench (6, C) is room to work in."""
    p, q, r = rates[i, 0], rates[i, 1], rates[i, 2]
    u, v, w = velocity[i, 0], velocity[i, 1], velocity[i, 2]
    gx, gy, gz = GRAVITY * down[i, 0], GRAVITY * down[i, 1], GRAVITY * down[i, 2]
    count = x.shape[1]
    for k in range(6):
        for c in range(count):
            wrench[k, c] = columns[i, k, c]
        for j in range(6):
            slope, at = slopes[i, k, j], j if j < 3 else j + 3
            for c in range(count):
                wrench[k, c] += slope * x[at, c]
    # angular momentum of the measured rates
    hx = inertia[0, 0] * p + inertia[0, 1] * q + inertia[0, 2] * r
    hy = inertia[1, 0] * p + inertia[1, 1] * q + inertia[1, 2] * r
    hz = inertia[2, 0] * p + inertia[2, 1] * q + inertia[2, 2] * r
    for c in range(count):
        du, dv, dw = x[0, c], x[1, c], x[2, c]
        a, b, d = x[3, c], x[4, c], x[5, c]
        dp, dq, dr = x[6, c], x[7, c], x[8, c]
        out[0, c] = wrench[0, c] / mass + (gy * d - gz * b) - (q * dw - r * dv) + (v * dr - w * dq)
        out[1, c] = wrench[1, c] / mass + (gz * a - gx * d) - (r * du - p * dw) + (w * dp - u * dr)
        out[2, c] = wrench[2, c] / mass + (gx * b - gy * a) - (p * dv - q * du) + (u * dq - v * dp)
        out[3, c] = dp - (q * d - r * b)
        out[4, c] = dq - (r * a - p * d)
        out[5, c] = dr - (p * b - q * a)
        kx = inertia[0, 0] * dp + inertia[0, 1] * dq + inertia[0, 2] * dr
        ky = inertia[1, 0] * dp + inertia[1, 1] * dq + inertia[1, 2] * dr
        kz = inertia[2, 0] * dp + inertia[2, 1] * dq + inertia[2, 2] * dr
        mx = wrench[3, c] - (dq * hz - dr * hy) - (q * kz - r * ky)
        my = wrench[4, c] - (dr * hx - dp * hz) - (r * kx - p * kz)
        mz = wrench[5, c] - (dp * hy - dq * hx) - (p * ky - q * kx)
        for k in range(3):
            out[6 + k, c] = inverse[k, 0] * mx + inverse[k, 1] * my + inverse[k, 2] * mz


@njit(cache=True, error_model="numpy")
def _respond(step, first, places, rates, velocity, down, slopes, columns, mass, inertia, inverse, out):
    """Fills out (S, places, 9, C) by steps of Heun's method, the columns linear between their samples."""
    count = columns.shape[2]
    x, y = np.zeros((9, count)), np.zeros((9, count))
    one, two, wrench = np.zeros((9, count)), np.zeros((9, count)), np.zeros((6, count))
    for s in range(len(first)):
        x[:] = 0.0
        part = 0
        for n in range(places[-1]):
            i = first[s] + n
            _slope(x, i, rates, velocity, down, slopes, columns, mass, inertia, inverse, wrench, one)
            for k in range(9):
                for c in range(count):
                    y[k, c] = x[k, c] + step * one[k, c]
            _slope(y, i + 1, rates, velocity, down, slopes, columns, mass, inertia, inverse, wrench, two)
            for k in range(9):
                for c in range(count):
                    x[k, c] += 0.5 * step * (one[k, c] + two[k, c])
            if n + 1 == places[part]:
                u, v, w = velocity[i + 1, 0], velocity[i + 1, 1], velocity[i + 1, 2]
                for c in range(count):
                    # velocity in the earth frame, along the measured body axes
                    out[s, part, 0, c] = x[0, c] + x[4, c] * w - x[5, c] * v
                    out[s, part, 1, c] = x[1, c] + x[5, c] * u - x[3, c] * w
                    out[s, part, 2, c] = x[2, c] + x[3, c] * v - x[4, c] * u
                    for k in range(3, 9):
                        out[s, part, k, c] = x[k, c]
                part += 1


def responses(course: Course, columns: np.ndarray) -> np.ndarray:
    """What columns of the wrench (m, 6, C), N and N m, make of the outputs (S, PARTS * OUTPUTS, C)."""
    out = np.zeros((len(course.first), len(course.places), OUTPUTS, columns.shape[2]))
    columns = np.ascontiguousarray(columns)
    inertia = np.ascontiguousarray(course.inertia, float)
    _respond(
        course.step, course.first, course.places, course.rates, course.velocity, course.down, course.slopes, columns,
        course.mass, inertia, np.linalg.inv(inertia), out,
    )  # fmt: skip
    return out.reshape(len(out), -1, columns.shape[2])


def deviations(course: Course, model: Model) -> np.ndarray:
    """Measured minus simulated at the lags (S, PARTS * OUTPUTS): velocity along the measured body axes, attitude, rate.

    A window that diverges holds NaN.
    """
    flight, lags = course.flight, course.lags
    if not len(course.starts):
        return np.zeros((0, len(lags) * OUTPUTS))
    horizon = float(flight.t[lags[-1]] - flight.t[0])
    run = simulated(model, flight, course.starts, horizon)[:, lags]
    measured = flight.states[course.starts[:, None] + lags]
    q, wanted = (from_euler(*np.moveaxis(s[..., :3], -1, 0)) for s in (run, measured))
    velocity = measured[..., 3:6] - rotate_inverse(wanted, rotate(q, run[..., 3:6]))
    turn = multiply(conjugate(q), wanted)
    turn = 2.0 * turn[..., 1:] * np.sign(turn[..., :1])
    found = np.concatenate([velocity, turn, measured[..., 6:9] - run[..., 6:9]], axis=-1)
    found = found.reshape(len(found), -1)
    return np.where(np.isfinite(found).all(axis=1)[:, None], found, np.nan)


def covariance_of(errors: Sequence[np.ndarray], nuisance: Sequence[np.ndarray], spread: np.ndarray) -> np.ndarray:
    """Covariance R (D, D) within a window, of errors (S, D) per flight once flights' nuisances (S, D, N) are out."""
    level = np.concatenate(errors)
    level = np.sqrt(np.mean(level[np.isfinite(level).all(axis=1)] ** 2, axis=0))
    left = []
    for error, columns in zip(errors, nuisance):
        good = np.isfinite(error).all(axis=1)
        y = (error[good] / level).ravel()
        x = (columns[good] / level[:, None]).reshape(len(y), -1) * spread
        left.append((y - x @ np.linalg.solve(x.T @ x + np.eye(x.shape[1]), x.T @ y)).reshape(-1, len(level)))
    left = np.concatenate(left)
    if len(left) < LEAST:
        raise DataError(f"{len(left)} windows of {WINDOW:g} s can be simulated, expected at least {LEAST}; fly longer")
    inner = left.T @ left / len(left)
    inner = (1.0 - SHRUNK) * inner + SHRUNK * np.diag(np.diag(inner))
    return inner * np.outer(level, level)


def blocks_of(stack: np.ndarray, noise: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Cross-products (B, P, P) of windows (S, D, P) weighed by R^-1, block after block; diverged windows left out."""
    good = np.isfinite(stack).all(axis=(1, 2))
    white = np.linalg.solve(np.linalg.cholesky(noise), stack[good])
    numbers = blocks[good]
    return np.array([np.einsum("sdi,sdj->ij", w, w) for n in np.unique(numbers) for w in [white[numbers == n]]])


@dataclass
class Fitted:
    """Parameters by output error, cause by cause: deviations from neutral, standard errors, and what speaks against.

    used  whether an estimate converged, lies in the physical range and agrees with that of the forces and moments
    noise (D, D) covariance within a window, for `confirm`
    """

    values: list[Values]
    std: list[Values]
    used: list[bool]
    notes: list[str]
    converged: bool
    noise: np.ndarray
    steps: int = 0


Maker = Callable[[Sequence[Values], bool], Model]
Courses = list[tuple[Course, np.ndarray]]


def courses_of(study: Study, tables: Mapping[str, pd.DataFrame], window: float = WINDOW) -> Courses:
    """Windows of a study's flights, and what each of its columns makes of them (S, PARTS * OUTPUTS, P - 1)."""
    result = []
    for flight, part in zip(study.flights, study.thinned):
        course = course_of(flight, tables[flight.key], part, window)
        result.append((course, responses(course, part.columns[:, :, 1:])))
    return result


def fit(
    study: Study,
    compared: Sequence[bool],
    causes: Sequence[Cause],
    make: Maker,
    windows: Courses,
    ranges: Mapping[str, Sequence[tuple[float, float]]],
    pooled: Sequence[str] = (),
) -> Fitted:
    """Fit the causes' parameters by output error over windows of the learning flights, from those of the wrench.

    study    of the learning flights; compared (F,) bool; windows  of `courses_of`
    make     (values of the causes, whether the flight is a compared one) -> the model that is to be simulated
    ranges   {cause: [(low, high)] of its fitted parameters' deviations}
    pooled   causes that belong to the model's own terms here, see `Mixed.test`
    Raises DataError when too few windows can be simulated, ConfigError for a model that cannot be.
    """
    flags = np.asarray(compared, bool)
    courses, slopes = [list(part) for part in zip(*windows)]
    own = [k - 1 for k in study.columns.nuisance]
    values = [dict(c.value) for c in causes]
    noise, tests, steps, converged = np.zeros((0, 0)), [], 0, not causes

    def errors(of: Sequence[Values]) -> list[np.ndarray]:
        models = {flag: make(of, flag) for flag in set(flags.tolist())}
        return [deviations(c, models[bool(flag)]) for c, flag in zip(courses, flags)]

    found = errors(values)
    noise = covariance_of(found, [s[:, :, own] for s in slopes], study.columns.spread)
    while causes and steps < STEPS:
        steps += 1
        mixed = _mixed(found, slopes, noise, courses, flags, study.columns)
        tests = []
        for cause in causes:
            others = [o.test.offer for o in causes if o is not cause]
            tests.append(mixed.test(cause.test.offer, others, pooled if cause.since == "changed" else []))
        largest = 0.0
        for value, cause, test in zip(values, causes, tests):
            for n, step, std in zip(_names(cause), test.value, test.std):
                value[n] = value.get(n, 0.0) + float(step)
                largest = max(largest, abs(step) / std)
        found = errors(values)
        if largest < SMALL:
            converged = True
            break
    std = [dict(zip(_names(c), map(float, t.std))) for c, t in zip(causes, tests)]
    used, notes = [], []
    for cause, value, error in zip(causes, values, std):
        why = _against(cause, value, error, converged, ranges.get(cause.effect.id))
        used.append(not why)
        if why:
            notes.append(f"{cause.effect.id}: {why}; what the forces and moments tell is used")
    return Fitted(values, std, used, notes, converged, noise, steps)


def _names(cause: Cause) -> list[str]:
    return [cause.effect.fitted[k] for k in cause.test.offer.which]


def _mixed(
    errors: Sequence[np.ndarray], slopes: Sequence[np.ndarray], noise: np.ndarray, courses: Sequence[Course],
    compared: np.ndarray, columns: Columns,
) -> Mixed:  # fmt: skip
    grams = []
    for error, slope, course in zip(errors, slopes, courses):
        stack = np.concatenate([error[:, :, None], slope], axis=2)
        size = stack.shape[2]
        blocks = blocks_of(stack, noise, course.blocks) if len(stack) else np.zeros((0, size, size))
        grams.append(in_stretches(blocks) if len(blocks) else np.zeros((1, size, size)))
    return Mixed(grams, compared, columns)


def _against(
    cause: Cause, value: Values, std: Values, converged: bool, limits: Sequence[tuple[float, float]] | None
) -> str:
    """Why an estimate by output error is not to be used, or nothing."""
    if not converged:
        return f"its fit by output error did not settle in {STEPS} steps"
    for n in _names(cause):
        apart = abs(value[n] - cause.value[n]) / np.hypot(std[n], cause.std[n])
        if apart > APART:
            return (
                f"output error puts {n} {apart:.1f} standard errors off what forces and moments tell "
                f"({value[n]:.3g} against {cause.value[n]:.3g} beyond neutral)"
            )
        low, high = (limits or {})[cause.effect.fitted.index(n)] if limits else (-np.inf, np.inf)
        if not low <= value[n] <= high:
            return f"output error puts {n} outside what is physical ({value[n]:.3g} beyond neutral)"
    return ""
