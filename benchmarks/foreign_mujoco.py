"""Flights in MuJoCo (Apache 2.0; Todorov, Erez & Tassa, 2012): a quadrotor in MJCF under a cascade of our own.

MuJoCo gives rigid-body motion, contact with the floor, fluid forces on an ellipsoid (drag, lift, added mass, wind),
thrust through actuators with a first-order lag, and the readings of accelerometer and gyro. The rotor speed that is
logged is the root of an actuator's thrust over its factor.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from foreign_flights import Motion, Vehicle
from foreign_pilot import RATE, Cascade, Course

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
    control = Cascade(MASS, INERTIA, HUBS, TORQUE * TURNS, (FACTOR * IDLE**2, FACTOR * FASTEST**2))
    h, n = 1 / RATE / STEPS, STEPS * len(course.yaw)
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
