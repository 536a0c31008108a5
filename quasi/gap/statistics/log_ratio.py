"""Whether positive quantities of some flights are larger than those of others: Student's test of their logarithms."""

import numpy as np
from scipy.stats import t as t_distribution

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
