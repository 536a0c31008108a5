"""Errors of sensors on held-out flights, and what causes of sensors remove of them.

What flights differ by anyway is taken off, before and after alike, but for the named causes' own columns: how much
those differ from flight to flight counts against them. The floor is what remains when everything that the level knows
is fitted to the flight itself. A calibration stays as it is: it was fixed before the held-out flights were looked at.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quasi.gap.catalogue import catalogue
from quasi.gap.flights.level import Flown, by_cause, causes_of, values_of
from quasi.gap.levels.sensors.columns import Weak, corrected_already, in_common, weak_form
from quasi.gap.levels.sensors.identify import NORMAL_SPREAD, SENSOR_CAUSES, TURNED_PAIR, size_of
from quasi.gap.levels.sensors.products import blocks_of, least_squares, whitener_of
from quasi.gap.materiality import Gain, LinearErrors, each_usable, gains_of, without_nuisances

MEAN_OF = {"accelerometer_scale": "accelerometer_bias"}  # {cause: what its mean looks like}


def gains(entries: Sequence[Mapping[str, Any]], flights: Sequence[Flown], corrected: bool = True) -> dict[str, Gain]:
    """What causes of sensors remove, or would remove where import cannot correct them.

    flights  with capture, processed with the calibration or (not corrected) without

    A flight's own bias takes off the mean of a scale, whatever its size: such a cause is judged with the bias left in
    the error as well, and the better of both counts.
    Raises DataError when no flight can be compared with its capture.
    """
    found = each_usable(flights, _known_of)
    usable = [
        k._replace(weak=w, information=_of(k, w.names)) for k, w in zip(found, in_common([k.weak for k in found]))
    ]
    found = _gains(entries, usable, corrected, causes_of(entries))
    for cause, bias in MEAN_OF.items():
        if cause in found:
            other = _gains(entries, usable, corrected, causes_of(entries) | {bias})[cause]
            if _most(other) > _most(found[cause]):
                found[cause] = other
    return found


class _Known(NamedTuple):
    """A flight, its columns, and their whitened cross-products (P, P)."""

    flown: Flown
    weak: Weak
    information: np.ndarray


def _known_of(flown: Flown) -> _Known:
    weak = weak_form(flown)
    return _Known(flown, weak, blocks_of(weak, whitener_of(weak)).sum(axis=0))


def _of(known: _Known, names: Sequence[str]) -> np.ndarray:
    at = [known.weak.names.index(n) for n in names]
    return known.information[np.ix_(at, at)]


def _most(gain: Gain) -> float:
    return float(np.max(gain.removed, where=np.isfinite(gain.removed), initial=-np.inf))


def _gains(
    entries: Sequence[Mapping[str, Any]], flights: Sequence[_Known], corrected: bool, own: set[str]
) -> dict[str, Gain]:
    """Gains with the nuisances of `own` causes left in the errors."""

    def errors(known: _Known) -> tuple[LinearErrors, dict[str, np.ndarray]]:
        weak = known.weak
        columns = weak.columns @ _without_nuisances(known, own)
        position = {n: k for k, n in enumerate(weak.names)}
        sizes = {c: sum(_in_columns(c, e, position) for e in of) for c, of in by_cause(entries).items()}
        values = corrected_already(known.flown, weak.names)
        values[0] = 1.0
        if corrected:  # what import took off is added again; it takes off none but what it can correct
            values = values + sum(v for c, v in sizes.items() if catalogue()[c].corrects)
        floor = weak.columns[:, :, 0] - weak.columns[:, :, 1:] @ least_squares(weak.columns)
        return LinearErrors(columns @ values, floor, columns), sizes

    found = [errors(one) for one in flights]
    return gains_of([e for e, _ in found], found[-1][1])


def _without_nuisances(known: _Known, own: set[str]) -> np.ndarray:
    """(P, P): columns times this have the flight's usual nuisances taken off, all but those of the `own` causes, and of
    what looks like one of them: it would take off the cause."""
    own = own | ({"imu_lever_arm"} if "marker_offset" in own else set())
    own = own | (TURNED_PAIR if own & TURNED_PAIR else set())
    of = [n.split(".")[0] for n in known.weak.names]
    spread = {k: NORMAL_SPREAD[c] for k, c in enumerate(of) if k > 0 and c in NORMAL_SPREAD and c not in own}
    return without_nuisances(known.information, spread)


def _in_columns(cause: str, entry: Mapping[str, Any], position: Mapping[str, int]) -> np.ndarray:
    """Values (P,) of the columns; markers that sit elsewhere look like an IMU that sits the other way."""
    sign = 1.0
    if cause == "marker_offset":
        cause, sign = "imu_lever_arm", -1.0
    values = np.zeros(len(position))
    for label, value in zip(SENSOR_CAUSES[cause].parameters, size_of(cause, values_of(entry))):
        if f"{cause}.{label}" in position:
            values[position[f"{cause}.{label}"]] = sign * value
    return values
