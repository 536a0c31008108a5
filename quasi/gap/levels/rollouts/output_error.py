"""Output error: parameters of causes from simulations, not from forces and moments.

Short windows are simulated from measured states with measured rotor speeds. What the measurement deviates by at a few
places of a window, velocity, attitude and rate,

    e = S_theta (theta - theta_0) + S_beta beta + S_nu nu_f + r,

theta the causes' parameters, beta corrections of the model's own terms, nu_f what flight f differs by anyway, N(0, s^2)
with the spreads of `nuisance`, r ~ N(0, R) what one window differs by: gusts, a wrong start. R, the covariance within a
window, is that of the learning flights' windows, so that a start error or a force that lasts for the window costs what
it costs there: velocity errors that only follow from errors of attitude weigh nothing. Minimising the squared errors
weighed by R^-1, nu integrated out, is Gauss-Newton:

    (S' R^-1 S) dtheta = S' R^-1 e(theta),   theta <- theta + dtheta

with e(theta) from the full simulation every time and S from the equations of motion linearised about the measured path
(`linear_response`). A slope S that is a little off slows the steps down and does not move the place where they end.
Standard errors come from how the estimate varies from stretch to stretch of the flights (`mixed`).
Sources: Jategaonkar, Flight Vehicle System Identification, 2nd ed., AIAA 2015, sections 4.4 to 4.6; Klein & Morelli,
Aircraft System Identification, AIAA 2006, section 6.2; Maine & Iliff, NASA RP-1138, 1985.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.design import Design, in_stretches
from quasi.gap.levels.rollouts.linear_response import Course, course_of, responses
from quasi.gap.levels.rollouts.open_loop import flight_of, simulated, vectors
from quasi.gap.materiality import Cause
from quasi.gap.statistics.blocks import BLOCK
from quasi.gap.statistics.candidates import Columns
from quasi.gap.statistics.mixed import MixedModel
from quasi.gap.statistics.whitening import Thinned
from quasi.model.model import Model

WINDOW = 0.4  # s; at this length the start is not forgotten and the response still about linear
COMPARED_TIMES = 4  # places of a window that are compared, its end among them
COMPARED_OUTPUTS = 9  # velocity, attitude, rate; a position follows from the velocities before it
NEXT = 4  # windows after one that may still remember it
SHRUNK = 0.1  # share of the covariance within a window that is drawn to its diagonal
MOST_STEPS = 5  # of Gauss-Newton, at most
CONVERGED_STEP = 0.1  # standard errors: a smaller step ends it
DISAGREEMENT = 4.0  # standard errors between the two estimates of one parameter that count as disagreement
FEWEST_WINDOWS = 8  # windows of all flights

Values = dict[str, float]


Windows = list[tuple[Course, np.ndarray]]


def windows_of(study: Design, tables: Mapping[str, pd.DataFrame]) -> Windows:
    """Windows one after another of a study's flights, and what each of its columns makes of them (S, D, P - 1).

    tables  {key: filtered flight}
    """
    result = []
    for evidence, part in zip(study.flights, study.thinned):
        course = windows_in(evidence, tables[evidence.key], part)
        result.append((course, sensitivities(course, part.columns[:, :, 1:])))
    return result


def windows_in(evidence: Evidence, table: pd.DataFrame, thinned: Thinned) -> Course:
    """Windows one after another through a flight, starting at the rows of its thinned columns."""
    times = WINDOW * np.arange(1, COMPARED_TIMES + 1) / COMPARED_TIMES
    flight = flight_of(evidence.key, table, evidence.mass, evidence.inertia)
    return course_of(evidence, flight, times, WINDOW, thinned.rows, thinned.breaks)


def sensitivities(course: Course, columns: np.ndarray) -> np.ndarray:
    """What columns (m, 6, C) make of the outputs that are fitted (S, D, C)."""
    found = responses(course, columns)[:, :, :COMPARED_OUTPUTS]
    return found.reshape(len(found), found.shape[1] * COMPARED_OUTPUTS, found.shape[3])


def deviations(course: Course, model: Model) -> np.ndarray:
    """Measured minus simulated, the outputs that are fitted (S, D); NaN in a window that has diverged."""
    if not len(course.starts):
        return np.zeros((0, len(course.lags) * COMPARED_OUTPUTS))
    horizon = float(course.flight.t[course.lags[-1]] - course.flight.t[0])
    run = simulated(model, course.flight, course.starts, horizon)
    found = vectors(run, course.flight, course.starts, course.lags)[:, :, :COMPARED_OUTPUTS]
    return found.reshape(len(found), -1)


def blocks_in(course: Course) -> np.ndarray:
    """(S,) number of the block of BLOCK seconds that a window lies in."""
    t = course.flight.t[course.starts]
    return ((t - t[0]) / BLOCK).astype(int) if len(t) else np.zeros(0, int)


def covariance_of(errors: Sequence[np.ndarray], nuisance: Sequence[np.ndarray], spread: np.ndarray) -> np.ndarray:
    """Covariance R (D, D) within a window, of errors (S, D) per flight once flights' nuisances (S, D, N) are out."""
    level = np.concatenate(errors)
    level = level[np.isfinite(level).all(axis=1)]
    if len(level) < FEWEST_WINDOWS:
        raise DataError(
            f"{len(level)} windows of {WINDOW:g} s can be simulated, expected at least {FEWEST_WINDOWS}; fly longer"
        )
    level = np.sqrt(np.mean(level**2, axis=0))
    left = []
    for error, columns in zip(errors, nuisance):
        good = np.isfinite(error).all(axis=1)
        y = (error[good] / level).ravel()
        x = (columns[good] / level[:, None]).reshape(-1, len(spread)) * spread
        left.append((y - x @ np.linalg.solve(x.T @ x + np.eye(x.shape[1]), x.T @ y)).reshape(-1, len(level)))
    whole = np.concatenate(left)
    inner = whole.T @ whole / len(whole)
    inner = (1.0 - SHRUNK) * inner + SHRUNK * np.diag(np.diag(inner))
    return inner * np.outer(level, level) * _repeated(left, inner)


