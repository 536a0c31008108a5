"""How far a filtered flight can be trusted: the import's verdict, and what the filter adds to it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi import attitude
from quasi.filtering.bias import Rest
from quasi.sensor_limits import (
    MOUNTING_ANGLE,
    REST_ANGLE,
    Contradiction,
    check_angle,
    check_biases,
    check_innovations,
    find_missing_sources,
    list_reasons,
    name_sources,
    to_plain,
)

WORDS = ("good", "usable with care", "unusable")
PREDICTED = ("position", "attitude", "velocity")  # innovations in the order in which they are reported


def judge_flight(
    imported: pd.DataFrame, imported_metadata: Mapping[str, Any], report: Mapping[str, Any], rest: Rest | None
) -> dict[str, Any]:
    """ "contradictions", "verdict" and "verdict because" of a filtered flight.

    imported, imported_metadata  as `filter_flight` has them; report  its metadata so far; rest  before take-off, if any
    """
    own = find_contradictions(imported, imported_metadata, report, rest)
    earlier = list(imported_metadata.get("contradictions") or [])
    bad = list_reasons(earlier) + list_reasons(to_plain(own))
    bad += find_missing_sources(imported, imported_metadata)
    none_valid = report["phases"]["none valid because"]
    if none_valid:
        bad.append(f"no row is valid for identification: {none_valid}")
    care = list(report["doubts"])
    before = str(imported_metadata.get("verdict") or WORDS[0])
    because = str(imported_metadata.get("verdict because") or "")
    if before == WORDS[2] and not bad:
        bad.append(because)
    word = WORDS[2] if bad else max(before, WORDS[1] if care else WORDS[0], key=WORDS.index)
    reasons = [b for b in bad if b not in because] + ([because] if before != WORDS[0] else []) + care
    return {
        "contradictions": [*earlier, *to_plain(own)],
        "verdict": word,
        "unusable because": bad,
        "verdict because": "; ".join(reasons) or "all sources are complete and agree",
    }


def find_contradictions(
    imported: pd.DataFrame, imported_metadata: Mapping[str, Any], report: Mapping[str, Any], rest: Rest | None
) -> list[Contradiction]:
    """What the filter shows beyond the limits of `quasi.sensor_limits`. Arguments as `judge_flight`."""
    names = name_sources(imported_metadata)
    found = check_innovations({k: report["NIS"][k] for k in PREDICTED if k in report["NIS"]}, names)
    biases = report["biases"]
    value, std = (
        np.concatenate([np.asarray(biases[s][k], float) for s in ("gyro", "accelerometer")]) for k in ("value", "std")
    )
    found += check_biases(value, std, names)
    if "attitude" not in names:
        return found
    aligned = report["attitude alignment"]
    if aligned is not None:
        turn = float(np.linalg.norm([aligned[axis]["value"] for axis in ("roll", "pitch", "yaw")]))
        found += check_angle(turn, MOUNTING_ANGLE, "the angle between their axes", names["attitude"])
    return found + check_angle(
        _angle_at_rest(imported, rest), REST_ANGLE, "the angle between their verticals at rest", names["attitude"]
    )


def _angle_at_rest(imported: pd.DataFrame, rest: Rest | None) -> float | None:
    """Angle, rad, between the vertical of the mean specific force at rest and that of the imported attitude."""
    if rest is None or not {"roll", "pitch", "yaw"} <= set(imported):
        return None
    euler = imported[["roll", "pitch", "yaw"]].to_numpy(float)[rest.first : rest.last]
    euler = euler[np.isfinite(euler).all(axis=1)]
    if not len(euler):
        return None
    up = attitude.rotate_inverse(attitude.from_euler(*euler.T), np.array([0.0, 0.0, -1.0])).mean(axis=0)
    sizes = np.linalg.norm(up) * np.linalg.norm(rest.accel)
    return float(np.arccos(np.clip(up @ rest.accel / sizes, -1.0, 1.0))) if sizes > 0 else None
