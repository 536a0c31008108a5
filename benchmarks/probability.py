"""How probable is what a diagnosis states? Fit the calibration of `quasi.gap.probability`, and check it.

    python benchmarks/probability.py DRAWS [DRAWS ...] [--plants PLANTS]

DRAWS are folders of draws of `hide_and_seek.py`, PLANTS one of `plants.py`: faults in recordings of a real vehicle. A
name is right where the cause is hidden in the data set, a tie where one of its causes is. Entries that healthy flights
show as well count for nothing: the vehicle has them, and no truth says whether they are right. Of every kind of entry,
a logistic function of the decades of its p-value is fitted by penalised likelihood, which stays finite where the two
outcomes are separated. Then every data set is left out in turn.
Source: Firth, Bias reduction of maximum likelihood estimates, Biometrika 80, 1993.
"""

import argparse
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from hidden import INHERENT, STRANGE
from plants import PLANTS
from scipy.optimize import minimize
from scipy.special import expit

from quasi.gap.probability import KINDS, decades_of, probability_of
from quasi.tables import read_json

BINS = (0.0, 0.1, 0.5, 0.9, 1.0)


class Stated(NamedTuple):
    """An entry of a diagnosis: kind (a key of KINDS), decades of its p-value, whether it is right, data set."""

    kind: str
    decades: float
    right: bool
    of: str

    @property
    def probability(self) -> float:
        """As `quasi.gap.probability` states it."""
        return probability_of(self.kind, self.decades)


def stated(result: Mapping[str, Any]) -> list[Stated]:
    """Entries of one draw that have a p-value and a known truth."""
    truth = set(result["effects"]) - set(STRANGE)
    inherent = INHERENT | ({"thrust_curve"} if result.get("world", 0) else set())
    entries = {"effects": result["effects said"], "ties": result["ties"], "candidates": result.get("candidates", [])}
    found = []
    for kind, of_kind in entries.items():
        for entry in of_kind:
            ids, x = set(entry.get("ids") or [entry["id"]]), decades_of(entry)
            if x is None or entry.get("level") == "trim" or "sentence" in entry:
                continue
            right = bool(ids & truth)
            common = entry.get("in training flights", entry["since"] == "always")
            # of a cause that changed, what all flights have in common is another question
            unknown = common and (result["design"] != "own" or (ids <= inherent and not right))
            if not unknown or (right and kind != "candidates"):
                found.append(Stated(kind, x, right, str(result["settings"]["seed"])))
    return found


def planted(name: str, found: Mapping[str, Any]) -> list[Stated]:
    """Entries of the diagnosis of a plant, of what changed alone: the recording has findings of its own."""
    right, result = set(PLANTS[name].right), []
    for kind in KINDS:
        for entry in found[kind]:
            ids, x = set(entry.get("ids") or [entry["id"]]), decades_of(entry)
            if x is not None and entry["since"] == "changed":
                result.append(Stated(kind, x, bool(ids & right), name))
    return result


def fit(entries: Sequence[Stated]) -> tuple[float, float]:
    """Intercept and slope of a logistic function, at the mode of Firth's penalised likelihood; the slope is >= 0."""
    x = np.column_stack([np.ones(len(entries)), [e.decades for e in entries]])
    y = np.array([e.right for e in entries], float)

    def loss(b: np.ndarray) -> float:
        eta = x @ b
        chance = expit(eta)
        information = (x * (chance * (1.0 - chance))[:, None]).T @ x
        return float(np.logaddexp(0.0, eta).sum() - y @ eta - 0.5 * np.linalg.slogdet(information)[1])

    found = minimize(loss, [0.0, 0.1], method="L-BFGS-B", bounds=[(-15.0, 15.0), (0.0, 5.0)])
    return float(found.x[0]), float(found.x[1])


def left_out(entries: Sequence[Stated]) -> np.ndarray:
    """Probability of each entry, fitted to the entries of all other data sets."""
    result = np.zeros(len(entries))
    for name in {e.of for e in entries}:
        a, b = fit([e for e in entries if e.of != name])
        for k, e in enumerate(entries):
            if e.of == name:
                result[k] = expit(a + b * e.decades)
    return result


def brier(chance: Iterable[float], right: Iterable[bool]) -> float:
    """Mean squared difference between probabilities and outcomes. Source: Brier, Monthly Weather Review 78, 1950."""
    return float(np.mean((np.array(list(chance), float) - np.array(list(right), float)) ** 2))


def bin_table(chance: Sequence[float], right: Sequence[bool]) -> list[str]:
    """Rows of Markdown: probabilities from, to, how many entries, mean probability, share that is right."""
    chance, right = np.asarray(chance, float), np.asarray(right, bool)
    rows = ["| stated | entries | mean | right | share |", "| --- | --- | --- | --- | --- |"]
    for low, high in pairwise(BINS):
        own = (chance >= low) & ((chance < high) | (high == BINS[-1]))
        if own.any():
            rows.append(
                f"| {low:g} to {high:g} | {own.sum()} | {chance[own].mean():.3f} | {right[own].sum()} | "
                f"{right[own].mean():.3f} |"
            )
    return rows


def main() -> None:
    """Fit and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("draws", type=Path, nargs="+")
    parser.add_argument("--plants", type=Path)
    arguments = parser.parse_args()
    paths = [path for folder in arguments.draws for path in sorted(folder.glob("*.json"))]
    results = [r for r in map(read_json, paths) if r["outcome"] != "lost"]
    entries = [e for r in results for e in stated(r)]
    real = sorted(arguments.plants.glob("*.json")) if arguments.plants else []
    entries += [e for path in real for e in planted(path.stem, read_json(path))]
    print(f"{len(results)} draws, {len(real)} plants")
    for kind in KINDS:
        own = [e for e in entries if e.kind == kind]
        if len({e.right for e in own}) < 2:
            print(f"{kind}: {len(own)} entries, all alike; nothing to fit")
            continue
        chance, right = left_out(own), [e.right for e in own]
        a, b = fit(own)
        print(f"{kind}: {len(own)} entries, {sum(right)} right; intercept {a:.2f}, slope {b:.3f} per decade")
        print(f"every data set left out in turn: Brier score {brier(chance, right):.4f}, of the mean alone "
              f"{brier([np.mean(right)] * len(own), right):.4f}")  # fmt: skip
        print("\n".join(bin_table(chance, right)))


if __name__ == "__main__":
    main()