def _repeated(left: Sequence[np.ndarray], inner: np.ndarray) -> float:
    """Effective number of windows in a row that repeat one: 1 + 2 (sum of correlations with the next), as gusts last.

    Source: Box, Jenkins & Reinsel, Time Series Analysis, 3rd ed., 1994, section 2.1.5: variance of a mean.
    """
    root = np.linalg.cholesky(inner)
    white = [np.linalg.solve(root, part.T).T for part in left]
    power = sum(float(np.sum(part**2)) for part in white)
    after = [sum(float(np.sum(part[lag:] * part[:-lag])) for part in white) for lag in range(1, NEXT + 1)]
    return max(1.0 + 2.0 * sum(after) / power, 1.0)


def blocks_of(stack: np.ndarray, noise: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Cross-products (B, P, P) of windows (S, D, P) weighed by R^-1, block after block; diverged windows left out."""
    good = np.isfinite(stack).all(axis=(1, 2))
    white = np.linalg.solve(np.linalg.cholesky(noise), stack[good])
    numbers, size = blocks[good], stack.shape[2]
    rows = (white[numbers == n].reshape(-1, size) for n in np.unique(numbers))
    return np.array([own.T @ own for own in rows])


@dataclass
class Fitted:
    """Parameters by output error, cause by cause: deviations from neutral, standard errors, and what speaks against.

    used  whether an estimate settled, lies in the physical range and agrees with that of the forces and moments
    noise (D, D) covariance within a window, for `confirm`; settled  whether all did
    """

    values: list[Values]
    std: list[Values]
    used: list[bool]
    notes: list[str]
    settled: bool
    noise: np.ndarray


Maker = Callable[[Sequence[Values], bool], Model]


def fit(
    study: Design,
    compared: Sequence[bool],
    causes: Sequence[Cause],
    make: Maker,
    windows: Windows,
    ranges: Mapping[str, Sequence[tuple[float, float]]],
) -> Fitted:
    """Fit the causes' parameters by output error over windows of the learning flights, from those of the wrench.

    study    of the learning flights; compared (F,) bool; windows  of `windows_of`
    make     (values of the causes, whether the flight is a compared one) -> the model that is to be simulated
    ranges   {cause: [(low, high)] of its fitted parameters' deviations}
    Raises DataError when too few windows can be simulated, ConfigError for a model that cannot be.
    """
    flags = np.asarray(compared, bool)
    courses, slopes = [list(part) for part in zip(*windows)]
    own = [k - 1 for k in study.columns.nuisance]
    values = [dict(c.value) for c in causes]
    tests, moved = [], np.zeros(len(causes))

    def errors(of: Sequence[Values]) -> list[np.ndarray]:
        models = {flag: make(of, flag) for flag in set(flags.tolist())}
        return [deviations(c, models[bool(flag)]) for c, flag in zip(courses, flags)]

    found = errors(values)
    noise = covariance_of(found, [s[:, :, own] for s in slopes], study.columns.spread)
    for _ in range(MOST_STEPS if causes else 0):
        mixed = _mixed(found, slopes, noise, courses, flags, study.columns)
        tests = []
        for cause in causes:
            others = [o.test.offer for o in causes if o is not cause]
            tests.append(mixed.test(cause.test.offer, others, mixed.pooled(cause.since)))
        for k, (value, cause, test) in enumerate(zip(values, causes, tests)):
            moved[k] = np.max(np.abs(test.value) / test.std)
            for n, step in zip(_names(cause), test.value):
                value[n] = value.get(n, 0.0) + float(step)
        if moved.max() < CONVERGED_STEP:
            break
        found = errors(values)
    std = [dict(zip(_names(c), map(float, t.std))) for c, t in zip(causes, tests)]
    used, notes = [], []
    for cause, value, error, last in zip(causes, values, std, moved):
        why = _against(cause, value, error, last < CONVERGED_STEP, ranges.get(cause.effect.id))
        used.append(not why)
        if why:
            notes.append(f"{cause.effect.id}: {why}; roll-outs used its value from forces and moments")
    return Fitted(values, std, used, notes, bool(np.all(moved < CONVERGED_STEP)), noise)


def apart(cause: Cause, value: Values, std: Values) -> dict[str, float]:
    """{parameter: how many standard errors two estimates of it are apart}; value, std  by output error"""
    return {n: float(abs(value[n] - cause.value[n]) / np.hypot(std[n], cause.std[n])) for n in _names(cause)}


def disagreeing(cause: Cause, value: Values, std: Values) -> dict[str, float]:
    """`apart`, of the parameters whose two estimates disagree."""
    return {n: times for n, times in apart(cause, value, std).items() if times > DISAGREEMENT}


def _names(cause: Cause) -> list[str]:
    return [cause.effect.fitted[k] for k in cause.test.offer.which]


def _mixed(
    errors: Sequence[np.ndarray], slopes: Sequence[np.ndarray], noise: np.ndarray, courses: Sequence[Course],
    compared: np.ndarray, columns: Columns,
) -> MixedModel:  # fmt: skip
    grams = []
    for error, slope, course in zip(errors, slopes, courses):
        stack = np.concatenate([error[:, :, None], slope], axis=2)
        size = stack.shape[2]
        blocks = blocks_of(stack, noise, blocks_in(course)) if len(stack) else np.zeros((0, size, size))
        grams.append(in_stretches(blocks, len(courses)) if len(blocks) else np.zeros((1, size, size)))
    return MixedModel(grams, compared, columns)


def _against(
    cause: Cause, value: Values, std: Values, settled: bool, limits: Sequence[tuple[float, float]] | None
) -> str:
    """Why an estimate by output error is not to be used, or nothing."""
    if not settled:
        return f"its fit by output error did not settle in {MOST_STEPS} steps"
    far = disagreeing(cause, value, std)
    for n in _names(cause):
        if n in far:
            return (
                f"output error puts {n} {far[n]:.1f} standard errors off the value from forces and moments "
                f"({value[n]:.3g} against {cause.value[n]:.3g} beyond neutral)"
            )
        low, high = (limits or {})[cause.effect.fitted.index(n)] if limits else (-np.inf, np.inf)
        if not low <= value[n] <= high:
            return f"output error puts {n} outside what is physical ({value[n]:.3g} beyond neutral)"
    return ""
