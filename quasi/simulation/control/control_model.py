"""The vehicle as a controller knows it: mass, inertia, rotor effectiveness and lag, all read from the model.

The constants come from the model's forces and moments about hover, so any set of terms works.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from quasi.airframe import Airframe
from quasi.errors import ConfigError, DataError
from quasi.model.extensions import DEFAULT_LAG, drive_of, read_speed_limits
from quasi.model.hover import find_hover_speed, predict_at_rest
from quasi.model.model import Model

_HIGHEST_SPEED_RATIO, _LOWEST_SPEED_RATIO = 2.0, 0.1  # of the hover speed, where the airframe has no limits


@dataclass(frozen=True)
class ControlModel:
    """Rigid body and rotors as a controller knows them.

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


def make_control_model(model: Model, actuators: Mapping[str, Any] | None = None) -> ControlModel:
    """Read a model about hover.

    actuators  optional "time constants" (a number or four, s), "delay" (s), "lowest", "highest" (rad/s); what is left
               out comes from the model's own actuators and the airframe
    Raises DataError for a model that cannot hover or whose rotors cannot steer, ConfigError for impossible actuators.
    """
    name = model.id
    airframe = model.airframe
    if airframe.mass is None:
        raise DataError(f"model {name} knows no mass; fill in 'Mass' in the logbook and build it again")
    given = dict(actuators or {})
    limits = [
        known if given.get(key) is None else float(given[key])
        for key, known in zip(("lowest", "highest"), read_speed_limits(model))
    ]
    hover = find_hover_speed(model, limits[1])
    highest = limits[1] if limits[1] is not None else _HIGHEST_SPEED_RATIO * hover
    lowest = limits[0] if limits[0] is not None else _LOWEST_SPEED_RATIO * hover
    if not 0.0 <= lowest < hover < highest:
        raise ConfigError(
            f"model {name}: rotor speeds from {lowest:.0f} to {highest:.0f} rad/s leave no room about its hover speed "
            f"{hover:.0f} rad/s; correct 'idle RPM', 'max RPM' and 'motor poles' of the quadrotor configuration"
        )
    own = (drive_of(model.document).get("time constants") or {}).get("value")
    own = DEFAULT_LAG if own is None else own
    lag = float(np.mean(_read_times(given.get("time constants", own), f"model {name}, 'time constants'")))
    delay = float(given.get("delay", 0.0))
    if not (np.isfinite(delay) and delay >= 0.0):
        raise ConfigError(f"model {name}: the actuators' 'delay' is {delay:g}, expected 0 s or more")
    effectiveness, reaction = _linearise_rotors(model, hover)
    vehicle = ControlModel(
        name, airframe, float(airframe.mass), np.asarray(airframe.inertia, float), hover, effectiveness, reaction,
        lowest, highest, lag, delay,
    )  # fmt: skip
    _check_steering(vehicle)
    return vehicle


def use_geometric_mixer(vehicle: ControlModel) -> ControlModel:
    """Replace the effectiveness by the mixer of a plain autopilot: hub positions, spins, one thrust and torque factor.

    Thrust f u at hub (x, y) gives Mx = -y f u, My = x f u; a clockwise rotor gives an anticlockwise moment.
    The factors are those of the model about hover; rotor accelerations are neglected.
    """
    hubs, spin = vehicle.airframe.hubs, vehicle.airframe.spin
    thrust = -float(np.mean(vehicle.effectiveness[3]))
    torque = -float(np.mean(spin * vehicle.effectiveness[2]))
    # the levers at which the model's rotors act; a flexible frame or offset hubs may shift them
    x, y = hubs[:, 0] * thrust, -hubs[:, 1] * thrust
    scale_roll = float(y @ vehicle.effectiveness[0] / (y @ y))
    scale_pitch = float(x @ vehicle.effectiveness[1] / (x @ x))
    mixer = np.array([scale_roll * y, scale_pitch * x, -torque * spin, np.full(4, -thrust)])
    return replace(vehicle, effectiveness=mixer, yaw_reaction=np.zeros(4))


def _linearise_rotors(model: Model, hover: float) -> tuple[np.ndarray, np.ndarray]:
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
    # a reaction of the opposite sign to the torque would make the inverse unstable, so it is neglected
    ratio = reaction @ per_square[2]
    return per_square, reaction if ratio > 0.0 else np.zeros(4)


def _check_steering(vehicle: ControlModel) -> None:
    scale = np.abs(vehicle.effectiveness).sum(axis=1)
    names = ("Mx", "My", "Mz", "Fz")
    dead = [n for n, s in zip(names, scale) if not (np.isfinite(s) and s > 0.0)]
    if dead:
        raise DataError(
            f"model {vehicle.name}: {dead[0]} does not depend on the rotor speeds, so it cannot be controlled; "
            "identify it with a term in the rotor speeds (U_p, U_q, U_r, w_tot ...)"
        )
    if np.linalg.cond(vehicle.effectiveness / scale[:, None]) > 1e4:
        raise DataError(
            f"model {vehicle.name}: the four rotors cannot set Mx, My, Mz and Fz independently about hover; "
            "check 'rotor config' and the rotors' spins"
        )


def _read_times(value: Any, where: str) -> np.ndarray:
    try:
        values = np.atleast_1d(np.asarray(value, float))
    except (TypeError, ValueError):
        values = np.array([np.nan])
    if values.size not in (1, 4) or not np.all(np.isfinite(values)) or np.any(values <= 0.0):
        raise ConfigError(f"{where} is {value!r}, expected one or four positive numbers of seconds")
    return values
