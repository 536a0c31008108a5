"""Flights in PyFlyt (MIT; Tai et al., 2023): its Crazyflie 2.x in Bullet, whose motors are noisy, under our cascade.

PyFlyt gives what the other simulators lack: speeds of rotors that fluctuate by some percent from step to step, with
thrust and torque that follow them, a moment against the square of the body's rates, and Bullet's integration and
contact. Of its noise of motors one value, with a mean of four, acts on all rotors; each gets one of its own here.
"""

import contextlib
import io
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from foreign_flights import GRAVITY, Motion, Vehicle
from foreign_pilot import RATE, Cascade, Course

Load = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
MODEL = "cf2x"
FACTOR, RATIO = 3.16e-10, 7.94e-12 / 3.16e-10  # N/rpm2; N m per N of thrust
FASTEST = float(np.sqrt(2.0 / 4 / FACTOR))  # rpm
IDLE = 0.1  # of the command's range
MASS, INERTIA, DRAG = 0.027, (1.4e-5, 1.4e-5, 2.17e-5), 0.5 * 1.225 * 3.0 * 4e-4  # kg, kg m2, N s2/m2
# front right, aft left, front left, aft right; x forward, y left, m
HUBS = np.array([[0.028, -0.028, 0.0], [-0.028, 0.028, 0.0], [0.028, 0.028, 0.0], [-0.028, -0.028, 0.0]])
TURNS = np.array([-1.0, -1.0, 1.0, 1.0])  # torque about z up on the body; a clockwise rotor gives 1
STIFFNESS = (25.0, 25.0, 12.0)  # 1/s, of the rates
WOUND = 4.0  # rad, of the rates' integral: it has to hold what a moved cg does to so light a vehicle
# what its vehicle has in every flight: true where a diagnosis reports it as always there
ALWAYS = frozenset({"body_drag"})
SENSORS: dict[str, Any] = {"hover": float(np.sqrt(MASS * GRAVITY / 4 / FACTOR)) * np.pi / 30}


class OwnNoise:
    """What PyFlyt's motors ask for their noise: one standard normal value for each."""

    def __init__(self, seed: int) -> None:
        self.generator = np.random.default_rng(seed)

    def normal(self, number: int) -> np.ndarray:
        """Values (number,)."""
        return self.generator.standard_normal(number)


def vehicle() -> Vehicle:
    """What the lab writes down about it."""
    places = {"front right": 1, "aft left": 2, "front left": 3, "aft right": 4}
    return Vehicle("Flit", MASS, INERTIA, HUBS, "CCW", 0.023, FASTEST * np.pi / 30, places)


def copied(folder: Path, shift: tuple[float, float, float]) -> None:
    """PyFlyt's vehicle with rotors and hull where they are seen from a cg that has moved by `shift`, m."""
    import PyFlyt.core

    source = Path(PyFlyt.core.__file__).parents[1] / "models/vehicles" / MODEL
    (folder / MODEL).mkdir()
    (folder / MODEL / f"{MODEL}.yaml").write_bytes((source / f"{MODEL}.yaml").read_bytes())
    tree = ElementTree.parse(source / f"{MODEL}.urdf")
    for link in tree.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        if link.get("name") != "base_link":  # rotors, and the hull at whose place drag acts
            origin = link.find("inertial/origin")
            place = np.array([float(v) for v in origin.get("xyz").split()]) - shift
            origin.set("xyz", " ".join(map(repr, place.tolist())))
    tree.write(folder / MODEL / f"{MODEL}.urdf")


def fly(
    course: Course,
    change: Callable[[Any], None] | None = None,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    fading: float = 0.0,
    load: Load | None = None,
) -> Motion:
    """One flight.

    change  alters PyFlyt's drone, which the controller does not know; shift  of the cg, m; wind  m/s, world
    fading  1/s, share of all rotors' thrust and torque lost with time
    load    (position m, velocity m/s body) to a force N and moment N m, body, of no parameter
    """
    from PyFlyt.core import Aviary

    n = len(course.yaw)
    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stdout(io.StringIO()):
        copied(Path(name), shift)
        options = {"control_hz": RATE, "drone_model": MODEL, "model_dir": name}
        room = Aviary(np.array([[0.0, 0.0, 0.02]]), np.zeros((1, 3)), "quadx", drone_options=options, physics_hz=RATE,
                      world_scale=5.0)  # fmt: skip
    room.setTimeStep(1 / RATE)  # Bullet keeps its 1/240 s whatever PyFlyt is asked for
    drone = room.drones[0]
    drone.set_mode(-1)
    drone.motors.np_random = OwnNoise(int(1e6 * abs(course.position).sum()) % 2**31)
    if any(wind):
        room.register_wind_field_function(lambda _, place: np.tile(wind, (len(place), 1)))
    if change is not None:
        change(drone)
    thrusts, torques = drone.motors.thrust_coef.copy(), drone.motors.torque_coef.copy()
    control = Cascade(
        MASS, np.array(INERTIA), HUBS, RATIO * TURNS, (FACTOR * (IDLE * FASTEST) ** 2, FACTOR * FASTEST**2), STIFFNESS,
        WOUND,
    )  # fmt: skip
    rows = np.zeros((n + 1, 21))
    for j in range(n + 1):
        k = min(j, n - 1)
        where, turn = room.getBasePositionAndOrientation(drone.Id)
        velocity, _ = room.getBaseVelocity(drone.Id)
        rates, x = drone.state[0], np.array(turn)
        state = np.concatenate([where, x[[3, 0, 1, 2]], velocity, rates])
        if course.armed[k]:
            drone.setpoint = np.sqrt(np.maximum(control.thrusts(course, k, state, 1 / RATE), 0.0) / FACTOR) / FASTEST
        else:
            drone.setpoint = np.full(4, IDLE)
        rows[j] = np.concatenate([where, turn, velocity, rates, drone.motors.throttle * FASTEST, drone.setpoint])
        lost = 1.0 - fading * j / RATE
        drone.motors.thrust_coef, drone.motors.torque_coef = lost * thrusts, lost * torques
        if load is not None:
            through = drone.state[2] - np.reshape(room.getMatrixFromQuaternion(turn), (3, 3)).T @ wind
            force, moment = load(np.array(where), through)
            room.applyExternalForce(drone.Id, -1, list(force), [0.0, 0.0, 0.0], room.LINK_FRAME)
            room.applyExternalTorque(drone.Id, -1, list(moment), room.LINK_FRAME)
        room.step()
    room.disconnect()
    return as_motion(rows, 1 / RATE)


def as_motion(rows: np.ndarray, h: float) -> Motion:
    """The flight of rows (n + 1, 21) at steps of h s.

    Bullet changes the velocity first, by forces at the row's attitude and the speeds of rotors after their step, and
    moves with the velocity after that: a row's velocity and rates are those of half a step before its path.
    """
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_quat(rows[:-1, 3:7])
    slope = np.diff(rows[:, 7:13], axis=0) / h
    return Motion(
        h * np.arange(len(rows) - 1), rows[:-1, :3], rows[:-1, 3:7], 0.5 * (rows[:-1, 10:13] + rows[1:, 10:13]),
        slope[:, 3:], turns.inv().apply(slope[:, :3] + [0.0, 0.0, GRAVITY]), rows[1:, 13:17] * np.pi / 30,
        rows[:-1, 17:21],
    )  # fmt: skip
