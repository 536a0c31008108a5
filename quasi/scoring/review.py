"""Review of a model in one step: predictions against measurements, scores, coverage, diagnosis."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.model.extensions import correct_flight
from quasi.model.model import Model
from quasi.scoring.diagnostics import compute_coverage, diagnose
from quasi.scoring.score import AxisComparison, compare_with_measurements, score_comparisons


class Review(NamedTuple):
    """comparisons {axis: AxisComparison}; scores, coverage as tables; diagnosis as plain data."""

    comparisons: dict[str, AxisComparison]
    scores: pd.DataFrame
    coverage: pd.DataFrame
    diagnosis: dict[str, Any]


def review_model(
    model: Model,
    flights: Mapping[str, pd.DataFrame],
    partition: Mapping[str, np.ndarray],
    roles: Mapping[str, int],
    excluded: Mapping[str, Mapping[str, np.ndarray]] | None = None,
    partitioning: Mapping[str, Any] | None = None,
    base: Model | None = None,
    masses: Mapping[str, float | None] | None = None,
) -> Review:
    """Judge a model on its training, test and validation rows.

    flights  filtered flights; partition {flight: (n,) role codes}; roles {name: code}
    excluded {axis: {flight: (n,) bool}} training rows that isolation excludes; partitioning  how rows were drawn
    base     the model that a gap extended to this one: judged on the same rows, and compared with
    masses   {flight: mass of its processing, kg}, of flights that record it
    Extended models are compared with flights corrected by their extensions, see `correct_flight`.
    """
    masses = masses or {}
    read = {key: correct_flight(model, flight, masses.get(key)) for key, flight in flights.items()}
    comparisons = compare_with_measurements(model, read, partition, excluded)
    scores = score_comparisons(comparisons, model, roles)
    held = {key: np.asarray(partition[key]) == roles["validation"] for key in flights}
    held = {key: rows for key, rows in held.items() if rows.any()}
    coverage, beyond = compute_coverage(model, {key: read[key] for key in held}, held)
    against_base = None
    if base:
        own = {key: correct_flight(base, flight, masses.get(key)) for key, flight in flights.items()}
        against_base = (
            base.id,
            score_comparisons(compare_with_measurements(base, own, partition, excluded), base, roles),
        )
    diagnosis = diagnose(model, comparisons, scores, coverage, beyond, roles, partitioning, against_base)
    return Review(comparisons, scores, coverage, diagnosis)
