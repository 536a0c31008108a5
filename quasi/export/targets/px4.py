"""PX4: parameters of an airframe, as a start-up script and as a file that QGroundControl loads.

Source of the parameters' meaning: PX4's parameter reference, modules control allocation (CA_ROTORn_PX, _PY, _PZ in body
axes x forward, y right, z down; _CT: thrust = CT u^2 for an output u of 0 to 1; _KM: torque over thrust, positive for a
rotor that turns counter-clockwise) and mixer (THR_MDL_FAC f: relative thrust = f u^2 + (1 - f) u), and simulation in
hardware (SIH_*; thrust T_MAX and torque Q_MAX at full output, linear drag KDV, rate damping KDW, thrust lag T_TAU).
"""

import math
from collections.abc import Mapping

import numpy as np

from quasi.errors import DataError
from quasi.export.physical_constants import Physical, not_carried
from quasi.export.simulator_check import Recovered, moments_of
from quasi.export.xml_text import number

NAME = "px4"
TITLE = "PX4: airframe parameters"
NEEDS = "PX4 1.14 or later, or QGroundControl"
CARRIES = frozenset({"thrust coefficient", "torque coefficient", "speed limits"})
CARRIES_SIMULATED = CARRIES | {"mass", "inertia", "products of inertia"}
# places of motors 1 to 4 in PX4's quadrotor x, which SIH assumes: (front, right) and clockwise from above
MOTOR_ORDER = ((1, 1, False), (-1, -1, False), (1, -1, True), (-1, 1, True))
INTEGERS = ("CA_AIRFRAME", "CA_ROTOR_COUNT", "SIM_GZ_EC_MIN", "SIM_GZ_EC_MAX")
MIXER_POINTS = 101  # of the output range, at which THR_MDL_FAC is fitted


def write(physical: Physical) -> dict[str, str]:
    """{file: text} of the export."""
    values, notes = parameters(physical)
    simulated = "SIH_MASS" in values
    head = [
        f"Quadrotor of model {physical.name}, made by quasi. Rotor i of the model is motor i (CA_ROTOR(i-1)).",
        "Positions: body axes x forward, y right, z down, m, where the rotors' thrust gives the model's moments.",
        *notes,
        "Not carried by these parameters:",
        *(f"- {line}" for line in not_carried(physical, CARRIES_SIMULATED if simulated else CARRIES)),
    ]
    lines = ["#!/bin/sh", *(f"# {line}" for line in head), "", ". ${R}etc/init.d/rc.mc_defaults", ""]
    lines += [f"param set-default {name} {_text(name, value)}" for name, value in values.items()]
    ground = ["# Onboard parameters for QGroundControl", "# Vehicle-Id Component-Id Name Value Type"]
    ground += [
        f"1\t1\t{name}\t{_text(name, value)}\t{6 if name.startswith(INTEGERS) else 9}" for name, value in values.items()
    ]
    return {"airframe.sh": "\n".join([*lines, ""]), "parameters.params": "\n".join([*ground, ""])}


def parameters(physical: Physical) -> tuple[dict[str, float], list[str]]:
    """{parameter: value}, and what was left out or assumed."""
    notes = []
    values: dict[str, float] = {"CA_AIRFRAME": 0, "CA_ROTOR_COUNT": 4}
    full = full_speed(physical)
    for i, (position, spin) in enumerate(zip(physical.positions, physical.spin)):
        values |= {f"CA_ROTOR{i}_P{axis}": float(v) for axis, v in zip("XYZ", position)}
        values[f"CA_ROTOR{i}_KM"] = -float(spin) * physical.moment_ratio
        if full is not None:
            values[f"CA_ROTOR{i}_CT"] = physical.thrust.value * full**2
    if full is None:
        notes.append("Left out, for the highest rotor speed is unknown: CA_ROTORn_CT, MPC_THR_HOVER, SIM_GZ_EC_MAXn.")
    if physical.command_map is None:
        notes.append("Left out, for no map from command to rotor speed is known: THR_MDL_FAC.")
    else:
        factor, rms = thrust_factor(physical)
        values["THR_MDL_FAC"] = factor
        notes.append(
            f"THR_MDL_FAC is fitted to the identified command map; rms error {100 * rms:.1f} % of full thrust."
        )
    if full is not None:
        values["MPC_THR_HOVER"] = hover_setpoint(physical)
        for i in range(1, 5):
            values[f"SIM_GZ_EC_MIN{i}"] = round(physical.rotors.lowest)
            values[f"SIM_GZ_EC_MAX{i}"] = round(full)
        if is_px4_order(physical):
            values |= _simulated(physical, full)
        else:
            notes.append(
                "Left out: SIH_*, whose quadrotor has front right as motor 1, then aft left, front left, aft right."
            )
    return values, notes


