"""Gazebo: an SDF model with a multicopter motor model per rotor.

Source of the motor model's law: gz-sim, system MulticopterMotorModel. Thrust = motorConstant w^2 along the joint axis;
reaction torque = -direction x momentConstant x thrust about it (direction +1 for ccw); drag = -|w| rotorDragCoefficient
v and moment = -|w| rollingMomentCoefficient v, v being the air velocity perpendicular to the axis; the speed follows
its command with timeConstantUp or timeConstantDown and is limited to maxRotVelocity. Elements: SDFormat 1.9.
"""

from collections.abc import Mapping

import numpy as np

from quasi.errors import DataError
from quasi.export.frames import swap_inertia, swap_vector
from quasi.export.physical_constants import Physical, not_carried
from quasi.export.rotor_links import Links, join_rotors, split_rotors
from quasi.export.simulator_check import Recovered, moments_of
from quasi.export.xml_text import comment, inertia_of, number, numbers, parsed

NAME = "gazebo"
TITLE = "Gazebo: SDF model with a motor model per rotor"
NEEDS = "Gazebo Garden (gz-sim 7) or later"
CARRIES = frozenset({
    "mass", "inertia", "products of inertia", "thrust coefficient", "torque coefficient", "time constants up",
    "time constants down", "horizontal drag", "rolling moment",
})  # fmt: skip
SLOWDOWN = 10  # joints turn slower than rotors by this factor, the value of Gazebo's own quadrotors


def write(physical: Physical) -> dict[str, str]:
    """{file: text} of the export. Raises DataError without a speed limit, which the motor model needs."""
    if physical.highest is None:
        raise DataError(
            f"model {physical.name} knows no highest rotor speed, which Gazebo's motor model needs; give 'max RPM' and "
            "'motor poles' in the quadrotor configuration and make the model anew"
        )
    height = physical.drag_height
    links = split_rotors(physical, "Gazebo", height)
    lost = not_carried(physical, CARRIES if height is None else CARRIES | {"pitching moment"})
    if physical.rotors.lowest > 0.0:
        lost.append("the lowest speed: send no command below it")
    head = [
        f"Quadrotor of model {physical.name}, made by quasi; body axes x forward, y left, z up.",
        "Command: gz.msgs.Actuators on command/motor_speed, velocity[0..3] of rotors 1..4, rad/s.",
        "Horizontal drag is that of the rotors, the same forwards and sideways. Rotors stand where their thrust and",
        "drag give the model's moments.",
        "Not carried by this format:",
        *(f"- {line}" for line in lost),
    ]
    lines = ['<?xml version="1.0"?>', *comment(head), '<sdf version="1.9">', f'  <model name="{physical.name}">']
    lines += ['    <link name="base_link">', *_inertial(links.base_mass, links.centre, links.base)]
    size = numbers(2.0 * np.max(np.abs(links.positions[:, :2]), axis=0)) + f" {number(0.3 * physical.arm)}"
    for kind in ("collision", "visual"):
        lines += [f'      <{kind} name="base_{kind}">', f"        <geometry><box><size>{size}</size></box></geometry>",
                  f"      </{kind}>"]  # fmt: skip
    lines.append("    </link>")
    for i, position in enumerate(links.positions):
        lines += _rotor(physical, links, i, position)
    for i in range(4):
        lines += _motor(physical, i)
    lines += ["  </model>", "</sdf>", ""]
    config = [
        '<?xml version="1.0"?>', "<model>", f"  <name>{physical.name}</name>", "  <version>1.0</version>",
        '  <sdf version="1.9">model.sdf</sdf>', f"  <description>Identified quadrotor {physical.name}</description>",
        "</model>", "",
    ]  # fmt: skip
    return {"model.sdf": "\n".join(lines), "model.config": "\n".join(config)}


