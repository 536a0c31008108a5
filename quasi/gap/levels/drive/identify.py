"""Drive: how the rotors follow their commands, from commands and measured rotor speeds alone.

Each flight's constants are those that predict its speeds best; then they are compared with the model's and with
one another, with what motors and telemetry differ in between flights as nuisance. A model's constants were found by
output error, so they count with what prediction finds differently in the flights at hand; in its own flights that may
have been less. A late command and late telemetry look the same here; what import found of the telemetry's age on its
own, from the motion, splits them.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.gap.catalogue import catalogue
from quasi.gap.flights.level import PRIOR_FREEDOM, Flown, Level, SensorMixedModel
from quasi.gap.flights.residual_tables import Residuals, level_tables
from quasi.gap.levels.drive.findings import LAGS_ALIKE, saturated, slow, weak
from quasi.gap.levels.drive.fit import (
    CONSTANTS,
    MAP_UNITS,
    Belief,
    DriveFit,
    belief_of,
    commanded,
    fit_drive,
    reference_voltage,
)
from quasi.gap.levels.drive.prediction import DELAY, EXPONENT, LAG
from quasi.gap.levels.selected import report_selection
from quasi.gap.profile import Profile
from quasi.gap.selection import EXACT, Selection, select_causes
from quasi.gap.statistics.blocks import BLOCK
from quasi.gap.statistics.candidates import Candidate, Columns
from quasi.importing.clocks.table_clocks import BY_ROTOR_SPEEDS
from quasi.importing.clocks.telemetry import YAW_EXPLAINED
from quasi.model.columns import ROTORS
from quasi.model.extensions import are_estimated, has_lag_of_extension
from quasi.terms.rotor_map import ROTOR_NUMBERS, SHARES

OWN_LAGS = tuple(f"lag{i}" for i in ROTOR_NUMBERS)
TIMING = ("up", "down", "delay", *OWN_LAGS)  # constants that output error errs in
# constants that a cause changes
DRIVE_CAUSES = {"motor_lag": ("up", "down", *OWN_LAGS), "command_delay": ("delay",), "telemetry_delay": ("late",),
          "battery_sag": ("exponent",)}  # fmt: skip
# columns of `Products.gram` that a cause is tested by, where they are not those constants; and of all rotors alike
CAUSE_COLUMNS = {"motor_lag": tuple(f"own lag {i}" for i in ROTOR_NUMBERS)}
ALIKE_COLUMNS = {"motor_lag": ("up", "down")}
DRIVE_UNITS = {"up": "s", "down": "s", "delay": "s", "late": "s", "exponent": "1"}
LATE = frozenset({"command_delay", "telemetry_delay"})
USUAL_AGE, AGE_SPREAD = 2e-3, 7e-4  # s, of rotor telemetry that nothing is wrong with
# standard deviations of what differs between healthy flights, as shares for the time constants; and of the error of
# what a model believes, common to all flights. The map is that of shares, see MAP_UNITS
NORMAL = {"up": LAGS_ALIKE, "down": LAGS_ALIKE, "delay": 7e-4, "a0": 8.0, "a1": 40.0, "a2": 40.0, "exponent": 0.03,
          **{f"rotor{i}": 0.01 for i in ROTOR_NUMBERS}, **dict.fromkeys(OWN_LAGS, LAGS_ALIKE)}  # fmt: skip
BELIEVED = {
    "up": 0.03,
    "down": 0.03,
    "delay": 1.2e-3,  # of a model for which it is unknown whether it holds the telemetry's age; else AGE_SPREAD
    "a0": 40.0,
    "a1": 200.0,
    "a2": 200.0,
    "exponent": 0.03,
    "late": 5e-4,
    **dict.fromkeys(OWN_LAGS, 0.03),
}
UNPOOLED = ("telemetry_delay",)  # the usual age is known; left free, it would hide its difference from a late command
DRIVE_TIE_BREAKERS = {LATE: "quick yaw inputs: the motion determines the delay of the telemetry"}
FOLLOWING = "how its rotors follow commands"
CATALOGUE = catalogue()


def examine(flights: Sequence[Flown], document: Mapping[str, Any], options: Mapping[str, Any]) -> Level:
    """Faults between command and rotor speed.

    flights  at least one compared one; document  the model's (its "actuators" say what it believes); options  as for
    sensors. Flights without commands or rotor speeds are left out and named.
    """
    level = Level("drive")
    asked = [c for c in DRIVE_CAUSES if options.get("effects", "all") == "all" or c in options["effects"]]
    kinds = {commanded(f) for f in flights if f.compared} - {""}
    if not kinds:
        why = "no compared flight logs the commands of all four rotors"
        level.cannot_be_asked = [{"id": c, "why": why} for c in [*asked, "actuator_saturation", "weak_motor"]]
        return level
    kind = "speeds" if "speeds" in kinds else "shares"
    level.findings += saturated(flights, kind)
    if all(are_estimated(f.filtered) for f in flights if f.compared):
        why = "no compared flight measures its rotor speeds; those made of the commands follow their map"
        level.cannot_be_asked = [{"id": c, "why": why} for c in [*asked, "weak_motor"]]
        return level
    belief, unknown = _belief(flights, document, kind)
    used, fits = _fits(flights, kind, belief, level)
    if not any(f.compared for f in used):
        why = "no compared flight has enough flying with commands and measured rotor speeds"
        level.cannot_be_asked += [{"id": c, "why": why} for c in asked]
        return level
    constants = [whole(f, d) for f, d in zip(used, fits)]
    first = [k for k, f in enumerate(used) if not f.compared] or list(range(len(used)))
    biased = np.zeros(len(CONSTANTS))
    if unknown:
        middle = np.median([constants[k] for k in first], axis=0)
        # reference flights of constant voltage have no information on the battery, so its exponent is no change
        informative = [k for k in first if fits[k].volts_vary] or [k for k, d in enumerate(fits) if d.volts_vary]
        middle[EXPONENT] = np.median([constants[k][EXPONENT] for k in informative or first])
        reference = Belief(middle, belief.voltage)
        level.notes.append(
            f"the model {document.get('id', '')} does not say {unknown}; only changes between "
            "reference and compared flights can show there"
        )
    else:
        # flights are compared with the age of their telemetry in the delay; an older model does not say if its own is
        at = belief.values.copy()
        at[2] += {True: 1.0, False: 0.0, None: 0.5}[belief.aged] * USUAL_AGE
        timing = np.array([n in TIMING for n in CONSTANTS])
        shift = timing * np.median([fits[k].values - fits[k].plain for k in first], axis=0)
        if has_lag_of_extension(document):
            shift[:DELAY] = 0.0  # an earlier comparison found it by prediction; how rotors differ is the model's own
        at += shift
        reference = belief._replace(values=at)
        # of flights that were flown otherwise, output error may have been off by less
        trained = set((document.get("flights") or {}).get("training") or ())
        biased = shift if not trained.issuperset(used[k].key for k in first) else biased
    if kind == "speeds" or not any(d.volts_vary for f, d in zip(used, fits) if f.compared):
        why = ("commands are speeds, which the speed controllers hold whatever the battery" if kind == "speeds"
               else "no compared flight logs a battery voltage that varies")  # fmt: skip
        level.cannot_be_asked.append({"id": "battery_sag", "why": why})
        asked = [c for c in asked if c != "battery_sag"]
    level.findings += weak(used, fits) + slow(used, fits)

    compared = np.array([f.compared for f in used])
    products = [
        Products(v - reference.values, np.linalg.inv(d.covariance()), d.moves(BLOCK), _age(f), reference.values)
        for f, v, d in zip(used, constants, fits)
    ]

    doubt = _doubt(document)
    interval = 1.0 / min(d.rate for d in fits)
    usual = usual_spreads(reference.values, interval, kind)
    sessions = [(options.get("sessions") or {}).get(f.key, "") for f in used]

    def build(grams: list[np.ndarray]) -> SensorMixedModel:
        return _mixed(grams, compared, asked, reference, kind, doubt, sessions, usual, biased)

    mixed = build([p.gram() for p in products])
    level.tests = mixed
    students = [d for d, flag in zip(fits, compared) if flag]
    learned = np.mean([d.values for d in students], axis=0)
    learned[EXPONENT] = np.mean([d.values[EXPONENT] for d in students if d.volts_vary] or learned[EXPONENT])
    level.healthy = {
        "values": reference.values.tolist(), "voltage": reference.voltage,
        "learned": {"kind": kind, "values": learned.tolist(), "voltage": belief.voltage},
    }  # fmt: skip
    profiles = {n: Profile("rotors" if n in ALIKE_COLUMNS else "all", CATALOGUE[n].rivals) for n in asked}
    selection = select_causes(mixed, profiles, float(options.get("false alarm rate", 0.01)), EXACT)
    shares = selection.reproducibility(lambda rng: [p.gram(rng) for p in products], build)
    volts = belief.voltage

    def parameters(offer: Candidate) -> dict[str, dict[str, Any]]:
        return _parameters(mixed, selection, offer, students, volts, timing_error(interval))

    alone = sorted(selection.marginal.values(), key=lambda test: test.wald)
    level.healthy["alone"] = {
        test.offer.cause: {n: p["value"] for n, p in parameters(test.offer).items()} for test in alone
    }

    def lags(offer: Candidate) -> dict[str, float]:
        mean = np.mean([d.values[:2] for d in students], axis=0)
        return dict(zip(("up", "down"), mean.tolist())) if offer.cause == "motor_lag" else {}

    report_selection(level, selection, mixed, shares, CATALOGUE, parameters, DRIVE_TIE_BREAKERS, lags)
    _tables(level, used, fits, [v - reference.values for v in constants])
    return level


def _belief(flights: Sequence[Flown], document: Mapping[str, Any], kind: str) -> tuple[Belief, str]:
    """Where the fits start, and what of it the model does not say, "" for nothing."""
    held, unknown = belief_of(document, kind), ""
    # next to factors of single rotors alone, a lag is taken for a model that states none
    if not (has_lag_of_extension(document) or "time constants" in (document.get("actuators") or {})):
        unknown = FOLLOWING
    volts = reference_voltage(flights)
    if held is None:
        values = np.zeros(len(CONSTANTS))
        values[:3] = 0.03, 0.03, 0.0
        if kind == "speeds":
            values[4] = 1.0
        else:
            values[3:6] = _first_map(flights)
        return Belief(values, volts), FOLLOWING
    if kind == "shares" and held.voltage is None and volts is not None:
        # a map without voltage holds at the voltage of the flights that it was fitted on, which nobody noted
        held = held._replace(voltage=volts)
        unknown = unknown or "at which battery voltage its command map holds"
    return held, unknown


def _first_map(flights: Sequence[Flown]) -> np.ndarray:
    """Speed regressed on command share over all flights, as a start."""
    command, speed = [], []
    for f in flights:
        if commanded(f) == "shares" and all(w in f.filtered for w in ROTORS):
            rows = f.filtered["valid"].to_numpy() > 0.5 if "valid" in f.filtered else np.ones(len(f.filtered), bool)
            command.append(f.filtered[list(SHARES)].to_numpy(float)[rows].ravel())
            speed.append(f.filtered[list(ROTORS)].to_numpy(float)[rows].ravel())
    c, w = np.concatenate([*command, [0.0]]), np.concatenate([*speed, [0.0]])
    fine = np.isfinite(c) & np.isfinite(w)
    return np.linalg.lstsq(np.column_stack([np.ones(fine.sum()), c[fine], c[fine] ** 2]), w[fine], rcond=None)[0]


def _fits(flights: Sequence[Flown], kind: str, start: Belief, level: Level) -> tuple[list[Flown], list[DriveFit]]:
    used, fits = [], []
    for flown in flights:
        try:
            if commanded(flown) != kind:
                raise DataError(f"flight {flown.key} has no rotor commands of the kind that the others log")
            fits.append(fit_drive(flown, kind, start, has_own_lags=True))
            used.append(flown)
        except DataError as error:
            level.notes.append(f"{error}; it is left out of the comparison of commands with speeds")
    # with one lag for all, the errors that an odd one makes are so large that they hide it
    if not any(fit.has_odd_lag(start.values[LAG:]) for fit in fits):
        fits = [fit_drive(flown, kind, start) for flown in used]
    return used, fits


def _doubt(document: Mapping[str, Any]) -> float:
    """How many times BELIEVED the model's time constants may be wrong, by their standard errors."""
    held = document.get("actuators") or {}
    shares = [max(held[n]["std"]) / np.mean(held[n]["value"])
              for n in ("time constants up", "time constants down") if held.get(n, {}).get("std")]  # fmt: skip
    return float(np.hypot(1.0, max(shares, default=0.0) / BELIEVED["up"]))


