"""Captured motion that was sent to the flight controller and stands in its own log (INDIflight's extPos and extVel).

The log repeats the last message in every row until the next one arrives; only the rows that bring a message are
samples. A body at rest sends the same numbers again and again: of such rows some are taken at the usual interval, but
not where the numbers jump afterwards, for then no message came.
"""

from typing import Any

import numpy as np

from quasi.importing.series import Series

POSITION_COLUMNS, VELOCITY_COLUMNS = ("x", "y", "z"), ("vx", "vy", "vz")
EXTERNAL_TOPICS = {"x": "extPos", "vx": "extVel"}
LARGEST_PAUSE_CHANGE = 0.005  # m or 10 x m/s; a larger change after a pause means that messages were lost


def external_series(
    t: np.ndarray, values: dict[str, np.ndarray], about: dict[str, Any], notes: list[str]
) -> dict[str, Series]:
    """Series of the messages: "capture" where they hold positions, else "onboard external" with the velocity.

    t       (n,) s, of the log's rows; values {x y z, vx vy vz: (n,)} m, m/s, earth NED, as repeated in the rows
    about   gains what was taken for what; notes  gain a sentence where nothing was sent
    """
    groups = [names for names in (POSITION_COLUMNS, VELOCITY_COLUMNS) if all(n in values for n in names)]
    if not groups or len(t) < 3:
        return {}
    stack = np.stack([values[n] for names in groups for n in names], axis=-1)
    known = np.isfinite(stack).all(axis=1)
    t, stack = t[known], stack[known]
    fields = " and ".join(EXTERNAL_TOPICS[names[0]] for names in groups)
    if len(t) < 3 or not np.ptp(stack, axis=0).any():
        notes.append(f"{fields} never change: no captured motion reached the flight controller")
        return {}
    rows = messages(
        stack,
        np.concatenate(
            [
                np.full(3, LARGEST_PAUSE_CHANGE if names == POSITION_COLUMNS else LARGEST_PAUSE_CHANGE * 10)
                for names in groups
            ]
        ),
    )
    columns = {n: stack[rows, i] for i, n in enumerate(n for names in groups for n in names)}
    where = "capture" if groups[0] == POSITION_COLUMNS else "onboard external"
    about["external motion"] = {
        "fields": fields,
        "meaning": "motion capture as sent to the flight controller, earth axes NED, on the controller's clock",
        "used as": "captured position; the velocity follows from it" if where == "capture" else "velocity over ground",
        "messages": len(rows),
        "rate": float(1.0 / np.median(np.diff(t[rows]))) if len(rows) > 1 else None,
    }
    return {where: Series(t[rows], columns)}


def messages(stack: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Indices of the rows of stack (n, k) that hold a new message; rest (k,) the largest change after a true pause."""
    changed = np.append(0, np.flatnonzero(np.any(np.diff(stack, axis=0) != 0, axis=1)) + 1)
    if len(changed) < 2:
        return changed
    usual = max(1, int(np.median(np.diff(changed))))
    ends = np.append(changed[1:], len(stack))
    rows = [changed]
    for begin, end in zip(changed, ends):
        if end - begin > 3 * usual:
            after = stack[end] if end < len(stack) else stack[begin]
            if np.all(np.abs(after - stack[begin]) <= rest):
                rows.append(np.arange(begin + usual, end, usual))
    return np.unique(np.concatenate(rows))
