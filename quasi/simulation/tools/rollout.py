"""Open-loop roll-outs: the rigid body from measured states with measured rotor speeds, for many windows at once.

Equations of motion in body axes, attitude as a quaternion q (body to earth), position in the earth frame:

    dv/dt = F/m + R' g - omega x v      (R' g only where F is mass x specific force)
    domega/dt = I^-1 (M - omega x I omega)
    dq/dt = q (0, omega) / 2,   dx/dt = R v

Classical Runge-Kutta of fourth order, all windows together, one call of the model per stage; rotor speeds are linear
between their samples. Source: Stevens, Lewis & Johnson, Aircraft Control and Simulation, 3rd ed., 2016, section 1.7.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from quasi.attitude import GRAVITY, from_euler, multiply, normalise, rotate, rotate_inverse, to_euler
from quasi.errors import DataError, ShapeError
from quasi.model.model import Model
from quasi.simulation.tools.replay import count_steps, replay, to_euler_states

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


def rollout(
    model: Model | Body,
    t: np.ndarray,
    states: np.ndarray,
    rotor_speeds: np.ndarray,
    starts: np.ndarray,
    horizon: float,
    substeps: int = 1,
    wind: np.ndarray | None = None,
    extra: Mapping[str, np.ndarray] | None = None,
) -> np.ndarray:
    """Simulate from measured states with measured rotor speeds.

    model         a model (compiled, see `replay`), or a Body with any function for its forces and moments
    t             (N,) s, evenly spaced; states (N, 12) roll pitch yaw u v w p q r x y z; rotor_speeds (N, 4) rad/s
    starts        (S,) row numbers at which a window starts; horizon s, rounded to whole samples
    substeps      integration steps per sample
    wind          (N, 3) velocity of the air, m/s, earth axes; extra {name: (N,)} further inputs; both of models alone
    Returns (S, steps + 1, 12): the first is the measured state, the last lies `horizon` later; angles in (-pi, pi].
    A window that diverges holds inf or NaN from there on. Raises ShapeError, or DataError for windows beyond the data.
    """
    if isinstance(model, Model):
        return to_euler_states(
            replay(model, t, states, rotor_speeds, starts, horizon, None, None, wind, extra, None, substeps)
        )
    if wind is not None or extra is not None:
        raise DataError("wind and further inputs can be given with a model, not with a Body; put them into its wrench")
    body = model
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


def compute_errors(predicted: np.ndarray, states: np.ndarray, starts: np.ndarray) -> dict[str, np.ndarray]:
    """Compute the norms of the roll-out errors, each (S, steps + 1).

    predicted (S, steps + 1, 12), states (N, 12) measured, starts (S,)
    "position" m, in the earth frame; "velocity" m/s, each rotated to the earth frame by its own attitude;
    "attitude" rad, the angle of the rotation between them; "rate" rad/s
    """
    steps = predicted.shape[1]
    rows = np.asarray(starts, int)[:, None] + np.arange(steps)
    measured = np.asarray(states, float)[rows]
    q, q_measured = (from_euler(*np.moveaxis(s[..., :3], -1, 0)) for s in (predicted, measured))
    cosine = np.abs(np.sum(q * q_measured, axis=-1))
    velocity = rotate(q, predicted[..., 3:6]) - rotate(q_measured, measured[..., 3:6])
    return {
        "position": np.linalg.norm(predicted[..., 9:] - measured[..., 9:], axis=-1),
        "velocity": np.linalg.norm(velocity, axis=-1),
        "attitude": 2.0 * np.arccos(np.minimum(cosine, 1.0)),
        "rate": np.linalg.norm(predicted[..., 6:9] - measured[..., 6:9], axis=-1),
    }


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
