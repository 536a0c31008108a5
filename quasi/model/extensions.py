"""Constants in the extensions of a model: rotors and their logs, wind, mass, inertia and centre of gravity.

A flight is recorded and filtered with the configured constants. An extended model is compared with it after the
recording is corrected by the constants of the extensions.
"""

import itertools
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi import attitude
from quasi.errors import ConfigError, DataError, nearest
from quasi.model.columns import ROTORS
from quasi.model.commands import map_of
from quasi.model.model import Model
from quasi.tables import TELEMETRY_AGE_REMOVED
from quasi.terms.rotor_map import COMMANDED, LAG_FACTORS, RAW, SHARES, WAYS_RATIO, lagged, speed_exponent

# keys of a model's document: mass, kg, and inertia, kg m2, with which its flights were processed
CONFIGURED_MASS_KEY, CONFIGURED_INERTIA_KEY = "configured mass", "configured inertia"
GAP_STEPS = 1.5  # usual steps in time, beyond which rows are missing
DEFAULT_LAG = 1.0 / 35.0  # s, of the rotors, where the model has no time constants
_LAGS = ("time constants", "time constants up", "time constants down")
_ROTOR_CONSTANTS = (
    "time constant",
    "delay",
    "voltage exponent",
    "reference voltage",
    "telemetry delay",
    "rotor speed scale",
    WAYS_RATIO,
    *LAG_FACTORS,
)


class Actuators(NamedTuple):
    """The rotors of a model: time constants (4,) s speeding up and slowing down, delay s, lowest and highest rad/s.

    highest is inf and lowest 0 where the airframe gives none; notes: what was assumed
    """

    up: np.ndarray
    down: np.ndarray
    delay: float
    lowest: float
    highest: float
    notes: tuple[str, ...]


def extensions_of(model: Model) -> list[Mapping[str, Any]]:
    """List the extensions of a model. Raises ConfigError where they are damaged."""
    return _sections(model.document, model.id)


def read_rotor_constants(model: Model) -> dict[str, float]:
    """Read the rotor constants of the extensions; {} without any. Raises ConfigError for unknown or invalid ones.

    "time constant" s, the mean of speeding up and slowing down; "down over up" the ratio of these; "rotor1 lag factor"
    and so on; "delay" s; "voltage exponent" of the steady speed;
    "reference voltage" V at which it is 1, for a command map without one. Recordings, where recorded speeds drive a
    roll-out: "telemetry delay" s and "rotor speed scale", both subtracted from the record
    """
    return _collect_rotor_constants(model.document, model.id)


def read_speed_limits(model: Model) -> tuple[float | None, float | None]:
    """Lowest and highest rotor speed, rad/s, by the airframe; None where it does not say, or not the unit.

    They are configured in recorded units, from which a scale of all recorded speeds is taken off.
    """
    frame = model.airframe
    factor = frame.logged_to_rad_s or model.document.get("logged to rad/s")
    scale = read_rotor_constants(model).get("rotor speed scale", 1.0)
    logged = frame.idle_rpm, frame.max_rpm
    low, high = (None if v is None or not factor else float(v * factor / scale) for v in logged)
    return low, high


def drive_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """Read the section "actuators" of a model's document, with the rotor constants of its extensions instead of its
    own.

    A time constant of an extension is the mean of speeding up and slowing down, of the four rotors by their
    logarithms; the model's own ratio of its rotors is kept, and that of the two where no extension states it. So is the
    reference voltage of its command map where it has one. Factors of single rotors multiply what there is; next to a
    time constant, that of all rotors, they shift rotors against one another.
    Raises DataError for a damaged section, ConfigError for a damaged extension.
    """
    name = str(document.get("id", ""))
    known = document.get("actuators") or {}
    if not isinstance(known, Mapping):
        raise DataError(f"model {name}: 'actuators' is {known!r:.60}, expected a section; build the model again")
    known, found = dict(known), _collect_rotor_constants(document, name)
    if "time constant" in found:
        lag = found["time constant"]
        own = {k: _read_seconds(known.pop(k), name, k) for k in _LAGS if k in known}
        both = all(k in own for k in _LAGS[1:])
        middle = np.mean([_mean_lag(own[k]) for k in _LAGS[1:]] if both else _mean_lag(own.get(_LAGS[0], lag)))
        scaled = {k: (v * lag / middle).tolist() for k, v in own.items() if both or k == _LAGS[0]}
        if ratio := found.get(WAYS_RATIO):
            ways = dict(zip(_LAGS, (lag, 2.0 * lag / (1.0 + ratio), 2.0 * lag * ratio / (1.0 + ratio))))
            rotors = {k: own.get(k, own.get(_LAGS[0], np.ones(4))) for k in ways}
            scaled = {k: (v / _mean_lag(v) * ways[k]).tolist() for k, v in rotors.items()}
        known |= {k: {"value": v} for k, v in ({_LAGS[0]: lag} | scaled).items()}
    if any(n in found for n in LAG_FACTORS):
        factors = np.array([found.get(n, 1.0) for n in LAG_FACTORS])
        if "time constant" in found:  # which is that of all four together
            factors /= _mean_lag(factors)
        own = {k: _read_seconds(known[k], name, k) for k in _LAGS if k in known}
        known |= {k: {"value": (v * factors).tolist()} for k, v in (own or {_LAGS[0]: DEFAULT_LAG}).items()}
    if "delay" in found:
        own = known.get("delay")
        removed = own.get(TELEMETRY_AGE_REMOVED) if isinstance(own, Mapping) else None
        known["delay"] = {"value": found["delay"]} | ({} if removed is None else {TELEMETRY_AGE_REMOVED: removed})
    mapped = known.get("command map")
    if mapped and "voltage exponent" in found:
        volts = mapped.get("reference voltage") or found.get("reference voltage")
        exponent = {"value": found["voltage exponent"]}
        known["command map"] = {**mapped, "voltage exponent": exponent, "reference voltage": volts}
    return known


