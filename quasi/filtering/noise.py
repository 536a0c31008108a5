"""Noise levels asked of the innovations, and whether a filter run is consistent with them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2

from quasi.attitude import continuous
from quasi.filtering.ekf import (
    ATTITUDE_KIND,
    MEASUREMENT_KINDS,
    POSITION_KIND,
    FilterResult,
    Inputs,
    cost,
    forward,
    unpack,
)

GATE = float(chi2.ppf(0.9999, 3))  # an honest measurement is thrown away once in ten thousand
LOOSE_GATE = 400.0  # while the levels are not yet known
FACTORS = 6  # factors on gyro, accelerometer, attitude, position, velocity, and on the accelerometer by folded lines
FOLDED = 5  # place of the last
NOISE_WINDOW, WINDOWS = 5.0, 3  # s, number of stretches of flight in which the levels are asked
LEAST_FOLDED = 0.1  # standard deviation of the share of folded lines, below which their factor cannot be separated
PRIOR = 1.0  # standard deviation of the logarithm of a noise level before the innovations are asked
SEEN = 0.7  # of the scatter that positions show by themselves, at least, is their noise
CONSISTENT = (0.6, 1.6)  # mean normalised innovation squared per degree of freedom
REJECTED = 0.05  # share of measurements that an honest model rejects at most
CORRELATED = 0.5  # autocorrelation from one innovation to the next that an honest model does not reach


def _window(inputs: Inputs, run: FilterResult, first: int, last: int) -> Inputs:
    """The same flight from sample `first` to `last`, started from what the forward pass knew there."""
    part = slice(first, last)
    return inputs._replace(
        gyro=inputs.gyro[part],
        accel=inputs.accel[part],
        noise=inputs.noise[part],
        used=inputs.used[part],
        attitude=inputs.attitude[part],
        position=inputs.position[part],
        velocity=inputs.velocity[part],
        quaternion=run.quaternion[first].copy(),
        state=run.state[first].copy(),
        covariance=unpack(run.covariance[first]) * 2.0,
    )


def _stretches(flying: np.ndarray, n: int, length: int, folded: np.ndarray) -> list[tuple[int, int]]:
    """Up to WINDOWS stretches of `length` samples spread over the flight, or all of it when it is short.

    Where folded lines (share `folded` (N,)) are asked for as well and these stretches hold few, the stretch that has
    most of them follows.
    """
    at = np.flatnonzero(flying)
    first, last = (int(at[0]), int(at[-1]) + 1) if len(at) > length else (0, n)
    count = min(WINDOWS, max(1, (last - first) // length))
    length = min(length, last - first)
    starts = np.linspace(first, last - length, count + 2)[1:-1] if count > 1 else [(first + last - length) / 2]
    found = [(int(s), int(s) + length) for s in starts]
    if folded.any() and last - first > length:
        total = np.concatenate([[0.0], np.cumsum(folded * flying)])
        sums = total[first + length : last + 1] - total[first : last + 1 - length]
        most = first + int(np.argmax(sums))
        if max(total[b] - total[a] for a, b in found) < 0.5 * sums.max():
            found.append((most, most + length))
    return found


def with_levels(inputs: Inputs, factors: np.ndarray, flying: np.ndarray, folded: np.ndarray) -> Inputs:
    """Noise scaled by factors (FACTORS,): gyro and accelerometer where `flying`, then attitude, position, velocity.

    The last factor, raised to the share `folded` (N,), scales the accelerometer as well.
    """
    noise, rows = inputs.noise.copy(), slice(None) if flying.all() else flying
    noise[rows, :3] *= factors[0]
    noise[rows, 3:] *= factors[1] * (factors[FOLDED] ** folded[rows, None] if factors[FOLDED] != 1.0 else 1.0)
    return inputs._replace(noise=noise, std=inputs.std * factors[2:FOLDED, None])


def scatter(t: np.ndarray, values: np.ndarray) -> float:
    """Noise of samples (m, 3) at times t (m,), from third divided differences, which smooth motion leaves near zero."""
    if len(t) < 20:
        return 0.0
    at = np.stack([t[i : len(t) - 3 + i] for i in range(4)], axis=1)
    apart = at[:, :, None] - at[:, None, :] + np.eye(4)
    weights = 1.0 / np.prod(apart, axis=2)
    weights /= np.sqrt(np.sum(weights**2, axis=1, keepdims=True))
    found = sum(weights[:, i, None] * values[i : len(t) - 3 + i] for i in range(4))
    return float(np.median(np.abs(found)) / 0.6745)


def estimate_levels(inputs: Inputs, flying: np.ndarray, floor: np.ndarray, folded: np.ndarray) -> np.ndarray:
    """Factors (FACTORS,) on the noise of gyro, accelerometer, attitude, position, velocity, by maximum likelihood.

    The likelihood of the innovations is maximised over stretches of flight; an outlier counts little more than
    the gate's value, so that it does not drive the levels. The last factor is on the accelerometer while a rotor's line
    folds to nearly 0 Hz: such a line is no white noise, and one level for the whole flight would be too low there and
    too high elsewhere. flying (N,) bool; floor (2,) least factors of gyro and accelerometer, at which the noise equals
    that at rest; folded (N,) of `harmonics.near_zero`.
    Source: Schweppe, Evaluation of likelihood functions for Gaussian signals, IEEE Trans. Inf. Theory 11(1), 1965.
    """
    lines = bool(flying.any() and folded[flying].std() > LEAST_FOLDED)
    present = np.array([True, True, *(inputs.used[flying].sum(axis=0) > 10), lines])
    if not present[2:FOLDED].any():
        return np.ones(FACTORS)
    at = np.flatnonzero(inputs.used[:, POSITION_KIND] * flying)
    seen = SEEN * scatter(at * inputs.dt, inputs.position[at]) / inputs.std[POSITION_KIND].mean()
    low = np.log(np.concatenate([np.minimum(floor, 1.0), [0.1, float(np.clip(seen, 0.1, 10.0)), 0.1, 1.0]]))
    high = np.log(np.array([30.0, 10.0, 30.0, 50.0, 30.0, 10.0]))
    wide = with_levels(inputs, np.array([2.0, 2.0, 3.0, 3.0, 3.0, 1.0]), flying, folded)._replace(gate=LOOSE_GATE)
    run = forward(wide)
    parts = [
        (_window(inputs, run, a, b), flying[a:b], folded[a:b])
        for a, b in _stretches(flying, len(flying), round(NOISE_WINDOW / inputs.dt), folded * lines)
    ]
    scale = sum(int(part.used.sum()) for part, *_ in parts) + 1
    costs: dict[bytes, float] = {}  # a line search begins where the last one ended: a quarter of all are asked again

    def cost_of(factors: np.ndarray) -> float:
        key = factors.tobytes()
        if key not in costs:
            costs[key] = sum(cost(with_levels(part, factors, *where)) for part, *where in parts)
        return costs[key]

    def target(free: np.ndarray) -> float:
        logs = np.zeros(FACTORS)
        logs[present] = free
        beyond = np.maximum(logs - high, 0.0) + np.maximum(low - logs, 0.0)
        # where the innovations carry little information, the levels stay near where they began
        total = cost_of(np.exp(np.clip(logs, low, high))) + float(np.sum((logs / PRIOR) ** 2))
        return total / scale + 10.0 * float(np.sum(beyond**2))

    at = np.flatnonzero(inputs.used[:, ATTITUDE_KIND] * flying)
    # four components of a quaternion share three halves of a rotation
    turned = (
        scatter(at * inputs.dt, continuous(inputs.attitude[at]))
        * 2.0
        / np.sqrt(0.75)
        / inputs.std[ATTITUDE_KIND].mean()
    )
    begin = np.clip(np.log([1.0, 1.0, max(turned, 1e-3), max(seen / SEEN, 1e-3), 1.0, 1.5]), low, high)[present]
    # one line search after the other: a simplex of six corners does not arrive in as many runs
    found = minimize(target, begin, method="Powell", options={"xtol": 0.05, "ftol": 1e-4, "maxfev": 150})
    logs = np.zeros(FACTORS)
    logs[present] = found.x
    return np.exp(np.clip(logs, low, high))


def consistency(run: FilterResult) -> dict[str, Any]:
    """Normalised innovations of a forward pass, per kind: {kind: {...}} for those that were measured.

    mean  mean NIS per degree of freedom of the accepted ones (1 when the noise levels are right); bounds  where 95 % of
    means would lie if they were exactly right; gated  share thrown away; whiteness  greatest autocorrelation from one
    measurement to the next, over the three components, with its 95 % bound; consistent  whether the run may be
    believed.
    Source: Bar-Shalom, Li & Kirubarajan, 2001, section 5.4.2.
    """
    result: dict[str, Any] = {}
    for i, kind in enumerate(MEASUREMENT_KINDS):
        seen = run.outcome[:, i] > 0
        if not seen.any():
            continue
        accepted = (run.outcome[:, i] == 1) | (run.outcome[:, i] == 3)
        white = run.whitened[accepted, i]
        count = len(white)
        entry: dict[str, Any] = {
            "measurements": int(seen.sum()),
            "gated": float((run.outcome[:, i] == 2).sum() / seen.sum()),
            "forced": int((run.outcome[:, i] == 3).sum()),
        }
        if count > 2:
            mean = float(np.mean(white**2))
            spread = 1.96 * np.sqrt(2.0 / (3.0 * count))
            centred = white - white.mean(axis=0)
            power = np.mean(centred**2, axis=0)
            lag1 = np.mean(centred[1:] * centred[:-1], axis=0) / np.where(power > 0, power, 1.0)
            entry |= {
                "mean": mean,
                "bounds": [1.0 - spread, 1.0 + spread],
                "whiteness": float(lag1[np.argmax(np.abs(lag1))]),
                "whiteness bound": float(1.96 / np.sqrt(count)),
            }
            entry["consistent"] = not beyond(entry)
        result[kind] = entry
    return result


def beyond(entry: Mapping[str, Any]) -> list[str]:
    """The figures of a kind of `consistency` that are beyond their limits, in words with the limits."""
    if "mean" not in entry:
        return [f"at most two of {entry['measurements']} measurements are accepted"]
    low, high = CONSISTENT
    excesses = []
    if not low < entry["mean"] < high:
        size = "larger" if entry["mean"] >= high else "smaller"
        excesses.append(
            f"innovations are {size} than their standard errors say (mean normalised square {entry['mean']:.2f}, "
            f"expected 1, limits {low:g} to {high:g})"
        )
    if not abs(entry["whiteness"]) < CORRELATED:
        excesses.append(f"neighbouring ones go together (correlation {entry['whiteness']:.2f}, limit {CORRELATED:g})")
    if not entry["gated"] < REJECTED:
        excesses.append(f"{100 * entry['gated']:.3g} % of the measurements are rejected (limit {100 * REJECTED:g} %)")
    if entry["forced"]:
        excesses.append(
            f"{entry['forced']} times a measurement had to be taken after a second of rejections in a row (limit 0): "
            "the states had strayed from it, or it jumped"
        )
    return excesses
