"""A model in hover: rotor speed that carries the weight, usual values of further inputs, hover position."""

import numpy as np
from scipy.optimize import brentq

from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.model.model import AXES, Model


def find_hover_speed(model: Model, highest: float | None = None) -> float:
    """Common rotor speed, rad/s, at which the model's Fz balances its weight at rest; raises DataError without one."""
    weight = model.airframe.mass * GRAVITY if model.with_gravity else 0.0
    guess = model.hover_speed or (0.6 * highest if highest else 1000.0)

    def residual(speed: np.ndarray) -> np.ndarray:
        speeds = np.repeat(np.atleast_1d(speed)[:, None], 4, axis=1)
        return predict_at_rest(model, speeds)[0][:, 2] + weight

    mesh = np.linspace(0.05 * guess, 4.0 * guess, 800)
    values = residual(mesh)
    found = np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))
    if not len(found):
        raise DataError(
            f"model {model.id} has no common rotor speed that carries its weight of {weight:.2f} N from "
            f"{mesh[0]:.0f} to {mesh[-1]:.0f} rad/s; check the mass, the pole count and the sign of Fz"
        )
    first = found[np.argmin(np.abs(mesh[found] - guess))]
    return float(brentq(lambda speed: residual(speed)[0], mesh[first], mesh[first + 1], xtol=1e-12 * guess))


def check_flyable(model: Model, purpose: str) -> None:
    """Raise DataError where an axis or the mass is unknown. purpose  what needs them, as in "a simulation"."""
    lacking = [axis for axis in AXES if axis not in model.axes]
    if lacking:
        raise DataError(f"model {model.id} lacks {', '.join(lacking)}; {purpose} needs all six axes")
    if model.airframe.mass is None:
        raise DataError(f"model {model.id} has no mass; fill in 'Mass' in the logbook and build it again")


def find_training_median(model: Model, name: str) -> float | None:
    """Median of an input over the model's training data; None where it is unknown."""
    covered = (model.document.get("envelope") or {}).get(name, {})
    return covered.get("percentiles", {}).get("50")


def list_usual_inputs(model: Model) -> np.ndarray:
    """List usual values of the model's further inputs (battery_voltage, ...), the medians of its training data, or
    zero.
    """
    return np.array([find_training_median(model, name) or 0.0 for name in model.inputs[20:]])


def find_hover_position(model: Model) -> np.ndarray:
    """Find the hover position (3,), m, earth NED: the middle of the training data, else 1 m above the floor.

    It matters only to models with terms in the position (ground effect, walls); others use the origin.
    """
    if not model.kernel.used[9:12].any():
        return np.zeros(3)
    middle = [find_training_median(model, name) for name in "xyz"]
    return np.array([free if known is None else known for known, free in zip(middle, (0.0, 0.0, -1.0))])


def predict_at_rest(
    model: Model, speeds: np.ndarray, accelerations: np.ndarray | None = None
) -> tuple[np.ndarray, ...]:
    """Forces and moments (N, 3) at rest, level, at these rotor speeds (N, 4)."""
    turn = np.zeros_like(speeds) if accelerations is None else accelerations
    further = dict(zip(model.inputs[20:], list_usual_inputs(model)))
    state = np.zeros((len(speeds), 12))
    state[:, 9:] = find_hover_position(model)
    return model.predict(state, speeds, turn, further)
