"""Everything that judges a model, in one go: predictions beside measurements, scores, coverage, diagnosis."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.model.extensions import as_read
from quasi.model.model import Model
from quasi.scoring.diagnostics import covered_share, diagnose
from quasi.scoring.score import Judged, judge, score_judged


class Review(NamedTuple):
    """judged {axis: Judged}; scores, coverage as tables; diagnosis as plain data."""

    judged: dict[str, Judged]
    scores: pd.DataFrame
    coverage: pd.DataFrame
    diagnosis: dict[str, Any]


def review(
    model: Model,
    flights: Mapping[str, pd.DataFrame],
    partition: Mapping[str, np.ndarray],
    roles: Mapping[str, int],
    aside: Mapping[str, Mapping[str, np.ndarray]] | None = None,
    partitioning: Mapping[str, Any] | None = None,
    base: Model | None = None,
    masses: Mapping[str, float | None] | None = None,
) -> Review:
    """Judge a model on its training, test and validation rows.

    flights  filtered flights; partition {flight: (n,) role codes}; roles {name: code}
    aside    {axis: {flight: (n,) bool}} training rows that isolation sets aside; partitioning  how rows were drawn
    base     the model that a gap extended to this one: judged on the same rows, and compared with
    masses   {flight: kg that it was processed with}, of flights that tell it
    Extended models are compared with flights that are read with what they know, see `as_read`.
    """
    masses = masses or {}
    read = {key: as_read(model, flight, masses.get(key)) for key, flight in flights.items()}
    judged = judge(model, read, partition, aside)
    scores = score_judged(judged, model, roles)
    held = {key: np.asarray(partition[key]) == roles["validation"] for key in flights}
    held = {key: rows for key, rows in held.items() if rows.any()}
    coverage, beyond = covered_share(model, {key: read[key] for key in held}, held)
    beside = None
    if base:
        own = {key: as_read(base, flight, masses.get(key)) for key, flight in flights.items()}
        beside = base.id, score_judged(judge(base, own, partition, aside), base, roles)
    diagnosis = diagnose(model, judged, scores, coverage, beyond, roles, partitioning, beside)
    return Review(judged, scores, coverage, diagnosis)
