"""What a controller believes of the vehicle: mass, inertia, rotor effectiveness and lag, all read from the model.

Everything is asked of the model's own forces and moments about hover, so that any set of terms will do.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from quasi.airframe import Airframe
from quasi.attitude import GRAVITY
from quasi.errors import ConfigError, DataError
from quasi.model.extensions import drive_of
from quasi.model.hover import extras, hover_speed, predict_at_rest, usual_place
from quasi.model.model import Model

__all__ = ["ControlModel", "by_geometry", "control_model", "extras", "hover_speed", "trim", "usual_place"]

DEFAULT_LAG = 1.0 / 35.0  # s, where the model knows no time constants
_HIGHEST, _LOWEST = 2.0, 0.1  # of the hover speed, where the airframe knows no limits


@dataclass(frozen=True)
class ControlModel:
    """Rigid body and rotors as a controller sees them.

    mass kg; inertia (3, 3) kg m2
    hover_speed     rad/s, the common rotor speed at which the model carries its weight
    effectiveness   (4, 4): rows Mx My Mz (N m) and Fz (N), columns the rotors, per (rad/s)^2, about hover
    yaw_reaction    (4,) N m per rad/s2: the moment Mz of each rotor's acceleration
    lowest, highest rad/s, range of the rotor speeds
    lag, delay      s, of the actuators
    """

    name: str
    airframe: Airframe
    mass: float
    inertia: np.ndarray
    hover_speed: float
    effectiveness: np.ndarray
    yaw_reaction: np.ndarray
    lowest: float
    highest: float
    lag: float
    delay: float


def control_model(model: Model, actuators: Mapping[str, Any] | None = None) -> ControlModel:
    """Read a model about hover.

    actuators  optional "time constants" (a number or four, s), "delay" (s), "lowest", "highest" (rad/s); what is left
               out comes from the model's own actuators and the airframe
    Raises DataError for a model that cannot hover or whose rotors cannot steer, ConfigError for impossible actuators.
    """
    name = model.id
    airframe = model.airframe
    if airframe.mass is None:
        raise DataError(f"model {name} knows no mass; fill in 'Mass' in the logbook and make it anew")
    given = dict(actuators or {})
    limits = [_limit(given, key, rpm, airframe) for key, rpm in (("lowest", "idle_rpm"), ("highest", "max_rpm"))]
    hover = hover_speed(model, limits[1])
    highest = limits[1] if limits[1] is not None else _HIGHEST * hover
    lowest = limits[0] if limits[0] is not None else _LOWEST * hover
    if not 0.0 <= lowest < hover < highest:
        raise ConfigError(
            f"model {name}: rotor speeds from {lowest:.0f} to {highest:.0f} rad/s leave no room about its hover speed "
            f"{hover:.0f} rad/s; correct 'idle RPM', 'max RPM' and 'motor poles' of the quadrotor configuration"
        )
    lag = float(np.mean(_positive(given.get("time constants", _own_lags(model)), f"model {name}, 'time constants'")))
    delay = float(given.get("delay", 0.0))
    if not (np.isfinite(delay) and delay >= 0.0):
        raise ConfigError(f"model {name}: the actuators' 'delay' is {delay:g}, expected 0 s or more")
    effectiveness, reaction = _slopes(model, hover)
    known = ControlModel(
        name, airframe, float(airframe.mass), np.asarray(airframe.inertia, float), hover, effectiveness, reaction,
        lowest, highest, lag, delay,
    )  # fmt: skip
    _check_steering(known)
    return known


def by_geometry(known: ControlModel) -> ControlModel:
    """The same vehicle with the mixer of a plain autopilot: hub positions and spins, one thrust and one torque factor.

    Thrust f u at hub (x, y) gives Mx = -y f u, My = x f u; a rotor that turns clockwise is pushed anticlockwise.
    The factors are those of the model about hover; rotor accelerations are left out.
    """
    hubs, spin = known.airframe.hubs, known.airframe.spin
    thrust = -float(np.mean(known.effectiveness[3]))
    torque = -float(np.mean(spin * known.effectiveness[2]))
    # levers are those at which the model's rotors act, which a flexible frame or offset hubs may shift
    x, y = hubs[:, 0] * thrust, -hubs[:, 1] * thrust
    scale_roll = float(y @ known.effectiveness[0] / (y @ y))
    scale_pitch = float(x @ known.effectiveness[1] / (x @ x))
    mixer = np.array([scale_roll * y, scale_pitch * x, -torque * spin, np.full(4, -thrust)])
    return replace(known, effectiveness=mixer, yaw_reaction=np.zeros(4))


def trim(model: Model, start: float) -> np.ndarray:
    """Rotor speeds (4,), rad/s, at which the model hovers without moments, by Newton's method from a common speed.

    Raises DataError when there are none: the model's moments about hover are beyond what its rotors can balance.
    """
    weight = model.airframe.mass * GRAVITY if model.with_gravity else 0.0
    speeds = np.full(4, float(start))

    def lack(at: np.ndarray) -> np.ndarray:
        force, moment = predict_at_rest(model, at[None])
        return np.array([*moment[0], force[0, 2] + weight])

    for _ in range(50):
        steps = 1e-4 * start * np.eye(4)
        jacobian = np.column_stack([(lack(speeds + s) - lack(speeds - s)) / (2e-4 * start) for s in steps])
        change = np.linalg.solve(jacobian, lack(speeds))
        speeds = speeds - change
        if np.max(np.abs(change)) < 1e-10 * start:
            return speeds
    raise DataError(
        f"model {model.id} has no rotor speeds at which it hovers without moments; "
        "switch 'correct for moment asymmetries' on"
    )


def _slopes(model: Model, hover: float) -> tuple[np.ndarray, np.ndarray]:
    """Effectiveness per (rad/s)^2 and yaw moment per rad/s2, by central differences about hover."""

    def wrench(speeds: np.ndarray, accelerations: np.ndarray) -> np.ndarray:
        force, moment = predict_at_rest(model, speeds, accelerations)
        return np.column_stack([moment, force[:, 2]]).T

    level, still = np.full((4, 4), hover), np.zeros((4, 4))
    step = 1e-3 * hover
    up, down = level + step * np.eye(4), level - step * np.eye(4)
    per_square = (wrench(up, still) - wrench(down, still)) / (4.0 * hover * step)
    turn = 100.0 * np.eye(4)
    reaction = (wrench(level, turn) - wrench(level, -turn))[2] / 200.0
    # a reaction against the torque's own sign would make its inverse unstable: it is then left out
    ratio = reaction @ per_square[2]
    return per_square, reaction if ratio > 0.0 else np.zeros(4)


def _check_steering(known: ControlModel) -> None:
    scale = np.abs(known.effectiveness).sum(axis=1)
    names = ("Mx", "My", "Mz", "Fz")
    dead = [n for n, s in zip(names, scale) if not (np.isfinite(s) and s > 0.0)]
    if dead:
        raise DataError(
            f"model {known.name}: {dead[0]} does not answer to the rotor speeds, so it cannot be controlled; identify "
            "it with a term in the rotor speeds (U_p, U_q, U_r, w_tot ...)"
        )
    if np.linalg.cond(known.effectiveness / scale[:, None]) > 1e4:
        raise DataError(
            f"model {known.name}: the four rotors cannot set Mx, My, Mz and Fz independently about hover; "
            "check 'rotor config' and the rotors' spins"
        )


def _own_lags(model: Model) -> Any:
    constants = (drive_of(model.document).get("time constants") or {}).get("value")
    return DEFAULT_LAG if constants is None else constants


def _positive(value: Any, where: str) -> np.ndarray:
    try:
        values = np.atleast_1d(np.asarray(value, float))
    except (TypeError, ValueError):
        values = np.array([np.nan])
    if values.size not in (1, 4) or not np.all(np.isfinite(values)) or np.any(values <= 0.0):
        raise ConfigError(f"{where} is {value!r}, expected one or four positive numbers of seconds")
    return values


def _limit(given: Mapping[str, Any], key: str, rpm: str, airframe: Airframe) -> float | None:
    if given.get(key) is not None:
        return float(given[key])
    logged, factor = getattr(airframe, rpm), airframe.logged_to_rad_s
    return None if logged is None or factor is None else logged * factor
