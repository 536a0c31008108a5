"""How probable it is that what a diagnosis states is there: a calibrated number for names, ties and candidates.

A p-value is no probability of a cause, and a share of resamples is none either. Made flights with hidden causes and
real recordings with planted faults have a known truth: `benchmarks/probability.py` counts how often names and
candidates of some p-value were right there, and fits a logistic function of the decades of the p-value to each kind. A
candidate has been rejected by at least one of the tests, so its probability is lower than that of a name with the same
p-value.
Source: Platt, Probabilistic outputs for support vector machines, in: Advances in Large Margin Classifiers, 1999.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit

MOST_DECADES = 12.0  # of a p-value: smaller ones rest on the tails of the distribution that the test assumes


class Logistic(NamedTuple):
    """Log odds: intercept + slope times the decades of the p-value."""

    intercept: float
    slope: float


# benchmarks/probability.py with 299 draws and 48 plants: 171 names, 164 right; 18 ties, 15 right, whose p-values sort
# nothing. Of candidates an earlier fit is kept (28 draws and 20 plants): the new one states 0.89 where half is right
KINDS = {"effects": Logistic(0.48, 0.320), "ties": Logistic(1.39, 0.0), "candidates": Logistic(-5.55, 0.457)}


def decades(p: float) -> float:
    """-log10 of a p-value, at most MOST_DECADES."""
    return float(np.clip(-np.log10(max(p, 1e-300)), 0.0, MOST_DECADES))


def decades_of(entry: Mapping[str, Any]) -> float | None:
    """`decades` of an effect, a tie or a candidate of diagnosis.json, None where it has no p-value."""
    places = (entry, entry.get("evidence") or {}, entry.get("constant force") or {})
    p = next((place["p"] for place in places if place.get("p") is not None), None)
    return None if p is None else decades(p)


def probability_of(kind: str, decades: float) -> float:
    """Probability that an entry is right. kind  "effects", "ties" or "candidates"; decades  of its p-value"""
    found = KINDS[kind]
    return float(expit(found.intercept + found.slope * decades))


def add_probabilities(diagnosis: Mapping[str, Any]) -> None:
    """Give every name, tie and candidate of a diagnosis its `probability`, None without a p-value.

    Of a tie it is the probability that one of its causes is there. An entry that has a posterior of its own, as the
    trim in steady flight and the order of the rotors have, keeps it.
    """
    for kind in KINDS:
        for entry in diagnosis[kind]:
            if entry.get("probability") is None:
                found = decades_of(entry)
                entry["probability"] = None if found is None else probability_of(kind, found)
