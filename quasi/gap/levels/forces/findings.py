"""Stated findings of the wrench level: restless air. It does not repeat between equal flights, so it is never fitted.

A gust changes the velocity through the air, and the model's own slope of force by velocity says how large it was. What
each flight's own fit of the model's terms and of the named causes leaves holds the gusts, the sensors' noise, which is
white, and what the model gets wrong; a gust is alike along all axes, an error of a model is not.
Sources: Hoblit, Gust Loads on Aircraft, 1988, chapter 4 (isotropic turbulence); Welch, IEEE Trans. Audio
Electroacoustics 15, 1967.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import welch
from scipy.stats import norm

from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.design import Design, own_fit
from quasi.gap.statistics.log_ratio import PRIOR_FLIGHTS, larger
from quasi.gap.statistics.whitening import stretches

GUST_BAND, NOISE_BAND = (0.1, 3.0), (6.0, 9.0)  # Hz: where gusts are, and where only the sensors' noise is
GUST_SEGMENT = 8.0  # s, of a spectrum
USUAL_GUSTS = 0.4  # m/s, standard deviation of a component that flights indoors have without anybody's remark
GUST_SPREAD = 0.4  # natural log: spread of that between flights, from 0.1 to 0.4 m/s
STRONGER_GUSTS = 1.5  # times the reference flights'
EVEN = 2.0  # largest over smallest axis
LEAST_SLOPE = 0.02  # of m g per m/s: below, a force says nothing about the air


class Unrest(NamedTuple):
    """Of one flight: velocity (3,) m/s and force (3,) N, standard deviations per body axis; memory s; info, samples."""

    velocity: np.ndarray
    force: np.ndarray
    memory: float
    count: float


def unrest_of(flight: Evidence, left: np.ndarray, breaks: np.ndarray, t: np.ndarray) -> Unrest | None:
    """Gusts of one flight; None where no stretch is long enough or the model's forces do not depend on velocity.

    left (m, 6) what the flight's own fit leaves, in the band of the analysis; breaks (m,), t (m,) of its rows
    """
    rate = 1.0 / float(np.median(np.diff(t)))
    length = round(GUST_SEGMENT * rate)
    densities, weights, lags = [], [], []
    for part in stretches(breaks):
        if part.stop - part.start < length:
            continue
        frequency, density = welch(left[part, :3], rate, nperseg=length, axis=0)
        densities.append(density)
        weights.append(part.stop - part.start)
        values = left[part, :3] - left[part, :3].mean(axis=0)
        lags.append([_memory(values[:, k]) / rate for k in range(3)])
    if not densities:
        return None
    mean = np.average(densities, axis=0, weights=weights)
    white = np.median(mean[(frequency > NOISE_BAND[0]) & (frequency < NOISE_BAND[1])], axis=0)
    band = (frequency >= GUST_BAND[0]) & (frequency < GUST_BAND[1])
    force = np.sqrt(np.maximum((mean[band] - white).sum(axis=0) * frequency[1], 0.0))
    gradient = flight.gradient("u", "v", "w")
    slope = np.abs([gradient[:, k, k].mean() for k in range(3)])
    if slope.min() < LEAST_SLOPE * flight.mass * 9.81:
        return None
    memory = float(np.average(lags, axis=0, weights=weights).mean())
    return Unrest(force / slope, force, memory, sum(weights) / rate / max(2.0 * memory, 1.0 / rate))


def _memory(values: np.ndarray) -> float:
    """Samples until the correlation has fallen to 1/e."""
    size = len(values)
    power = np.abs(np.fft.rfft(values, 2 * size)) ** 2
    correlation = np.fft.irfft(power)[:size]
    below = np.flatnonzero(correlation < correlation[0] / np.e)
    return float(below[0]) if len(below) else float(size)


def gusts(
    study: Design, compared: Sequence[bool], causes: Sequence[str] = (), alarm: float = 0.001
) -> list[dict[str, Any]]:
    """Restless air in the compared flights: more than is usual, or more than in the reference flights.

    causes  named ones, fitted to each flight with the model's terms
    alarm  probability of a false finding. Stated only where the air would have to be alike along all three axes.
    """
    named = [c for cause in causes for c in study.columns.causes.get(cause, [])]
    layout = study.columns._replace(shared=[*study.columns.shared, *named])
    groups: dict[bool, list[Unrest]] = {True: [], False: []}
    for flight, part, flag in zip(study.flights, study.thinned, compared):
        left = own_fit(part.columns, layout)
        found = unrest_of(flight, left, part.breaks, flight.t[part.rows])
        if found is not None and found.velocity.min() > 0.0:
            groups[bool(flag)].append(found)
    now, before = groups[True], groups[False]
    if len(now) < 2:
        return []
    axes = np.sqrt(np.mean([u.velocity**2 for u in now], axis=0))
    if axes.max() > EVEN * axes.min():
        return []
    sizes = np.array([np.sqrt(np.mean(u.velocity**2)) for u in now])
    size = float(np.sqrt(np.mean(sizes**2)))
    # a variance of n independent samples is known to sqrt(2/n), its root to half of that
    error = float(np.sqrt(np.mean([1.0 / (2.0 * 3.0 * u.count) for u in now]) / len(now)))
    unusual = float(norm.sf(np.log(size / USUAL_GUSTS) / error))
    force = np.sqrt(np.mean([u.force**2 for u in now], axis=0))
    memory = float(np.mean([u.memory for u in now]))
    evidence: dict[str, Any] = {
        "velocity": size, "std": size * error, "unit": "m/s", "memory": memory, "flights": len(now),
        "force": dict(zip(("Fx", "Fy", "Fz"), map(float, force))), "p": unusual,
    }  # fmt: skip
    because = ""
    if unusual < alarm:
        because = f"more than the {USUAL_GUSTS:g} m/s that flights usually have"
    elif len(before) >= 2:
        rest = np.array([np.sqrt(np.mean(u.velocity**2)) for u in before])
        gain, p = larger(sizes, rest, GUST_SPREAD, PRIOR_FLIGHTS)
        if p < alarm and gain > np.log(STRONGER_GUSTS):
            because = f"{np.exp(gain):.1f} times as much as in the reference flights"
            evidence |= {"times the reference flights": float(np.exp(gain)), "p": p}
    if not because:
        return []
    text = (
        f"the air is restless: forces that no state explains ({force[0]:.2g} N forward, {force[1]:.2g} N sideward, "
        f"{force[2]:.2g} N vertical rms, with a memory of {memory:.1f} s) are like gusts of {size:.2f} ± "
        f"{size * error:.2f} m/s, {because}"
    )
    return [{"id": "gusts", "text": text, "evidence": evidence}]
