"""Two filtered flights of one vehicle: which of its constants differ by more than their spread."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.gap.comparing.differences import (
    FALSE_RATE,
    Difference,
    Estimate,
    differences,
    differences_plain,
    differences_text,
)
from quasi.gap.comparing.flight_quantities import QUANTITY_UNITS, patterns_of, quantities_of

SCHEMA = "quasi.comparison/1"
LEAST_REPEATS = 3


def compare_flights(
    a: tuple[str, pd.DataFrame],
    b: tuple[str, pd.DataFrame],
    repeats: Mapping[str, pd.DataFrame] | None = None,
) -> list[Difference]:
    """What differs from flight a to flight b, each (key, filtered table).

    repeats  further flights of the healthy vehicle: their scatter beyond the errors of each is added to the spread
    Raises DataError for a flight that cannot be compared, or fewer than LEAST_REPEATS repeats.
    """
    patterns = patterns_of(a[1])
    first, second = (quantities_of(table, key, patterns) for key, table in (a, b))
    between = None
    if repeats:
        if len(repeats) < LEAST_REPEATS:
            raise DataError(
                f"{len(repeats)} repeated flights were given, at least {LEAST_REPEATS} are needed for a scatter"
            )
        between = spread_between([quantities_of(table, key, patterns) for key, table in repeats.items()])
    return differences(first, second, QUANTITY_UNITS, between)


def spread_between(flights: list[dict[str, Estimate]]) -> dict[str, Estimate]:
    """Standard deviation between flights beyond the errors of each; a quantity that one flight lacks is left out."""
    found = {}
    for name in [n for n in flights[0] if all(n in f for f in flights)]:
        values, own = (np.array([getattr(f[name], part) for f in flights]) for part in ("value", "std"))
        extra = max(float(values.var(ddof=1) - np.mean(own**2)), 0.0)
        found[name] = Estimate(float(np.sqrt(extra)), 0.0, float(len(flights) - 1))
    return found


def flights_plain(rows: list[Difference], names: tuple[str, str], repeats: int) -> dict[str, Any]:
    """The comparison as plain data ("quasi.comparison/1")."""
    return {
        "schema": SCHEMA,
        "kind": "flights",
        "a": names[0],
        "b": names[1],
        "repeats": repeats,
        "false alarm rate": FALSE_RATE,
        "differences": differences_plain(rows),
    }


def flights_text(rows: list[Difference], names: tuple[str, str], repeats: int) -> str:
    """The comparison as text: a sentence, the table, and what the spread holds."""
    differing = [row.name for row in rows if row.differs]
    if differing:
        lines = [
            f"{len(differing)} of {len(rows)} quantities differ from {names[0]} to {names[1]}: {', '.join(differing)}."
        ]
    else:
        lines = [f"No quantity differs from {names[0]} to {names[1]} beyond the spread ({len(rows)} compared)."]
    lines.append(differences_text(rows, names))
    lines.append(
        f"* differs; {100 * FALSE_RATE:g} % risk of any false mark (Holm). ± is the standard error, from blocks of 5 s."
    )
    if repeats:
        lines.append(f"The spread holds the scatter between {repeats} repeated flights.")
    else:
        lines.append("The spread is that within both flights; flights of one vehicle can differ by more: --repeats.")
    return "\n".join(lines)
