"""How regularly each source was sampled, and where it has nothing: rates, jitter, gaps with their times."""

from typing import Any

import numpy as np

COUNTER = 2.0**32  # numbers that a clock of 32 bits counts before it starts again from 0
LONGEST_TURN = 1000  # usual steps, over which a counter may start again unseen
GAP = 3.1  # usual intervals without a sample that count as a gap
MOST_GAPS_LISTED = 50


def stream(t: np.ndarray, zero: float = 0.0) -> dict[str, Any] | None:
    """Sampling of one source whose valid samples lie at times t (n,), s; None for fewer than three.

    Returns samples, rate (Hz, of the median interval), jitter (s, standard deviation of the intervals outside gaps)
            and gaps [[begin, end], ...] in s since `zero`, the longest MOST_GAPS_LISTED in order; "lost" s in all
    """
    if len(t) < 3:
        return None
    interval = np.diff(t)
    usual = float(np.median(interval))
    wide = np.flatnonzero(interval > GAP * usual)
    listed = np.sort(wide[np.argsort(-interval[wide], kind="stable")[:MOST_GAPS_LISTED]])
    return {
        "samples": len(t),
        "rate": 1.0 / usual if usual > 0 else None,
        "jitter": float(np.std(interval[interval <= GAP * usual])),
        "first": float(t[0] - zero),
        "last": float(t[-1] - zero),
        "gap count": len(wide),
        "lost": float(np.sum(interval[wide] - usual)),
        "gaps": [[float(t[i] - zero), float(t[i + 1] - zero)] for i in listed],
        "unit": "s",
    }


def unwrapped(counts: np.ndarray) -> tuple[np.ndarray, int]:
    """Numbers (n,) of a counter as logged, carried on where one of 32 bits starts again; and how often it does.

    A step back is such a start only where it is a step forward of a usual size to a counter of 32 bits. NaN stays.
    """
    known = np.flatnonzero(np.isfinite(counts))
    step = np.diff(counts[known])
    ahead = step[step > 0]
    if not len(ahead) or np.min(counts[known]) < 0 or np.max(counts[known]) >= COUNTER:
        return counts, 0
    starts = (step < 0) & (step + COUNTER > 0) & (step + COUNTER <= LONGEST_TURN * np.median(ahead))
    carried = counts.copy()
    carried[known[1:]] += COUNTER * np.cumsum(starts)
    return carried, int(np.count_nonzero(starts))
