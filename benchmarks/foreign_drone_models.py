"""Flights of drone-models (MIT; Learning Systems Lab): Crazyflies with thrust, torque and motors as measured on them.

Its dynamics have what RotorPy and MuJoCo lack: a thrust and a torque that are no plain squares of the speed, motors
that slow down unlike they speed up, and drag that depends on no rotor. They are integrated by the classical
Runge-Kutta method, with a derivative of the attitude of our own, as the package advises. Its gyroscopic moment about x
has the opposite sign of -w x h; with rotors in pairs it is small.
"""

import copy
import os
from collections.abc import Callable, Mapping
from functools import partial
from types import SimpleNamespace
from typing import Any

os.environ["SCIPY_ARRAY_API"] = "1"  # which the package insists on

import numpy as np
from foreign_flights import GRAVITY, Motion, Vehicle
from foreign_pilot import RATE, Cascade, Course
from scipy.spatial.transform import Rotation

Load = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
TO_RPM = 30.0 / np.pi
COMPENSATED = 0.03  # s, lag of the motors that the flight controller's lead leaves
STIFFNESS = (14.0, 14.0, 3.0)  # 1/s, of the rates: an accelerating rotor turns the vehicle before its drag does
ROOM = 0.9  # of the greatest thrust, that the controller asks for: the rest is for the motors' lead
WOUND = 4.0  # rad, of the rates' integral: it has to hold what a moved cg does to so light a vehicle
# the brushed Crazyflie with stronger motors, and the brushless one
VEHICLES = {"thrust_upgrade": "cf2x_T350", "brushless_500": "cf21B_500"}
USED = ("mass", "L", "prop_inertia", "gravity_vec", "J", "rpm2thrust", "rpm2torque", "mixing_matrix", "drag_matrix",
        "rotor_dyn_coef")  # fmt: skip


def of(name: str) -> SimpleNamespace:
    """The vehicle `name` of `VEHICLES`, with what a module of a simulator holds."""
    p = parameters(name)
    hover = float(speed_of(p, p["mass"] * GRAVITY / 4)) / TO_RPM
    return SimpleNamespace(
        ALWAYS=frozenset({"rotor_drag", "body_drag", "axial_inflow", "thrust_curve"}),
        SENSORS={"hover": hover},
        parameters=partial(parameters, name),
        vehicle=partial(vehicle, name),
        fly=partial(fly, name),
    )


def parameters(name: str) -> dict[str, Any]:
    """Published parameters, as arrays."""
    import tomllib
    from importlib.resources import files

    text = files("drone_models").joinpath("data/params.toml").read_text()
    return {key: np.array(value, float) for key, value in tomllib.loads(text)[VEHICLES[name]].items()}


def hubs_of(p: Mapping[str, Any]) -> np.ndarray:
    """Places of the rotors (4, 3), m, x forward, y left, from the mixing of thrusts."""
    roll, pitch, _ = p["mixing_matrix"]
    return np.column_stack([-pitch, roll, 0 * roll]) * p["L"]


def vehicle(name: str) -> Vehicle:
    """What the lab writes down about it."""
    p = parameters(name)
    hubs = hubs_of(p)
    places = {
        f"{'front' if x > 0 else 'aft'} {'left' if y > 0 else 'right'}": i + 1 for i, (x, y, _) in enumerate(hubs)
    }
    turns = "CW" if p["mixing_matrix"][2, 0] > 0 else "CCW"
    inertia = tuple(map(float, np.diag(p["J"])))
    return Vehicle(name, float(p["mass"]), inertia, hubs, turns, float(p["prop_radius"]), fastest(p) / TO_RPM, places)


def speed_of(p: Mapping[str, Any], thrust: np.ndarray) -> np.ndarray:
    """Speed of a rotor, rpm, that gives a thrust, N."""
    _, b, c = p["rpm2thrust"]
    return (-b + np.sqrt(b * b + 4.0 * c * np.asarray(thrust))) / (2.0 * c)


def fastest(p: Mapping[str, Any]) -> float:
    """Speed of full thrust, rpm."""
    return float(speed_of(p, p["thrust_max"]))


