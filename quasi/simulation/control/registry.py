"""The compiled controllers. A new one needs its own file, an entry in LAWS and a branch in `run_law`."""

from typing import Any

from numba import njit

from quasi.errors import ConfigError, nearest
from quasi.simulation.control.indi import INDI, run_indi
from quasi.simulation.control.law import Law
from quasi.simulation.control.ndi import NDI, run_ndi
from quasi.simulation.control.pid import PID, run_pid

LAWS = (PID, NDI, INDI)
CONTROLLER_NAMES = {
    prefix + law.name: law for prefix in ("drone_", "") for law in LAWS
}  # the manual's names and short ones


@njit(cache=True, error_model="numpy")
def run_law(kind, parameters, packed, memory, dt, measurement, setpoint):
    """Set the wanted loads by the law that has the place `kind` in LAWS."""
    if kind == 0:
        run_pid(parameters, memory, dt, measurement, setpoint)
    elif kind == 1:
        run_ndi(parameters, packed, memory, dt, measurement, setpoint)
    else:
        run_indi(parameters, memory, dt, measurement, setpoint)


def find_law(name: Any) -> Law:
    """The law of a controller's name; raises ConfigError that names the nearest known one."""
    for known, law in CONTROLLER_NAMES.items():
        if str(name).lower() == known.lower():
            return law
    raise ConfigError(f"controller {name!r} is not known{nearest(str(name), CONTROLLER_NAMES)}; choose one of them")
