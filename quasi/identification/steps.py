"""The course of a stepwise search in words, as the manual reports it: term added, term removed, PSE, R2, bias.

Source: QuaSI user manual V1.0.a, section 6.5.2.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quasi.identification.products import Pool


def biases(log: Sequence[Mapping[str, Any]], pool: Pool, names: Sequence[str]) -> list[float | None]:
    """The constant term after each step of the log, in the target's unit; None where the model has none.

    names  expressions of the pool's columns, by which the log names them
    """
    place = {name: k for k, name in enumerate(names)}
    columns, found = list(range(pool.fixed)), []
    for entry in log:
        if entry["selected"] is not None:
            columns.append(place[entry["selected"]])
        if entry["removed"] is not None:
            columns.remove(place[entry["removed"]])
        found.append(_bias(pool, columns) if pool.constant else None)
    return found


def _bias(pool: Pool, columns: Sequence[int]) -> float:
    gram = np.array([pool.cross(k)[:, columns].sum(axis=0) for k in columns])
    scale = np.sqrt(np.diag(gram))
    target = pool.target[:, columns].sum(axis=0)
    theta = np.linalg.solve(gram / np.outer(scale, scale), target / scale) / scale
    # the columns stand about their means, the constant (first) does not
    return float(pool.target_shift + theta[0] - theta[1:] @ pool.shift[list(columns[1:])])


def describe_steps(axis: str, log: Sequence[Mapping[str, Any]], reason: str) -> list[str]:
    """One sentence for each step of a search, and why it ended."""
    lines = []
    for entry in log:
        head = f"{axis}, fixed regressors alone" if entry["step"] == 0 else f"{axis}, step {entry['step']}"
        changed = [
            f"{what} {entry[key]}" for key, what in (("selected", "added"), ("removed", "removed")) if entry[key]
        ]
        values = [f"PSE {entry['PSE']:.6g}", f"R2 {entry['R2']:.6f}"]
        if entry.get("bias") is not None:
            values.append(f"bias {entry['bias']:.6g}")
        lines.append(f"{head}: {', '.join([*changed, *values])}")
    return [*lines, f"{axis}: the search ended because {reason}"]
