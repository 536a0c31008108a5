"""What every reader returns: samples on their own clock, in standard quantities."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Series:
    """Samples of one source on one clock.

    t       (n,) s, strictly increasing, on the source's own clock
    values  {quantity: (n,)} under the standard column names, SI units, earth NED and body FRD axes; attitude as
            qw qx qy qz (Hamilton, body to earth); NaN where a sample is missing
    """

    t: np.ndarray
    values: dict[str, np.ndarray]

    def matrix(self, names: Sequence[str]) -> np.ndarray | None:
        """Quantities side by side (n, len(names)); None where one is absent."""
        return np.stack([self.values[n] for n in names], axis=-1) if all(n in self.values for n in names) else None


def interpolate_columns(at: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Columns of values (n, k) at times t (n,) by straight lines at times `at` (m,); returns (m, k)."""
    return np.stack([np.interp(at, t, column) for column in values.T], axis=-1)


@dataclass(frozen=True)
class Track:
    """One quantity group on its own times: t (n,) s, values (n, k); NaN where missing."""

    t: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class Recording:
    """One raw file as read.

    series    {"onboard": ..., "capture": ...}; a table whose sources keep clocks of their own has further on-board
              series under names of their own ("onboard motors", ...)
    metadata  plain data: what was read, from where, what was assumed, what was lost
    notes     the same as sentences for a person, worst first
    """

    series: dict[str, Series]
    metadata: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