def led(p: Mapping[str, Any], wanted: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Commands (4,), rpm, with which motors of these parameters reach the wanted speeds with a lag of COMPENSATED."""
    rate = (wanted - speed) / COMPENSATED
    up = rate > 0
    first, second = (np.where(up, p["rotor_dyn_coef"][k], p["rotor_dyn_coef"][k + 2]) for k in (0, 1))
    # first (c - w) + second (c^2 - w^2) = rate, for c
    level = first * speed + second * speed**2 + rate
    square = np.where(second > 0, second, 1.0)
    root = (-first + np.sqrt(np.maximum(first**2 + 4.0 * square * level, 0.0))) / (2.0 * square)
    return np.where(second > 0, root, level / np.where(first > 0, first, 1.0))


def compiled(p: Mapping[str, Any]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The package's dynamics: derivative (17,) of position, attitude, velocity, rates and rotors, rpm.

    Of these, a force N and a moment N m of further origin, both in the world (23,), and commands (4,) rpm
    """
    import casadi
    from drone_models.first_principles import symbolic_dynamics

    used = {key: p[key] for key in USED}
    slope, state, command, _ = symbolic_dynamics(True, True, True, **used, J_inv=np.linalg.inv(p["J"]))
    function = casadi.Function("slope", [state, command], [slope])
    return lambda s, u: np.array(function(s, u)).ravel()


def moved(p: dict[str, Any], shift: tuple[float, float, float]) -> None:
    """Rotors and the place of the drag as seen from a cg that has moved by `shift`, m: the package's acts at any cg."""
    p["mixing_matrix"][0] -= shift[1] / p["L"]
    p["mixing_matrix"][1] += shift[0] / p["L"]
    p["drag_place"] = -np.array(shift)


def fly(
    name: str,
    course: Course,
    change: Callable[[dict[str, Any]], None] | None = None,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    weak: Mapping[int, float] | None = None,
    fading: float = 0.0,
    load: Load | None = None,
) -> Motion:
    """One flight.

    change  alters the vehicle's parameters, which the controller does not know; wind  m/s, world
    weak    {rotor from 1: factor of its thrust}; fading  1/s, share of all rotors' thrust and torque lost with time
    load    (position m, velocity m/s body) to a force N and moment N m, body, of no parameter
    """
    known = parameters(name)
    p = copy.deepcopy(known)
    if change is not None:
        change(p)
    least, most = float(known["thrust_min"]), float(known["thrust_max"])
    torques = known["mixing_matrix"][2] * known["thrust2torque"]
    control = Cascade(
        float(known["mass"]), np.diag(known["J"]), hubs_of(known), torques, (least, most), STIFFNESS, WOUND
    )
    idle, top, blown = float(speed_of(known, least)), fastest(known), np.array(wind)
    lost = np.array([(weak or {}).get(i + 1, 1.0) for i in range(4)]) - 1.0
    h, n = 1 / RATE, len(course.yaw)
    change_of = compiled(p)

    def slope(s: np.ndarray, command: np.ndarray, t: float) -> np.ndarray:
        turn = Rotation.from_quat(s[3:7]).as_matrix()
        thrust, torque = (p[key] @ [np.ones(4), s[13:], s[13:] ** 2] for key in ("rpm2thrust", "rpm2torque"))
        gone = (1.0 - fading * t) * (1.0 + lost) - 1.0
        further = np.array([0.0, 0.0, gone @ thrust]) - p["drag_matrix"] @ (turn.T @ blown)
        moment = np.append(p["L"] * p["mixing_matrix"][:2] @ (gone * thrust), 0.0)
        moment = moment + np.cross(p.get("drag_place", np.zeros(3)), p["drag_matrix"] @ (turn.T @ (s[7:10] - blown)))
        moment[2] += -fading * t * p["mixing_matrix"][2] @ torque
        if load is not None:
            own = load(s[:3], turn.T @ (s[7:10] - blown))
            further, moment = further + own[0], moment + own[1]
        made = change_of(np.concatenate([s, turn @ further, turn @ moment]), command)
        x, y, z, w = s[3:7]
        i, j, k = 0.5 * s[10:13]
        made[3:7] = w * i + y * k - z * j, w * j + z * i - x * k, w * k + x * j - y * i, -x * i - y * j - z * k
        return made

    s = np.concatenate([np.zeros(3), [0.0, 0.0, 0.0, 1.0], np.zeros(6), np.full(4, idle)])
    states, slopes, commands = np.zeros((n, 17)), np.zeros((n, 17)), np.full((n, 4), idle)
    for j in range(n):
        t = j * h
        if course.armed[j]:
            state = np.concatenate([s[:3], s[[6, 3, 4, 5]], s[7:13]])
            wanted = speed_of(known, control.thrusts(course, j, state, h))
            commands[j] = np.clip(led(known, wanted, s[13:]), idle, top)
        one = slope(s, commands[j], t)
        two = slope(s + h / 2 * one, commands[j], t)
        three = slope(s + h / 2 * two, commands[j], t)
        four = slope(s + h * three, commands[j], t)
        states[j], slopes[j] = s, one
        grounded = s[2] <= 0.0 and one[9] <= 0.0
        if grounded:  # the floor carries what thrust does not, and holds the feet
            slopes[j, 7:13] = 0.0
        s = s + h / 6 * (one + 2 * two + 2 * three + four)
        s[3:7] /= np.linalg.norm(s[3:7])
        if grounded or s[2] < 0.0:
            yaw = Rotation.from_quat(s[3:7]).as_euler("ZYX")[0]
            s[2], s[3:7] = 0.0, Rotation.from_euler("z", yaw).as_quat()
            s[7:13] = 0.0
    force = Rotation.from_quat(states[:, 3:7]).inv().apply(slopes[:, 7:10] + [0.0, 0.0, GRAVITY])
    return Motion(
        h * np.arange(n), states[:, :3], states[:, 3:7], states[:, 10:13], slopes[:, 10:13], force,
        states[:, 13:] / TO_RPM, commands / top,
    )  # fmt: skip