def _mean_lag(values: Any) -> float:
    """The mean of lags by their logarithms, from which rotors with lags of their own are counted."""
    return float(np.exp(np.mean(np.log(values))))


def has_lag_of_extension(document: Mapping[str, Any]) -> bool:
    """Whether an extension of a model's document states the rotors' lag; factors of single rotors keep the model's."""
    return "time constant" in _collect_rotor_constants(document, str(document.get("id", "")))


def actuators_of(model: Model) -> Actuators:
    """Read lag, delay and speed limits of the rotors, those of extensions before the model's own.

    Raises DataError for damaged ones.
    """
    known, notes = drive_of(model.document), []

    def value(*keys: str) -> np.ndarray | None:
        for key in keys:
            about = known.get(key) or {}
            if not isinstance(about, Mapping) or about.get("value") is not None:
                return _read_seconds(about, model.id, key)
        return None

    up, down, late = value("time constants up", "time constants"), value("time constants down"), value("delay")
    if up is None:
        up = DEFAULT_LAG
        notes.append(f"the model knows no time constants of its rotors; {DEFAULT_LAG:.4f} s is taken")
    limits = []
    for key, limit, free in zip(("idle RPM", "max RPM"), read_speed_limits(model), (0.0, np.inf)):
        if limit is None:
            notes.append(f"the airframe's '{key}' or 'motor poles' is unknown: commands have no such limit")
        limits.append(free if limit is None else limit)
    up, down = (np.broadcast_to(tau, 4).copy() for tau in (up, up if down is None else down))
    delay = 0.0 if late is None else max(float(np.mean(late)), 0.0)
    return Actuators(up, down, delay, *limits, tuple(notes))


def wind_of(model: Model) -> np.ndarray:
    """Read the wind velocity (3,), m/s, north east down, of the model's extensions.

    Raises ConfigError unless it is three numbers.
    """
    wind = np.zeros(3)
    for extension in extensions_of(model):
        value = (extension.get("environment") or {}).get("wind", 0.0)
        try:
            found = np.broadcast_to(np.asarray(value, float), 3)
        except (TypeError, ValueError):
            found = np.full(3, np.nan)
        if not np.isfinite(found).all():
            raise ConfigError(f"model {model.id}, extension '{extension.get('id')}': 'wind' is {value!r:.60}, expected "
                              "three numbers of m/s; build the extended model again")  # fmt: skip
        wind = wind + found
    return wind


def telemetry_of(model: Model) -> tuple[float, float]:
    """Read delay (s) and scale factor of recorded rotor speeds."""
    constants = read_rotor_constants(model)
    return constants.get("telemetry delay", 0.0), constants.get("rotor speed scale", 1.0)


def shift_of(model: Model) -> np.ndarray:
    """True minus configured centre of gravity (3,), m, body axes."""
    found = [(e.get("airframe") or {}).get("cg offset") for e in extensions_of(model)]
    return np.sum([np.zeros(3), *(np.asarray(f, float) for f in found if f is not None)], axis=0)


def configured_mass(model: Model) -> float | None:
    """Read the mass, kg, with which flights were processed; the model's mass may differ by its extensions."""
    return model.document.get(CONFIGURED_MASS_KEY, model.airframe.mass)


