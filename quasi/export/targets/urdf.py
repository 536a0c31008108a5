"""URDF: mass, inertia and geometry of the vehicle, for ROS 2 tools, PyBullet and importers of other simulators.

Source of the format: the URDF XML specification (wiki.ros.org/urdf/XML). It holds no rotor; what is needed to drive one
is in the file's comment.
"""

from collections.abc import Mapping

import numpy as np

from quasi.export.frames import swap_inertia, swap_vector
from quasi.export.physical_constants import Physical, not_carried
from quasi.export.rotor_links import check_inertia
from quasi.export.simulator_check import Recovered
from quasi.export.xml_text import comment, inertia_of, number, numbers, parsed

NAME = "urdf"
TITLE = "URDF: mass, inertia and geometry"
NEEDS = "a reader of URDF (ROS 2, PyBullet, Isaac Sim)"
CARRIES = frozenset({"mass", "inertia", "products of inertia"})


def write(physical: Physical) -> dict[str, str]:
    """{file: text} of the export."""
    check_inertia(physical, "a physics engine")
    positions, inertia = swap_vector(physical.positions), swap_inertia(physical.inertia)
    turns = ", ".join(f"{i} {'cw' if s > 0 else 'ccw'}" for i, s in enumerate(physical.spin, 1))
    head = [
        f"Quadrotor of model {physical.name}, made by quasi; body axes x forward, y left, z up.",
        "The base link holds the mass and inertia of the whole vehicle. Rotor links stand where the rotors'",
        f"thrust gives the model's moments; seen from above they turn: {turns}.",
        "Not carried by this format:",
        *(f"- {line}" for line in not_carried(physical, CARRIES)),
    ]
    entries = zip(("xx", "xy", "xz", "yy", "yz", "zz"), inertia[np.triu_indices(3)])
    tensor = " ".join(f'i{n}="{number(v)}"' for n, v in entries)
    size = numbers([*(2.0 * np.max(np.abs(positions[:, :2]), axis=0)), 0.3 * physical.arm])
    box = f'      <geometry><box size="{size}"/></geometry>'
    lines = [
        '<?xml version="1.0"?>', *comment(head), f'<robot name="{physical.name}">', '  <link name="base_link">',
        "    <inertial>", '      <origin xyz="0 0 0" rpy="0 0 0"/>', f'      <mass value="{number(physical.mass)}"/>',
        f"      <inertia {tensor}/>", "    </inertial>", "    <visual>", box, "    </visual>", "    <collision>", box,
        "    </collision>", "  </link>",
    ]  # fmt: skip
    zero = " ".join(f'i{n}="0"' for n in ("xx", "xy", "xz", "yy", "yz", "zz"))
    for i, position in enumerate(positions, 1):
        disc = f'radius="{number(physical.radius)}" length="{number(0.05 * physical.radius)}"'
        lines += [
            f'  <link name="rotor_{i}">', f'    <inertial><mass value="0"/><inertia {zero}/></inertial>',
            f"    <visual><geometry><cylinder {disc}/></geometry></visual>", "  </link>",
            f'  <joint name="rotor_{i}_joint" type="fixed">', '    <parent link="base_link"/>',
            f'    <child link="rotor_{i}"/>', f'    <origin xyz="{numbers(position)}" rpy="0 0 0"/>', "  </joint>",
        ]  # fmt: skip
    return {"quadrotor.urdf": "\n".join([*lines, "</robot>", ""])}


def recover(files: Mapping[str, str], physical: Physical) -> Recovered:
    """What quadrotor.urdf holds, parsed back: mass and inertia; moments by k_T, which physical gives, at its rotors."""
    root = parsed(files["quadrotor.urdf"], "quadrotor.urdf")
    links = {link.get("name"): link for link in root.findall("link")}
    inertial = links["base_link"].find("inertial")
    mass = sum(float(link.find("inertial/mass").get("value")) for link in links.values())
    joints = {joint.find("child").get("link"): joint for joint in root.findall("joint")}
    places = [joints[f"rotor_{i}"].find("origin").get("xyz").split() for i in range(1, 5)]
    positions = swap_vector(np.array(places, float))
    k = physical.thrust.value
    yaw = -physical.spin * physical.torque.value  # the format holds none
    return Recovered(
        mass=mass,
        inertia=swap_inertia(inertia_of(inertial.find("inertia"))),
        moments=np.array([-positions[:, 1] * k, positions[:, 0] * k, yaw]),
    )