def recover(files: Mapping[str, str], physical: Physical) -> Recovered:
    """What model.sdf holds, parsed back; physical gives the hover speed alone."""
    model = parsed(files["model.sdf"], "model.sdf").find("model")
    parsed(files["model.config"], "model.config")
    joints = {j.get("name"): j for j in model.findall("joint")}
    links = {link.get("name"): link for link in model.findall("link")}
    base, rotor = links["base_link"].find("inertial"), links["rotor_1"].find("inertial")
    motors = sorted(model.findall("plugin"), key=lambda m: int(m.findtext("motorNumber")))
    positions = np.array([_pose(links[m.findtext("linkName")])[:3] for m in motors])
    axes = np.array([_floats(joints[m.findtext("jointName")].findtext("axis/xyz")) for m in motors])
    if not np.allclose(axes, [0.0, 0.0, 1.0]):
        raise DataError("the exported model.sdf has a rotor axis that does not point up; please report this")
    mass, centre, inertia = join_rotors(
        Links(
            float(base.findtext("mass")),
            _pose(base)[:3],
            inertia_of(base.find("inertia")),
            float(rotor.findtext("mass")),
            inertia_of(rotor.find("inertia")),
            positions,
        )
    )
    if np.max(np.abs(centre)) > 1e-6 * physical.arm:
        raise DataError(f"the exported model.sdf has its centre of gravity at {centre} m; please report this")

    def each(element: str) -> np.ndarray:
        return np.array([float(m.findtext(element)) for m in motors])

    thrust = each("motorConstant")
    direction = np.array([{"ccw": 1.0, "cw": -1.0}[m.findtext("turningDirection")] for m in motors])
    # a moment about the axis that points up, seen about the one that points down
    torque = -(-direction * each("momentConstant") * thrust)
    drag = float(np.sum(each("rotorDragCoefficient")) * physical.hover)
    return Recovered(
        mass=mass,
        inertia=swap_inertia(inertia),
        hover_thrust=float(np.sum(thrust) * physical.hover**2),
        moments=moments_of(swap_vector(positions), thrust, torque),
        times={"up": each("timeConstantUp"), "down": each("timeConstantDown")},
        highest=float(each("maxRotVelocity")[0]),
        drag=drag,
        pitching=None if physical.drag_height is None else drag * float(np.mean(positions[:, 2])),
    )


def _inertial(mass: float, centre: np.ndarray, inertia: np.ndarray) -> list[str]:
    entries = zip(("xx", "xy", "xz", "yy", "yz", "zz"), inertia[np.triu_indices(3)])
    return [
        "      <inertial>", f"        <pose>{numbers(centre)} 0 0 0</pose>", f"        <mass>{number(mass)}</mass>",
        "        <inertia>", *(f"          <i{n}>{number(v)}</i{n}>" for n, v in entries), "        </inertia>",
        "      </inertial>",
    ]  # fmt: skip


def _rotor(physical: Physical, links: Links, i: int, position: np.ndarray) -> list[str]:
    disc = f"<cylinder><radius>{number(physical.radius)}</radius><length>{number(0.05 * physical.radius)}</length>"
    return [
        f'    <link name="rotor_{i + 1}">', f"      <pose>{numbers(position)} 0 0 0</pose>",
        *_inertial(links.rotor_mass, np.zeros(3), links.rotor),
        '      <visual name="disc">', f"        <geometry>{disc}</cylinder></geometry>", "      </visual>",
        "    </link>", f'    <joint name="rotor_{i + 1}_joint" type="revolute">', "      <parent>base_link</parent>",
        f"      <child>rotor_{i + 1}</child>", "      <axis>", "        <xyz>0 0 1</xyz>",
        "        <limit><lower>-1e16</lower><upper>1e16</upper></limit>", "      </axis>", "    </joint>",
    ]  # fmt: skip


def _motor(physical: Physical, i: int) -> list[str]:
    drag, rolling = max(physical.rotor_drag, 0.0), max(physical.rotor_rolling, 0.0)
    elements = {
        "jointName": f"rotor_{i + 1}_joint",
        "linkName": f"rotor_{i + 1}",
        "turningDirection": "cw" if physical.spin[i] > 0.0 else "ccw",
        "timeConstantUp": number(physical.rotors.up[i]),
        "timeConstantDown": number(physical.rotors.down[i]),
        "maxRotVelocity": number(physical.highest),
        "motorConstant": number(physical.thrust.value),
        "momentConstant": number(physical.moment_ratio),
        "rotorDragCoefficient": number(drag),
        "rollingMomentCoefficient": number(rolling),
        "rotorVelocitySlowdownSim": str(SLOWDOWN),
        "motorNumber": str(i),
        "commandSubTopic": "command/motor_speed",
        "motorSpeedPubTopic": f"motor_speed/{i}",
        "motorType": "velocity",
    }
    name = "gz::sim::systems::MulticopterMotorModel"
    return [
        f'    <plugin filename="gz-sim-multicopter-motor-model-system" name="{name}">',
        *(f"      <{key}>{value}</{key}>" for key, value in elements.items()),
        "    </plugin>",
    ]


def _pose(element) -> np.ndarray:
    return _floats(element.findtext("pose"))


def _floats(text: str) -> np.ndarray:
    return np.array([float(part) for part in text.split()])
