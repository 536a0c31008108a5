"""PID: B u = I (nu + integral - derivative), Fz of hover + B_z (u - u_hover) = -T; B from geometry, one thrust factor.

nu  wanted angular acceleration, T  thrust, u  squared rotor speeds, B  their effectiveness.
"""

import numpy as np
from numba import njit

from quasi.simulation.control import law
from quasi.simulation.control import parameters as g
from quasi.simulation.control.control_model import ControlModel, use_geometric_mixer
from quasi.simulation.control.outer_loop import (
    CONTROLLER_STATUS,
    RUNNING,
    VELOCITY_INTEGRAL,
    WANTED_RATES,
    run_outer_loop,
)
from quasi.terms.lanes import choose


@njit(cache=True, error_model="numpy")
def run_pid(p, m, dt, measurement, setpoint):
    """Set the wanted loads."""
    thrust = run_outer_loop(p, m, dt, measurement, setpoint, 0.0, 0.0, 0.0)
    law.set_angular_acceleration(p, m, measurement)
    for k in range(3):
        law.filter_value(m, law.RATE_FILTERS + 3 * k, 0.5 * dt, measurement[7 + k])
        error = m[WANTED_RATES + k] - measurement[7 + k]
        # anti-windup: no integration further into a limit of the rotors
        integrates = (m[CONTROLLER_STATUS] == RUNNING) | (error * m[law.RATE_INTEGRAL + k] < 0.0)
        most = p[g.RATE_GAINS + k] * p[g.MAX_TILT_RATE]
        total = m[law.RATE_INTEGRAL + k] + p[g.RATE_INTEGRAL_GAINS + k] * error * dt
        m[law.RATE_INTEGRAL + k] = choose(integrates, min(max(total, -most), most), m[law.RATE_INTEGRAL + k])
        m[law.ANGULAR_ACCELERATION + k] += (
            m[law.RATE_INTEGRAL + k] - p[g.RATE_DERIVATIVE_GAINS + k] * m[law.RATE_FILTERS + 3 * k + 1]
        )
    mx, my, mz = law.multiply_inertia(
        p, m[law.ANGULAR_ACCELERATION], m[law.ANGULAR_ACCELERATION + 1], m[law.ANGULAR_ACCELERATION + 2]
    )
    law.set_wanted_loads(p, m, dt, mx, my, mz, thrust)


def _slow_yaw(vehicle: ControlModel, small_time_constant: float) -> float:
    """The torque of rotor acceleration adds gain that the geometric mixer neglects: the lead of the yaw moment, s."""
    lead = np.abs(vehicle.yaw_reaction).mean() / (np.abs(vehicle.effectiveness[2]).mean() * 2.0 * vehicle.hover_speed)
    return max(0.5 * float(lead) / small_time_constant, 1.0)


PID = law.Law(
    "PID",
    gains={"velocity": ("integral time",), "rates": ("integral time", "derivative time")},
    memory=(
        (law.LAST_COMMANDS_SQUARED, 4, True), (VELOCITY_INTEGRAL, 3, False), (law.RATE_INTEGRAL, 3, False),
        (law.RATE_FILTERS, 9, False),
    ),
    yaw=_slow_yaw,
    vehicle=use_geometric_mixer,
)  # fmt: skip
