"""What sensors and drive found, as a calibration that import applies: one for the compared flights, one for the others.

A cause that changed is corrected in the compared flights alone, one that was always there in all of them. Biases,
misalignments and the like add up; scales multiply. Motor lag, command delay and battery sag are the vehicle's, not a
sensor's: they extend the model and are not corrected here.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quasi.gap.catalogue import catalogue
from quasi.gap.flights.level import Level
from quasi.importing.calibration import CALIBRATED_CONSTANTS, SCHEMA, check, is_identity

# cause: (part, quantity, its parameters in order)
CORRECTS: dict[str, tuple[str, str, tuple[str, ...]]] = {
    n: (*e.corrects, tuple(e.parameters)) for n, e in catalogue().items() if e.corrects is not None
}


def corrected_at_import(cause: str, level: str) -> bool:
    """Whether a cause that a level found is corrected at import, and so is no part of the extended model."""
    return level in ("sensors", "drive") and cause in CORRECTS


def uncorrected(cause: str, level: str) -> bool:
    """Whether a named cause is neither corrected at import nor part of the extended model: a leaning attitude."""
    return level == "sensors" and cause not in CORRECTS


def document(levels: Sequence[Level], settled: tuple[str, str] | None = None) -> dict[str, Any]:
    """The calibration of a comparison: plain data, to be written and read by import through `for_flight`.

    levels   sensors and drive; settled  (cause, since) of the tie that something else (the wrench) decides. Of every
             other tie the first cause is corrected, and a note says so
    Returns  {"schema", "compared": parts, "reference": parts, "causes": [...], "notes": [...]}
    """
    found: list[tuple[str, str, Mapping[str, Any]]] = []
    notes: list[str] = []
    for level in levels:
        found += [(e["id"], e["since"], e["parameters"]) for e in level.effects]
        for tie in level.ties:
            decided = [i for i in tie["ids"] if (i, tie["since"]) == settled]
            taken = decided[0] if decided else tie["ids"][0]
            if taken in CORRECTS and not decided:
                notes.append(
                    f"{' and '.join(tie['ids'])} look alike at level {level.level}; the flights were corrected for "
                    f"{taken}"
                )
            found.append((taken, tie["since"], tie["parameters"][taken]))
    causes = [(c, since, p) for c, since, p in found if c in CORRECTS]
    return {
        "schema": SCHEMA,
        "compared": _parts([(c, p) for c, _, p in causes]),
        "reference": _parts([(c, p) for c, since, p in causes if since == "always"]),
        "causes": [{"id": c, "since": since} for c, since, _ in causes],
        "notes": notes,
    }


def for_flight(whole: Mapping[str, Any] | None, compared: bool) -> dict[str, Any] | None:
    """What import applies to one flight; None for nothing, so that a flight without faults stays as it is.

    Raises ConfigError when a part or quantity is not one of a calibration's.
    """
    if not whole:
        return None
    parts = {"schema": whole.get("schema", SCHEMA), **(whole.get("compared" if compared else "reference") or {})}
    check(parts)
    return None if is_identity(parts) else parts


def _parts(causes: Sequence[tuple[str, Mapping[str, Any]]]) -> dict[str, dict[str, Any]]:
    parts: dict[str, dict[str, Any]] = {}
    for cause, parameters in causes:
        part, quantity, names = CORRECTS[cause]
        size, neutral = CALIBRATED_CONSTANTS[part][quantity]
        value = np.array([parameters[n]["value"] if n in parameters else neutral for n in names])
        before = np.atleast_1d(parts.setdefault(part, {}).get(quantity, np.full(size, neutral)))
        total = before * value if neutral == 1.0 else before + value
        parts[part][quantity] = total.tolist() if size > 1 else float(total[0])
    return parts
