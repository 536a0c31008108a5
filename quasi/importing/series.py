"""What every reader returns: samples on their own clock, in standard quantities."""

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
