"""An independent roll-out of any loads on a rigid body, written plainly, for comparison with the compiled one.

Equations of motion in body axes, attitude as a quaternion q (body to earth), position in the earth frame:

    dv/dt = F/m + R' g - omega x v      (R' g only where F is mass x specific force)
    domega/dt = I^-1 (M - omega x I omega)
    dq/dt = q (0, omega) / 2,   dx/dt = R v

Classical Runge-Kutta of fourth order, all windows together, one call of the model per stage; rotor speeds are linear
between their samples. Source: Stevens, Lewis & Johnson, Aircraft Control and Simulation, 3rd ed., 2016, section 1.7.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from quasi.attitude import GRAVITY, from_euler, multiply, normalise, rotate, rotate_inverse, to_euler
from quasi.errors import DataError, ShapeError
from quasi.model.model import Model
from quasi.simulation.tools.replay import count_steps

LoadFunction = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Body:
    """A rigid body and the loads on it.

    mass kg; inertia (3, 3) kg m2 about the cg, body axes
    wrench(state (W, 12), rotor_speeds (W, 4), rotor_accelerations (W, 4)) gives forces and moments (W, 3), body axes;
    state is roll pitch yaw, u v w (over ground), p q r, x y z
    with_gravity  whether the forces exclude gravity, so that it is added here
    """

    mass: float
    inertia: np.ndarray
    wrench: LoadFunction
    with_gravity: bool = True


def make_body(model: Model) -> Body:
    """Make the body that a model describes. Raises DataError when an axis or the mass is missing."""
    if len(model.axes) < 6:
        missing = [a for a in ("Fx", "Fy", "Fz", "Mx", "My", "Mz") if a not in model.axes]
        raise DataError(f"model {model.id} lacks {', '.join(missing)}; a roll-out needs all six axes")
    if model.airframe.mass is None:
        raise DataError(f"model {model.id} has no mass; fill in 'Mass' in the logbook and build it again")

    def wrench(state: np.ndarray, speeds: np.ndarray, accelerations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return model.predict(state, speeds, accelerations if model.uses_rotor_accelerations else None)

    return Body(model.airframe.mass, model.airframe.inertia, wrench, model.with_gravity)


def rollout_body(
    body: Body,
    t: np.ndarray,
    states: np.ndarray,
    rotor_speeds: np.ndarray,
    starts: np.ndarray,
    horizon: float,
    substeps: int = 1,
) -> np.ndarray:
    """Simulate a body from measured states with measured rotor speeds.

    t             (N,) s, evenly spaced; states (N, 12) roll pitch yaw u v w p q r x y z; rotor_speeds (N, 4) rad/s
    starts        (S,) row numbers at which a window starts; horizon s, rounded to whole samples
    substeps      integration steps per sample
    Returns (S, steps + 1, 12); a window that diverges holds inf or NaN from there on. Raises ShapeError, or DataError
    for windows beyond the data.
    """
    t, states, speeds = np.asarray(t, float), np.asarray(states, float), np.asarray(rotor_speeds, float)
    starts = np.asarray(starts, int)
    if states.shape != (len(t), 12) or speeds.shape != (len(t), 4):
        raise ShapeError(
            f"states must be ({len(t)}, 12) and rotor_speeds ({len(t)}, 4), got {states.shape}, {speeds.shape}"
        )
    steps = count_steps(t, horizon)
    if len(starts) and (starts.min() < 0 or starts.max() + steps >= len(t)):
        raise DataError(
            f"a window of {horizon:g} s that starts at row {starts.max()} leaves the {len(t)} rows; start earlier"
        )

    inverse = np.linalg.inv(body.inertia)
    state = _pack(states[starts])
    result = np.empty((len(starts), steps + 1, 12))
    result[:, 0] = _unpack(state)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(steps):
            here, there = starts + k, starts + k + 1
            span = t[there] - t[here]
            slope = (speeds[there] - speeds[here]) / span[:, None]
            for part in range(substeps):
                dt = (span / substeps)[:, None]
                begin = speeds[here] + slope * dt * part
                state = _integrate_step(body, inverse, state, begin, slope, dt)
            result[:, k + 1] = _unpack(state)
    return result


def hold_states(states: np.ndarray, starts: np.ndarray, steps: int) -> np.ndarray:
    """Baseline: hold the state of the start constant, (S, steps + 1, 12)."""
    return np.repeat(np.asarray(states, float)[np.asarray(starts, int)][:, None], steps + 1, axis=1)


def _pack(states: np.ndarray) -> np.ndarray:
    """(W, 12) to (W, 13): quaternion, velocity, rates, position."""
    q = from_euler(states[:, 0], states[:, 1], states[:, 2])
    return np.concatenate([q, states[:, 3:]], axis=1)


def _unpack(packed: np.ndarray) -> np.ndarray:
    return np.concatenate([to_euler(packed[:, :4]), packed[:, 4:]], axis=1)


def _differentiate(
    body: Body, inverse: np.ndarray, packed: np.ndarray, speeds: np.ndarray, accelerations: np.ndarray
) -> np.ndarray:
    q, v, omega = packed[:, :4], packed[:, 4:7], packed[:, 7:10]
    force, moment = body.wrench(_unpack(packed), speeds, accelerations)
    acceleration = force / body.mass - np.cross(omega, v)
    if body.with_gravity:
        acceleration = acceleration + rotate_inverse(q, np.array([0.0, 0.0, GRAVITY]))
    turn = (moment - np.cross(omega, omega @ body.inertia.T)) @ inverse.T
    spin = 0.5 * multiply(q, np.concatenate([np.zeros((len(q), 1)), omega], axis=1))
    return np.concatenate([spin, acceleration, turn, rotate(q, v)], axis=1)


def _integrate_step(
    body: Body, inverse: np.ndarray, packed: np.ndarray, speeds: np.ndarray, slope: np.ndarray, dt: np.ndarray
) -> np.ndarray:
    halfway, end = speeds + 0.5 * dt * slope, speeds + dt * slope
    a = _differentiate(body, inverse, packed, speeds, slope)
    b = _differentiate(body, inverse, packed + 0.5 * dt * a, halfway, slope)
    c = _differentiate(body, inverse, packed + 0.5 * dt * b, halfway, slope)
    d = _differentiate(body, inverse, packed + dt * c, end, slope)
    packed = packed + dt / 6.0 * (a + 2 * b + 2 * c + d)
    # the four stages leave the unit sphere by a fifth-order error
    packed[:, :4] = normalise(packed[:, :4])
    return packed


def trim_before(missing: np.ndarray, starts: np.ndarray, window: int, margin: int) -> np.ndarray:
    """Compute the trim (S, 6) that the flight itself shows before each start: constant force, N, and moment, N m.

    A battery put back elsewhere or a propeller changed shifts the trim of a flight; no model of other flights can know
    it. It is the mean of what the model misses over `window` rows.

    missing  (N, 6) measured minus predicted Fx .. Mz of a filtered flight, NaN in rows that are not to be used
    starts   (S,) rows; window  rows that are averaged; margin  rows between their end and the start, at least the half
    length of the flight's low-pass, which looks ahead by that much
    The trim is 0 where fewer than a quarter of the rows can be used.
    """
    used = np.isfinite(missing).all(axis=1)
    sums = np.vstack([np.zeros(6), np.cumsum(np.where(used[:, None], missing, 0.0), axis=0)])
    counts = np.concatenate([[0], np.cumsum(used)])
    last = np.maximum(np.asarray(starts, int) - margin, 0)
    first = np.maximum(last - window, 0)
    rows = counts[last] - counts[first]
    enough = rows > 0.25 * window
    return np.where(enough[:, None], (sums[last] - sums[first]) / np.maximum(rows, 1)[:, None], 0.0)
