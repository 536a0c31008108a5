"""Settings of the controllers: names, gains as time constants, limits, filters, and the flat array the kernels read.

The default time constants follow the damping optimum: each loop is twice as slow as the one inside it, the innermost
twice as slow as what it cannot see (lag and delay of the actuators, half a sample, the filter's delay where it stands
in the loop). Source: Kessler, Das symmetrische Optimum, Regelungstechnik 6, 1958; Schroeder, Elektrische Antriebe -
Regelung von Antriebssystemen, 4th ed., 2015, section 3.3.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from quasi.errors import ConfigError, nearest
from quasi.simulation.control.control_model import ControlModel

PID, NDI, INDI = 0, 1, 2
# the manual's names and plain ones
NAMES = {"drone_PID": PID, "drone_NDI": NDI, "drone_INDI": INDI, "PID": PID, "NDI": NDI, "INDI": INDI}
LABELS = ("PID", "NDI", "INDI")
METHODS = {"inverse": 0.0, "weighted": 1.0}
SECTIONS = ("controller", "gains", "limits", "filter", "allocation", "time step")

# places in the flat array of parameters
MASS, INERTIA, EFFECT, REACTION, HOVER, LOWEST, HIGHEST, LAG = 0, 1, 10, 26, 30, 31, 32, 33
WEIGHTS, METHOD, LEARN = 34, 38, 39
POSITION, VELOCITY, VELOCITY_INTEGRAL, ATTITUDE, YAW = 40, 41, 42, 43, 44
RATES, RATES_INTEGRAL, RATES_DERIVATIVE = 45, 48, 51  # three each
CUT_OFF, DAMPING = 54, 55
TILT, SPEED, CLIMB, ACCELERATION, RATE, YAW_RATE, INTEGRAL, SLOPE = 56, 57, 58, 59, 60, 61, 62, 63
MODEL = 64  # from here on, for NDI, the compiled model; see `packing`

_TIME = (lambda v: v > 0.0, "a positive number of seconds")
_LONG = (lambda v: v >= 0.0, "seconds, 0 for none")
_SHARE = (lambda v: v > 0.0, "a positive number")
# block: {key: (check, what is expected, controllers that have it)}
BLOCKS: dict[str, dict[str, tuple[Callable[[float], bool], str, tuple[int, ...]]]] = {
    "position": {"time constant": (*_TIME, (PID, NDI, INDI))},
    "velocity": {"time constant": (*_TIME, (PID, NDI, INDI)), "integral time": (*_LONG, (PID, NDI))},
    "attitude": {"time constant": (*_TIME, (PID, NDI, INDI)), "yaw time constant": (*_TIME, (PID, NDI, INDI))},
    "rates": {
        "time constant": (*_TIME, (PID, NDI, INDI)),
        "yaw time constant": (*_TIME, (PID, NDI, INDI)),
        "integral time": (*_LONG, (PID,)),
        "derivative time": (*_LONG, (PID,)),
    },
}
LIMITS: dict[str, tuple[float, Callable[[float], bool], str]] = {
    "tilt": (math.radians(55.0), lambda v: 0.0 < v <= math.radians(80.0), "rad, above 0 and at most 1.396"),
    "speed": (8.0, *_SHARE),
    "climb": (4.0, *_SHARE),
    "acceleration": (10.0, *_SHARE),
    "rate": (8.0, *_SHARE),
    "yaw rate": (3.0, *_SHARE),
    "integral": (3.0, lambda v: v >= 0.0, "m/s2, 0 or more"),
}
FILTER = {"cut-off": (8.0, *_SHARE), "damping": (0.7, *_SHARE)}
ALLOCATION = ("method", "weights", "learn rotor limits")


def kind_of(name: Any) -> int:
    """PID, NDI or INDI of a controller's name; raises ConfigError that names the nearest known one."""
    for known, kind in NAMES.items():
        if str(name).lower() == known.lower():
            return kind
    raise ConfigError(f"controller {name!r} is not known{nearest(str(name), NAMES)}; choose one of them")


