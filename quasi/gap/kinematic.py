"""Level K: faults of sensors, mounting, frames and clocks, from inertial sensors against motion capture alone.

What flights differ in by anybody's doing is nuisance, in every flight with the spread that is usual for it; a cause has
to exceed it. What import corrected on its own (clock rate, a lever arm told by hover) is added to the residual again:
it is evidence for the same causes.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.gap.kinematic_columns import ANGLES, CHANNELS, RATE, Weak, corrected_already, straightened, weak_form
from quasi.gap.level import Choice, Flown, Level, Tests, choose, final_test, probability, separability
from quasi.gap.mixed import Columns, Offer
from quasi.gap.sensor_findings import shaken, torn
from quasi.gap.whitening import Whitener, autoregression, block_grams, whiten
from quasi.importing.calibration import check

ORDER = 8  # of the autoregression: what correlates over 0.4 s
BLOCK = 5.0  # s
RIDGE = 1e-9
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
    "imu_lever_arm": 3e-4,
    "mocap_delay": 1e-4,
}
# sizes below which a cause's columns are as good as exact; larger ones are set right and looked at again
BENT = {"imu_misalignment": 0.01, "mocap_misalignment": 0.01, "room_tilt": 0.02, "gyro_scale": 0.01,
        "accelerometer_scale": 0.01, "mocap_delay": 0.003}  # fmt: skip
LOOKS = 3
MARKERS_KNOWN = 1.5e-3  # m, how well the marker offset is measured: turned markers move the tracked point by less
LEVELLED = 0.02  # rad, how upright an attitude estimated on board is taken to be
UNITS = {
    "gyro_bias": "rad/s", "gyro_scale": "1", "accelerometer_bias": "m/s2", "accelerometer_scale": "1",
    "imu_lever_arm": "m", "imu_misalignment": "rad", "mocap_misalignment": "rad", "room_tilt": "rad",
    "mocap_delay": "s", "clock_drift": "s/s", "attitude_error": "s",
}  # fmt: skip
NEUTRAL = {"gyro_scale": 1.0, "accelerometer_scale": 1.0}
SHOWS = {
    "gyro_bias": ("p", "q", "r"), "gyro_scale": ("p", "q", "r"), "accelerometer_bias": ("ax", "ay", "az"),
    "accelerometer_scale": ("ax", "ay", "az"), "imu_lever_arm": ("ax", "ay", "az"),
    "imu_misalignment": ("p", "q", "r", "ax", "ay", "az"), "mocap_misalignment": ("p", "q", "r", "ax", "ay", "az"),
    "room_tilt": ("ax", "ay"), "mocap_delay": ("p", "q", "r", "ax", "ay", "az"), "clock_drift": ("clock",),
    "attitude_error": ("ax", "ay"),
}  # fmt: skip
TURNED = frozenset({"imu_misalignment", "mocap_misalignment"})
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
        asked = [c for c in asked if c != "attitude_error"]
    else:
        why = "the attitude is not captured in every flight (or 'use onboard attitude' is on)"
        level.cannot_be_asked += [{"id": c, "why": why} for c in asked if c in WITHOUT_ATTITUDE]
        asked = [c for c in asked if c not in WITHOUT_ATTITUDE]
        weak = [w._replace(columns=_only_forces(w.columns), turning=False) for w in weak]
    names = [n for n in weak[0].names if all(n in w.names for w in weak)]
    weak = [w._replace(columns=w.columns[:, :, [w.names.index(n) for n in names]], names=names) for w in weak]
    level.cannot_be_asked.append(
        {"id": "mocap_delay", "why": "a delay of the whole capture is the same as an offset between its clock and the "
                                     "log's; only its rotation against its position is asked"}
    )  # fmt: skip

    compared = np.array([f.compared for f in used])
    stages = 1 if compared.all() else 2

    def build(grams: list[np.ndarray], lever: float = SPREAD["imu_lever_arm"]) -> Tests:
        return _mixed(grams, compared, names, asked, {**SPREAD, "imu_lever_arm": lever}, turning)

    applied = [np.zeros(len(names)) for _ in used]
    offsets = [0.0 for _ in used]
    late, turn_late = names.index("clock.offset"), names.index("mocap_delay.delay")
    for look in range(LOOKS):
        whiteners = [_whitener(w) for w in weak]
        blocks = [_added(_blocks(w, whitener), corrected_already(f, names) + known)
                  for f, w, whitener, known in zip(used, weak, whiteners, applied)]  # fmt: skip
        grams = [b.sum(axis=0) for b in blocks]
        mixed = build(grams)
        threshold = float(options.get("false alarm rate", 0.01)) / (stages * max(len(mixed.columns.causes), 1))
        doubtful = build(grams, MARKERS_KNOWN * np.sqrt(len(blocks)))
        choice = choose(mixed, threshold, [TURNED], doubtful)
        wanted = [_bent(mixed, choice, names, flag) for flag in compared]
        if not turning or look == LOOKS - 1 or max(_apart(a, b, names) for a, b in zip(wanted, applied)) < 1.0:
            break
        for k, (gram, target) in enumerate(zip(grams, wanted)):
            own, _ = _alone(gram, names)
            # the rotation's place on the log's clock is sharp, whatever part of it is the whole capture's
            offsets[k] += own[late] + own[turn_late] - target[turn_late]
        applied = wanted
        weak = [weak_form(straightened(f, _set_right(values, names), offset))
                for f, values, offset in zip(used, applied, offsets)]  # fmt: skip
        weak = [w._replace(columns=w.columns[:, :, [w.names.index(n) for n in names]], names=names) for w in weak]
    shares = probability(blocks, build, choice, threshold)
    _report(level, mixed, choice, shares, names)
    _tables(level, used, weak, whiteners, names, choice, mixed)
    return level


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


def _fit(columns: np.ndarray) -> np.ndarray:
    """Least squares of the residual on all other columns, channels weighted alike; coefficients (P - 1,)."""
    weight = columns[:, :, 0].std(axis=0)
    flat = (columns / np.where(weight > 0, weight, 1.0)[None, :, None]).reshape(-1, columns.shape[2])
    gram = flat.T @ flat
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inner = (gram / np.outer(scale, scale))[1:, 1:] + RIDGE * np.eye(len(gram) - 1)
    return np.linalg.solve(inner, gram[1:, 0] / scale[1:]) / scale[1:]


def _whitener(weak: Weak) -> Whitener:
    """Each flight has a noise of its own: vibration, captures of different quality."""
    left = weak.columns[:, :, 0] - weak.columns[:, :, 1:] @ _fit(weak.columns)
    return autoregression([left], [weak.breaks], ORDER)


def _blocks(weak: Weak, whitener: Whitener) -> np.ndarray:
    blocks = block_grams(weak.columns, weak.breaks, whitener, weak.t, BLOCK)
    if not len(blocks):
        raise DataError(f"flight {weak.key} has no {ORDER / RATE:.1f} s without gaps between sensors and capture")
    return blocks


def _alone(gram: np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """One flight's own values of the columns (P,), and standard errors, 0 where left out.

    A turned IMU and turned markers look alike in one flight; they are stated as the markers' turn.
    """
    single = [i for i, n in enumerate(names) if i > 0 and n.split(".")[0] not in ("imu_misalignment", "drawn")]
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))[single]
    inverse = np.linalg.inv(gram[np.ix_(single, single)] / np.outer(scale, scale) + RIDGE * np.eye(len(single)))
    values, std = np.zeros(len(names)), np.zeros(len(names))
    values[single] = inverse @ (gram[single, 0] / scale) / scale
    std[single] = np.sqrt(np.diag(inverse)) / scale
    return values, std


def _added(blocks: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Cross-products with the residual raised by known values of the columns."""
    change = np.eye(len(values))
    change[:, 0] += values
    return change.T @ blocks @ change


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
        if cause in asked:
            causes.setdefault(cause, []).append(i)
        if cause in usual:
            nuisance.append(i)
            # the least spread between flights that a test allows for is as large again as a flight's own doubt
            size = usual[cause] if turning or cause != "room_tilt" else LEVELLED
            spread.append(size / (np.sqrt(2.0) if cause in causes else 1.0))
    place = list(range(len(names))) + nuisance
    columns = Columns([], list(range(len(names), len(place))), np.array(spread), causes)
    return Tests([g[np.ix_(place, place)] for g in grams], compared, columns, PRIOR_FREEDOM)


