"""Whether compared flights log their rotors in another order than the model has them.

The model, or the reference flights that it explains, show the right order. Each of the 23 other orders is a hypothesis:
the model predicts the moments from the reordered speeds, and what is left is compared with what the logged order
leaves. A wrong order predicts moments of the wrong sense, which no force or inertia can correct, so that it is tested
before the causes of forces. Where it is found, import puts the columns right and all else is asked of the same flights.

Under an order the moments are a gain from 0 to 1 times the prediction, and a rest that is taken for normal, with a
variance of its own on each axis: the log likelihood is -n/2 times the sum of the logarithms of these variances. Without
the gain, of two orders that explain nothing the one that predicts less would win. n counts seconds: moments of a flight
in closed loop are independent from one second to the next at the latest.
Source: Kass & Raftery, Bayes factors, JASA 90, 1995 (DECISIVE).
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.gap.flights.evidence import RATE, Evidence
from quasi.gap.flights.gathering import gather_all
from quasi.gap.flights.level import Flown
from quasi.model.columns import ROTORS
from quasi.model.model import AXES, Model

ID = "rotor_order"
MOMENT_AXES = tuple(AXES.index(a) for a in ("Mx", "My", "Mz"))
RIGHT = tuple(range(4))
ORDERS = tuple(itertools.permutations(RIGHT))  # order[i]: column, from 0, that holds rotor i
DECISIVE = np.log(100.0)  # of the odds, beyond the 23 to 1 that chance has more tries with the other orders
ROTOR_COLUMNS = ("w{}", "w{}_dot")
LAGS = (0.0, 0.01, 0.02, 0.04, 0.08)  # s, time constants from none to that of a large rotor
COMMAND_COLUMNS = ("command{}", "command{}_raw", "w{}_CMD", "w{}_CMD_raw")


class RotorOrder(NamedTuple):
    """speeds, commands  (4,) column, from 0, that holds rotor 1 to 4; odds {flight: log odds over the logged order};
    probability of this order among all; explained {axis: (share of the variance that the model explains in the logged
    order, in this one)} over the compared flights."""

    speeds: tuple[int, ...]
    commands: tuple[int, ...]
    odds: dict[str, float]
    probability: float
    explained: dict[str, tuple[float, float]]

    def calibration(self) -> dict[str, Any]:
        """The part of a calibration that puts the columns right."""
        wanted = {"order of speeds": self.speeds, "order of commands": self.commands}
        return {"rotors": {name: [i + 1 for i in order] for name, order in wanted.items() if order != RIGHT}}

    def document(self) -> dict[str, Any]:
        """Plain data for calibration and diagnosis."""
        return {
            "speeds": [i + 1 for i in self.speeds], "commands": [i + 1 for i in self.commands],
            "sentence": sentence_of(self.speeds), "log odds": self.odds, "probability": self.probability,
            "explained": {a: {"logged": e[0], "reordered": e[1]} for a, e in self.explained.items()},
        }  # fmt: skip


def sentence_of(order: Sequence[int]) -> str:
    """An order (from 0) in words: exchanged columns, or which column holds which rotor."""
    moved = [i for i in RIGHT if order[i] != i]
    pairs = [(i, order[i]) for i in moved if order[order[i]] == i and i < order[i]]
    if 2 * len(pairs) == len(moved):
        columns = ", and ".join(f"{a + 1} and {b + 1}" for a, b in pairs)
        return f"rotor columns {columns} are exchanged"
    return "rotor columns are permuted: " + ", ".join(f"column {order[i] + 1} holds rotor {i + 1}" for i in moved)


def reordered(table: pd.DataFrame, speeds: Sequence[int], commands: Sequence[int]) -> pd.DataFrame:
    """A table whose rotor columns stand in the order of the rotors. Orders count from 0."""
    names = {}
    for order, patterns in ((speeds, ROTOR_COLUMNS), (commands, COMMAND_COLUMNS)):
        for i, pattern in itertools.product(RIGHT, patterns):
            names[pattern.format(order[i] + 1)] = pattern.format(i + 1)
    # the columns keep their places, so that a table looks as it did
    return table.rename(columns=names)[list(table.columns)]


def reorder(flown: Flown, found: Mapping[str, Any]) -> Flown:
    """A flight with its columns put right as a document says."""
    orders = [[i - 1 for i in found[n]] for n in ("speeds", "commands")]
    return replace(flown, imported=reordered(flown.imported, *orders), filtered=reordered(flown.filtered, *orders))


def find_rotor_order(flights: Sequence[Flown], model: Model) -> RotorOrder | None:
    """The order in which compared flights log their rotors, where it is surely another one than the model's.

    Compared flights must favour the same order, each of them, and decisively together: a gentle flight shows little by
    itself, and one that is logged in another order than the rest speaks against theirs. Without a velocity, or where
    reference flights do not show the model's own order, nothing is found. Nor is it where the model's rotors contradict
    its configuration: then the order of the flights that made it is wrong, which the diagnosis reports of the model.
    """
    if model.document.get("contradictions"):
        return None
    read = {f.key: (f.filtered, f.filtered_metadata, f.airframe) for f in flights}
    try:
        evidence, _ = gather_all(read, model, RATE)
    except DataError:
        return None
    compared = {f.key: f for f in flights if f.compared and f.key in evidence}
    known = [np.isfinite(evidence[k].predicted[:, MOMENT_AXES]).all() for k in compared]
    if not compared or not all(known):
        return None
    left = {key: residual_variances(one, model) for key, one in evidence.items()}
    odds = {key: log_odds(left[key], evidence[key].t) for key in left}
    total = np.sum([odds[key] for key in compared], axis=0)
    best = int(np.argmax(total))
    needed = DECISIVE + np.log(len(ORDERS) - 1)
    if best == 0 or total[best] < needed or any(odds[key][best] <= 0.0 for key in compared):
        return None
    if any(odds[key].max() > needed for key in left if key not in compared):
        return None
    weight = np.exp(total - total.max())
    speeds = ORDERS[best]
    rows = np.array([len(evidence[key]) for key in compared], float)
    measured = rows @ [evidence[key].measured[:, MOMENT_AXES].var(axis=0) for key in compared]
    rest = np.einsum("f,fok->ok", rows, [left[key] for key in compared])
    share = 1.0 - rest / np.maximum(measured, 1e-300)
    explained = {AXES[a]: (float(share[0, k]), float(share[best, k])) for k, a in enumerate(MOMENT_AXES)}
    return RotorOrder(
        speeds, _order_of_commands([f.filtered for f in compared.values()], speeds),
        {key: float(odds[key][best]) for key in compared}, float(weight[best] / weight.sum()), explained,
    )  # fmt: skip


def residual_variances(flight: Evidence, model: Model) -> np.ndarray:
    """Variance (24, 3) within a flight of what the model leaves of the moments at best, by order (see `_rest`)."""
    accelerations = [f"{w}_dot" for w in ROTORS]
    names = [*ROTORS, *(a for a in accelerations if a in flight.columns)]
    found = []
    for order in ORDERS:
        moved = {n: flight.columns[f"w{order[int(n[1]) - 1] + 1}{n[2:]}"] for n in names}
        predicted = model.predict_columns({**flight.columns, **moved})[[AXES[a] for a in MOMENT_AXES]].to_numpy()
        found.append(_rest(flight.measured[:, MOMENT_AXES], predicted))
    return np.array(found)


def _rest(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Variance (3,) of the measured moments (n, 3) that the predicted ones leave, with the gain from 0 to 1 that leaves
    least."""
    power, common = predicted.var(axis=0), np.mean((measured - measured.mean(axis=0)) * predicted, axis=0)
    gain = np.clip(common / np.maximum(power, 1e-300), 0.0, 1.0)
    return (measured - gain * predicted).var(axis=0)