def compute_flight_mass(model: Model, logged: float | None) -> float | None:
    """Compute the mass, kg, of a vehicle by a model in a flight with another logged mass.

    The extensions give a difference from the configured mass; it is added to the logged mass.
    """
    own, configured = model.airframe.mass, configured_mass(model)
    if own is None or configured is None or logged is None or not math.isfinite(logged):
        return own
    return own + (logged - configured)


def compute_flight_inertia(model: Model, logged: np.ndarray) -> np.ndarray:
    """Compute the inertia (3, 3), kg m2, of a vehicle by a model in a flight that was processed with another one.

    The extensions give a difference from the configured inertia; it is added to that of the processing.
    """
    own = np.asarray(model.airframe.inertia, float)
    return own + (logged - np.asarray(model.document.get(CONFIGURED_INERTIA_KEY, own), float))


def correct_rotor_speeds(columns: Mapping[str, np.ndarray], late: float, scale: float) -> dict[str, np.ndarray]:
    """Correct the rotor speeds of a flight's columns. late  delay, s; scale  factor of the recorded speeds

    Speeds are read `late` later, linear between samples: W + late dW/dt would miss what bends within the delay.
    """
    result = dict(columns)
    if late or scale != 1.0:
        t = np.asarray(columns["t"], float)
        for name in (*ROTORS, *(f"{rotor}_dot" for rotor in ROTORS)):
            result[name] = np.interp(t + late, t, np.asarray(columns[name], float)) / scale
    return result


def are_estimated(columns: Mapping[str, np.ndarray] | pd.DataFrame) -> bool:
    """Whether the rotor speeds of a filtered flight's columns come from a map of its commands."""
    return any(f"{name}{RAW}" in columns for name in (SHARES[0], COMMANDED[0]))


class OfMap(NamedTuple):
    """What extensions change of the map that speeds are estimated by.

    exponent  of the voltage, beyond that of the map; reference  V of the map, None without; before, after  time
    constants, s, with which the speeds were estimated and should have been
    """

    exponent: float = 0.0
    reference: float | None = None
    before: float = 0.0
    after: float = 0.0

    @property
    def any(self) -> bool:
        """Whether speeds differ under it from those of the map."""
        return self.exponent != 0.0 or self.after != self.before

    def beyond(self, base: "OfMap") -> "OfMap":
        """What is changed of speeds that are put right by what `base` changes already."""
        return OfMap(self.exponent - base.exponent, self.reference, base.after, self.after)


def changes_of_map(model: Model) -> OfMap:
    """Read what the extensions of a model change of its map from commands to speeds."""
    drive, found = map_of(model.document), read_rotor_constants(model)
    if drive is None:
        return OfMap()
    own, lag = speed_exponent(drive), drive["time constant"]["value"]
    reference = drive["reference voltage"] or found.get("reference voltage")
    return OfMap(found.get("voltage exponent", own) - own, reference, lag, found.get("time constant", lag))


def correct_estimated_speeds(columns: Mapping[str, np.ndarray], of: OfMap) -> dict[str, np.ndarray]:
    """Correct rotor speeds estimated from commands for another map; measured ones stay.

    A voltage that is not positive leaves the speed.
    """
    result = dict(columns)
    if not of.any or not are_estimated(columns):
        return result
    if of.exponent and of.reference and "battery_voltage" in columns:
        ratio = np.asarray(columns["battery_voltage"], float) / of.reference
        factor = np.where(ratio > 0.0, ratio, 1.0) ** of.exponent
        names = [name for rotor in ROTORS for name in (rotor, f"{rotor}_dot") if name in columns]
        result |= {name: np.asarray(columns[name], float) * factor for name in names}
    if of.after != of.before:
        speeds, slopes = (
            np.stack([np.asarray(result[f"{w}{d}"], float) for w in ROTORS], axis=1) for d in ("", "_dot")
        )
        wanted = speeds + of.before * slopes  # what the lag made the speeds of
        turned = _lagged_again(np.asarray(columns["t"], float), wanted, of.after)
        result |= dict(zip(ROTORS, turned.T))
        result |= {f"{w}_dot": slope for w, slope in zip(ROTORS, ((wanted - turned) / of.after).T)}
    return result


