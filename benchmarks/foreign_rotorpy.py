"""Flights in RotorPy (MIT; Folk, Paulos & Kumar, 2023): its multirotor, its ground, its SE(3) controller.

A cause is one of the simulator's own parameters. Its derivative is integrated by the classical Runge-Kutta method at
250 Hz, fifteen times as fast as its own adaptive step with the same result to 1e-6.
"""

import copy
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from foreign_flights import GRAVITY, Motion, Vehicle
from foreign_pilot import RATE, Course
from scipy.spatial.transform import Rotation

Load = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
IDLE = 60.0  # rad/s
SENSORS: dict[str, Any] = {}
# what its vehicle has in every flight: true where a diagnosis reports it as always there
ALWAYS = frozenset({"rotor_drag", "body_drag", "axial_inflow", "translational_lift"})


def parameters() -> dict[str, Any]:
    """RotorPy's AscTec Hummingbird with a motor of 20 ms, as small drives have, and drag that flights can show."""
    from rotorpy.vehicles.hummingbird_params import quad_params

    return {**copy.deepcopy(quad_params), "tau_m": 0.02}


def vehicle() -> Vehicle:
    """What the lab writes down about it."""
    return written_down("Hummingbird", parameters())


def written_down(name: str, p: Mapping[str, Any]) -> Vehicle:
    """What a lab writes down about a vehicle of RotorPy's parameters."""
    hubs = np.array(list(p["rotor_pos"].values()))
    places = {
        f"{'front' if x > 0 else 'aft'} {'left' if y > 0 else 'right'}": i + 1 for i, (x, y, _) in enumerate(hubs)
    }
    inertia = (p["Ixx"], p["Iyy"], p["Izz"])
    # a positive direction is a torque about z up on the body: the rotor itself turns clockwise
    turns = "CW" if p["rotor_directions"][0] > 0 else "CCW"
    return Vehicle(name, p["mass"], inertia, hubs, turns, p["rotor_radius"], p["rotor_speed_max"], places)


def moved(p: dict[str, Any], shift: tuple[float, float, float]) -> None:
    """Rotors as seen from a cg that has moved by `shift`, m."""
    p["rotor_pos"] = {k: v - np.array(shift) for k, v in p["rotor_pos"].items()}


def fly(
    course: Course,
    change: Callable[[dict[str, Any]], None] | None = None,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    weak: Mapping[int, tuple[float, float]] | None = None,
    fading: float = 0.0,
    load: Load | None = None,
    of: Callable[[], dict[str, Any]] = parameters,
) -> Motion:
    """One flight.

    change  alters the vehicle's parameters, which the controller does not know
    wind    m/s, world
    weak    {rotor from 1: factors of its thrust and torque coefficients}
    fading  1/s, share of all rotors' thrust and torque that is lost with time
    load    (position m, velocity through the air m/s body) to a force N and moment N m, body, of no parameter
    of      the vehicle's parameters
    """
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.vehicles.multirotor import Multirotor

    p = of()
    control = SE3Control(p)
    if change is not None:
        change(p)
    craft = Multirotor(p, enable_ground=True)
    if weak:
        craft.compute_body_wrench = _with_weak_rotors(craft, weak)
    if load:
        craft.compute_body_wrench = _loaded(craft.compute_body_wrench, load, position := np.zeros(3))
    state = {**copy.deepcopy(craft.initial_state), "x": np.zeros(3), "rotor_speeds": np.full(4, IDLE)}
    state["wind"] = np.array(wind, float)
    n, h = len(course.yaw), 1 / RATE
    states, slopes, commands = np.zeros((n, 20)), np.zeros((n, 20)), np.full((n, 4), IDLE)
    for k in range(n):
        if course.armed[k]:
            wanted = {"x": course.position[k], "x_dot": course.velocity[k], "x_ddot": course.acceleration[k],
                      "yaw": course.yaw[k], "yaw_dot": course.yaw_rate[k]}  # fmt: skip
            commands[k] = control.update(k * h, state, wanted)["cmd_motor_speeds"]
        commands[k] = np.clip(commands[k], IDLE, p["rotor_speed_max"])
        s = craft._pack_state(state)
        craft.k_eta, craft.k_m = p["k_eta"] * (1.0 - fading * k * h), p["k_m"] * (1.0 - fading * k * h)
        if load:
            position[:] = state["x"]
        one = craft._s_dot_fn(0.0, s, commands[k])
        two = craft._s_dot_fn(0.0, s + h / 2 * one, commands[k])
        three = craft._s_dot_fn(0.0, s + h / 2 * two, commands[k])
        four = craft._s_dot_fn(0.0, s + h * three, commands[k])
        states[k], slopes[k] = s, one
        if craft._on_ground(state):  # it sets velocities there; the floor's friction is in no force of its own
            slopes[k, 3:6] = slopes[k, 10:13] = 0.0
        state = craft._unpack_state(s + h / 6 * (one + 2 * two + 2 * three + four))
        state["q"] = state["q"] / np.linalg.norm(state["q"])
        if craft._on_ground(state):
            state = craft._handle_vehicle_on_ground(state)
    attitude = Rotation.from_quat(states[:, 6:10])
    force = attitude.inv().apply(slopes[:, 3:6] + [0.0, 0.0, GRAVITY])
    return Motion(
        h * np.arange(n), states[:, :3], states[:, 6:10], states[:, 10:13], slopes[:, 10:13], force, states[:, 16:],
        commands / p["rotor_speed_max"],
    )  # fmt: skip


def _loaded(
    plain: Callable[..., tuple[np.ndarray, np.ndarray]], load: Load, position: np.ndarray
) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """A wrench with a further force and moment, which may depend on the position (3,) that the caller keeps."""

    def wrench(rates: np.ndarray, speeds: np.ndarray, airspeed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own, further = plain(rates, speeds, airspeed), load(position, airspeed)
        return own[0] + further[0], own[1] + further[1]

    return wrench


def _with_weak_rotors(
    craft: Any, weak: Mapping[int, tuple[float, float]]
) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """The simulator's wrench, with some rotors' coefficients times factors: it has those of all rotors alike."""
    plain = craft.compute_body_wrench

    def wrench(rates: np.ndarray, speeds: np.ndarray, airspeed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        force, moment = plain(rates, speeds, airspeed)
        for i, (thrust, torque) in weak.items():
            lost = np.array([0.0, 0.0, (thrust - 1.0) * craft.k_eta * speeds[i - 1] ** 2])
            force, moment = force + lost, moment + np.cross(craft.rotor_geometry[i - 1], lost)
            moment[2] += (torque - 1.0) * craft.rotor_dir[i - 1] * craft.k_m * speeds[i - 1] ** 2
        return force, moment

    return wrench
