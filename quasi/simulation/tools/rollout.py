"""Open-loop roll-outs of a model from measured states with measured rotor speeds, and the norms of their errors."""

from collections.abc import Mapping

import numpy as np

from quasi.attitude import from_euler, rotate
from quasi.model.model import Model
from quasi.simulation.tools.replay import count_steps as count_steps  # of a horizon, for callers of `rollout`
from quasi.simulation.tools.replay import replay, to_euler_states


def rollout(
    model: Model,
    t: np.ndarray,
    states: np.ndarray,
    rotor_speeds: np.ndarray,
    starts: np.ndarray,
    horizon: float,
    substeps: int = 1,
    wind: np.ndarray | None = None,
    extra: Mapping[str, np.ndarray] | None = None,
    offsets: np.ndarray | None = None,
) -> np.ndarray:
    """Simulate from measured states with measured rotor speeds; arguments and errors as `replay.replay`.

    Returns (S, steps + 1, 12) roll pitch yaw u v w p q r x y z: the first is the measured state, the last lies
    `horizon` later; angles in (-pi, pi].
    """
    return to_euler_states(
        replay(model, t, states, rotor_speeds, starts, horizon, None, None, wind, extra, offsets, substeps)
    )


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
