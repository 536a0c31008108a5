"""Level K: faults of sensors, mounting, frames and clocks, from inertial sensors against motion capture alone.

What flights differ in by anybody's doing is nuisance, in every flight with the spread that is usual for it; a cause has
to exceed it. What import corrected on its own (clock rate, a lever arm told by hover) is added to the residual again:
it is evidence for the same causes.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quasi.errors import DataError
from quasi.gap.calibration.kinematic_columns import ANGLES, AXES, Weak, corrected_already, straightened, weak_form
from quasi.gap.calibration.kinematic_products import added, alone, blocks_of, whitener_of
from quasi.gap.calibration.kinematic_tables import tables
from quasi.gap.calibration.sensor_findings import shaken, torn
from quasi.gap.flights.level import (
    Choice,
    Flown,
    Level,
    Tests,
    choose,
    final_test,
    probability,
    resampled,
    separability,
    shares_of,
)
from quasi.gap.statistics.mixed import Columns, Offer
from quasi.gap.statistics.whitening import Whitener
from quasi.importing.calibration import check

# Freedom that the spreads below stand for: they are known from many flights, not told by the few at hand
PRIOR_FREEDOM = 16.0
# Standard deviations of what differs between healthy flights. Biases after turning on, seating of the IMU (0.2 deg) and
# of the markers (0.3 deg), two quartz clocks of 25 ppm each; and how well a good set-up is known at all.
SPREAD = {
    "gyro_bias": 0.012,
    "accelerometer_bias": 0.08,
    "imu_misalignment": float(np.radians(0.2)),
    "mocap_misalignment": float(np.radians(0.3)),
    "clock_drift": 3.5e-5,
    "clock": 0.05,
    "gyro_scale": 5e-4,
    "accelerometer_scale": 5e-4,
    "room_tilt": 5e-4,
    "imu_lever_arm": 1e-3,  # m: a marker set taken off and put on again comes back to about a millimetre
    "mocap_delay": 3e-4,  # s: a filter that no header declares is 0 to 1 ms late, uniform, so 1 ms / sqrt(12)
}
# what healthy set-ups have in all flights alike: sensors' own filters and decimation, which no header states
COMMON = {"mocap_delay": 5e-4}
# sizes below which a cause's columns are as good as exact; larger ones are set right and looked at again
BENT = {"imu_misalignment": 0.01, "mocap_misalignment": 0.01, "room_tilt": 0.02, "gyro_scale": 0.01,
        "accelerometer_scale": 0.01, "mocap_delay": 0.003}  # fmt: skip
LOOKS = 3
MARKERS_KNOWN = 1.5e-3  # m, how well the marker offset is measured: turned markers move the tracked point by less
# where the attitude is one estimated on board: how upright it is, how late, and what it hides along x and y
WITHOUT_TURNING = {"room_tilt": 0.02, "mocap_delay": 0.02, "accelerometer_scale": 0.3}
UNHIDDEN = ("accelerometer_scale.z",)
UNITS = {
    "gyro_bias": "rad/s", "gyro_scale": "1", "accelerometer_bias": "m/s2", "accelerometer_scale": "1",
    "imu_lever_arm": "m", "imu_misalignment": "rad", "mocap_misalignment": "rad", "room_tilt": "rad",
    "mocap_delay": "s", "clock_drift": "s/s", "attitude_error": "s",
}  # fmt: skip
# how far from neutral a parameter can physically be
LARGEST = {
    "gyro_bias": 1.0, "gyro_scale": 0.3, "accelerometer_bias": 5.0, "accelerometer_scale": 0.3, "imu_lever_arm": 0.15,
    "imu_misalignment": 0.5, "mocap_misalignment": 0.5, "room_tilt": 0.3, "mocap_delay": 0.1, "clock_drift": 0.05,
    "attitude_error": 5.0,
}  # fmt: skip
SURE = 2.0  # standard errors beyond that
ONE_SIDED = ("attitude_error",)  # an estimate can only lean after the apparent vertical, not away from it
NEUTRAL = {"gyro_scale": 1.0, "accelerometer_scale": 1.0}
LABELS = dict.fromkeys(UNITS, AXES) | {
    "imu_misalignment": ANGLES, "mocap_misalignment": ANGLES, "room_tilt": ANGLES[:2], "mocap_delay": ("delay",),
    "clock_drift": ("rate",), "attitude_error": ("gain",),
}  # fmt: skip
SHOWS = {
    "gyro_bias": ("p", "q", "r"), "gyro_scale": ("p", "q", "r"), "accelerometer_bias": ("ax", "ay", "az"),
    "accelerometer_scale": ("ax", "ay", "az"), "imu_lever_arm": ("ax", "ay", "az"),
    "imu_misalignment": ("p", "q", "r", "ax", "ay", "az"), "mocap_misalignment": ("p", "q", "r", "ax", "ay", "az"),
    "room_tilt": ("ax", "ay"), "mocap_delay": ("p", "q", "r", "ax", "ay", "az"), "clock_drift": ("clock",),
    "attitude_error": ("ax", "ay"),
}  # fmt: skip
TURNED = frozenset({"imu_misalignment", "mocap_misalignment"})
WITNESS = {TURNED: "imu_lever_arm"}  # turned markers displace the tracked point, a turned IMU does not
BREAKERS = {
    TURNED: "correct either and compare what the model leaves of forces and moments; the smaller residual wins",
    frozenset({"accelerometer_bias", "room_tilt"}): "turn through all headings in hover",
    frozenset({"accelerometer_bias", "accelerometer_scale"}): "climbs and dives with a large range of thrust",
    frozenset({"mocap_misalignment", "accelerometer_bias"}): "turns about all axes",
    frozenset({"imu_misalignment", "accelerometer_bias"}): "turns about all axes",
}
ANY_BREAKER = "sharp turns about all axes, with large changes of thrust and a sweep of the heading"
WITHOUT_ATTITUDE = (
    "gyro_bias", "gyro_scale", "imu_misalignment", "mocap_misalignment", "mocap_delay", "room_tilt",
    "accelerometer_bias",
)  # fmt: skip


def examine(flights: Sequence[Flown], options: Mapping[str, Any]) -> Level:
    """Faults of sensors, mounting, frames and clocks.

    flights  at least one compared one; options  "false alarm rate", family-wise (0.01), "effects" ("all" or ids)
    A flight without capture is left out and named; without any, nothing of this level can be asked.
    """
    level = Level("K")
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
    asked = [c for c in UNITS if options.get("effects", "all") == "all" or c in options["effects"]]
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
        level.cannot_be_asked += [{"id": c, "why": why} for c in asked if c in WITHOUT_ATTITUDE]
        asked = [c for c in asked if c not in WITHOUT_ATTITUDE]
        weak = [w._replace(columns=_only_forces(w.columns), turning=False) for w in weak]
    names = [n for n in weak[0].names if all(n in w.names for w in weak)]
    if "attitude_error" in asked and not any(n.startswith("attitude_error") for n in names):
        why = "not every flight is told by the flight controller's own attitude"
        level.cannot_be_asked.append({"id": "attitude_error", "why": why})
    weak = [w._replace(columns=w.columns[:, :, [w.names.index(n) for n in names]], names=names) for w in weak]
    level.notes.append(
        "a delay of the whole capture is the same as an offset between its clock and the log's and cannot be told; "
        "mocap_delay is that of its rotation against its position"
    )
    alarm = float(options.get("false alarm rate", 0.01))
    while True:
        search = _search(used, weak, asked, turning, alarm)
        impossible = _impossible(search)
        if not impossible:
            break
        asked = [c for c in asked if c not in impossible]
        level.candidates += [
            {"id": cause, "since": "always", "score": 0.0, "p": 1.0, "why_not": why}
            for cause, why in impossible.items()
        ]
    level.tests = search.mixed
    shares = probability(resampled(search.blocks), search.build, search.choice, search.levels)
    _report(level, search.mixed, search.choice, shares, names)
    fitted = {o: final_test(search.mixed, search.choice, o) for o in search.choice.taken}
    usual = SPREAD if turning else SPREAD | WITHOUT_TURNING
    level.tables, level.noise_floor = tables(
        used, search.weak, search.whiteners, search.known, fitted, search.mixed.columns.causes, usual, UNITS
    )
    return level


class Search(NamedTuple):
    """What one search found: the flights as they were last looked at, the tests on them, and the causes taken."""

    weak: list[Weak]
    whiteners: list[Whitener]
    blocks: list[np.ndarray]
    known: list[np.ndarray]
    mixed: Tests
    choice: Choice
    levels: dict[str, float]
    build: Callable[..., Tests]

    @property
    def names(self) -> list[str]:
        """Columns."""
        return self.weak[0].names


def _search(used: Sequence[Flown], weak: Sequence[Weak], asked: Sequence[str], turning: bool, alarm: float) -> Search:
    """Choose causes; where large ones are found, set the flights right and look again."""
    names = weak[0].names
    compared = np.array([f.compared for f in used])
    usual = SPREAD if turning else SPREAD | WITHOUT_TURNING

    def build(grams: list[np.ndarray], lever: float = SPREAD["imu_lever_arm"]) -> Tests:
        return _mixed(grams, compared, names, asked, {**usual, "imu_lever_arm": lever}, turning)

    applied = [np.zeros(len(names)) for _ in used]
    offsets = [0.0 for _ in used]
    late, turn_late = names.index("clock.offset"), names.index("mocap_delay.delay")
    for look in range(LOOKS):
        whiteners = [whitener_of(w) for w in weak]
        known = [corrected_already(f, names) + values for f, values in zip(used, applied)]
        blocks = [added(blocks_of(w, by), values) for w, by, values in zip(weak, whiteners, known)]
        grams = [b.sum(axis=0) for b in blocks]
        mixed = build(grams)
        levels = {since: alarm * part / max(len(asked), 1) for since, part in shares_of(compared).items()}
        doubtful = build(grams, MARKERS_KNOWN * np.sqrt(len(blocks)))
        choice = choose(mixed, levels, witness=WITNESS, doubtful=doubtful)
        wanted = [_bent(mixed, choice, names, flag) for flag in compared]
        if not turning or look == LOOKS - 1 or max(_apart(a, b, names) for a, b in zip(wanted, applied)) < 1.0:
            break
        for k, (gram, target) in enumerate(zip(grams, wanted)):
            own, _ = alone(gram, names)
            # the rotation's place on the log's clock is sharp, whatever part of it is the whole capture's
            offsets[k] += own[late] + own[turn_late] - target[turn_late]
        applied = wanted
        weak = [weak_form(straightened(f, _set_right(values, names), offset))
                for f, values, offset in zip(used, applied, offsets)]  # fmt: skip
        weak = [w._replace(columns=w.columns[:, :, [w.names.index(n) for n in names]], names=names) for w in weak]
    return Search(list(weak), whiteners, blocks, known, mixed, choice, levels, build)


def _impossible(search: Search) -> dict[str, str]:
    """Causes that were taken with values that no sensor has, {cause: why not}: something else is at work."""
    refused = {}
    for offer in search.choice.given:
        for name, p in _parameters(search.names, search.mixed, search.choice, offer).items():
            away = p["value"] - NEUTRAL.get(offer.cause, 0.0)
            if abs(away) - SURE * p["std"] > LARGEST[offer.cause] or (offer.cause in ONE_SIDED and away < 0.0):
                refused[offer.cause] = f"its {name} would be {p['value']:.3g} {p['unit']}, which cannot be"
    return refused


def _bent(mixed: Tests, choice: Choice, names: Sequence[str], flag: bool) -> np.ndarray:
    """(P,) values of the accepted causes whose columns hold for small sizes only, for a compared flight or another."""
    values = np.zeros(len(names))
    for offer in choice.taken:
        if offer.cause in BENT and (flag or offer.since == "always"):
            test = final_test(mixed, choice, offer)
            values[[mixed.columns.causes[offer.cause][k] for k in offer.which]] += test.value
    return values


def _apart(wanted: np.ndarray, applied: np.ndarray, names: Sequence[str]) -> float:
    """Largest difference of two sets of values, in sizes below which columns are as good as exact."""
    return max(abs(a - b) / BENT.get(n.split(".")[0], np.inf) for n, a, b in zip(names, wanted, applied))


def _set_right(values: np.ndarray, names: Sequence[str]) -> dict[str, dict[str, np.ndarray]]:
    """The calibration of fitted values."""
    found = dict(zip(names, values))

    def three(cause: str, labels: Sequence[str]) -> np.ndarray:
        return np.array([found.get(f"{cause}.{label}", 0.0) for label in labels])

    return check(
        {
            "imu": {
                "gyro scale": 1.0 / (1.0 - three("gyro_scale", "xyz")),
                "accelerometer scale": 1.0 / (1.0 - three("accelerometer_scale", "xyz")),
                "misalignment": three("imu_misalignment", ANGLES),
            },
            "capture": {
                "misalignment": three("mocap_misalignment", ANGLES),
                "room tilt": three("room_tilt", ANGLES[:2]),
                "rotation delay": three("mocap_delay", ["delay"]),
            },
        }
    )


def _only_forces(columns: np.ndarray) -> np.ndarray:
    kept = columns.copy()
    kept[:, :3] = 0.0
    return kept


def _mixed(
    grams: Sequence[np.ndarray],
    compared: np.ndarray,
    names: Sequence[str],
    asked: Sequence[str],
    usual: Mapping[str, float],
    turning: bool,
) -> Tests:
    """Tests on the cross-products: nuisances in every flight, causes beside them."""
    causes: dict[str, list[int]] = {}
    nuisance, spread = [], []
    for i, name in enumerate(names[1:], 1):
        cause = name.split(".")[0]
        if cause in asked and (turning or cause != "accelerometer_scale" or name in UNHIDDEN):
            causes.setdefault(cause, []).append(i)
        if cause in usual:
            nuisance.append(i)
            # the least spread between flights that a test allows for is as large again as a flight's own doubt
            size = SPREAD[cause] if name in UNHIDDEN else usual[cause]
            spread.append(size / (np.sqrt(2.0) if cause in causes else 1.0))
    place = list(range(len(names))) + nuisance
    columns = Columns([], list(range(len(names), len(place))), np.array(spread), causes)
    return Tests([g[np.ix_(place, place)] for g in grams], compared, columns, PRIOR_FREEDOM, common=COMMON)


def _true(cause: str, value: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameters as they are stated; a scale was found as what to take off the measurement: true = (1 - x) measured."""
    if cause not in NEUTRAL:
        return value, std
    return 1.0 / (1.0 - value), std / (1.0 - value) ** 2


