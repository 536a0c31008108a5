"""Where the windows of level R begin, and where their end errors live."""

from collections.abc import Sequence

import pandas as pd

from quasi.gap.evidence import Evidence
from quasi.gap.places import places
from quasi.gap.residual_tables import located, where
from quasi.gap.rollouts import CHANNELS, QUANTITIES, finite

MODELS = ("before", "after", "noise_floor")
UNITS = QUANTITIES | {name: QUANTITIES[name.split()[0]] for name in CHANNELS.values()}


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
    largest finite error.
    """
    models, parts = [m for m in MODELS if m in set(errors["model"])], []
    for (line, horizon), rows in errors.groupby(["driven", "horizon"], sort=False):
        by_model = {m: part.reset_index(drop=True) for m, part in rows.groupby("model")}
        if not all(m in by_model for m in models):
            continue
        table = by_model["before"].drop(columns=[*UNITS]).rename(columns={"start": "t"})
        for model in models:
            table = table.assign(**{f"{q}_{model}": finite(by_model[model][q]) for q in UNITS})
        parts.append(where(table, UNITS, models).assign(driven=line, horizon=horizon))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=["channel", "where"])
