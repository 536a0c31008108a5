"""What a reader of a fit should know before trusting its terms, in words."""

from typing import Any

import numpy as np

from quasi.identification.regression import Fit
from quasi.identification.stepwise import RIVAL

INFLATED = 10.0  # a variance so many times what it would be alone; the usual rule of thumb
ILL_CONDITIONED = 1e4  # of the scaled columns
TOGETHER = 0.7  # correlation of two coefficients from which they are named together
RARE = 0.5  # share of resamples
SHOWN = 3


def warnings(
    axis: str, terms: list[dict[str, Any]], log: list[dict[str, Any]], fit: Fit, resampled: dict[str, Any] | None
) -> list[str]:
    """Sentences about ties, weak terms, inflated variances and terms that resamples do not confirm.

    terms  entries of the axis, the estimated ones first and in the order of the fit; log  steps of the selection
    """
    notes, kept = [], {t["name"] for t in terms}
    for entry in log[1:]:
        close = [r for r in entry.get("rivals", []) if r["share of gain"] > RIVAL]
        if close and entry["selected"] in kept:
            best = 100 * close[0]["share of gain"]
            notes.append(
                f"{axis}: step {entry['step']} took {entry['selected']}, but {_list(r['expression'] for r in close)} "
                f"would do {best:.1f} % as well; the data hardly distinguish them"
            )
    for term in terms:
        rivals = term.get("interchangeable with", [])
        if rivals:
            notes.append(
                f"{axis}: {_list((r['expression'] for r in rivals), term['rivals'])} could stand for {term['name']} "
                "without the data noticing; its form is not settled by these flights"
            )
    weak = [t["name"] for t in terms if t["t"] is not None and abs(t["t"]) < 2 and not t["fixed"]]
    if weak:
        notes.append(
            f"{axis}: {', '.join(weak)} cannot be distinguished from zero, the residuals' memory counted (|t| < 2)"
        )
    notes += _inflated(axis, terms, fit)
    if resampled:
        what = f"{resampled['resamples']} resamples of {resampled['units']} {resampled['of']}"
        for term in terms:
            if term.get("inclusion frequency with rivals", 1.0) < RARE:
                notes.append(
                    f"{axis}: {term['name']} or a rival of it is chosen in only "
                    f"{100 * term['inclusion frequency with rivals']:.0f} % of {what}; do not read physics into it"
                )
    return notes


def _inflated(axis: str, terms: list[dict[str, Any]], fit: Fit) -> list[str]:
    notes = []
    std = np.sqrt(np.diag(fit.plain_covariance))
    correlation = fit.plain_covariance / np.outer(std, std)
    for k in np.flatnonzero(fit.inflation > INFLATED):
        near = [i for i in np.argsort(-np.abs(correlation[k])) if i != k and abs(correlation[k, i]) > TOGETHER]
        correlated = _list(terms[i]["name"] for i in near) or "the other terms together"
        notes.append(
            f"{axis}: the variance of the coefficient of {terms[k]['name']} is {fit.inflation[k]:.0f} times what it "
            f"would be alone, because it moves with {correlated}; read their sum, not the single coefficients"
        )
    if fit.condition > ILL_CONDITIONED:
        notes.append(f"{axis}: the terms are nearly interchangeable (condition number {fit.condition:.1e})")
    return notes


def _list(names, count: int | None = None) -> str:
    names = list(names)
    count = count or len(names)
    shown = names[:SHOWN]
    if count > len(shown):
        return f"{', '.join(shown)} and {count - len(shown)} more"
    return " or ".join([", ".join(shown[:-1]), shown[-1]]) if len(shown) > 1 else "".join(shown)
