"""Whether the compared model is worth a comparison: axes on which it explains nothing neither name nor judge causes."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from quasi.gap.flights.evidence import Evidence
from quasi.model.model import AXES, Model

NEAR_NOTHING = 0.1  # share of the variance that a model must explain for an axis to count


class Worth(NamedTuple):
    """share {axis: explained share of the variance}; excluded  axes that do not count; wrong  what contradicts the
    model as a whole (rotors that act elsewhere than configured), "" for nothing."""

    share: Mapping[str, float]
    excluded: tuple[str, ...]
    wrong: str

    def sentence(self) -> str:
        """The first sentence of a diagnosis, "" for a model that is worth a comparison."""
        if self.wrong:
            return f"The base model is unusable: {self.wrong}."
        if not self.excluded:
            return ""
        shares = ", ".join(f"{a} {100 * self.share[a]:z.0f} %" for a in self.excluded)
        return (
            f"The base model explains next to nothing of {', '.join(self.excluded)} (share of the variance: {shares}); "
            "these axes were not used."
        )


def explained_share(flights: Sequence[Evidence]) -> np.ndarray:
    """Share (6,) of the variance of forces and moments within flights that their model explains."""
    left, whole = np.zeros(6), np.zeros(6)
    for flight in flights:
        left += len(flight) * flight.residual.var(axis=0)
        whole += len(flight) * flight.measured.var(axis=0)
    return 1.0 - left / np.maximum(whole, 1e-300)


def worth_of(model: Model, reference: Sequence[Evidence]) -> Worth:
    """How much the model explains of the rows that it was identified from and, where given, of reference flights.

    Compared flights do not judge it: there an effect such as wind may hide all that the model explains. A published
    model states no rows: what it explains of them is unknown (NaN), and it counts.
    """
    identified = {a: part for a, part in model.document["axes"].items() if part.get("n") != 0}
    known = {a: float(identified.get(a, {}).get("R2", np.nan)) for a in AXES}
    shares = dict(known)
    if reference:
        shown = explained_share(reference)
        shares = {a: float(np.nanmin([known[a], shown[k]])) for k, a in enumerate(AXES)}
    excluded = tuple(a for a in AXES if shares[a] < NEAR_NOTHING)
    wrong = "; ".join(model.document.get("contradictions") or [])
    return Worth(shares, excluded, wrong)