def log_odds(left: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Log likelihood (24,) of a flight's moments in each order above that in the logged one.

    left  (24, 3) variances that are left; t (n,) s
    """
    seconds = float(np.median(np.diff(t))) * len(t)
    return -0.5 * seconds * np.log(np.maximum(left, 1e-300) / np.maximum(left[:1], 1e-300)).sum(axis=1)


def _order_of_commands(tables: Sequence[pd.DataFrame], speeds: tuple[int, ...]) -> tuple[int, ...]:
    """Order of the commands: that of the speeds or the logged one, whichever the reordered speeds follow better."""
    for pattern in COMMAND_COLUMNS:
        names = [pattern.format(i + 1) for i in RIGHT]
        if not all(set(names) <= set(t) for t in tables):
            continue
        alike = [sum(_likeness(t, names, speeds, order) for t in tables) for order in (speeds, RIGHT)]
        return speeds if alike[0] > alike[1] else RIGHT
    return RIGHT


def _likeness(table: pd.DataFrame, names: Sequence[str], speeds: Sequence[int], order: Sequence[int]) -> float:
    """Largest correlation of lagged commands with speeds, both by what single rotors have beyond the mean of all.

    A controller's quick commands are turns of one sense after turns of the other: without the rotors' lag, the speed of
    one rotor may resemble the command of its neighbour more than its own.
    """
    turning, asked = table[[f"w{i + 1}" for i in speeds]], table[[names[i] for i in order]]
    dt = float(np.median(np.diff(table["t"])))
    return max(_correlation(turning, _lagged(asked, lag, dt)) for lag in LAGS)


def _lagged(columns: pd.DataFrame, lag: float, dt: float) -> pd.DataFrame:
    """First-order lag of columns every dt seconds, over rows known."""
    return columns.ewm(alpha=1.0 - np.exp(-dt / lag), adjust=False).mean() if lag else columns


def _correlation(one: pd.DataFrame, other: pd.DataFrame) -> float:
    both = np.hstack([one, other]).astype(float)
    both = both[np.isfinite(both).all(axis=1)]
    parts = [part - part.mean(axis=1, keepdims=True) for part in (both[:, :4], both[:, 4:])]
    sizes = np.prod([np.sqrt(np.mean(part**2)) for part in parts]) if len(both) else 0.0
    return float(np.mean(parts[0] * parts[1]) / sizes) if sizes > 0.0 else 0.0


def effect_of(found: Mapping[str, Any], since: str = "changed") -> dict[str, Any]:
    """The named cause of diagnosis.json, of a document of this module."""
    moved = {f"rotor{i + 1}": float(n) for i, n in enumerate(found["speeds"]) if n != i + 1}
    return {
        "id": ID, "level": "sensors", "since": since, "sentence": f"in the compared flights {found['sentence']}",
        "probability": found["probability"], "channels": list(found["explained"]),
        "parameters": {n: {"value": v, "std": 0.0, "unit": "1"} for n, v in moved.items()},
        "gain": {"wrench": None, "rollout": None}, "confused_with": [],
        "evidence": {"log odds": found["log odds"], "explained": found["explained"]},
    }  # fmt: skip


def note_of(found: Mapping[str, Any]) -> str:
    """What the order was found by, in a sentence."""
    shares = ", ".join(
        f"{a} {100 * e['logged']:.0f} to {100 * e['reordered']:.0f} %" for a, e in found["explained"].items()
    )
    return (
        f"in the compared flights {found['sentence']}: in the right order the model's explained share of the variance "
        f"of moments goes from {shares}; the flights were imported in the right order before all else was asked"
    )


def corrected_process(
    process: Callable[[Flown, Mapping[str, Any] | None], Flown], found: RotorOrder
) -> Callable[[Flown, Mapping[str, Any] | None], Flown]:
    """Import and filter compared flights in the right order, whatever else is corrected."""

    def processed(flown: Flown, calibration: Mapping[str, Any] | None) -> Flown:
        return process(flown, {**(calibration or {}), **found.calibration()} if flown.compared else calibration)

    return processed
