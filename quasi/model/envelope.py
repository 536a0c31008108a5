"""The region of a model's training data, and the distance of a state outside it.

Two limits, both learnt from the training rows (where isolation applies, those that some axis was fitted to):

- one range per variable: its 0.01 % to 99.99 % percentile. The variables are the base columns that the model reads and
  those that its terms name (U_p, mu_x, ...), the latter because a combination may be new where each part is not.
  Constant variables are not limited.
- one ellipsoid for the base columns together: distance from their mean in units of their covariance (Mahalanobis),
  limited to the 99.99 % percentile of the training rows. It detects combinations that no single range shows, such as
  full forward speed at the rotor speeds of hover.

The distance is 0 inside; outside it is the largest overshoot over all limits, in units of the covered range: 0.5 means
that a variable lies half of its covered range beyond the nearer end. The ellipsoid is measured alike: its diameter is
its range. Polynomials extrapolate badly: a distance above a few tenths means an unreliable prediction.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numba as nb
import numpy as np
import pandas as pd

from quasi.airframe import Airframe
from quasi.tables import COLUMNS
from quasi.terms.expressions import names, parse
from quasi.terms.graph import ONE, Graph
from quasi.terms.kernel import INPUTS, Kernel, compile_outputs, compute_wrench_rows
from quasi.terms.variables import SYNONYMS, Variables, base_columns, plain_name

STATE_INPUTS = INPUTS[:12]
PERCENTILES = (0.01, 1, 5, 25, 50, 75, 95, 99, 99.99)
LOW_PERCENTILE, HIGH_PERCENTILE = "0.01", "99.99"
JOINT_LIMIT = "all together"
_NOT_LIMITED = ("F_den", "M_den")  # of the non-dimensional scheme; functions of the rotor speeds alone
_MIN_UNEXPLAINED_SHARE = (
    1e-4  # share of a variable's own deviation that the others never explain: keeps the ellipsoid from being flat
)


class Limits(NamedTuple):
    """Limits of V variables, low and high (V,), and of the ellipsoid: whitening (J, J) lower triangular, limit (1,)."""

    low: np.ndarray
    high: np.ndarray
    whitening: np.ndarray
    limit: np.ndarray


class Region(NamedTuple):
    """The covered region as flat arrays.

    kernel  gives the V limited variables, then the J base columns of the ellipsoid less their mean
    limits  what they are compared with
    """

    kernel: Kernel
    limits: Limits


@nb.njit(cache=True, error_model="numpy")
def _farthest(
    low: np.ndarray, high: np.ndarray, whitening: np.ndarray, limit: np.ndarray, values: np.ndarray
) -> tuple[float, int]:
    farthest, worst, total, square = 0.0, -1, 0.0, 0.0
    first = len(low)
    for k in range(first):
        value = values[k]
        total += value
        beyond = max(low[k] - value, value - high[k])
        if beyond > 0.0 and beyond > farthest * (high[k] - low[k]):
            farthest, worst = beyond / (high[k] - low[k]), k
    for i in range(len(whitening)):
        part = 0.0
        for j in range(i + 1):
            part += whitening[i, j] * values[first + j]
        square += part * part
    joint = 0.5 * (np.sqrt(square) / limit[0] - 1.0)
    if joint > farthest:
        farthest, worst = joint, first
    return (np.nan, -1) if np.isnan(total + square) else (farthest, worst)


@nb.njit(cache=True, error_model="numpy")
def compute_distances(kernel: Kernel, limits: Limits, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance and worst variable of many rows: columns (G, N), the inputs of `kernel.gather`."""
    rows = columns.shape[1]
    values = np.empty((kernel.code[4], rows))
    compute_wrench_rows(kernel, columns, values)
    low, high, whitening, limit = limits.low, limits.high, limits.whitening, limits.limit
    distance, worst, row = np.empty(rows), np.empty(rows, np.int64), np.empty(len(values))
    for k in range(rows):
        for m in range(len(values)):
            row[m] = values[m, k]
        distance[k], worst[k] = _farthest(low, high, whitening, limit, row)
    return distance, worst


def make_region(
    document: Mapping[str, Any], graph: Graph, inputs: Sequence[str], used: np.ndarray, named: Iterable[str]
) -> tuple[Region, tuple[str, ...]]:
    """Region of a model and the names of its limited variables.

    document  the model as plain data; graph  a new graph of its airframe; inputs  names of the kernel's inputs
    used (20 + E,) which of them the model reads; named  the variables of its terms
    Variables for which the model holds no range are not limited.
    """
    ranges = document.get("envelope", {})
    read = [name for name, reads in zip(inputs, used) if reads]
    ends = {}
    for name in [*read, *list_limited_names(named)]:
        if name in ranges:
            shares = ranges[name]["percentiles"]
            low, high = (
                shares.get(LOW_PERCENTILE, ranges[name]["min"]),
                shares.get(HIGH_PERCENTILE, ranges[name]["max"]),
            )
            if low < high:
                ends[name] = (low, high)
    limited = tuple(ends)
    names, mean, whitening, limit = _read_ellipsoid(document.get("joint envelope"), read)
    outputs = [graph.combine([(1.0, graph.variable(name))]) for name in limited]
    outputs += [graph.combine([(1.0, graph.variable(n)), (-m, (1.0, ONE))]) for n, m in zip(names, mean, strict=True)]
    limits = Limits(
        np.array([ends[name][0] for name in limited], float),
        np.array([ends[name][1] for name in limited], float),
        whitening,
        np.array([limit], float),
    )
    return Region(compile_outputs(graph, outputs, inputs), limits), limited


