"""crazyflow and drone-models: one table of physical parameters in TOML.

Source of the law: the first-principles model of drone-models. Rotor speeds in rpm; thrust and torque are polynomials of
the rpm, coefficients by order; mixing_matrix times thrust times L are the moments about x and y, its last row times
torque that about z, in body axes x forward, y left, z up; force = drag_matrix times body velocity; the rpm follows its
command with rotor_dyn_coef (up, up squared, down, down squared), 1/s.
"""

import math
import tomllib
from collections.abc import Mapping

import numpy as np

from quasi.attitude import GRAVITY
from quasi.export.frames import swap_inertia, swap_vector
from quasi.export.physical_constants import Physical, not_carried
from quasi.export.simulator_check import Recovered
from quasi.export.xml_text import number

NAME = "crazyflow"
TITLE = "crazyflow and drone-models: parameters in TOML"
NEEDS = "drone-models 0.1 or crazyflow"
CARRIES = frozenset({
    "mass", "inertia", "products of inertia", "thrust coefficient", "torque coefficient", "time constants up",
    "time constants down", "speed limits", "horizontal drag", "vertical drag", "rotor inertia",
})  # fmt: skip
RPM = 30.0 / math.pi  # of one rad/s


def write(physical: Physical) -> dict[str, str]:
    """{file: text} of the export."""
    positions, arm = swap_vector(physical.positions), _arm(physical)
    inertia = swap_inertia(physical.inertia)
    mixing = np.array([positions[:, 1] / arm, -positions[:, 0] / arm, physical.spin])
    drag = -np.diag([d.value for d in physical.drag])
    lost = not_carried(physical, CARRIES)
    for name in ("up", "down"):
        if np.ptp(getattr(physical.rotors, name)) > 0.0:
            lost.append(f"the rotors' own time constants {name}: their mean is used")
    values = {
        "gravity_vec": [0.0, 0.0, -GRAVITY],
        "mass": physical.mass,
        "L": arm,
        "J": inertia,
        "rpm2thrust": [0.0, 0.0, physical.thrust.value / RPM**2],
        "rpm2torque": [0.0, 0.0, physical.torque.value / RPM**2],
        "thrust2torque": physical.moment_ratio,
        "mixing_matrix": mixing,
        "thrust_tau": 0.5 * float(np.mean(physical.rotors.up + physical.rotors.down)),
        "rotor_tau": 0.5 * float(np.mean(physical.rotors.up + physical.rotors.down)),
        "rotor_dyn_coef": [1.0 / np.mean(physical.rotors.up), 0.0, 1.0 / np.mean(physical.rotors.down), 0.0],
        "drag_matrix": drag,
        "prop_radius": physical.radius,
        "prop_inertia": 0.0 if physical.rotor_inertia is None else physical.rotor_inertia.value,
        "thrust_min": physical.thrust.value * physical.rotors.lowest**2,
    }
    if physical.highest is not None:
        values["thrust_max"] = physical.thrust.value * physical.highest**2
    head = [
        f"Quadrotor of model {physical.name}, made by quasi; body axes x forward, y left, z up.",
        "Put the table into data/params.toml of drone-models, and a table of the same name into first_principles/.",
        "Columns of mixing_matrix are rotors 1 to 4, speeds are rpm, thrust in N per rotor.",
        "Not carried by this format:",
        *(f"- {line}" for line in lost),
    ]
    lines = [*(f"# {line}" for line in head), "", f'["{physical.name}"]']
    lines += [f"{name} = {_toml(value)}" for name, value in values.items()]
    return {"params.toml": "\n".join([*lines, ""])}


def recover(files: Mapping[str, str], physical: Physical) -> Recovered:
    """What params.toml holds, parsed back; physical gives the hover speed."""
    table = tomllib.loads(files["params.toml"])[physical.name]
    mixing, arm = np.array(table["mixing_matrix"]), table["L"]
    thrust, torque = table["rpm2thrust"][2] * RPM**2, table["rpm2torque"][2] * RPM**2
    moments = np.column_stack([arm * thrust * mixing[0], arm * thrust * mixing[1], torque * mixing[2]])
    up, _, down, _ = table["rotor_dyn_coef"]
    rpm = physical.hover * RPM
    highest = table.get("thrust_max")
    drag = -np.diag(np.array(table["drag_matrix"]))
    return Recovered(
        mass=table["mass"],
        inertia=swap_inertia(np.array(table["J"])),
        hover_thrust=4.0 * float(np.polynomial.Polynomial(table["rpm2thrust"])(rpm)),
        moments=swap_vector(moments).T,
        times={"up, mean of rotors": 1.0 / up, "down, mean of rotors": 1.0 / down},
        highest=None if highest is None else math.sqrt(highest / thrust),
        drag=max(float(np.mean(drag[:2])), 0.0),
    )


def _arm(physical: Physical) -> float:
    """L, m: the distance along x and y that mixing_matrix is relative to."""
    return float(np.mean(np.abs(physical.positions[:, :2])))


def _toml(value: object) -> str:
    array = np.asarray(value, float)
    if array.ndim == 0:
        text = number(float(array))
        return text if any(c in text for c in ".en") else f"{text}.0"
    return f"[{', '.join(_toml(part) for part in array)}]"
