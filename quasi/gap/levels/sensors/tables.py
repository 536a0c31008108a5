"""Tables of the kinematic level for the report: residuals before and after, the floor, each flight's own values."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from quasi.gap.flights.level import Flown
from quasi.gap.flights.residual_tables import Residuals, level_tables
from quasi.gap.levels.sensors.columns import SENSED_CHANNELS, Weak
from quasi.gap.levels.sensors.products import added, alone, blocks_of, least_squares
from quasi.gap.statistics.candidates import Candidate, Columns, Test
from quasi.gap.statistics.whitening import Whitener


def tables(
    flights: Sequence[Flown], weak: Sequence[Weak], whiteners: Sequence[Whitener], known: Sequence[np.ndarray],
    fitted: Mapping[Candidate, Test], of: Columns, usual: Mapping[str, float],
    parameter_units: Mapping[str, str],
) -> tuple[dict[str, pd.DataFrame], dict[str, float]]:  # fmt: skip
    """Tables of the level, see `level_tables`, and its noise floor.

    known   (P,) per flight: values of the columns that were taken off before, and are added again here
    fitted  causes taken; of  their columns; usual  {cause: spread} of nuisances
    In "residuals" and "channels" usual nuisances are taken off throughout: before the causes, after them, and at the
    floor, where everything is fitted that the level knows. "parameters" are each flight's own best values.
    """
    names = weak[0].names
    place = {n: i for i, n in enumerate(names)}
    nuisance = [i for i, n in enumerate(names) if i > 0 and n.split(".")[0] in usual]
    weight = np.diag([1.0 / usual[names[i].split(".")[0]] ** 2 for i in nuisance])
    shown = [c for c in range(len(SENSED_CHANNELS)) if all(w.turning if c < 3 else w.feeling for w in weak)]
    residuals, parameters = [], []
    for flown, one, whitener, values in zip(flights, weak, whiteners, known):
        gram = added(blocks_of(one, whitener).sum(axis=0), values)
        columns = one.columns.copy()
        columns[:, :, 0] += one.columns @ values
        healthy = np.zeros(len(names))
        healthy[0] = 1.0
        corrected = healthy.copy()
        for offer, test in fitted.items():
            if offer.since == "always" or flown.compared:
                own, found, _ = of.parameters(test)
                corrected[own] -= found
        series = {}
        for word, taken in (("before", healthy), ("after", corrected)):
            usually = np.linalg.solve(gram[np.ix_(nuisance, nuisance)] + weight, gram[nuisance] @ taken)
            series[word] = columns @ taken - columns[:, :, nuisance] @ usually
        series["floor"] = one.columns[:, :, 0] - one.columns[:, :, 1:] @ least_squares(one.columns)
        residuals.append(Residuals({word: v[:, shown] for word, v in series.items()}, one.t, one.breaks))
        own, std = alone(gram, names)
        parameters += [
            {"flight": flown.key, "compared": flown.compared, "id": n.split(".")[0], "parameter": n.split(".")[1],
             "value": own[i], "std": std[i], "unit": parameter_units.get(n.split(".")[0], "s")}
            for n, i in place.items()
            if std[i] > 0 and gram[i, i] > 0
        ]  # fmt: skip
    units = {SENSED_CHANNELS[c]: "rad/s" if c < 3 else "m/s2" for c in shown}
    return level_tables(flights, residuals, units, pd.DataFrame(parameters))