def usual_spreads(values: np.ndarray, interval: float, kind: str) -> dict[str, float]:
    """What constants near `values` (15,) differ by between healthy flights with a sample each `interval` s, by NORMAL.

    By what is unknown of the time between two samples, lags and delay may differ with the manoeuvre.
    """
    unknown = timing_error(interval)
    own = {"up": (values[0], unknown), "down": (values[1], unknown), "delay": (1.0, unknown)}
    own |= {n: (unit, 0.0) for n, unit in MAP_UNITS[kind].items()}
    spreads = {n: (s, *own.get(n, (1.0, 0.0))) for n, s in NORMAL.items()}
    return {n: float(np.hypot(share * unit, timing)) for n, (share, unit, timing) in spreads.items()}


def timing_error(interval: float) -> float:
    """Standard deviation, s, of when between two samples a command changed: uniform over the interval."""
    return interval / float(np.sqrt(12.0))


def _age(flown: Flown) -> tuple[float, float, float | None]:
    """Seconds that import took off the rotor telemetry; what the motion says of its age, total, and the doubt."""
    found = flown.metadata.get("rotor telemetry") or {}
    if not found.get("applied"):
        return 0.0, 0.0, None
    value, std = found["age"]["value"], float(np.hypot(found["age"]["std"], AGE_SPREAD))
    # stamps that import moved to where the speeds fit the motion leave no age: late telemetry would look like none
    shown = found.get("explained variance", 0.0) > YAW_EXPLAINED and not _moved_to_fit(flown)
    return value, value, std if shown else None


