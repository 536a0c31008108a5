"""Whether positive quantities of some flights are larger than those of others: Student's tests of their logarithms."""

import numpy as np
from scipy.stats import t as t_distribution

BY_EFFORT = 0.05  # largest p with which errors grew more than the motion that was flown
LEAST_FLIGHTS = 2  # compared ones, and reference ones, for a spread between flights
PRIOR_FLIGHTS = 10.0  # flights that the usual spread between healthy flights counts as


def larger(
    now: np.ndarray, before: np.ndarray, usual_spread: float = 0.0, prior_flights: float = 0.0
) -> tuple[float, float]:
    """Natural logarithm of the ratio of geometric means, and its one-sided p-value.

    now (n,), before (m,) positive; usual_spread  standard deviation of the logarithm between healthy flights, which is
    known as from `prior_flights` flights; without these the flights alone state their spread, and at least three of
    both kinds together are needed
    """
    groups = [np.log(now), np.log(before)]
    gain = float(groups[0].mean() - groups[1].mean())
    freedom = len(now) + len(before) - 2 + prior_flights
    squares = sum(float(np.sum((g - g.mean()) ** 2)) for g in groups) + prior_flights * usual_spread**2
    std = np.sqrt(squares / freedom * (1.0 / len(now) + 1.0 / len(before)))
    return gain, float(t_distribution.sf(gain / std, freedom))


def two_larger(now: np.ndarray, before: np.ndarray) -> float:
    """P-value of two flights and more beyond what the flights before predict of one; 1 below three flights before.

    now (n,), before (m,) positive. Each flight by itself is compared with the prediction interval of the earlier ones:
    an effect that some manoeuvres alone show spreads the logarithms of the flights, and hides in a test of their mean.
    Of n flights that need not be independent, two and more have p-values below a with a probability of at most n a / 2
    (Markov's inequality). Source: Hahn & Meeker, Statistical Intervals, 1991, section 4.7 (prediction intervals).
    """
    freedom = len(before) - 1
    if freedom < 2 or len(now) < 2:
        return 1.0
    usual = np.log(before)
    beyond = (np.log(now) - usual.mean()) / max(usual.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(before)), 1e-300)
    second = float(np.sort(t_distribution.sf(beyond, freedom))[1])
    return min(1.0, 0.5 * len(now) * second)


def beyond_references(now: np.ndarray, usual: np.ndarray, harder: np.ndarray) -> tuple[float, float, float]:
    """Natural logarithm of the ratio of geometric means, p-value, and the p-value by what was flown.

    now (n,), usual (m,)  squared errors of compared and of reference flights, positive; harder (n,)  how many times the
    squared effort of the reference flights, at least 1. All flights may show an effect, or two that have the manoeuvre
    for it: both are tested.
    """
    gain, in_mean = larger(now, usual)
    tests = [(in_mean, larger(now / harder, usual)[1]), (two_larger(now, usual), two_larger(now / harder, usual))]
    p, by_effort = min(tests)
    return gain, min(1.0, len(tests) * p), by_effort