def _read_ellipsoid(
    plain: Mapping[str, Any] | None, read: Sequence[str]
) -> tuple[list[str], list[float], np.ndarray, float]:
    """The ellipsoid in the columns that a model reads; of others its shadow is taken, which never reaches further."""
    if not plain:
        return [], [], np.zeros((0, 0)), 1.0
    chosen = [k for k, name in enumerate(plain["names"]) if name in read]
    size = len(plain["names"])
    whitening = np.array(plain["whitening"], float).reshape(size, size)
    if len(chosen) < size:
        spread = np.linalg.inv(whitening)
        whitening = np.linalg.inv(np.linalg.cholesky((spread @ spread.T)[np.ix_(chosen, chosen)]))
    return [plain["names"][k] for k in chosen], [plain["mean"][k] for k in chosen], whitening, plain["limit"]


def list_limited_names(named: Iterable[str]) -> list[str]:
    """Variables of terms as they are limited: without |..|, sin[..], cos[..], under one spelling; no squared speeds."""
    plain = dict.fromkeys(plain_name(name) for name in named)
    return [name for name in plain if name not in SYNONYMS and name not in _NOT_LIMITED]


# ---- from the training rows ----


def measure_coverage(
    flights: Mapping[str, pd.DataFrame],
    rows: Mapping[str, np.ndarray],
    airframe: Airframe,
    hover_speed: float | None,
    parts: Mapping[str, Mapping[str, Any]] | None = None,
) -> dict[str, dict[str, Any]]:
    """Measure the coverage of the training data, as stored in a model: "envelope" and "joint envelope".

    flights  filtered flights; rows {flight: (n,) bool} those that were fitted
    parts    identified axes, whose terms' variables are included in addition to the state and the rotor speeds
    "envelope" holds per variable its smallest and largest value and percentiles. "joint envelope" holds names, mean,
    whitening (lower triangular, x - mean becomes uncorrelated with unit variance) and limit, the distance within which
    99.99 % of the rows lie, of the base columns that the terms need; it is empty when no row holds all of them.
    """
    terms = [
        n for part in (parts or {}).values() for term in part["terms"] for n in names(parse(term["expression"]))
        if plain_name(n) not in _NOT_LIMITED
    ]  # fmt: skip
    # under the non-dimensional scheme every term needs the rotor speeds
    scheme = any(part.get("normalisation") for part in (parts or {}).values())
    speeds = {"w1", "w2", "w3", "w4"} if scheme else set()
    base = sorted(set().union(*(base_columns(n) for n in terms), speeds), key=_position)
    wanted = list(dict.fromkeys([*STATE_INPUTS, "w1", "w2", "w3", "w4", *base, *terms, *list_limited_names(terms)]))
    gathered: dict[str, list[np.ndarray]] = {}
    together: list[np.ndarray] = []
    for key, flight in flights.items():
        use = np.asarray(rows[key], bool)
        if not use.any():
            continue
        columns = {c: flight[c].to_numpy(float)[use] for c in flight if pd.api.types.is_numeric_dtype(flight[c])}
        variables = Variables(columns, airframe, hover_speed)
        for name in wanted:
            if name in STATE_INPUTS and name not in columns:
                continue
            values = variables[name]
            gathered.setdefault(name, []).append(values[np.isfinite(values)])
        if base:
            together.append(np.column_stack([variables[name] for name in base]))
    ranges = {name: np.concatenate(chunks) for name, chunks in gathered.items()}
    return {
        "envelope": {name: _describe_range(name, values) for name, values in ranges.items() if len(values)},
        "joint envelope": _fit_ellipsoid(base, np.vstack(together)) if together else {},
    }


def _position(name: str) -> tuple[int, str]:
    return (INPUTS.index(name) if name in INPUTS else len(INPUTS), name)


def _describe_range(name: str, values: np.ndarray) -> dict[str, Any]:
    shares = np.percentile(values, PERCENTILES)
    return {
        "min": float(values.min()),
        "max": float(values.max()),
        "percentiles": {f"{p:g}": float(s) for p, s in zip(PERCENTILES, shares)},
    } | ({"unit": COLUMNS[name][0]} if name in COLUMNS else {})


def _fit_ellipsoid(base: list[str], table: np.ndarray) -> dict[str, Any]:
    table = table[np.isfinite(table).all(axis=1)]
    spread = table.std(axis=0) if len(table) > len(base) + 1 else np.zeros(len(base))
    chosen = spread > 0
    if not chosen.any():
        return {}
    mean, spread = table[:, chosen].mean(axis=0), spread[chosen]
    scaled = (table[:, chosen] - mean) / spread
    correlation = scaled.T @ scaled / len(scaled) + _MIN_UNEXPLAINED_SHARE * np.eye(len(spread))
    whitening = np.linalg.inv(np.linalg.cholesky(correlation)) / spread
    size = np.sqrt(np.sum(((table[:, chosen] - mean) @ whitening.T) ** 2, axis=1))
    return {
        "names": [name for name, c in zip(base, chosen) if c],
        "mean": mean.tolist(),
        "whitening": np.tril(whitening).tolist(),
        "limit": float(np.percentile(size, float(HIGH_PERCENTILE))),
    }
