"""Stated faults of the rotors' drive: commands that sit at a limit, motors that turn slower than the others."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from quasi.gap.flights.level import Flown
from quasi.gap.levels.drive.fit import ODD_T, DriveFit
from quasi.gap.levels.drive.prediction import LAG, SPEED_SHARE
from quasi.terms.rotor_map import COMMANDED, SHARES

LIMIT_WIDTH = 0.002  # of a share, or of the largest speed: commands at one limit differ by less
CROWD = 5.0  # times as many commands at a limit as just inside it
LIMIT_SHARE = 0.005  # of the time in flight that a rotor sits at a limit, below which nobody minds
WEAK = 0.02  # of its speed
ALIKE = 0.005  # how much rotors' speeds at one command differ between flights
LAGS_ALIKE = 0.05  # share by which a healthy rotor's time constant differs between flights


def _crowded(values: np.ndarray, sign: float) -> float | None:
    """The level near the upper (sign 1) or lower (-1) end at which commands pile up, None where they do not."""
    values = np.sort(sign * values)
    top = values[int(0.90 * len(values)) :]
    edges = np.arange(values[0] if len(values) else 0.0, values[-1] + 2 * LIMIT_WIDTH, LIMIT_WIDTH)
    counts = np.histogram(values, edges)[0]
    best = None
    for k in np.flatnonzero(edges[:-1] >= top[0] - LIMIT_WIDTH):
        pile = counts[k : k + 2].sum()
        inside = counts[max(k - 10, 0) : max(k - 2, 0)]
        beyond = counts[k + 4 :].sum()
        crowd = pile > CROWD * 2.0 * max(inside.mean() if len(inside) else 0.0, 1.0)
        if crowd and beyond < 0.3 * pile and pile >= LIMIT_SHARE * len(values) and (best is None or pile > best[0]):
            best = pile, edges[k] + LIMIT_WIDTH
    return None if best is None else float(sign * best[1])


def _closed(table: np.ndarray) -> np.ndarray:
    """True (n,) where all four commands (n, 4) are as low as can be.

    Then the throttle is closed, as where rotors are switched off above the floor, and no limit holds one rotor back.
    """
    lowest = np.nanmin(table, initial=np.inf)
    return (table <= lowest + LIMIT_WIDTH * max(abs(lowest), 1.0)).all(axis=1)


def saturated(flights: Sequence[Flown], kind: str) -> list[dict[str, Any]]:
    """Commands of the compared flights that sit at a common limit: which rotor, how often, first when."""
    names = list(COMMANDED if kind == "speeds" else SHARES)
    flights = [f for f in flights if f.compared and all(n in f.imported for n in names)]
    if not flights:
        return []
    rows = [
        (f.filtered["valid"].to_numpy() > 0.5) & np.isfinite(f.imported[names].to_numpy(float)).all(axis=1)
        for f in flights
    ]
    tables = [f.imported[names].to_numpy(float) for f in flights]
    rows = [good & ~_closed(table) for good, table in zip(rows, tables)]
    pooled = np.concatenate([table[good].ravel() for table, good in zip(tables, rows)])
    if len(pooled) < 1000:
        return []
    scale = 1.0 if kind == "shares" else max(float(np.max(pooled)), 1.0)
    found = []
    for sign, word in ((1.0, "an upper"), (-1.0, "a lower")):
        limit = _crowded(pooled / scale, sign)
        if limit is None:
            continue
        shares, when = {}, None
        for flown, table, good in zip(flights, tables, rows):
            at = good[:, None] & (np.abs(table / scale - limit) < LIMIT_WIDTH)
            for i in range(4):
                shares.setdefault(f"rotor{i + 1}", []).append(at[:, i].sum() / max(good.sum(), 1))
            if when is None and at.any():
                when = flown.key, float(flown.imported["t"].to_numpy()[np.argmax(at.any(axis=1))])
        mean = {rotor: float(np.mean(v)) for rotor, v in shares.items()}
        worst = max(mean, key=mean.get)
        unit = "" if kind == "shares" else " rad/s"
        found.append(
            {
                "id": "actuator_saturation",
                "text": f"commands sit at {word} limit of {limit * scale:.3g}{unit}, {worst} for "
                f"{100 * mean[worst]:.1f} % of the flight, first in {when[0]} at {when[1]:.2f} s",
                "evidence": {"limit": limit * scale, "share": mean, "first": {"flight": when[0], "t": when[1]}},
            }
        )
    return found


def weak(flights: Sequence[Flown], fits: Sequence[DriveFit]) -> list[dict[str, Any]]:
    """Rotors that turn slower (or faster) at the same command than the others do, beyond the reference flights."""
    centred = np.eye(4) - 0.25  # apart from the mean of the rotors, which is the map's
    errors = [np.sqrt(np.diag(centred @ d.covariance()[SPEED_SHARE:LAG, SPEED_SHARE:LAG] @ centred)) for d in fits]
    values = np.array([d.values[SPEED_SHARE:LAG] for d in fits])
    return [
        {
            "id": "weak_motor",
            "text": f"rotor {odd.rotor + 1} turns {100 * abs(odd.size):.1f} % {'slower' if odd.size < 0 else 'faster'} "
            f"at the same command than {odd.others}",
            "evidence": {"rotor": odd.rotor + 1, "speed": 1.0 + odd.size, "std": odd.std},
        }
        for odd in _odd_rotors(flights, values, np.hypot(ALIKE, errors), -1)
        if abs(0.75 * odd.size) >= WEAK
    ]


def slow(flights: Sequence[Flown], fits: Sequence[DriveFit]) -> list[dict[str, Any]]:
    """Rotors that follow their commands later (or sooner) than the others do, beyond the reference flights."""
    errors = [d.lag_errors() for d in fits]
    values = np.array([d.values[LAG:] for d in fits])
    return [
        {
            "id": "motor_lag",
            "text": f"rotor {odd.rotor + 1} follows its commands with {np.exp(odd.size):.2f} times the time constant "
            f"of {odd.others}",
            "evidence": {"rotor": odd.rotor + 1, "factor": float(np.exp(odd.size)),
                         "std": float(np.exp(odd.size) * odd.std)},
        }
        for odd in _odd_rotors(flights, values, np.hypot(LAGS_ALIKE, errors), 1)
    ]  # fmt: skip


class Odd(NamedTuple):
    """A rotor (0 to 3) that is apart from others that are alike, by how much, and its standard error."""

    rotor: int
    others: str
    size: float
    std: float


def _odd_rotors(flights: Sequence[Flown], values: np.ndarray, doubt: np.ndarray, side: int) -> list[Odd]:
    """Rotors that are apart from the others, or from two that are alike where these three differ as well.

    values, doubt (F, 4)  of the flights, and their standard errors with what healthy rotors differ by between flights
    side  1 or -1, to which faults are: of two pairs that are each alike, that one is odd
    """
    compared = np.array([f.compared for f in flights])
    apart = values - values.mean(axis=1, keepdims=True)
    now, before = apart[compared], apart[~compared]
    usual = before.mean(axis=0) if len(before) else np.zeros(4)
    # two flights hardly show how much flights differ; those of all rotors, and of either kind, show it together
    groups = [group for group in (now, before) if len(group)]
    squares, freedom = sum(group.var(axis=0).mean() * len(group) for group in groups), len(apart) - len(groups)
    together = np.sqrt(squares / freedom) if freedom else 0.0
    scatter = np.maximum(np.maximum(now.std(axis=0), together), np.sqrt(np.mean(doubt**2, axis=0)))
    std = scatter * np.sqrt(1.0 / len(now) + (1.0 / len(before) if len(before) else 0.0))
    size = now.mean(axis=0) - usual
    i = int(np.argmax(np.abs(size)))
    if abs(size[i]) < ODD_T * std[i]:
        return []
    alike = np.delete(np.arange(4), i)
    if np.any(np.abs(size - size[alike].mean())[alike] >= ODD_T * std[alike]):
        order = np.argsort(side * size)
        gaps = np.diff(size[order]) * side
        near = np.flatnonzero(gaps < ODD_T * std[order[1:]])
        first = near[0] if len(near) else np.argmin(gaps)
        alike = np.sort(order[first : first + 2])
    away = size - size[alike].mean()
    # the mean of the four is in each of them; that of those that are alike is as unsure as few rotors are
    factor = np.sqrt((1.0 + 1.0 / len(alike)) / 0.75)
    others = "the others" if len(alike) == 3 else f"rotors {alike[0] + 1} and {alike[1] + 1}"
    found = [Odd(int(k), others, float(away[k]), float(factor * std[k])) for k in range(4) if k not in alike]
    return [odd for odd in found if abs(odd.size) >= ODD_T * odd.std]
