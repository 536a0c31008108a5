"""Estimates of two sides and which of them differ: Welch's t by quantity, Holm's bound over all of them.

Sources: Welch, Biometrika 34, 1947 (two variances, degrees of freedom); Holm, Scandinavian Journal of Statistics 6,
1979 (family-wise rate).
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from scipy.stats import t as student

FALSE_RATE = 0.01  # family-wise rate of false differences, that of a gap's configuration


class Estimate(NamedTuple):
    """A number, its standard error, and the degrees of freedom of that."""

    value: float
    std: float
    freedom: float


class Difference(NamedTuple):
    """One quantity of both sides. p_value of no difference; differs: Holm's decision over all quantities together."""

    name: str
    unit: str
    a: Estimate
    b: Estimate
    change: float
    std: float
    p_value: float
    differs: bool


def differences(
    a: Mapping[str, Estimate],
    b: Mapping[str, Estimate],
    units: Mapping[str, str],
    between: Mapping[str, Estimate] | None = None,
    rate: float = FALSE_RATE,
) -> list[Difference]:
    """Every quantity that both sides have, in the order of a.

    between  {quantity: standard deviation between repeated flights, as a value with its degrees of freedom}; it adds
             to the standard error of the difference, twice, for two flights are compared
    """
    rows = []
    for name in [n for n in a if n in b]:
        parts = [(a[name].std ** 2, a[name].freedom), (b[name].std ** 2, b[name].freedom)]
        if between and name in between:
            parts.append((2.0 * between[name].value ** 2, between[name].freedom))
        variance = sum(v for v, _ in parts)
        change = b[name].value - a[name].value
        if variance <= 0.0 or not math.isfinite(variance):
            p_value = 1.0 if change == 0.0 or not math.isfinite(variance) else 0.0
        else:
            freedom = variance**2 / sum(v**2 / max(f, 1.0) for v, f in parts if v > 0.0)
            p_value = float(2.0 * student.sf(abs(change) / math.sqrt(variance), freedom))
        rows.append(
            Difference(name, units.get(name, ""), a[name], b[name], change, math.sqrt(variance), p_value, False)
        )
    rejected = reject_by_holm([row.p_value for row in rows], rate)
    return [row._replace(differs=bad) for row, bad in zip(rows, rejected)]


def reject_by_holm(p_values: Sequence[float], rate: float) -> list[bool]:
    """Which hypotheses are rejected at a family-wise rate."""
    rejected = [False] * len(p_values)
    for rank, k in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
        if not p_values[k] <= rate / (len(p_values) - rank):
            break
        rejected[k] = True
    return rejected


def differences_plain(rows: Sequence[Difference]) -> list[dict[str, Any]]:
    """The table as plain data; numbers that are not finite are null."""

    def plain(value: float) -> float | None:
        return value if math.isfinite(value) else None

    def side(estimate: Estimate) -> dict[str, float | None]:
        return {"value": plain(estimate.value), "std": plain(estimate.std)}

    return [
        {"quantity": r.name, "unit": r.unit, "a": side(r.a), "b": side(r.b), "difference": plain(r.change),
         "std": plain(r.std), "p-value": plain(r.p_value), "differs": r.differs}
        for r in rows
    ]  # fmt: skip


def differences_text(rows: Sequence[Difference], names: tuple[str, str]) -> str:
    """The table as text; what differs is marked and comes first."""
    wide = max([8, *(len(r.name) for r in rows)])
    lines = [f"  {'quantity':<{wide}}  {names[0]:>24}  {names[1]:>24}  {'difference':>24}  {'p-value':>9}  unit"]
    for row in sorted(rows, key=lambda r: (not r.differs, r.p_value if r.differs else 0.0)):
        cells = [_with_error(e.value, e.std) for e in (row.a, row.b)] + [_with_error(row.change, row.std)]
        mark = "*" if row.differs else " "
        lines.append(f"{mark} {row.name:<{wide}}  " + "  ".join(f"{c:>24}" for c in cells)
                     + f"  {row.p_value:>9.2g}  {row.unit}")  # fmt: skip
    return "\n".join(lines)


def _with_error(value: float, std: float) -> str:
    return f"{value:.4g} ± {std:.1g}" if math.isfinite(std) else f"{value:.4g}"
