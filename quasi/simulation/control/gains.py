"""Settings of the controllers: gains as time constants, limits, filters, allocation; checked, with defaults.

The default time constants follow the damping optimum: each loop is twice as slow as the one inside it. The
innermost is twice as slow as the sum of the small time constants: lag and delay of the actuators, half a sample, and
the delay of a filter in the loop. Source: Kessler, Das symmetrische Optimum, Regelungstechnik 6, 1958; Schroeder,
Elektrische Antriebe - Regelung von Antriebssystemen, 4th ed., 2015, section 3.3.
"""

import math
from collections.abc import Mapping
from typing import Any

from quasi.errors import ConfigError, nearest
from quasi.model.document import is_number
from quasi.project import configuration
from quasi.simulation.control.control_model import ControlModel
from quasi.simulation.control.law import Law
from quasi.simulation.control.registry import find_law

# settings that do not depend on the vehicle, in units of the schema
LIMITS = {"tilt": math.radians(55.0), "speed": 8.0, "climb": 4.0, "acceleration": 10.0, "rate": 8.0, "yaw rate": 3.0,
          "integral": 3.0}  # fmt: skip
FILTER = {"cut-off": 8.0, "damping": 0.7}
ALLOCATION = {"method": "weighted", "weights": [1000.0, 1000.0, 1.0, 100.0]}


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

    settings  the section "controller" of a simulation, see its schema; "time step" (s) is used by the default gains
    Raises ConfigError naming the key.
    """
    law = find_law(settings.get("controller", "INDI"))
    label, step = f"controller {law.name}", settings.get("time step", 0.004)
    if not (is_number(step) and step > 0.0):
        raise ConfigError(f"{label}: 'time step' is {step!r}, expected a positive number of seconds")
    given = {k: v for k, v in settings.items() if k not in ("controller", "time step") and v is not None}
    given, _ = configuration.check(given, "simulation", label, "properties", "controller")
    gains = derive_gains(law, known, step)
    for block, values in given.get("gains", {}).items():
        for key, value in values.items():
            if key not in gains[block]:
                raise ConfigError(f"{label}, 'gains', '{block}': unknown key '{key}'{nearest(key, gains[block])}")
            gains[block][key] = value
    return {
        "controller": law.name,
        "gains": gains,
        "limits": {**LIMITS, **given.get("limits", {})},
        "filter": {**FILTER, **given.get("filter", {})},
        "allocation": {**ALLOCATION, "learn rotor limits": law.learns_limits, **given.get("allocation", {})},
        "time step": step,
    }
