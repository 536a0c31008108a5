"""NDI: M(x, W) + B (u - W^2) = I nu + omega x I omega; F(x, W) likewise; M and F of the whole model.

nu  wanted angular acceleration, u  squared rotor speeds, B  their effectiveness, W  measured rotor speeds.
"""

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.model.hover import list_usual_inputs
from quasi.model.model import Model
from quasi.simulation.control import law
from quasi.simulation.control import parameters as g
from quasi.simulation.control.outer_loop import VELOCITY_INTEGRAL, rotation_matrix, run_outer_loop
from quasi.simulation.vehicle.dynamics import euler_angles
from quasi.terms.kernel import Kernel, compute_wrench


@njit(cache=True, error_model="numpy")
def run_ndi(p, packed, m, dt, measurement, setpoint):
    """Set the wanted loads. packed  parameters of one drone as an array, which hold its model"""
    kernel, offset, further = unpack_model(packed)
    inputs = m[law.MODEL_INPUTS : law.MODEL_INPUTS + 20 + len(further)]
    work = m[law.MODEL_INPUTS + 20 + len(further) :]
    out = m[law.MODEL_LOADS : law.MODEL_LOADS + 6]
    euler_angles(measurement, inputs)
    for i in range(13):
        inputs[3 + i] = measurement[4 + i]
    for i in range(4):
        inputs[16 + i] = 0.0  # the moment of rotor accelerations is part of the unknowns
    for i in range(20, len(inputs)):
        inputs[i] = further[i - 20]
    compute_wrench(kernel, inputs, work, out)
    for k in range(6):
        out[k] -= offset[k]
    r = rotation_matrix(measurement)
    mass = p[g.CONTROL_MASS]
    if packed[g.MODEL_START] == 0.0:  # the model's forces include the weight
        for k in range(3):
            out[k] -= mass * GRAVITY * r[6 + k]
    u0, u1 = measurement[13] * measurement[13], measurement[14] * measurement[14]
    u2, u3 = measurement[15] * measurement[15], measurement[16] * measurement[16]
    ax, ay = out[0] / mass, out[1] / mass
    az = (out[2] - law.thrust_force(p, u0, u1, u2, u3)) / mass
    thrust = run_outer_loop(
        p, m, dt, measurement, setpoint,
        r[0] * ax + r[1] * ay + r[2] * az, r[3] * ax + r[4] * ay + r[5] * az, r[6] * ax + r[7] * ay + r[8] * az,
    )  # fmt: skip
    law.set_angular_acceleration(p, m, measurement)
    mx, my, mz = law.compute_moments(p, m, measurement, setpoint)
    mx, my, mz = mx - out[3], my - out[4], mz - out[5]
    e = g.EFFECTIVENESS
    for i in range(4):
        u = measurement[13 + i] * measurement[13 + i]
        mx += p[e + i] * u
        my += p[e + 4 + i] * u
        mz += p[e + 8 + i] * u
    law.set_wanted_loads(p, m, dt, mx, my, mz, thrust)


def _pack_model(model: Model, offset: np.ndarray) -> tuple[np.ndarray, int]:
    """The model as float64: 1 or 0 for forces without or with weight, offset (6,), lengths, extras, arrays; and the
    size of its work array.

    Two integers of the code occupy the bytes of one float; `unpack_model` reads them in place.
    """
    if len(model.axes) < 6:
        raise DataError(f"controller NDI inverts forces and moments, but model {model.id} has only {model.axes}")
    kernel, further = model.kernel, list_usual_inputs(model)
    code = np.concatenate([kernel.code, np.zeros(len(kernel.code) % 2, np.uint32)]).astype(np.uint32)
    head = [float(model.with_gravity), *offset, len(further), len(kernel.code), len(kernel.numbers)]
    packed = np.concatenate([head, further, kernel.numbers, code.view(np.float64)])
    return packed, len(model.inputs) + len(kernel.work)


@njit(cache=True, error_model="numpy")
def unpack_model(p):
    """Read kernel, offset (6,) and extras that `_pack_model` wrote, without a copy."""
    at = g.MODEL_START + 10
    extra, whole, numbers = int(p[at - 3]), int(p[at - 2]), int(p[at - 1])
    begin = at + extra + numbers
    code = p[begin : begin + (whole + 1) // 2].view(np.uint32)[:whole]
    return Kernel(code, p[at + extra : begin]), p[g.MODEL_START + 1 : g.MODEL_START + 7], p[at : at + extra]


NDI = law.Law(
    "NDI",
    gains={"velocity": ("integral time",)},
    memory=((law.LAST_COMMANDS_SQUARED, 4, True), (VELOCITY_INTEGRAL, 3, False)),
    integral=16.0,
    pack=_pack_model,
)