def _moved_to_fit(flown: Flown) -> bool:
    """Whether import moved a source of rotor speeds, and the commands in it, to where the speeds fit the motion."""
    sources = ((flown.metadata.get("sources") or {}).get("onboard") or {}).get("sources") or {}
    lags = [source.get("lag of main stamps") or {} for source in sources.values()]
    return any(lag.get("applied") and lag.get("from") == BY_ROTOR_SPEEDS for lag in lags)


class Products(NamedTuple):
    """One flight's constants minus the reference's (15,), their precision (15, 15), what blocks add to them (B, 15)."""

    apart: np.ndarray
    precision: np.ndarray
    moves: np.ndarray
    age: tuple[float, float, float | None]
    reference: np.ndarray

    def gram(self, rng: np.random.Generator | None = None) -> np.ndarray:
        """Cross-products (21, 21) of: difference from the reference, constants by CONSTANTS, late telemetry, each
        rotor's own lag by the logarithm.

        The delay is that of command and telemetry together; the motion's estimate of the telemetry delay is a
        measurement of its own. rng  draws the flight's blocks anew.
        """
        apart = self.apart.copy()
        if rng is not None:
            apart += self.moves[rng.integers(0, len(self.moves), len(self.moves))].sum(axis=0)
        _, seen, doubt = self.age
        one = np.eye(len(CONSTANTS))
        columns = np.column_stack([apart, one, one[:, 2], lag_columns(self.reference)])
        gram = columns.T @ self.precision @ columns
        if doubt is not None:
            row = np.zeros(len(gram))
            row[0], row[1 + len(CONSTANTS)] = (seen - USUAL_AGE) / doubt, 1.0 / doubt
            gram += np.outer(row, row)
        return gram


