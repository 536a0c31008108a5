"""What sensors and drive share: flights as imported and filtered, what a level found, and its tests."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import f as f_distribution

from quasi.airframe import Airframe
from quasi.gap.statistics.candidates import Candidate, Columns, Test
from quasi.gap.statistics.mixed import MixedModel

# of spreads between healthy flights: they are known from many flights, not estimated from the few at hand
PRIOR_FREEDOM = 16.0


@dataclass(frozen=True)
class Flown:
    """One flight as it went through import and filter.

    compared  False for a reference flight, which is believed clean
    imported, filtered        their tables, row by row alike; metadata, filtered_metadata  what came with them
    """

    key: str
    compared: bool
    imported: pd.DataFrame
    metadata: Mapping[str, Any]
    filtered: pd.DataFrame
    filtered_metadata: Mapping[str, Any]
    airframe: Airframe


@dataclass
class Level:
    """What one level found; plain data but for the tables, written as the diagnosis writes it.

    effects           accepted causes, strongest first: id, since, parameters, p, wald, tau, evidence
    ties              ids that this data cannot split, with separability and tie_breaker
    findings          stated faults that are no cause
    candidates        causes that lost: id, since, score (Wald statistic), why_not
    cannot_be_asked   id and why
    tables            {name: table} of residuals for the report
    noise_floor       {channel: rms} that no cause of this level can explain
    tests             what causes were tested on, None where nothing could be asked
    found_on          what held-out flights are compared with, see `sensors_and_drive.found_on`
    healthy           of the drive: constants ("values") and voltage that flights were compared with
    significance      {since: p-value below which a cause was accepted}
    """

    level: str
    effects: list[dict[str, Any]] = field(default_factory=list)
    ties: list[dict[str, Any]] = field(default_factory=list)
    findings: list[dict[str, Any]] = field(default_factory=list)
    candidates: list[dict[str, Any]] = field(default_factory=list)
    cannot_be_asked: list[dict[str, Any]] = field(default_factory=list)
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    noise_floor: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    tests: "SensorMixedModel | None" = None
    found_on: dict[str, Any] = field(default_factory=dict)
    healthy: dict[str, Any] = field(default_factory=dict)
    significance: dict[str, float] = field(default_factory=dict)


def causes_of(entries: Sequence[Mapping[str, Any]]) -> set[str]:
    """All causes of effects and ties."""
    return {c for e in entries for c in (e["ids"] if "ids" in e else [e["id"]])}


def cause_of(entry: Mapping[str, Any]) -> str:
    """The cause of an effect; of a tie, the one that the flights were corrected for."""
    return entry["id"] if "id" in entry else entry["ids"][0]


def values_of(entry: Mapping[str, Any]) -> dict[str, float]:
    """Parameters of `cause_of` an effect or a tie."""
    parameters = entry["parameters"] if "id" in entry else entry["parameters"][cause_of(entry)]
    return {n: p["value"] for n, p in parameters.items()}


def by_cause(entries: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Effects and ties by `cause_of`: one cause may act always and have changed as well."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for entry in entries:
        found.setdefault(cause_of(entry), []).append(entry)
    return found


class SensorMixedModel(MixedModel):
    """Tests whose nuisances have spreads known from many flights, not estimated from the few at hand.

    freedom   degrees of freedom that those spreads stand for, in addition to the flights' own
    unpooled  causes that the base holds already, with what is known of them
    common    {cause: standard deviation of what healthy set-ups have in all flights alike}, added to the covariance of
              what all flights have in common
    dispersed {cause: factor of its variances where noise is not white}
    sessions  name of each flight's session, see `MixedModel`. Healthy sessions differ as healthy flights do: sensors
              are turned on, seated and calibrated anew
    """

    informed = False

    def __init__(
        self, grams: Sequence[np.ndarray], compared: Sequence[bool], columns: Columns, freedom: float,
        prior: np.ndarray | None = None, unpooled: Sequence[str] = (), common: Mapping[str, float] | None = None,
        sessions: Sequence[str] = (), dispersed: Mapping[str, float] | None = None,
    ) -> None:  # fmt: skip
        of_session = {"session": tuple(columns.nuisance), "session_spread": tuple(columns.spread)}
        columns = columns._replace(unpooled=tuple(unpooled), **of_session)
        super().__init__(grams, compared, columns, prior, sessions)
        if sessions and sessions[0] and len(set(sessions)) == 1:
            # what the one session has is in all flights alike, and no evidence of a fault that they all have
            self._sessions = [np.ones(len(self.compared), bool)]
        self.common, self.dispersed = dict(common or {}), dict(dispersed or {})
        groups = 1 if self.compared.all() else 2
        self.freedom = max(len(grams) - groups, 1) + freedom

    def test(self, offer: Candidate, given: Sequence[Candidate] = (), pooled: Sequence[str] = ()) -> Test:
        """A cause with other causes given, see `MixedModel.test`; what healthy set-ups have in common is no fault."""
        test = super().test(offer, given, pooled)
        size = self.common.get(offer.cause, 0.0) if offer.since == "always" else 0.0
        factor = self.dispersed.get(offer.cause, 1.0)
        if size == 0.0 and factor == 1.0:
            return test
        covariance = factor * test.covariance + size**2 * np.eye(len(test.value))
        wald = float(test.value @ np.linalg.solve(covariance, test.value))
        p = float(f_distribution.sf(wald / len(test.value), len(test.value), self.freedom))
        return test._replace(covariance=covariance, wald=wald, p=max(p, test.p))


def offers_of(mixed: SensorMixedModel, since: str) -> list[Candidate]:
    """Every cause with all its parameters."""
    return [Candidate(cause, since, tuple(range(len(columns)))) for cause, columns in mixed.columns.causes.items()]
