"""Errors of rotor speeds on held-out flights, and what causes of the drive remove of them, as for sensors."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quasi.gap.flights.level import Flown, by_cause, causes_of, values_of
from quasi.gap.levels.drive.fit import CONSTANTS, Belief, DriveFit, fit_drive
from quasi.gap.levels.drive.identify import DRIVE_CAUSES, LATE, lag_columns, usual_spreads, whole
from quasi.gap.materiality import Gain, LinearErrors, each_usable, gains_of, without_nuisances
from quasi.model.columns import ROTORS
from quasi.terms.rotor_map import ROTOR_NUMBERS


def gains(
    entries: Sequence[Mapping[str, Any]], flights: Sequence[Flown], healthy: Mapping[str, Any]
) -> dict[str, Gain]:
    """What causes of the drive remove. flights  before any calibration; healthy  what `identify.examine` compared with.

    Raises DataError when no flight has commands and rotor speeds enough.
    """
    reference, kind = Belief(np.array(healthy["values"], float), healthy["voltage"]), healthy["learned"]["kind"]
    of_rotors = any(f"rotor{i}" in values_of(e) for e in entries for i in ROTOR_NUMBERS)

    def errors(flown: Flown) -> LinearErrors:
        whole_band = fit_drive(flown, kind, reference, of_rotors)
        fit = whole_band.in_band()
        slopes = fit.slopes @ _without_nuisances(whole_band, reference, kind, causes_of(entries))
        return LinearErrors(fit.residual + slopes @ (whole(flown, fit) - reference.values), fit.residual, slopes)

    sizes = {cause: _deviations(cause, of, reference.values) for cause, of in by_cause(entries).items()}
    return gains_of(each_usable(flights, errors), sizes)


def rms_errors(
    entries: Sequence[Mapping[str, Any]], flights: Sequence[Flown], healthy: Mapping[str, Any]
) -> dict[str, dict[str, float]]:
    """Root mean squares, rad/s, of measured minus modelled speeds: {"before", "after", "noise_floor": {rotor: rms}}.

    before  against what the compared flights were compared with; after  with the causes taken off; arguments as for
    `gains`. A model that does not state at which voltage its map holds has no other standard: flights that are held
    out must not become their own.
    Raises DataError when no flight has commands and rotor speeds enough.
    """
    reference, kind = Belief(np.array(healthy["values"], float), healthy["voltage"]), healthy["learned"]["kind"]
    of_rotors = any(f"rotor{i}" in values_of(e) for e in entries for i in ROTOR_NUMBERS)
    sizes = sum((_deviations(c, of, reference.values) for c, of in by_cause(entries).items()), np.zeros(len(CONSTANTS)))

    def errors(flown: Flown) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        whole_band = fit_drive(flown, kind, reference, of_rotors)
        fit = whole_band.in_band()
        away = whole(flown, whole_band) - reference.values
        return fit.residual + fit.slopes @ away, fit.residual + fit.slopes @ (away - sizes), fit.residual

    parts = zip(*each_usable(flights, errors))
    before, after, floor = (np.sqrt(np.mean(np.concatenate(part) ** 2, axis=0)) for part in parts)
    found = {"before": before, "after": after, "noise_floor": np.minimum(floor, after)}
    return {word: dict(zip(ROTORS, rms.tolist())) for word, rms in found.items()}


def _without_nuisances(fit: DriveFit, reference: Belief, kind: str, own: set[str]) -> np.ndarray:
    """(15, 15): columns times this have the flight's usual nuisances taken off, all but those of the `own` causes."""
    named = {n for c in own for n in DRIVE_CAUSES.get(c, ())} | ({"delay"} if own & LATE else set())
    usual = usual_spreads(reference.values, 1.0 / fit.rate, kind)
    spread = {k: usual[n] for k, n in enumerate(CONSTANTS) if n in usual and n not in named}
    return without_nuisances(np.linalg.inv(fit.covariance()), spread)


def _deviations(cause: str, entries: Sequence[Mapping[str, Any]], healthy: np.ndarray) -> np.ndarray:
    """Values (15,) of the drive's constants, as deviations from healthy ones; what was always there and what changed
    add up. Time constants and exponents are stated as totals."""
    size = np.zeros(len(CONSTANTS))
    if cause == "motor_lag":
        factors = [np.prod([values_of(e).get(f"rotor{i}", 1.0) for e in entries]) for i in ROTOR_NUMBERS]
        size += lag_columns(healthy) @ np.log(factors)
        common = next((e for e in entries if "time_constant" in values_of(e)), None)
        if common is not None:  # a slower rotor is in the mean already
            size[:2] = [common["evidence"][n] - healthy[k] for k, n in enumerate(("up", "down"))]
    elif cause == "battery_sag":
        size[6] = values_of(entries[0])["exponent"] - healthy[6]
    else:
        size[2] = sum(values_of(e)["delay"] for e in entries)
    return size
