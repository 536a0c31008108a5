"""The yardstick of a named cause: a polynomial of the same size, which has no name and no physics."""

from collections.abc import Callable, Sequence

import numpy as np

from quasi.gap.effect import vehicle_of
from quasi.gap.flights.evidence import Evidence
from quasi.model.model import AXES

SCALES = {"u": 3.0, "v": 3.0, "w": 3.0, "p": 3.0, "q": 3.0, "r": 3.0, "height": 1.0, "rotors": 1.0}


def polynomial(
    flights: Sequence[Evidence], size: int, axes: Sequence[int] = range(len(AXES))
) -> Callable[[Evidence], np.ndarray]:
    """Fit `size` monomials of up to second order to the residuals; returns flight -> (n, 6), what is then left.

    flights  those that may be learnt from; monomials of velocity, rates, height and mean rotor speed are chosen one by
             one, each for the axis whose residual it reduces most as a share, and fitted by least squares
    axes     on which it may spend its terms: elsewhere, what flights differ by would take them all
    """
    names, _ = _monomials(flights[0])
    grams = np.zeros((6, len(names) + 1, len(names) + 1))
    for flight in flights:
        columns = _monomials(flight)[1]
        for k in range(6):
            whole = np.column_stack([flight.residual[:, k], columns])
            grams[k] += whole.T @ whole
    chosen: list[list[int]] = [[] for _ in AXES]
    left = grams[:, 0, 0].copy()

    def fit(k: int, use: list[int]) -> tuple[float, np.ndarray]:
        inner = grams[k][np.ix_(use, use)]
        value = np.linalg.solve(inner + 1e-9 * np.diag(np.diag(inner)), grams[k][use, 0])
        return grams[k][0, 0] - grams[k][0, use] @ value, value

    for _ in range(size):
        best = min(
            ((fit(k, [*chosen[k], j])[0] / left[k], k, j)
             for k in axes for j in range(1, len(names) + 1) if j not in chosen[k]),
        )  # fmt: skip
        _, k, j = best
        chosen[k].append(j)
        left[k] = max(fit(k, chosen[k])[0], 1e-300)
    values = [fit(k, use)[1] if use else np.zeros(0) for k, use in enumerate(chosen)]

    def residual(flight: Evidence) -> np.ndarray:
        columns = _monomials(flight)[1]
        taken = [columns[:, [j - 1 for j in use]] @ value for use, value in zip(chosen, values)]
        return flight.residual - np.stack(taken, axis=1)

    return residual


def _monomials(flight: Evidence) -> tuple[list[str], np.ndarray]:
    first = dict(zip("uvw", flight.velocity.T)) | dict(zip("pqr", flight.rates.T))
    hover = flight.model.hover_speed or vehicle_of(flight.model).hover_speed  # which some published models do not state
    first["rotors"] = flight.speeds.mean(axis=1) / hover - 1.0
    if "z" in flight.columns:
        first["height"] = -flight.columns["z"]
    first = {n: v / SCALES[n] for n, v in first.items()}
    names, columns = ["1", *first], [np.ones(len(flight)), *first.values()]
    pairs = list(first)
    for i, a in enumerate(pairs):
        for b in pairs[i:]:
            names.append(f"{a} {b}")
            columns.append(first[a] * first[b])
    return names, np.stack(columns, axis=1)
