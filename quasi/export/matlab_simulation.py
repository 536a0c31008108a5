"""The simulation environment of chapter 8.3 as .m files: main.m, the blocks of figures 29 to 31, their parameters.

The blocks stand in matlab_files/simulation; what depends on the model is simParameters.m, which is written here from
the constants of a closed loop (`quasi.simulation.tools.portable.loop_constants`).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from quasi.export.matlab_terms import number
from quasi.model.model import Model
from quasi.tables import read_text, write_text

_OF_LOOP = (
    ("dt", "time step", "s, between two commands; the gains below were derived for it"),
    ("substeps", "substeps", "of the integrator within a time step"),
    ("mass", "mass", "kg"),
    ("inertia", "inertia", "kg m2, body axes"),
    ("inverseInertia", "inverse inertia", "1/(kg m2)"),
    ("gravityAdded", "gravity added", "m/s2; 0 where the model's forces hold gravity"),
    ("offset", "offset", "N, N m, taken off the model's forces and moments"),
    ("tausUp", "time constants up", "s, of the rotors when they speed up; 0 for none"),
    ("tausDown", "time constants down", "s, when they slow down"),
    ("rateLimit", "rate limit", "rad/s2"),
    ("lowestSpeed", "lowest", "rad/s, of the rotors"),
    ("highestSpeed", "highest", "rad/s"),
    ("delay", "delay", "s, before a command acts"),
    ("wind", "wind", "m/s, velocity of the air: north east down"),
)
_OF_CONTROLLER = (
    ("mass", "mass", "kg"),
    ("inertia", "inertia", "kg m2"),
    ("effectiveness", "effectiveness", "rows Mx My Mz (N m), Fz (N), columns rotors, per (rad/s)^2, about hover"),
    ("yawReaction", "yaw reaction", "N m per rad/s2: Mz of each rotor's acceleration"),
    ("hoverSpeed", "hover speed", "rad/s"),
    ("lowestSpeed", "lowest", "rad/s"),
    ("highestSpeed", "highest", "rad/s"),
    ("lag", "lag", "s, lag and delay of the rotors"),
    ("position", "position", "1/s, position error to velocity"),
    ("velocity", "velocity", "1/s, velocity error to acceleration"),
    ("velocityIntegral", "velocity integral", "1/s2"),
    ("attitude", "attitude", "1/s, tilt error to rates"),
    ("yaw", "yaw", "1/s, yaw error to rate"),
    ("rates", "rates", "1/s, rate errors to angular accelerations"),
    ("cutOff", "cut-off", "rad/s, of INDI's low-pass filter"),
    ("damping", "damping", "of that filter"),
    ("tilt", "tilt", "rad, greatest"),
    ("speed", "speed", "m/s, greatest horizontal speed of approach"),
    ("climb", "climb", "m/s, greatest vertical one"),
    ("acceleration", "acceleration", "m/s2, greatest"),
    ("rate", "rate", "rad/s, greatest of roll and pitch"),
    ("yawRate", "yaw rate", "rad/s, greatest"),
    ("integral", "integral", "m/s2, greatest"),
    ("weights", "weights", "of roll, pitch, yaw, thrust in the allocation"),
    ("weighted", "weighted", "1: weighted allocation at the limits; 0: plain inverse, cut off"),
    ("learnRotorLimits", "learn rotor limits", "1: a rotor that stays behind is taken to be at its limit"),
)


def simulation_files(model: Model, loop: Mapping[str, Any], source: Path) -> dict[str, str]:
    """{path in the folder: text} of the environment. source  folder of the blocks."""
    files = {f"simulation/{p.name}": read_text(p) for p in sorted((source / "simulation").glob("*.m"))}
    files["main.m"] = read_text(source / "main.m.template").replace("@MODEL@", model.id.replace("'", "''"))
    files["simulation/simParameters.m"] = parameters_file(model, loop)
    return files


def write_simulation(model: Model, folder: Path, loop: Mapping[str, Any], source: Path) -> None:
    """Write main.m and the folder simulation/."""
    for name, text in simulation_files(model, loop, source).items():
        write_text(folder / name, text)


def parameters_file(model: Model, loop: Mapping[str, Any]) -> str:
    """simParameters.m: the numbers of vehicle and controller, each with its unit."""
    voltage = loop["battery voltage"]
    lines = [
        "function simParams = simParameters()",
        f"%SIMPARAMETERS  Vehicle and controller of the closed loop of model {model.id}; SI units.",
        "%",
        "%   Change a number here, or in the struct that comes back, to fly with other gains, limits or wind.",
        "",
        "simParams.g = 9.81;  % m/s2",
        *(f"simParams.{name} = {_value(loop[key])};  % {about}" for name, key, about in _OF_LOOP),
        f"simParams.rungeKutta = {_value(loop['integrator'] == 'rk4')};  % 1: fourth-order Runge-Kutta, 0: Euler",
        f"simParams.batteryVoltage = {_value(np.nan if voltage is None else voltage)};  % V, NaN where no term asks",
        "",
        "% controller: attitude and rates by INDI, position and velocity by PID",
        *(f"controller.{name} = {_value(loop['controller'][key])};  % {about}" for name, key, about in _OF_CONTROLLER),
        "simParams.controller = controller;",
        "end",
        "",
    ]
    return "\n".join(lines)


def _value(value: Any) -> str:
    array = np.asarray(value, float)
    if array.ndim == 0:
        return number(float(array))
    rows = "; ".join(" ".join(number(x) for x in row) for row in np.atleast_2d(array))
    return f"[{rows}]"
