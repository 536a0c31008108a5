"""Tables of the wrench level: residuals row by row with where they were found, per channel, per place, and spectra."""

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd

from quasi.gap.flights.covariates import places
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.residual_tables import SEGMENT, where, whiteness
from quasi.gap.levels.forces.design import BAND
from quasi.gap.statistics.whitening import stretches
from quasi.model.model import AXES

WRENCH_UNITS = {axis: "N" if axis[0] == "F" else "N m" for axis in AXES}


def wrench_tables(
    evidence: Mapping[str, Evidence], roles: Mapping[str, str], left: Callable[[Evidence], np.ndarray]
) -> dict[str, pd.DataFrame]:
    """forces_residuals, forces_channels, forces_where, forces_spectra; none without any flight.

    left  flight -> (n, 6) residual of the extended model; of a reference flight without what only changed
    """
    rows, channels, spectra = [], [], {}
    if not evidence:
        return {}
    for key, flight in evidence.items():
        series = {"before": flight.residual, "after": left(flight)}
        memory = whiteness(series, flight.t, flight.breaks)
        found = {name.replace(" ", "_"): values for name, values in places(flight).items() if name != "time"}
        table = {"t": flight.t, "flight": key, "role": roles[key], **found}
        for k, axis in enumerate(AXES):
            table[f"{axis}_measured"] = flight.measured[:, k]
            for word, values in series.items():
                table[f"{axis}_{word}"] = values[:, k]
            channels.append(
                {"flight": key, "role": roles[key], "channel": axis, "unit": WRENCH_UNITS[axis],
                 **{w: float(np.sqrt(np.mean(v[:, k] ** 2))) for w, v in series.items()},
                 **memory[k]}
            )  # fmt: skip
        rows.append(pd.DataFrame(table))
        for word, values in series.items():
            _spectrum(flight, values, spectra.setdefault((roles[key], word), []))
    whole = pd.concat(rows, ignore_index=True)
    return {
        "forces_residuals": whole,
        "forces_channels": pd.DataFrame(channels),
        # what reference flights show as well does not hide where compared and held-out ones differ
        "forces_where": where(whole[whole["role"] != "reference"], WRENCH_UNITS, ("before", "after")),
        "forces_spectra": _merged(spectra),
    }


def _spectrum(flight: Evidence, values: np.ndarray, found: list[tuple[np.ndarray, np.ndarray, int]]) -> None:
    rate = 1.0 / float(np.median(np.diff(flight.t)))
    length = round(SEGMENT * rate)
    window = np.hanning(length)[:, None]
    for part in stretches(flight.breaks):
        for begin in range(part.start, part.stop - length + 1, length // 2):
            piece = values[begin : begin + length]
            power = np.abs(np.fft.rfft((piece - piece.mean(axis=0)) * window, axis=0)) ** 2
            density = 2.0 * power / (rate * float((window**2).sum()))
            found.append((np.fft.rfftfreq(length, 1.0 / rate), density, 1))


def _merged(spectra: Mapping[tuple[str, str], list]) -> pd.DataFrame:
    rows = []
    for role in dict.fromkeys(r for r, _ in spectra):
        before, after = spectra.get((role, "before"), []), spectra.get((role, "after"), [])
        if not before:
            continue  # no stretch is long enough
        # segments are alike in seconds, so that flights of several rates share their lowest frequencies
        common = min(len(f) for f, *_ in before)
        frequency = before[0][0][:common]
        means = {
            "before": np.mean([d[:common] for _, d, _ in before], axis=0),
            "after": np.mean([d[:common] for _, d, _ in after], axis=0),
        }
        for k, axis in enumerate(AXES):
            rows.append(
                pd.DataFrame({"frequency": frequency, "role": role, "channel": axis,
                              **{f"{axis}_density_{w}"[len(axis) + 1 :]: m[:, k] for w, m in means.items()}})
            )  # fmt: skip
    if not rows:
        return pd.DataFrame({"frequency": [], "role": [], "channel": [], "density_before": [], "density_after": []})
    whole = pd.concat(rows, ignore_index=True)
    return whole[whole["frequency"] <= 2.0 * BAND].reset_index(drop=True)