def default_gains(kind: int, known: ControlModel, step: float = 0.004) -> dict[str, dict[str, float]]:
    """Time constants derived from the vehicle: lag and delay of its actuators, and the loop's time step (s)."""
    unseen = known.lag + known.delay + 1.5 * step
    rates = 2.0 * unseen
    attitude, velocity, position = 2.0 * rates, 4.0 * rates, 8.0 * rates
    yaw = 1.5 * rates
    if kind == PID:
        # the torque of the rotors' acceleration adds gain that the plain mixer does not know
        yaw *= max(0.5 * yaw_lead(known) / unseen, 1.0)
    gains = {
        "position": {"time constant": position},
        "velocity": {"time constant": velocity, "integral time": (16.0 if kind == NDI else 8.0) * velocity},
        "attitude": {"time constant": attitude, "yaw time constant": 2.0 * yaw},
        "rates": {
            "time constant": rates,
            "yaw time constant": yaw,
            "integral time": 6.0 * attitude,
            "derivative time": 0.3 * known.lag,
        },
    }
    return {block: {k: v for k, v in values.items() if kind in BLOCKS[block][k][2]} for block, values in gains.items()}


def yaw_lead(known: ControlModel) -> float:
    """Time constant, s, of the lead that the rotors' acceleration gives the yaw moment about hover."""
    slope = np.abs(known.effectiveness[2]).mean() * 2.0 * known.hover_speed
    return float(np.abs(known.yaw_reaction).mean() / slope)


def settle(settings: Mapping[str, Any], known: ControlModel) -> dict[str, Any]:
    """The settings of a controller, checked, with every default filled in; gives itself back unchanged.

    settings  "controller": name; optional "gains" {block: {time constants, s}}, all blocks or none; "limits", "filter",
              "allocation", "time step" (s, that the default gains count with)
    Raises ConfigError naming the key.
    """
    _known(settings, SECTIONS, "controller")
    kind = kind_of(settings.get("controller", "INDI"))
    label = f"controller {LABELS[kind]}"
    step = _number(settings.get("time step", 0.004), f"{label}: 'time step'", *_TIME)
    gains = default_gains(kind, known, step)
    given = settings.get("gains")
    if given is not None:
        _known(given, BLOCKS, f"{label}, 'gains'")
        for block in BLOCKS:
            if block not in given:
                raise ConfigError(
                    f"{label}: 'gains' lacks the block '{block}'; add it, or leave 'gains' out for gains derived from "
                    "the vehicle"
                )
            _known(given[block], gains[block], f"{label}, 'gains', '{block}'")
            for key, value in given[block].items():
                check, expected, _ = BLOCKS[block][key]
                gains[block][key] = _number(value, f"{label}, 'gains', '{block}': '{key}'", check, expected)
    limits = _plain(settings.get("limits"), LIMITS, f"{label}, 'limits'")
    lowpass = _plain(settings.get("filter"), FILTER, f"{label}, 'filter'")
    return {
        "controller": LABELS[kind],
        "gains": gains,
        "limits": limits,
        "filter": lowpass,
        "allocation": _allocation(settings.get("allocation"), kind, label),
        "time step": step,
    }


