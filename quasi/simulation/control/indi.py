"""INDI: B (u - W^2_f) = I (nu - omega_dot_f) + the change of omega x I omega since omega_f; T from the measured
specific force likewise; f: the same low-pass filter.

nu  wanted angular acceleration, T  thrust, u  squared rotor speeds, B  their effectiveness, W  measured rotor speeds.
Source: Smeur, Chu, de Croon, Adaptive incremental nonlinear dynamic inversion for attitude control of micro air
vehicles, J. Guidance, Control and Dynamics 39(3), 2016, and the paper named in outer_loop.py.
"""

from numba import njit

from quasi.simulation.control import law
from quasi.simulation.control import parameters as g
from quasi.simulation.control.outer_loop import rotation_matrix, run_outer_loop


@njit(cache=True, error_model="numpy")
def run_indi(p, m, dt, measurement, setpoint):
    """Set the wanted loads."""
    # acceleration not caused by thrust: accelerometer and rotor speeds of the same instant, with the same filter
    u0, u1 = measurement[13] * measurement[13], measurement[14] * measurement[14]
    u2, u3 = measurement[15] * measurement[15], measurement[16] * measurement[16]
    ax, ay = measurement[17], measurement[18]
    az = measurement[19] - law.thrust_force(p, u0, u1, u2, u3) / p[g.CONTROL_MASS]
    r = rotation_matrix(measurement)
    north, east, down = law.ACCELERATION_FILTERS, law.ACCELERATION_FILTERS + 3, law.ACCELERATION_FILTERS + 6
    law.filter_value(m, north, 0.5 * dt, r[0] * ax + r[1] * ay + r[2] * az)
    law.filter_value(m, east, 0.5 * dt, r[3] * ax + r[4] * ay + r[5] * az)
    law.filter_value(m, down, 0.5 * dt, r[6] * ax + r[7] * ay + r[8] * az)
    thrust = run_outer_loop(p, m, dt, measurement, setpoint, m[north], m[east], m[down])
    law.set_angular_acceleration(p, m, measurement)
    for k in range(3):
        law.filter_value(m, law.RATE_FILTERS + 3 * k, 0.5 * dt, measurement[7 + k])
    for i in range(4):
        law.filter_value(m, law.SPEED_FILTERS + 3 * i, 0.5 * dt, measurement[13 + i] * measurement[13 + i])
    mx, my, mz = law.compute_moments(p, m, measurement, setpoint)
    # moments of neither rotors nor gyroscopic terms: rates and rotor speeds with the same filter
    ax, ay, az = law.multiply_inertia(p, m[law.RATE_FILTERS + 1], m[law.RATE_FILTERS + 4], m[law.RATE_FILTERS + 7])
    hx, hy, hz = law.multiply_inertia(p, m[law.RATE_FILTERS], m[law.RATE_FILTERS + 3], m[law.RATE_FILTERS + 6])
    mx -= ax + m[law.RATE_FILTERS + 3] * hz - m[law.RATE_FILTERS + 6] * hy
    my -= ay + m[law.RATE_FILTERS + 6] * hx - m[law.RATE_FILTERS] * hz
    mz -= az + m[law.RATE_FILTERS] * hy - m[law.RATE_FILTERS + 3] * hx
    e = g.EFFECTIVENESS
    for i in range(4):
        u, slope = m[law.SPEED_FILTERS + 3 * i], m[law.SPEED_FILTERS + 3 * i + 1]
        mx += p[e + i] * u
        my += p[e + 4 + i] * u
        mz += p[e + 8 + i] * u + p[g.YAW_REACTION + i] / (2.0 * p[g.HOVER_SPEED]) * slope
    law.set_wanted_loads(p, m, dt, mx, my, mz, thrust)


INDI = law.Law(
    "INDI",
    gains={},
    memory=(
        (law.LAST_COMMANDS_SQUARED, 4, True), (law.RATE_FILTERS, 9, False), (law.SPEED_FILTERS, 12, True),
        (law.ACCELERATION_FILTERS, 9, False),
    ),
    learns_limits=True,
)  # fmt: skip
