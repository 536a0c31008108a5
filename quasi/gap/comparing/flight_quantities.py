"""Constants of a vehicle as one filtered flight shows them, the same few terms in every flight.

Forces and moments are regressed on the physical terms of a quadrotor, so that another manoeuvre is no difference:

    Fx = c + d u,  Fy = c + d v,  Fz = k sum w^2 + d w sum w,
    Mx = c + e C + f p + g v,  My = c + e C + f q + g u,  Mz = c + e C + f r

C is the pattern of four signs of the squared rotor speeds that moves the moment most in hover: front less aft, left
less right, or one diagonal less the other; the geometry need not be known. Standard errors are robust to correlation
within blocks. Further: each rotor's share of the squared speeds, levels of vibration, battery voltage.

Source: Cameron, Gelbach & Miller, J. Human Resources 50(2), 2015 (block-robust errors).
"""

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
from scipy.signal import butter, sosfiltfilt

from quasi.errors import DataError
from quasi.gap.comparing.differences import Estimate
from quasi.gap.statistics.blocks import BLOCK

LEAST_BLOCKS = 4
VIBRATION = 10.0  # Hz, above which a rate or specific force counts as vibration and not as motion
PATTERNS = np.array([[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0], [1.0, -1.0, -1.0, 1.0]])
COMPARED_COLUMNS = ("t", "w1", "w2", "w3", "w4", "Fx", "Fy", "Fz", "Mx", "My", "Mz", "u", "v", "w", "p", "q", "r")
QUANTITY_UNITS = {
    "force x, constant": "N", "force y, constant": "N", "drag x": "N/(m/s)", "drag y": "N/(m/s)",
    "thrust coefficient": "N/(rad/s)^2", "thrust by vertical speed": "N s2/m",
    **{f"{a} moment, constant": "N m" for a in ("roll", "pitch", "yaw")},
    **{f"{a} effectiveness": "N m/(rad/s)^2" for a in ("roll", "pitch", "yaw")},
    **{f"{a} damping": "N m/(rad/s)" for a in ("roll", "pitch", "yaw")},
    "roll moment by velocity": "N m/(m/s)", "pitch moment by velocity": "N m/(m/s)",
    **{f"share of rotor {i}": "-" for i in range(1, 5)},
    **{f"vibration a{a}": "m/s2" for a in "xyz"}, **{f"vibration {a}": "rad/s" for a in "pqr"},
    "rotor speed": "rad/s", "battery voltage": "V",
}  # fmt: skip


def quantities_of(flight: pd.DataFrame, where: str, patterns: Mapping[str, int] | None = None) -> dict[str, Estimate]:
    """{quantity: estimate} of a filtered flight, SI, body axes x forward, y right, z down.

    where     names the flight in messages
    patterns  {axis: row of PATTERNS} of another flight, so that both use the same; None finds them here
    Raises DataError for a flight without a column, or shorter than LEAST_BLOCKS blocks of BLOCK s in flight.
    """
    missing = [n for n in COMPARED_COLUMNS if n not in flight]
    if missing:
        raise DataError(f"{where} has no column '{missing[0]}'; give a filtered flight (results/filtered/...)")
    rows = rows_in_flight(flight)
    part = flight[rows]
    blocks = np.floor((part["t"].to_numpy(float) - float(flight["t"].iloc[0])) / BLOCK).astype(int)
    if len(np.unique(blocks)) < LEAST_BLOCKS:
        raise DataError(
            f"{where} holds {len(np.unique(blocks))} blocks of {BLOCK:g} s in flight, at least {LEAST_BLOCKS} are "
            "needed for a spread; give a longer flight"
        )
    return _estimates(flight, part, rows, blocks, patterns or patterns_of(flight))


def rows_in_flight(flight: pd.DataFrame) -> np.ndarray:
    """(n,) bool: rows that are in flight, valid, and finite in all that is needed."""
    rows = np.isfinite(flight[list(COMPARED_COLUMNS)].to_numpy(float)).all(axis=1)
    for flag in ("valid", "in_flight"):
        if flag in flight:
            rows &= flight[flag].to_numpy(float) > 0.5
    return rows


def patterns_of(flight: pd.DataFrame) -> dict[str, int]:
    """{"Mx", "My", "Mz": row of PATTERNS} with which the moment moves most."""
    part = flight[rows_in_flight(flight)]
    contrast = _squares(part) @ PATTERNS.T
    contrast = contrast - contrast.mean(axis=0)
    found = {}
    for axis in ("Mx", "My", "Mz"):
        moment = part[axis].to_numpy(float)
        slopes = np.linalg.lstsq(contrast, moment - moment.mean(), rcond=None)[0]
        found[axis] = int(np.argmax(np.abs(slopes) * contrast.std(axis=0)))
    return found


