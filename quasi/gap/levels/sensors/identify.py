"""Faults of sensors, mounting, frames and clocks, from inertial sensors against motion capture alone.

What flights differ in anyway is nuisance, in every flight with the spread that is usual for it (`Sensor` in each
cause's file); a cause has to exceed it. What import corrected on its own (clock rate, a lever arm found in hover) is
added to the residual again: it is evidence for the same causes.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from quasi.errors import DataError
from quasi.gap.catalogue import catalogue
from quasi.gap.effect import Effect, Limits
from quasi.gap.flights.level import PRIOR_FREEDOM, Flown, Level, SensorMixedModel
from quasi.gap.levels.selected import report_selection
from quasi.gap.levels.sensors.columns import Weak, corrected_already, in_common, straightened, weak_form
from quasi.gap.levels.sensors.findings import errors_beyond_references, shaken, torn
from quasi.gap.levels.sensors.products import added, alone, blocks_of, dispersion, spread_of_slopes, whitener_of
from quasi.gap.levels.sensors.tables import tables
from quasi.gap.profile import Profile
from quasi.gap.selection import Rules, Selection, select_causes
from quasi.gap.statistics.candidates import Candidate, Columns, Test
from quasi.gap.statistics.whitening import Whitener
from quasi.importing.calibration import check

SENSOR_CAUSES: dict[str, Effect] = {n: e for n, e in catalogue().items() if e.sensor is not None}
CLOCK_OFFSET = 0.05  # s, between healthy flights
# standard deviations of what differs between healthy flights, in the units of the columns
NORMAL_SPREAD = {n: s for n, e in SENSOR_CAUSES.items() if (s := e.sensor.spread) is not None} | {"clock": CLOCK_OFFSET}
NORMAL_SPREAD["filters"] = NORMAL_SPREAD["mocap_delay"]  # undeclared filters, of the accelerometer as of all else
UNCAPTURED = {n: s for n, e in SENSOR_CAUSES.items() if (s := e.sensor.without_attitude) is not None}
COMMON = {n: e.sensor.common for n, e in SENSOR_CAUSES.items() if e.sensor.common}
LINEAR_RANGE = {n: e.sensor.linear for n, e in SENSOR_CAUSES.items() if e.sensor.linear is not None}
LINEARISED = 3
GYRO_CHANNELS, FORCE_CHANNELS = slice(0, 3), slice(3, 6)  # of the channels
MARKERS_KNOWN = 1.5e-3  # m, how well the marker offset is measured: turned markers move the tracked point by less
UNHIDDEN = ("accelerometer_scale.z",)  # what an attitude estimated on board does not hide
TURNED_PAIR = frozenset({"imu_misalignment", "mocap_misalignment"})
WITNESS = {TURNED_PAIR: "imu_lever_arm"}  # turned markers displace the tracked point, a turned IMU does not
SENSOR_TIE_BREAKERS = {
    TURNED_PAIR: "correct either and compare what the model leaves of forces and moments; the smaller residual wins",
}


def examine(flights: Sequence[Flown], options: Mapping[str, Any]) -> Level:
    """Faults of sensors, mounting, frames and clocks.

    flights  at least one compared one; options  "false alarm rate", family-wise (0.01), "effects" ("all" or ids),
              "sessions" {flight: session}, {} where they are not known
    A flight without capture is left out and named; without any, nothing of this level can be asked.
    """
    level = Level("sensors")
    for flown in flights:
        level.findings += torn(flown)
    level.findings += shaken(flights)
    weak: list[Weak] = []
    used: list[Flown] = []
    for flown in flights:
        try:
            weak.append(weak_form(flown))
            used.append(flown)
        except DataError as error:
            level.notes.append(f"{error}; it is left out of the comparison of sensors with capture")
    turning = bool(weak) and all(w.turning for w in weak)
    if not turning:  # forces alone are compared then
        level.notes += [
            f"flight {w.key} has no accelerometer of its own; it is left out of the comparison of sensors with capture"
            for w in weak if not w.feeling
        ]  # fmt: skip
        used = [f for f, w in zip(used, weak) if w.feeling]
        weak = [w for w in weak if w.feeling]
    asked = [c for c in SENSOR_CAUSES if options.get("effects", "all") == "all" or c in options["effects"]]
    if not any(f.compared for f in used):
        why = "no compared flight has a motion capture of enough flying"
        level.cannot_be_asked = [{"id": c, "why": why} for c in asked]
        return level
    if turning:
        if "attitude_error" in asked:
            why = "the attitude is captured: that of the flight controller plays no part"
            level.cannot_be_asked.append({"id": "attitude_error", "why": why})
        asked = [c for c in asked if c != "attitude_error"]
    else:
        why = "the attitude is not captured in every flight (or 'use onboard attitude' is on)"
        level.cannot_be_asked += [{"id": c, "why": why} for c in asked if SENSOR_CAUSES[c].sensor.needs_attitude]
        asked = [c for c in asked if not SENSOR_CAUSES[c].sensor.needs_attitude]
        weak = [w._replace(columns=_only(w.columns, FORCE_CHANNELS), turning=False) for w in weak]
    if not all(w.feeling for w in weak):
        asked = _ask_of_rates(weak, asked, level)
        level.notes.append(
            "not every flight has an accelerometer of its own: where forces are made of the capture, a late or turned "
            "capture looks like a force"
        )
        weak = [w._replace(columns=_only(w.columns, GYRO_CHANNELS), feeling=False) for w in weak]
    weak = in_common(weak)
    names = weak[0].names
    if "attitude_error" in asked and not any(n.startswith("attitude_error") for n in names):
        why = "not every flight has the flight controller's own attitude"
        level.cannot_be_asked.append({"id": "attitude_error", "why": why})
    level.notes.append(
        "a delay of the whole capture is the same as an offset between its clock and the log's and is not reported; "
        "mocap_delay is that of its rotation against its position"
    )
    alarm = float(options.get("false alarm rate", 0.01))
    sessions = [(options.get("sessions") or {}).get(f.key, "") for f in used]
    search = _search(used, weak, asked, turning, alarm, sessions)
    level.tests = search.mixed
    shares = search.selection.reproducibility(_resampled(search.blocks), search.build)

    def parameters(offer: Candidate) -> dict[str, dict[str, Any]]:
        return _parameters(names, search, offer)

    report_selection(level, search.selection, search.mixed, shares, SENSOR_CAUSES, parameters, SENSOR_TIE_BREAKERS)
    fitted = {o: search.test(o) for o in search.selection.offers}
    usual = NORMAL_SPREAD if turning else NORMAL_SPREAD | UNCAPTURED
    units = {n: next(iter(e.parameters.values())).unit for n, e in SENSOR_CAUSES.items()}
    level.tables, level.noise_floor = tables(
        used, search.weak, search.whiteners, search.known, fitted, search.mixed.columns, usual, units
    )
    channels = level.tables["channels"].drop_duplicates("channel").set_index("channel")["unit"]
    level.findings += errors_beyond_references(used, level.tables["residuals"], dict(channels), alarm)
    return level


class Search(NamedTuple):
    """What one search found: the flights as they were last looked at, the tests on them, and the selected causes."""

    weak: list[Weak]
    whiteners: list[Whitener]
    blocks: list[np.ndarray]
    known: list[np.ndarray]
    mixed: SensorMixedModel
    selection: Selection
    build: Callable[..., SensorMixedModel]

    def test(self, offer: Candidate) -> Test:
        """A selected cause with all others given."""
        return self.selection.test(self.mixed, offer)


def _search(
    used: Sequence[Flown], weak: Sequence[Weak], asked: Sequence[str], turning: bool, alarm: float,
    sessions: Sequence[str],
) -> Search:  # fmt: skip
    """Choose causes; where large ones are found, set the flights right and look again."""
    names = weak[0].names
    compared = np.array([f.compared for f in used])
    usual = NORMAL_SPREAD if turning else NORMAL_SPREAD | UNCAPTURED
    profiles = {n: _profile(SENSOR_CAUSES[n]) for n in asked}

    def build(
        grams: list[np.ndarray], slopes: Mapping[str, float], dispersed: Mapping[str, float],
        lever: float = NORMAL_SPREAD["imu_lever_arm"],
    ) -> SensorMixedModel:  # fmt: skip
        spreads = {**usual, **slopes, "imu_lever_arm": lever}
        return _mixed(grams, compared, names, asked, spreads, turning, sessions, dispersed)

    applied = [np.zeros(len(names)) for _ in used]
    offsets = [0.0 for _ in used]
    late, turn_late = names.index("clock.offset"), names.index("mocap_delay.delay")
    for look in range(LINEARISED):
        whiteners = [whitener_of(w) for w in weak]
        known = [corrected_already(f, names) + values for f, values in zip(used, applied)]
        blocks = [added(blocks_of(w, by), values) for w, by, values in zip(weak, whiteners, known)]
        grams = [b.sum(axis=0) for b in blocks]
        slopes = spread_of_slopes(grams, names, compared, alarm) if turning and weak[0].feeling else {}
        dispersed = dispersion(blocks, names, alarm)
        mixed = build(grams, slopes, dispersed)
        rules = Rules(0.0, WITNESS, build(grams, slopes, dispersed, MARKERS_KNOWN * np.sqrt(len(blocks))))
        selection = select_causes(mixed, profiles, alarm, rules)
        wanted = [_nonlinear_values(mixed, selection, names, flag) for flag in compared]
        if not turning or look == LINEARISED - 1 or max(_apart(a, b, names) for a, b in zip(wanted, applied)) < 1.0:
            break
        for k, (gram, target) in enumerate(zip(grams, wanted)):
            own, _ = alone(gram, names)
            # the rotation's place on the log's clock is sharp, whatever part of it is the whole capture's
            offsets[k] += own[late] + own[turn_late] - target[turn_late]
        applied = wanted
        weak = [weak_form(straightened(f, _set_right(values, names), offset))
                for f, values, offset in zip(used, applied, offsets)]  # fmt: skip
        weak = [w._replace(columns=w.columns[:, :, [w.names.index(n) for n in names]], names=names) for w in weak]
    return Search(
        list(weak), whiteners, blocks, known, mixed, selection, partial(build, slopes=slopes, dispersed=dispersed)
    )


def _profile(effect: Effect) -> Profile:
    """What the selection knows of a cause, its physical range in the units of its columns."""
    low, high = ({n: getattr(p, end) for n, p in effect.parameters.items()} for end in ("low", "high"))
    ranges = list(zip(size_of(effect.id, low), size_of(effect.id, high)))
    limits = Limits(ranges + ranges[:1] * (effect.parts == "alike"))
    return Profile(effect.parts, effect.rivals, effect.always_tied_with, limits=limits)


def _resampled(blocks: Sequence[np.ndarray]) -> Callable[[np.random.Generator], list[np.ndarray]]:
    """Draws of flights whose cross-products are sums over blocks (B, P, P)."""
    return lambda rng: [b[rng.integers(0, len(b), len(b))].sum(axis=0) for b in blocks]


def _nonlinear_values(mixed: SensorMixedModel, selection: Selection, names: Sequence[str], flag: bool) -> np.ndarray:
    """(P,) values of the selected causes whose columns hold for small sizes only, for a compared flight or another."""
    values = np.zeros(len(names))
    for offer in selection.offers:
        if offer.cause in LINEAR_RANGE and (flag or offer.since == "always"):
            columns, found, _ = mixed.columns.parameters(selection.test(mixed, offer))
            values[columns] += found
    return values


def _apart(wanted: np.ndarray, applied: np.ndarray, names: Sequence[str]) -> float:
    """Largest difference of two sets of values, in sizes below which columns are as good as exact."""
    return max(abs(a - b) / LINEAR_RANGE.get(n.split(".")[0], np.inf) for n, a, b in zip(names, wanted, applied))


def _set_right(values: np.ndarray, names: Sequence[str]) -> dict[str, dict[str, np.ndarray]]:
    """The calibration of fitted values."""
    found = dict(zip(names, values))
    parts: dict[str, dict[str, np.ndarray]] = {}
    for cause in LINEAR_RANGE:
        effect = SENSOR_CAUSES[cause]
        part, quantity = effect.corrects
        size = np.array([found.get(f"{cause}.{label}", 0.0) for label in effect.parameters])
        parts.setdefault(part, {})[quantity] = _stated(cause, size, size)[0]
    return check(parts)


def _only(columns: np.ndarray, channels: slice) -> np.ndarray:
    kept = np.zeros_like(columns)
    kept[:, channels] = columns[:, channels]
    return kept


def _ask_of_rates(weak: Sequence[Weak], asked: Sequence[str], level: Level) -> list[str]:
    """The causes that rates alone show; the others are entered as those that cannot be asked."""
    kept = []
    for cause in asked:
        own = [w.columns[:, GYRO_CHANNELS, k] for w in weak for k, n in enumerate(w.names) if n.split(".")[0] == cause]
        clocks = [w.columns[:, GYRO_CHANNELS, w.names.index("clock.offset")] for w in weak]
        why = "not every flight has an accelerometer of its own, and rates do not show it"
        if any(c.any() for c in own) and not all(np.array_equal(a, b) for a, b in zip(own, clocks)):
            kept.append(cause)
        else:
            level.cannot_be_asked.append({"id": cause, "why": why})
    return kept


def _mixed(
    grams: Sequence[np.ndarray],
    compared: np.ndarray,
    names: Sequence[str],
    asked: Sequence[str],
    usual: Mapping[str, float],
    turning: bool,
    sessions: Sequence[str],
    dispersed: Mapping[str, float],
) -> SensorMixedModel:
    """Tests on the cross-products: nuisances in every flight, and causes."""
    causes, nuisance, spread = layout(names, asked, usual, turning)
    place = list(range(len(names))) + nuisance
    columns = Columns([], list(range(len(names), len(place))), np.array(spread), causes)
    turn = np.eye(len(place))
    alike = [n for n, own in causes.items() if SENSOR_CAUSES[n].parts == "alike" and len(own) > 1]
    columns = columns._replace(alike={n: (len(place) + k,) for k, n in enumerate(alike)})
    turn = np.column_stack([turn, *(turn[:, causes[n]].sum(axis=1) for n in alike)])
    used = [turn.T @ g[np.ix_(place, place)] @ turn for g in grams]
    return SensorMixedModel(
        used, compared, columns, PRIOR_FREEDOM, common=COMMON, sessions=sessions, dispersed=dispersed
    )


def layout(
    names: Sequence[str], asked: Collection[str], usual: Mapping[str, float], turning: bool = True
) -> tuple[dict[str, list[int]], list[int], list[float]]:
    """Columns of the causes, columns of the nuisances and their spreads, of columns that are called `names`."""
    causes: dict[str, list[int]] = {}
    nuisance, spread = [], []
    for i, name in enumerate(names[1:], 1):
        cause = name.split(".")[0]
        if cause in asked and (turning or cause != "accelerometer_scale" or name in UNHIDDEN):
            causes.setdefault(cause, []).append(i)
        if cause in usual:
            nuisance.append(i)
            # the least spread between flights that a test allows for is as large again as a flight's own doubt
            size = NORMAL_SPREAD[cause] if name in UNHIDDEN else usual[cause]
            spread.append(size / (np.sqrt(2.0) if cause in causes else 1.0))
    return causes, nuisance, spread


def _neutral(cause: str) -> float:
    return next(iter(SENSOR_CAUSES[cause].parameters.values())).neutral


def _stated(cause: str, value: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameters as they are stated; a scale was found as what to take off the measurement: true = (1 - x) measured."""
    if not _neutral(cause):
        return value, std
    return 1.0 / (1.0 - value), std / (1.0 - value) ** 2


def size_of(cause: str, values: Mapping[str, float]) -> np.ndarray:
    """Deviation from healthy (m,) of parameters as they are stated, in the units of the cause's columns."""
    neutral = _neutral(cause)
    stated = np.array([values.get(label, neutral) for label in SENSOR_CAUSES[cause].parameters])
    return 1.0 - 1.0 / stated if neutral else stated


def _parameters(names: Sequence[str], search: Search, offer: Candidate) -> dict[str, dict[str, Any]]:
    columns, value, std = search.mixed.columns.parameters(search.test(offer))
    value, std = _stated(offer.cause, value, std)
    labels = [names[i].split(".")[1] for i in columns]
    units = {n: p.unit for n, p in SENSOR_CAUSES[offer.cause].parameters.items()}
    return {n: {"value": float(v), "std": float(s), "unit": units[n]} for n, v, s in zip(labels, value, std)}
