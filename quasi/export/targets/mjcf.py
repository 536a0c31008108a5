"""MuJoCo: the vehicle as MJCF, with one thrust actuator per rotor and linear drag.

Source of the actuators' law: MuJoCo's XML reference, actuator/general. A rotor's control is its thrust in N; the
activation follows it with the rotor's time constant (a filter of first order: about hover, thrust lags as the speed
does); force and torque act at the rotor's site by the gear. Drag is an actuator without gain whose bias is minus a
coefficient times the velocity of the site along its gear. Horizontal drag acts at the heights that give the model's
pitching moments; the rate damping that this adds is taken off that of roll and pitch.
Body axes x forward, y left, z up.
"""

from collections.abc import Mapping

import numpy as np

from quasi.attitude import GRAVITY
from quasi.export.frames import swap_inertia, swap_vector
from quasi.export.physical_constants import Physical, not_carried
from quasi.export.rotor_links import check_inertia
from quasi.export.simulator_check import Recovered
from quasi.export.xml_text import comment, number, numbers, parsed

NAME = "mjcf"
TITLE = "MuJoCo: MJCF with thrust actuators"
NEEDS = "MuJoCo 3"
CARRIES = frozenset({
    "mass", "inertia", "products of inertia", "thrust coefficient", "torque coefficient", "speed limits",
    "horizontal drag", "vertical drag", "rate damping",
})  # fmt: skip
MJCF_STEP = 0.002  # s, as the exported FMUs take it