def _lagged_again(t: np.ndarray, wanted: np.ndarray, lag: float) -> np.ndarray:
    """What follows wanted (n, R) with a first-order lag, s, each stretch without missing rows or values by itself."""
    steps, known = np.diff(t), np.isfinite(wanted).all(axis=1)
    usual = float(np.median(steps))
    apart = (steps > GAP_STEPS * usual) | (known[1:] != known[:-1])
    edges = [0, *(np.flatnonzero(apart) + 1).tolist(), len(t)]
    return np.concatenate([lagged(wanted[a:b], usual, lag, 0.0) for a, b in itertools.pairwise(edges)])


def correct_columns(model: Model, columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Correct a flight's columns by the model's constants: true rotor speeds, and velocity through the air."""
    result = correct_rotor_speeds(columns, *telemetry_of(model))
    result = correct_estimated_speeds(result, changes_of_map(model))
    wind = wind_of(model)
    if wind.any():
        quaternion = attitude.from_euler(*(columns[c] for c in ("roll", "pitch", "yaw")))
        over_ground = np.stack([columns.get(f"{c}_air", columns[c]) for c in "uvw"], axis=1)
        through_air = over_ground - attitude.rotate_inverse(quaternion, wind)
        result |= {f"{c}_air": through_air[:, k] for k, c in enumerate("uvw")}
    return result


def correct_flight(model: Model, flight: pd.DataFrame, logged: float | None = None) -> pd.DataFrame:
    """Correct a filtered flight by the model's constants: rotor speeds, air, mass, inertia and centre of gravity.

    logged  mass of its processing, kg, where known
    Parts with states of their own (a load that swings, inflow that lags) stay in the measurement. Source: the filter's
    definitions F = m f, M = I domega/dt + omega x I omega.
    """
    sections = extensions_of(model)
    if not sections:
        return flight
    columns = {n: flight[n].to_numpy(float) for n in flight if pd.api.types.is_numeric_dtype(flight[n])}
    result = correct_columns(model, columns)
    rates, turning = (np.stack([columns[f"{c}{d}"] for c in "pqr"], axis=1) for d in ("", "_dot"))
    shift, mass = shift_of(model), compute_flight_mass(model, logged)
    configured = configured_mass(model) if logged is None else logged
    force = np.stack([columns[a] for a in ("Fx", "Fy", "Fz")], axis=1)
    if shift.any():
        force = force + configured * (np.cross(turning, shift) + np.cross(rates, np.cross(rates, shift)))
    if mass and configured and mass != configured:
        force = force * (mass / configured)
    result |= dict(zip(("Fx", "Fy", "Fz"), force.T))
    if any("inertia" in (e.get("airframe") or {}) for e in sections):
        inertia = np.asarray(model.airframe.inertia, float)
        moment = turning @ inertia.T + np.cross(rates, rates @ inertia.T)
        result |= dict(zip(("Mx", "My", "Mz"), moment.T))
    return flight.assign(**result)


def _sections(document: Mapping[str, Any], name: str) -> list[Mapping[str, Any]]:
    found = document.get("extensions") or []
    if not isinstance(found, list) or not all(isinstance(e, Mapping) for e in found):
        raise ConfigError(f"model {name} holds an extension that is no section; build the model again")
    return list(found)


def _collect_rotor_constants(document: Mapping[str, Any], name: str) -> dict[str, float]:
    found: dict[str, float] = {}
    for extension in _sections(document, name):
        for key, value in (extension.get("actuators") or {}).items():
            what = f"model {name}, extension '{extension.get('id')}'"
            if key not in _ROTOR_CONSTANTS:
                raise ConfigError(f"{what} changes the rotors' '{key}', which the simulator does not know"
                                  f"{nearest(key, _ROTOR_CONSTANTS)}; extend the model without it")  # fmt: skip
            number = float(value) if isinstance(value, int | float) else math.nan
            positive = key in ("time constant", "reference voltage", "rotor speed scale", WAYS_RATIO, *LAG_FACTORS)
            if not math.isfinite(number) or (positive and number <= 0.0):
                raise ConfigError(f"{what}: '{key}' is {value!r}, expected a {'positive' if positive else 'finite'} "
                                  "number; build the extended model again")  # fmt: skip
            found[key] = number
    return found


def _read_seconds(about: Any, name: str, key: str) -> np.ndarray:
    try:
        value = np.asarray(about["value"], float)
    except (KeyError, TypeError, ValueError):
        value = np.full(1, np.nan)
    # an identified delay may be slightly negative
    if value.size not in (1, 4) or not np.isfinite(value).all() or (key in _LAGS and value.min() <= 0.0):
        expected = "positive seconds" if key in _LAGS else "seconds"
        raise DataError(f"model {name}: 'actuators' / '{key}' is {about!r:.60}, expected {expected} under 'value'; "
                          "build the model again")  # fmt: skip
    return value
