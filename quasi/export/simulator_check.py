"""Whether an exported simulator file agrees with the model: its numbers, parsed back, against `Model.predict`."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from quasi.attitude import GRAVITY
from quasi.export.agreement import Check, compare
from quasi.model.extensions import Actuators, actuators_of
from quasi.model.hover import find_hover_position, find_hover_speed, list_usual_inputs, predict_at_rest
from quasi.model.model import Model

RECOVERY_LIMIT = 1e-6  # relative; the files hold nine digits
LIMIT_SLOPES = 1e-4  # of moments by the rotor speeds: two difference quotients about hover with different steps
QUOTIENT_STEP = 2e-3  # of the hover speed, for those quotients


class Recovered(NamedTuple):
    """What a file holds, body axes x forward, y right, z down; None where the format does not hold it.

    mass kg; inertia (3, 3) kg m2 of the whole vehicle; hover_thrust N, of all rotors at the model's hover speed
    moments  (3, 4) N m/(rad/s)^2: Mx My Mz of each rotor by the square of its speed
    times    {which time constants: s}, the names those of `time_constants_of`
    highest rad/s; drag N/(m/s), horizontal, mean of forwards and sideways, in hover
    pitching N m/(m/s), dMy/du and -dMx/dv (2,), or their mean
    damping  (3,) N m/(rad/s), moments against p q r in hover
    """

    mass: float | None = None
    inertia: np.ndarray | None = None
    hover_thrust: float | None = None
    moments: np.ndarray | None = None
    times: Mapping[str, np.ndarray | float] | None = None
    highest: float | None = None
    drag: float | None = None
    pitching: np.ndarray | float | None = None
    damping: np.ndarray | None = None


def moments_of(positions: np.ndarray, thrust: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """(3, 4) moments of rotors at positions (4, 3) m, FRD, with thrust (4,) upwards and torque Mz (4,)."""
    positions = np.asarray(positions, float)
    return np.array([-positions[:, 1] * thrust, positions[:, 0] * thrust, torque])


def time_constants_of(rotors: Actuators) -> dict[str, np.ndarray | float]:
    """Time constants, s, as formats hold them: four and four, one up and one down, or four of both directions."""
    return {
        "up": rotors.up,
        "down": rotors.down,
        "up, mean of rotors": float(np.mean(rotors.up)),
        "down, mean of rotors": float(np.mean(rotors.down)),
        "mean of up and down": 0.5 * (rotors.up + rotors.down),
    }


def check_recovered(model: Model, found: Recovered) -> list[Check]:
    """Compare what a file says with the model, quantity by quantity.

    Moments are compared in the patterns of roll, pitch and yaw: a file holds one factor each, the model four.
    """
    frame, checks = model.airframe, []
    rotors = actuators_of(model)
    hover = find_hover_speed(model, rotors.highest if np.isfinite(rotors.highest) else None)
    weight = float(frame.mass) * GRAVITY
    level = predict_at_rest(model, np.full((1, 4), hover))[0][0, 2]
    thrust = weight - level if not model.with_gravity else -level
    drag, pitching = _by_velocity(model, hover)
    patterns = np.array([-frame.hubs[:, 1], frame.hubs[:, 0], -frame.spin])
    reference: dict[str, tuple[object, object, list[str], float]] = {
        "mass": (found.mass, frame.mass, ["mass"], RECOVERY_LIMIT),
        "inertia": (found.inertia, frame.inertia, [f"I{a}{b}" for a in "xyz" for b in "xyz"], RECOVERY_LIMIT),
        "hover thrust": (found.hover_thrust, thrust, ["thrust"], RECOVERY_LIMIT),
        "moments by rotor speed": (
            None if found.moments is None else np.sum(found.moments * patterns, axis=1),
            np.sum(_slopes(model, hover) * patterns, axis=1),
            ["roll", "pitch", "yaw"],
            LIMIT_SLOPES,
        ),
        "highest speed": (found.highest, rotors.highest, ["speed"], RECOVERY_LIMIT),
        "horizontal drag": (found.drag, max(drag, 0.0), ["drag"], RECOVERY_LIMIT),
        "pitching moment": (
            found.pitching,
            pitching if np.size(found.pitching) == 2 else pitching.mean(),
            ["by forward velocity", "by sideways velocity"],
            RECOVERY_LIMIT,
        ),
        "rate damping": (found.damping, _damping(model, hover), ["roll", "pitch", "yaw"], RECOVERY_LIMIT),
    }
    known = time_constants_of(rotors)
    for which, value in (found.times or {}).items():
        names = [f"rotor {i}" for i in range(1, 5)] if np.size(known[which]) == 4 else [which]
        reference[f"time constants {which}"] = (value, known[which], names, RECOVERY_LIMIT)
    for what, (value, expected, names, limit) in reference.items():
        if value is not None:
            row = np.reshape(np.asarray(value, float), (1, -1))
            checks.append(compare(what, row, np.reshape(np.asarray(expected, float), (1, -1)), names, limit))
    return checks


def _slopes(model: Model, hover: float) -> np.ndarray:
    """(3, 4) moments by the square of each rotor's speed about hover, by `Model.predict`."""
    step = QUOTIENT_STEP * hover * np.eye(4)
    level = np.full((4, 4), hover)
    up, down = (predict_at_rest(model, level + sign * step)[1] for sign in (1.0, -1.0))
    return (up - down).T / (4.0 * hover * QUOTIENT_STEP * hover)


def _by_velocity(model: Model, hover: float) -> tuple[float, np.ndarray]:
    """Mean horizontal force against, N/(m/s), and dMy/du and -dMx/dv (2,), N m/(m/s), by `Model.predict`.

    From 1 m/s forwards, backwards and to both sides in hover.
    """
    state = np.zeros((4, 12))
    state[:, 9:] = find_hover_position(model)
    state[[0, 1], 3], state[[2, 3], 4] = (1.0, -1.0), (1.0, -1.0)
    speeds, further = np.full((4, 4), hover), dict(zip(model.inputs[20:], list_usual_inputs(model)))
    force, moment = model.predict(state, speeds, np.zeros((4, 4)), further)
    against = force[1, 0] - force[0, 0] + force[3, 1] - force[2, 1]
    across = np.array([moment[0, 1] - moment[1, 1], moment[3, 0] - moment[2, 0]])
    return float(0.25 * against), 0.5 * across


def _damping(model: Model, hover: float) -> np.ndarray:
    """(3,) N m/(rad/s): moments against 1 rad/s of p, q, r in both directions, in hover, by `Model.predict`."""
    state = np.zeros((6, 12))
    state[:, 9:] = find_hover_position(model)
    state[:3, 6:9], state[3:, 6:9] = np.eye(3), -np.eye(3)
    speeds, further = np.full((6, 4), hover), dict(zip(model.inputs[20:], list_usual_inputs(model)))
    moment = model.predict(state, speeds, np.zeros((6, 4)), further)[1]
    return 0.5 * np.diag(moment[3:] - moment[:3])