def recover(files: Mapping[str, str], physical: Physical) -> Recovered:
    """What the airframe holds, parsed back; physical gives hover speed and command map.

    Raises DataError where both files differ.
    """
    values = {}
    for line in files["airframe.sh"].splitlines():
        if line.startswith("param set-default "):
            name, value = line.split()[2:]
            values[name] = float(value)
    rows = [line.split("\t") for line in files["parameters.params"].splitlines() if not line.startswith("#")]
    if {row[2]: float(row[3]) for row in rows} != values:
        raise DataError("the exported airframe.sh and parameters.params differ; please report this")
    positions = np.array([[values[f"CA_ROTOR{i}_P{axis}"] for axis in "XYZ"] for i in range(4)])
    full = full_speed(physical)
    thrust = None
    moments = None
    if full is not None:
        most = np.array([values[f"CA_ROTOR{i}_CT"] for i in range(4)])
        ratio = np.array([values[f"CA_ROTOR{i}_KM"] for i in range(4)])
        # a counter-clockwise rotor is pushed clockwise, which is positive about the axis that points down
        moments = moments_of(positions, most / full**2, ratio * most / full**2)
        speed = _speed_at(physical, values["MPC_THR_HOVER"], values.get("THR_MDL_FAC"), full)
        thrust = float(np.sum(most) * (speed / full) ** 2)
    inertia = None
    if "SIH_IXX" in values:
        xx, yy, zz, xy, xz, yz = (values[f"SIH_I{n}"] for n in ("XX", "YY", "ZZ", "XY", "XZ", "YZ"))
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Recovered(mass=values.get("SIH_MASS"), inertia=inertia, hover_thrust=thrust, moments=moments)


def is_px4_order(physical: Physical) -> bool:
    """Whether rotors 1 to 4 are numbered and turn as PX4's quadrotor x has them."""
    return all(
        hub[0] * front > 0.0 and hub[1] * right > 0.0 and (spin > 0.0) == clockwise
        for hub, spin, (front, right, clockwise) in zip(physical.hubs, physical.spin, MOTOR_ORDER)
    )


def full_speed(physical: Physical) -> float | None:
    """Rotor speed at full output, rad/s: of the command map, else the airframe's limit; None where both are unknown."""
    return float(_mapped(physical, 1.0)) if physical.command_map is not None else physical.highest


def thrust_factor(physical: Physical) -> tuple[float, float]:
    """THR_MDL_FAC of the command map by least squares over the output range, 0 to 1; and the rms error of thrust."""
    u = np.linspace(0.0, 1.0, MIXER_POINTS)
    thrust = (_mapped(physical, u) / _mapped(physical, 1.0)) ** 2
    bend = u**2 - u
    factor = float(np.clip(np.sum((thrust - u) * bend) / np.sum(bend**2), 0.0, 1.0))
    return factor, float(np.sqrt(np.mean((u + factor * bend - thrust) ** 2)))


def hover_setpoint(physical: Physical) -> float:
    """MPC_THR_HOVER: the thrust set-point, 0 to 1, whose output turns the rotors at hover speed."""
    full = full_speed(physical)
    if physical.command_map is None:
        return (physical.hover / full) ** 2  # as if the output were linearised without error
    u = np.linspace(0.0, 1.0, 100 * MIXER_POINTS)
    output = float(np.interp(physical.hover, _mapped(physical, u), u))
    factor = thrust_factor(physical)[0]
    return factor * output**2 + (1.0 - factor) * output


def _speed_at(physical: Physical, setpoint: float, factor: float | None, full: float) -> float:
    """Rotor speed, rad/s, of a thrust set-point: the mixer inverts f u^2 + (1 - f) u, the map gives the speed."""
    if factor is None:
        return full * math.sqrt(setpoint)
    output = setpoint
    if factor > 0.0:
        b = 1.0 - factor
        output = (-b + math.sqrt(b * b + 4.0 * factor * setpoint)) / (2.0 * factor)
    return float(_mapped(physical, output))


def _mapped(physical: Physical, command: np.ndarray | float) -> np.ndarray:
    """Rotor speed, rad/s, by the command map at its reference voltage."""
    table = physical.command_map
    powers = table.get("powers") or range(len(table["coefficients"]))
    return sum(float(c) * np.asarray(command, float) ** float(p) for c, p in zip(table["coefficients"], powers))


def _simulated(physical: Physical, full: float) -> dict[str, float]:
    inertia, positions = physical.inertia, np.abs(physical.positions)
    return {
        "SIH_MASS": physical.mass,
        **{f"SIH_I{n}": float(inertia[k]) for n, k in (("XX", (0, 0)), ("YY", (1, 1)), ("ZZ", (2, 2)))},
        **{f"SIH_I{n}": float(inertia[k]) for n, k in (("XY", (0, 1)), ("XZ", (0, 2)), ("YZ", (1, 2)))},
        "SIH_T_MAX": physical.thrust.value * full**2,
        "SIH_Q_MAX": physical.torque.value * full**2,
        "SIH_L_ROLL": float(np.mean(positions[:, 1])),
        "SIH_L_PITCH": float(np.mean(positions[:, 0])),
        "SIH_KDV": max(0.5 * (physical.drag[0].value + physical.drag[1].value), 0.0),
        "SIH_KDW": max(float(np.mean([d.value for d in physical.damping])), 0.0),
        "SIH_T_TAU": float(np.mean([physical.rotors.up, physical.rotors.down])),
    }


def _text(name: str, value: float) -> str:
    return str(int(value)) if name.startswith(INTEGERS) else number(value)