def write(physical: Physical) -> dict[str, str]:
    """{file: text} of the export."""
    check_inertia(physical, "MuJoCo")
    positions, inertia = swap_vector(physical.positions), swap_inertia(physical.inertia)
    tau = 0.5 * (physical.rotors.up + physical.rotors.down)  # a filter of first order has one
    heights = physical.drag_heights
    lost = not_carried(physical, CARRIES if heights is None else CARRIES | {"pitching moment"})
    heights = np.zeros(2) if heights is None else heights
    head = [
        f"Quadrotor of model {physical.name}, made by quasi; body axes x forward, y left, z up.",
        f"Control: thrust of rotors 1 to 4, N; thrust = {number(physical.thrust.value)} N/(rad/s)^2 x speed^2.",
        "The other controls have no effect: those actuators are drag.",
        "Thrust follows its command with the mean of the time constants up and down. Rotors stand where their thrust",
        "gives the model's moments. Horizontal drag acts at the heights that give the model's pitching moments.",
        "Not carried by this format:",
        *(f"- {line}" for line in lost),
    ]
    full = "" if physical.highest is None else number(physical.thrust.value * physical.highest**2)
    least = number(physical.thrust.value * physical.rotors.lowest**2)
    size = numbers([*np.max(np.abs(positions[:, :2]), axis=0), 0.15 * physical.arm])
    entries = numbers(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    lines = [
        '<?xml version="1.0"?>', *comment(head), f'<mujoco model="{physical.name}">',
        '  <compiler inertiafromgeom="false" autolimits="true"/>',
        f'  <option timestep="{number(MJCF_STEP)}" integrator="RK4" gravity="0 0 {number(-GRAVITY)}"/>',
        "  <worldbody>", '    <body name="quadrotor" pos="0 0 1">', '      <freejoint name="root"/>',
        f'      <inertial pos="0 0 0" mass="{number(physical.mass)}" fullinertia="{entries}"/>',
        f'      <geom name="base" type="box" size="{size}" mass="0"/>',
    ]  # fmt: skip
    for i, position in enumerate(positions, 1):
        disc = f"{number(physical.radius)} {number(0.025 * physical.radius)}"
        lines += [
            f'      <site name="rotor{i}" pos="{numbers(position)}"/>',
            f'      <geom name="disc{i}" type="cylinder" size="{disc}" pos="{numbers(position)}" mass="0" '
            'contype="0" conaffinity="0" rgba="0.5 0.5 0.5 0.5"/>',
        ]
    lines += [
        '      <site name="imu" pos="0 0 0"/>',
        *(f'      <site name="drag_{a}" pos="0 0 {number(h)}"/>' for a, h in zip("xy", heights)),
        "    </body>", "  </worldbody>", "  <actuator>",
    ]  # fmt: skip
    for i in range(4):
        limit = f' ctrlrange="{least} {full}"' if full else ""
        torque = float(physical.spin[i]) * physical.moment_ratio
        lines.append(
            f'    <general name="rotor{i + 1}" site="rotor{i + 1}" gear="0 0 1 0 0 {number(torque)}"{limit} '
            f'dyntype="filter" dynprm="{number(tau[i])}" gainprm="1" biastype="none"/>'
        )
    resisting = [d.value for d in (*physical.drag, *physical.damping)]
    # drag above the centre of gravity damps roll and pitch as well
    resisting[3] -= physical.drag[1].value * heights[1] ** 2
    resisting[4] -= physical.drag[0].value * heights[0] ** 2
    for k, (name, value) in enumerate(zip(("x", "y", "z", "roll", "pitch", "yaw"), resisting)):
        if value != 0.0:
            gear = numbers(np.eye(6)[k])
            lines.append(
                f'    <general name="drag_{name}" site="{f"drag_{name}" if name in "xy" else "imu"}" gear="{gear}" '
                f'gainprm="0" biastype="affine" biasprm="0 0 {number(-value)}"/>'
            )
    hover = number(physical.mass * GRAVITY / 4.0)
    extra = sum(v != 0.0 for v in resisting)
    lines += [
        "  </actuator>", "  <sensor>", '    <gyro name="gyro" site="imu"/>',
        '    <accelerometer name="accelerometer" site="imu"/>', "  </sensor>", "  <keyframe>",
        f'    <key name="hover" qpos="0 0 1 1 0 0 0" act="{" ".join([hover] * 4)}" '
        f'ctrl="{" ".join([hover] * 4 + ["0"] * extra)}"/>',
        "  </keyframe>", "</mujoco>", "",
    ]  # fmt: skip
    scene = [
        '<?xml version="1.0"?>', '<mujoco model="scene">', '  <include file="quadrotor.xml"/>',
        "  <worldbody>", '    <light pos="0 0 3" dir="0 0 -1" directional="true"/>',
        '    <geom name="floor" type="plane" size="10 10 0.1"/>', "  </worldbody>", "</mujoco>", "",
    ]  # fmt: skip
    return {"quadrotor.xml": "\n".join(lines), "scene.xml": "\n".join(scene)}


def recover(files: Mapping[str, str], physical: Physical) -> Recovered:
    """What quadrotor.xml holds, parsed back; physical gives thrust per speed^2."""
    root = parsed(files["quadrotor.xml"], "quadrotor.xml")
    parsed(files["scene.xml"], "scene.xml")
    body = root.find("worldbody/body")
    inertial = body.find("inertial")
    xx, yy, zz, xy, xz, yz = (float(v) for v in inertial.get("fullinertia").split())
    sites = {s.get("name"): np.array([float(v) for v in s.get("pos").split()]) for s in body.findall("site")}
    motors = {a.get("name"): a for a in root.findall("actuator/general")}
    rotors = [motors[f"rotor{i}"] for i in range(1, 5)]
    gears = np.array([[float(v) for v in r.get("gear").split()] for r in rotors])
    positions = np.array([sites[r.get("site")] for r in rotors])
    k = physical.thrust.value
    force, torque = gears[:, :3] * k, gears[:, 3:] * k
    moments = swap_vector(np.cross(positions, force) + torque).T
    key = {k.get("name"): k for k in root.findall("keyframe/key")}["hover"]
    limits = rotors[0].get("ctrlrange")
    drag, turn = (
        np.array([-float(motors[n].get("biasprm").split()[2]) if n in motors else 0.0 for n in names])
        for names in (("drag_x", "drag_y"), ("drag_roll", "drag_pitch", "drag_yaw"))
    )
    height = np.array([sites["drag_x"][2], sites["drag_y"][2]])
    return Recovered(
        mass=float(inertial.get("mass")),
        inertia=swap_inertia(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])),
        hover_thrust=sum(float(v) for v in key.get("act").split()),
        moments=moments,
        times={"mean of up and down": np.array([float(r.get("dynprm")) for r in rotors])},
        highest=None if limits is None else float(np.sqrt(float(limits.split()[1]) / k)),
        drag=max(float(np.mean(drag)), 0.0),
        pitching=None if physical.drag_height is None else drag * height,
        damping=turn + np.append((drag * height**2)[::-1], 0.0),
    )