def _estimates(
    flight: pd.DataFrame, part: pd.DataFrame, rows: np.ndarray, blocks: np.ndarray, patterns: Mapping[str, int]
) -> dict[str, Estimate]:
    column: Callable[[str], np.ndarray] = lambda name: part[name].to_numpy(float)  # noqa: E731
    air = {c: column(f"{c}_air") if f"{c}_air" in part else column(c) for c in "uvw"}
    squares, one = _squares(part), np.ones(len(part))
    speeds = part[["w1", "w2", "w3", "w4"]].to_numpy(float)
    found: dict[str, Estimate] = {}

    def fit(axis: str, terms: Mapping[str, np.ndarray], sign: float = 1.0) -> None:
        found.update(regress(sign * column(axis), terms, blocks))

    fit("Fx", {"force x, constant": one, "drag x": -air["u"]})
    fit("Fy", {"force y, constant": one, "drag y": -air["v"]})
    fit(
        "Fz",
        {"thrust coefficient": squares.sum(axis=1), "thrust by vertical speed": air["w"] * speeds.sum(axis=1)},
        -1.0,
    )
    for axis, name, rate in (("Mx", "roll", "p"), ("My", "pitch", "q"), ("Mz", "yaw", "r")):
        terms = {f"{name} moment, constant": one, f"{name} effectiveness": squares @ PATTERNS[patterns[axis]],
                 f"{name} damping": -column(rate)}  # fmt: skip
        if axis != "Mz":
            terms[f"{name} moment by velocity"] = air["v" if axis == "Mx" else "u"]
        fit(axis, terms)
    for i in range(4):
        found[f"share of rotor {i + 1}"] = mean_of(squares[:, i] / squares.sum(axis=1), blocks)
    for name in ("ax", "ay", "az", "p", "q", "r"):
        level = _vibration(flight, name)
        if level is not None:
            found[f"vibration {name}"] = mean_of(level[rows], blocks)
    found["rotor speed"] = mean_of(np.sqrt(squares.mean(axis=1)), blocks)
    if "battery_voltage" in part and np.isfinite(column("battery_voltage")).all():
        found["battery voltage"] = mean_of(column("battery_voltage"), blocks)
    return found


def regress(measured: np.ndarray, terms: Mapping[str, np.ndarray], blocks: np.ndarray) -> dict[str, Estimate]:
    """Least squares with block-robust standard errors; a term that hardly moves has a large one."""
    design = np.stack(list(terms.values()), axis=1)
    scale = np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1e-300)
    a = design / scale
    normal = np.linalg.pinv(a.T @ a)
    solution = normal @ (a.T @ measured)
    scores = a * (measured - a @ solution)[:, None]
    labels = np.unique(blocks)
    sums = np.stack([scores[blocks == b].sum(axis=0) for b in labels])
    count = len(labels)
    # a fit of k terms to few blocks makes residuals too small by about k of them
    freedom = max(count - len(terms), 1)
    covariance = normal @ (sums.T @ sums) @ normal * count / freedom
    std = np.sqrt(np.diag(covariance)) / scale
    return {n: Estimate(float(v), float(s), float(freedom)) for n, v, s in zip(terms, solution / scale, std)}


def mean_of(values: np.ndarray, blocks: np.ndarray) -> Estimate:
    """The mean over blocks, and its standard error from the spread between them."""
    means = np.array([values[blocks == b].mean() for b in np.unique(blocks)])
    return Estimate(float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means))), float(len(means) - 1))


def _squares(part: pd.DataFrame) -> np.ndarray:
    return part[["w1", "w2", "w3", "w4"]].to_numpy(float) ** 2


def _vibration(flight: pd.DataFrame, name: str) -> np.ndarray | None:
    """(n,) size of a column above VIBRATION, or None where it is absent or sampled too slowly."""
    if name not in flight:
        return None
    rate = 1.0 / float(np.median(np.diff(flight["t"].to_numpy(float))))
    if rate < 4.0 * VIBRATION:
        return None
    high = butter(2, VIBRATION, btype="high", fs=rate, output="sos")
    return np.abs(sosfiltfilt(high, np.nan_to_num(flight[name].to_numpy(float))))
