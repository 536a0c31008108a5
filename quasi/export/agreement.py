"""Whether an export gives the numbers of `Model.predict`: states to compare at, differences, and the report.

A difference is relative to the reference value of its row, or to a thousandth of the largest of its column where that
is more: near a change of sign the last digits of the terms say nothing of the sum.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quasi.errors import DataError
from quasi.model.model import AXES, Model
from quasi.tables import write_json, write_text
from quasi.terms.differential import make_differential_system
from quasi.terms.kernel import INPUTS

COMPARED_STATES_ROWS = 10_000
AGREEMENT_LIMIT = 1e-12  # of the relative difference, float64
LIMIT_FLOAT32 = 1e-3  # polynomials of the fourth power of rotor speeds cancel to some digits less than float's seven
_FLOOR = 1e-3
_RANGES = {
    **dict.fromkeys(("roll", "pitch", "yaw"), (-3.0, 3.0)),
    **dict.fromkeys(("u", "v", "w", "p", "q", "r", "x", "y", "z"), (-10.0, 10.0)),
    **dict.fromkeys(INPUTS[16:], (-2e4, 2e4)),
}


class States(NamedTuple):
    """Where models are compared: state (N, 12), speeds (N, 4), accelerations (N, 4), extra {name: (N,)}."""

    state: np.ndarray
    speeds: np.ndarray
    accelerations: np.ndarray
    extra: dict[str, np.ndarray]

    @property
    def table(self) -> np.ndarray:
        """(N, 20 + E) all columns in the order of the model's inputs."""
        return np.column_stack([self.state, self.speeds, self.accelerations, *self.extra.values()])


class Check(NamedTuple):
    """One comparison: what, in which result it differs most, by how much (relative), and how much is allowed.

    binding  whether an export that differs is not handed over
    """

    what: str
    rows: int
    largest: float
    where: str
    limit: float
    binding: bool = True

    @property
    def agrees(self) -> bool:
        """Whether the difference is allowed."""
        return self.largest <= self.limit


def states_of(model: Model, rows: int = COMPARED_STATES_ROWS, seed: int = 8) -> States:
    """Random states over half as much again as a model's training data covered; wide ranges where that is unknown.

    Added to them: rest, and states whose velocities and rates are exactly zero.
    """
    random = np.random.default_rng(seed)
    hover = model.hover_speed or 2000.0
    ranges = {**_RANGES, **dict.fromkeys(INPUTS[12:16], (0.3 * hover, 1.7 * hover))}
    columns = {}
    for name in model.inputs:
        low, high = ranges.get(name, (0.1, 20.0))
        known = (model.document.get("envelope") or {}).get(name)
        if known and known["max"] > known["min"]:
            middle, half = 0.5 * (known["max"] + known["min"]), 0.75 * (known["max"] - known["min"])
            low, high = middle - half, middle + half
        if name in INPUTS[12:16]:
            low = max(low, 1.0)  # advance ratios have no value at rotors that stand still
        columns[name] = random.uniform(low, high, rows)
    for name in INPUTS[:12]:
        columns[name][0] = 0.0
    for k, name in enumerate(INPUTS[3:9]):
        columns[name][1 + k : 2 + k] = 0.0
    table = np.column_stack([columns[name] for name in INPUTS])
    return States(table[:, :12], table[:, 12:16], table[:, 16:], {n: columns[n] for n in model.inputs[20:]})


def wrench_of(model: Model, at: States) -> np.ndarray:
    """(N, 6) reference: Fx Fy Fz, N, Mx My Mz, N m, of `Model.predict`."""
    return np.column_stack(model.predict(at.state, at.speeds, at.accelerations, at.extra))


def form_of(model: Model, at: States, u: Sequence[str]) -> np.ndarray:
    """(N, 9 + 3 K) reference: A and B of the differential form, row by row."""
    form = make_differential_system(model, at.state, at.speeds, u, at.accelerations, at.extra)
    rows = len(at.state)
    return np.column_stack([form.A.reshape(rows, 9), form.B.reshape(rows, -1)])


def names_of_form(u: Sequence[str]) -> list[str]:
    """Names of the columns of `form_of`."""
    rates = ("p", "q", "r")
    return [f"A {a} by {b}" for a in rates for b in rates] + [f"B {a} by {b}" for a in rates for b in u]


def compare(
    what: str, found: np.ndarray, reference: np.ndarray, names: Sequence[str] = AXES, limit: float = AGREEMENT_LIMIT
) -> Check:
    """Compare (N, M) numbers with their reference; NaN and infinities must stand in the same places."""
    found, reference = np.asarray(found, float), np.asarray(reference, float)
    if found.shape != reference.shape:
        raise DataError(f"{what}: {found.shape} numbers instead of {reference.shape}; please report this")
    finite = np.isfinite(reference)
    # a number where there should be none, or the other way round, is as wrong as can be
    same = (found == reference) | (np.isnan(found) & np.isnan(reference))
    error = np.where(same, 0.0, np.inf)
    size = np.abs(np.where(finite, reference, 0.0))
    floor = np.maximum(size, _FLOOR * size.max(axis=0, initial=0.0))
    both = finite & np.isfinite(found) & ~same
    with np.errstate(divide="ignore", invalid="ignore"):
        error[both] = (np.abs(found - reference)[both]) / floor[both]
    worst = error.max(axis=0, initial=0.0)
    k = int(np.argmax(worst))
    return Check(what, len(found), float(worst[k]), names[k], limit)


def report(model: Model, export: str, checks: Sequence[Check], notes: Sequence[str]) -> dict[str, Any]:
    """The agreement report as plain data."""
    return {
        "schema": "quasi.agreement/1",
        "model": model.id,
        "export": export,
        "reference": "Model.predict and differential_system of quasi, float64",
        "agrees": all(check.agrees for check in checks if check.binding) if checks else None,
        "checks": [{**check._asdict(), "agrees": check.agrees} for check in checks],
        "notes": list(notes),
    }


def as_text(found: Mapping[str, Any]) -> str:
    """The agreement report as text."""
    lines = [f"Model {found['model']}, export {found['export']}, compared with {found['reference']}"]
    for check in found["checks"]:
        verdict = "agrees" if check["agrees"] else "DIFFERS"
        lines.append(
            f"{verdict}  {check['what']}: {check['rows']} rows, largest relative difference {check['largest']:.1e} "
            f"({check['where']}), allowed {check['limit']:.0e}"
        )
    if not found["checks"]:
        lines.append("not compared")
    return "\n".join([*lines, *found["notes"]]) + "\n"


def insist(found: Mapping[str, Any]) -> None:
    """Raises DataError naming the first comparison that failed."""
    for check in found["checks"]:
        if check["binding"] and not check["agrees"]:
            raise DataError(
                f"the {found['export']} export of model {found['model']} differs from the model: {check['what']}, "
                f"{check['where']} by {check['largest']:.1e} of its value, allowed {check['limit']:.0e}; report it"
            )


def hand_over(
    folder: str | Path, model: Model, export: str, checks: Sequence[Check], notes: Sequence[str], files: Sequence[str]
) -> str:
    """Write agreement.json and agreement.txt into an export's folder; returns the lines to report.

    files  what else stands there. Raises DataError when a comparison failed, after writing why.
    """
    found = report(model, export, checks, notes)
    write_json(Path(folder) / "agreement.json", found)
    write_text(Path(folder) / "agreement.txt", as_text(found))
    insist(found)
    return f"{as_text(found).rstrip()}\nMade {folder}: {', '.join([*files, 'agreement.json', 'agreement.txt'])}"
