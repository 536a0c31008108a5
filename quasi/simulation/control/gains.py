"""Settings of the controllers: names, gains as time constants, limits, filters, and the flat array the kernels read.

The default time constants follow the damping optimum: each loop is twice as slow as the one inside it. The
innermost is twice as slow as the sum of the small time constants: lag and delay of the actuators, half a sample, and
the delay of a filter in the loop. Source: Kessler, Das symmetrische Optimum, Regelungstechnik 6, 1958; Schroeder,
Elektrische Antriebe - Regelung von Antriebssystemen, 4th ed., 2015, section 3.3.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from quasi.errors import ConfigError, nearest
from quasi.simulation.control.control_model import ControlModel

PID, NDI, INDI = 0, 1, 2
# the manual's names and short ones
CONTROLLER_NAMES = {"drone_PID": PID, "drone_NDI": NDI, "drone_INDI": INDI, "PID": PID, "NDI": NDI, "INDI": INDI}
CONTROLLER_LABELS = ("PID", "NDI", "INDI")
ALLOCATION_METHODS = {"inverse": 0.0, "weighted": 1.0}
CONTROLLER_SECTIONS = ("controller", "gains", "limits", "filter", "allocation", "time step")

# places in the flat array of parameters
CONTROL_MASS, CONTROL_INERTIA, EFFECTIVENESS, YAW_REACTION = 0, 1, 10, 26
HOVER_SPEED, LOWEST_SPEED, HIGHEST_SPEED, ACTUATOR_LAG = 30, 31, 32, 33
ALLOCATION_WEIGHTS, USES_WEIGHTED_ALLOCATION, LEARNS_ROTOR_LIMITS = 34, 38, 39
POSITION_GAIN, VELOCITY_GAIN, VELOCITY_INTEGRAL_GAIN, ATTITUDE_GAIN, YAW_GAIN = 40, 41, 42, 43, 44
RATE_GAINS, RATE_INTEGRAL_GAINS, RATE_DERIVATIVE_GAINS = 45, 48, 51  # three each
FILTER_FREQUENCY, FILTER_DAMPING = 54, 55
MAX_TILT, MAX_SPEED, MAX_CLIMB, MAX_ACCELERATION = 56, 57, 58, 59
MAX_TILT_RATE, MAX_YAW_RATE, MAX_INTEGRAL, MAX_TILT_TANGENT = 60, 61, 62, 63
MODEL_START = 64  # from here on, for NDI, the compiled model; see `controllers`

_POSITIVE_TIME = (lambda v: v > 0.0, "a positive number of seconds")
_TIME_OR_NONE = (lambda v: v >= 0.0, "seconds, 0 for none")
_POSITIVE = (lambda v: v > 0.0, "a positive number")
# block: {key: (check, expected value, controllers that use it)}
GAIN_BLOCKS: dict[str, dict[str, tuple[Callable[[float], bool], str, tuple[int, ...]]]] = {
    "position": {"time constant": (*_POSITIVE_TIME, (PID, NDI, INDI))},
    "velocity": {"time constant": (*_POSITIVE_TIME, (PID, NDI, INDI)), "integral time": (*_TIME_OR_NONE, (PID, NDI))},
    "attitude": {
        "time constant": (*_POSITIVE_TIME, (PID, NDI, INDI)),
        "yaw time constant": (*_POSITIVE_TIME, (PID, NDI, INDI)),
    },
    "rates": {
        "time constant": (*_POSITIVE_TIME, (PID, NDI, INDI)),
        "yaw time constant": (*_POSITIVE_TIME, (PID, NDI, INDI)),
        "integral time": (*_TIME_OR_NONE, (PID,)),
        "derivative time": (*_TIME_OR_NONE, (PID,)),
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


def find_kind(name: Any) -> int:
    """PID, NDI or INDI of a controller's name; raises ConfigError that names the nearest known one."""
    for known, kind in CONTROLLER_NAMES.items():
        if str(name).lower() == known.lower():
            return kind
    raise ConfigError(f"controller {name!r} is not known{nearest(str(name), CONTROLLER_NAMES)}; choose one of them")


def derive_gains(kind: int, known: ControlModel, step: float = 0.004) -> dict[str, dict[str, float]]:
    """Derive time constants from lag and delay of the actuators and the loop's time step (s)."""
    small_time_constant = known.lag + known.delay + 1.5 * step
    rates = 2.0 * small_time_constant
    attitude, velocity, position = 2.0 * rates, 4.0 * rates, 8.0 * rates
    yaw = 1.5 * rates
    if kind == PID:
        # the torque of rotor acceleration adds gain that the geometric mixer neglects
        yaw *= max(0.5 * compute_yaw_lead(known) / small_time_constant, 1.0)
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
    return {
        block: {k: v for k, v in values.items() if kind in GAIN_BLOCKS[block][k][2]} for block, values in gains.items()
    }


