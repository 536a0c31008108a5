"""Where the windows of roll-outs begin, where their end errors live, and whether these come again in the next
window."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from quasi.gap.flights.covariates import places
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.residual_tables import located, where
from quasi.gap.levels.rollouts.open_loop import COLUMN, ERROR_UNITS, EVERY, MOVED_BY, VECTORS, Flight, finite

MODELS = ("before", "after", "noise_floor")
PAIRS = 8  # of windows from which it is decided whether errors come again
UNIT_OF = ERROR_UNITS | {name: ERROR_UNITS[name.split()[0]] for name in MOVED_BY.values()}


def placed(errors: pd.DataFrame, flights: Sequence[Evidence]) -> pd.DataFrame:
    """End errors of windows with the place of each window's start, as far as its flight knows it."""
    parts = []
    for flight in flights:
        starts = errors.loc[errors["flight"] == flight.key, "start"].unique()
        at = located(places(flight), flight.t, starts)
        parts.append(pd.DataFrame({"flight": flight.key, "start": starts, **at}))
    return errors.merge(pd.concat(parts, ignore_index=True), on=["flight", "start"], how="left")


def where_of(errors: pd.DataFrame) -> pd.DataFrame:
    """As `residual_tables.where`, by line and horizon, along the place where windows begin.

    errors  of `placed`. Norms and absolute values have no sign: the means are of sizes. Diverged windows count with the
    largest finite error of any model.
    """
    models, parts = [m for m in MODELS if m in set(errors["model"])], []
    for (line, horizon), rows in errors.groupby(["driven", "horizon"], sort=False):
        by_model = {m: part.reset_index(drop=True) for m, part in rows.groupby("model")}
        if not all(m in by_model for m in models):
            continue
        table = by_model["before"].drop(columns=[*UNIT_OF]).rename(columns={"start": "t"})
        for model in models:
            errors_of = {q: [by_model[m][q] for m in (model, *models)] for q in UNIT_OF}
            table = table.assign(**{f"{q}_{model}": finite(*own) for q, own in errors_of.items()})
        parts.append(where(table, UNIT_OF, models).assign(driven=line, horizon=horizon))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=["channel", "where"])


def channels_of(
    flight: Flight, starts: np.ndarray, horizons: Sequence[float], errors: Mapping[str, np.ndarray], line: str
) -> pd.DataFrame:
    """Table rollouts_channels of one flight and line: root mean square and whiteness of the end errors, by quantity.

    starts (S,) rows; errors  {"before", "after": (S, K, VECTOR_SIZE)} of `open_loop.vectors`, with their signs
    The whiteness is the correlation of the end errors of windows that follow one another without overlap: 0 where a
    window says nothing of the next, NaN where there are too few.
    """
    columns = VECTORS | {name: slice(COLUMN[c], COLUMN[c] + 1) for c, name in MOVED_BY.items()}
    rows = []
    for k, horizon in enumerate(sorted(horizons)):
        for name, place in columns.items():
            row = {"flight": flight.key, "driven": line, "horizon": float(horizon), "channel": name,
                   "unit": UNIT_OF[name]}  # fmt: skip
            norms = {word: np.linalg.norm(values[:, k, place], axis=1) for word, values in errors.items()}
            for word, values in errors.items():
                own, size = values[:, k, place], finite(norms[word], *norms.values())
                row |= {word: float(np.sqrt(np.mean(size**2))),
                        f"whiteness_{word}": _again(own, flight.t[starts], horizon)}  # fmt: skip
            rows.append(row)
    return pd.DataFrame(rows)


def _again(errors: np.ndarray, t: np.ndarray, horizon: float) -> float:
    """Correlation of errors (S, d) of windows that begin at t (S,), s, with those that begin where these end."""
    known = np.isfinite(errors).all(axis=1)
    errors, t = errors[known], t[known]
    if len(t) < 2:
        return float("nan")
    errors = errors - errors.mean(axis=0)
    # the first window that begins within EVERY of the end of each
    following = np.searchsorted(t, t + horizon - 0.25 * EVERY)
    late = t[np.minimum(following, len(t) - 1)] - t - horizon
    pairs = np.flatnonzero((following < len(t)) & (late < EVERY))
    if len(pairs) < PAIRS:
        return float("nan")
    products = np.einsum("nd,nd->n", errors[pairs], errors[following[pairs]])
    return float(products.mean() / max(np.mean(np.sum(errors**2, axis=1)), 1e-300))