def _true(cause: str, value: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameters as they are stated; a scale was found as what to take off the measurement: true = (1 - x) measured."""
    if cause not in NEUTRAL:
        return value, std
    return 1.0 / (1.0 - value), std / (1.0 - value) ** 2


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


def _tables(
    level: Level, used: Sequence[Flown], weak: Sequence[Weak], whiteners: Sequence[Whitener], names: Sequence[str],
    choice: Choice, mixed: Tests,
) -> None:  # fmt: skip
    """Residuals as they are, with the causes taken off, and with everything taken off that the level knows: the floor.

    Tables: "residuals" (rows), "channels" (rms per flight and channel, and whether the floor is white), "parameters"
    (each flight's own best values, nuisances included, beyond what import corrected).
    """
    fitted = {offer: final_test(mixed, choice, offer) for offer in choice.taken}
    rows, channels, parameters, floors = [], [], [], []
    for flown, one, whitener in zip(used, weak, whiteners):
        coefficients = _fit(one.columns)
        gram = _blocks(one, whitener).sum(axis=0)
        own, std = _alone(gram, names)
        y = one.columns[:, :, 0]
        explained = np.zeros_like(y)
        for offer, test in fitted.items():
            if offer.since == "always" or flown.compared:
                explained += one.columns[:, :, mixed.columns.causes[offer.cause]] @ test.value
        explained -= one.columns @ corrected_already(flown, list(names))
        left = y - one.columns[:, :, 1:] @ coefficients
        white, _ = whiten(left[:, :, None], one.breaks, whitener)
        floors.append((left**2).mean(axis=0))
        table = pd.DataFrame({"t": one.t})
        for c, channel in enumerate(CHANNELS):
            table[f"{channel}_residual"] = y[:, c]
            table[f"{channel}_after"] = y[:, c] - explained[:, c]
            table[f"{channel}_floor"] = left[:, c]
            n = white[:, c, 0]
            channels.append(
                {"flight": flown.key, "compared": flown.compared, "channel": channel,
                 "unit": "rad/s" if c < 3 else "m/s2", "before": _rms(y[:, c]),
                 "after": _rms(y[:, c] - explained[:, c]), "floor": _rms(left[:, c]),
                 "whiteness": float(n[1:] @ n[:-1] / max(n @ n, 1e-300)) if len(n) > 1 else np.nan}
            )  # fmt: skip
        rows.append(table.assign(flight=flown.key))
        parameters += [
            {"flight": flown.key, "compared": flown.compared, "id": n.split(".")[0], "parameter": n.split(".")[1],
             "value": v, "std": s, "unit": UNITS.get(n.split(".")[0], "s")}
            for n, v, s in zip(names[1:], own[1:], std[1:])
            if s > 0
        ]  # fmt: skip
    level.tables = {
        "residuals": pd.concat(rows, ignore_index=True),
        "channels": pd.DataFrame(channels),
        "parameters": pd.DataFrame(parameters),
    }
    floor = np.sqrt(np.mean(floors, axis=0))
    level.noise_floor = dict(zip(CHANNELS, floor.tolist()))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
