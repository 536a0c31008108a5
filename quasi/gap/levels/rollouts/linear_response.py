"""How simulated windows of a flight answer to small changes of force and moment: the equations of motion, linearised.

Deviations of attitude (a, rad), velocity (v), rate (w) and position (x), all along body axes, from the measured path
with velocity V, rate W, gravity g in body axes, and a change of force f and moment m:

    da/dt = w - W x a              dv/dt = (F_v v + F_w w + f)/mass + g x a - W x v + V x w
    dx/dt = v + a x V - W x x      I dw/dt = M_v v + M_w w + m - w x (I W) - W x (I w)

F_v .. M_w are slopes of the model's forces and moments by velocity and rates. One pass gives what any number of columns
(causes, terms of the model, nuisances) make of every window, for the cost of a few simulations.
Source: Stevens, Lewis & Johnson, Aircraft Control and Simulation, 3rd ed., 2016, sections 1.7 and 3.7.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.rollouts.open_loop import VECTOR_SIZE, Flight
from quasi.gap.statistics.whitening import stretches


class Course(NamedTuple):
    """The measured path of a flight that windows start from.

    flight; starts (S,) rows of it; lags (K,) its rows after a start at which a window is looked at
    first (S,) rows of the arrays below; places (K,) rows after them; step s between rows
    rates, velocity (m, 3) over ground, down (m, 3) in body axes; slopes (m, 6, 6) of the wrench by u v w p q r
    """

    flight: Flight
    starts: np.ndarray
    lags: np.ndarray
    first: np.ndarray
    places: np.ndarray
    step: float
    rates: np.ndarray
    velocity: np.ndarray
    down: np.ndarray
    slopes: np.ndarray
    mass: float
    inertia: np.ndarray


def course_of(
    evidence: Evidence, flight: Flight, times: Sequence[float], every: float, rows: np.ndarray | None = None,
    breaks: np.ndarray | None = None,
) -> Course:  # fmt: skip
    """Windows through the valid stretches of a flight.

    times   s after the start at which a window is looked at, rising; every  s between starts
    rows    (m,) of the evidence that columns will be given at, with breaks (m,) bool where a stretch begins; None
            takes all rows
    """
    rows = np.arange(len(evidence)) if rows is None else rows
    breaks = evidence.breaks if breaks is None else breaks
    t = evidence.t[rows]
    step = float(np.median(np.diff(t))) if len(t) > 1 else times[-1]
    places = np.maximum.accumulate(np.maximum(np.round(np.asarray(times) / step).astype(int), 1))
    sampling = float(np.median(np.diff(flight.t)))
    lags = np.round(places * step / sampling).astype(int)
    bad = np.concatenate([[0], np.cumsum(~flight.valid)])
    near = np.clip(np.searchsorted(flight.t, t), 1, len(flight.t) - 1)
    near -= t - flight.t[near - 1] < flight.t[near] - t
    first = [
        k
        for part in stretches(breaks)
        for k in range(part.start, part.stop - places[-1], max(round(every / step), 1))
        if near[k] + lags[-1] < len(flight.t) and bad[near[k] + lags[-1] + 1] == bad[near[k]]
    ]
    first = np.array(first, int)
    slopes = evidence.gradient("u", "v", "w", "p", "q", "r")[rows]
    return Course(
        flight, near[first], lags, first, places, step, evidence.rates[rows], evidence.take("u", "v", "w")[rows],
        evidence.down[rows], np.ascontiguousarray(slopes), evidence.mass, np.ascontiguousarray(evidence.inertia, float),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _slope(x, i, rates, velocity, down, slopes, columns, mass, inertia, inverse, wrench, out):
    """Derivative of deviations x (12, C): velocity, attitude, rate, position; wrench (6, C) is room to work in."""
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
        px, py, pz = x[9, c], x[10, c], x[11, c]
        out[0, c] = wrench[0, c] / mass + (gy * d - gz * b) - (q * dw - r * dv) + (v * dr - w * dq)
        out[1, c] = wrench[1, c] / mass + (gz * a - gx * d) - (r * du - p * dw) + (w * dp - u * dr)
        out[2, c] = wrench[2, c] / mass + (gx * b - gy * a) - (p * dv - q * du) + (u * dq - v * dp)
        out[3, c] = dp - (q * d - r * b)
        out[4, c] = dq - (r * a - p * d)
        out[5, c] = dr - (p * b - q * a)
        out[9, c] = du + (b * w - d * v) - (q * pz - r * py)
        out[10, c] = dv + (d * u - a * w) - (r * px - p * pz)
        out[11, c] = dw + (a * v - b * u) - (p * py - q * px)
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
    """Fills out (S, K, 12, C) by steps of Heun's method, the columns linear between their samples."""
    count = columns.shape[2]
    x, y = np.zeros((12, count)), np.zeros((12, count))
    ends, wrench = np.zeros((2, 12, count)), np.zeros((6, count))
    for s in range(len(first)):
        x[:] = 0.0
        part = 0
        for n in range(places[-1]):
            i = first[s] + n
            for k in range(12):
                for c in range(count):
                    y[k, c] = x[k, c]
            for stage in range(2):
                _slope(
                    y, i + stage, rates, velocity, down, slopes, columns, mass, inertia, inverse, wrench, ends[stage]
                )
                for k in range(12):
                    for c in range(count):
                        y[k, c] = x[k, c] + step * ends[0, k, c]
            for k in range(12):
                for c in range(count):
                    x[k, c] += 0.5 * step * (ends[0, k, c] + ends[1, k, c])
            while part < len(places) and n + 1 == places[part]:
                u, v, w = velocity[i + 1, 0], velocity[i + 1, 1], velocity[i + 1, 2]
                for c in range(count):
                    # velocity in the earth frame, along the measured body axes
                    out[s, part, 0, c] = x[0, c] + x[4, c] * w - x[5, c] * v
                    out[s, part, 1, c] = x[1, c] + x[5, c] * u - x[3, c] * w
                    out[s, part, 2, c] = x[2, c] + x[3, c] * v - x[4, c] * u
                    for k in range(3, 12):
                        out[s, part, k, c] = x[k, c]
                part += 1


def responses(course: Course, columns: np.ndarray) -> np.ndarray:
    """What columns (m, 6, C) of the wrench, N and N m, make of the windows (S, K, VECTOR_SIZE, C), see `vectors`."""
    out = np.zeros((len(course.first), len(course.places), VECTOR_SIZE, columns.shape[2]))
    _respond(
        course.step, course.first, course.places, course.rates, course.velocity, course.down, course.slopes,
        np.ascontiguousarray(columns), course.mass, course.inertia, np.linalg.inv(course.inertia), out,
    )  # fmt: skip
    return out
