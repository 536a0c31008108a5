"""Columns of a log as they were recorded. Every format that is mapped by names becomes this before units and axes."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import pandas as pd


@dataclass(frozen=True)
class Topic:
    """A group of columns that were sampled together.

    kind     type of its messages, "" where the format has none
    columns  full names of its columns, "topic.field"
    samples  how many there are; seconds  over which time
    """

    kind: str
    columns: tuple[str, ...]
    samples: int
    seconds: float = 0.0

    @property
    def rate(self) -> float:
        """Mean rate, Hz; 0 where it is not known."""
        return (self.samples - 1) / self.seconds if self.samples > 1 and self.seconds > 0 else 0.0


def seconds_of(t: np.ndarray) -> float:
    """The time that stamps t (n,), s, span; 0 without any."""
    return float(np.ptp(t)) if len(t) else 0.0


@dataclass
class Signals:
    """Samples of the columns that were asked for.

    frames  {group: table of its columns}, a column in one group alone
    clocks  {group: (n,) s, when the log received or took each sample, one clock for all groups}; empty for a table,
            whose clocks are columns
    """

    frames: dict[str, pd.DataFrame]
    clocks: dict[str, np.ndarray] = field(default_factory=dict)

    def group_of(self, column: str) -> str | None:
        """The group that holds a column, or None."""
        return next((group for group, frame in self.frames.items() if column in frame.columns), None)

    def only(self, columns: Collection[str]) -> "Signals":
        """These columns alone; groups without any of them are left out."""
        held = {g: [c for c in frame.columns if c in columns] for g, frame in self.frames.items()}
        frames = {g: self.frames[g][names] for g, names in held.items() if names}
        return Signals(frames, {g: self.clocks[g] for g in frames})

    @property
    def columns(self) -> list[str]:
        """Names of all columns."""
        return [str(name) for frame in self.frames.values() for name in frame.columns]


class LogFile(Protocol):
    """An open log of several topics.

    topics  {name: Topic} of everything that can be read
    facts   plain data for the metadata: format, firmware, parameters, losses
    """

    topics: Mapping[str, Topic]
    facts: dict[str, Any]

    def samples_of(self, columns: Collection[str], notes: list[str]) -> Signals:
        """The samples of these columns; names that are absent are left out."""
        ...