def pack(settled: Mapping[str, Any], known: ControlModel) -> np.ndarray:
    """Parameters (MODEL,) of the kernels, from settled settings and what is known of the vehicle."""
    gains, limits, allocation = settled["gains"], settled["limits"], settled["allocation"]
    out = np.zeros(MODEL)
    out[MASS], out[HOVER], out[LAG] = known.mass, known.hover_speed, known.lag + known.delay
    out[LOWEST], out[HIGHEST] = known.lowest, known.highest
    out[INERTIA : INERTIA + 9] = known.inertia.ravel()
    out[EFFECT : EFFECT + 16] = known.effectiveness.ravel()
    out[REACTION : REACTION + 4] = known.yaw_reaction
    out[WEIGHTS : WEIGHTS + 4] = allocation["weights"]
    out[METHOD] = METHODS[allocation["method"]]
    out[LEARN] = float(allocation["learn rotor limits"])
    out[POSITION] = 1.0 / gains["position"]["time constant"]
    out[VELOCITY] = 1.0 / gains["velocity"]["time constant"]
    out[VELOCITY_INTEGRAL] = out[VELOCITY] * _inverse(gains["velocity"].get("integral time", 0.0))
    out[ATTITUDE] = 1.0 / gains["attitude"]["time constant"]
    out[YAW] = 1.0 / gains["attitude"]["yaw time constant"]
    rates = gains["rates"]
    gain = np.array([1.0 / rates["time constant"]] * 2 + [1.0 / rates["yaw time constant"]])
    out[RATES : RATES + 3] = gain
    out[RATES_INTEGRAL : RATES_INTEGRAL + 3] = gain * _inverse(rates.get("integral time", 0.0))
    out[RATES_DERIVATIVE : RATES_DERIVATIVE + 3] = gain * rates.get("derivative time", 0.0)
    out[CUT_OFF] = 2.0 * math.pi * settled["filter"]["cut-off"]
    out[DAMPING] = settled["filter"]["damping"]
    for place, key in ((TILT, "tilt"), (SPEED, "speed"), (CLIMB, "climb"), (ACCELERATION, "acceleration"),
                       (RATE, "rate"), (YAW_RATE, "yaw rate"), (INTEGRAL, "integral")):  # fmt: skip
        out[place] = limits[key]
    out[SLOPE] = math.tan(limits["tilt"])
    return out


def _allocation(given: Any, kind: int, label: str) -> dict[str, Any]:
    given = {} if given is None else given
    where = f"{label}, 'allocation'"
    _known(given, ALLOCATION, where)
    # NDI and PID know nothing of a fault; INDI watches what its rotors do
    default = {"method": "weighted", "weights": [1000.0, 1000.0, 1.0, 100.0], "learn rotor limits": kind == INDI}
    result = {**default, **given}
    if result["method"] not in METHODS:
        raise ConfigError(f"{where}: 'method' is {result['method']!r}{nearest(str(result['method']), METHODS)}")
    try:
        weights = [float(w) for w in result["weights"]]
    except (TypeError, ValueError):
        weights = []
    if len(weights) != 4 or not all(math.isfinite(w) and w > 0.0 for w in weights):
        raise ConfigError(
            f"{where}: 'weights' is {result['weights']!r}, expected four positive numbers: roll, pitch, yaw, thrust"
        )
    if not isinstance(result["learn rotor limits"], bool):
        raise ConfigError(f"{where}: 'learn rotor limits' is {result['learn rotor limits']!r}, expected true or false")
    return {**result, "weights": weights}


def _plain(given: Any, table: Mapping[str, tuple[float, Callable[[float], bool], str]], where: str) -> dict[str, float]:
    given = {} if given is None else given
    _known(given, table, where)
    return {
        key: _number(given.get(key, default), f"{where}: '{key}'", check, expected)
        for key, (default, check, expected) in table.items()
    }


def _known(given: Any, known: Any, where: str) -> None:
    if not isinstance(given, Mapping):
        raise ConfigError(f"{where} is {given!r}, expected a section {{ ... }}")
    for key in given:
        if key not in known:
            raise ConfigError(f"{where}: unknown key '{key}'{nearest(key, known)}")


def _number(value: Any, where: str, check: Callable[[float], bool], expected: str) -> float:
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not good or not check(float(value)):
        raise ConfigError(f"{where} is {value!r}, expected {expected}")
    return float(value)


def _inverse(time: float) -> float:
    return 1.0 / time if time > 0.0 else 0.0
