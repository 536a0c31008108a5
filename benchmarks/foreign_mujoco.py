"""Flights in MuJoCo (Apache 2.0; Todorov, Erez & Tassa, 2012): a quadrotor in MJCF under a cascade of our own.

MuJoCo gives rigid-body motion, contact with the floor, fluid forces on an ellipsoid (drag, lift, added mass, wind),
thrust through actuators with a first-order lag, and the readings of accelerometer and gyro. The rotor speed that is
logged is the root of an actuator's thrust over its factor.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from foreign_flights import Motion, Vehicle
from foreign_pilot import RATE, Course
from scipy.spatial.transform import Rotation

STEPS = 2  # of simulation and control for one of the course
FACTOR, TORQUE = 1.5e-6, 0.016  # N s2/rad2 of a rotor; N m per N of thrust
FASTEST, IDLE = 2200.0, 120.0  # rad/s
MASS, INERTIA = 0.62, (2.6e-3, 3.1e-3, 4.9e-3)
# aft right, front right, aft left, front left, as Betaflight counts; x forward, y left, z up, m
HUBS = np.array([[-0.095, -0.105, 0.02], [0.095, -0.105, 0.02], [-0.095, 0.105, 0.02], [0.095, 0.105, 0.02]])
TURNS = np.array([1.0, -1.0, -1.0, 1.0])  # torque about z up on the body; a clockwise rotor gives 1
# what its vehicle has in every flight: true where a diagnosis reports it as always there
ALWAYS = frozenset({"body_drag", "translational_lift"})
SENSORS: dict[str, Any] = {"hover": 1007.0, "accelerometer_noise": 0.6, "gyro_noise": 0.015}


def scene(cg: tuple[float, float, float]) -> str:
    """The MJCF: floor, body with its cg at a place of the frame (m), feet, rotors, sensors."""
    sites = "".join(f'<site name="r{i}" pos="{x} {y} {z}"/>' for i, (x, y, z) in enumerate(HUBS))
    feet = "".join(f'<geom type="sphere" size="0.01" pos="{x} {y} -0.05" mass="0"/>' for x, y in 0.6 * HUBS[:, :2])
    rotors = "".join(
        f'<general site="r{i}" gear="0 0 1 0 0 {TORQUE * s}" ctrlrange="0 {FACTOR * FASTEST**2}"'
        ' dyntype="filter" dynprm="0.025" ctrllimited="true" gaintype="fixed" gainprm="1"/>'
        for i, s in enumerate(TURNS)
    )
    return f"""
<mujoco>
  <option timestep="{1 / RATE / STEPS}" integrator="RK4" density="1.2" viscosity="1.8e-5"/>
  <worldbody>
    <geom type="plane" size="20 20 1"/>
    <body name="quad" pos="0 0 0.06">
      <freejoint/>
      <inertial pos="{cg[0]} {cg[1]} {cg[2]}" mass="{MASS}" diaginertia="{INERTIA[0]} {INERTIA[1]} {INERTIA[2]}"/>
      <geom name="hull" type="ellipsoid" size="0.14 0.12 0.05" mass="0" contype="0" conaffinity="0"
            fluidshape="ellipsoid"/>
      {feet}{sites}<site name="imu"/>
    </body>
  </worldbody>
  <actuator>{rotors}</actuator>
  <sensor><accelerometer site="imu"/><gyro site="imu"/></sensor>
</mujoco>"""


def vehicle() -> Vehicle:
    """What the lab writes down about it."""
    places = {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3}
    return Vehicle("Mujo", MASS, INERTIA, HUBS, "CW", 0.0635, FASTEST, places, arrays=True)


class Cascade:
    """Position, velocity, attitude and rate loops; it knows the nominal vehicle."""

    def __init__(self) -> None:
        """Integrators at zero; the mixer from the nominal geometry."""
        self.drift = np.zeros(3)
        self.turned = np.zeros(3)
        rows = [np.ones(4), HUBS[:, 1], -HUBS[:, 0], TORQUE * TURNS]
        self.mixer = np.linalg.inv(np.array(rows))

    def thrusts(self, course: Course, k: int, state: np.ndarray, h: float) -> np.ndarray:
        """Of each rotor, N; state: position, quaternion w x y z, velocity (world), rates (body)."""
        turn = Rotation.from_quat(state[3:7], scalar_first=True)
        error = np.clip(course.position[k] - state[:3], -0.8, 0.8)
        speed = course.velocity[k] + 2.5 * error - state[7:10]
        self.drift = np.clip(self.drift + 1.0 * h * speed, -2.0, 2.0)
        wanted = course.acceleration[k] + 4.0 * speed + self.drift + [0.0, 0.0, 9.81]
        wanted[2] = max(wanted[2], 3.0)
        up = wanted / np.linalg.norm(wanted)
        left = np.cross(up, [np.cos(course.yaw[k]), np.sin(course.yaw[k]), 0.0])
        left /= np.linalg.norm(left)
        goal = Rotation.from_matrix(np.column_stack([np.cross(left, up), left, up]))
        rates = np.array([9.0, 9.0, 4.0]) * (turn.inv() * goal).as_rotvec()
        rates[2] += course.yaw_rate[k]
        off = np.clip(rates, -8.0, 8.0) - state[10:13]
        self.turned = np.clip(self.turned + h * off, -0.5, 0.5)
        moment = np.array(INERTIA) * ([25.0, 25.0, 12.0] * off + 15.0 * self.turned)
        lift = MASS * max(float(wanted @ turn.apply([0.0, 0.0, 1.0])), 2.0)
        return np.clip(self.mixer @ [lift, *moment], FACTOR * IDLE**2, FACTOR * FASTEST**2)


def fly(
    course: Course,
    change: Callable[[Any], None] | None = None,
    cg: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Motion:
    """One flight, as the origin of the frame sees it.

    change  alters MuJoCo's compiled model, which the controller does not know
    cg      place of the centre of gravity in the frame, m
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(scene(cg))
    if change is not None:
        change(model)
        mujoco.mj_setConst(model, mujoco.MjData(model))  # what follows from masses, such as those of subtrees
    data = mujoco.MjData(model)
    data.act[:] = FACTOR * IDLE**2
    control, h, n = Cascade(), 1 / RATE / STEPS, STEPS * len(course.yaw)
    rows = np.zeros((n, 30))
    for j in range(n):
        k = j // STEPS
        state = np.concatenate([data.qpos, data.qvel])
        data.ctrl[:] = control.thrusts(course, k, state, h) if course.armed[k] else FACTOR * IDLE**2
        mujoco.mj_forward(model, data)
        rows[j] = np.concatenate([data.qpos, data.qvel, data.qacc, data.sensordata[:3], data.act, data.ctrl])
        mujoco.mj_step(model, data)
    quaternion = rows[:, [4, 5, 6, 3]]
    return Motion(
        h * np.arange(n), rows[:, :3], quaternion, rows[:, 10:13], rows[:, 16:19], rows[:, 19:22],
        np.sqrt(rows[:, 22:26] / FACTOR), np.sqrt(rows[:, 26:30] / FACTOR) / FASTEST,
    )  # fmt: skip
