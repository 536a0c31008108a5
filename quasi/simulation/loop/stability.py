"""Whether an integrator can follow a vehicle's own motions: its linearised dynamics about hover, and the step.

Source: Hairer & Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, section IV.2.
"""

from typing import Any

import numpy as np

from quasi.errors import ConfigError
from quasi.simulation.vehicle.dynamics import INTEGRATORS, derivative, scratch_of, with_rest
from quasi.simulation.vehicle.layout import INFLOW_LAG, OWN, ROTORS, SLOPE, STATES, UP

_ACCURATE = {"rk4": 0.7, "euler": 0.2}  # fastest rate x step beyond which a method follows a mode badly


def linearised(body: np.ndarray, kernel: Any, held: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Jacobian of the state derivative (17 + own,) in hover x (17,), rotors commanded to stay: central differences."""
    scratch = scratch_of(kernel, int(body[OWN]))
    x = with_rest(x, held, kernel, body)
    at = held.copy()
    at[SLOPE : SLOPE + 4] = np.where(body[UP : UP + 4] > 0.0, np.nan, 0.0)
    result = np.empty((len(x), len(x)))
    late = STATES + 4 * (body[INFLOW_LAG] > 0.0)  # rotor speeds and those that the air belongs to
    for k in range(len(x)):
        step = 1e-4 * x[ROTORS] if ROTORS <= k < late else 1e-4
        both = []
        for sign in (1.0, -1.0):
            y = x.copy()
            y[k] += sign * step
            derivative(y, at, kernel, body, scratch.inputs, scratch.work, scratch.loads, scratch.slopes)
            both.append(scratch.slopes[0].copy())
        result[:, k] = (both[0] - both[1]) / (2.0 * step)
    return result


def check_step(
    body: np.ndarray, kernel: Any, held: np.ndarray, x: np.ndarray, h: float, method: str, notes: list[str], name: str
) -> None:
    """Refuse a step at which the method makes a mode grow that decays; note one that it follows badly.

    Growth per step: |1 + z| for Euler, |1 + z + z^2/2 + z^3/6 + z^4/24| for Runge-Kutta, z = mode x step.
    """
    if method not in INTEGRATORS:
        return  # it chooses its steps itself
    modes = np.linalg.eigvals(linearised(body, kernel, held, x))
    decaying = modes[modes.real < -1e-2 * np.abs(modes).max()]
    if not len(decaying):
        return

    def growth(step: float) -> float:
        z = decaying * step
        return float(np.max(np.abs(1 + z if method == "euler" else 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)))

    fastest = float(np.max(np.abs(decaying)))
    if growth(h) > 1.0:
        longest = h
        while growth(longest) > 1.0:
            longest *= 0.98
        raise ConfigError(
            f"{name}: a step of {h:g} s is unstable: the fastest motion (rotor lag or damping, time constant "
            f"{1.0 / fastest:.4g} s) grows with '{method}'; use a 'time step' of at most {longest:.3g} s or more "
            "'substeps'"
        )
    if fastest * h > _ACCURATE[method]:
        notes.append(
            f"a step of {h:g} s follows the fastest motion (time constant {1.0 / fastest:.4g} s) badly with "
            f"'{method}'; use a shorter 'time step' or more 'substeps'"
        )
