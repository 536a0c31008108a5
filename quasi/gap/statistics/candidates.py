"""What tests of causes are about: which columns belong to a cause, which flights it is offered to, what was found."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.special import fdtrc

MOST_FREEDOM = 40.0  # the known spreads are not that well known


class Candidate(NamedTuple):
    """A cause, the flights it is offered to, which of its parameters.

    since  "always": all flights, "changed": the compared ones, "reference": the others
    """

    cause: str
    since: str
    which: tuple[int, ...]


class Columns(NamedTuple):
    """Which columns of the cross-products are what; column 0 is the target.

    unpooled  causes that are never added to the base, see MixedModel.pooled
    tries     {cause: how many forms of its columns were tried}
    bounds    {cause: (m,) standard deviation of each parameter in healthy flights; infinite where nothing is known}.
              It bounds the part that all flights have alike where changes are tested: reference flights that hardly
              excite a cause would return any value, and its error would become the change
    session   columns whose coefficients the flights of a session share, with session_spread their standard deviations
    alike     {cause: columns} of a cause whose parameters may all be equal: the sum of its columns, or parts of the
              sum that have sizes of their own; its place in `Candidate.which` follows those of the parameters
    base      {cause: columns} of what all flights have alike of a cause, where it is more than its parameters
    barred    {cause: parameters of which no change is asked}
    """

    shared: list[int]
    nuisance: list[int]
    spread: np.ndarray  # (len(nuisance),) standard deviations of the nuisances
    causes: dict[str, list[int]]
    unpooled: tuple[str, ...] = ()
    tries: Mapping[str, int] = MappingProxyType({})
    bounds: Mapping[str, np.ndarray] = MappingProxyType({})
    session: tuple[int, ...] = ()
    session_spread: tuple[float, ...] = ()
    alike: Mapping[str, Sequence[int]] = MappingProxyType({})
    base: Mapping[str, Sequence[int]] = MappingProxyType({})
    barred: Mapping[str, frozenset[int]] = MappingProxyType({})

    def of(self, offer: Candidate) -> list[int]:
        """Columns of a candidate."""
        own = self.causes[offer.cause]
        return [c for k in offer.which for c in (self.alike[offer.cause] if k == len(own) else (own[k],))]

    def parameters(self, test: "Test") -> tuple[list[int], np.ndarray, np.ndarray]:
        """Columns of the parameters of a test, their values and standard errors; equal ones each by itself."""
        own = self.causes[test.offer.cause]
        if test.offer.which != (len(own),):
            return self.of(test.offer), test.value, test.std
        return list(own), np.repeat(test.value, len(own)), np.repeat(test.std, len(own))


class Test(NamedTuple):
    """One cause with others given: parameters (m,), their covariance, Wald statistic, probability of nothing.

    p counts that the best of several selections of the cause's parameters was taken.
    """

    offer: Candidate
    value: np.ndarray
    covariance: np.ndarray
    tau: float
    wald: float
    p: float
    unlikely: float = 0.0  # -2 log likelihood at this spread, up to a constant: for choosing between selections

    @property
    def std(self) -> np.ndarray:
        """Standard errors (m,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def separability(self) -> float:
        """|t| of one of its columns, were all alike: the root of the Wald statistic by column."""
        return float((self.wald / len(self.value)) ** 0.5)

    @property
    def p_known_spread(self) -> float:
        """Probability of nothing were the spread as well known as nuisances are, however few flights there are."""
        return float(fdtrc(len(self.value), MOST_FREEDOM, self.wald / len(self.value)))
