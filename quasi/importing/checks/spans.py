"""Spans of time in which a channel cannot be used, from rows of its samples."""

from typing import NamedTuple

import numpy as np

from quasi.importing.streams import GAP
from quasi.sensor_limits import runs_of

# s; nearer spans of one reason are one, for the filters of the resampling reach so far
JOIN = 0.1


class InvalidSpan(NamedTuple):
    """From `begin` to `end`, s on the clock of its series, rows cannot be used; `reason` names the channel."""

    begin: float
    end: float
    reason: str


def constant_runs(t: np.ndarray, values: np.ndarray, shortest: float = 0.0) -> np.ndarray:
    """First and one past the last index (k, 2) of runs of two or more equal finite values (n,) without a gap in t.

    shortest  s, that a run lasts at least
    """
    step = np.diff(t)
    together = step <= GAP * np.median(step)
    same = np.concatenate([[False], (values[1:] == values[:-1]) & together])
    runs = runs_of(same)
    runs[:, 0] -= 1
    return runs[t[runs[:, 1] - 1] - t[runs[:, 0]] >= shortest]


def log_step(values: np.ndarray) -> float:
    """The least change (n,) from one sample to the next; infinite where nothing changes."""
    moves = np.abs(np.diff(values))
    return float(moves[moves > 0].min(initial=np.inf))


def is_quiet(values: np.ndarray, first: int, end: int, step: float) -> bool:
    """Whether the values (n,) before and after a run from `first` up to `end` are one step of the log from it.

    A quiet channel that is logged in coarse steps repeats a value too. It comes and goes by one step; a frozen one
    jumps to what it missed.
    """
    around = [values[k] for k in (first - 1, end) if 0 <= k < len(values)]
    return len(around) == 2 and all(abs(v - values[first]) < 1.5 * step for v in around)


def merge_spans(spans: list[InvalidSpan]) -> list[InvalidSpan]:
    """Spans of one reason that overlap or nearly touch as one, in order of time within each reason."""
    merged: list[InvalidSpan] = []
    for span in sorted(spans, key=lambda s: (s.reason, s.begin)):
        if merged and merged[-1].reason == span.reason and span.begin <= merged[-1].end + JOIN:
            merged[-1] = merged[-1]._replace(end=max(merged[-1].end, span.end))
        else:
            merged.append(span)
    return merged