def lag_columns(reference: np.ndarray) -> np.ndarray:
    """Changes (15, 4) of the constants where one rotor's time constants grow by a factor, per its logarithm.

    A rotor of four moves the mean by a quarter of its own logarithm. reference (15,)
    """
    lags = [CONSTANTS.index(n) for n in OWN_LAGS]
    found = np.zeros((len(CONSTANTS), 4))
    found[:2] = 0.25 * reference[:2, None]
    found[lags, range(4)] = 1.0
    return found


def whole(flown: Flown, fit: DriveFit) -> np.ndarray:
    """A flight's constants (15,), the age that import took off the rotor telemetry added to the delay again."""
    values = fit.values.copy()
    values[2] += _age(flown)[0]
    return values


def _mixed(
    grams: Sequence[np.ndarray], compared: np.ndarray, asked: Sequence[str], reference: Belief, kind: str,
    doubt: float, sessions: Sequence[str], usual: Mapping[str, float], biased: np.ndarray,
) -> SensorMixedModel:  # fmt: skip
    """biased (15,), by what the model's constants may be off for the way in which they were found."""
    place = {name: 1 + i for i, name in enumerate([*CONSTANTS, "late", *CAUSE_COLUMNS["motor_lag"]])}
    scale = {"up": doubt * reference.values[0], "down": doubt * reference.values[1], **MAP_UNITS[kind]}
    width = len(place) + 1
    own = [name for names in (DRIVE_CAUSES[c] for c in asked) for name in names]
    source = list(range(width)) + [place[n] for n in NORMAL] + [place[n] for n in BELIEVED]
    # the least spread between flights that a test allows for is as large again as a flight's own doubt
    spread = [s / (np.sqrt(2.0) if n in own else 1.0) for n, s in usual.items()]
    nuisance = list(range(width, width + len(NORMAL)))
    shared = list(range(width + len(NORMAL), len(source)))
    known = BELIEVED if reference.aged is None else {**BELIEVED, "delay": AGE_SPREAD}
    off = dict(zip(CONSTANTS, biased))
    believed = np.array([np.hypot(s * scale.get(n, 1.0), off.get(n, 0.0)) for n, s in known.items()])
    tested = {c: [place[n] for n in CAUSE_COLUMNS.get(c, DRIVE_CAUSES[c])] for c in asked}
    alike = {c: [place[n] for n in some] for c, some in ALIKE_COLUMNS.items()}
    base = {c: [place[n] for n in DRIVE_CAUSES[c]] for c in CAUSE_COLUMNS}
    columns = Columns(shared, nuisance, np.array(spread), tested, alike=alike, base=base)
    prior = np.diag(1.0 / believed**2)
    used = [g[np.ix_(source, source)] for g in grams]
    return SensorMixedModel(used, compared, columns, PRIOR_FREEDOM, prior, UNPOOLED, sessions=sessions)