def compute_yaw_lead(known: ControlModel) -> float:
    """Compute the time constant, s, of the lead that rotor acceleration adds to the yaw moment about hover."""
    slope = np.abs(known.effectiveness[2]).mean() * 2.0 * known.hover_speed
    return float(np.abs(known.yaw_reaction).mean() / slope)


def complete_settings(settings: Mapping[str, Any], known: ControlModel) -> dict[str, Any]:
    """Check the settings of a controller and fill in every default; complete settings are returned unchanged.

    settings  "controller": name; optional "gains" {block: {time constants, s}}, all blocks or none; "limits", "filter",
              "allocation", "time step" (s, used by the default gains)
    Raises ConfigError naming the key.
    """
    _check_keys(settings, CONTROLLER_SECTIONS, "controller")
    kind = find_kind(settings.get("controller", "INDI"))
    label = f"controller {CONTROLLER_LABELS[kind]}"
    step = _read_number(settings.get("time step", 0.004), f"{label}: 'time step'", *_POSITIVE_TIME)
    gains = derive_gains(kind, known, step)
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
                check, expected, _ = GAIN_BLOCKS[block][key]
                gains[block][key] = _read_number(value, f"{label}, 'gains', '{block}': '{key}'", check, expected)
    limits = _read_section(settings.get("limits"), LIMIT_DEFAULTS, f"{label}, 'limits'")
    lowpass = _read_section(settings.get("filter"), FILTER_DEFAULTS, f"{label}, 'filter'")
    return {
        "controller": CONTROLLER_LABELS[kind],
        "gains": gains,
        "limits": limits,
        "filter": lowpass,
        "allocation": _read_allocation(settings.get("allocation"), kind, label),
        "time step": step,
    }


def pack_parameters(complete: Mapping[str, Any], known: ControlModel) -> np.ndarray:
    """Parameters (MODEL_START,) of the kernels, from complete settings and the vehicle."""
    gains, limits, allocation = complete["gains"], complete["limits"], complete["allocation"]
    out = np.zeros(MODEL_START)
    out[CONTROL_MASS], out[HOVER_SPEED], out[ACTUATOR_LAG] = known.mass, known.hover_speed, known.lag + known.delay
    out[LOWEST_SPEED], out[HIGHEST_SPEED] = known.lowest, known.highest
    out[CONTROL_INERTIA : CONTROL_INERTIA + 9] = known.inertia.ravel()
    out[EFFECTIVENESS : EFFECTIVENESS + 16] = known.effectiveness.ravel()
    out[YAW_REACTION : YAW_REACTION + 4] = known.yaw_reaction
    out[ALLOCATION_WEIGHTS : ALLOCATION_WEIGHTS + 4] = allocation["weights"]
    out[USES_WEIGHTED_ALLOCATION] = ALLOCATION_METHODS[allocation["method"]]
    out[LEARNS_ROTOR_LIMITS] = float(allocation["learn rotor limits"])
    out[POSITION_GAIN] = 1.0 / gains["position"]["time constant"]
    out[VELOCITY_GAIN] = 1.0 / gains["velocity"]["time constant"]
    out[VELOCITY_INTEGRAL_GAIN] = out[VELOCITY_GAIN] * _invert_time(gains["velocity"].get("integral time", 0.0))
    out[ATTITUDE_GAIN] = 1.0 / gains["attitude"]["time constant"]
    out[YAW_GAIN] = 1.0 / gains["attitude"]["yaw time constant"]
    rates = gains["rates"]
    gain = np.array([1.0 / rates["time constant"]] * 2 + [1.0 / rates["yaw time constant"]])
    out[RATE_GAINS : RATE_GAINS + 3] = gain
    out[RATE_INTEGRAL_GAINS : RATE_INTEGRAL_GAINS + 3] = gain * _invert_time(rates.get("integral time", 0.0))
    out[RATE_DERIVATIVE_GAINS : RATE_DERIVATIVE_GAINS + 3] = gain * rates.get("derivative time", 0.0)
    out[FILTER_FREQUENCY] = 2.0 * math.pi * complete["filter"]["cut-off"]
    out[FILTER_DAMPING] = complete["filter"]["damping"]
    for place, key in ((MAX_TILT, "tilt"), (MAX_SPEED, "speed"), (MAX_CLIMB, "climb"),
                       (MAX_ACCELERATION, "acceleration"), (MAX_TILT_RATE, "rate"), (MAX_YAW_RATE, "yaw rate"),
                       (MAX_INTEGRAL, "integral")):  # fmt: skip
        out[place] = limits[key]
    out[MAX_TILT_TANGENT] = math.tan(limits["tilt"])
    return out


def _read_allocation(given: Any, kind: int, label: str) -> dict[str, Any]:
    given = {} if given is None else given
    where = f"{label}, 'allocation'"
    _check_keys(given, ALLOCATION_KEYS, where)
    # only INDI monitors its rotors, so only INDI learns limits
    default = {"method": "weighted", "weights": [1000.0, 1000.0, 1.0, 100.0], "learn rotor limits": kind == INDI}
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


def _invert_time(time: float) -> float:
    return 1.0 / time if time > 0.0 else 0.0
