"""Settings of the controllers: gains as time constants, limits, filters, allocation; checked, with defaults.

The default time constants follow the damping optimum: each loop is twice as slow as the one inside it. The
innermost is twice as slow as the sum of the small time constants: lag and delay of the actuators, half a sample, and
the delay of a filter in the loop. Source: Kessler, Das symmetrische Optimum, Regelungstechnik 6, 1958; Schroeder,
Elektrische Antriebe - Regelung von Antriebssystemen, 4th ed., 2015, section 3.3.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

from quasi.errors import ConfigError, nearest
from quasi.simulation.control.control_model import ControlModel
from quasi.simulation.control.law import Law
from quasi.simulation.control.parameters import ALLOCATION_METHODS
from quasi.simulation.control.registry import find_law

CONTROLLER_SECTIONS = ("controller", "gains", "limits", "filter", "allocation", "time step")

_POSITIVE_TIME = (lambda v: v > 0.0, "a positive number of seconds")
_TIME_OR_NONE = (lambda v: v >= 0.0, "seconds, 0 for none")
_POSITIVE = (lambda v: v > 0.0, "a positive number")
# block: {key: (check, expected value)}; time constants are of all controllers, other keys of those that list them
GAIN_BLOCKS: dict[str, dict[str, tuple[Callable[[float], bool], str]]] = {
    "position": {"time constant": _POSITIVE_TIME},
    "velocity": {"time constant": _POSITIVE_TIME, "integral time": _TIME_OR_NONE},
    "attitude": {"time constant": _POSITIVE_TIME, "yaw time constant": _POSITIVE_TIME},
    "rates": {
        "time constant": _POSITIVE_TIME,
        "yaw time constant": _POSITIVE_TIME,
        "integral time": _TIME_OR_NONE,
        "derivative time": _TIME_OR_NONE,
    },
}
LIMIT_DEFAULTS: dict[str, tuple[float, Callable[[float], bool], str]] = {
    "tilt": (math.radians(55.0), lambda v: 0.0 < v <= math.radians(80.0), "rad, above 0 and at most 1.396"),
    "speed": (8.0, *_POSITIVE),
    "climb": (4.0, *_POSITIVE),
    "acceleration": (10.0, *_POSITIVE),
    "rate": (8.0, *_POSITIVE),
    "yaw rate": (3.0, *_POSITIVE),
    "integral": (3.0, lambda v: v >= 0.0, "m/s2, 0 or more"),
}
FILTER_DEFAULTS = {"cut-off": (8.0, *_POSITIVE), "damping": (0.7, *_POSITIVE)}
ALLOCATION_KEYS = ("method", "weights", "learn rotor limits")


def derive_gains(law: Law, known: ControlModel, step: float = 0.004) -> dict[str, dict[str, float]]:
    """Derive time constants from lag and delay of the actuators and the loop's time step (s)."""
    small_time_constant = known.lag + known.delay + 1.5 * step
    rates = 2.0 * small_time_constant
    attitude, velocity, position = 2.0 * rates, 4.0 * rates, 8.0 * rates
    yaw = 1.5 * rates * law.yaw(known, small_time_constant)
    gains = {
        "position": {"time constant": position},
        "velocity": {"time constant": velocity, "integral time": law.integral * velocity},
        "attitude": {"time constant": attitude, "yaw time constant": 2.0 * yaw},
        "rates": {
            "time constant": rates,
            "yaw time constant": yaw,
            "integral time": 6.0 * attitude,
            "derivative time": 0.3 * known.lag,
        },
    }
    return {
        block: {k: v for k, v in values.items() if k.endswith("time constant") or k in law.gains.get(block, ())}
        for block, values in gains.items()
    }


def complete_settings(settings: Mapping[str, Any], known: ControlModel) -> dict[str, Any]:
    """Check the settings of a controller and fill in every default; complete settings are returned unchanged.

    settings  "controller": name; optional "gains" {block: {time constants, s}}, all blocks or none; "limits", "filter",
              "allocation", "time step" (s, used by the default gains)
    Raises ConfigError naming the key.
    """
    _check_keys(settings, CONTROLLER_SECTIONS, "controller")
    law = find_law(settings.get("controller", "INDI"))
    label = f"controller {law.name}"
    step = _read_number(settings.get("time step", 0.004), f"{label}: 'time step'", *_POSITIVE_TIME)
    gains = derive_gains(law, known, step)
    given = settings.get("gains")
    if given is not None:
        _check_keys(given, GAIN_BLOCKS, f"{label}, 'gains'")
        for block in GAIN_BLOCKS:
            if block not in given:
                raise ConfigError(
                    f"{label}: 'gains' lacks the block '{block}'; add it, or leave 'gains' out for gains derived from "
                    "the vehicle"
                )
            _check_keys(given[block], gains[block], f"{label}, 'gains', '{block}'")
            for key, value in given[block].items():
                check, expected = GAIN_BLOCKS[block][key]
                gains[block][key] = _read_number(value, f"{label}, 'gains', '{block}': '{key}'", check, expected)
    limits = _read_section(settings.get("limits"), LIMIT_DEFAULTS, f"{label}, 'limits'")
    lowpass = _read_section(settings.get("filter"), FILTER_DEFAULTS, f"{label}, 'filter'")
    return {
        "controller": law.name,
        "gains": gains,
        "limits": limits,
        "filter": lowpass,
        "allocation": _read_allocation(settings.get("allocation"), law, label),
        "time step": step,
    }


def _read_allocation(given: Any, law: Law, label: str) -> dict[str, Any]:
    given = {} if given is None else given
    where = f"{label}, 'allocation'"
    _check_keys(given, ALLOCATION_KEYS, where)
    default = {"method": "weighted", "weights": [1000.0, 1000.0, 1.0, 100.0], "learn rotor limits": law.learns_limits}
    result = {**default, **given}
    if result["method"] not in ALLOCATION_METHODS:
        raise ConfigError(
            f"{where}: 'method' is {result['method']!r}{nearest(str(result['method']), ALLOCATION_METHODS)}"
        )
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


def _read_section(
    given: Any, table: Mapping[str, tuple[float, Callable[[float], bool], str]], where: str
) -> dict[str, float]:
    given = {} if given is None else given
    _check_keys(given, table, where)
    return {
        key: _read_number(given.get(key, default), f"{where}: '{key}'", check, expected)
        for key, (default, check, expected) in table.items()
    }


def _check_keys(given: Any, known: Any, where: str) -> None:
    if not isinstance(given, Mapping):
        raise ConfigError(f"{where} is {given!r}, expected a section {{ ... }}")
    for key in given:
        if key not in known:
            raise ConfigError(f"{where}: unknown key '{key}'{nearest(key, known)}")


def _read_number(value: Any, where: str, check: Callable[[float], bool], expected: str) -> float:
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not good or not check(float(value)):
        raise ConfigError(f"{where} is {value!r}, expected {expected}")
    return float(value)
