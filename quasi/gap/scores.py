"""Errors of every level on held-out flights before and after, at the floor and of the yardsticks."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.level import Flown
from quasi.gap.levels.forces.error_reduction import Squares, after, before, removed, wrench_squares
from quasi.gap.levels.forces.identify import Found
from quasi.gap.levels.rollouts.error_reduction import Yardsticks
from quasi.gap.levels.rollouts.open_loop import WITH_COMMANDS
from quasi.gap.levels.sensors_and_drive import drive_errors, sensors_judged
from quasi.gap.materiality import Cause
from quasi.model.model import AXES, Model


def scored(
    model: Model, extended: Model, found: Found | None, kept: Sequence[Cause], held: Sequence[Evidence],
    yardsticks: Yardsticks, rolled: Mapping[str, Any], lower: tuple[Sequence[Flown], Sequence[Flown]],
    drive: Mapping[str, Any],
) -> tuple[dict[str, Any], dict[str, Any], tuple[Squares, Squares, np.ndarray] | None]:  # fmt: skip
    """Root mean squares before, after and at the floor by level, channel and horizon; shares of W with intervals; and
    the squared errors of W after, at the floor, and its mean. yardsticks  what the gain is compared with; lower
    held-out flights before and after calibration; drive  that level as the calibration holds it"""
    gap: dict[str, Any] = {k: {} for k in ("before", "after", "noise_floor", "best_wrong_cause", "generic_polynomial")}
    for key in gap:
        gap[key] |= rolled["rms"].get(key, {})
    scores: dict[str, Any] = {}
    best = None
    if held:
        old, new = wrench_squares(held, before), wrench_squares(held, after(extended, model))
        if len(old.t):
            floor = np.minimum(found.scores["noise_floor"] if found else new.mean(), new.mean())
            gap["before"]["forces"], gap["after"]["forces"] = _axes(old.mean()), _axes(new.mean())
            if found:
                gap["noise_floor"]["forces"] = _axes(floor)
                best = new, wrench_squares(held, yardsticks.floor), floor
                scores["removed"] = removed(old, *best)
                if yardsticks.polynomial is not None:
                    size = sum(len(c.value) for c in kept)
                    other = wrench_squares(held, yardsticks.polynomial)
                    gap["generic_polynomial"]["forces"] = _axes(other.mean())
                    scores["generic polynomial"] = {"terms": size, "removed": removed(old, other, *best[1:], new)}
                for name, wrong in yardsticks.wrong.items():
                    other = wrench_squares(held, after(wrong, model))
                    gap["best_wrong_cause"]["forces"] = _axes(other.mean())
                    scores["best wrong cause"] = name
                    scores["best wrong cause removed"] = removed(old, other, *best[1:], new)
    first, last = lower
    if first:
        start = sensors_judged(first)
        for word, table in (("before", start), ("after", start if _stay(first, last) else sensors_judged(last))):
            if table is None:
                continue
            mean = {c: float(np.sqrt(np.mean(t["before"] ** 2))) for c, t in table.groupby("channel")}
            gap[word]["sensors"] = {c: {"0": v} for c, v in mean.items()}
            if word == "after":
                least = {c: float(np.sqrt(np.mean(t["floor"] ** 2))) for c, t in table.groupby("channel")}
                gap["noise_floor"]["sensors"] = {c: {"0": min(v, mean[c])} for c, v in least.items()}
        for word, speeds in drive_errors(drive, first).items():
            gap[word]["drive"] = {w: {"0": v} for w, v in speeds.items()}
    if WITH_COMMANDS in rolled["wrong"]:
        scores["best wrong cause with commands"] = rolled["wrong"][WITH_COMMANDS]
    return gap, scores, best


def _stay(first: Sequence[Flown], last: Sequence[Flown]) -> bool:
    """Whether calibration left all flights as they were."""
    pairs = zip(first, last, strict=True)
    return all(a.imported.equals(b.imported) and a.filtered.equals(b.filtered) for a, b in pairs)


def _axes(values: np.ndarray) -> dict[str, dict[str, float]]:
    return {axis: {"0": float(np.sqrt(v))} for axis, v in zip(AXES, values)}
