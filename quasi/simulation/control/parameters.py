"""The flat array of parameters that the kernels of all controllers read: its places, and how it is filled."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from quasi.simulation.control.control_model import ControlModel

ALLOCATION_METHODS = {"inverse": 0.0, "weighted": 1.0}

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


def _invert_time(time: float) -> float:
    return 1.0 / time if time > 0.0 else 0.0