def size_of(cause: str, values: Mapping[str, float]) -> np.ndarray:
    """Deviation from healthy (m,) of parameters as they are stated, in the units of the cause's columns."""
    neutral = NEUTRAL.get(cause, 0.0)
    stated = np.array([values.get(label, neutral) for label in LABELS[cause]])
    return 1.0 - 1.0 / stated if neutral else stated


def _parameters(names: Sequence[str], mixed: Tests, choice: Choice, offer: Offer) -> dict[str, dict[str, Any]]:
    cause = offer.cause
    test = final_test(mixed, choice, offer)
    value, std = _true(cause, test.value, test.std)
    labels = [names[i].split(".")[1] for i in mixed.columns.causes[cause]]
    return {
        label: {"value": float(v), "std": float(s), "unit": UNITS[cause]} for label, v, s in zip(labels, value, std)
    }


def _report(level: Level, mixed: Tests, choice: Choice, shares: Mapping[Offer, float], names: Sequence[str]) -> None:
    for offer in choice.taken:
        tie = choice.tied[offer]
        test = final_test(mixed, choice, offer)
        if len(tie) > 1:
            pair = frozenset(o.cause for o in tie)
            alike = pair == TURNED
            level.ties.append(
                {
                    "ids": [o.cause for o in tie],
                    "since": offer.since,
                    "separability": 0.0 if alike else separability(mixed, choice, offer, tie[1]),
                    "tie_breaker": BREAKERS.get(pair, ANY_BREAKER),
                    "parameters": {o.cause: _parameters(names, mixed, choice, o) for o in tie},
                    "p": test.p,
                    "wald": test.wald,
                    "probability": shares[offer],
                }
            )
            continue
        level.effects.append(
            {
                "id": offer.cause,
                "since": offer.since,
                "probability": shares[offer],
                "channels": list(SHOWS[offer.cause]),
                "parameters": _parameters(names, mixed, choice, offer),
                "evidence": {"p": test.p, "wald": test.wald, "between flights": test.tau},
            }
        )
    level.effects.sort(key=lambda e: -e["evidence"]["wald"])
    for offer, why in choice.why_not.items():
        level.candidates.append(
            {"id": offer.cause, "since": offer.since, "score": choice.marginal[offer].wald,
             "p": choice.marginal[offer].p, "why_not": why}
        )  # fmt: skip
