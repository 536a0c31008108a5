"""Check whether an integrator is stable for a vehicle's linearised dynamics about hover and a step size.

Source: Hairer & Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, section IV.2.
"""

from typing import Any

import numpy as np

from quasi.errors import ConfigError
from quasi.simulation.vehicle.dynamics import (
    INTEGRATORS,
    append_extra_states,
    compute_loads,
    equations_of_motion,
    make_scratch,
)
from quasi.simulation.vehicle.layout import (
    EXTRA_STATES,
    GIVEN_ACCELERATION,
    INFLOW_LAG,
    LAG_UP,
    ROTOR_SPEEDS,
    STATE_SIZE,
)

_MAX_STEP_TIMES_RATE = {"rk4": 0.7, "euler": 0.2}  # fastest rate x step beyond which a method is inaccurate


def linearise_state(body: np.ndarray, kernel: Any, step_inputs: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Jacobian of the state derivative (17 + extra states,) in hover x (17,), constant commands."""
    scratch = make_scratch(kernel, int(body[EXTRA_STATES]))
    x = append_extra_states(x, step_inputs, kernel, body)
    at = step_inputs.copy()
    at[GIVEN_ACCELERATION : GIVEN_ACCELERATION + 4] = np.where(body[LAG_UP : LAG_UP + 4] > 0.0, np.nan, 0.0)
    result = np.empty((len(x), len(x)))
    late = STATE_SIZE + 4 * (body[INFLOW_LAG] > 0.0)  # rotor speeds and those of the inflow
    for k in range(len(x)):
        step = 1e-4 * x[ROTOR_SPEEDS] if ROTOR_SPEEDS <= k < late else 1e-4
        both = []
        for sign in (1.0, -1.0):
            y = x.copy()
            y[k] += sign * step
            compute_loads(y, at, kernel, body, scratch.inputs, scratch.work, scratch.loads)
            equations_of_motion(y, scratch.loads, at, body, scratch.derivatives, 0)
            both.append(scratch.derivatives[0].copy())
        result[:, k] = (both[0] - both[1]) / (2.0 * step)
    return result


def check_step(
    body: np.ndarray,
    kernel: Any,
    step_inputs: np.ndarray,
    x: np.ndarray,
    h: float,
    method: str,
    notes: list[str],
    name: str,
) -> None:
    """Reject a step at which a decaying mode grows with this method; note a step that is inaccurate.

    Growth per step: |1 + z| for Euler, |1 + z + z^2/2 + z^3/6 + z^4/24| for Runge-Kutta, z = mode x step.
    """
    if method not in INTEGRATORS:
        return  # an adaptive method chooses its steps itself
    modes = np.linalg.eigvals(linearise_state(body, kernel, step_inputs, x))
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
    if fastest * h > _MAX_STEP_TIMES_RATE[method]:
        notes.append(
            f"a step of {h:g} s follows the fastest motion (time constant {1.0 / fastest:.4g} s) badly with "
            f"'{method}'; use a shorter 'time step' or more 'substeps'"
        )