def _parameters(
    mixed: SensorMixedModel, selection: Selection, offer: Candidate, fits: Sequence[DriveFit], volts: float | None,
    timing: float,
) -> dict[str, dict[str, Any]]:  # fmt: skip
    """As they are stated: time constant and exponent absolute, of the compared flights; delays beyond the reference.

    volts  at which the exponent's map holds; timing  error of a lag, s, that flights of the same manoeuvres share
    """
    test = selection.test(mixed, offer)
    # a flight whose voltage stays holds the exponent that its fit began with
    informative = [d for d in fits if d.volts_vary] if offer.cause == "battery_sag" else fits
    values = np.array([d.values for d in informative])
    if offer.cause == "motor_lag" and offer.which != (len(OWN_LAGS),):
        return {
            f"rotor{ROTOR_NUMBERS[k]}": {"value": float(np.exp(v)), "std": float(np.exp(v) * s), "unit": "1"}
            for k, v, s in zip(offer.which, test.value, test.std)
        }
    if offer.cause == "motor_lag":
        each = values[:, :2].mean(axis=1)
        std = _error_of_mean(each, NORMAL["up"] * float(each.mean()) / np.sqrt(2.0))
        ratio = values[:, 1] / values[:, 0]
        apart = _error_of_mean(ratio, NORMAL["up"] * float(ratio.mean()))
        return {
            "time_constant": {"value": float(each.mean()), "std": float(np.hypot(std, timing)), "unit": "s"},
            "down_over_up": {"value": float(ratio.mean()), "std": apart, "unit": "1"},
        }
    if offer.cause == "battery_sag":
        each = values[:, EXPONENT]
        std = _error_of_mean(each, NORMAL["exponent"])
        found = {"exponent": {"value": float(each.mean()), "std": std, "unit": "1"}}
        return found | ({"reference voltage": {"value": volts, "std": 0.0, "unit": "V"}} if volts else {})
    return {"delay": {"value": float(test.value[0]), "std": float(test.std[0]), "unit": "s"}}


def _error_of_mean(each: np.ndarray, usual: float) -> float:
    """Standard error of the mean of flights (n,) that differ by what they show, and by no less than what is usual."""
    shown = float(each.std(ddof=1)) if len(each) > 1 else 0.0
    return max(shown, usual) / float(np.sqrt(len(each)))


def _tables(level: Level, used: Sequence[Flown], fits: Sequence[DriveFit], apart: Sequence[np.ndarray]) -> None:
    """Tables of measured minus modelled speeds, see `level_tables`. apart  (15,) per flight: minus the reference's"""
    residuals, parameters = [], []
    bands = [fit.in_band() for fit in fits]
    for flown, fit, some, away in zip(used, fits, bands, apart):
        series = {"before": some.residual + some.slopes @ away, "floor": some.residual}
        residuals.append(Residuals(series, some.t, some.breaks()))
        held = fit.slopes.reshape(-1, len(CONSTANTS)).any(axis=0)
        parameters += [
            {"flight": flown.key, "compared": flown.compared, "parameter": name, "value": float(value),
             "unit": DRIVE_UNITS.get(name, "rad/s" if name[0] == "a" else "1")}
            for name, value, known in zip(CONSTANTS, fit.values, held)
            if known
        ]  # fmt: skip
    units = dict.fromkeys(ROTORS, "rad/s")
    level.tables, level.noise_floor = level_tables(used, residuals, units, pd.DataFrame(parameters))
